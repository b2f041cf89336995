"""Deviations of one machine from its description, and the files that state them."""
