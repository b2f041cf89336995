"""A hard case and its outcomes; machines and bounds that several cases share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.machine.schemes.known import KNOWN, SCHEMES
from bench.motion import Array

HELD, DRIFTS, DETECTED, FAILED = "held", "drifts", "detected", "FAILED"


EARTH = [0.0, 0.0, -9.81]  # m/s2


@dataclass(frozen=True)
class Outcome:
    """The result of one scheme on a case at one step."""

    scheme: str
    dt: float  # s
    measured: float | None  # None: the plant diverged, and reported it
    bound: float
    note: str = ""
    may_drift: bool = False  # whether to miss the bound is no failure

    @property
    def verdict(self) -> str:
        """Return whether the truth came out."""
        if self.measured is None:
            return DETECTED
        if self.measured <= self.bound:
            return HELD
        return DRIFTS if self.may_drift and math.isfinite(self.measured) else FAILED


@dataclass(frozen=True)
class Case:
    """A machine, a motion, and what must come out."""

    name: str
    truth: str
    measured: str  # what is measured, with its unit
    run: Callable[[bool], Iterator[Outcome]]


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
    center: float = 0.5  # of mass, in lengths


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
            <origin xyz="{rod.center * rod.length} 0 0"/><mass value="{rod.mass}"/>
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
            except Diverged as fault:
                yield diverged(scheme, dt, bound(scheme, dt), fault)
                continue
            yield Outcome(scheme, dt, float(np.abs(q - truth).max()), bound(scheme, dt))


def diverged(scheme: str, dt: float, bound: float, fault: Diverged) -> Outcome:
    """Return the outcome of a divergence that the plant detected."""
    return Outcome(scheme, dt, None, bound, f"{fault.joint} after {fault.t:.3g} s")


def of_order(first: float, second: float) -> Callable[[str, float], float]:
    """Return the bound `first` dt for schemes of order 1, `second` dt^2 for those of higher order.

    Where the links alone count, one evaluation of them per step has the error constant of the
    Adams-Bashforth method, 5/12, and two have that of a Runge-Kutta method, 1/6: 2.5 times less.
    """

    def bound(scheme: str, dt: float) -> float:
        known = KNOWN[scheme]
        least = first if known.order == 1 else second * (1.0 if known.evaluations > 1 else 2.5)
        return least * dt ** min(known.order, 2)

    return bound


def all_schemes(*dts: float) -> dict[str, tuple[float, ...]]:
    """Try all schemes at the same steps."""
    return dict.fromkeys(SCHEMES, dts)


def of_one_case(quick: bool, one: str) -> tuple[str, ...]:
    """Return the schemes to try on a machine of one case alone.

    A compiler takes longer over each of them than the case itself, so in quick runs it is `one`.
    """
    return (one,) if quick else SCHEMES
