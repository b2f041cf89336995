"""Checks of values from files and callers."""
