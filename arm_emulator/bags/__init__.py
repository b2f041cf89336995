"""Bags of our network, read, repeated and compared."""
