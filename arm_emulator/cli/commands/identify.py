"""Identify a scene's numbers from measured motion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, SceneName

Names = Annotated[str, Parameter(metavar="NAMES")]


@command()
def identify(
    scene: SceneName,
    data: Path,
    /,
    *,
    fit: Names = "*",
    hold: Names = "",
    out: Annotated[Path, Parameter(metavar="SCENE")] = Path("fitted.yaml"),
    angles: Literal["rad", "deg"] = "rad",
    side: Literal["link", "motor"] = "link",
    delay: Annotated[list[str] | None, Parameter(metavar="SIGNAL=S ...")] = None,
    low_pass: Annotated[float, Parameter(metavar="HZ")] = 10.0,
    trust: float = 0.5,
    as_is: bool = False,
    simulate: bool = False,
    json: Json = False,
) -> int:
    """Find a scene's numbers from a record of its machine's motion.

    Args:
        scene: scene file or name: the nominal machine.
        data: record: .npz, .csv, or a bag's folder.
        fit: numbers to identify, separated by commas.
        hold: numbers to keep, separated by commas.
        out: the scene to write.
        angles: unit in the data.
        side: of the gear on which motor angles are measured.
        delay: delays of tau or q_link.
        low_pass: cut-off frequency.
        trust: relative accuracy of the scene's inertias and springs.
        as_is: skip the check of axes, signs and units.
        simulate: second stage: fit simulated free runs (compiles).
    """
    from arm_emulator.cli.identify import identify as find

    return find(
        scene,
        data,
        [one for one in fit.split(",") if one],
        [one for one in hold.split(",") if one],
        out,
        angles=angles,
        side=side,
        delays=delay or (),
        low_pass=low_pass,
        trust=trust,
        as_is=as_is,
        simulate=simulate,
        json=json,
    )
