"""Shapes of the arm and distances between them."""
