"""The motion controller: tool targets in, joint targets out."""
