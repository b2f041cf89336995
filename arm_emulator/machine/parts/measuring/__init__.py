"""Sensors of joints and links."""
