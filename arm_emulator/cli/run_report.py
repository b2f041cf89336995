"""Common to commands that run a machine: duration, Ctrl-C, the outcome."""

import contextlib
import math
import signal
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.output import output
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.session.session import END_OF_TIME, Session
from arm_emulator.toolchain.flags import ARITHMETIC


@contextlib.contextmanager
def end_at_ctrl_c() -> Iterator[None]:
    """In this block Ctrl-C needs no Python: hanging control code ends, and gdb gets it."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def count_ticks(seconds: float, scene: Scene) -> int:
    """Return a time as a number of servo periods.

    Raises:
        Refusal: less than one, or beyond the range of logical time.
    """
    period, latest = scene.servo_period, END_OF_TIME / 1e9
    if not (math.isfinite(seconds) and round(seconds / period) >= 1):
        rule = f"be at least the servo period, {period:g} s"
        raise Refusal("run", "seconds", rule, f"{seconds:g}")
    if seconds >= latest:
        raise Refusal("run", "seconds", f"be less than {latest:g} s", f"{seconds:g}")
    return round(seconds / period)


def report_run(
    session: Session,
    ticks: int,
    wall: float,
    off: npt.NDArray[np.float64] | None,
) -> None:
    """Print the outcome of a run.

    Args:
        session: the machine.
        ticks: servo periods of the run.
        wall: their wall time [s].
        off: target minus tool, in the world (3,) [m]; None: no target.
    """
    scene, logical, energy = session.scene, session.logical_ns / 1e9, session.plant.energy
    output.print_line(f"scene {scene.name}: {logical:g} s of logical time in {wall:.2f} s")
    output.print_line(
        f"real-time factor  {logical / wall:.1f}   ({wall / ticks * 1e6:.1f} us per servo period)"
    )
    if off is not None:
        x, y, z = off * 1e3
        output.print_line(f"tool off by       x {x:+.4f}  y {y:+.4f}  z {z:+.4f} mm")
    output.print_line(f"energy            {energy:.6g} J")
    output.add_facts(
        {
            "scene": scene.name,
            "arithmetic": ARITHMETIC,
            "logical_time": logical,
            "wall_time": wall,
            "ticks": ticks,
            "tool_off": off,
            "energy": energy,
            "q": dict(zip(scene.joint_names, session.state.q, strict=True)),
            "diverged": None,
        }
    )
