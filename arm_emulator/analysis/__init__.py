"""What a machine and its servos do together, worked out before anything moves."""
