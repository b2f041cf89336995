"""Runs and searches divided among processes."""
