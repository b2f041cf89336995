"""What a machine's numbers are, found from records of its motion."""
