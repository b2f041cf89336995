"""Residual errors of a target at rest, summed over the parts of a scene, joint by joint.

Each part states its own share (`Part.rests`); no part is known by name here. If a part states none,
there is no prediction, and the part is named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from arm_emulator.analysis.stability import at_rest
from arm_emulator.base.given import FloatArray
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.joint import Joint
from arm_emulator.machine.parts.resting import Around, AtRest, Share, Stuck
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene
from arm_emulator.servo.servo_config import ServoConfig


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
