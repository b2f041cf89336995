"""A campaign as its file states it: scenario, faults, numbers that vary."""
