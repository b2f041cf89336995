"""Sensors of the motors' currents, apart from their declaration."""

from oracles.parts import analog_sensor

NUMBERS = "[joints.NAME.current_sensor, U = A]" + analog_sensor.NUMBERS_OF_SENSORS
FAULTS = "[of joints, S = current_sensor, U = A]" + analog_sensor.FAULTS_OF_SENSORS
