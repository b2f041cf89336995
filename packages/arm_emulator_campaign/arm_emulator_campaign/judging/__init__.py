"""Judgement of runs: signals, requirements and measures, as one program in C."""
