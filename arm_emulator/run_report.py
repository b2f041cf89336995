"""What `arm_emulator run` asks and prints, whoever gave the targets."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from emulator_node.scene import Scene
from emulator_node.session import END_OF_TIME, Session
from words.refusal import Refusal


def ticks_of(seconds: float, scene: Scene) -> int:
    """Return how many servo periods a time is.

    Raises:
        Refusal: less than one, or more than logical time has.
    """
    period, latest = scene.servo_period, END_OF_TIME / 1e9
    if not (math.isfinite(seconds) and round(seconds / period) >= 1):
        rule = f"be at least the servo period, {period:g} s"
        raise Refusal("run", "seconds", rule, f"{seconds:g}")
    if seconds >= latest:
        raise Refusal("run", "seconds", f"be less than {latest:g} s", f"{seconds:g}")
    return round(seconds / period)


def tell(session: Session, ticks: int, wall: float, off: npt.NDArray[np.float64] | None) -> None:
    """Print the outcome of a run.

    Args:
        session: the machine.
        ticks: servo periods that it has gone through.
        wall: time that they took [s].
        off: what the tool lacks to its target, in the world (3,) [m]; None: no target is known.
    """
    logical = session.logical_ns / 1e9
    print(f"scene {session.scene.name}: {logical:g} s of logical time in {wall:.2f} s")
    print(
        f"real-time factor  {logical / wall:.1f}   ({wall / ticks * 1e6:.1f} us per servo period)"
    )
    if off is not None:
        x, y, z = off * 1e3
        print(f"tool off by       x {x:+.4f}  y {y:+.4f}  z {z:+.4f} mm")
    print(f"energy            {session.plant.energy:.6g} J")
