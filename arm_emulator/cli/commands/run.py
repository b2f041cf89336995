"""Run machine, servo and motion controller without a network, as fast as possible."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.kept import NOTHING
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, Keep, SceneName, Seconds, TargetFile


@command()
def run(
    scene: SceneName = "three_axis",
    /,
    *,
    seconds: Seconds = None,
    displacement: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None,
    targets: TargetFile = None,
    servo: Annotated[Path | None, Parameter(metavar="LIBRARY")] = None,
    kept: Keep = NOTHING,
    json: Json = False,
) -> int:
    """Run machine, servo and motion controller in one process, in lock-step.

    Args:
        displacement: displacement of the tool from its start (m, in the world; default: none).
        targets: joint targets instead of the motion controller: CSV with t and the joints' names.
        servo: control code in C instead of our servo; with --targets.
    """
    kept.check("run")
    if targets is not None:
        if displacement is not None:
            raise Refusal("run", "--displacement", "stand without --targets", "both")
        from arm_emulator.cli.run import run_table

        return run_table(scene, seconds, targets, servo, kept, json=json)
    if servo is not None:
        raise Refusal("run", "--servo", "come with --targets, a table of joint targets", "none")
    from arm_emulator.cli.run import run as work

    return work(scene, 10.0 if seconds is None else seconds, displacement, kept, json=json)
