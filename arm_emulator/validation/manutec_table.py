"""The table of the Manutec r3 beside the independent solution."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from arm_emulator.validation import manutec_r3
from arm_emulator.validation.manutec_r3 import AXES, Comparison, Motion, solution

WIDTH = 110  # characters of the table
PERIODS = (2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)  # s, servo period and step
SHOWN = 5e-5  # s, of which angles and currents are drawn


# Limits at the drawn period; the solution itself is accurate to 5e-9 rad.
MOST = {"q": 1e-6, "v": 1e-3, "current": 5e-3, "wind_up": 5e-5}
MOST_OTHER_MODES = 0.01  # of the rows: the solution has two at each instant of change
ORDER = (1.8, 2.2)  # of the angles' error, over the periods from 50 to 5 us
LEAST_SPEED = 1.0  # times real time


def validate_manutec(folder: Path, console: Console) -> dict[str, Any]:
    """Compare, print, draw into a folder, and return the same for programs."""
    table = Table(title="Manutec r3 against the independent solution, largest differences")
    for heading in ("period, us", "angles, rad", "speeds, rad/s", "currents, A",
                    "wind-up at the motor, rad", "rows in other friction modes",
                    "times real time"):  # fmt: skip
        table.add_column(heading, justify="right")
    found: dict[float, tuple[manutec_r3.Comparison, float]] = {}
    shown = None
    for period in track(PERIODS, "manutec_r3", console=Console(stderr=True)):
        motion = min((manutec_r3.simulate(period) for _ in range(3)), key=lambda one: one.seconds)
        one, speed = manutec_r3.compare(motion), manutec_r3.END / motion.seconds
        found[period] = one, speed
        if period == SHOWN:
            shown = motion
        table.add_row(
            f"{1e6 * period:g}", f"{one.q.max():.2g}", f"{one.v.max():.2g}",
            f"{one.current.max():.2g}", f"{one.wind_up.max():.2g}",
            f"{one.other_modes} of {one.rows}", f"{speed:.0f}",
        )  # fmt: skip
    console.print(table)
    assert shown is not None
    picture = folder / "manutec_r3.png"
    draw(shown, [(period, one) for period, (one, _) in found.items()], picture)
    failures = list(manutec_failures(found))
    for failure in failures:
        console.print(f"[red]{failure}")
    order = order_of(found)
    verdict = "NOT GOOD" if failures else "good"
    console.print(f"order of the angles' error {order:.2f}; {verdict}; picture: {picture}")
    rows = [
        {
            "period": period,
            **{name: float(getattr(one, name).max()) for name in MOST},
            "other_modes": one.other_modes,
            "rows": one.rows,
            "speed": speed,
        }
        for period, (one, speed) in found.items()
    ]
    return {
        "good": not failures,
        "failures": failures,
        "order": order,
        "rows": rows,
        "pictures": [picture],
    }


def order_of(found: Mapping[float, tuple[manutec_r3.Comparison, float]]) -> float:
    """Return the slope of the angles' error over the period, both as logarithms."""
    periods = [period for period in found if 5e-6 <= period <= SHOWN]
    errors = [found[period][0].q.max() for period in periods]
    return float(np.polyfit(np.log(periods), np.log(errors), 1)[0])


def manutec_failures(
    found: Mapping[float, tuple[manutec_r3.Comparison, float]],
) -> Iterator[str]:
    """Yield each exceeded limit, as a line: figures at `SHOWN`, order, and modes."""
    at, speed = found[SHOWN]
    where = f"at {1e6 * SHOWN:g} us"
    for name, most in MOST.items():
        value = float(getattr(at, name).max())
        if not value <= most:
            yield f"{where}: {name} must be within {most:g}, got {value:.3g}"
    if not speed >= LEAST_SPEED:
        yield f"{where}: speed must be >= {LEAST_SPEED:g} times real time, got {speed:.3g}"
    for period, (one, _) in found.items():
        if not one.other_modes <= MOST_OTHER_MODES * one.rows:
            yield (
                f"at {1e6 * period:g} us: rows in other friction modes must be <= "
                f"{MOST_OTHER_MODES:.0%}, got {one.other_modes} of {one.rows}"
            )
    order = order_of(found)
    if not ORDER[0] <= order <= ORDER[1]:
        yield f"order of the angles' error must be {ORDER[0]:g} to {ORDER[1]:g}, got {order:.2f}"


def draw(motion: Motion, by_period: Sequence[tuple[float, Comparison]], file: Path) -> None:
    """Draw angles, currents, friction modes, and the error over the period."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    truth, modes, _, _ = solution()
    figure, ((angles, currents), (sticking, errors)) = plt.subplots(
        2, 2, figsize=(12, 7.5), layout="constrained"
    )
    for j in range(AXES):
        colour = f"C{j}"
        for axes, name in ((angles, "q"), (currents, "current")):
            values = getattr(motion, name)[:, j]
            axes.plot(motion.t, values, color=colour, label=f"axis {j + 1}")
            axes.plot(truth.t[::60], getattr(truth, name)[::60, j], ".", color=colour, ms=4)
        lift = 2.5 * j
        sticking.plot(motion.t, motion.friction_mode[:, j] + lift, color=colour, lw=1)
        sticking.plot(truth.t[::20], modes[::20, j] + lift, ".", color=colour, ms=3)
    angles.set(title="link angles (points: the solution)", xlabel="s", ylabel="rad")
    angles.legend(loc="upper right", fontsize="small", ncols=2)  # "best" is slow
    currents.set(title="motor currents", xlabel="s", ylabel="A")
    sticking.set(title="slides back, sticks, slides on", xlabel="s")
    sticking.set(yticks=2.5 * np.arange(AXES), yticklabels=[f"axis {j + 1}" for j in range(AXES)])
    period = np.array([one for one, _ in by_period])
    off = np.array([[c.q.max(), c.current.max()] for _, c in by_period])
    errors.loglog(1e6 * period, off[:, 0], "o-", label="angles, rad")
    errors.loglog(1e6 * period, off[:, 1], "s-", label="currents, A")
    errors.loglog(1e6 * period, off[-1, 0] * (period / period[-1]) ** 2, "k:", label="order 2")
    errors.set(title="largest difference", xlabel="servo period = step, us")
    errors.legend(loc="lower right", fontsize="small")
    for axes in (angles, currents, sticking, errors):
        axes.grid(alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    plt.close(figure)
