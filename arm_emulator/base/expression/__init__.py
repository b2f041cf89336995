"""Expressions of signals: read, folded, bound to columns."""
