"""Cascaded position and velocity control of geared motors, from encoder counts and currents alone.

Per joint and servo period, in motor quantities:

    measure    theta = (counts + 1/2) 2 pi / counts_per_turn      the middle of the count
    observe    theta, omega, load from theta and current          tracking observer
    position   omega_ref = v_target / Ng + Kp (q_target / Ng - theta), 0 within the count
    velocity   i_ref = Kv (omega_ref - omega) + integral + tau_feedforward Ng / Kt
    current    V = R i_ref + Kb omega + Rc (i_ref - i)

Every stage is limited (speed, current, supply voltage), and the integral follows the current that
the limits have left over (automatic reset), so that it cannot wind up.

"Within the count": as drives that are commanded in counts do, the servo asks for no correction
where the target lies in the very count that the encoder shows. An encoder cannot tell positions
within a count apart, and integral action on a difference that cannot be measured would hunt for
ever. So the servo guarantees, at rest, a measured angle within half a count of the target, and no
more.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from servo_node.servo_config import JointServo, ServoConfig, load_servo_config
from words.bound import CURRENT, EFFORT, POSITION, VELOCITY, Bound, encoder_counts
from words.refusal import Refusal

__all__ = ["JointServo", "Servo", "ServoConfig", "load_servo_config"]

FloatArray = npt.NDArray[np.float64]

_Q_TARGET = POSITION.named("q_target")
_V_TARGET = VELOCITY.named("v_target")
_TAU = EFFORT.named("tau_feedforward")


class Servo:
    """All joints of an arm under cascaded control.

    Arrays are (N,) in the order of ``config.joints``. Call once in every servo period `update`, or
    its two halves: `observe` when the measurement is there, `control` when the target is.

    A joint whose observer or integral is no longer finite begins anew where the motor stands, gets
    0 V for that period, and is counted in `restarts`. Within the bounds of words/bound.py
    only a data sheet of impossible numbers can lead there.

    Args:
        config: data-sheet values, gains and limits.

    Raises:
        Refusal: numbers of a data sheet that cannot be computed with.
    """

    def __init__(self, config: ServoConfig) -> None:
        self.config = config
        self._axes = [_axis(joint, config.period, config.supply_voltage) for joint in config.joints]
        self._zeros = [0.0] * len(self._axes)
        self._counts = encoder_counts([j.count_angle for j in config.joints]).named("counts")
        self.restarts = 0
        """How often the state of a joint was no longer finite, and began anew."""

    def reset(self) -> None:
        """Forget everything; the next measurement starts the observer where the motor stands."""
        for axis in self._axes:
            axis.reset()

    def retune(self, config: ServoConfig) -> None:
        """Go on with other gains and limits; what was observed and the integrals stay.

        Raises:
            Refusal: as the constructor. Nothing has changed then.
        """
        axes = [_axis(joint, config.period, config.supply_voltage) for joint in config.joints]
        for new, old in zip(axes, self._axes, strict=True):
            for name in _Axis.STATE:
                setattr(new, name, getattr(old, name))
        self.config, self._axes = config, axes

    @property
    def q_measured(self) -> FloatArray:
        """Link angles by the encoders, the middle of the count, (N,) [rad]; NaN before any."""
        return np.array([axis.theta_measured * axis.ratio for axis in self._axes])

    @property
    def v_measured(self) -> FloatArray:
        """Link speeds by the observer, (N,) [rad/s]; NaN before any count."""
        return np.array([axis.omega * axis.ratio for axis in self._axes])

    def update(
        self,
        counts: npt.ArrayLike,
        current: npt.ArrayLike,
        q_target: npt.ArrayLike,
        v_target: npt.ArrayLike | None = None,
        tau_feedforward: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Return the voltages for the period that begins now: `observe`, then `control`.

        Raises:
            Refusal: a wrong length, or a value that is not finite or too large. Nothing has changed
                then.
        """
        measured = self._measurement(counts, current)
        wanted = self._targets(q_target, v_target, tau_feedforward)
        self._observe(*measured)
        return self._control(*wanted)

    def observe(self, counts: npt.ArrayLike, current: npt.ArrayLike) -> None:
        """Take this period's measurement.

        Args:
            counts: encoder counts, (N,) whole numbers.
            current: motor currents, (N,) [A].

        Raises:
            Refusal: a wrong length, or a value that is not finite or too large. Nothing has changed
                then.
        """
        self._observe(*self._measurement(counts, current))

    def control(
        self,
        q_target: npt.ArrayLike,
        v_target: npt.ArrayLike | None = None,
        tau_feedforward: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Return the voltages for the period that began with the last measurement.

        Args:
            q_target: link angles wanted, (N,) [rad].
            v_target: link speeds that belong to them, (N,) [rad/s]; None: 0.
            tau_feedforward: link torques known beforehand, e.g. of gravity, (N,) [N m]; None: 0.

        Returns:
            Motor voltages, (N,) [V], within the supply voltage.

        Raises:
            Refusal: a wrong length, a value that is not finite or too large, or nothing was
                measured yet. Nothing has changed then.
        """
        wanted = self._targets(q_target, v_target, tau_feedforward)
        if math.isnan(self._axes[0].theta):
            raise Refusal("servo", "control", "follow a measurement", "none since the reset")
        return self._control(*wanted)

    def release(self) -> None:
        """Tell that the motors get no voltage; control will start without an integral again."""
        for axis in self._axes:
            axis.release()

    def _observe(self, counts: list[float], current: list[float]) -> None:
        for axis, count, amps in zip(self._axes, counts, current, strict=True):
            axis.observe(count, amps)
            if not math.isfinite(axis.theta + axis.omega + axis.load):
                self._begin_anew(axis)

    def _control(self, q: list[float], v: list[float], tau: list[float]) -> FloatArray:
        voltages = [axis.control(*row) for axis, *row in zip(self._axes, q, v, tau, strict=True)]
        for j, axis in enumerate(self._axes):
            if not math.isfinite(voltages[j] + axis.integral):
                self._begin_anew(axis)
                voltages[j] = 0.0
        return np.array(voltages)

    def _begin_anew(self, axis: _Axis) -> None:
        axis.start(axis.current if math.isfinite(axis.current) else 0.0)
        self.restarts += 1

    def _measurement(
        self, counts: npt.ArrayLike, current: npt.ArrayLike
    ) -> tuple[list[float], list[float]]:
        return self._vector(counts, self._counts), self._vector(current, CURRENT)

    def _targets(
        self,
        q_target: npt.ArrayLike,
        v_target: npt.ArrayLike | None,
        tau_feedforward: npt.ArrayLike | None,
    ) -> tuple[list[float], list[float], list[float]]:
        return (
            self._vector(q_target, _Q_TARGET),
            self._zeros if v_target is None else self._vector(v_target, _V_TARGET),
            self._zeros if tau_feedforward is None else self._vector(tau_feedforward, _TAU),
        )

    def _vector(self, values: npt.ArrayLike, bound: Bound) -> list[float]:
        """Return `values` as N Python floats within the bound."""
        # Python floats: for N below about 20 a loop over them beats NumPy's call overhead.
        result: list[float] = bound.vector("servo", values, len(self._axes)).tolist()
        return result


def _axis(joint: JointServo, period: float, supply_voltage: float) -> _Axis:
    """Return a joint whose coefficients are all finite."""
    try:
        axis = _Axis(joint, period, supply_voltage)
        if all(math.isfinite(value) for value in axis.coefficients()):
            return axis
    except ArithmeticError:
        pass
    rule = "have data that finite coefficients of the control law follow from"
    raise Refusal("servo", f"joint {joint.name}", rule, joint)


class _Axis:
    """Observer and control of one joint, in motor quantities and plain floats."""

    __slots__ = (
        "back_emf",
        "count_angle",
        "current",
        "current_gain",
        "current_limit",
        "inertia",
        "integral",
        "load",
        "load_gain",
        "omega",
        "omega_gain",
        "omega_limit",
        "period",
        "position_gain",
        "ratio",
        "reset_rate",
        "resistance",
        "theta",
        "theta_gain",
        "theta_measured",
        "torque_constant",
        "velocity_gain",
        "voltage_limit",
    )

    STATE = ("theta_measured", "theta", "omega", "load", "current", "integral")

    def __init__(self, joint: JointServo, period: float, supply_voltage: float) -> None:
        self.period = period
        self.ratio = joint.gear_ratio
        self.count_angle = 2.0 * math.pi / joint.counts_per_turn
        self.inertia = joint.rotor_inertia
        self.torque_constant = joint.torque_constant
        self.resistance = joint.resistance
        self.back_emf = joint.back_emf_constant
        self.omega_limit = joint.velocity_limit / joint.gear_ratio
        self.current_limit = joint.current_limit
        self.voltage_limit = supply_voltage
        self.position_gain = joint.position_gain
        # Link torque per link speed -> motor current per motor speed.
        self.velocity_gain = joint.velocity_gain * joint.gear_ratio**2 / joint.torque_constant
        self.reset_rate = period / joint.integral_time
        # Rc [ohm]: over one period the winding alone keeps the part z = exp(-R T / L) of a current
        # error; with Rc it keeps z / 2, which also stands one period of dead time (then the poles
        # solve p^2 - z p + z / 2 = 0, |p| = sqrt(z / 2) < 0.71).
        z = math.exp(-joint.resistance * period / joint.inductance) if joint.inductance else 0.0
        self.current_gain = 0.5 * z / (1.0 - z) * joint.resistance
        # Critically damped third-order tracker, all poles at p (the g-h-k filter with fading
        # memory; Brookner, Tracking and Kalman Filtering Made Easy, 1998, section 1.3).
        p = math.exp(-joint.observer_bandwidth * period)
        self.theta_gain = 1.0 - p**3
        self.omega_gain = 1.5 * (1.0 - p**2) * (1.0 - p) / period
        self.load_gain = (1.0 - p) ** 3 / period**2 * self.inertia
        self.reset()

    def coefficients(self) -> tuple[float, ...]:
        """Return what the law multiplies and divides by."""
        return (
            self.ratio,
            1.0 / self.ratio,
            self.omega_limit,
            self.velocity_gain,
            self.reset_rate,
            self.current_gain,
            1.0 / (self.resistance + self.current_gain),
            self.theta_gain,
            self.omega_gain,
            self.load_gain,
            1.0 / self.inertia,
            1.0 / self.torque_constant,
        )

    def reset(self) -> None:
        """Forget the past."""
        self.theta_measured = math.nan
        self.theta = math.nan
        self.omega = math.nan
        self.load = 0.0
        self.current = 0.0
        self.integral = 0.0

    def observe(self, count: float, current: float) -> None:
        """Follow angle, speed and load torque of the motor.

        Predicts over the past period by ``Mm domega/dt = Kt i - load`` with the mean of the two
        measured currents, then corrects by the encoder. A plain difference of counts would step by
        a whole count per period (6 rad/s at 1024 counts and 1 ms).
        """
        self.theta_measured = (count + 0.5) * self.count_angle
        if self.theta != self.theta:  # NaN: the first measurement
            self.start(current)
            return
        torque = 0.5 * self.torque_constant * (self.current + current)
        change = self.period * (torque - self.load) / self.inertia
        self.theta += self.period * (self.omega + 0.5 * change)
        self.omega += change
        innovation = self.theta_measured - self.theta
        self.theta += self.theta_gain * innovation
        self.omega += self.omega_gain * innovation
        self.load -= self.load_gain * innovation
        self.current = current

    def start(self, current: float) -> None:
        """Take the motor as standing in the middle of its count, its load held by its current."""
        self.theta = self.theta_measured
        self.omega = 0.0
        self.load = self.torque_constant * current
        self.current = current
        self.integral = current

    def control(self, q_target: float, v_target: float, tau: float) -> float:
        """Return the voltage for the period that begins now [V]."""
        theta_target = q_target / self.ratio
        within_count = abs(theta_target - self.theta_measured) <= 0.5 * self.count_angle
        error = 0.0 if within_count else theta_target - self.theta
        omega_ref = clip(v_target / self.ratio + self.position_gain * error, self.omega_limit)

        feedforward = tau * self.ratio / self.torque_constant
        i_ref = self.velocity_gain * (omega_ref - self.omega) + self.integral + feedforward
        i_ref = clip(i_ref, self.current_limit)

        emf = self.back_emf * self.omega
        wanted = self.resistance * i_ref + emf + self.current_gain * (i_ref - self.current)
        voltage = clip(wanted, self.voltage_limit)
        if voltage != wanted:  # what current the supply leaves of the reference
            i_ref = (voltage - emf + self.current_gain * self.current) / (
                self.resistance + self.current_gain
            )
        # Automatic reset: with no limit active this is the integral of Kv error / integral_time.
        self.integral += self.reset_rate * (i_ref - feedforward - self.integral)
        return voltage

    def release(self) -> None:
        """Forget what torque the motor was held with."""
        self.integral = 0.0


def clip(value: float, limit: float) -> float:
    """Return `value` limited to [-limit, limit]."""
    return -limit if value < -limit else limit if value > limit else value
