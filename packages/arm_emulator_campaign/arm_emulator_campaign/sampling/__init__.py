"""Numbers that vary: distributions, samples, and confidence of what follows."""
