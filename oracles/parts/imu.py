"""Inertial measurement units, apart from their declaration."""

from oracles.parts import analog_sensor

NUMBERS = f"""
[imus.NAME.accelerometer, U = m/s2]
[imus.NAME.gyroscope, U = rad/s]{analog_sensor.NUMBERS_OF_CONVERTERS}\
bias_x                  U           none        -1e6 to 1e6
bias_y                  U           none        -1e6 to 1e6
bias_z                  U           none        -1e6 to 1e6

[imus.NAME]
delay                   servo periods  0        whole 0 to 100
"""
FAULTS = (
    "[of imus, S = accelerometer, U = m/s2]\n[of imus, S = gyroscope, U = rad/s]"
    + analog_sensor.FAULTS_OF_CONVERTERS.format("bias_x")
)
OUTPUTS = {"specific_force": ("m/s2", "m/s2"), "angular_rate": ("rad/s", "rad/s")}
