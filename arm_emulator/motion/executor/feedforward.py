"""Feed-forward for the servo: speeds, torques, wind-up of the gears."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.drive_parameters import DriveParameters
from arm_emulator.motion.model.elastic_arm import Drive, ElasticArm
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.link_torques import LinkTorques
from arm_emulator.motion.model.rest_load import RestLoad

_TIMES = 4  # each reduces the error to about a thousandth
_APART = 1e-9  # rad or m: rounding of angles that go on from one period to the next


class Feedforward:
    """Computes the servo's targets from the links' motion.

    With `full` these are the angles and speeds of the motors at which the links move as they shall
    (`ElasticArm`). The motors' angles, which are measured, are not those of the links then:
    `compute_link_angles` takes the wind-up off. `RestLoad` observes how heavy the links are.

    Attributes:
        gives: none, speed, torque (and speed), full.
        trouble: why torques are not known though they were asked for; empty: they are, or were not.
        wind_up: by how much the gears are taken to be wound up (N,) [rad]; 0 but with `full`.
    """

    def __init__(self, kinematics: Kinematics, config: MotionConfig) -> None:
        names = kinematics.joint_names
        self.gives = config.gives
        self.trouble = ""
        self.wind_up: Array = np.zeros(len(names))
        self._period = config.period
        self._torques: LinkTorques | None = None
        self._arm: ElasticArm | None = None
        self._before: _Period | None = None
        if self.gives not in ("torque", "full"):
            return
        gravity = config.gravity_x, config.gravity_y, config.gravity_z
        try:
            self._torques = LinkTorques(kinematics.urdf_xml, names, gravity)
        except Refusal as reason:
            self.trouble = str(reason)
            return
        if self.gives == "full":
            drives = [config.drives.get(name, DriveParameters()) for name in names]
            self._arm = ElasticArm(self._torques, drives, kinematics.velocity_limit)
            arm, outboard = self._arm, self._torques.outboard
            self._load = RestLoad(arm.dry, arm.softness, self._period, outboard)
            self._factor = self._load.factor
            self._integral_torque: Array = np.zeros(
                len(names)
            )  # by the servo's integrals, N m, negative
            self._at_rest: Array | None = None  # announced there, N m

    def compute_link_angles(self, q: Array) -> Array:
        """Return the links' angles for measured motors at q (N,) [rad]."""
        if self._arm is not None and self._before is None:
            for _ in range(_TIMES):  # the weight is that at the links' true angles
                weight = self._arm.compute_weight(q - self.wind_up)
                self.wind_up = self._arm.compute_wind_up(self._load.factor * weight)
        return q - self.wind_up

    def compute_rest_angles(self, q: Array) -> Array:
        """Return the links' angles at rest for commanded angles q, (N,) [rad]."""
        measured = q + self.wind_up
        self.reset_estimate()
        return self.compute_link_angles(measured)

    def reset_estimate(self) -> None:
        """Reset for the next motion."""
        self._before = None

    def observe_torques(self, tau: Array | None, movable: npt.NDArray[np.bool_] | None) -> None:
        """Take what the motors give, at the links (N,) [N m], and which joints can move (N,).

        None: not measured; all can.
        """
        if self._arm is None:
            return
        if movable is not None and not movable.all():
            self._integral_torque, self._at_rest = (
                np.where(movable, self._integral_torque, 0.0),
                None,
            )  # as the integrals
            self._load.note_brakes(movable)
            tau = None
        before = self._before
        sound = tau is not None and bool(np.isfinite(tau).all())
        if tau is not None and sound and before is not None and before.rests:
            self._load.observe_rest(tau, self._arm.compute_weight(before.q_end))
        else:
            self._load.note_motion()

    def complete_setpoint(self, instruction: JointSetpoint) -> JointSetpoint:
        """Return the servo's targets for this motion period."""
        if self.gives == "none":
            return JointSetpoint(instruction.q)
        if self._arm is not None:
            return self._complete_full(self._arm, instruction)
        if self.gives == "speed" or instruction.tau is not None or self._torques is None:
            return instruction
        v = np.zeros_like(instruction.q) if instruction.v is None else instruction.v
        return replace(instruction, tau=self._torques.compute_torques(instruction.q, v))

    def _complete_full(self, arm: ElasticArm, instruction: JointSetpoint) -> JointSetpoint:
        q, period = instruction.q, self._period
        mean = np.zeros_like(q) if instruction.v is None else instruction.v
        before = self._before
        if before is not None and (np.abs(before.q_end - q) > _APART).any():
            before = None
        now = instruction.now
        if now is None:  # by the mean speeds of this period and the last
            a = np.zeros_like(q) if before is None else (mean - before.mean) / period
            now = Reference(q, mean - 0.5 * a * period, a)
        jerk = now.jerk
        if jerk is None:
            jerk = np.zeros_like(q) if before is None else (now.a - before.now.a) / period
            now = replace(now, jerk=jerk)
        q_end = q + mean * period
        then = instruction.then or now.extrapolate_to(period, q_end)
        rests = not any(rate.any() for rate in (mean, now.v, now.a, jerk))
        if rests or before is None:
            self._factor = self._load.factor
        factor = self._factor
        begins = (
            arm.compute_drive(now.q, now.v, now.a, jerk, factor) if before is None else before.ends
        )
        ends = arm.compute_drive(
            q_end, then.v, then.a, jerk if then.jerk is None else then.jerk, factor
        )
        self._before = present = _Period(now, mean, q_end, ends, rests)
        self.wind_up = begins.theta - q
        tau = (
            self._compute_torques(arm, begins, present)
            if instruction.tau is None
            else instruction.tau
        )
        return JointSetpoint(begins.theta, (ends.theta - begins.theta) / period, tau, now)

    def _compute_torques(self, arm: ElasticArm, begins: Drive, present: _Period) -> Array:
        """Return the torques of the present period (N,).

        At rest they stay as they are while the factor follows: the servo's integrals hold the rest
        of the weight, and torques that change without a motion would be wrong evidence to it.
        """
        ends = present.ends
        tau = arm.compute_mean_torques(begins, ends, self._period) + self._integral_torque
        if not present.rests:
            self._at_rest = None
            return tau - self._load.release_friction(arm.compute_sliding_share(present.mean))
        weight = arm.compute_mean_torques(ends, ends, self._period)
        if self._at_rest is None:
            self._at_rest = weight + self._integral_torque
            return tau
        self._integral_torque = self._at_rest - weight
        return self._at_rest


@dataclass(frozen=True, eq=False)
class _Period:
    """A commanded motion period."""

    now: Reference
    mean: Array
    """Speeds (N,)."""
    q_end: Array
    ends: Drive
    """Motion of the motors at its end."""
    rests: bool
    """Whether the links rest in it and after it."""
