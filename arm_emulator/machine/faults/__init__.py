"""Faults: named changes of numbers of a machine, each with a magnitude; 0 is off."""
