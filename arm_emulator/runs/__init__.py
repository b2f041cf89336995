"""Machine and control code coupled in one process, in lock-step, without a network."""
