"""Drag of links, apart from its declaration."""

NUMBERS = """
[joints.NAME.drag]
coefficient             N m s2/rad2  needed     >= 0    0.1 to 10
"""
FAULTS = """
[of joints]
drag_grows              N m s2/rad2  1      0 to 1e6    drag.coefficient x + m
"""
