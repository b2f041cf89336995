"""Hard cases of motion control through the Jacobian: eq. (6) beside the bounded method.

Each case goes through the whole machine, motors, gears and encoders included, but for the random
moves, which ask the control laws alone. What is left of the gears' wind-up at rest is in the
figures: 0.75 mm with ur5, 1 mm with panda.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from arm_emulator import Kinematics, OfflineRun, Pose, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.motion.controller import controller_for
from arm_emulator.motion.motion_config import MotionConfig
from bench.measure import progress
from bench.motion import Array

TITLE = "Hard places of motion control"

METHODS = ("paper", "way")
SETTLING = 0.5  # s of holding before a case begins
EVERY = 0.01  # s between samples of the machine
ARRIVED = 2e-3  # m from the target by the true tool, the wind-up included


@dataclass
class Track:
    """Motion of the true arm: samples since the case began."""

    kinematics: Kinematics
    start: Array
    times: list[float]
    q: list[Array]
    errors: list[Array]  # to the target of that time
    peak: float = 0.0  # joint speed over the description's limit

    @property
    def distances(self) -> Array:
        """Distance of the tool from its target [m]."""
        distances: Array = np.linalg.norm(np.array(self.errors)[:, :3], axis=1)
        return distances

    @property
    def end(self) -> str:
        """The error at the end."""
        error = self.errors[-1]
        words = _metres(float(np.linalg.norm(error[:3])))
        if len(error) > 3:
            words += f", {np.linalg.norm(error[3:]) * 1e3:.1f} mrad"
        return words

    @property
    def arrival(self) -> str:
        """When the tool came within 2 mm for good."""
        away = np.flatnonzero(self.distances > ARRIVED)
        if len(away) and away[-1] == len(self.times) - 1:
            return "not there"
        return f"there after {self.times[away[-1] + 1] if len(away) else 0.0:.2f} s"


Targets = Callable[[Kinematics, float], Pose]


@dataclass(frozen=True)
class Case:
    """A motion, and what is asked of it."""

    name: str
    scene: str
    seconds: float
    targets: Targets
    """The target by the time since the case began [s]."""
    every: float
    """Interval of its publication [s]."""
    outcome: Callable[[Track], str]
    start: tuple[float, ...] | None = None


def at_start(kinematics: Kinematics, scene: str) -> Pose:
    """Return the tool's pose at the start of a scene."""
    R_WT, p_WT = kinematics.forward(load_scene(scene).start)
    return Pose(p_WT, R_WT)


def moved(pose: Pose, way: Array, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Pose:
    """Return a pose moved and turned in the world."""
    return Pose(pose.p_WT + way, pin.exp3(np.array(turn)) @ pose.R_WT)


STRETCHED = (0.3, -1.0, 0.0, 0.4, -1.2, 0.0)
BEYOND = 4.0  # s until the target comes back


def inward(kinematics: Kinematics, t: float) -> Pose:
    """100 mm towards the base from the stretched pose."""
    R_WT, p_WT = kinematics.forward(STRETCHED)
    return Pose(p_WT - 0.1 * p_WT / np.linalg.norm(p_WT), R_WT)


def on_the_axis(kinematics: Kinematics, t: float) -> Pose:
    """Above the shoulder of three_axis: the waist moves the tool no more."""
    return Pose(np.array([0.0, 0.0, 0.75]), np.eye(3))


def there_and_back(kinematics: Kinematics, t: float) -> Pose:
    """1 m beyond the reach, and back."""
    home = at_start(kinematics, "ur5")
    direction = home.p_WT / np.linalg.norm(home.p_WT)
    return Pose(direction * (kinematics.reach + 1.0), home.R_WT) if t < BEYOND else home


def beside_singular(side: float) -> tuple[float, ...]:
    """Return joint angles of ur5 to one side of its wrist's singular pose, wrist_2 at 0."""
    q = load_scene("ur5").start.copy()
    q[0], q[4] = -side * 0.31, side * 0.3
    return tuple(q.tolist())


def past_singular(kinematics: Kinematics, t: float) -> Pose:
    """300 mm to the other side."""
    R_WT, p_WT = kinematics.forward(beside_singular(-1.0))
    return Pose(p_WT, R_WT)


def circle(kinematics: Kinematics, t: float) -> Pose:
    """Ten turns of 2 s about 100 mm, from the tool's start."""
    turn = math.pi * min(t, 20.0)
    return moved(
        at_start(kinematics, "panda"), 0.1 * np.array([math.cos(turn) - 1.0, math.sin(turn), 0.0])
    )


def wave(kinematics: Kinematics, t: float) -> Pose:
    """100 mm to and fro along y, twice a second, for 4 s."""
    way = 0.1 * math.sin(math.pi * t) if t < 4.0 else 0.0
    return moved(at_start(kinematics, "ur5"), np.array([0.0, way, 0.0]))


def reversal(kinematics: Kinematics, t: float) -> Pose:
    """200 mm to one side, and in mid-motion to the other."""
    return moved(at_start(kinematics, "ur5"), np.array([0.0, 0.2 if t < 0.3 else -0.2, 0.0]))


def elbow(track: Track) -> str:
    """Return whether the arm is as it was before it went beyond its reach."""
    change = float(np.abs(track.q[-1] - track.start).max())
    return f"{track.end}; {change:.3f} rad from where it began"


def drift(track: Track) -> str:
    """Return what ten circles have left in the joints."""
    change = track.q[-1] - track.start
    worst = float(np.abs(change).max())
    return f"joint 1 drifts {change[0]:+.3f} rad, the worst {worst:.3f} rad; {track.end}"


def arrival(track: Track) -> str:
    """Return when it was there, and what is left."""
    return f"{track.arrival}; {track.end}"


def lag(track: Track) -> str:
    """Return how far the tool is behind, and how fast the joints get."""
    moving = track.distances[100:400]
    return (
        f"at most {_metres(float(moving.max()))} behind; peak speed {track.peak:.2f} of the limit"
    )


def turned(track: Track) -> str:
    """Return when it was there, and how fast the joints got."""
    return f"{arrival(track)}; peak speed {track.peak:.2f} of the limit"


def cases() -> Iterator[Case]:
    """Yield the cases."""
    never = math.inf
    yield Case("stretched out, 100 mm inward", "ur5", 6.0, inward, never, arrival, STRETCHED)
    yield Case("onto the base's axis", "three_axis", 6.0, on_the_axis, never, arrival)
    yield Case("1 m beyond reach and back", "ur5", 10.0, there_and_back, BEYOND, elbow)
    yield Case(
        "300 mm through the wrist's singular pose", "ur5", 10.0, past_singular, never, arrival,
        beside_singular(1.0),
    )  # fmt: skip
    yield Case("ten circles of 100 mm", "panda", 23.0, circle, 0.05, drift)
    for axis, name in zip(np.eye(3).tolist(), "xyz", strict=True):

        def half(kinematics: Kinematics, t: float, axis: list[float] = axis) -> Pose:
            x, y, z = (math.pi * part for part in axis)
            return moved(at_start(kinematics, "ur5"), np.zeros(3), (x, y, z))

        yield Case(f"half a turn about {name}", "ur5", 10.0, half, never, turned)
    yield Case("200 Hz, 100 mm to and fro", "ur5", 6.0, wave, 0.005, lag)
    yield Case("reversal in mid-motion, 200 mm", "ur5", 5.0, reversal, 0.3, turned)


def run(quick: bool) -> dict[str, Any]:
    """Run each case with both methods."""
    chosen = list(cases())[:: 4 if quick else 1]
    rows = []
    with progress("hard places", len(METHODS) * len(chosen)) as done:
        for case in chosen:
            row = {"case": case.name, "scene": case.scene}
            for method in METHODS:
                row[method] = case.outcome(machine(case, method))
                done(f"{case.name}, {method}")
            rows.append(row)
    rows.append(random_moves(5 if quick else 40))
    return {"rows": rows, "times": motion_periods(200 if quick else 1000)}


def config_of(scene: str, method: str) -> MotionConfig:
    """Return a scene's motion control, or that of eq. (6) as it was before there was another."""
    motion = load_gains(find_scene(scene)).motion
    if method == "paper" and scene != "three_axis":
        return dataclasses.replace(motion, method=method, period=0.05, step_limit=0.02)
    return dataclasses.replace(motion, method=method)


def machine(case: Case, method: str) -> Track:
    """Return what the machine did."""
    file = find_scene(case.scene)
    motion = config_of(case.scene, method)
    servo = dataclasses.replace(load_gains(file).servo, motion_period=motion.period)
    names = load_scene(file).joint_names
    starts = {f"joints.{n}.start": x for n, x in zip(names, case.start or (), strict=False)}
    one = OfflineRun(load_scene(file, starts), servo, motion)
    session, kinematics = one.session, one.controller.kinematics
    period = session.scene.servo_period
    one.advance(round(SETTLING / period))
    track = Track(kinematics, session.state.q.copy(), [], [], [])
    begun, sent = session.logical_ns, -math.inf
    while True:
        t = (session.logical_ns - begun) * 1e-9
        if t >= case.seconds:
            return track
        if t - sent >= case.every - 1e-9:
            target = case.targets(kinematics, t)
            one.instructor.add(session.logical_ns, target)
            sent = t
        if round(t / period) % round(EVERY / period) == 0:
            track.times.append(t)
            track.q.append(session.state.q.copy())
            track.errors.append(kinematics.tool_error(session.state.q, target))
        share = np.abs(session.state.v) / kinematics.velocity_limit
        track.peak = max(track.peak, float(share.max()))
        one.advance(min(round(EVERY / period), round(min(case.every, EVERY) / period)))


def random_moves(count: int) -> dict[str, Any]:
    """Ask both laws for moves of panda from and to random angles, all over its joint limits."""
    scene = load_scene("panda")
    row: dict[str, Any] = {"case": f"{count} moves all over the joint limits", "scene": "panda"}
    for method in METHODS:
        rng, arrived = np.random.default_rng(1), 0
        law = controller_for(scene.urdf, scene.joint_names, config_of("panda", method))
        kinematics = law.kinematics
        for _ in range(count):
            q, end = rng.uniform(kinematics.lower, kinematics.upper, (2, len(scene.start)))
            R_WT, p_WT = kinematics.forward(end)
            target = Pose(p_WT, R_WT)
            law.begin(q)
            period = config_of("panda", method).period
            for _ in range(round(15.0 / period)):
                answer = law.update(q, target)
                q = answer.q if answer.v is None else answer.q + period * answer.v
            arrived += bool(np.abs(kinematics.tool_error(q, target)).max() < 1e-6)
        row[method] = f"{arrived} arrive within 15 s"
    return row


def motion_periods(count: int) -> dict[str, float]:
    """Return the median wall time of a motion period on the way to a target [s], by scene."""
    medians = {}
    for scene_name in ("ur5", "panda"):
        scene = load_scene(scene_name)
        law = controller_for(scene.urdf, scene.joint_names, config_of(scene_name, "way"))
        home, q, spent = at_start(law.kinematics, scene_name), scene.start, []
        law.begin(q)
        for k in range(count):
            if k % 100 == 0:
                target = moved(home, np.array([0.0, 0.15 * (-1) ** (k // 100), 0.1]))
            begun = time.perf_counter()
            answer = law.update(q, target)
            spent.append(time.perf_counter() - begun)
            assert answer.v is not None
            q = answer.q + 0.01 * answer.v
        medians[scene_name] = float(np.median(spent))
    return medians


def _metres(length: float) -> str:
    return f"{length * 1e3:.2f} mm"


def report(figures: dict[str, Any]) -> str:
    """Return the section of the report."""
    lines = [
        "The true tool through motors, gears and encoders; `paper` is eq. (6) with the parameters "
        "that ur5 and panda had with it. The wind-up of the gears (ur5 0.75 mm, panda 1 mm) is in "
        "the figures.",
        "",
        "| case | scene | `paper` | `way` |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {row['case']} | {row['scene']} | {row['paper']} | {row['way']} |"
        for row in figures["rows"]
    ]
    times = ", ".join(f"{name} {t * 1e6:.0f} us" for name, t in figures["times"].items())
    lines += ["", f"A motion period of `way` takes in the median: {times}."]
    return "\n".join(lines)
