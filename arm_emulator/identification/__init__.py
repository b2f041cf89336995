"""Identification of a machine's numbers from records of its motion."""
