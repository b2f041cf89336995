"""`make fuzz`: random scenes, messages and machines, until something breaks.

Each part runs in processes of its own and prints one JSON object per line, see `fuzz.line`.
"""
