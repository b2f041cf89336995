"""A run of a network made again from its joint targets: machine and servo."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_ticks import RecordedChange
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import EFFORT, POSITION, VELOCITY
from arm_emulator.base.validation.count import check_count
from arm_emulator.base.validation.joint_order import JointOrder
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds
from arm_emulator.runs.gains import Gains, load_gains
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.order import Order
from arm_emulator.servo.servo_arm import Target


class _NoMotionControl:
    """Takes the place of the motion executor, which the bag does not have.

    Attributes:
        until: recorded changes by hand from this tick on are left out; None: all are kept.
    """

    def __init__(self) -> None:
        self.until: int | None = None

    def add(self, *_: Any) -> None:
        """Refuse a target."""
        rule = "go to the servo: the motion controller's own state is not in a network's bag"
        valid = "gains, power, numbers, faults, pushes; or a bag of run --bag"
        raise Refusal("fork", "a target for the tool", rule, "one for the motion controller", valid)


class TargetedRun(OfflineRun):
    """Machine and servo in lock-step, under joint targets that are known; the last one stays.

    Changes by hand come where they came in a network: between a tick's state, which the servo has
    answered, and the period that follows.

    Attributes:
        source: the bag that has the targets.

    Args:
        source: see above.
        scene: the machine.
        gains: of the servo.
        targets: by the tick at which each one came, in the servo's order of joints.
        changes: by their ticks; those at tick 0 come first of all.
    """

    def __init__(
        self,
        source: str,
        scene: Scene,
        gains: Gains,
        targets: Mapping[int, Target],
        changes: Mapping[int, Sequence[RecordedChange]],
    ) -> None:
        super().__init__(scene, gains.servo, gains.motion)
        self.source = source
        self._targets = targets
        self._changes = dict(changes)
        self.instructor: Any = _NoMotionControl()
        for change in self._changes.pop(0, ()):
            self.session.restore(change.saved)

    @property
    def changes_here(self) -> Sequence[RecordedChange]:
        """Changes by hand that come before the period that begins now."""
        tick, until = self.session.tick, self.instructor.until
        return () if until is not None and tick >= until else self._changes.get(tick, ())

    def leave_changes(self) -> None:
        """Leave out the changes by hand from now on."""
        self.instructor.until = self.session.tick

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods, see `OfflineRun.advance`."""
        check_count("TargetedRun.advance", "ticks", ticks)
        session, end = self.session, self.session.tick + ticks
        while session.tick < end:
            if self.changes_here:
                self._advance_by_hand()
                continue
            following = (tick for tick in self._changes if tick > session.tick)
            super().advance(min([end, *following]) - session.tick)

    def _advance_by_hand(self) -> None:
        """Change the machine behind the servo's answer, and go on under that."""
        session = self.session
        self._instruct_servo()
        rows = self._step.compute_commands(session.powered)
        for change in self.changes_here:
            session.restore(change.saved)
        session.advance_under(rows, session.tick)
        if session.fault is not None:
            raise session.fault

    def _instruct_servo(self) -> None:
        self._step.take_measurement(self.session.plant)
        target = self._targets.get(self.session.tick)
        if target is not None:
            self.aimed = target.q
            self.drives.set_target(target)


@dataclass(frozen=True)
class LeaveChanges(Order):
    """Leaves out the changes by hand that were recorded from now on."""

    kind: ClassVar[str] = "leave_changes"

    @property
    def name(self) -> str:
        """The change in words."""
        return "without the changes by hand that followed"

    def __call__(self, run: OfflineRun) -> None:
        """Leave them out."""
        if isinstance(run, TargetedRun):
            run.leave_changes()


def load_targeted_run(topics: RecordedTopics, scene_name: str) -> TargetedRun:
    """Return the last run of a network's bag, at its tick 0.

    Raises:
        Refusal: it was in real time, or has no joint targets.
    """
    where = str(topics.bag.path)
    if topics.is_real_time:
        rule = "be of lock-step, to be made again from its targets"
        raise Refusal(where, "the bag", rule, "one in real time")
    file = find_scene(scene_name)
    scene, gains = load_scene(file), load_gains(file)
    targets = _read_targets(topics, gains.servo.joint_names, round(scene.servo_period * 1e9))
    changes = RecordedMachine(topics, scene).changes
    if not targets:
        rule = "have its orders or joint_targets"
        valid = "bags of run --bag, fork and record; up --record writes what the emulator sees"
        raise Refusal(where, "the bag", rule, "neither", valid)
    return TargetedRun(where, scene, gains, targets, changes)


def _read_targets(
    topics: RecordedTopics, joints: tuple[str, ...], period: int
) -> dict[int, Target]:
    """Return the targets of the last run, by the ticks of the joint states that they answer."""
    targets: dict[int, Target] = {}
    arrange, tick = JointOrder("joint_targets", joints).arrange_values, -1
    for name, message, _ in topics.read_with_time("motor_states", "joint_targets"):
        if name == "motor_states":
            if message.tick < tick:
                targets = {}
            tick = int(message.tick)
            continue
        at = convert_to_nanoseconds(message.header.stamp) // period
        if at <= tick and at not in targets:  # else it is of the run before, or published again
            names, v, tau = message.name, message.velocity, message.effort
            targets[at] = Target(
                arrange(names, message.position, POSITION),
                arrange(names, v, VELOCITY) if len(v) else None,
                arrange(names, tau, EFFORT) if len(tau) else None,
            )
    return targets
