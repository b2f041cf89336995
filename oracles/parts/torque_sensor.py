"""Torque sensors at the output of gears, apart from their declaration."""

from oracles.parts import analog_sensor

NUMBERS = "[joints.NAME.torque_sensor, U = N m]" + analog_sensor.NUMBERS_OF_SENSORS
FAULTS = "[of joints, S = torque_sensor, U = N m]" + analog_sensor.FAULTS_OF_SENSORS
OUTPUTS = {"torque": ("N m", "N")}
