"""Machines that break integrators, each with a truth that must come out.

A scheme holds a case, or the plant detects that it does not: anything else is a failure. One truth
(free links in a spin) asks more than a scheme of first order or a very coarse step can give; there
"drifts" marks it.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.special import ellipk

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.analysis.reference import links_model, reference
from arm_emulator.base.config_files import config_folder
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES
from bench.absurd_inputs import absurd_inputs
from bench.hard_case import (
    EARTH,
    EVERYTHING,
    HELD,
    LINKS_ALONE,
    NO_INDUCTANCE,
    RIGID,
    SHARED,
    Case,
    Outcome,
    Rod,
    against,
    all_schemes,
    chain,
    diverged,
    of_one_case,
    of_order,
    sines,
    three_axis,
)
from bench.measure import side_by_side

TITLE = "Hard cases"


def undamped_stiff_gear(quick: bool) -> Iterator[Outcome]:
    """Gear of 1e7 N m/rad without damping: rings at 8 kHz, and may not be seen to."""
    period, rows = 1e-2, sines(3, 50, 1e-2)
    truth = reference(three_axis("paper", 1e-3, **RIGID), rows, period, 1e-7)  # to 1e-9 rad
    machine = {**SHARED, "joints.*.gear.stiffness": 1e7, "joints.*.gear.damping": 0.0}
    # Wind-up of T / Kg, twice when it rings: T = 25 N m. The scheme's own error is that of the
    # rigid machine: 0.45 dt, and 0.65 dt^2.
    wind_up, own = 5e-6, of_order(0.5, 1.0)
    yield from against(
        truth,
        rows,
        period,
        lambda scheme, dt: three_axis(scheme, dt, **machine),
        all_schemes(1e-2, 1e-3, 1e-4, 1e-5),
        lambda scheme, dt: wind_up + own(scheme, dt),
    )


def fast_current(quick: bool) -> Iterator[Outcome]:
    """L/R = 1e-7 s at steps of up to 1 ms."""
    period, rows = 1e-3, sines(3, 300, 1e-3)
    one = three_axis("paper", 1e-3, period, **NO_INDUCTANCE)
    truth = reference(one, rows, period, 1e-8)  # to 1e-10 rad
    machine = {**SHARED, "joints.*.motor.inductance": 1e-7}
    lag, own = 5e-7, of_order(3.0, 8.0)  # L/R at 3 rad/s; the errors without inductance
    yield from against(
        truth,
        rows,
        period,
        lambda scheme, dt: three_axis(scheme, dt, period, **machine),
        all_schemes(1e-3, 1e-4),
        lambda scheme, dt: lag + own(scheme, dt),
    )


def light_distal_link(quick: bool) -> Iterator[Outcome]:
    """A forearm of 1 g behind links of 10 and 6 kg, its gear as stiff as theirs."""
    period, rows = 1e-2, sines(3, 20, 1e-2)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = (config_folder() / "urdf" / "three_axis.urdf").read_text(encoding="utf-8")
        # The forearm weighs 3 kg; the same shape of 1 g.
        head, forearm, tail = urdf.partition('<link name="forearm">')
        for heavy, light in (
            ('mass value="3"', 'mass value="0.001"'),
            ("0.024375", "8.125e-6"),
            ("0.00375", "1.25e-6"),
        ):
            assert heavy in tail
            tail = tail.replace(heavy, light)
        (folder / "light.urdf").write_text(head + forearm + tail, encoding="utf-8")
        where: dict[str, Any] = {"urdf": str(folder / "light.urdf"), "name": "light_distal_link"}
        # Ten times as stiff as the others; at 1e-7 a step it is good to 1e-10 rad all the same.
        truth = reference(three_axis("paper", 1e-3, **where), rows, period, 1e-7)
        yield from against(
            truth,
            rows,
            period,
            lambda scheme, dt: three_axis(scheme, dt, **where),
            {
                scheme: (1e-3, 1e-4, 1e-6) if scheme == "paper" else (1e-2, 1e-3, 1e-4)
                for scheme in of_one_case(quick, "rosenbrock")
            },
            of_order(3.0, 10.0),
        )


SPIN = 100.0  # rad/s


def spin(quick: bool) -> Iterator[Outcome]:
    """The links alone thrown at 100 rad/s about the vertical: arms fly up and down for 60 s."""
    for scheme in of_one_case(quick, "rosenbrock"):
        for dt in (1e-3, 1e-4) if quick else (1e-3, 1e-4, 1e-5):
            plant = Plant(three_axis(scheme, dt, 1e-1, **LINKS_ALONE))
            model = links_model(plant.scene)
            data = model.createData()

            def momentum(plant: Plant = plant, model: Any = model, data: Any = data) -> float:
                """Angular momentum about the waist [kg m2/s]."""
                state = plant.state
                M = pin.crba(model, data, state.q)
                return float((np.triu(M) + np.triu(M, 1).T)[0] @ state.v)

            plant.reset(v=[SPIN, 0.0, 0.0])
            E, H = plant.energy, momentum()
            worst_E = worst_H = 0.0
            # 1e3 turns; of the first order, every turn of dt v = 0.01 rad per step costs.
            bound = 1e5 * dt**2 if KNOWN[scheme].order > 1 else 1e-2
            try:
                for _ in range(60 if quick else 600):
                    plant.advance(np.zeros(3), round(0.1 / dt))
                    worst_E = max(worst_E, abs(plant.energy / E - 1.0))
                    worst_H = max(worst_H, abs(momentum() / H - 1.0))
            except Diverged as fault:
                yield diverged(scheme, dt, bound, fault)
                continue
            note = f"energy {worst_E:.1e}, momentum {worst_H:.1e}"
            # 0.1 rad per step is not small any more, and nothing damps what it costs.
            may_drift = KNOWN[scheme].order == 1 or SPIN * dt >= 0.1
            yield Outcome(scheme, dt, max(worst_E, worst_H), bound, note, may_drift)


def double_pendulum(quick: bool) -> Iterator[Outcome]:
    """Two rods of 1 m, let go from the horizontal."""
    period, seconds = 0.05, 5.0 if quick else 20.0
    rows = np.zeros((round(seconds / period), 2))
    calm = round(2.0 / period)
    with tempfile.TemporaryDirectory() as name:
        rod = Rod(1.0, 1.0, 1.0 / 12.0)
        file = chain("double_pendulum", [rod, rod], Path(name), {}, gravity=EARTH)

        def scene(scheme: str, dt: float) -> Scene:
            own = {"integrator.scheme": scheme, "integrator.dt": dt, "servo_period": period}
            return load_scene(file, overrides=own)

        truth = reference(scene("paper", 1e-3), rows, period, rtol=1e-9, method="DOP853")
        for scheme in of_one_case(quick, "rosenbrock"):
            for dt in (1e-3, 1e-4, 1e-5):
                off = np.abs(Plant(scene(scheme, dt)).run(rows, round(period / dt)) - truth).max(1)
                away = np.flatnonzero(off > 0.1)
                note = (
                    f"leaves the truth by 0.1 rad at {period * (away[0] + 1):.3g} s"
                    if len(away)
                    else f"within 0.1 rad for {seconds:g} s"
                )
                bound = of_order(150.0 if scheme == "paper" else 20.0, 100.0)(scheme, dt)
                yield Outcome(scheme, dt, float(off[:calm].max()), bound, note)


def simple_pendulum(quick: bool) -> Iterator[Outcome]:
    """A point mass at 1 m, from rest at the horizontal: T = 4 K(1/2) sqrt(l / g) = 2.3678 s."""
    tiny = 1e-6  # kg m2, since a link needs some inertia
    period = 4.0 * float(ellipk(0.5)) * math.sqrt((1.0 + tiny) / 9.81)
    with tempfile.TemporaryDirectory() as name:
        bob = Rod(1.0, 1.0, tiny, center=1.0)
        file = chain("simple_pendulum", [bob], Path(name), {}, gravity=EARTH)
        for scheme in of_one_case(quick, "extrapolated"):
            for dt in (1e-2, 1e-3, 1e-4):
                own = {"integrator.scheme": scheme, "integrator.dt": dt, "servo_period": dt}
                plant = Plant(load_scene(file, overrides=own))
                q = plant.run(np.zeros((round(2.0 * period / dt), 1)), 1)[:, 0] - 0.5 * np.pi
                # Passes the lowest point upwards-bound once per period; its speed is even there.
                k = np.flatnonzero((q[:-1] < 0.0) & (q[1:] >= 0.0))
                passes = dt * (k + 1 - q[k] / (q[k + 1] - q[k]))
                measured = float(passes[1] - passes[0])
                bound = 10.0 * dt if scheme == "paper" else 10.0 * dt**2
                note = f"T = {measured:.6f} s"
                yield Outcome(scheme, dt, abs(measured - period), bound, note)


def fifty_links(quick: bool) -> Iterator[Outcome]:
    """A chain of 50 rods of 0.1 m about skew axes, let go from the horizontal."""
    period, rows = 0.02, np.zeros((25, 50))
    with tempfile.TemporaryDirectory() as name:
        rods = [Rod(0.1, 0.2, 2e-4, axis="0 1 0" if k % 2 else "0 0.6 0.8") for k in range(50)]
        file = chain("fifty_links", rods, Path(name), {}, gravity=EARTH)

        def scene(scheme: str, dt: float) -> Scene:
            own = {"integrator.scheme": scheme, "integrator.dt": dt, "servo_period": period}
            return load_scene(file, overrides=own)

        truth = reference(scene("paper", 1e-3), rows, period, rtol=1e-8, method="DOP853")
        yield from against(
            truth,
            rows,
            period,
            scene,
            {
                scheme: (1e-2, 1e-3, 1e-4) if scheme == "paper" else (1e-3, 1e-4)
                for scheme in of_one_case(quick, "extrapolated")
            },
            of_order(50.0, 500.0),
        )


def reversing(quick: bool) -> Iterator[Outcome]:
    """All of the supply, to and fro with every servo period of 1 ms."""
    period = 1e-3
    rows = np.where(np.arange(300) % 2, -1e3, 1e3)[:, None] * np.ones((1, 3))  # cut to 48 V
    truth = reference(three_axis("paper", 1e-3, period), rows, period, 1e-10)
    yield from against(
        truth,
        rows,
        period,
        lambda scheme, dt: three_axis(scheme, dt, period),
        all_schemes(1e-3, 1e-4, 1e-5),
        of_order(0.3, 4.0),
    )


def stick_slip(quick: bool) -> Iterator[Outcome]:
    """Joints held by friction against gravity and against wound-up gears: 100 s, and not a bit."""
    torque = 2.0 * 9.81 * 0.5
    with tempfile.TemporaryDirectory() as name:
        hanging = chain(
            "held_by_friction",
            [Rod(1.0, 2.0, 0.1)],
            Path(name),
            {"friction": {"viscous": 0.1, "coulomb": 0.5 * torque, "breakaway": 1.01 * torque}},
            gravity=EARTH,
        )
        for scheme in of_one_case(quick, "rosenbrock"):
            for dt in (1e-2, 1e-3):
                own = {"integrator.scheme": scheme, "integrator.dt": dt, "servo_period": dt}
                # The gear is wound up by the motor to Kt V / (R Ng) = 25 N m, and rings up to 50.
                friction = {"viscous": 0.5, "coulomb": 32.0, "breakaway": 51.2}
                pulled = three_axis(scheme, dt, dt, **SHARED, **{"joints.*.friction": friction})
                moved = 0.0
                for scene, volts in ((load_scene(hanging, overrides=own), 0.0), (pulled, 5.0)):
                    plant = Plant(scene)
                    plant.advance(np.full(len(scene.joints), volts), round(100.0 / dt))
                    moved = max(moved, float(np.abs(plant.state.q - scene.start).max()))
                yield Outcome(scheme, dt, moved, 0.0)


def everything_at_ten_milliseconds(quick: bool) -> Iterator[Outcome]:
    """All options of a scene at once, at steps of 10 ms."""
    period, rows = 1e-2, sines(3, 100, 1e-2, 30.0)
    steps = 2_000 if quick else 10_000
    # No reference knows dry friction: the finest rosenbrock stands in. Its own last step of
    # refinement changes 1e-5 rad.
    truth = Plant(three_axis("rosenbrock", period / steps, **EVERYTHING)).run(rows, steps)
    yield from against(
        truth,
        rows,
        period,
        lambda scheme, dt: three_axis(scheme, dt, **EVERYTHING),
        dict.fromkeys(of_one_case(quick, "rosenbrock"), (1e-2,)),
        lambda scheme, dt: 5e-2 if KNOWN[scheme].order == 1 else 2e-2,
    )


CASES = (
    Case(
        "undamped stiff gear",
        "Kg = 1e7 N m/rad, Dg = 0: the motion of a rigid gear, within the wind-up T / Kg",
        "error [rad]",
        undamped_stiff_gear,
    ),
    Case(
        "L/R = 1e-7 s",
        "the motion without inductance, within L/R times the speed",
        "error [rad]",
        fast_current,
    ),
    Case(
        "forearm of 1 g behind 16 kg",
        "the reference",
        "error [rad]",
        light_distal_link,
    ),
    Case(
        "100 rad/s spin, 60 s",
        "free links keep their energy and their angular momentum about the post",
        "largest relative drift of the two",
        spin,
    ),
    Case(
        "double pendulum",
        "the reference; chaos multiplies any error by ten within every 1.5 to 3 s",
        "error in the first 2 s [rad]",
        double_pendulum,
    ),
    Case(
        "simple pendulum",
        "T = 4 K(1/2) sqrt(l/g) = 2.3678 s from rest at the horizontal",
        "error of the period [s]",
        simple_pendulum,
    ),
    Case("50 links", "the reference", "error after 0.5 s at most [rad]", fifty_links),
    Case(
        "voltage reversing every servo period",
        "the reference under the supply's 48 V to and fro",
        "error [rad]",
        reversing,
    ),
    Case(
        "stick-slip",
        "under less than breakaway torque a joint stays at rest for 100 s, exactly",
        "moved [rad]",
        stick_slip,
    ),
    Case(
        "everything on at 10 ms",
        "the motion at 1 us",
        "error [rad]",
        everything_at_ten_milliseconds,
    ),
    Case(
        "absurd inputs",
        "1e300 V is the supply, 5e-324 V is nothing; NaN, infinity, 2^63 steps are refused",
        "breaches",
        absurd_inputs,
    ),
)


def run(quick: bool) -> dict[str, Any]:
    """Try every scheme on every case."""
    return {"cases": side_by_side("hard cases", _try, [(case, quick) for case in CASES])}


def _try(which: tuple[Case, bool]) -> dict[str, Any]:
    case, quick = which
    return {
        "name": case.name,
        "truth": case.truth,
        "measured": case.measured,
        "outcomes": [
            {**dataclasses.asdict(outcome), "verdict": outcome.verdict}
            for outcome in case.run(quick)
        ],
    }


def report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    lines = [
        "Each case has a truth that must come out within a bound (in brackets). `detected`: the "
        "plant found that the scheme does not hold, stopped at the last sound state, and reported "
        "which joint, when, and what would hold; it never goes on with numbers that mean nothing. "
        "`drifts`: a free motion that nothing damps, over so many turns that the scheme's error "
        "grows beyond the bound; where it makes energy of more than half of what there was, the "
        "plant stops. The arm is three_axis, where no other is named.",
        "",
    ]
    for case in figures["cases"]:
        steps = sorted({outcome["dt"] for outcome in case["outcomes"]}, reverse=True)
        lines += [
            f"**{case['name']}** - {case['truth']}. Shown: {case['measured']}.",
            "",
            "| | " + " | ".join(f"{dt:g} s" for dt in steps) + " |",
            "|---" * (len(steps) + 1) + "|",
        ]
        for scheme in SCHEMES:
            by_step = {o["dt"]: o for o in case["outcomes"] if o["scheme"] == scheme}
            if by_step:
                cells = " | ".join(_cell(by_step.get(dt)) for dt in steps)
                lines.append(f"| {scheme} | {cells} |")
        lines.append("")
    return "\n".join(lines)


def _cell(outcome: dict[str, Any] | None) -> str:
    if outcome is None:
        return ""
    note = f", {outcome['note']}" if outcome["note"] else ""
    if outcome["measured"] is None:
        return f"detected{note}"
    verdict = "" if outcome["verdict"] == HELD else f" {outcome['verdict']}"
    return f"{outcome['measured']:.1e} ({outcome['bound']:.0e}){verdict}{note}"
