"""Ways without a machine: do references keep their limits, and how much time do they take?

    python -m bench.ways [ROBOT ...] [--count 10000] [--arms 20] [--period 0.01]

Random tool targets of random arms, from rest and in mid-motion. Held against the limits at random
times, not those at which the planner looked; against the shortest time by toppra (speeds,
accelerations and torques, without jerk) for those from rest, and by ruckig for lines of the joints.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import math
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from arm_emulator import Kinematics, Pose, Refusal
from arm_emulator.base.urdf_text import UNLIMITED
from arm_emulator.motion.kinematics import moving_joints
from arm_emulator.motion.motion_config import MotionConfig
from arm_emulator.motion.no_way import NoWay
from arm_emulator.motion.target_ways import joints_duration
from arm_emulator.motion.way import Way
from arm_emulator.motion.way_controller import WayController
from bench.measure import progress
from bench.motion import Array
from oracles.any_arm import arms
from oracles.own_robots import OWN

LOOKS = 60  # at a way
MOVES = (0.02, 0.6)  # part of the arm's reach, a target is away
GRID = 100  # gridpoints of toppra


@dataclass
class Seen:
    """Outcome of all ways."""

    ways: Counter[str] = field(default_factory=Counter)
    speed: float = 0.0
    acceleration: float = 0.0
    jerk: float = 0.0
    torque: float = 0.0
    position: float = 0.0
    """Farthest outside of a limit [rad]."""
    past: float = 0.0
    """Farthest past the end of a line, in parts of its length."""
    violations: int = 0
    """Ways that exceed a limit by more than 1e-3 of it."""
    over_toppra: list[float] = field(default_factory=list)
    over_jerky: list[float] = field(default_factory=list)
    """The same over the shortest with the time that jerks take, see `with_jerk`."""
    over_ruckig: list[float] = field(default_factory=list)
    planning: list[float] = field(default_factory=list)
    """Processor times of the period in which a target came [s]."""


def main() -> None:
    """Print what became of all; exit code 1 if a limit was exceeded or an end passed."""
    parser = argparse.ArgumentParser(prog="bench.ways", description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", help="names, or parts of them")
    parser.add_argument("--count", type=int, default=10_000, help="of ways in all")
    parser.add_argument("--arms", type=int, default=20, help="at most")
    parser.add_argument("--period", type=float, default=0.01, help="of the motion [s]")
    arguments = parser.parse_args()
    logging.getLogger("toppra").setLevel(logging.ERROR)
    chosen = {
        name: robot
        for name, robot in arms().items()
        if not arguments.robots or any(one in name for one in arguments.robots)
    }
    rng, seen = np.random.default_rng(0), Seen()
    found = (law_of(robot, arguments.period) for robot in chosen.values())
    laws = [law for law in found if law is not None]
    laws = [
        laws[i] for i in np.linspace(0, len(laws) - 1, min(arguments.arms, len(laws)), dtype=int)
    ]
    each = max(1, arguments.count // len(laws))
    with progress("arms", len(laws)) as tick:
        for law in laws:
            for _ in range(each):
                examine(law, rng, seen)
            tick(law.kinematics.tool)
    print(report(seen, len(laws)))
    sys.exit(seen.violations > 0 or seen.past > 1e-6)


def law_of(robot: Path | str, period: float) -> WayController | None:
    """Return the law for an arm as its description is; None: it cannot be taken as it is."""
    urdf = OWN[robot]() if isinstance(robot, str) else robot.read_text(encoding="utf-8")
    try:
        names = moving_joints(urdf)[:9]
        tool = Kinematics(urdf, names, last_link(urdf, names)).tool
        config = MotionConfig(tool=tool, period=period)
        return WayController(Kinematics(urdf, names, tool), config)
    except (Refusal, ValueError):
        return None


def last_link(urdf: str, names: tuple[str, ...]) -> str:
    """Return the link that the last joint moves."""
    import xml.etree.ElementTree as ET

    for joint in ET.fromstring(urdf.encode()).findall("joint"):
        child = joint.find("child")
        if joint.get("name") == names[-1] and child is not None:
            return child.get("link", "")
    raise ValueError(names[-1])


def drawn(kinematics: Kinematics, rng: np.random.Generator) -> Array:
    """Return joint angles within the limits."""
    low, high = np.maximum(kinematics.lower, -3.0), np.minimum(kinematics.upper, 3.0)
    slide = kinematics.upper >= UNLIMITED
    low, high = np.where(slide, -1.0, low), np.where(slide, 1.0, high)
    return np.asarray(low + (high - low) * rng.random(len(low)))


def examine(law: WayController, rng: np.random.Generator, seen: Seen) -> None:
    """Send a reference to a target, from rest or a motion, and judge its way."""
    kinematics = law.kinematics
    q = drawn(kinematics, rng)
    far = rng.uniform(*MOVES)
    end = np.clip(
        q + far * rng.normal(size=len(q)) * kinematics.joint_scale,
        np.minimum(kinematics.lower, q),
        np.maximum(kinematics.upper, q),
    )
    law.begin(q)
    if rng.random() < 0.3:  # on the way to somewhere else
        R_WT, p_WT = kinematics.forward(drawn(kinematics, rng))
        with contextlib.suppress(NoWay):  # then it rests
            for _ in range(int(rng.integers(1, 60))):
                law.update(law.coming.q, Pose(p_WT, R_WT))
    R_WT, p_WT = kinematics.forward(end)
    target = Pose(p_WT, R_WT)
    begun = time.process_time()
    try:
        law.update(law.coming.q, target)
        seen.planning.append(time.process_time() - begun)
        for _ in range(60):
            if not law.seeking:
                break
            law.update(law.coming.q, target)
    except NoWay:
        seen.ways["refused"] += 1
        return
    motion = law.motion
    seen.ways[law.way.split(":")[0] or "none"] += 1
    judge(law, motion, rng, seen)
    if isinstance(motion, Way):
        compare(law, motion, seen)


def judge(law: WayController, motion: object, rng: np.random.Generator, seen: Seen) -> None:
    """Hold a way against all limits at random times, and the tool against its line."""
    limits, kinematics = law.limits, law.kinematics
    duration: float = motion.duration  # type: ignore[attr-defined]
    times = np.sort(rng.uniform(0.0, duration, LOOKS))
    rows = [motion.at(t) for t in times]  # type: ignore[attr-defined]
    q, v, a = (np.array([getattr(one, key) for one in rows]) for key in "qva")
    jerk = np.array([one.jerk for one in rows])
    shares = [
        float((np.abs(x) / limit).max(initial=0.0))
        for x, limit in ((v, limits.speed), (a, limits.acceleration), (jerk, limits.jerk))
    ]
    torque = 0.0
    if isinstance(motion, Way) and motion.loaded:
        torque = float((np.abs(law.arm.torques(q, v, a)) / limits.torque).max(initial=0.0))
    outside = np.maximum(kinematics.lower - q, q - kinematics.upper) / kinematics.joint_scale
    seen.speed, seen.acceleration = max(seen.speed, shares[0]), max(seen.acceleration, shares[1])
    seen.jerk, seen.torque = max(seen.jerk, shares[2]), max(seen.torque, torque)
    seen.position = max(seen.position, float(outside.max()))
    seen.violations += max(*shares, torque) > 1.0 + 1e-3 or float(outside.max()) > 1e-6
    if "tool's line" in law.way and law.way.startswith("along the tool"):
        p = law.arm.forward(np.vstack([motion.at(0.0).q, q, motion.at(duration).q]))[0]  # type: ignore[attr-defined]
        line = p[-1] - p[0]
        length = float(np.linalg.norm(line))
        if length > 1e-6:
            seen.past = max(seen.past, float(((p - p[0]) @ line).max() / length**2 - 1.0))


def compare(law: WayController, motion: Way, seen: Seen) -> None:
    """Take the shortest times of others for the same curve."""
    import toppra
    from toppra import algorithm, constraint

    limits, curve = law.limits, motion.curve
    grid = np.linspace(0.0, 1.0, GRID + 1)
    if curve.coefficients.shape[:2] == (1, 2):  # a line of the joints
        step = curve.derivatives(np.zeros(1))[1, 0]
        least = joints_duration(step, limits)
        if least > 0.0 and not motion.loaded:
            seen.over_ruckig.append(motion.duration / least)
    path = toppra.SplineInterpolator(grid, curve.derivatives(grid)[0])
    held = [
        constraint.JointVelocityConstraint(np.stack([-limits.speed, limits.speed], axis=1)),
        constraint.JointAccelerationConstraint(
            np.stack([-limits.acceleration, limits.acceleration], axis=1)
        ),
    ]
    if motion.loaded:
        most = np.where(np.isfinite(limits.torque), limits.torque, 1e9)
        held.append(
            constraint.JointTorqueConstraint(
                lambda q, v, a: law.arm.torques(q[None], v[None], a[None])[0],
                np.stack([-most, most], axis=1),
                np.zeros(len(most)),
            )
        )
    found = algorithm.TOPPRA(held, path, gridpoints=grid, solver_wrapper="seidel")
    shortest = found.compute_trajectory(0, 0)
    if shortest is not None and shortest.duration > 1e-3:
        seen.over_toppra.append(motion.duration / float(shortest.duration))
        rise = float((limits.acceleration / limits.jerk).max())
        seen.over_jerky.append(motion.duration / with_jerk(float(shortest.duration), rise))


def with_jerk(shortest: float, rise: float) -> float:
    """Return how long a move takes if its acceleration needs a time to come to its limit [s].

    In closed form for a move d = a T^2 / 4 of one joint, which takes T without that: the time of
    toppra, which knows no jerk, plus what the jerk costs where acceleration decides.
    """
    took = rise + math.sqrt(rise**2 + shortest**2)
    return took if took >= 4.0 * rise else 2.0 * (shortest**2 * rise) ** (1.0 / 3.0)


def report(seen: Seen, count: int) -> str:
    """Return the figures in a few lines."""
    ways = ", ".join(f"{number} {name}" for name, number in seen.ways.most_common())
    lines = [
        f"{seen.ways.total()} ways of {count} arms: {ways}",
        f"over their limits by more than 0.1 %: {seen.violations}; largest, in parts of them: "
        f"speed {seen.speed:.4f}, acceleration {seen.acceleration:.4f}, jerk {seen.jerk:.4f}, "
        f"torque {seen.torque:.4f}; outside of position limits {max(0.0, seen.position):.1e} rad; "
        f"past the end of a line {max(0.0, seen.past):.1e} of its length",
    ]
    for name, ratios in (
        ("toppra", seen.over_toppra),
        ("toppra with the time that jerks take", seen.over_jerky),
        ("ruckig", seen.over_ruckig),
    ):
        if ratios:
            low, high = np.percentile(ratios, [50, 99])
            over = int(np.sum(np.array(ratios) > 1.3))
            lines.append(
                f"times over the shortest by {name}: {len(ratios)} ways, median {low:.3f}, 99 % "
                f"below {high:.3f}, largest {max(ratios):.3f}; {over} above 1.3"
            )
    low, high = np.percentile(seen.planning, [50, 99])
    lines.append(
        f"the period in which a target came: median {low * 1e3:.2f} ms, 99 % {high * 1e3:.2f} ms"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
