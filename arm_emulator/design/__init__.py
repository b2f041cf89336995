"""Scenes and gains worked out from a robot description and data sheets."""
