"""Whether the tool rests where it was predicted to, over many poses and effects.

    python -m bench.residuals [SCENE ...] [--poses N] [--effects NAME ...] [--out FILE]
    python -m bench.pages residuals

Arms with one effect each start in drawn poses and bring their tools to drawn targets, as the demo
does; where they rest was predicted before. The bound is how far from the target the tool may rest:
the predicted deviation and the radius around it.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator import Kinematics, OfflineRun, Pose, Scene, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.demo.predicted_rest import Arrival, PredictedRest, predicted_rest
from arm_emulator.motion.controller import controller_for
from arm_emulator.runs.gains import Gains

Array = NDArray[np.float64]

POSES = 100
WAITS = 2000  # motion periods at most, beside those of the plan: so that noise is another
AROUND = 0.6  # rad, of the start
NEAREST_SINGULAR = 0.08  # singular value
STICKS = {"viscous": 0.5, "coulomb": 2.0, "breakaway": 3.0}
WAVES = [[2, 5e-5], [1, 2e-5, 0.7]]

# Cases measured by `make pages`: the effects of each arm.
OF_ARMS: dict[str, tuple[str, ...]] = {
    "three_axis": (
        "none", "play", "stiction", "stiction of rotors", "eccentric encoders", "noisy encoders",
        "payload", "kinematic error", "cogging", "torque ripple",
    ),
    "ur5": ("none", "play", "stiction", "eccentric encoders", "noisy encoders", "payload"),
    "panda": ("none", "play", "stiction", "eccentric encoders", "noisy encoders", "payload"),
}  # fmt: skip

# Changes of a scene, by the name of the effect.
EFFECTS: dict[str, dict[str, Any]] = {
    "none": {},
    "play": {"joints.*.gear.backlash": 4e-4, "joints.*.gear.cubic_stiffness": None},
    "stiction": {"joints.*.friction": STICKS},
    "stiction of rotors": {"joints.*.motor.friction": {"coulomb": 0.02, "breakaway": 0.025}},
    "eccentric encoders": {
        "joints.*.encoder.eccentricity": 0.02, "joints.*.encoder.eccentricity_phase": 0.7,
    },
    "noisy encoders": {"joints.*.encoder.noise": 0.02},
    "payload": {"payload": {"mass": 2.0, "com": [0.0, 0.0, 0.05]}, "gravity": [0.0, 0.0, -9.81]},
    "kinematic error": {
        "joints.*.gear.cubic_stiffness": None,
        "joints.*.gear.kinematic_error": {"motor": WAVES, "link": [[1, 1e-4]]},
    },
    "cogging": {"joints.*.motor.cogging": {"waves": [[12, 5e-3]]}},
    "torque ripple": {"joints.*.motor.ripple": {"waves": [[6, 0.05]]}},
}  # fmt: skip


@dataclass(frozen=True)
class Rest:
    """One demo: what was predicted, and what was left."""

    residual: float  # m, distance of the tool from its target
    bound: float  # m
    off: float  # distance from the predicted place, by the radius
    inside: bool
    arrival: str


def rests(scene: Scene, gains: Gains, plan: DemoPlan, poses: int, seed: int = 0) -> Iterator[Rest]:
    """Yield demos from drawn poses to drawn targets."""
    rng = np.random.default_rng(seed)
    kinematics = controller_for(scene.urdf, scene.joint_names, gains.motion).kinematics
    for _ in range(poses):
        q = _pose(scene, kinematics, rng)
        joints = tuple(
            replace(joint, start=float(angle)) for joint, angle in zip(scene.joints, q, strict=True)
        )
        displacement = rng.normal(size=3)
        displacement *= np.linalg.norm(plan.displacement) / np.linalg.norm(displacement)
        waits = int(rng.integers(WAITS)) * round(gains.motion.period * 1e9)
        own = replace(plan, displacement=displacement, settle_ns=plan.settle_ns + waits)
        yield rest(replace(scene, joints=joints), gains, own)


def rest(scene: Scene, gains: Gains, plan: DemoPlan) -> Rest:
    """Predict a demo, and make it."""
    predicted = predicted_rest(scene, gains, plan)
    residual = left_by(scene, gains, plan)
    off = float(np.linalg.norm(residual - predicted.centre[:3])) / predicted.radius
    return Rest(
        float(np.linalg.norm(residual)),
        bound_of(predicted),
        off,
        predicted.contains(residual),
        predicted.arrival.value,
    )


def bound_of(predicted: PredictedRest) -> float:
    """Return how far from its target the tool may rest [m]."""
    return float(np.linalg.norm(predicted.centre[:3])) + predicted.radius


def left_by(scene: Scene, gains: Gains, plan: DemoPlan) -> Array:
    """Return target minus tool (3,) at the end of a demo without a network [m]."""
    run = OfflineRun(scene, gains.servo, gains.motion)
    kinematics = run.controller.kinematics
    R_WT, p_WT = kinematics.forward(scene.start)
    goal: Array = p_WT + plan.displacement
    target = Pose.from_quaternion(goal, Pose(p_WT, R_WT).quaternion(), "displacement")
    run.instructor.add(plan.settle_ns, target)
    run.advance(plan.settle_ns // run.session.period_ns + plan.instructions * run.motion_ticks)
    return goal - kinematics.forward(run.session.state.q)[1]


def _pose(scene: Scene, kinematics: Kinematics, rng: np.random.Generator) -> Array:
    while True:
        q: Array = scene.start + rng.uniform(-AROUND, AROUND, len(scene.start))
        if kinematics.singular_values(q)[-1] > NEAREST_SINGULAR:
            return q


@dataclass(frozen=True)
class Summary:
    """Of one arm with one effect."""

    arm: str
    effect: str
    poses: int
    inside: int
    reached: int
    residual: float  # mm, median
    bound: float  # mm, median
    largest_bound: float  # mm
    off: float  # the largest, by the radius


def measure(arm: str, effect: str, poses: int) -> Summary:
    """Make the demos of an arm with one effect."""
    file = find_scene(arm)
    changes = dict(EFFECTS[effect])
    gains = load_gains(file)
    plan = DemoPlan.load(file, round(gains.motion.period * 1e9))
    found = list(rests(load_scene(file, changes), gains, plan, poses))
    residual, bound = (1e3 * np.array([getattr(one, name) for one in found])
                       for name in ("residual", "bound"))  # fmt: skip
    return Summary(
        arm,
        effect,
        poses,
        sum(one.inside for one in found),
        sum(one.arrival == Arrival.REACHED.value for one in found),
        float(np.median(residual)),
        float(np.median(bound)),
        float(bound.max()),
        max(one.off for one in found),
    )


def run(quick: bool) -> list[Summary]:
    """Make the demos of all arms."""
    poses = 10 if quick else POSES
    return [measure(arm, effect, poses) for arm, effects in OF_ARMS.items() for effect in effects]


def report(found: list[Summary]) -> str:
    """Return them as a table."""
    return "\n".join([HEAD, *map(row, found)])


HEAD = """\
| arm | effect | poses | inside | residual, median [mm] | bound, median [mm] | times | largest bound, times | farthest, of the radius |
|---|---|---|---|---|---|---|---|---|"""  # noqa: E501


def row(one: Summary) -> str:
    """Return it in Markdown."""
    times, most = one.bound / one.residual, one.largest_bound / one.residual
    return (
        f"| {one.arm} | {one.effect} | {one.poses} | {one.inside} | {one.residual:.4f} | "
        f"{one.bound:.4f} | {times:.2f} | {most:.2f} | {one.off:.2f} |"
    )


def main(arguments: list[str] | None = None) -> int:
    """Print a row per arm and effect."""
    parser = argparse.ArgumentParser(prog="bench.residuals", description=__doc__)
    parser.add_argument("scenes", nargs="*", default=tuple(OF_ARMS))
    parser.add_argument("--poses", type=int, default=POSES)
    parser.add_argument("--effects", nargs="*", choices=list(EFFECTS), default=list(EFFECTS))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args(arguments)
    print(HEAD, flush=True)
    found = []
    for arm in options.scenes:
        for effect in options.effects:
            found.append(measure(arm, effect, options.poses))
            print(row(found[-1]), flush=True)
    if options.out:
        options.out.write_text(json.dumps([asdict(one) for one in found], indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
