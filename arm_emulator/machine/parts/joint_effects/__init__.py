"""Further torques on link or rotor."""
