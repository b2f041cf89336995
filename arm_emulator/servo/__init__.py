"""The servo: joint targets and encoder counts in, motor commands out; the law is servo.c."""
