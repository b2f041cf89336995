"""Linear analysis of every loop of a drive: which of its modes are stable on the machine.

A CiA 402 drive controls position, speed or torque, or a torque at the speed limit; each with the
joint's brake open or closed. The machine is linearised about rest in several poses, sampled exactly
and closed by the actual law (`servo_loop.py`): first with one joint in the judged loop and the
others in position control, then with all joints in that loop.

A loop is stable if no small motion grows with the nominal command. With a command `GAIN` times as
strong or as weak no motion faster than the position loop may grow. A torque by a voltage takes the
back EMF from a data sheet. Its excess makes a speed grow slowly, which a torque master observes and
corrects. A torque loop does not hold a link up, and a speed loop only by its integral. Growth up to
that of the arm's fall without motor torque comes from the weight and is not counted. In speed loops
a tenth of it is not counted.
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from arm_emulator.analysis.linear_servo import LinearServo, Loop
from arm_emulator.analysis.sampled_loop import SampledLoop, SampledPlant
from arm_emulator.analysis.servo_loop import HARMLESS, count_delay_periods, draw_poses, sample_plant
from arm_emulator.analysis.stability import SmallMotions, list_contacts
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.servo.servo_config import ServoConfig

POSES = 4
GAIN = 1.25
# Growth rate relative to the arm's fall that a loop without position control may leave: gears
# give way, too; the integral of a speed loop holds against some weight.
FALLING = {Loop.POSITION: 0.0, Loop.SPEED: 0.1, Loop.TORQUE: 1.1, Loop.SPEED_LIMIT: 1.1}

_STANDS = 1e-4  # rad per period: slower rotation is not an oscillation; rounding splits poles at 1


@dataclass(frozen=True)
class Mode:
    """A mode of operation of a drive."""

    number: int
    """Number in CiA 402, 0x6060."""
    name: str
    loops: tuple[Loop, ...]
    """Controlled quantity."""

    def __str__(self) -> str:
        return f"{self.name} ({self.number})"


@dataclass(frozen=True)
class LoopFigure:
    """One loop of one joint, at its worst over the poses."""

    joint: int
    loop: Loop
    braked: bool
    """Whether the joint's brake is closed."""
    alike: bool
    """Whether all joints are in this loop; else the others are held in position."""
    radius: float
    """Largest eigenvalue of a servo period: growth factor of the fastest growing motion."""
    swing: float
    """The same of oscillating motions; 0: none."""
    frequency: float
    """Frequency of that oscillation [Hz]."""
    beyond: float
    """Growth rate beyond the arm's fall, at the worst gain [1/s]."""
    gain: float
    """That gain; 1: nominal."""
    q: tuple[float, ...]
    """The worst pose [rad or m]."""

    @property
    def is_stable(self) -> bool:
        """Whether small motions decay, or fall."""
        return self.beyond <= HARMLESS

    def explain_instability(self) -> str:
        """Return the reason for its instability, as text."""
        pose = ", ".join(f"{q:.2f}" for q in self.q)
        brake = " with its brake closed" if self.braked else ""
        others = " with all joints in it" if self.alike else ""
        gain = f" with {self.gain:g} times the command" if self.gain != 1.0 else ""
        return (
            f"small motions of its {self.loop.value} loop{brake}{others} grow by {self.beyond:.3g} "
            f"1/s{gain} at q = [{pose}]"
        )


@dataclass(frozen=True)
class Withheld:
    """A mode that a drive does not offer."""

    joint: int
    mode: Mode
    why: str


class ModeLoops:
    """All loops of a scene with its servos.

    Args:
        scene: the machine; every joint has a motor.
        servo: names the scene's joints, in any order.
    """

    def __init__(self, scene: Scene, servo: ServoConfig) -> None:
        by_name = {joint.name: joint for joint in servo.joints}
        joints = [by_name[name] for name in scene.joint_names]
        self._N, self._delay, self._period = len(joints), count_delay_periods(scene), servo.period
        self._fast = min(joint.position_gain for joint in joints)
        self._servos = {
            loop: [LinearServo(joint, servo.period, loop) for joint in joints] for loop in Loop
        }
        plant = Plant(scene)
        stand = [(q, loaded) for loaded in list_contacts(plant) for q in draw_poses(scene, POSES)]
        self._poses = [q for q, _ in stand]
        motions = [SmallMotions(plant, *pose) for pose in stand]
        self._falls = [motion.falls for motion in motions]
        self._free = [sample_plant(motion, servo, servo.period) for motion in motions]
        self._braked = {
            j: [sample_plant(motion, servo, servo.period, j) for motion in motions]
            for j, joint in enumerate(scene.joints)
            if joint.brake is not None
        }
        self.figures = tuple(self._evaluate_all())

    def _evaluate_all(self) -> Iterator[LoopFigure]:
        for loop in Loop:
            yield from self._evaluate_loop(0, loop, alike=True)
            for j in range(self._N):
                if loop is not Loop.POSITION:
                    yield from self._evaluate_loop(j, loop)
                if j in self._braked:
                    yield from self._evaluate_loop(j, loop, braked=True)

    def _evaluate_loop(
        self, j: int, loop: Loop, braked: bool = False, alike: bool = False
    ) -> Iterator[LoopFigure]:
        """Evaluate one loop; a loop of all joints is named after the joint that moves most."""
        plants = self._braked[j] if braked else self._free
        servos = [
            self._servos[loop if alike or k == j else Loop.POSITION][k] for k in range(self._N)
        ]
        loops = [SampledLoop(plant, servos, self._delay) for plant in plants]
        beyond = [
            self._compute_excess_growth(*pair, loop)
            for pair in zip(loops, self._falls, strict=True)
        ]
        worst = int(np.argmax(beyond))
        closed, gain, excess = loops[worst], 1.0, beyond[worst]
        if excess <= HARMLESS:
            for factor in (GAIN, 1.0 / GAIN):
                scaled = SampledLoop(
                    _scale_command(plants[worst], factor, None if alike else j), servos, self._delay
                )
                grows = self._compute_excess_growth(scaled, self._falls[worst], loop, self._fast)
                if grows > HARMLESS:
                    closed, gain, excess = scaled, factor, grows
        poles = np.concatenate([pose_loop.poles for pose_loop in loops])
        swings = poles[np.abs(np.angle(poles)) > _STANDS]
        swing = swings[np.argmax(np.abs(swings))] if len(swings) else 0.0
        yield LoopFigure(
            joint=closed.find_loudest() if alike else j,
            loop=loop,
            braked=braked,
            alike=alike,
            radius=max(pose_loop.radius for pose_loop in loops),
            swing=float(np.abs(swing)),
            frequency=float(np.abs(np.angle(swing)) / (2.0 * math.pi * self._period)),
            beyond=excess,
            gain=gain,
            q=tuple(self._poses[worst].tolist()),
        )

    def _compute_excess_growth(
        self, closed: SampledLoop, falls: float, loop: Loop, min_rate: float = 0.0
    ) -> float:
        """Return the growth rate of motions faster than `min_rate` [1/s], beyond a fall [1/s]."""
        poles = closed.poles[np.abs(closed.poles) > 1e-300]
        rates = np.log(poles) / self._period
        growth = rates.real[np.abs(rates) >= min_rate].max(initial=-math.inf)
        return float(growth) - FALLING[loop] * falls

    def find_withheld(self, modes: Iterable[Mode]) -> list[Withheld]:
        """Return the unstable modes among some, by joint and mode, each with its worst loop."""
        withheld = []
        for j in range(self._N):
            for mode in modes:
                bad = [
                    figure
                    for figure in self.figures
                    if figure.joint == j and figure.loop in mode.loops and not figure.is_stable
                ]
                if bad:
                    worst = max(bad, key=lambda unstable: unstable.beyond)
                    withheld.append(Withheld(j, mode, worst.explain_instability()))
        return withheld


def _scale_command(plant: SampledPlant, factor: float, joint: int | None) -> SampledPlant:
    """Return a machine with a scaled command of a joint (None: of all)."""
    by = np.full(len(plant.q), factor)
    if joint is not None:
        by = np.where(np.arange(len(by)) == joint, factor, 1.0)
    return dataclasses.replace(
        plant, G=plant.G * by, current_by_command=plant.current_by_command * by
    )


_Key = tuple[str, bytes, tuple[float, ...], ServoConfig, tuple[Mode, ...]]
_CACHE: dict[_Key, list[Withheld]] = {}
_CACHE_SIZE = 64


def list_withheld_modes(
    scene: Scene, servo: ServoConfig, modes: tuple[Mode, ...]
) -> list[Withheld]:
    """Return the modes that drives of this scene do not offer, with the reasons.

    Empty if a joint has no motor, or if small motions cannot be computed for numerical range.
    """
    if any(joint.motor is None for joint in scene.joints):
        return []
    values = tuple(number.value for number in scene.varied)
    key = write_scene_unit(scene), scene.start.tobytes(), values, servo, modes
    if key not in _CACHE:
        while len(_CACHE) >= _CACHE_SIZE:
            del _CACHE[next(iter(_CACHE))]
        try:
            with np.errstate(all="ignore"):
                _CACHE[key] = ModeLoops(scene, servo).find_withheld(modes)
        except (ArithmeticError, np.linalg.LinAlgError):
            _CACHE[key] = []
    return _CACHE[key]


def describe_withheld_modes(scene: Scene, withheld: list[Withheld]) -> list[str]:
    """Return the same as text, one line per joint and reason."""
    by_reason: dict[tuple[int, str], list[Mode]] = {}
    for lost in withheld:
        by_reason.setdefault((lost.joint, lost.why), []).append(lost.mode)
    return [
        f"{scene.where}: {scene.joint_names[j]}: a drive offers no "
        f"{' or '.join(map(str, modes))}: {why}"
        for (j, why), modes in by_reason.items()
    ]
