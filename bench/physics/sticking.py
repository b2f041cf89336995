"""Machines that stick: creep, error and stick-slip, beside MuJoCo, Drake and Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.measure import show_progress
from bench.physics.sticking_peers import (
    SAMPLE,
    Bar,
    Peer,
    make_drake_block,
    make_emulator,
    make_mujoco_bar,
    make_pinocchio_bar,
    predict_stick_slip,
    solve_swing,
)
from bench.pictures import make_figure, save_picture
from bench.tables import format_table

TITLE = "Machines that stick"
PICTURE = "sticking"

SWING, PULL = 5.0, 30.0  # s
DRAWS = 12
STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
EVENTS = {"located": "emulator, `located`", "step": "emulator, `step`"}
HARD = 'solimpfriction="0.9999 0.9999 0.001 0.5 2"'
HARD_AND_SHORT = f'{HARD} solreffriction="0.002 1"'
# Name, peer, seconds at rest: a creep that is constant shows in few of them.
HOLDS: tuple[tuple[str, Peer, float], ...] = (
    *((f"{name}, 1 ms", make_emulator(1e-3, events), 60.0) for events, name in EVENTS.items()),
    ("MuJoCo, as delivered, 2 ms", make_mujoco_bar(2e-3), 60.0),
    ("MuJoCo, as delivered, 0.1 ms", make_mujoco_bar(1e-4), 60.0),
    ("MuJoCo, RK4, 2 ms", make_mujoco_bar(2e-3, option='integrator="RK4"'), 60.0),
    ("MuJoCo, solimpfriction 0.9999, 2 ms", make_mujoco_bar(2e-3, HARD), 60.0),
    (
        "MuJoCo, and solreffriction 0.002, 0.1 ms",
        make_mujoco_bar(1e-4, HARD_AND_SHORT),
        60.0,
    ),
    (
        "MuJoCo, noslip_iterations 10, 2 ms",
        make_mujoco_bar(2e-3, option='noslip_iterations="10"'),
        60.0,
    ),
    ("Drake, TAMSI as delivered, 1 ms (block)", make_drake_block(1e-3, "Tamsi"), 60.0),
    ("Drake, Lagged, 1 ms (block)", make_drake_block(1e-3, "Lagged"), 60.0),
    (
        "Drake, Lagged, stiction 1e-6 m/s, 1 ms (block)",
        make_drake_block(1e-3, "Lagged", 1e-6),
        60.0,
    ),
    ("Pinocchio, tanh(v / 0.1 rad/s), 1 ms", make_pinocchio_bar(1e-3, 0.1), 4.0),
    ("Pinocchio, tanh(v / 0.001 rad/s), 0.01 ms", make_pinocchio_bar(1e-5, 1e-3), 1.0),
)
SWINGS: dict[str, Callable[[float], Peer]] = {
    EVENTS["located"]: lambda dt: make_emulator(dt, "located"),
    EVENTS["step"]: lambda dt: make_emulator(dt, "step"),
    "MuJoCo, as delivered": make_mujoco_bar,
    "MuJoCo, noslip_iterations 10": lambda dt: make_mujoco_bar(dt, option='noslip_iterations="10"'),
    "MuJoCo, solimpfriction 0.9999": lambda dt: make_mujoco_bar(dt, HARD),
    "MuJoCo, and solreffriction 0.002": lambda dt: make_mujoco_bar(dt, HARD_AND_SHORT),
}
PULLED = Bar(friction=2.0, breakaway=1.5, pull=(50.0, 0.05))
PULLS: dict[str, Peer] = {
    "emulator, `located`, 1 ms": make_emulator(1e-3, "located"),
    "emulator, `step`, 1 ms": make_emulator(1e-3, "step"),
    "Pinocchio, tanh(v / 0.01 rad/s), 1 ms": make_pinocchio_bar(1e-3, 1e-2, 0.1),
    "Pinocchio, tanh(v / 0.001 rad/s), 0.1 ms": make_pinocchio_bar(1e-4, 1e-3, 1e-2),
}


def run_bench(quick: bool) -> dict[str, Any]:
    """Let them rest, swing and be pulled."""
    draws = 2 if quick else DRAWS
    steps = STEPS[1:4] if quick else STEPS
    with show_progress("machines", len(HOLDS) + len(SWINGS) * len(steps) + len(PULLS)) as done:
        return {
            "hold": [
                _hold_bar(name, peer, 0.1 * t if quick else t, done) for name, peer, t in HOLDS
            ],
            "loads": _measure_largest_creep(20 if quick else 1000),
            "swing": _measure_swing(draws, steps, done),
            "pull": [_pull_bar(name, peer, done) for name, peer in PULLS.items()],
        }


def _hold_bar(name: str, peer: Peer, duration: float, done: Any) -> dict[str, Any]:
    ran = peer(Bar(), duration, 0.0)
    half = len(ran.q) // 2
    done(name)
    creep = abs(float(ran.q[-1] - ran.q[half])) / (SAMPLE * (len(ran.q) - 1 - half)) * 60.0
    return {"name": name, "creep": creep, "step": ran.step}


def _measure_largest_creep(count: int) -> dict[str, Any]:
    """Return the largest way of random bars under loads within their friction, in a minute."""
    rng = np.random.default_rng(9)
    bars = [
        Bar(mass=m, reach=r, friction=share * m * 9.81 * r)
        for m, r, share in rng.uniform((0.1, 0.05, 1.0001), (50.0, 1.0, 3.0), (count, 3)).tolist()
    ]
    moved = [float(np.abs(make_emulator(1e-3, "located")(bar, 60.0, 0.0).q).max()) for bar in bars]
    return {"count": count, "largest": max(moved)}


def _measure_swing(draws: int, steps: tuple[float, ...], done: Any) -> list[dict[str, Any]]:
    """Return the median over random bars of the largest error on the way."""
    rng = np.random.default_rng(10)
    bars = []
    for mass, reach, share in rng.uniform((1.0, 0.2, 0.05), (20.0, 0.8, 0.5), (draws, 3)).tolist():
        bars.append(Bar(mass=mass, reach=reach, friction=share * mass * 9.81 * reach))
    truths = [solve_swing(bar, SWING, 0.0) for bar in bars]
    rows = []
    for name, make in SWINGS.items():
        for dt in steps:
            runs = [make(dt)(bar, SWING, 0.0) for bar in bars]
            off = [float(np.abs(r.q - q).max()) for r, q in zip(runs, truths, strict=True)]
            times = [r.step for r in runs if r.step is not None]
            rows.append(
                {"name": name, "dt": dt, "error": float(np.median(off)), "worst": max(off),
                 "step": float(np.median(times))}
            )  # fmt: skip
            done(f"{name}, {dt:g} s")
    return rows


def _pull_bar(name: str, peer: Peer, done: Any) -> dict[str, Any]:
    assert PULLED.pull is not None
    q = peer(PULLED, PULL, 0.0).q
    spring = PULLED.pull[1] * SAMPLE * np.arange(1, len(q) + 1) - q
    settled = spring[len(spring) // 3 :]
    middle = 0.5 * (settled.max() + settled.min())
    falls = np.flatnonzero((settled[:-1] > middle) & (settled[1:] <= middle))
    done(name)
    period = float(np.diff(falls).mean() * SAMPLE) if len(falls) > 1 else None
    swing = float(np.ptp(settled)) if period else 0.0
    return {"name": name, "period": period, "swing": swing, "spring": spring[-600:].tolist()}


def write_report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    period, swing = predict_stick_slip(PULLED)
    rest = [
        (row["name"], f"{row['creep']:.1e}" if row["creep"] else "0",
         "" if row["step"] is None else f"{row['step']:.0f}")
        for row in figures["hold"]
    ]  # fmt: skip
    moving = [
        (row["name"], f"{1e3 * row['dt']:g}", f"{row['error']:.1e}", f"{row['worst']:.1e}",
         f"{row['step'] / row['dt'] * 1e-3:.0f}")
        for row in figures["swing"]
    ]  # fmt: skip
    cycles = [
        (row["name"], *(f"{row[key]:.4f}" if row["period"] else "none"
                        for key in ("period", "swing")))
        for row in figures["pull"]
    ]  # fmt: skip
    loads = figures["loads"]
    return f"""\
A bar of 4 kg on a hinge, 0.5 m to its centre, is held horizontally by dry friction of twice its
weight's torque. Drake has no dry friction in joints: there a block of 4 kg rests on a slope, in
contact of twice the friction that it needs, and the creep is in m. Pinocchio has none either: its
rows are ABA under a smooth law in a loop of Python, whose time is not stated.

{format_table(("at rest", "creep [rad/min, m/min]", "step [ns]"), rest)}

{loads["count"]} random bars of the emulator under loads up to 99.99 % of their friction, a minute
each: they moved by {loads["largest"]:g} rad.

Random bars with friction of 5 to 50 % of their weight swing for {SWING:g} s and stop. The error is
the largest on the way against a solution that is cut at every stop (SciPy, 1e-12): median and
largest of the bars. `located` keeps order 2. Steps of MuJoCo are its own kinematics, constraint and
solver, which serve many more machines than this one.

{format_table(("swinging", "step [ms]", "median error [rad]", "largest", "µs per s"), moving)}

The bar, without gravity, is pulled at 0.05 rad/s through a spring of 50 N m/rad, with 2 N m of
sliding friction and 3 N m to break away. In closed form it sticks and slips with a period of
{period:.4f} s, and the spring swings by {swing:.4f} rad. MuJoCo's joints and Drake's contact in
discrete time have one coefficient: they slide evenly.

![Error over time of computation, and the spring of the bar that is pulled]({PICTURE}.png)

{format_table(("pulled", "period [s]", "swing [rad]"), cycles)}"""


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw errors over the time of computation, and the spring of the bar that is pulled."""
    figure = make_figure(9.0, 3.4)
    left, right = figure.subplots(1, 2)
    for name in SWINGS:
        rows = [row for row in figures["swing"] if row["name"] == name]
        cost = [1e-6 * row["step"] / row["dt"] for row in rows]
        left.loglog(cost, [row["error"] for row in rows], "o-", label=name.replace("`", ""))
    left.set_xlabel("time of computation [ms per s]")
    left.set_ylabel("largest error on the way [rad]")
    left.legend(fontsize=7, loc="lower right")
    for row in figures["pull"]:
        t = SAMPLE * np.arange(len(row["spring"]))
        right.plot(t, row["spring"], label=row["name"].replace("`", ""))
    right.set_xlabel("t [s]")
    right.set_ylabel("twist of the spring [rad]")
    right.set_ylim(bottom=-0.01)
    right.legend(fontsize=7, loc="lower left")
    save_picture(figure, folder, PICTURE)
