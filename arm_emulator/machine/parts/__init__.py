"""The parts of a drive, one per file, and the list of them (known.py)."""
