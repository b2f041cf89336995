"""Real machines compared with measurements or computations of others."""
