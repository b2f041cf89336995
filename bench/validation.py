"""Real machines, computed again: what `python -m arm_emulator validate` prints, in a report."""

from __future__ import annotations

from typing import Any

import numpy as np

from arm_emulator.validation import manutec_r3
from arm_emulator.validation.kuka_kr300 import SHIPPED, compare
from bench.measure import progress

TITLE = "Real machines"
PERIODS = (2e-4, 5e-5, 1e-5)  # s, servo period and step of the Manutec r3


def run(quick: bool) -> dict[str, Any]:
    """Compare the Manutec r3 with its solution, and the KUKA KR300 with its measured runs."""
    periods = PERIODS[:2] if quick else PERIODS
    figures: dict[str, Any] = {"manutec_r3": [], "kuka_kr300": []}
    with progress("validation", len(periods) + len(SHIPPED)) as done:
        for period in periods:
            motion = min((manutec_r3.simulate(period) for _ in range(3)), key=lambda m: m.seconds)
            one = manutec_r3.compare(motion)
            figures["manutec_r3"].append({
                "period": period, "angles": float(one.q.max()),
                "currents": float(one.current.max()),
                "times_real_time": manutec_r3.END / motion.seconds,
            })  # fmt: skip
            done("manutec_r3")
        for path in SHIPPED:
            found = compare(path)
            figures["kuka_kr300"].append({
                "run": path.stem, "good": found.good,
                "figures": [
                    {"title": one.title, "form": one.form, "values": one.values.tolist()}
                    for one in found.figures
                ],
            })  # fmt: skip
            done(path.stem)
    return figures


def report(figures: dict[str, Any]) -> str:
    """Return the section."""
    lines = [
        "Manutec r3, against an independent solution ([validation](../validation.md)):\n",
        "| period, us | angles, rad | currents, A | times real time |", "|---|---|---|---|",
    ]  # fmt: skip
    for one in figures["manutec_r3"]:
        lines.append(
            f"| {1e6 * one['period']:g} | {one['angles']:.2g} | {one['currents']:.2g} | "
            f"{one['times_real_time']:.0f} |"
        )
    names = " | ".join(f"axis {j}" for j in range(1, 7))
    lines += ["\nKUKA KR300, identified on run A, against measured runs:\n",
              f"| | {names} | mean |", "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for one in figures["kuka_kr300"]:
        for row in one["figures"]:
            known = [value for value in row["values"] if np.isfinite(value)]
            cells = [
                format(value, row["form"]) if np.isfinite(value) else ""
                for value in (*row["values"], float(np.mean(known)))
            ]
            lines.append(f"| {one['run']}: {row['title'].strip()} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
