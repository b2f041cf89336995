"""Machine and servos as one loop: whether it is stable, by what margin, and what would hold.

The machine is linearised about rest in a pose (`SmallMotions`) and sampled exactly, the servo is
the law that runs without its limits (`LinearServo`). So this is what small motions do, apart from
Coulomb friction, which only takes energy, and the steps of the encoders.
"""

from __future__ import annotations

import dataclasses
import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from arm_emulator.analysis.linear_servo import LinearServo
from arm_emulator.analysis.sampled_loop import Margins, SampledLoop, SampledPlant
from arm_emulator.analysis.stability import SmallMotions, list_contacts
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.urdf_text import UNLIMITED
from arm_emulator.base.warning import print_warnings
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.servo.servo_config import JointServo, ServoConfig
from arm_emulator.servo.zoh_motor import discretise_zoh

HARMLESS = 0.1  # 1/s: what grows more slowly, e-fold in ten seconds, is drift
FREE_TURN = math.pi  # rad either way, where a joint has no limits
FREE_SLIDE = 0.5  # m
POSES = 8  # that are looked at, the start among them
LITTLE_GAIN = 1.6  # 4 dB
LITTLE_PHASE = math.radians(25.0)
LITTLE_DELAY = 1.0  # servo periods: what a real-time network takes
_TRIALS = 8  # halvings of a gain or a period, in search of one that holds


def draw_poses(scene: Scene, count: int = POSES) -> list[Array]:
    """Return the start and poses drawn within the limits of the URDF, the same every time."""
    limits = {}
    for joint in ET.fromstring(scene.urdf).iter("joint"):
        limit, kind = joint.find("limit"), joint.get("type")
        if limit is not None and kind in ("revolute", "prismatic"):
            lower, upper = (float(limit.get(key, "0")) for key in ("lower", "upper"))
            if max(-lower, upper) >= UNLIMITED:
                free = FREE_SLIDE if kind == "prismatic" else FREE_TURN
                lower, upper = max(lower, -free), min(upper, free)
            limits[joint.get("name")] = (lower, upper)
    turn = (-FREE_TURN, FREE_TURN)
    low, high = np.array([limits.get(name, turn) for name in scene.joint_names]).T
    samples = np.random.default_rng(0).uniform(low, np.maximum(low, high), (count - 1, len(low)))
    return [scene.start, *samples]


def sample_plant(
    motions: SmallMotions, servo: ServoConfig, period: float, braked: int | None = None
) -> SampledPlant:
    """Return the machine over a servo period, its motor angles as its encoders measure.

    Args:
        motions: the machine.
        servo: whose encoders.
        period: [s].
        braked: the joint whose brake is closed; None: no joint's.
    """
    scene = motions.scene
    n = len(motions.J)
    q = np.eye(n)[motions.q]
    counts = {joint.name: joint.counts_per_turn for joint in servo.joints}
    # A servo that is set up for another encoder takes the angle for another one.
    scale = np.array([[joint.counts_per_turn / counts[joint.name]] for joint in scene.joints])
    J, B = (motions.J, motions.B) if braked is None else motions.apply_brake(braked)
    return SampledPlant(
        *discretise_zoh(J, B, period),
        scale * motions.theta_m,
        motions.current,
        motions.current_by_command,
        q,
        period,
    )


def count_delay_periods(scene: Scene) -> int:
    """Return by how many servo periods the latest sensor comes of those that our servos use."""
    sensors = [joint.sensors for joint in scene.joints]
    used = [
        part for sensor in sensors for part in (sensor.encoder, sensor.current) if part is not None
    ]
    return max((part.delay for part in used), default=0)


class ServoLoops:
    """The loop of a scene with its servos, in some poses.

    Args:
        scene: the machine; every joint has a motor.
        servo: names the scene's joints, in any order.
        at: poses (N,) [rad or m]; None: those of `draw_poses`.
        delay: servo periods of dead time, beside that of the scene's sensors.

    Raises:
        Refusal: as `Servo`, or a joint without a motor.
    """

    def __init__(
        self,
        scene: Scene,
        servo: ServoConfig,
        at: list[Array] | None = None,
        delay: int = 0,
    ) -> None:
        self.scene = scene
        by_name = {joint.name: joint for joint in servo.joints}
        self.joints = [by_name[name] for name in scene.joint_names]
        self.servo = servo
        self.delay = delay = delay + count_delay_periods(scene)
        self.poses = draw_poses(scene) if at is None else at
        plant = Plant(scene)
        self._motions = [
            SmallMotions(plant, q, loaded) for loaded in list_contacts(plant) for q in self.poses
        ]
        # With play first all poses with teeth in contact, then all without.
        self._all = self.close_loops(self.joints, servo.period, delay)
        self.loops = self._all[: len(self.poses)]

    def close_loops(self, joints: list[JointServo], period: float, delay: int) -> list[SampledLoop]:
        """Return the loops with other gains or another period, one per pose, with play two."""
        servos = [LinearServo(joint, period) for joint in joints]
        return [
            SampledLoop(sample_plant(motions, self.servo, period), servos, delay)
            for motions in self._motions
        ]

    def compute_margins(self) -> list[Margins]:
        """Return each joint's worst margins over the poses."""
        every = [loop.compute_margins() for loop in self._all]
        return [
            Margins(
                min(margins.gain_up for margins in row),
                max(margins.gain_down for margins in row),
                min(margins.phase for margins in row),
                min(margins.delay for margins in row),
                max(margins.sensitivity for margins in row),
            )
            for row in zip(*every, strict=True)
        ]

    def find_unstable(self) -> Unstable | None:
        """Return what grows fastest, None where all small motions die away or only drift."""
        beyond = self._compute_excess_growth(self._all, self.servo.period)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= HARMLESS:
            return None
        loop = self._all[worst]
        pose = worst % len(self.poses)
        return Unstable(
            loop.find_loudest(), pose, loop.radius, *self._find_stable_gains(loop.find_loudest())
        )

    def _compute_excess_growth(self, loops: list[SampledLoop], period: float) -> list[float]:
        """Return how fast small motions grow [1/s], beyond the fall of links that hang in play."""
        loaded = len(self.poses)
        falls = [motion.fastest if k >= loaded else 0.0 for k, motion in enumerate(self._motions)]
        return [
            compute_growth_rate(loop, period) - fall
            for loop, fall in zip(loops, falls, strict=True)
        ]

    def _find_stable_gains(self, joint: int) -> tuple[JointServo | None, float | None]:
        softer = self.joints[joint]
        stable_gains = None
        for _ in range(_TRIALS):
            softer = slow_loops(softer, 0.5, self.servo.period)
            joints = [*self.joints[:joint], softer, *self.joints[joint + 1 :]]
            if self._is_stable(joints, self.servo.period):
                stable_gains = softer
                break
        period = self.servo.period
        for _ in range(_TRIALS):
            period /= 2.0
            if self._is_stable(self.joints, period):
                return stable_gains, period
        return stable_gains, None

    def _is_stable(self, joints: list[JointServo], period: float) -> bool:
        try:
            loops = self.close_loops(joints, period, self.delay)
        except Refusal:
            return False
        return all(beyond <= HARMLESS for beyond in self._compute_excess_growth(loops, period))


@dataclass(frozen=True)
class Unstable:
    """A small motion that grows."""

    joint: int
    """Whose command swings most."""
    pose: int
    growth: float
    """Factor per servo period."""
    softer: JointServo | None
    """This joint with gains that hold."""
    period: float | None
    """A servo period that holds [s]."""

    def describe_remedies(self) -> str:
        """Return gain and period in words."""
        remedies = []
        if self.softer is not None:
            remedies.append(
                f"velocity_gain {self.softer.velocity_gain:.3g} with position_gain "
                f"{self.softer.position_gain:.3g}"
            )
        if self.period is not None:
            remedies.append(f"a servo period of {self.period:.3g} s")
        return " or ".join(remedies) or "gains by `arm_emulator tune`"


def compute_growth_rate(loop: SampledLoop, period: float) -> float:
    """Return how fast small motions grow [1/s]."""
    return math.log(max(loop.radius, 1e-300)) / period


def slow_loops(joint: JointServo, share: float, period: float) -> JointServo:
    """Return a joint's servo with its loops a share as fast, the observer as it is."""
    return dataclasses.replace(
        joint,
        velocity_gain=share * joint.velocity_gain,
        position_gain=share * joint.position_gain,
        integral_time=max(period, joint.integral_time / share),
    )


def warn_of_loops(scene: Scene, servo: ServoConfig) -> None:
    """Print the warnings of a scene, and what `check_loops` finds, to stderr.

    Raises:
        Refusal: see `check_loops`.
    """
    print_warnings(*scene.warnings)
    for line in check_loops(scene, servo):
        print_warnings(line)


def check_loops(scene: Scene, servo: ServoConfig) -> list[str]:
    """Hold the servo's gains against the machine; return warnings, one line each.

    A joint without a motor has no loop, and is not reported. Nothing is reported where the
    machine's numbers are so far apart that its small motions cannot be computed.

    Raises:
        Refusal: the loop is unstable where the machine starts.
    """
    if any(joint.motor is None for joint in scene.joints):
        return []
    try:
        with np.errstate(all="ignore"):
            return _check_loops(scene, servo)
    except (ArithmeticError, np.linalg.LinAlgError):
        return []


def _check_loops(scene: Scene, servo: ServoConfig) -> list[str]:
    loops = ServoLoops(scene, servo)
    where, names = scene.where, scene.joint_names
    bad = loops.find_unstable()
    if bad is not None:
        quantity = f"servo.joints.{names[bad.joint]}"
        actual = f"small motions that grow {bad.growth:.4g}-fold per servo period"
        if bad.pose == 0 or compute_growth_rate(loops.loops[0], servo.period) > HARMLESS:
            rule = f"be stable at a period of {servo.period:g} s"
            raise Refusal(where, quantity, rule, actual, bad.describe_remedies())
        pose = np.array2string(loops.poses[bad.pose], precision=2, separator=", ")
        pose = " ".join(pose.split())
        return [
            f"{where}: {quantity}: {actual} at q = {pose}; what holds: {bad.describe_remedies()}"
        ]
    lines = []
    for j, margins in enumerate(loops.compute_margins()):
        little = describe_lacking_margins(margins)
        if little:
            lines.append(f"{where}: servo.joints.{names[j]}: {little}; `tune` computes gains")
    return lines


def describe_lacking_margins(margins: Margins) -> str:
    """Return in words what a joint has too little of; empty: nothing."""
    flaws = []
    if margins.gain_up < LITTLE_GAIN:
        flaws.append(f"a gain margin of {margins.gain_up:.2f}")
    if margins.phase < LITTLE_PHASE:
        flaws.append(f"a phase margin of {math.degrees(margins.phase):.0f} degrees")
    if margins.delay < LITTLE_DELAY:
        flaws.append(f"unstable with {margins.delay:.2g} servo periods of dead time")
    return ", ".join(flaws)
