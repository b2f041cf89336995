"""The demo: its plan, its prediction, its pictures."""
