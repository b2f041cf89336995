"""Spread of an arm's demo over the assumed numbers of its scene.

    python -m bench.assumed [SCENE ...]

Most figures of motors, gears and friction of the scenes are assumed, each within a range
(bench/origins.py). Here a fleet makes the demo's motion: an arm as the scene has it, arms with one
figure at either end of its range, and arms with all figures drawn from their ranges. Servo and
motion controller are the scene's in all of them: they do not know.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator import Fleet, Pose, Refusal, Scene, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.machine.chain import Array
from arm_emulator.motion.controller import controller_for
from arm_emulator.motion.instructor import Instructor
from arm_emulator.motion.kinematics import moving_joints
from arm_emulator.runs.gains import Gains
from arm_emulator.servo.drives import Drives, Target
from bench.measure import progress
from bench.origins import Origin, origins

TITLE = "What is assumed of the arms"

ARMS = ("ur5", "panda")
DRAWN = 24  # arms with all figures drawn
NANOSECONDS = 1_000_000_000
Values = dict[str, float]  # of varied numbers, by name


@dataclass(frozen=True)
class Assumed:
    """A figure that is assumed, and how to give it to the joints that share it."""

    label: str
    joints: tuple[str, ...]
    value: float
    low: float
    high: float
    names: tuple[tuple[str, float], ...]  # numbers that change, and with which power of the figure
    nominal: Values

    def at(self, value: float) -> Values:
        """Return the numbers of the joints where the figure is `value`."""
        if self.value == 0.0:
            return {name: value for name, _ in self.names}
        factor = value / self.value
        return {name: self.nominal[name] * factor**power for name, power in self.names}

    def draw(self, rng: np.random.Generator) -> float:
        """Return a value from the range: of 2 and 8, 4 is in the middle."""
        if self.low <= 0.0:
            return float(rng.uniform(self.low, self.high))
        return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))


def assumed_of(file: Path) -> list[Assumed]:
    """Return what a scene assumes, in the order of the file.

    The torque constant is the constant of the back EMF, too. A gear's ratio is no number of a
    machine but structure: r0/r of it does what motors do whose constants and dry friction are r0/r
    times as large, and their rotors (r0/r)^2 times as heavy and as viscous.
    """
    found = [one for one in origins(file) if one.assumed is not None]
    nominal = {name: one.value for one in found for name in one.names()}

    def of(one: Origin) -> Assumed:
        key = f"{one.section}.{one.key}"
        powers = {
            "motor.torque_constant": {"torque_constant": 1.0, "back_emf_constant": 1.0},
            "gear.ratio": {"torque_constant": -1.0, "back_emf_constant": -1.0,
                           "rotor_inertia": -2.0, "friction.coulomb": -1.0,
                           "friction.viscous": -2.0},
        }.get(key)  # fmt: skip
        names = [(name, 1.0) for name in one.names()]
        if powers:
            names = [(name, power) for joint in one.joints for of_motor, power in powers.items()
                     if (name := f"joints.{joint}.motor.{of_motor}") in nominal]  # fmt: skip
        assert one.assumed is not None
        return Assumed(key, one.joints, one.value, *one.assumed, tuple(names), nominal)

    return [of(one) for one in found if one.key != "back_emf_constant"]


class Laws:
    """Servo and motion controller of one arm, in lock-step."""

    def __init__(self, scene: Scene, gains: Gains, target: Pose, from_ns: int) -> None:
        self.drives = Drives(gains.servo)
        self.controller = controller_for(scene.urdf, moving_joints(scene.urdf), gains.motion)
        self.instructor = Instructor(gains.motion)
        self.instructor.add(from_ns, target)
        names, of_servo = self.controller.kinematics.joint_names, list(gains.servo.joint_names)
        # Indices of one side's joints in the other's arrays.
        self._to_servo = [list(scene.joint_names).index(name) for name in of_servo]
        self._to_scene = [of_servo.index(name) for name in scene.joint_names]
        self._to_motion = [of_servo.index(name) for name in names]
        self._from_motion = [list(names).index(name) for name in of_servo]

    def answer(
        self, now: int, counts: NDArray[np.int64], current: Array, applied: Array, instruct: bool
    ) -> Array:
        """Return the commands of a servo period, in the scene's order of joints [V].

        Args:
            now: logical time [ns].
            counts: of the encoders now, (N,) like the next two.
            current: of the motors now [A].
            applied: applied in the period that ends now [V].
            instruct: whether a motion period begins, too.
        """
        drives, to_servo, back = self.drives, self._to_servo, self._from_motion
        drives.measure(now, counts[to_servo], current[to_servo], applied[to_servo])
        if instruct:
            q, v = (x[self._to_motion] for x in (drives.servo.q_measured, drives.servo.v_measured))
            given = self.instructor.instruct(self.controller, now, q, v)
            v_back, tau = (None if x is None else x[back] for x in (given.v, given.tau))
            drives.aim(Target(given.q[back], v_back, tau))
        answer: Array = drives.command(powered=True)[self._to_scene]
        return answer


def demos(scene_name: str, arms: list[Values], instructions: int | None = None) -> Array:
    """Return target minus tool of each arm before each instruction (count, K + 1, 3) [m].

    What the demo does, in lock-step and without a network; from where an arm diverges, NaN.

    Args:
        scene_name: scene file or name.
        arms: by which numbers each differs from the scene.
        instructions: K; None: as many as the demo has.
    """
    file = find_scene(scene_name)
    names = sorted({name for arm in arms for name in arm})
    scene, gains = load_scene(file, {"varied": names} if names else None), load_gains(file)
    count, own = len(arms), {one.name: one.value for one in scene.varied}
    values = {name: np.array([arm.get(name, own[name]) for arm in arms]) for name in names}
    fleet = Fleet(scene, count, varied=values)
    motion_ns = round(gains.motion.period * NANOSECONDS)
    period_ns = round(scene.servo_period * NANOSECONDS)
    plan, ticks = DemoPlan.load(file, motion_ns), motion_ns // period_ns
    kinematics = controller_for(scene.urdf, moving_joints(scene.urdf), gains.motion).kinematics
    R_WT, p_WT = kinematics.forward(scene.start)
    goal = p_WT + plan.displacement
    target = Pose.from_quaternion(goal, Pose(p_WT, R_WT).quaternion(), "displacement")
    laws = [Laws(scene, gains, target, plan.settle_ns) for _ in range(count)]
    steps = round(scene.servo_period / scene.integrator.dt)
    first = plan.settle_ns // period_ns
    last = first + ticks * (plan.instructions if instructions is None else instructions)
    applied, deviations = np.zeros((count, len(scene.joint_names))), []
    with progress(f"{scene.name}, {count} arms", last + 1) as done:
        for tick in range(last + 1):
            state, instruct = fleet.state, tick % ticks == 0
            measured = fleet.measured
            if tick >= first and instruct:
                tools = np.array([kinematics.forward(q)[1] for q in state.q])
                tools[fleet.faults >= 0] = np.nan
                deviations.append(goal - tools)
            for arm, law in enumerate(laws):
                counts, current = measured.encoder_counts[arm], measured.current[arm]
                applied[arm] = law.answer(tick * period_ns, counts, current, applied[arm], instruct)
            fleet.advance(applied, steps)
            done("")
    return np.stack(deviations, axis=1)


@dataclass(frozen=True)
class Outcome:
    """Result of the demo of one arm."""

    residual: float  # mm, that remains at the end
    away: float  # mm, by which it was away from the scene's own arm at most, before any instruction
    settled: int | None  # instructions until it was within 2 % of the way; None: never


def outcome(deviations: Array, nominal: Array) -> Outcome:
    """Return it, of the deviations (K + 1, 3) [m]."""
    distance = np.linalg.norm(deviations, axis=1)
    below = np.flatnonzero(distance < 0.02 * np.linalg.norm(nominal[0]))
    away = float(np.linalg.norm(deviations - nominal, axis=1).max())
    return Outcome(1e3 * float(distance[-1]), 1e3 * away, int(below[0]) if len(below) else None)


def measure(scene_name: str, quick: bool = False) -> dict[str, Any]:
    """Make the demo over the ranges of a scene."""
    assumed = assumed_of(find_scene(scene_name))
    rng = np.random.default_rng(1)
    arms: list[Values] = [{}]
    for one in assumed:
        arms += [one.at(one.low), one.at(one.high)]
    for _ in range(2 if quick else DRAWN):
        arm: Values = dict(assumed[0].nominal)
        for one in assumed:
            factors, drawn = one.nominal, one.at(one.draw(rng))
            # A ratio changes what was drawn of the motor before.
            arm |= {name: arm[name] * value / factors[name] if factors[name] else value
                    for name, value in drawn.items()}  # fmt: skip
        arms.append({name: value for name, value in arm.items() if not name.endswith("ratio")})
    deviations = demos(scene_name, arms, 30 if quick else None)
    found = [asdict(outcome(one, deviations[0])) for one in deviations]
    ends = len(assumed)
    return {
        "nominal": found[0],
        "rows": [
            {"figure": one.label, "joints": list(one.joints), "value": one.value,
             "range": [one.low, one.high], "ends": found[1 + 2 * k : 3 + 2 * k]}
            for k, one in enumerate(assumed)
        ],
        "drawn": found[1 + 2 * ends :],
    }  # fmt: skip


def run(quick: bool) -> dict[str, Any]:
    """Measure all arms."""
    return {name: measure(name, quick) for name in ARMS}


def report(figures: dict[str, Any]) -> str:
    """Return the tables."""
    return "\n\n".join(table(name, of_arm) for name, of_arm in figures.items())


def table(name: str, figures: dict[str, Any]) -> str:
    """Return the table of one arm, in Markdown."""

    def cell(one: dict[str, Any]) -> str:
        settled = "never" if one["settled"] is None else one["settled"]
        if not np.isfinite(one["residual"]):
            return "diverged"
        return f"{one['residual']:.2f} / {one['away']:.2f} / {settled}"

    lines = [
        f"{name}, as its scene has it: {cell(figures['nominal'])}.",
        "",
        "| figure | joints | scene | range | at its low end | at its high end |",
        "|---|---|---|---|---|---|",
    ]
    for row in figures["rows"]:
        low, high = row["range"]
        joints = f"{row['joints'][0]} to {row['joints'][-1]}"
        ends = " | ".join(map(cell, row["ends"]))
        value = f"{row['value']:.3g} | {low:.3g} to {high:.3g}"
        lines.append(f"| `{row['figure']}` | {joints} | {value} | {ends} |")
    drawn = figures["drawn"]
    sound = [one for one in drawn if np.isfinite(one["residual"])]
    if sound:
        residual, away = ([one[key] for one in sound] for key in ("residual", "away"))
        settled = [one["settled"] for one in sound if one["settled"] is not None]
        lines += [
            "",
            f"{len(drawn)} arms with all figures drawn: {len(drawn) - len(sound)} diverged; "
            f"{min(residual):.2f} to {max(residual):.2f} mm remain (median "
            f"{np.median(residual):.2f}), at most {max(away):.2f} mm away, "
            f"{len(settled)} within 2 %"
            + (f", after {min(settled)} to {max(settled)} instructions." if settled else "."),
        ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Print the tables of scenes."""
    parser = argparse.ArgumentParser(prog="bench.assumed", description=__doc__)
    parser.add_argument("scenes", nargs="*", default=ARMS)
    parser.add_argument("--quick", action="store_true", help="fewer arms and instructions")
    options = parser.parse_args(arguments)
    try:
        for name in options.scenes:
            print(table(name, measure(name, options.quick)), end="\n\n", flush=True)
    except Refusal as refusal:
        print(refusal, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
