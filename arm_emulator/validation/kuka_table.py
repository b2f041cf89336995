"""Tables of the KUKA KR300 beside its measured runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from arm_emulator.machine.scene import load_scene
from arm_emulator.validation.figure import table_of
from arm_emulator.validation.kuka_kr300 import SHIPPED, compare
from arm_emulator.validation.kuka_picture import draw

WIDTH = 150  # characters of the tables


def validate_kuka(runs: Sequence[Path], folder: Path, console: Console) -> dict[str, Any]:
    """Compare with runs, print, draw into a folder, and return the same for programs.

    Args:
        runs: files as run_A.npz; none: the shipped ones.
        folder: of the pictures.
        console: for the tables.

    Raises:
        Refusal: a file is not such a run.
    """
    scene = load_scene("kuka_kr300")
    paths = list(runs) or list(SHIPPED)
    found = [
        compare(path, scene) for path in track(paths, "kuka_kr300", console=Console(stderr=True))
    ]
    compared = []
    for one in found:
        title = f"KUKA KR300, identified on run A, beside {one.run.where}"
        console.print(table_of(title, scene.joint_names, one.figures))
        picture = folder / f"kuka_kr300_{Path(one.run.where).stem}.png"
        draw(one, scene.joint_names, picture)
        for failure in one.failures:
            console.print(f"[red]{failure}")
        console.print(f"{one.run.where}: {'good' if one.good else 'NOT GOOD'}; picture: {picture}")
        figures = [
            {"title": f.title, "values": f.values, "mean": f.mean, "limits": f.limits}
            for f in one.figures
        ]
        compared.append(
            {
                "record": one.run.where,
                "good": one.good,
                "failures": one.failures,
                "figures": figures,
                "picture": picture,
            }
        )
    return {"good": all(one.good for one in found), "runs": compared}
