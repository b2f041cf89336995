"""Faults, a file each."""
