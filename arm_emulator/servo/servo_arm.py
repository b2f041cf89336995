"""The servo under its watchdog, with and without joint targets: servo.c does it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.bound import BRAKE_CLOSED
from arm_emulator.servo.servo import Servo, ServoConfig
from arm_emulator.servo.servo_law import SERVO, servo_law
from arm_emulator.servo.watchdog import DOES, Watchdog, WatchdogState
from arm_emulator.toolchain.c_header import NULL, make_pointer


@dataclass(frozen=True)
class Target:
    """Joint targets of one moment, (N,) each in the servo's order of joints."""

    q: Array
    """Link angles [rad]."""
    v: Array | None = None
    """Link speeds [rad/s], with which the angles go on; None: 0."""
    tau: Array | None = None
    """Link torques known beforehand [N m]; None: 0."""


class ServoArm:
    """All drives of an arm: follow the newest target, hold without one, or command nothing.

    Per servo period `take_measurement` once, `set_target` when a target comes, then
    `compute_commands`.

    A target that has a speed goes on with it until the next one comes, for one motion period at
    most: q + v (t - t_target). So the angles asked for are a line from target to target and no
    stairs. Without a motion period the time of the next target is unknown, and the angles stand.
    """

    def __init__(self, config: ServoConfig) -> None:
        self.servo = Servo(config)
        self._law = servo_law()
        arm = self.servo.arm
        arm.motion_period = round(config.motion_period * 1e9)
        self._watchdog = Watchdog(
            config.hold_after, config.cut_after, SERVO.ffi.addressof(arm, "watchdog")
        )
        self._powered = True
        self.reset()

    def reset(self) -> None:
        """Forget everything; power that was cut comes back."""
        self.servo.reset()
        self._requested = False

    def save(self) -> dict[str, Any]:
        """Return all that decides how the drives go on, gains included, for `restore`."""
        return {
            "servo": self.servo.__getstate__(),
            "asked": self._requested,
            "powered": self._powered,
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Go on from what `save` of these drives has returned."""
        self.servo.go_back(saved["servo"])
        self._requested, self._powered = saved["asked"], saved["powered"]

    def set_config(self, config: ServoConfig) -> None:
        """Change gains, limits and timeouts, between two ticks.

        Raises:
            Refusal: see `Servo.retune`. Nothing has changed then.
        """
        self.servo.retune(config)
        self._watchdog.set_times(config.hold_after, config.cut_after)

    def take_measurement(
        self,
        time_ns: int,
        counts: npt.ArrayLike,
        current: npt.ArrayLike,
        applied: npt.ArrayLike | None = None,
        closed: npt.ArrayLike | None = None,
    ) -> None:
        """Take this period's measurement.

        Args:
            time_ns: logical time [ns].
            counts: see `Servo.observe`, as for the others.
            current: [A].
            applied: what the motors got in the period that ends now [V, N m, A].
            closed: which brakes are closed, 1 or 0 (N,); None: all are open.

        Raises:
            Refusal: see `Servo.observe`. Nothing has changed then.
        """
        servo = self.servo
        places = servo.take_measurement(counts, current, applied)
        if closed is not None:
            closed = servo.check_vector(closed, BRAKE_CLOSED).astype(np.int64)
        brakes = NULL if closed is None else make_pointer(closed)
        self._law.servo_measure(servo.arm, time_ns, *places, brakes)

    def movable(self, powered: bool) -> npt.NDArray[np.bool_]:
        """Return which joints can be moved (N,), and could since the newest target.

        They cannot without power or with a closed brake.
        """
        return self.servo.movable(powered)

    def set_target(self, target: Target) -> None:
        """Take new joint targets, from this period on.

        Raises:
            Refusal: see `Servo.control`. Nothing has changed then.
        """
        servo = self.servo
        places = servo.take_targets(target.q, target.v, target.tau)
        self._law.servo_aim(servo.arm, *places)

    def compute_commands(self, powered: bool) -> Array:
        """Return the commands for the period that began with the last measurement, (N,).

        Args:
            powered: whether the drives have power; without it the motors turn no matter what.
        """
        servo = self.servo
        assert servo.arm.measured, "measure first"
        self._law.servo_command(servo.arm, powered, servo.places[6])
        self.note_command(powered)
        return servo.command

    def note_command(self, powered: bool) -> None:
        """Take note of a ``servo_command``, for `reason`."""
        self._requested, self._powered = True, powered

    @property
    def state(self) -> WatchdogState:
        """Action of the last `compute_commands`."""
        return DOES[self.servo.arm.does]

    @property
    def reason(self) -> str:
        """The same in words."""
        if not self._requested:
            return "starting"
        if not self._powered and self._watchdog.state is not WatchdogState.CUT:
            return "the drives' power is off"
        return self._watchdog.reason
