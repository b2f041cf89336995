"""A page in the browser: a run, its moments, the machine and its controls."""
