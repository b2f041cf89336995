"""Paths and trajectories towards targets within limits."""
