"""The servo of an arm: what comes from outside is checked, then servo.c does the rest."""

import copy
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.synchronized import Synchronized, synchronized
from arm_emulator.base.validation.bound import COMMAND, CURRENT, EFFORT, POSITION, VELOCITY
from arm_emulator.base.validation.number import Number
from arm_emulator.servo.servo_config import (
    JointServo,
    ServoConfig,
    check_joints,
    load_servo_config,
)
from arm_emulator.servo.servo_law import SERVO, Rows, servo_law
from arm_emulator.servo.servo_numbers import make_servo_numbers
from arm_emulator.toolchain.c_header import NULL, CData, make_pointer

__all__ = ["JointServo", "Servo", "ServoConfig", "load_servo_config"]

Places = tuple[CData, CData, CData]  # pointers to arrays; NULL: not given

_APPLIED = COMMAND.rename("applied")
_Q_TARGET = POSITION.rename("q_target")
_V_TARGET = VELOCITY.rename("v_target")
_TAU = EFFORT.rename("tau_feedforward")
# Of the struct `servo`, beside its arrays and its watchdog.
_SCALARS = tuple(
    name for name, of in SERVO.ffi.typeof("servo").fields if of.type.kind == "primitive"
)


class Servo(Synchronized):
    """All joints of an arm under cascaded control, see arm_emulator/servo/c/servo.h.

    Arrays are (N,) in the order of ``config.joints``. Call once in every servo period `update`, or
    its two halves: `observe` when the measurement is there, `control` when the target is.

    If the observer or the integral of a joint is no longer finite, the joint begins anew at the
    motor's position. It is commanded 0 for that period, and is counted in `restarts`. Within the
    bounds of base/validation/bound.py only a data sheet of impossible numbers can cause this.

    Attributes:
        config: data-sheet values, gains and limits.
        arm: pointer to the struct that the law works on.
        state: what each joint remembers, (N,) rows of ``servo_state``.
        places: where the law finds counts, current, applied, q, v, tau, and puts commands.

    Args:
        config: data-sheet values, gains and limits, or what `load_servo_config` takes.

    Raises:
        Refusal: numbers of a data sheet that cannot be computed with, or no such file.
    """

    def __init__(self, config: ServoConfig | str | Path) -> None:
        super().__init__()
        if isinstance(config, str | Path):
            config = load_servo_config(config)
        if not isinstance(config, ServoConfig):
            raise Refusal("Servo", "config", "be a ServoConfig, a name or a file", config)
        self.config = config
        self._law = servo_law()
        self._N = len(config.joints)
        self._joint = self._compute_numbers(config)
        self.state: Rows = SERVO.make_rows("servo_state", self._N)
        self.arm = SERVO.make_struct("servo", joints=self._N, joint=self._joint, state=self.state)
        self._counts = config.counts.rename("counts")
        self._is_measured = self.state["known"]
        # Fixed arrays for the law's inputs and outputs: finding an array's address costs time.
        self._integer_counts = np.zeros(self._N, np.int64)
        self._rows = np.zeros((6, self._N))
        self.places = (make_pointer(self._integer_counts), *map(make_pointer, self._rows))
        self._measured, self._movable = np.zeros((3, self._N)), np.zeros(self._N, np.int64)
        self._reported = (*map(make_pointer, self._measured), make_pointer(self._movable))
        self._law.servo_reset(self.arm)

    def __repr__(self) -> str:
        return f"<Servo of {', '.join(self.config.joint_names)}>"

    @synchronized
    def __getstate__(self) -> dict[str, Any]:
        scalars = {name: copy.copy(getattr(self.arm, name)) for name in _SCALARS}
        watchdog = bytes(SERVO.ffi.buffer(SERVO.ffi.addressof(self.arm, "watchdog")))
        rows = {
            name: getattr(self, name).copy()
            for name in ("state", "_integer_counts", "_rows", "_joint")
        }
        return {"config": self.config, "scalars": scalars, "watchdog": watchdog, "rows": rows}

    def __setstate__(self, of: dict[str, Any]) -> None:
        Servo.__init__(self, of["config"])
        self.go_back(of)

    def go_back(self, of: dict[str, Any]) -> None:
        """Go on from what `__getstate__` of this servo, or of one like it, has returned."""
        self.config = of["config"]
        for name, rows in of["rows"].items():
            getattr(self, name)[:] = rows
        SERVO.fill_struct(self.arm, **of["scalars"])
        SERVO.ffi.buffer(SERVO.ffi.addressof(self.arm, "watchdog"))[:] = of["watchdog"]

    def __copy__(self) -> Self:
        return copy.deepcopy(self)

    @staticmethod
    def _compute_numbers(config: ServoConfig) -> Rows:
        return make_servo_numbers(config.joints, config.period, config.supply_voltage)

    @property
    def restarts(self) -> int:
        """Number of restarts of a joint's observer because its state was not finite."""
        return int(self.arm.restarts)

    @synchronized
    def reset(self) -> None:
        """Forget everything; the next measurement starts the observer where the motor stands."""
        self._law.servo_reset(self.arm)

    @synchronized
    def retune(self, config: ServoConfig) -> None:
        """Go on with other gains and limits; what was observed and the integrals stay.

        Raises:
            Refusal: as the constructor, or other joints. Nothing has changed then.
        """
        now = self.config
        check_joints("Servo.retune", config, now.joint_names)
        if (now.period, now.supply_voltage) != (config.period, config.supply_voltage):
            self._joint[:] = self._compute_numbers(config)
        else:  # most often a few joints of many are other ones
            pairs = zip(now.joints, config.joints, strict=True)
            places = [place for place, (before, after) in enumerate(pairs) if before is not after]
            changed = tuple(config.joints[place] for place in places)
            self._joint[places] = make_servo_numbers(changed, config.period, config.supply_voltage)
        self.config = config

    @property
    @synchronized
    def q_measured(self) -> Array:
        """Link angles by the encoders, the middle of the count, (N,) [rad]; NaN before any."""
        return self._read_at_links(0)

    @property
    @synchronized
    def v_measured(self) -> Array:
        """Link speeds by the observer, (N,) [rad/s]; NaN before any count."""
        return self._read_at_links(1)

    @property
    @synchronized
    def tau_measured(self) -> Array:
        """Loads of the motors by the observer, at the links, (N,) [N m]; NaN before any count."""
        return self._read_at_links(2)

    def _read_at_links(self, row: int) -> Array:
        self._law.servo_report(self.arm, 1, *self._reported)
        measured: Array = self._measured[row]
        return measured.copy() if self._is_measured[0] else measured * np.nan

    def movable(self, powered: bool) -> npt.NDArray[np.bool_]:
        """Return which joints can be moved, see `ServoArm.movable`."""
        self._law.servo_report(self.arm, powered, *self._reported)
        return np.asarray(self._movable != 0)

    @synchronized
    def update(
        self,
        counts: npt.ArrayLike,
        current: npt.ArrayLike,
        q_target: npt.ArrayLike,
        v_target: npt.ArrayLike | None = None,
        tau_feedforward: npt.ArrayLike | None = None,
        applied: npt.ArrayLike | None = None,
    ) -> Array:
        """Return the commands for the period that begins now: `observe`, then `control`.

        Raises:
            Refusal: a wrong length, or a value that is not finite or too large. Nothing has changed
                then.
        """
        measured = self.take_measurement(counts, current, applied)
        target_rows = self.take_targets(q_target, v_target, tau_feedforward)
        self._law.servo_observe(self.arm, *measured)
        return self._compute_command(target_rows)

    @synchronized
    def observe(
        self,
        counts: npt.ArrayLike,
        current: npt.ArrayLike,
        applied: npt.ArrayLike | None = None,
    ) -> None:
        """Take this period's measurement.

        Args:
            counts: encoder counts, (N,) whole numbers.
            current: motor currents, (N,) [A].
            applied: what the motors got in the period that ends now, (N,) [V, N m, A]; None: what
                `control` returned last, 0 after `release`.

        Raises:
            Refusal: a wrong length, or a value that is not finite or too large. Nothing has changed
                then.
        """
        self._law.servo_observe(self.arm, *self.take_measurement(counts, current, applied))

    @synchronized
    def control(
        self,
        q_target: npt.ArrayLike,
        v_target: npt.ArrayLike | None = None,
        tau_feedforward: npt.ArrayLike | None = None,
    ) -> Array:
        """Return the commands for the period that began with the last measurement.

        Args:
            q_target: link angles wanted, (N,) [rad].
            v_target: link speeds that belong to them, (N,) [rad/s]; None: 0.
            tau_feedforward: link torques known beforehand, e.g. of gravity, (N,) [N m]; None: 0.

        Returns:
            Of the motors, (N,) [V, N m, A], within what the drives can give.

        Raises:
            Refusal: a wrong length, a value that is not finite or too large, or nothing was
                measured yet. Nothing has changed then.
        """
        target_rows = self.take_targets(q_target, v_target, tau_feedforward)
        if not self._is_measured[0]:
            raise Refusal("servo", "control", "follow a measurement", "none since the reset")
        return self._compute_command(target_rows)

    @synchronized
    def release(self) -> None:
        """Report that the motors get no command; control will start without an integral again."""
        self._law.servo_release(self.arm)

    def _compute_command(self, target_rows: Places) -> Array:
        self._law.servo_control(self.arm, *target_rows, self.places[6])
        return self.command

    @property
    def commanded(self) -> Array:
        """The newest commands (N,), as the memory into which the law writes them."""
        row: Array = self._rows[5]
        return row

    @property
    @synchronized
    def command(self) -> Array:
        """The newest commands, (N,) [V, N m, A], as a copy."""
        command: Array = self._rows[5].copy()
        return command

    def take_measurement(
        self, counts: npt.ArrayLike, current: npt.ArrayLike, applied: npt.ArrayLike | None
    ) -> Places:
        """Return where counts, currents and what was applied lie for the law.

        Raises:
            Refusal: see `observe`.
        """
        numbers = self.check_vector(counts, self._counts)
        self._integer_counts[:] = numbers
        if (self._integer_counts != numbers).any():
            raise Refusal("servo", "counts", "be whole numbers", numbers.tolist())
        applied_row = None if applied is None else self.check_vector(applied, _APPLIED)
        return (
            self.places[0],
            self._fill_row(0, self.check_vector(current, CURRENT)),
            self._fill_row(1, applied_row),
        )

    def take_targets(
        self,
        q_target: npt.ArrayLike,
        v_target: npt.ArrayLike | None,
        tau_feedforward: npt.ArrayLike | None,
    ) -> Places:
        """Return where angles, speeds and torques lie for the law.

        Raises:
            Refusal: see `control`.
        """
        q = self.check_vector(q_target, _Q_TARGET)
        v = None if v_target is None else self.check_vector(v_target, _V_TARGET)
        tau = None if tau_feedforward is None else self.check_vector(tau_feedforward, _TAU)
        return self._fill_row(2, q), self._fill_row(3, v), self._fill_row(4, tau)

    def _fill_row(self, row: int, values: Array | None) -> CData:
        if values is None:
            return NULL
        self._rows[row] = values
        return self.places[row + 1]

    def check_vector(self, values: npt.ArrayLike, bound: Number) -> Array:
        """Return `values` as N numbers within the bound."""
        return bound.check_row("servo", values, self._N)
