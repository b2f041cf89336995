"""The servo: joint targets and encoder counts in, motor voltages out."""
