"""Paths of an arm in C++20: kinematics along a line, and the timing of least duration."""

from pathlib import Path

FOLDER = Path(__file__).resolve().parent
