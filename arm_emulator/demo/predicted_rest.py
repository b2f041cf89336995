"""Predicted rest of the tool beside its target, computed before the arm moves.

The motion controller moves an arm whose joints follow it exactly; their final positions are the
targets of the joints. The deviation is the sum of the contributions of the scene's parts
(`rest_shares`), mapped by the Jacobian.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

import numpy as np

from arm_emulator.analysis.servo_loop import ServoLoops
from arm_emulator.analysis.stability import at_rest
from arm_emulator.base.given import FloatArray
from arm_emulator.base.refusal import Refusal
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.machine.joint import Joint
from arm_emulator.machine.parts.resting import Around, AtRest, Share, Stuck
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene
from arm_emulator.motion.controller import Controller, controller_for
from arm_emulator.motion.instructor import Instructor
from arm_emulator.motion.jacobian import JacobianController
from arm_emulator.motion.kinematics import POSITION_ROWS
from arm_emulator.motion.pose import Pose
from arm_emulator.runs.gains import Gains
from arm_emulator.servo.servo_config import ServoConfig

# One in this many machines rests farther off than predicted; number of machines drawn.
ONE_OF, DRAWN = 200, 30_000
LITTLE = 0.1  # of the width of a prediction: negligible beside it


class Arrival(enum.Enum):
    """Final state of the motion controller if every joint follows it."""

    REACHED = "reached"
    UNREACHABLE = "unreachable"
    NOT_YET = "not yet there"


@dataclass(frozen=True, eq=False)
class PredictedRest:
    """Target minus true tool at rest. Rows as the task: translation [m], then rotation [rad]."""

    centre: FloatArray
    within: FloatArray
    """Bound of each row's distance from its centre."""
    radius: float
    """Bound of the tool's distance from the centre [m]."""
    reference: FloatArray
    """Share of the motion controller itself in the centre."""
    arrival: Arrival

    @property
    def total(self) -> FloatArray:
        """Bound on the size of the whole deviation, (rows,)."""
        return np.abs(self.centre) + self.within

    def contains(self, residual: FloatArray) -> bool:
        """Whether a deviation of the tool (3,) [m] is within."""
        return bool(np.linalg.norm(residual - self.centre[:POSITION_ROWS]) <= self.radius)


def predicted_rest(scene: Scene, gains: Gains, plan: DemoPlan) -> PredictedRest:
    """Return the predicted rest of the tool at the end of a plan.

    Raises:
        Refusal: a part of the scene does not state its share.
    """
    controller = controller_for(scene.urdf, scene.joint_names, gains.motion)
    kinematics = controller.kinematics
    R_WT, p_WT = kinematics.forward(scene.start)
    # Through the quaternion, as in a message, for the same rounding.
    goal = p_WT + plan.displacement
    target = Pose.from_quaternion(goal, Pose(p_WT, R_WT).quaternion(), "displacement")
    way, wound = _reference(controller, gains, plan, scene.start, target)
    q, period, times = way[-1], gains.motion.period, _times_held(controller)
    count = np.array(gains.servo.count_angles(scene.joint_names))
    away = np.flatnonzero((np.abs(way - q) > 2.0 * count).any(axis=1))
    arrived = int(away[-1]) + 1 if len(away) else 0
    shares = rest_shares(scene, gains.servo, q, (len(way) - 1 - arrived) * period, times)
    reference = kinematics.tool_error(q - wound, target)
    centre = kinematics.tool_error(q - shares.centre, target)
    within, radius = _spread(scene, gains, controller, q, shares)
    moved = np.linalg.norm(kinematics.forward(way[-1])[1] - kinematics.forward(way[-2])[1])
    arrival = Arrival.REACHED
    if moved > LITTLE * radius:
        arrival = Arrival.NOT_YET
    elif np.linalg.norm(reference[:POSITION_ROWS]) > LITTLE * radius:
        arrival = Arrival.UNREACHABLE
    return PredictedRest(centre, within, radius, reference, arrival)


def _reference(
    controller: Controller, gains: Gains, plan: DemoPlan, start: FloatArray, target: Pose
) -> tuple[FloatArray, FloatArray]:
    """Return the joint targets at each instruction, for joints that follow at once.

    Also return the assumed wind-up of the gears at the last one (N,).
    """
    instructor, period_ns = Instructor(gains.motion), round(gains.motion.period * 1e9)
    instructor.add(period_ns, target)
    way = [start]
    still = np.zeros_like(start)
    for k in range(plan.instructions + 1):
        instruction = instructor.instruct(controller, k * period_ns, way[-1], still)
        way.append(instruction.q)
    return np.array(way), instructor.wound


def _spread(
    scene: Scene, gains: Gains, controller: Controller, q: FloatArray, shares: RestShares
) -> tuple[FloatArray, float]:
    """Return `within` and `radius`: the bounds that 1 of 200 drawn machines exceeds.

    Each machine has its own values of all unknown contributions, by the distributions of the parts.
    """
    kinematics, rng = controller.kinematics, np.random.default_rng(0)
    off = shares.draw(rng, DRAWN)
    noise = _unrest(scene, gains, controller, q, shares)
    if noise.any():
        off = off + rng.multivariate_normal(np.zeros(len(q)), noise, DRAWN)
    rows = off @ kinematics.jacobian(q).T
    share = 1.0 - 1.0 / ONE_OF
    # The tool moves by terms of second order in all deviations, too, times the reach: see
    # `oracles.predicted_residual`.
    bounds = shares.within.sum()
    second = np.full(rows.shape[1], bounds * (0.5 * bounds + np.abs(shares.centre).sum()))
    second[:POSITION_ROWS] *= kinematics.reach
    within = np.quantile(np.abs(rows), share, axis=0) + second
    distances = np.linalg.norm(rows[:, :POSITION_ROWS], axis=1)
    return within, float(np.quantile(distances, share) + second[0])


def _unrest(
    scene: Scene, gains: Gains, controller: Controller, q: FloatArray, shares: RestShares
) -> FloatArray:
    """Return the covariance of the joints by the noise of sensors (N, N)."""
    if not shares.angle_noise.any() and not shares.current_noise.any():
        return np.zeros((len(q), len(q)))
    loop = ServoLoops(scene, gains.servo, [q]).loops[0]
    noise = shares.angle_noise, shares.current_noise
    if not isinstance(controller, JacobianController):
        return loop.unrest(*noise)
    # Its targets follow measured angles: w of the error is removed, from 1 - w of the angle.
    periods = round(gains.motion.period / gains.servo.period)
    return loop.unrest_of_followers(*noise, scene.gear_ratios, 1.0 - controller.weight, periods)


def _times_held(controller: Controller) -> float:
    """Return the factor by which the controller amplifies the servo's error of a target."""
    return 1.0 / controller.weight if isinstance(controller, JacobianController) else 1.0


# Each part states its own share (`Part.rests`); no part is known by name here. If a part states
# none, there is no prediction, and the part is named.


@dataclass(frozen=True, eq=False)
class RestShares:
    """Shares of all joints, base to tool: rad of the links, m for prismatic joints.

    `ahead` is the error of the servo's measurement of the links, `stuck` the distance from their
    targets at which they may stick.
    """

    ahead: tuple[Around, ...]
    stuck: tuple[Stuck, ...]
    angle_noise: FloatArray  # of the motors (N,) [rad]
    current_noise: FloatArray  # of the motors (N,) [A]

    @property
    def centre(self) -> FloatArray:
        """Known values of `ahead` (N,)."""
        return np.array([one.centre for one in self.ahead])

    @property
    def within(self) -> FloatArray:
        """Bounds of the links' deviations beside that (N,), without noise."""
        stuck = [max(one.short, one.beyond) for one in self.stuck]
        return np.array([one.within for one in self.ahead]) + stuck

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Return by how much the links may stop short of their targets beyond that, (count, N)."""
        columns = []
        for ahead, stuck in zip(self.ahead, self.stuck, strict=True):
            side = rng.choice([-1.0, 1.0], count)
            short = side * rng.uniform(-stuck.beyond, stuck.short, count)
            columns.append(short + sum(one.draw(rng, side) for one in ahead.unknown))
        return np.array(columns).T


def rest_shares(
    scene: Scene, servo: ServoConfig, q: FloatArray, seconds: float, times: float = 1.0
) -> RestShares:
    """Return the residual errors in a pose.

    Args:
        scene: the machine.
        servo: the servo that holds it.
        q: target of the joints (N,) [rad or m].
        seconds: time for which the servo has held the joints there.
        times: factor by which the motion controller amplifies the servo's error.

    Raises:
        Refusal: a part states no share; it is named.
    """
    weight = at_rest(Plant(scene), q)[1]
    of_servo = {joint.name: joint for joint in servo.joints}
    rows = []
    for joint, angle, torque in zip(scene.joints, q, weight, strict=True):
        law = of_servo[joint.name]
        if abs(law.count_angle - _count_angle(joint)) > 1e-9 * law.count_angle:
            raise _declined(scene, joint, "the servo", "takes another gear or encoder for it")
        stiffness = law.velocity_gain * law.position_gain
        at = AtRest(
            q=float(angle),
            theta=float(angle) / joint.gear.ratio,
            theta_within=0.0,
            start=joint.start / joint.gear.ratio,
            ratio=joint.gear.ratio,
            rigid=joint.gear.stiffness is None,
            torque=Around(float(torque)),
            stiffness=stiffness,
            integral=stiffness / law.integral_time * max(seconds, servo.period),
            count=law.count_angle,
        )
        rows.append(_of_joint(scene, joint, at, times))
    ahead, stuck, angle_noise, current_noise = zip(*rows, strict=True)
    return RestShares(ahead, stuck, np.array(angle_noise), np.array(current_noise))


def _of_joint(
    scene: Scene, joint: Joint, at: AtRest, times: float
) -> tuple[Around, Stuck, float, float]:
    first = _ask(scene, joint, at)
    torque, stuck = _sum(first, times)[1:]
    known = replace(
        at,
        theta_within=max(stuck.short, stuck.beyond) / abs(at.ratio),
        # The gear need not transmit the torques of other parts on the link.
        torque=Around(at.torque.centre - torque.centre, torque.scaled(-1.0).unknown),
    )
    shares = _ask(scene, joint, known)
    ahead, _, stuck = _sum(shares, times)
    angle, current = (sum(getattr(share, name) for share in shares)
                      for name in ("angle_noise", "current_noise"))  # fmt: skip
    return ahead, stuck, angle, current


def _ask(scene: Scene, joint: Joint, at: AtRest) -> list[Share]:
    shares = []
    for part in (*joint.parts, *joint.sensors.measuring.values()):
        share = part.rests(at)
        if isinstance(share, str):
            raise _declined(scene, joint, part.section, share)
        shares.append(share)
    return shares


def _sum(shares: list[Share], times: float) -> tuple[Around, Around, Stuck]:
    """Return `ahead`, `torque` and `stuck` of all parts together.

    The motion controller amplifies the servo's error. A joint that has slipped past its target
    stays there.
    """
    ahead, torque, stuck = Around(), Around(), Stuck()
    for share in shares:
        ahead, torque, stuck = ahead + share.ahead, torque + share.torque, stuck | share.stuck
    return ahead, torque, replace(stuck, short=times * stuck.short)


def _count_angle(joint: Joint) -> float:
    return 2.0 * np.pi / joint.counts_per_turn * abs(joint.gear.ratio)


def _declined(scene: Scene, joint: Joint, part: str, why: str) -> Refusal:
    rule = "state their contribution to the error at rest"
    return Refusal(scene.where, f"parts of {joint.name}", rule, f"{part}: {why}")
