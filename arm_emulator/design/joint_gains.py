"""Gains of a joint's servo, computed from its data sheets.

Motor, gear and link are two masses and a spring, sampled exactly; the servo is the law that runs
(`LinearServo`). Tried are velocity gains K over two decades and some bandwidths of the observer.
With M the inertia of rotor and heaviest link, both at the link, each K has its

    position_gain = K / (3 M)           integral_time = 5 / position_gain

which place the poles of the slow motion, M s^2 + K s + K position_gain, at a damping of 0.87, and
the integral's well below them. (The cascade of a drive: Gross, Hamann and Wiegaertner, Electrical
Feed Drives in Automation, 2001, chapter 4.) Stiffer is not always better: the rotor has to give way
to the link for its swing to die, so that a mean K is best for every gear. A fast motor cannot give
way, since its back EMF brakes it; then smaller position gains, which excite less, are tried, too.

The search takes the pair whose link settles first after a step of its target. Of the pairs within
`NEARLY` of that time it takes the one whose response to an encoder count is least. A pair must meet
these conditions with the lightest, a mean and the heaviest link, without dead time and with one
more period of it:

- the loop is stable, and disturbances are amplified by `SENSITIVITY` = 2 at most (a gain margin of
  2 and a phase margin of 29 degrees at least; Astrom and Murray, Feedback Systems, 2008, section
  12.2),
- the link overshoots by `OVERSHOOT` at most,
- one count of the encoder changes the current asked for by `KICK` of the current limit at most:
  where a count asks for more than the limit, the joint never comes to rest.
"""

import dataclasses
import functools
import math
from dataclasses import dataclass

import numpy as np

from arm_emulator.analysis.linear_servo import LinearServo
from arm_emulator.analysis.sampled_loop import SampledLoop, SampledPlant
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.design.sizing import round_figure
from arm_emulator.servo.servo_config import CommandPath, JointServo
from arm_emulator.servo.zoh_motor import discretise_zoh

SENSITIVITY = 2.0
OVERSHOOT = 0.1
KICK = 0.25
NEARLY = 0.1
_STEPS = np.geomspace(
    0.01, 0.8, 15
).tolist()  # of speed per period and speed error, the rotor alone
_BANDWIDTHS = (0.5, 0.3, 0.1, 0.03)  # of the observer, per period
_SHARES = (1.0, 0.5, 0.25, 0.12, 0.06)  # of K / (3 M)
# The observer is at least so much faster than the loop of the speed: a slower one sees the
# rotor swing too late, and with the current at its limit the swing then stays.
_OBSERVED = 0.7
_SWINGS = 20  # of the heaviest link on its gear, within which it has to settle
_DELAYS = (0, 1)  # periods
_ROWS = 240  # of a step response
_FREQUENCIES = 60
_IDEAL = 2**20  # counts per turn, as good as none
_HALVINGS = 12
_IF_NEED_BE = ((3.0, 0.3), (10.0, 1.0))  # sensitivity and overshoot


@dataclass(frozen=True)
class MotorData:
    """Winding, rotor and encoder of a motor, as in a scene or a data sheet."""

    resistance: float  # ohm
    inductance: float  # H; 0: the current follows the voltage at once
    torque_constant: float  # N m/A
    back_emf_constant: float  # V s/rad
    rotor_inertia: float  # kg m2, with the gear's primary side
    counts_per_turn: int | None = None  # of the encoder; None: as good as ideal
    current_bandwidth: float = 0.0  # Hz, of the drive's current loop; 0: it takes a voltage
    viscous: float = 0.0  # N m s/rad, friction of the rotor
    torque_bandwidth: float = 0.0  # Hz, of a drive that is commanded a torque, whose current it is


@dataclass(frozen=True)
class GearData:
    """Gear between motor and link. N m (N) are those of the joint, rad (m) as well."""

    ratio: float = 1.0  # link turns per motor turn (m per rad for a prismatic joint)
    stiffness: float | None = None  # N m/rad at the link; None: rigid
    damping: float = 0.0  # N m s/rad at the link


@dataclass(frozen=True)
class ServoGains:
    """Numbers of `JointServo` beside the data sheet."""

    position_gain: float  # 1/s
    velocity_gain: float  # N m s/rad, at the link
    integral_time: float  # s
    observer_bandwidth: float  # rad/s
    link_inertia: float = 0.0  # kg m2, that turns rigidly with the rotor; 0: behind an elastic gear


@functools.lru_cache(maxsize=256)
def compute_gains(
    motor: MotorData,
    gear: GearData,
    link_inertia: tuple[float, float],
    period: float,
    viscous: float = 0.0,
    supply_voltage: float = math.inf,
    current_limit: float = math.inf,
) -> ServoGains:
    """Return gains that hold for every link inertia in a range.

    Where nothing holds all of the above, more sensitivity and overshoot are taken, as little as
    there is.

    Args:
        motor: the motor.
        gear: the gear.
        link_inertia: what the joint moves, over all poses and payloads: the least, the other joints
            free (1 / (M^-1)_jj), and the largest, the others held (M_jj) [kg m2, kg].
        period: servo period [s].
        viscous: friction at the link [N m s/rad].
        supply_voltage: largest voltage at the motor [V].
        current_limit: largest current that the drive asks for [A], by which encoder steps are
            judged; without one, what the supply drives through the winding.

    Raises:
        Refusal: no gains hold this motor at this period; it names one that would do.
    """
    stall = supply_voltage / motor.resistance if motor.resistance else math.inf
    kick = KICK * min(current_limit, stall)
    gains = _search_gains(motor, gear, link_inertia, period, viscous, kick)
    if gains is not None:
        return gains
    valid, shorter = "another motor", period
    for _ in range(_HALVINGS):
        shorter /= 2.0
        if _search_gains(motor, gear, link_inertia, shorter, viscous, kick) is not None:
            valid = f"{shorter:.3g} s"
            break
    rule = "be short enough for motor and gear"
    raise Refusal("servo design", "the servo period", rule, f"{period:g} s", valid)


def _search_gains(
    motor: MotorData,
    gear: GearData,
    link_inertia: tuple[float, float],
    period: float,
    viscous: float,
    kick: float,
) -> ServoGains | None:
    smallest, largest = link_inertia
    rotor = motor.rotor_inertia / gear.ratio**2
    mean = math.sqrt(smallest * largest)
    with_rotor = mean if gear.stiffness is None else 0.0
    plants = [
        make_joint_model(motor, gear, inertia, viscous, period)
        for inertia in sorted({smallest, mean, largest})
    ]
    swing = 0.0 if gear.stiffness is None else 2.0 * math.pi * math.sqrt(largest / gear.stiffness)
    trial = _Trial(motor, gear, plants, period, _SWINGS * swing, kick)
    for share in _SHARES:
        for bandwidth in _BANDWIDTHS:
            for step in reversed(_STEPS):
                velocity_gain = step * (rotor + with_rotor) / period
                position_gain = share * velocity_gain / (3.0 * (rotor + largest))
                if position_gain * period > 0.5 or bandwidth < _OBSERVED * step:
                    continue
                trial.try_gains(
                    ServoGains(
                        round_figure(position_gain),
                        round_figure(velocity_gain),
                        round_figure(max(period, 5.0 / position_gain)),
                        round_figure(bandwidth / period),
                        round_figure(with_rotor),
                    )
                )
    return trial.choose_best()


@dataclass(frozen=True)
class _Outcome:
    """Worst results of gains."""

    gains: ServoGains
    kick: float  # A per count
    sensitivity: float
    overshoot: float
    settling: float  # s


class _Trial:
    """Tries gains on a joint and keeps what holds."""

    def __init__(
        self,
        motor: MotorData,
        gear: GearData,
        plants: list[SampledPlant],
        period: float,
        patience: float,
        kick: float,
    ) -> None:
        self.motor = motor
        self.gear = gear
        self.plants = plants
        self.period = period
        self.patience = patience  # s
        self.kick = kick  # A per count at most
        self.outcomes: list[_Outcome] = []
        self.fastest = math.inf  # s, of those that hold everything

    def try_gains(self, gains: ServoGains) -> None:
        """Take note of gains, unless they do not hold, never settle or are slower than others."""
        try:
            servo = LinearServo(make_joint_servo(self.motor, self.gear, gains), self.period)
        except Refusal:
            return
        count = 2.0 * math.pi / (self.motor.counts_per_turn or _IDEAL)
        kick = servo.current_per_angle * count
        span = max(12.0 / gains.position_gain, self.patience)
        every = max(1, round(span / self.period / _ROWS))
        sensitivity, overshoot, settling = 1.0, 0.0, 0.0
        for plant in reversed(self.plants):  # the heaviest link is the hardest
            for delay in reversed(_DELAYS):
                loop = SampledLoop(plant, [servo], delay)
                if not loop.is_stable:
                    return
                rows = loop.compute_step_response(0, _ROWS, every)[:, 0]
                off = np.flatnonzero(np.abs(rows - 1.0) > 0.02)
                settling = max(settling, float(off[-1] + 1) * every * self.period)
                if off[-1] == _ROWS - 1 or settling > (1.0 + NEARLY) * self.fastest:
                    return
                overshoot = max(overshoot, float(rows.max()) - 1.0)
                if delay:
                    _, S = loop.compute_sensitivities(_FREQUENCIES)
                    sensitivity = max(sensitivity, float(np.abs(S).max()))
        self.outcomes.append(_Outcome(gains, kick, sensitivity, overshoot, settling))
        if sensitivity <= SENSITIVITY and overshoot <= OVERSHOOT and kick <= self.kick:
            self.fastest = min(self.fastest, settling)

    def choose_best(self) -> ServoGains | None:
        """Return the best of what was tried; None where nothing holds."""
        quiet = [outcome for outcome in self.outcomes if outcome.kick <= self.kick]
        for sensitivity, overshoot in ((SENSITIVITY, OVERSHOOT), *_IF_NEED_BE):
            for among in (quiet, self.outcomes):
                good = [
                    outcome
                    for outcome in among
                    if outcome.sensitivity <= sensitivity and outcome.overshoot <= overshoot
                ]
                if good:
                    first = min(outcome.settling for outcome in good)
                    near = [
                        outcome for outcome in good if outcome.settling <= (1.0 + NEARLY) * first
                    ]
                    return min(near, key=lambda outcome: outcome.kick).gains
        return None


def make_joint_servo(
    motor: MotorData, gear: GearData, gains: ServoGains, name: str = "joint"
) -> JointServo:
    """Return a joint's servo without limits."""
    return JointServo(
        name=name,
        gear_ratio=gear.ratio,
        counts_per_turn=motor.counts_per_turn or _IDEAL,
        resistance=motor.resistance,
        inductance=motor.inductance,
        torque_constant=motor.torque_constant,
        back_emf_constant=motor.back_emf_constant,
        rotor_inertia=motor.rotor_inertia,
        current_bandwidth=motor.current_bandwidth,
        torque_bandwidth=motor.torque_bandwidth,
        velocity_limit=1e6,
        **dataclasses.asdict(gains),
    )


def make_joint_model(
    motor: MotorData, gear: GearData, link_inertia: float, viscous: float, period: float
) -> SampledPlant:
    """Return one joint: motor, gear and a link that nothing else moves."""
    bandwidth = motor.torque_bandwidth or motor.current_bandwidth
    R, L, Kb = CommandPath.compute_path(
        motor.resistance, motor.inductance, motor.back_emf_constant, bandwidth
    )
    Kt = motor.torque_constant
    Dv, Ng, Kg, Dg = motor.viscous, gear.ratio, gear.stiffness, gear.damping
    # States i, theta, omega, q, v.
    A, B = np.zeros((5, 5)), np.zeros((5, 1))
    A[1, 2] = A[3, 4] = 1.0
    if Kg is None:
        inertia = motor.rotor_inertia + Ng**2 * link_inertia
        A[2, [0, 2]] = Kt / inertia, -(Dv + Ng**2 * viscous) / inertia
        columns = [0, 1, 2]
    else:
        Mm = motor.rotor_inertia
        A[2] = Kt / Mm, -(Ng**2) * Kg / Mm, -(Dv + Ng**2 * Dg) / Mm, Ng * Kg / Mm, Ng * Dg / Mm
        A[4, 1:] = np.array([Ng * Kg, Ng * Dg, -Kg, -Dg - viscous]) / link_inertia
        columns = [0, 1, 2, 3, 4]
    current, by_voltage = np.zeros(5), 0.0
    if L > 1e-6 * R * period:
        A[0, [0, 2]] = -R / L, -Kb / L
        B[0] = 1.0 / L
        current[0] = 1.0
    else:  # i = (V - Kb omega) / R
        current[2], by_voltage = -Kb / R, 1.0 / R
        B[2] = A[2, 0] * by_voltage
        A[2] += A[2, 0] * current
        columns = columns[1:]
    unit: Array = np.eye(5)[:, columns]
    return SampledPlant(
        *discretise_zoh(unit.T @ A @ unit, unit.T @ B, period),
        unit[1:2],
        current[None] @ unit,
        np.array([by_voltage]),
        unit[3:4] if Kg is not None else Ng * unit[1:2],
        period,
    )
