"""Voltage lost in inverters, apart from its declaration."""

NUMBERS = """
[joints.NAME.motor.inverter]
voltage_error           V           needed      >= 0    0.3 to 3
knee                    A           needed      > 0     0.2 to 1
"""
FAULTS = """
[of joints]
inverter_ages           1           1       0 to 1000   motor.inverter.voltage_error (1 + m) x
"""
ON_BASE = "InvertedMotor<DcMotor>{}", "R"
