"""What each optional part of a machine costs per step, and what leaving it out does."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from bench.closed_loop import DemoMotion
from bench.measure import Task, compile_all, interleaved, progress, stepping
from bench.motion import Array
from emulator_node.plant import Diverged, Plant
from emulator_node.scene import Scene, load_scene

TITLE = "What each part costs"

DT = 1e-4  # s, fine enough that the differences below are those of the machines
STEPS = 20_000  # in one measurement
TIMED = ("paper", "rosenbrock")

RIGID = {"joints.*.gear.stiffness": None, "joints.*.gear.damping": None}
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
FULL = "nothing"


def run(quick: bool) -> dict[str, Any]:
    """Measure the three scenes."""
    names = ("three_axis",) if quick else ("three_axis", "ur5", "panda")
    variants = {name: _variants(name) for name in names}
    compile_all(
        _scene(name, scheme, overrides)
        for name in names
        for scheme in TIMED
        for overrides in (*variants[name].values(), *IN.values())
    )
    return {name: _measure(name, variants[name], 5 if quick else 15) for name in names}


def _variants(name: str) -> dict[str, dict[str, Any]]:
    """Return what can be taken out of a scene: what it has."""
    scene = load_scene(name)
    absent = {
        "gravity": scene.gravity is None,
        "brakes": not any(joint.brake for joint in scene.joints),
        "end stops": not any(joint.extras for joint in scene.joints),
    }
    return {FULL: {}} | {
        part: overrides for part, overrides in OUT.items() if not absent.get(part, False)
    }


def _scene(name: str, scheme: str, overrides: dict[str, Any], dt: float = DT) -> Scene:
    return load_scene(name, {**overrides, "integrator.scheme": scheme, "integrator.dt": dt})


def _measure(name: str, variants: dict[str, dict[str, Any]], repetitions: int) -> dict[str, Any]:
    motion = DemoMotion(load_scene(name))
    times = _times(name, {**variants, **IN}, repetitions)
    with progress("what each part costs", len(variants) + 1) as done:
        q_full, voltages = motion.run(_scene(name, "rosenbrock", {}))
        watched = slice(motion.settle, None)
        tool_full = motion.tool(q_full[watched])

        def error(q: Array | None) -> dict[str, float] | None:
            if q is None:
                return None
            tool = motion.tool(q[watched]) - tool_full
            return {
                "joint": float(np.abs(q[watched] - q_full[watched]).max()),
                "tool": float(np.linalg.norm(tool, axis=1).max()),
            }

        errors: dict[str, Any] = {}
        for part, overrides in variants.items():
            # What differs for no reason but rounding and step is the ground of all the others.
            scene = _scene(name, "rosenbrock", overrides, DT / 2 if part == FULL else DT)
            errors[part] = {
                "closed_loop": error(motion.run(scene)[0]),
                "open_loop": error(_open_loop(scene, voltages)),
            }
            done(f"{name} without {part}")
        done(name)
    travel = float(np.abs(q_full[watched] - q_full[motion.settle - 1]).max())
    return {"times": times, "errors": errors, "travel": travel, "dt": DT}


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
    timings = interleaved(tasks, repetitions)
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
    lines += [
        "",
        "A time saved of less than the spread of some per cent is none. An encoder's share is 0 in "
        "open loop by its nature: it is read by the servo alone. What this table does not show: "
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
