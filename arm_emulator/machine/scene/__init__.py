"""Scene files: read, checked, as objects."""
