"""The demo's motions of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.config_files import find_beside
from arm_emulator.base.number import Number
from arm_emulator.base.section import Section
from arm_emulator.base.yaml_file import read_yaml
from arm_emulator.machine.chain import Array
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene

NANOSECONDS = 1_000_000_000

_DISPLACEMENT = Number.within("displacement", "m", 100.0)
_SETTLE = Number("settle", "s", at_least=0.0, at_most=1000.0)
_SHOWN = Number.within("shown", "m", 100.0)
_INSTRUCTIONS = Number("instructions", at_least=1, at_most=1_000_000, whole=True)


@dataclass(frozen=True)
class DemoPlan:
    """A displacement of the tool, its start, and the time of observation.

    Attributes:
        shown: displacement that the tool is given after the observation, as long as that, so that
            the recording has a motion of the arm that can be seen; or None for no such motion.
    """

    displacement: NDArray[np.float64]  # m (3,), of the tool in the world
    settle_ns: int  # logical time before the target holds, a multiple of the motion period
    instructions: int
    shown: NDArray[np.float64] | None = None  # m (3,), of the tool in the world

    @classmethod
    def load(cls, scene: Path, period_ns: int) -> DemoPlan:
        """Read the plan that belongs to a scene file, for a motion period.

        Raises:
            Refusal: the plan is missing, or a value is refused.
        """
        file = find_beside(scene, "demo")
        section = Section(read_yaml(file), file.name)
        displacement = section.vector(_DISPLACEMENT)
        settle, instructions = section.number(_SETTLE), section.integer(_INSTRUCTIONS)
        shown = section.vector(_SHOWN)
        section.finish()
        if displacement is None:
            raise section.refusal("displacement", "be given", "nothing")
        periods = round(settle * NANOSECONDS / period_ns)
        return cls(
            np.array(displacement),
            periods * period_ns,
            instructions,
            None if shown is None else np.array(shown),
        )


HOLD = 1.0  # s, without power
RUN_UP = 5.0  # s, for a joint to reach its stop at full command


def report_safety(scene: Scene, q: Array) -> Iterator[str]:
    """Yield a line on the power cut at positions q (N,), and one on a stop, if there are any."""
    if any(joint.brake for joint in scene.joints):
        yield _power_cut(scene, q)
    for j, joint in enumerate(scene.joints):
        if joint.motor and joint.stops:
            yield _hit(scene, j, joint.stops[1])
            return


def _power_cut(scene: Scene, q: Array) -> str:
    plant, zero = Plant(scene), np.zeros(len(scene.joints))
    steps = round(HOLD / scene.integrator.dt)
    plant.reset(q)
    plant.powered = False
    plant.advance(zero, steps)
    # Restart with the gears wound up as they are after some time at rest here.
    wind_up = scene.wind_up(plant.state.gear_torque)
    ratio = scene.gear_ratios
    plant.powered = True
    plant.reset(q)
    elastic = np.array([joint.gear.stiffness is not None for joint in scene.joints])
    plant.put("demo", {"theta_m": np.where(elastic, q + wind_up, q) / ratio})
    plant.powered = False
    plant.advance(zero, steps)
    x = plant.state
    held = "stand still" if not x.omega_m.any() else "[red]turn[/red]"
    return (
        f"power cut                 links drop by {np.abs(x.q - q).max() * 1e3:.3f} mrad until the "
        f"brakes hold (wind-up {np.abs(wind_up).max() * 1e3:.3f} mrad); the rotors {held}"
    )


def _hit(scene: Scene, j: int, stop: float) -> str:
    plant, command = Plant(scene), np.zeros(len(scene.joints))
    command[j] = scene.largest_commands[j] * np.sign(scene.joints[j].gear.ratio)
    name, fastest, deepest, back = scene.joints[j].name, 0.0, 0.0, 0.0
    label = f"end stop of {name}"
    if not np.isfinite(command[j]):
        return f"{label}: not tried, the joint's command has no limit"
    try:
        for _ in range(round(RUN_UP / scene.servo_period)):
            plant.advance(command, scene.steps_per_period)
            x = plant.state
            depth, v = float(x.q[j]) - stop, float(x.v[j])
            if depth > 0.0:
                command[j] = 0.0
            elif deepest > 0.0:
                break
            fastest, deepest, back = max(fastest, v), max(deepest, depth), min(back, v)
    except Diverged as fault:
        return f"{label}: {fault}"
    if deepest <= 0.0:
        return f"{label}: not reached in {RUN_UP:g} s"
    return (
        f"{label}: hit at {fastest:.2f} rad/s, {deepest * 1e3:.0f} mrad deep, "
        f"thrown back at {-back:.2f} rad/s"
    )
