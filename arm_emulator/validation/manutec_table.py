"""The table of the Manutec r3 beside the independent solution."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import track
from rich.table import Table

from arm_emulator.validation import manutec_r3
from arm_emulator.validation.manutec_picture import draw

PERIODS = (2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)  # s, servo period and step
SHOWN = 5e-5  # s, of which angles and currents are drawn


def validate_manutec(folder: Path) -> int:
    """Compare, print, draw into a folder; exit code 1 if angles are not within 1e-5 rad."""
    console = Console(width=max(110, Console().width))
    table = Table(title="Manutec r3 against the independent solution, largest differences")
    for heading in ("period, us", "angles, rad", "speeds, rad/s", "currents, A",
                    "wind-up at the motor, rad", "rows in other friction modes",
                    "times real time"):  # fmt: skip
        table.add_column(heading, justify="right")
    found, shown = [], None
    for period in track(PERIODS, "manutec_r3", console=Console(stderr=True)):
        motion = min((manutec_r3.simulate(period) for _ in range(3)), key=lambda one: one.seconds)
        one = manutec_r3.compare(motion)
        found.append((period, one))
        if period == SHOWN:
            shown = motion
        table.add_row(
            f"{1e6 * period:g}", f"{one.q.max():.2g}", f"{one.v.max():.2g}",
            f"{one.current.max():.2g}", f"{one.wind_up.max():.2g}",
            f"{one.other_modes} of {one.rows}", f"{manutec_r3.END / motion.seconds:.0f}",
        )  # fmt: skip
    console.print(table)
    assert shown is not None
    picture = folder / "manutec_r3.png"
    draw(shown, found, picture)
    console.print(f"picture: {picture}")
    at = dict(found)[SHOWN]
    return 0 if at.q.max() < 1e-5 else 1
