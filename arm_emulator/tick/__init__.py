"""One servo period of a machine, for every door; what imports what is in CONTRIBUTING.md."""
