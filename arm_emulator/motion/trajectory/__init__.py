"""Curves of joints and tool over distance and time."""
