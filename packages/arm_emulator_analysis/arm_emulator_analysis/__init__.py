"""Scheme and step for an error, frequency responses, moments and differences of recorded runs."""
