"""A master of drives for tests: their objects, their states, and how they are enabled."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from arm_emulator import Plant, Scene, load_scene, load_servo_config
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT

ROOT = Path(__file__).resolve().parents[3]
SERVO = load_servo_config(ROOT / "config/servo/three_axis.yaml")
PLAIN = load_scene("three_axis")
N, T = len(PLAIN.joints), PLAIN.servo_period
CLOSE, RELEASE = 0.012, 0.025  # s
# Scene with all features of a drive: gravity, stops, brakes and index pulses.
RICH = load_scene(
    "three_axis",
    overrides={
        "gravity": [0.0, 0.0, -9.81],
        "joints.*.brake": {"torque": 1.2, "close_delay": CLOSE, "release_delay": RELEASE},
        "joints.*.encoder": {"counts_per_turn": 1024, "index": "latch"},
        "joints.*.end_stops": {
            "lower": -2.0,
            "upper": 2.0,
            "stiffness": 3000.0,
            "damping": 50.0,
        },
        "joints.waist.motor.winding": {
            "heat_capacity": 3.0,
            "thermal_resistance": 2.0,
            "limit": 40.0,
        },
    },
)

CONTROL, STATUS, MODE, MODE_DISPLAY = 0x6040, 0x6041, 0x6060, 0x6061
TARGET, ACTUAL, ERROR = 0x607A, 0x6064, 0x603F
PP, PV, TQ, HM, CSP, CSV, CST = 1, 3, 4, 6, 8, 9, 10
SHUTDOWN, SWITCH_ON, ENABLE, RESET, HALT = 0x06, 0x07, 0x0F, 0x80, 0x100
REACHED, INTERNAL_LIMIT, BIT12, BIT13 = 0x400, 0x800, 0x1000, 0x2000

STATES = {  # masks and values of the statusword, CiA 402
    "not ready": (0x4F, 0x00),
    "switch on disabled": (0x4F, 0x40),
    "ready": (0x6F, 0x21),
    "switched on": (0x6F, 0x23),
    "operation enabled": (0x6F, 0x27),
    "quick stop": (0x6F, 0x07),
    "fault reaction": (0x4F, 0x0F),
    "fault": (0x4F, 0x08),
}


def make(scene: Scene = PLAIN, bus: int = ETHERCAT) -> Drives:
    return Drives(Plant(scene), SERVO, bus)


def state(drives: Drives, j: int = 0) -> str:
    word = drives.read(j, STATUS)
    names = [name for name, (mask, value) in STATES.items() if word & mask == value]
    assert len(names) == 1, f"states of the statusword 0x{word:04x}"
    return names[0]


def command(drives: Drives, word: int, periods: int = 1) -> None:
    for j in range(len(drives.plant.scene.joints)):
        drives.write(j, CONTROL, word)
    drives.period(periods)


def enable(drives: Drives, mode: int) -> None:
    """All drives, as masters do it; the targets are where the motors are."""
    joints = range(len(drives.plant.scene.joints))
    for j in joints:
        drives.write(j, MODE, mode)
        drives.write(j, TARGET, drives.read(j, ACTUAL))
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        command(drives, word)
    for _ in range(1000):
        if all(state(drives, j) == "operation enabled" for j in joints):
            return
        drives.period()
    raise AssertionError("the drives are not enabled after a second")


def until(drives: Drives, done: Callable[[], bool], max_periods: int = 5000) -> int:
    """Go on until something is so; return how many periods that took."""
    for periods in range(max_periods):
        if done():
            return periods
        drives.period()
    raise AssertionError(f"it is not so after {max_periods} periods")


def truth(drives: Drives, name: str) -> np.ndarray:
    return np.array(getattr(drives.plant.state, name))


def set_point(drives: Drives, target: int, bits: int = 0, j: int = 0) -> None:
    """The handshake of profile position."""
    drives.write(j, CONTROL, ENABLE | bits)
    drives.period()
    assert not drives.read(j, STATUS) & BIT12, "set-point acknowledge before"
    drives.write(j, TARGET, target)
    drives.write(j, CONTROL, ENABLE | bits | 0x10)
    drives.period()
    assert drives.read(j, STATUS) & BIT12, "set-point acknowledge"
