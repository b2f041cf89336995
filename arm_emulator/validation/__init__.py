"""Real machines, held against what others measured or computed of them."""
