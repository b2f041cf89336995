"""Tables of the KUKA KR300 beside its measured runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import track

from arm_emulator.machine.scene import load_scene
from arm_emulator.validation.figure import table_of
from arm_emulator.validation.kuka_kr300 import SHIPPED, compare
from arm_emulator.validation.kuka_picture import draw


def validate_kuka(runs: Sequence[Path], folder: Path) -> int:
    """Compare with runs, print, draw into a folder; exit code 1 if a figure is beyond its limit.

    Args:
        runs: files as run_A.npz; none: the shipped ones.
        folder: of the pictures.

    Raises:
        Refusal: a file that is no such run.
    """
    scene = load_scene("kuka_kr300")
    paths = list(runs) or list(SHIPPED)
    found = [
        compare(path, scene) for path in track(paths, "kuka_kr300", console=Console(stderr=True))
    ]
    console = Console(width=max(150, Console().width))
    for one in found:
        title = f"KUKA KR300, identified on run A, beside {one.run.where}"
        console.print(table_of(title, scene.joint_names, one.figures))
        picture = folder / f"kuka_kr300_{Path(one.run.where).stem}.png"
        draw(one, scene.joint_names, picture)
        for failure in one.failures:
            console.print(f"[red]{failure}")
        console.print(f"{one.run.where}: {'good' if one.good else 'NOT GOOD'}; picture: {picture}")
    return 0 if all(one.good for one in found) else 1
