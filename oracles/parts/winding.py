"""Temperature of windings, apart from its declaration."""

NUMBERS = """
[joints.NAME.motor.winding]
heat_capacity           J/K         needed      > 0     0.2 to 5
thermal_resistance      K/W         needed      > 0     0.1 to 2
ambient                 degC        20          -50 to 150
reference               degC        20          -50 to 150
resistance_coefficient  1/K         0.0039      0 to 0.0045
magnet_coefficient      1/K         0           -0.01 to 0  -0.001 to 0
limit                   degC        none        > 0, <= 1000
"""
FAULTS = """
[of joints]
cooling_fails           1           9       0 to 1e6    motor.winding.thermal_resistance (1 + m) x
ambient_rises           K           40      0 to 300    motor.winding.ambient x + m
"""
ON_BASE = "HeatedMotor<DcMotor>{}", "R"
