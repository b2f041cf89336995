"""Hysteresis of gears, apart from its declaration."""

NUMBERS = """
[joints.NAME.gear.hysteresis]
torque                  N m         needed      > 0     1 to 20
twist                   rad         needed      > 0     3e-4 to 3e-3
elements                elements    4           whole 1 to 16
"""
ON_BASE = "HystereticGear<ElasticGear, 4>{}", "Kg"
