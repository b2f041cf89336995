"""Cascaded position and velocity control of geared motors, from encoder counts and currents alone.

Per joint and servo period, in motor quantities:

    measure    theta = (counts + 1/2) 2 pi / counts_per_turn      the middle of the count
    observe    theta, omega, load from theta, current, voltage    tracking observer
    position   omega_ref = v_target / Ng + Kp (q_target / Ng - theta), 0 within the count
    velocity   i_ref = Kv (omega_ref - omega) + integral + tau_feedforward Ng / Kt
    current    V such that the mean current of the coming period is i_ref - c (i_ref - i)

The last stage is exact for winding and rotor (held_motor.py), so that the law holds for motors
slower and faster than the period alike. For slow ones V = R i_ref + Kb omega + Rc (i_ref - i).

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

from servo_node.held_motor import Sum, held_motor
from servo_node.servo_config import JointServo, ServoConfig, load_servo_config
from words.bound import CURRENT, EFFORT, POSITION, VELOCITY, VOLTAGE, Bound
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
        self._axes = self._axes_of(config)
        self._zeros = [0.0] * len(self._axes)
        self._counts = config.counts.named("counts")
        self.restarts = 0
        """How often the state of a joint was no longer finite, and began anew."""

    @staticmethod
    def _axes_of(config: ServoConfig) -> list[_Axis]:
        period, supply_voltage = config.period, config.supply_voltage
        return [axis_of(joint, period, supply_voltage) for joint in config.joints]

    def reset(self) -> None:
        """Forget everything; the next measurement starts the observer where the motor stands."""
        for axis in self._axes:
            axis.reset()

    def retune(self, config: ServoConfig) -> None:
        """Go on with other gains and limits; what was observed and the integrals stay.

        Raises:
            Refusal: as the constructor. Nothing has changed then.
        """
        axes = self._axes_of(config)
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
        voltage: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Return the voltages for the period that begins now: `observe`, then `control`.

        Raises:
            Refusal: a wrong length, or a value that is not finite or too large. Nothing has changed
                then.
        """
        measured = self._measurement(counts, current, voltage)
        wanted = self._targets(q_target, v_target, tau_feedforward)
        self._observe(*measured)
        return self._control(*wanted)

    def observe(
        self,
        counts: npt.ArrayLike,
        current: npt.ArrayLike,
        voltage: npt.ArrayLike | None = None,
    ) -> None:
        """Take this period's measurement.

        Args:
            counts: encoder counts, (N,) whole numbers.
            current: motor currents, (N,) [A].
            voltage: what the drives applied in the period that ends now, (N,) [V]; None: what
                `control` returned last, 0 after `release`.

        Raises:
            Refusal: a wrong length, or a value that is not finite or too large. Nothing has changed
                then.
        """
        self._observe(*self._measurement(counts, current, voltage))

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

    def _observe(
        self, counts: list[float], current: list[float], voltage: list[float] | None
    ) -> None:
        if voltage is None:
            voltage = [axis.voltage for axis in self._axes]
        for axis, *row in zip(self._axes, counts, current, voltage, strict=True):
            axis.observe(*row)
            if not math.isfinite(axis.theta + axis.omega + axis.load + axis.unknown_voltage):
                self._begin_anew(axis)

    def _control(self, q: list[float], v: list[float], tau: list[float]) -> FloatArray:
        voltages = [axis.control(*row) for axis, *row in zip(self._axes, q, v, tau, strict=True)]
        for j, axis in enumerate(self._axes):
            if not math.isfinite(voltages[j] + axis.integral):
                self._begin_anew(axis)
                axis.voltage = voltages[j] = 0.0
        return np.array(voltages)

    def _begin_anew(self, axis: _Axis) -> None:
        axis.start(axis.current if math.isfinite(axis.current) else 0.0)
        self.restarts += 1

    def _measurement(
        self, counts: npt.ArrayLike, current: npt.ArrayLike, voltage: npt.ArrayLike | None
    ) -> tuple[list[float], list[float], list[float] | None]:
        return (
            self._vector(counts, self._counts),
            self._vector(current, CURRENT),
            None if voltage is None else self._vector(voltage, VOLTAGE),
        )

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


def axis_of(joint: JointServo, period: float, supply_voltage: float) -> _Axis:
    """Return the observer and control of a joint.

    Raises:
        Refusal: coefficients that are not finite, or a winding and a rotor that swing together so
            fast that a voltage held for a period cannot control the current.
    """
    axis = _finite_axis(joint, period, supply_voltage)
    if axis is None:
        rule = "have data that finite coefficients of the control law follow from"
        raise Refusal("servo", f"joint {joint.name}", rule, joint)
    if axis.current_kept > _MOST_KEPT:
        rule = (
            f"have a winding and a rotor that do not swing together faster than a period of "
            f"{period:g} s can control"
        )
        got = (
            f"L / R = {joint.inductance / joint.resistance:.3g} s, R Mm / (Kt Kb) = "
            f"{_time_constant(joint):.3g} s"
        )
        raise Refusal("servo", f"joint {joint.name}", rule, got, _period_that_holds(joint, period))
    return axis


_MOST_KEPT = 0.9  # of a current error over a period


def _finite_axis(joint: JointServo, period: float, supply_voltage: float) -> _Axis | None:
    try:
        axis = _Axis(joint, period, supply_voltage)
    except ArithmeticError:
        return None
    return axis if all(math.isfinite(value) for value in axis.coefficients()) else None


def _time_constant(joint: JointServo) -> float:
    """Return how fast the motor runs up by itself [s]."""
    torque_per_speed = joint.torque_constant * joint.back_emf_constant / joint.resistance
    return joint.inertia / torque_per_speed if torque_per_speed else math.inf


def _period_that_holds(joint: JointServo, period: float) -> str:
    for _ in range(_HALVINGS):
        period /= 2.0
        axis = _finite_axis(joint, period, 1.0)
        if axis is not None and axis.current_kept <= _MOST_KEPT:
            return f"a period of {period:.3g} s"
    return "another motor"


_HALVINGS = 30


class _Axis:
    """Observer and control of one joint, in motor quantities and plain floats."""

    __slots__ = (
        "count_angle",
        "counts",
        "current",
        "current_kept",
        "current_limit",
        "current_memory",
        "current_voltage",
        "emf",
        "integral",
        "load",
        "load_gain",
        "mean_current",
        "motor",
        "omega",
        "omega_gain",
        "omega_limit",
        "position_gain",
        "ratio",
        "reset_rate",
        "theta",
        "theta_gain",
        "theta_measured",
        "torque_constant",
        "unknown_voltage",
        "velocity_gain",
        "voltage",
        "voltage_limit",
        "winding",
        "wrap",
    )

    STATE = (
        "counts",
        "theta_measured",
        "theta",
        "omega",
        "load",
        "current",
        "integral",
        "voltage",
        "unknown_voltage",
    )

    def __init__(self, joint: JointServo, period: float, supply_voltage: float) -> None:
        self.ratio = joint.gear_ratio
        self.count_angle = 2.0 * math.pi / joint.counts_per_turn
        self.wrap = 2.0**joint.encoder_bits if joint.encoder_bits else 0.0
        self.torque_constant = joint.torque_constant
        self.emf = joint.back_emf_constant
        self.omega_limit = joint.velocity_limit / abs(joint.gear_ratio)
        self.current_limit = joint.current_limit
        self.voltage_limit = supply_voltage
        self.position_gain = joint.position_gain
        # Link torque per link speed -> motor current per motor speed.
        self.velocity_gain = joint.velocity_gain * joint.gear_ratio**2 / joint.torque_constant
        self.reset_rate = period / joint.integral_time
        self.motor = held_motor(
            joint.resistance,
            joint.inductance,
            joint.torque_constant,
            joint.back_emf_constant,
            joint.inertia,
            period,
        )
        self._set_current_loop(joint, period)
        self._set_observer(math.exp(-joint.observer_bandwidth * period))
        self.reset()

    def _set_current_loop(self, joint: JointServo, period: float) -> None:
        """Set what the voltage follows from.

        Over one period the winding alone keeps the part z = exp(-R T / L) of a current error; the
        law keeps z / 2, which also stands one period of dead time (then the poles solve
        p^2 - z p + z / 2 = 0, |p| = sqrt(z / 2) < 0.71). The mean current of the period is then off
        by `current_memory` of the error at its start.
        """
        y = joint.inductance / joint.resistance / period
        z = math.exp(-1.0 / y) if y else 0.0
        start = (1.0 - z) * y  # share of the current at the start in the mean, at a given voltage
        share = 0.5 * z / (1.0 - z)
        self.current_memory = start - (1.0 - start) * share
        # The largest voltage that the current limit leaves, beside the back EMF and the current.
        self.winding = joint.resistance * share
        self.current_voltage = joint.resistance + self.winding
        # The mean current is the change of speed and the load that it has carried.
        speed, to_current = self.motor.speed, joint.inertia / joint.torque_constant / period
        self.mean_current = Sum(
            to_current * speed.current,
            to_current * (speed.speed - 1.0),
            to_current * speed.voltage,
            to_current * speed.load + 1.0 / joint.torque_constant,
        )
        # What is left of a current error after a period: z / 2 where the motor is slow.
        current, per_volt = self.motor.current, 1.0 / self.mean_current.voltage
        self.current_kept = abs(
            current.current
            + current.voltage * per_volt * (self.current_memory - self.mean_current.current)
        )

    def _set_observer(self, p: float) -> None:
        """Place the poles of the observer, p = exp(-observer_bandwidth T).

        Its errors in angle, speed and load go on by a matrix of rows (1, b, c), (0, a, d) and
        (0, 0, 1) and are then corrected by gains times the error in angle; the gains are those for
        which the characteristic polynomial is (z - p)^2 (z - r). A slow motor has a = 1, and r = p:
        this is the g-h-k filter with fading memory (Brookner, Tracking and Kalman Filtering Made
        Easy, 1998, section 1.3). The faster the motor, the more of an error in speed is gone by
        itself.
        """
        motor = self.motor
        a = motor.speed.speed - motor.speed_per_surplus * motor.current.speed
        b = motor.turn.speed - motor.turn_per_surplus * motor.current.speed
        c = motor.turn.load - motor.turn_per_surplus * motor.current.load
        d = motor.speed.load - motor.speed_per_surplus * motor.current.load
        kept = 1.0 - abs(a) * (1.0 - p)
        r = a * kept
        self.theta_gain = 1.0 - p * p * kept
        self.load_gain = (1.0 - p) ** 2 * (1.0 - r) / (b * d + c * (1.0 - a))
        self.omega_gain = (2.0 + a - 2.0 * p - r - self.theta_gain - c * self.load_gain) / b

    def coefficients(self) -> tuple[float, ...]:
        """Return what the law multiplies and divides by."""
        motor = self.motor
        sums = (motor.current, motor.speed, motor.turn, self.mean_current)
        return (
            self.ratio,
            1.0 / self.ratio,
            self.omega_limit,
            self.velocity_gain,
            self.reset_rate,
            self.current_kept,
            self.current_memory,
            self.current_voltage,
            1.0 / self.mean_current.voltage,
            self.theta_gain,
            self.omega_gain,
            self.load_gain,
            1.0 / self.torque_constant,
            motor.speed_per_surplus,
            motor.turn_per_surplus,
            motor.voltage_per_surplus,
            *(value for one in sums for value in one),
        )

    def reset(self) -> None:
        """Forget the past."""
        self.counts = 0.0
        self.theta_measured = math.nan
        self.theta = math.nan
        self.omega = math.nan
        self.load = 0.0
        self.current = 0.0
        self.integral = 0.0
        self.voltage = 0.0
        self.unknown_voltage = 0.0

    def observe(self, count: float, current: float, voltage: float) -> None:
        """Follow angle, speed and load torque of the motor.

        Predicts over the past period, takes what the measured current adds to that, then corrects
        by the encoder. A plain difference of counts would step by a whole count per period (6 rad/s
        at 1024 counts and 1 ms).
        """
        if self.wrap:
            count = self.unwrapped(count)
        self.take((count + 0.5) * self.count_angle, current, voltage)

    def unwrapped(self, word: float) -> float:
        """Return the counts of an absolute encoder that are next to those before; next to 0 first.

        So a motor may turn by less than half a word in a servo period.
        """
        turned = (word - self.counts + 0.5 * self.wrap) % self.wrap - 0.5 * self.wrap
        self.counts += turned
        return self.counts

    def take(self, theta: float, current: float, voltage: float) -> None:
        """Follow a motor that was measured at an angle [rad]."""
        self.theta_measured = theta
        if self.theta != self.theta:  # NaN: the first measurement
            self.start(current)
            return
        motor = self.motor
        known = (self.current, self.omega, voltage, self.load)
        surplus = current - motor.current.of(*known)
        self.unknown_voltage = motor.voltage_per_surplus * surplus
        self.theta += motor.turn.of(*known) + motor.turn_per_surplus * surplus
        self.omega = motor.speed.of(*known) + motor.speed_per_surplus * surplus
        innovation = self.theta_measured - self.theta
        self.theta += self.theta_gain * innovation
        self.omega += self.omega_gain * innovation
        self.load += self.load_gain * innovation
        self.current = current

    def start(self, current: float) -> None:
        """Take the motor as standing in the middle of its count, its load held by its current."""
        self.theta = self.theta_measured
        self.omega = 0.0
        self.load = self.torque_constant * current
        self.current = current
        self.integral = current
        self.unknown_voltage = 0.0

    def control(self, q_target: float, v_target: float, tau: float) -> float:
        """Return the voltage for the period that begins now [V]."""
        theta_target = q_target / self.ratio
        within_count = abs(theta_target - self.theta_measured) <= 0.5 * self.count_angle
        error = 0.0 if within_count else theta_target - self.theta
        omega_ref = clip(v_target / self.ratio + self.position_gain * error, self.omega_limit)

        feedforward = tau * self.ratio / self.torque_constant
        i_ref = self.velocity_gain * (omega_ref - self.omega) + self.integral + feedforward
        i_ref = clip(i_ref, self.current_limit)

        current, memory, mean = self.current, self.current_memory, self.mean_current
        free = mean.of(current, self.omega, 0.0, self.load)  # at 0 V
        wanted = (i_ref - memory * (i_ref - current) - free) / mean.voltage
        # No voltage that lets the current beyond its limit within the period. What the model did
        # not know in the last period, an observed speed that lags for one, counts here: the winding
        # turns a few volts into many amperes.
        middle = self.emf * self.omega - self.unknown_voltage - self.winding * current
        span = self.current_voltage * self.current_limit
        voltage = clip(min(max(wanted, middle - span), middle + span), self.voltage_limit)
        if voltage != wanted:  # what current the limits leave of the reference
            i_ref = (mean.voltage * voltage + free - memory * current) / (1.0 - memory)
        # Automatic reset: with no limit active this is the integral of Kv error / integral_time.
        self.integral += self.reset_rate * (i_ref - feedforward - self.integral)
        self.voltage = voltage
        return voltage

    def release(self) -> None:
        """Forget what torque the motor was held with; it gets no voltage."""
        self.integral = 0.0
        self.voltage = 0.0


def clip(value: float, limit: float) -> float:
    """Return `value` limited to [-limit, limit]."""
    return -limit if value < -limit else limit if value > limit else value
