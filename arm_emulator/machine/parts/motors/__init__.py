"""Motors and their ratings."""
