"""Pose accuracy of an arm, and its true kinematics from measured poses of the tool."""
