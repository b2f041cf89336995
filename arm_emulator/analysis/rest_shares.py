"""What the parts of a scene leave of a target at rest, summed up joint by joint.

Each part states its own share (`Part.rests`). This sums them, and knows no part by name: where one
states none, there is no prediction, and the part is named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from arm_emulator.analysis.stability import at_rest
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.encoder import IDEAL_COUNTS_PER_TURN, Encoder
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.resting import Around, AtRest, Share
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Joint, Scene
from arm_emulator.servo.servo_config import ServoConfig

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RestShares:
    """Of all joints, base to tool (N,): rad of the links, m where they slide.

    `ahead` is by how much the servo takes the links to be ahead of where they are, `stuck` by how
    much it may leave its targets alone.
    """

    ahead: FloatArray
    ahead_within: FloatArray
    ahead_spread: FloatArray
    stuck_within: FloatArray
    stuck_spread: FloatArray
    angle_noise: FloatArray  # of the motors [rad]
    current_noise: FloatArray  # of the motors [A]


def rest_shares(
    scene: Scene, servo: ServoConfig, q: FloatArray, seconds: float, times: float = 1.0
) -> RestShares:
    """Return what is left in a pose.

    Args:
        scene: the machine.
        servo: that holds it.
        q: where the joints shall be (N,) [rad or m].
        seconds: for which the servo has held the joints there.
        times: by how much the motion controller multiplies what the servo leaves.

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
            torque=float(torque),
            torque_within=0.0,
            torque_spread=0.0,
            stiffness=stiffness,
            integral=stiffness / law.integral_time * max(seconds, servo.period),
            count=law.count_angle,
        )
        rows.append(_of_joint(scene, joint, at, times))
    return RestShares(*np.array(rows).T)


def _of_joint(scene: Scene, joint: Joint, at: AtRest, times: float) -> tuple[float, ...]:
    first = _ask(scene, joint, at)
    torque = _sum([share.torque for share in first])
    stuck = _sum([share.stuck for share in first])
    known = replace(
        at,
        theta_within=times * stuck.within / abs(at.ratio),
        torque=at.torque - torque.centre,  # what other parts put on the link the gear need not
        torque_within=torque.within,
        torque_spread=torque.spread,
    )
    shares = _ask(scene, joint, known)
    ahead = _sum([share.ahead for share in shares])
    stuck = _sum([share.stuck for share in shares])
    noise = [sum(getattr(share, name) for share in shares)
             for name in ("angle_noise", "current_noise")]  # fmt: skip
    return ahead.centre, ahead.within, ahead.spread, stuck.within, stuck.spread, *noise


def _ask(scene: Scene, joint: Joint, at: AtRest) -> list[Share]:
    sensors: dict[str, Part] = {"encoder": Encoder(counts_per_turn=IDEAL_COUNTS_PER_TURN)}
    parts = [*joint.parts, *(sensors | joint.sensors.parts).values()]
    shares = []
    for part in parts:
        share = part.rests(at)
        if isinstance(share, str):
            raise _declined(scene, joint, part.section, share)
        shares.append(share)
    return shares


def _sum(numbers: list[Around]) -> Around:
    return Around(
        sum(one.centre for one in numbers),
        sum(one.within for one in numbers),
        float(np.sqrt(sum(one.spread**2 for one in numbers))),
    )


def _count_angle(joint: Joint) -> float:
    return 2.0 * np.pi / joint.counts_per_turn * abs(joint.gear.ratio)


def _declined(scene: Scene, joint: Joint, part: str, why: str) -> Refusal:
    rule = "state what they leave of a target at rest"
    return Refusal(scene.where, f"parts of {joint.name}", rule, f"{part}: {why}")
