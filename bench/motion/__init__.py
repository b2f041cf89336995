"""The motion of the tool, and what controllers make of it."""
