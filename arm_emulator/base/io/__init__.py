"""Files: read with refusals, written atomically."""
