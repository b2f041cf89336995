"""Doors to software that is not ROS: field buses, FMI, firmware of a microcontroller."""
