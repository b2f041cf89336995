"""Kinematics, elastic drives and configuration of one arm."""
