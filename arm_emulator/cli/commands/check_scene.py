"""Check scene files, and that servo and motion control fit them."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, SceneName


@command()
def check_scenes(
    scene: SceneName,
    /,
    *more: Annotated[str, Parameter(metavar="SCENE", help="further ones")],
    modes: bool = False,
    json: Json = False,
) -> int:
    """Check scene files, and the servo and motion parameters that lie beside them.

    Args:
        modes: show the eigenvalues of every loop that the modes of the scene's drives select.
    """
    from arm_emulator.cli.check_scene import check_scenes as check

    return check((scene, *more), modes=modes, json=json)
