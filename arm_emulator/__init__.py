"""The command line of the arm emulator, and the entry points of its nodes."""
