"""Tests of a servo against an emulated arm: ``pytest examples/my_tests.py``."""

import numpy as np
import pytest

from arm_emulator import Servo, load_servo_config, testing

CONFIG = "config/servo/three_axis.yaml"


@pytest.fixture
def servo():
    return Servo(load_servo_config(CONFIG))


@pytest.mark.parametrize("payload", [0, 2.0])
@pytest.mark.parametrize("noise", [None, 0.05])  # A, of the current sensors
def test_the_servo_reaches_its_target(servo, payload, noise):
    sensor = noise and {"noise": noise}
    scene = {"payload": payload, "joints.*.current_sensor": sensor}
    plant = testing.plant_of("three_axis", scene)
    target = plant.scene.start + np.array([0.05, -0.05, 0.05])
    q = testing.drive(plant, lambda _, m: servo.update(m.encoder_counts, m.current, target), 2000)
    testing.assert_settles(q, target, within=2e-4, last=200)


def test_an_emergency_stop_leaves_the_arm_where_it_is(servo):
    plant = testing.plant_of("three_axis")
    plant.powered = False
    target = plant.scene.start + 0.5
    q = testing.drive(plant, lambda _, m: servo.update(m.encoder_counts, m.current, target), 200)
    assert np.abs(q - plant.scene.start).max() < 1e-9
