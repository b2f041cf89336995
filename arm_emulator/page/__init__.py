"""A page in the browser: the arm, its signals, and every moment of a run."""
