"""Analysis of a machine with its servos before it moves."""
