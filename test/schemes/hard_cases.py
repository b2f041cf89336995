"""Machines that break integrators, each with a truth that must come out within a bound.

A scheme holds a case, or the plant detects that it does not: anything else is a failure. One truth
(free links in a spin) asks more than a scheme of first order or a very coarse step can give; there
"drifts" marks it.
"""

import dataclasses
import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from arm_emulator import Diverged, Plant, Refusal, Scene, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_config_folder
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES
from oracles.reference import make_links_model, solve_positions

HELD, DRIFTS, DETECTED, FAILED = "held", "drifts", "detected", "FAILED"


EARTH = [0.0, 0.0, -9.81]  # m/s2


@dataclass(frozen=True)
class Outcome:
    """The result of one scheme on a case at one step."""

    scheme: str
    dt: float  # s
    measured: float | None  # None: the plant diverged, and reported it
    bound: float
    may_drift: bool = False  # whether to miss the bound is no failure

    @property
    def verdict(self) -> str:
        """Return whether the truth came out."""
        if self.measured is None:
            return DETECTED
        if self.measured <= self.bound:
            return HELD
        return DRIFTS if self.may_drift and math.isfinite(self.measured) else FAILED


def three_axis(scheme: str, dt: float, period: float = 1e-2, **overrides: Any) -> Scene:
    """Return the paper's arm with another integrator."""
    own = {"integrator.scheme": scheme, "integrator.dt": dt, "servo_period": period}
    return load_scene("three_axis", overrides={**own, **overrides})


RIGID: dict[str, Any] = {"joints.*.gear.stiffness": None, "joints.*.gear.damping": None}


NO_INDUCTANCE: dict[str, Any] = {"joints.*.motor.inductance": None}


# Machines that differ in these numbers share a library.
SHARED: dict[str, Any] = {"varied": ["joints.*"]}


# All options of a scene at once, dry friction and current limits too.
EVERYTHING: dict[str, Any] = {
    **SHARED,
    "gravity": EARTH,
    "payload": {"mass": 1.0, "com": [0.0, 0.02, 0.05]},
    "joints.*.motor.current_limit": 8.0,
    "joints.*.friction": {"viscous": 0.5, "coulomb": 3.0, "breakaway": 4.0},
}


LINKS_ALONE: dict[str, Any] = {
    f"joints.*.{part}": None for part in ("motor", "gear", "encoder", "friction")
}


@dataclass(frozen=True)
class Rod:
    """A link that turns about `axis`, its centre of mass halfway along x."""

    length: float  # m
    mass: float  # kg
    inertia: float  # kg m2, about the centre of mass, across the rod
    axis: str = "0 1 0"


def chain(name: str, rods: list[Rod], folder: Path, joint: dict[str, Any], **keys: Any) -> Path:
    """Write a scene of rods one behind the other, all with the same kind of joint."""
    urdf, parent, x = f'<robot name="{name}"><link name="base"/>', "base", 0.0
    for k, rod in enumerate(rods):
        thin = 1e-3 * rod.inertia if rod.inertia > 1e-5 else rod.inertia
        urdf += f"""
          <joint name="joint_{k}" type="continuous">
            <origin xyz="{x} 0 0"/><parent link="{parent}"/><child link="rod_{k}"/>
            <axis xyz="{rod.axis}"/>
          </joint>
          <link name="rod_{k}"><inertial>
            <origin xyz="{0.5 * rod.length} 0 0"/><mass value="{rod.mass}"/>
            <inertia ixx="{thin}" iyy="{rod.inertia}" izz="{rod.inertia}" ixy="0" ixz="0" iyz="0"/>
          </inertial></link>"""
        parent, x = f"rod_{k}", rod.length
    (folder / f"{name}.urdf").write_text(urdf + "</robot>", encoding="utf-8")
    scene = {
        "name": name,
        "urdf": f"{name}.urdf",
        "tool": parent,
        "supply_voltage": 48.0,
        "joints": {f"joint_{k}": joint for k in range(len(rods))},
        "integrator": {"dt": 1e-3},
        "servo_period": 1e-3,
        **keys,
    }
    file = folder / f"{name}.yaml"
    file.write_text(yaml.safe_dump(scene), encoding="utf-8")
    return file


def sines(joints: int, rows: int, period: float, amplitude: float = 12.0) -> Array:
    """Return voltages (rows, joints) [V] that start with a jump, each held over one period."""
    t, j = period * np.arange(rows)[:, None], np.arange(joints)
    out: Array = amplitude * np.sin(2.0 * np.pi * (0.5 + 0.3 * j) * t + 0.5 + j)
    return out


def against(
    truth: Array,
    voltages: Array,
    period: float,
    scene: Callable[[str, float], Scene],
    steps: dict[str, tuple[float, ...]],
    bound: Callable[[str, float], float],
) -> Iterator[Outcome]:
    """Compare motions with the truth (K, N), the largest difference on the way."""
    for scheme, dts in steps.items():
        for dt in dts:
            plant = Plant(scene(scheme, dt))
            try:
                q = plant.run(voltages, round(period / dt))
            except Diverged:
                yield Outcome(scheme, dt, None, bound(scheme, dt))
                continue
            yield Outcome(scheme, dt, float(np.abs(q - truth).max()), bound(scheme, dt))


def of_order(first: float, second: float) -> Callable[[str, float], float]:
    """Return the bound `first` dt for schemes of order 1, `second` dt^2 for those of higher order.

    Where the links alone count, one evaluation of them per step has the error constant of the
    Adams-Bashforth method, 5/12. Two evaluations have that of a Runge-Kutta method, 1/6: 2.5 times
    less.
    """

    def bound(scheme: str, dt: float) -> float:
        scheme_data = KNOWN[scheme]
        error = (
            first
            if scheme_data.order == 1
            else second * (1.0 if scheme_data.evaluations > 1 else 2.5)
        )
        return error * dt ** min(scheme_data.order, 2)

    return bound


def all_schemes(*dts: float) -> dict[str, tuple[float, ...]]:
    """Try all schemes at the same steps."""
    return dict.fromkeys(SCHEMES, dts)


def choose_schemes(quick: bool, case: str) -> tuple[str, ...]:
    """Return the schemes to try on a machine of one case alone.

    A compiler takes longer over each of them than the case itself, so in quick runs it is `case`.
    """
    return (case,) if quick else SCHEMES


def undamped_stiff_gear(quick: bool) -> Iterator[Outcome]:
    """Gear of 1e7 N m/rad without damping: rings at 8 kHz, and may not be seen to."""
    period, rows = 1e-2, sines(3, 50, 1e-2)
    truth = solve_positions(three_axis("paper", 1e-3, **RIGID), rows, period, 1e-7)  # to 1e-9 rad
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
    arm_case = three_axis("paper", 1e-3, period, **NO_INDUCTANCE)
    truth = solve_positions(arm_case, rows, period, 1e-8)  # to 1e-10 rad
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
        urdf = (find_config_folder() / "urdf" / "three_axis.urdf").read_text(encoding="utf-8")
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
        truth = solve_positions(three_axis("paper", 1e-3, **where), rows, period, 1e-7)
        yield from against(
            truth,
            rows,
            period,
            lambda scheme, dt: three_axis(scheme, dt, **where),
            {
                scheme: (1e-3, 1e-4, 1e-6) if scheme == "paper" else (1e-2, 1e-3, 1e-4)
                for scheme in choose_schemes(quick, "rosenbrock")
            },
            of_order(3.0, 10.0),
        )


SPIN = 100.0  # rad/s


def spin(quick: bool) -> Iterator[Outcome]:
    """The links alone thrown at 100 rad/s about the vertical: arms fly up and down for 60 s."""
    for scheme in choose_schemes(quick, "rosenbrock"):
        for dt in (1e-3, 1e-4) if quick else (1e-3, 1e-4, 1e-5):
            plant = Plant(three_axis(scheme, dt, 1e-1, **LINKS_ALONE))
            model = make_links_model(plant.scene)
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
            except Diverged:
                yield Outcome(scheme, dt, None, bound)
                continue
            # 0.1 rad per step is not small any more, and nothing damps what it costs.
            may_drift = KNOWN[scheme].order == 1 or SPIN * dt >= 0.1
            yield Outcome(scheme, dt, max(worst_E, worst_H), bound, may_drift)


def fifty_links(quick: bool) -> Iterator[Outcome]:
    """A chain of 50 rods of 0.1 m about skew axes, let go from the horizontal."""
    period, rows = 0.02, np.zeros((25, 50))
    with tempfile.TemporaryDirectory() as name:
        rods = [Rod(0.1, 0.2, 2e-4, axis="0 1 0" if k % 2 else "0 0.6 0.8") for k in range(50)]
        file = chain("fifty_links", rods, Path(name), {}, gravity=EARTH)

        def scene(scheme: str, dt: float) -> Scene:
            own = {"integrator.scheme": scheme, "integrator.dt": dt, "servo_period": period}
            return load_scene(file, overrides=own)

        truth = solve_positions(scene("paper", 1e-3), rows, period, rtol=1e-8, method="DOP853")
        yield from against(
            truth,
            rows,
            period,
            scene,
            {
                scheme: (1e-2, 1e-3, 1e-4) if scheme == "paper" else (1e-3, 1e-4)
                for scheme in choose_schemes(quick, "extrapolated")
            },
            of_order(50.0, 500.0),
        )


def stick_slip(quick: bool) -> Iterator[Outcome]:
    """Joints held by friction against gravity and against wound-up gears: 100 s, and not a bit."""
    # A gear is wound up by the motor to Kt V / (R Ng) = 25 N m, and rings up to 50; weights at the
    # start are below 20 N m.
    friction = {"viscous": 0.5, "coulomb": 45.0, "breakaway": 72.0}
    machine = EVERYTHING | {"joints.*.friction": friction}
    for scheme in choose_schemes(quick, "rosenbrock"):
        for dt in (1e-2, 1e-3):
            moved = 0.0
            for volts in (0.0, 5.0):
                plant = Plant(three_axis(scheme, dt, dt, **machine))
                plant.advance(np.full(3, volts), round(100.0 / dt))
                moved = max(moved, float(np.abs(plant.state.q - plant.scene.start).max()))
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
        dict.fromkeys(choose_schemes(quick, "rosenbrock"), (1e-2,)),
        lambda scheme, dt: 5e-2 if KNOWN[scheme].order == 1 else 2e-2,
    )


def absurd_inputs(quick: bool) -> Iterator[Outcome]:
    """Huge is the supply, denormal is nothing, and what is no number changes nothing."""
    for scheme in SCHEMES:
        plant = Plant(three_axis(scheme, 1e-4, **SHARED))
        yield Outcome(scheme, 1e-4, float(_breaches(plant)), 0.0)


def _breaches(plant: Plant) -> int:
    """Return how many of the rules for absurd inputs a plant breaks."""
    start, zero = plant.scene.start, np.zeros(3)

    def moved(volts: float) -> Array:
        plant.reset()
        plant.advance(np.full(3, volts), 500)
        return plant.state.q

    wrong = [
        not np.array_equal(moved(1e300), moved(48.0)),
        not np.array_equal(moved(-1e300), moved(-48.0)),
        # Motion by a denormal voltage is lost in rounding beside angles of 1 rad.
        np.abs(moved(5e-324) - start).max() > 1e-15,
        np.abs(moved(-1e-310) - start).max() > 1e-15,
    ]
    for refused in (
        lambda: plant.advance([math.nan, 0.0, 0.0], 1),
        lambda: plant.advance([0.0, math.inf, 0.0], 1),
        lambda: plant.advance(zero, 2**63),
        lambda: plant.advance(zero, -1),
        lambda: plant.reset(q=[math.nan, 0.0, 0.0]),
        lambda: plant.reset(q=[1e300, 0.0, 0.0]),
        lambda: plant.reset(v=[math.inf, 0.0, 0.0]),
        lambda: plant.reset(v=[1e300, 0.0, 0.0]),
    ):
        wrong.append(not _refused(plant, refused))
    plant.reset(v=np.full(3, 1e6))  # a speed, if a mad one: no step can follow it
    try:
        plant.advance(zero, 1)
        wrong.append(True)
    except Diverged:
        wrong.append(plant.t != 0.0 or not np.array_equal(plant.state.q, start))
    plant.reset(v=np.full(3, 1e-310))
    plant.advance(zero, 500)
    wrong.append(np.abs(plant.state.q - start).max() > 1e-15)
    return sum(map(bool, wrong))


def _refused(plant: Plant, action: Callable[[], object]) -> bool:
    """Whether the plant refuses and stays as it was."""
    before = dataclasses.astuple(plant.state)
    try:
        action()
    except Refusal:
        after = dataclasses.astuple(plant.state)
        return all(np.array_equal(first, two) for first, two in zip(before, after, strict=True))
    return False


CASES: dict[str, Callable[[bool], Iterator[Outcome]]] = {
    "undamped stiff gear": undamped_stiff_gear,
    "L/R = 1e-7 s": fast_current,
    "forearm of 1 g behind 16 kg": light_distal_link,
    "100 rad/s spin, 60 s": spin,
    "50 links": fifty_links,
    "stick-slip": stick_slip,
    "everything on at 10 ms": everything_at_ten_milliseconds,
    "absurd inputs": absurd_inputs,
}
