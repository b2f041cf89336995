"""Cost of each optional part of a machine per step, and the effect of leaving it out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import numpy as np

from arm_emulator import Diverged, Plant, Scene, load_scene
from arm_emulator.machine.parts.known import GEARS, gear_of
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES
from bench.closed_loop import DemoMotion
from bench.measure import Task, compile_all, interleaved, progress, side_by_side, stepping
from bench.motion import Array

TITLE = "What each part costs"

DT = 1e-4  # s, fine enough that the differences below are those of the machines
STEPS = 20_000  # in one measurement
TIMED = ("paper", "rosenbrock")

RIGID: dict[str, Any] = {
    f"joints.*.gear.{key}": None
    for kind in GEARS
    for key in kind.numbers()
    if key not in gear_of(ratio=1.0).numbers()
}
OUT: dict[str, dict[str, Any]] = {
    "inductance": {"joints.*.motor.inductance": None},
    "gear elasticity": RIGID,
    "friction": {"joints.*.friction": None},
    "encoder": {"joints.*.encoder": None},
    "gravity": {"gravity": None},
    "all of these": {
        "joints.*.motor.inductance": None,
        **RIGID,
        "joints.*.friction": None,
        "joints.*.encoder": None,
        "gravity": None,
    },
    "brakes": {"joints.*.brake": None},
    "end stops": {"joints.*.end_stops": None},
}
IN: dict[str, dict[str, Any]] = {
    "current limit": {"joints.*.motor.current_limit": 20.0},
    "Coulomb friction": {"joints.*.friction.coulomb": 1.0},
}
# Whose commands are others without it, so that only its time is measured.
LOOPS: dict[str, dict[str, Any]] = {
    "current loops": {"joints.*.motor.current_loop": None, "joints.*.motor.current_limit": None}
}
FULL = "nothing"


def run(quick: bool) -> dict[str, Any]:
    """Measure the three scenes."""
    names = ("three_axis",) if quick else ("three_axis", "ur5", "panda")
    variants = {name: _variants(name) for name in names}
    compile_all(timed_scenes(names))
    fulls = side_by_side("full machines", _full, names)
    cases = [(full, part) for full in fulls for part in variants[full.name]]
    errors = side_by_side("without a part", _errors, cases)
    found = {(full.name, part): error for (full, part), error in zip(cases, errors, strict=True)}
    repetitions = 5 if quick else 15
    return {
        full.name: {
            "times": _times(full.name, {**variants[full.name], **_timed(full.name)}, repetitions),
            "errors": {part: found[full.name, part] for part in variants[full.name]},
            "travel": _travel(full),
            "dt": DT,
        }
        for full in fulls
    }


def timed_scenes(names: Sequence[str]) -> Iterator[Scene]:
    """Yield the scenes whose steps are timed."""
    for name in names:
        for overrides in (*_variants(name).values(), *_timed(name).values()):
            for scheme in TIMED:
                yield _scene(name, scheme, overrides)


@cache
def _variants(name: str) -> dict[str, dict[str, Any]]:
    """Return what can be taken out of a scene: what it has."""
    scene = load_scene(name)
    absent = {
        "gravity": scene.gravity is None,
        "brakes": not any(joint.brake for joint in scene.joints),
        "end stops": not any(joint.extras for joint in scene.joints),
        "inductance": _has_loops(scene),  # a current loop is one around it
        "all of these": _has_loops(scene),
    }
    return {FULL: {}} | {
        part: overrides for part, overrides in OUT.items() if not absent.get(part, False)
    }


def _has_loops(scene: Scene) -> bool:
    return any(joint.current_bandwidth > 0.0 for joint in scene.joints)


@cache
def _timed(name: str) -> dict[str, dict[str, Any]]:
    """Return what is put in, and what is taken out, to be timed alone."""
    return {**IN, **LOOPS} if _has_loops(load_scene(name)) else IN


def _scene(name: str, scheme: str, overrides: dict[str, Any], dt: float = DT) -> Scene:
    own = {"integrator.scheme": scheme, "integrator.dt": dt}
    if scheme not in LOCATING_SCHEMES:
        own["integrator.events"] = "step"
    return load_scene(name, {**overrides, **own})


@dataclass(frozen=True)
class _Full:
    """Motion of the full machine, the reference for machines without a part.

    Attributes:
        name: of the scene.
        q: link positions and voltages of each servo period, (K, N) each.
    """

    name: str
    q: Array
    voltages: Array


def _full(name: str) -> _Full:
    return _Full(name, *DemoMotion(load_scene(name)).run(_scene(name, "rosenbrock", {})))


def _errors(case: tuple[_Full, str]) -> dict[str, dict[str, float] | None]:
    """Return how far the machine without one part moves from the full one."""
    full, part = case
    motion = DemoMotion(load_scene(full.name))
    watched = slice(motion.settle, None)
    tool = motion.tool(full.q[watched])

    def error(q: Array | None) -> dict[str, float] | None:
        if q is None:
            return None
        return {
            "joint": float(np.abs(q - full.q)[watched].max()),
            "tool": float(np.linalg.norm(motion.tool(q[watched]) - tool, axis=1).max()),
        }

    # Differences by rounding and step alone are the base for all others.
    dt = DT / 2 if part == FULL else DT
    scene = _scene(full.name, "rosenbrock", _variants(full.name)[part], dt)
    return {
        "closed_loop": error(motion.run(scene)[0]),
        "open_loop": error(_open_loop(scene, full.voltages)),
    }


def _travel(full: _Full) -> float:
    settle = DemoMotion(load_scene(full.name)).settle
    return float(np.abs(full.q[settle:] - full.q[settle - 1]).max())


def _open_loop(scene: Scene, voltages: Array) -> Array | None:
    try:
        return Plant(scene).run(voltages, scene.steps_per_period)
    except Diverged:
        return None


def _times(
    name: str, variants: dict[str, dict[str, Any]], repetitions: int
) -> dict[str, dict[str, Any]]:
    """Time a step of each variant under each scheme, all interleaved."""
    tasks: dict[str, Task] = {}
    for scheme in TIMED:
        for part, overrides in variants.items():
            plant = Plant(_scene(name, scheme, overrides, 1e-5))
            rows = 1.0 * (-1.0) ** np.arange(len(plant.scene.joints))[None, :]
            tasks[f"{scheme}: {part}"] = stepping(plant, rows, STEPS, about=1e-3)
    with progress(f"steps, {name}", repetitions * len(tasks)) as done:
        timings = interleaved(tasks, repetitions, done)
    return {
        part: {scheme: asdict(timings[f"{scheme}: {part}"].per(STEPS)) for scheme in TIMED}
        for part in variants
    }


def report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    lines = [
        "Each scene, and the same with one part left out of its file. Time saved is per step of "
        f"the schemes {' and '.join(f'`{scheme}`' for scheme in TIMED)}. Error is the largest "
        "difference from the full machine within 1 s of the demo's motion (after it has settled), "
        f"rosenbrock at {DT:g} s: in closed loop, with the same servo, motion controller and "
        "target, as one would use it; and in open loop, with the voltages that the full machine "
        "got. `nothing` left out, but the step halved, is what differs anyway: steps, rounding, "
        "and encoder counts that fall to the other side.",
    ]
    for name, scene in figures.items():
        full = scene["times"][FULL]
        shown = ", ".join(f"{scheme} {_ns(full[scheme])}" for scheme in TIMED)
        travel = f"{scene['travel'] * 1e3:.0f} mrad"
        lines += [
            "",
            f"**{name}**: full machine {shown} per step; the joints travel up to {travel}.",
            "",
            "| left out | " + " | ".join(f"saved, {scheme}" for scheme in TIMED)
            + " | closed loop: joints [rad] | tool [mm] | open loop: joints [rad] | tool [mm] |",
            "|---" * (len(TIMED) + 5) + "|",
        ]  # fmt: skip
        for part, errors in scene["errors"].items():
            times = [
                "-" if part == FULL else _saved(full[scheme], scene["times"][part][scheme])
                for scheme in TIMED
            ]
            cells = [cell for loop in ("closed_loop", "open_loop") for cell in _error(errors[loop])]
            lines.append(f"| {part} | " + " | ".join([*times, *cells]) + " |")
        put_in = [
            f"{part} {', '.join(_saved(times[s], full[s]) for s in TIMED)}"
            for part, times in scene["times"].items()
            if part in IN
        ]
        lines += [
            "",
            "Parts that this scene does not have cost, put in: " + "; ".join(put_in)
            + f" ({', '.join(TIMED)}).",
        ]  # fmt: skip
        for part in LOOPS:
            if part in scene["times"]:
                cost = ", ".join(_saved(full[s], scene["times"][part][s]) for s in TIMED)
                lines += ["", f"Its {part} cost {cost} ({', '.join(TIMED)})."]
    lines += [
        "",
        "A time saved within the spread of some per cent does not count. An encoder's share is 0 "
        "in open loop by its nature: it is read by the servo alone. What this table does not show: "
        "a part that is left out may allow a longer step (section Stability map).",
    ]
    return "\n".join(lines)


def _ns(time: dict[str, float]) -> str:
    return f"{time['median'] * 1e9:.1f} ns"


def _saved(before: dict[str, float], after: dict[str, float]) -> str:
    saved = before["median"] - after["median"]
    return f"{saved * 1e9:+.1f} ns ({100 * saved / before['median']:+.0f} %)"


def _error(error: dict[str, float] | None) -> list[str]:
    if error is None:
        return ["diverged", "diverged"]
    return [f"{error['joint']:.1e}", f"{error['tool'] * 1e3:.1e}"]
