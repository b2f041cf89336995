"""The names of the core on which packages beside it may rely, by what they serve."""
