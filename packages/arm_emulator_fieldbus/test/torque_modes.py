"""Behaviour of drives in their torque modes: joint after joint, from the scene's start."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from arm_emulator import Plant, Scene
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT

CYCLIC_POSITION, PROFILE_TORQUE, CYCLIC_TORQUE = 8, 4, 10
INTERNAL_LIMIT = 0x800
SETTLED, PERIODS = 100, 800  # of all joints in position; of the torque
STEP = 100  # 0.1 %
SLOPE = 4294967295  # as steep as a slope can be


@dataclass(frozen=True)
class TorqueRun:
    """Of one joint in a torque mode, per period."""

    torque: np.ndarray  # % of rated, that the drive reports
    current: np.ndarray  # % of rated, that flows
    limited: np.ndarray  # whether a limit was at work

    @property
    def free(self) -> np.ndarray:
        """The torques before any limit was at work."""
        return self.torque[np.cumsum(self.limited) == 0]


def enabled(scene: Scene, servo: ServoConfig, withheld: bool = False) -> Drives:
    """All drives in cyclic position, at rest; `withheld`: with the modes that they withhold."""
    drives = Drives(Plant(scene), servo, ETHERCAT)
    joints = range(len(scene.joints))
    for j in joints:
        if withheld:
            drives.set_entry(j, 0x6502, 0x3AD)
        drives.write(j, 0x6060, CYCLIC_POSITION)
        drives.write(j, 0x607A, drives.read(j, 0x6064))
    for word in (6, 7, 15):
        for j in joints:
            drives.write(j, 0x6040, word)
        drives.period()
    drives.period(SETTLED)
    assert all(drives.read(j, 0x6041) & 0x6F == 0x27 for j in joints), "operation enabled"
    return drives


def torque_run(
    scene: Scene, servo: ServoConfig, joint: int, mode: int, target: int, braked: bool = False
) -> TorqueRun:
    """Let one joint take a torque [0.1 %], the others held."""
    drives = enabled(scene, servo)
    if braked:
        drives.write(joint, 0x60FE, 1, 2)
        drives.write(joint, 0x60FE, 1, 1)
        drives.period(SETTLED)
        assert drives.plant.measured.brake_closed[joint], "the brake is closed"
    drives.write(joint, 0x6071, 0)
    drives.write(joint, 0x6087, SLOPE)
    drives.write(joint, 0x6060, mode)
    drives.period(5)
    assert drives.read(joint, 0x6061) == mode, "the mode that is shown"
    drives.write(joint, 0x6071, target)
    rated = drives.read(joint, 0x6075) / 1e3
    torque, current, limited = [], [], []
    for _ in range(PERIODS):
        drives.period()
        torque.append(drives.read(joint, 0x6077) / 10.0)
        current.append(100.0 * drives.plant.state.current[joint] / rated)
        limited.append(bool(drives.read(joint, 0x6041) & INTERNAL_LIMIT))
    return TorqueRun(np.array(torque), np.array(current), np.array(limited))


def swings(torque: np.ndarray) -> float:
    """Standard deviation of what changes from period to period, as a swing does and a fall not."""
    return float(np.diff(torque, 2).std()) if len(torque) > 2 else 0.0


def faults(scene: Scene, servo: ServoConfig) -> Iterator[str]:
    """Report of every joint in every torque mode that does not reach its commanded torque."""
    for j, joint in enumerate(scene.joints):
        for braked in (False, True)[: 1 + (joint.brake is not None)]:
            for mode in (CYCLIC_TORQUE, PROFILE_TORQUE):
                at = f"{scene.name}, {joint.name}, mode {mode}, brake closed {braked}"
                rest = torque_run(scene, servo, j, mode, 0, braked)
                flows = rest.current[: len(rest.free)]
                for quantity, values in (("reports", rest.free), ("flows", flows)):
                    if len(values) < 20 or values.std() > 1.0:
                        yield (
                            f"{at}: at 0 {quantity} {values.std():.3g} % over {len(values)} periods"
                        )
                # At a limit of the speed a count of the encoder is some torque.
                if swings(rest.torque) > 5.0:
                    yield f"{at}: at 0 swings by {swings(rest.torque):.3g} % at its limits"
                step = torque_run(scene, servo, j, mode, STEP, braked)
                size = STEP / 10.0
                if len(step.free) < 20 or step.free.max() > 1.1 * size:
                    yield f"{at}: a step of {size:g} % reaches {step.free.max(initial=0.0):.3g} %"
                late = step.free[10:]
                if len(late) and np.abs(late - size).max() > 0.1 * size:
                    yield f"{at}: after a step it is {late.min():.3g} to {late.max():.3g} %"
                for limit, values in ((1.0, late), (5.0, step.torque[10:])):
                    if swings(values) > limit:
                        yield f"{at}: after a step it swings by {swings(values):.3g} %"
