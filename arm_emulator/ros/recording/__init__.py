"""Bags: written, read, recovered, and played into a node."""
