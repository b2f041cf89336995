"""The parts of a drive, one per file."""
