"""Processes of nodes: how they start, end, and share a computer."""
