"""Command line of the arm emulator, and the few words that all its packages share."""
