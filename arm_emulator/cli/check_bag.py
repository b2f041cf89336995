"""`arm_emulator check-bag`: drive the machine again under a bag's commands and compare all bits.

A run depends only on the commands of each servo period, and every motor state reports those of the
previous period. The machine, driven by these, must therefore reach the recorded states; and in
lock-step they must equal the recorded commands. Changes by hand are repeated: a reset or a switch
of the power is computed, and a machine that was set or restored takes the state of its event.
A run lies between two resets; it is checked if the bag contains it from tick 0 on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from arm_emulator.analysis.stability import explain
from arm_emulator.base.config_files import config_folder
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.yaml_file import read_yaml
from arm_emulator.cli.checked import Tally
from arm_emulator.cli.output import Output
from arm_emulator.machine.inputs import further_inputs, named_inputs
from arm_emulator.machine.measured import rows_of
from arm_emulator.machine.measured_fields import MeasuredFields
from arm_emulator.machine.parts.output import FURTHER
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.plant_state import SET
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.machine.session import Session
from arm_emulator.ros.bag import Bag
from arm_emulator.ros.message_types import definition_of, fields
from arm_emulator.ros.node_shell import nanoseconds_of
from arm_emulator_msgs.msg import EmulatorStatus, MachineEvent, MotorCommand, MotorState

# Topic -> class and type of its messages.
TYPES: dict[str, tuple[Any, str]] = {
    "motor_commands": (MotorCommand, "arm_emulator_msgs/msg/MotorCommand"),
    "motor_states": (MotorState, "arm_emulator_msgs/msg/MotorState"),
    "emulator/joint_states": (JointState, "sensor_msgs/msg/JointState"),
    "emulator/events": (MachineEvent, "arm_emulator_msgs/msg/MachineEvent"),
    "emulator/status": (EmulatorStatus, "arm_emulator_msgs/msg/EmulatorStatus"),
    "robot_description": (String, "std_msgs/msg/String"),
    "diagnostics": (DiagnosticArray, "diagnostic_msgs/msg/DiagnosticArray"),
}
COMPARED = ("motor_states", "motor_commands", "emulator/joint_states", "emulator/events")
KINDS = {
    MachineEvent.KIND_SET_STATE: "set_state",
    MachineEvent.KIND_RESTORE: "restore_state",
    MachineEvent.KIND_POWER: "power",
    MachineEvent.KIND_RESET: "reset",
    MachineEvent.KIND_SET_VARIED: "set_varied",
    MachineEvent.KIND_EXTERNAL_WRENCH: "external_wrench",
}


class Difference(Exception):
    """The first bit that differs from the record."""


def check(path: Path, scene_name: str | None, strict: bool = False, *, json: bool = False) -> int:
    """Compare, and print the compared and omitted messages and the outcome.

    The exit code is 0 if all is equal; 1 at a difference, or if states after the start of a run
    could not be compared; with `strict` also if any other message could not.

    Args:
        path: the bag.
        scene_name: scene file or name; None: the one that the bag names.
        strict: permit no omission.
        json: print one JSON object instead of lines.

    Raises:
        Refusal: the bag is damaged or contains nothing to check, or there is no scene.
    """
    bag = Bag(path)
    topics = _topics(bag)
    scene = load_scene(scene_name or _scene_of(bag, topics))
    lockstep = not _in_real_time(bag, topics)
    checker = _Checker(Session(scene, "lockstep", "first_answer"), bag, lockstep)
    tally = checker.tally
    difference: Difference | None = None
    try:
        for name, message in _read(bag, topics, COMPARED):
            checker.take(name, message)
    except Difference as found:
        difference = found
    if not tally.runs:
        rule, got = "hold a run from tick 0 on", f"{tally.before} states of later ticks"
        raise Refusal(str(path), "the bag", rule, got, "record, then call emulator/reset")
    if difference is None and not tally.periods:
        rule, got = "hold a servo period of a run", f"{tally.states} states of tick 0"
        raise Refusal(str(path), "the bag", rule, got, "record while the machine runs")
    output = Output(json)
    clock = "" if lockstep else " in real time"
    output.line(f"scene {scene.name}{clock}: {tally.compared}")
    fields = [f"{name} ({of})" for name, of in checker.fields.items() if name in topics]
    output.line(f"compared: {'; '.join(fields)}")
    left_out = [*tally.left_out, *_not_known(bag)]
    for line in left_out:
        output.line(f"not compared: {line}")
    others = sorted(set(bag.topics) - {topics[name] for name in COMPARED if name in topics})
    if others:
        output.line(f"topics that are not compared: {', '.join(others)}")
    outcome = int(bool(difference or tally.after or (strict and left_out)))
    output.facts(
        {
            "scene": scene.name,
            "clock": "lockstep" if lockstep else "realtime",
            "equal": difference is None,
            "difference": None if difference is None else str(difference),
            "counts": dataclasses.asdict(tally),
            "not_compared": left_out,
            "topics_not_compared": others,
        }
    )
    if difference is not None:
        output.line(f"the first difference: {difference}")
        for hint in _hints(bag, topics, scene):
            output.line(f"note: {hint}")
        return outcome
    if tally.after:
        output.line("not checked to its end; what was compared is equal to the last bit")
    else:
        output.line(f"equal to the last bit{', as far as it was compared' if left_out else ''}")
    return outcome


class _Checker:
    """Takes the messages of a bag in the order of publication, and repeats the actions."""

    def __init__(self, session: Session, bag: Bag, lockstep: bool) -> None:
        self.tally = Tally()
        self._session = session
        self._where = str(bag.path)
        self._lockstep = lockstep
        # A recorder of all topics has recorded all changes by hand.
        self._reports_changes = any(name.endswith("/emulator/events") for name in bag.topics)
        self._reports_commands = any(name.endswith("/motor_commands") for name in bag.topics)
        self._machine = 0  # the emulator whose states form the run
        self._inside = False  # within a run that began at tick 0
        self._further = rows_of(session.scene)[FURTHER]  # applied further inputs of motors
        self._measured = MeasuredFields(session.scene, MotorState.get_fields_and_field_types())
        self._reported = Plant(session.scene)  # machines as events report them
        self._event = (0, 0)  # emulator and number of the newest one
        self._waiting: list[MachineEvent] = []  # at tick 0, before the run's first state
        self._begin()

    @property
    def fields(self) -> dict[str, str]:
        """Compared fields of each message."""
        fields = self._measured
        own = (one.name for one in fields.own)
        names = "stamp", "tick", *fields.in_all, *own, *fields.listed
        return {
            "motor_states": ", ".join(names),
            "motor_commands": ", ".join(("command", *further_inputs(self._session.scene))),
            "emulator/joint_states": "position, velocity, effort",
            "emulator/events": "tick, stamp, state",
        }

    def take(self, name: str, message: Any) -> None:
        {
            "motor_commands": self._on_command,
            "motor_states": self._on_state,
            "emulator/joint_states": self._on_truth,
            "emulator/events": self._on_event,
        }[name](message)

    def _begin(self) -> None:
        """Clear the previous run."""
        self._session.reset()
        self._led = False  # by commands: some command was not 0
        self._commands: dict[int, list[NDArray[np.float64]]] = {}  # by the tick that they answer

    def _on_command(self, command: MotorCommand) -> None:
        if not self._inside:
            return
        try:
            names, given = command.joint_names, (command.input_names, command.inputs)
            further = named_inputs("motor_commands", *given, len(names))
            rows = self._session.arranged(names, command.command, further)
        except Refusal:
            self.tally.refused += 1
            return
        tick = int(command.tick)
        self._lead_past_a_lost_state(tick)
        if tick > self._session.tick:
            self.tally.refused += 1
            return
        self._commands.setdefault(tick, []).append(rows)

    def _lead_past_a_lost_state(self, tick: int) -> None:
        """Advance to a tick whose state is missing in the bag, if the command before it exists."""
        session = self._session
        known = self._commands.get(session.tick)
        if tick == session.tick + 1 and known and self._lockstep:
            self.tally.lost += 1
            self._advance(known[-1] if session.powered else np.zeros_like(known[-1]))

    def _on_event(self, event: MachineEvent) -> None:
        session, number = self._session, int(event.number)
        machine, before = self._event
        self._event = int(event.machine), number
        if event.kind == MachineEvent.KIND_RESET:
            self._inside = False
            self._waiting = [event]
            return
        if not self._inside:
            if event.tick == 0:
                self._waiting.append(event)
            return
        if machine == event.machine and number != before + 1:
            rule = f"report change {before + 1} by hand"
            raise Refusal(self._where, "emulator/events", rule, f"{number}", "a bag without gaps")
        self._lead_past_a_lost_state(int(event.tick))
        if event.tick != session.tick or nanoseconds_of(event.header.stamp) != session.logical_ns:
            raise Difference(
                f"run {self.tally.runs}, tick {session.tick}, change {number} by hand: "
                f"recorded at tick {event.tick}, stamp {nanoseconds_of(event.header.stamp)} ns"
            )
        self._change(event)

    def _change(self, event: MachineEvent) -> None:
        """Repeat a change by hand."""
        session = self._session
        what = KINDS.get(event.kind, f"kind {event.kind}")
        place = (
            f"run {self.tally.runs}, tick {session.tick}, change {event.number} by hand ({what})"
        )
        self.tally.changes += 1
        try:
            self._reported.restore(bytes(event.state))
        except Refusal as reason:
            raise Difference(f"{place}: the state after it cannot be restored: {reason}") from None
        if self._reported.powered != event.powered or event.kind not in KINDS:
            raise Difference(f"{place}: it does not report one change of one machine")
        if event.kind == MachineEvent.KIND_RESET:
            session.powered = bool(event.powered)
            self._set_varied()
            session.reset()
        elif event.kind == MachineEvent.KIND_SET_VARIED and self._reported.diverged is None:
            self._set_varied()
        elif event.kind == MachineEvent.KIND_EXTERNAL_WRENCH and self._reported.diverged is None:
            for link, wrench in self._reported.external_wrenches.items():
                if wrench != session.plant.external_wrenches[link]:
                    session.set_external_wrench(link, wrench)
        elif event.kind == MachineEvent.KIND_POWER and self._reported.diverged is None:
            session.powered = bool(event.powered)
        else:  # a machine that has diverged stands within a servo period
            session.restore(bytes(event.state))
        if self._reported.parameters != session.plant.parameters:
            raise Difference(f"{place}: varied numbers differ")
        if self._reported.external_wrenches != session.plant.external_wrenches:
            raise Difference(f"{place}: external wrenches differ")
        reported, now = self._reported.state, session.state
        for name in SET:
            self._same_bits(
                f"{name} after {what} by hand", getattr(reported, name), getattr(now, name)
            )

    def _set_varied(self) -> None:
        for name, value in self._reported.parameters.items():
            self._session.set_varied(name, value)

    def _on_state(self, state: MotorState) -> None:
        session, tick = self._session, int(state.tick)
        self._same_joints("motor_states", state.joint_names)
        if tick < session.tick and self._inside:
            self._end_run(state)
        begins = tick == 0 and not self._inside
        if begins:
            self._begin()
            self._inside = True
            self._machine = int(state.machine)
            self.tally.runs += 1
            for event in self._waiting:
                self._change(event)
            self._waiting.clear()
        elif not self._inside:
            # A reset whose first state is not in the bag, or a bag that begins within a run.
            self.tally.leave_out(f"one of tick {tick}")
            return
        order = self._order(state.joint_names)
        if tick > session.tick + 1:
            rule = f"report tick {session.tick + 1}"
            got = f"nothing, and the next state is that of tick {tick}"
            raise Refusal(self._where, "motor_states", rule, got, "a bag without gaps")
        first = begins or tick == session.tick + 1
        if tick == session.tick + 1:
            self._advance(self._applied(state, order))
        self.tally.states += 1
        stamp = nanoseconds_of(state.header.stamp)
        if stamp != session.logical_ns:
            raise Difference(
                f"run {self.tally.runs}, tick {session.tick}, stamp: "
                f"recorded {stamp} ns, computed {session.logical_ns} ns"
            )
        now = session.measured
        per_joint = (one.name for one in self._measured.own if not one.per_unit)
        for name in (*self._measured.in_all, *per_joint):
            if name == "applied" and not first:
                continue  # a machine that diverges then, and is reported again, has others
            self._compare(name, order, np.array(getattr(state, name)), getattr(now, name))
        self._compare_readings(state, order)
        for name in (*self._measured.absent, "imu_names"):
            if len(getattr(state, name)) and (name != "imu_names" or not session.scene.imus):
                raise Difference(
                    f"run {self.tally.runs}, tick {session.tick}, {name}: "
                    "recorded, and the scene has no such sensor"
                )
        if session.scene.imus:
            self._compare_imus(state)

    def _end_run(self, state: MotorState) -> None:
        """Take a tick that goes back: without a reset it must be of another machine."""
        self._inside = False
        if self._reports_changes and state.machine == self._machine:
            raise Difference(
                f"run {self.tally.runs}: tick {state.tick} comes after tick {self._session.tick}, "
                "and no reset is recorded"
            )

    def _compare_readings(self, state: MotorState, order: list[int]) -> None:
        known, given = self._measured.listed, tuple(state.reading_names)
        if given != known:
            rule, got = "be those of the scene", ", ".join(given) or "none"
            raise Refusal(self._where, "reading_names", rule, got, ", ".join(known) or "none")
        rows, N = np.array(state.readings), len(order)
        if len(rows) != N * len(known):
            rule = f"have {N * len(known)} values"
            raise Refusal(self._where, "readings", rule, f"{len(rows)} values")
        for name, row in zip(known, rows.reshape(len(known), N), strict=True):
            computed = getattr(self._session.measured, name).astype(np.float64)
            self._compare(name, order, row, computed)

    def _compare_imus(self, state: MotorState) -> None:
        known = [one.name for one in self._session.scene.imus]
        if list(state.imu_names) != known:
            got = ", ".join(state.imu_names) or "none"
            raise Refusal(self._where, "imu_names", "be those of the scene", got, ", ".join(known))
        for name in (one.name for one in self._measured.own if one.per_unit):
            computed = getattr(self._session.measured, name).ravel()
            recorded = np.array(getattr(state, name))
            if len(recorded) != len(computed):
                rule = f"have {len(computed)} values"
                raise Refusal(self._where, name, rule, f"{len(recorded)} values")
            owners = [unit for unit in known for _ in range(3)]
            self._same_bits(name, recorded, computed, owners)

    def _applied(self, state: MotorState, order: list[int]) -> NDArray[np.float64]:
        """Return the commands of the period before this state, compared with the recorded ones."""
        session = self._session
        session.powered = bool(state.powered)  # of the period before: switched between ticks
        self._has_values("applied", order, len(state.applied))
        applied = self._got(state, order)
        commands = self._commands.pop(session.tick, [])
        self._led = self._led or bool(applied.any())
        self.tally.free += not self._led and not commands
        led = self._led and session.powered
        self.tally.uncommanded += led and self._lockstep and self._reports_commands and not commands
        self.tally.held += 0 if self._lockstep else len(commands)
        # In real time a command may answer any tick, and before the first one was taken it may
        # answer a tick that is past. Power may be switched while nothing moves.
        if commands and self._lockstep and led:
            self.tally.commands += 1
            if not any(self._could_be(applied, one) for one in commands):
                row, joint = np.argwhere(applied != commands[-1])[0].tolist()
                raise Difference(
                    f"run {self.tally.runs}, tick {session.tick}, "
                    f"joint {session.scene.joint_names[joint]}, "
                    f"{('applied', *self._further)[row]}: commanded "
                    f"{commands[-1][row, joint].item()!r}, applied {applied[row, joint].item()!r}"
                )
        return applied

    def _got(self, state: MotorState, order: list[int]) -> NDArray[np.float64]:
        """Return the values applied to the motors for commands and further inputs (1 + I, N)."""
        rows, listed = [np.array(state.applied)[order]], list(state.reading_names)
        N = len(order)
        for name in self._further:
            at = listed.index(name) * N if name in listed else 0
            values = np.array(state.readings[at : at + N])
            self._has_values(name, order, len(values) if name in listed else 0)
            rows.append(values[order])
        return np.array(rows)

    def _could_be(self, applied: NDArray[np.float64], commanded: NDArray[np.float64]) -> bool:
        """Return whether the values can be the applied ones of inputs (1 + I, N).

        A motor with several inputs limits all of them together: each may be reduced.
        """
        scene = self._session.scene
        U = scene.largest_commands
        several = np.array([len(joint.inputs) > 1 for joint in scene.joints])
        if not _are_equal(applied[0, ~several], np.clip(commanded[0], -U, U)[~several]):
            return False
        got, wanted = applied[:, several], commanded[:, several]
        less = (np.abs(got) < np.abs(wanted)) & ((np.sign(got) == np.sign(wanted)) | (got == 0.0))
        return bool((less | (got == wanted)).all())

    def _on_truth(self, truth: JointState) -> None:
        session, now = self._session, self._session.state
        if not self._inside or nanoseconds_of(truth.header.stamp) != session.logical_ns:
            self.tally.stray_truths += self._inside
            return
        self._same_joints("emulator/joint_states", truth.name)
        self.tally.truths += 1
        order = self._order(truth.name)
        self._compare("position", order, np.array(truth.position), now.q)
        self._compare("velocity", order, np.array(truth.velocity), now.v)
        self._compare("effort", order, np.array(truth.effort), now.gear_torque)

    def _advance(self, command: NDArray[np.float64]) -> None:
        self._session.advance_under(command)
        self.tally.periods += 1
        if self._session.fault is not None:
            fault = explain(self._session.fault)
            raise Difference(f"run {self.tally.runs}, {fault}; the recorded run went on")

    def _same_joints(self, topic: str, names: list[str]) -> None:
        expected = self._session.scene.joint_names
        if sorted(names) != sorted(expected):
            raise Refusal(
                self._where,
                f"joints of {topic}",
                "be those of the scene",
                ", ".join(names),
                ", ".join(expected),
            )

    def _order(self, names: list[str]) -> list[int]:
        """Return the position in the message of each joint of the scene."""
        return [list(names).index(name) for name in self._session.scene.joint_names]

    def _has_values(self, quantity: str, order: list[int], given: int) -> None:
        if given != len(order):
            rule = f"have {len(order)} values"
            raise Refusal(self._where, quantity, rule, f"{given} values")

    def _compare(
        self, quantity: str, order: list[int], given: NDArray[Any], computed: NDArray[Any]
    ) -> None:
        self._has_values(quantity, order, len(given))
        self._same_bits(quantity, given[order], computed)

    def _same_bits(
        self,
        quantity: str,
        recorded: NDArray[Any],
        computed: NDArray[Any],
        owners: Sequence[str] | None = None,
    ) -> None:
        # Of the bits: 0.0 and -0.0 differ, and a NaN is equal to itself.
        recorded, computed = np.ascontiguousarray(recorded), np.ascontiguousarray(computed)
        differ = recorded.view(np.int64) != computed.view(np.int64)
        if differ.any():
            place = int(np.argmax(differ))
            joints = [f"joint {name}" for name in self._session.scene.joint_names]
            owner = owners[place] if owners else joints[place]
            raise Difference(
                f"run {self.tally.runs}, tick {self._session.tick}, {owner}, {quantity}: "
                f"recorded {recorded[place].item()!r}, computed {computed[place].item()!r}"
            )


def _are_equal(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    return one.tobytes() == other.tobytes()


def _topics(bag: Bag) -> dict[str, str]:
    """Return the names in the bag of the topics wanted; they may stand in a namespace."""
    states = [name for name in bag.topics if name.endswith("/motor_states")]
    if len(states) != 1:
        known = ", ".join(states or sorted(bag.topics)) or "no topics"
        raise Refusal(str(bag.path), "the bag", "have one topic motor_states", known)
    namespace = states[0].removesuffix("motor_states")
    found = {}
    for name, (_, kind) in TYPES.items():
        topic = bag.topics.get(namespace + name)
        if topic is None or not topic.count:
            if name == "motor_states":
                raise Refusal(str(bag.path), "the bag", f"have messages on {name}", "none")
            continue
        if topic.type != kind:
            raise Refusal(str(bag.path), f"type of {topic.name}", f"be {kind}", topic.type)
        if topic.definition and fields(topic.definition) != fields(definition_of(kind)):
            rule = f"be the {kind} of this version"
            raise Refusal(str(bag.path), f"definition of {topic.name}", rule, "other fields")
        found[name] = topic.name
    return found


def read_topics(bag: Bag, wanted: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """Yield name and message of our topics in a bag, in the order of publication.

    Raises:
        Refusal: it has no motor states, or its messages are of another version.
    """
    yield from _read(bag, _topics(bag), wanted)


def _read(bag: Bag, topics: dict[str, str], wanted: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """Yield name and message, in the order of publication."""
    names = {topics[name]: name for name in wanted if name in topics}
    for one in bag.as_published(names):
        name = names[one.topic]
        try:
            yield name, deserialize_message(one.data, TYPES[name][0])
        except RuntimeError as error:
            raise Refusal(str(bag.path), f"messages on {name}", "be readable", error) from None


def _in_real_time(bag: Bag, topics: dict[str, str]) -> bool:
    return any(
        status.worst_lateness > 0.0 or status.overruns
        for _, status in _read(bag, topics, ("emulator/status",))
    )


def _scene_of(bag: Bag, topics: dict[str, str]) -> str:
    """Return the scene that the emulator named, or the only one that has these joints."""
    folder = config_folder()
    for _, array in _read(bag, topics, ("diagnostics",)):
        for status in array.status:
            if status.name.split("/")[-1] == "emulator" and status.hardware_id:
                name = status.hardware_id.split("/")[-1]  # after the namespace
                if (folder / f"{name}.yaml").is_file():
                    return str(name)
                got = f"none, and {name} is not shipped"
                raise Refusal("check-bag", "--scene", "name the scene's file", got)
    _, state = next(_read(bag, topics, ("motor_states",)))
    fitting = [
        file.stem
        for file in sorted(folder.glob("*.yaml"))
        if sorted(read_yaml(file).get("joints", {})) == sorted(state.joint_names)
    ]
    if len(fitting) != 1:
        joints = ", ".join(state.joint_names)
        valid = ", ".join(fitting) or None
        raise Refusal(
            "check-bag", "--scene", f"name the scene with the joints {joints}", "none", valid
        )
    return fitting[0]


def _not_known(bag: Bag) -> Iterator[str]:
    """Yield the messages that the bag lacks."""
    if not bag.complete:
        yield "messages after the bag's end: its recorder did not close it"
    for name, what in (
        ("motor_commands", "what was commanded"),
        ("emulator/joint_states", "the true state of the machine"),
        ("emulator/events", "whether the machine was changed by hand"),
        ("emulator/status", "whether this was lock-step, as assumed"),
    ):
        if not any(known.endswith(f"/{name}") for known in bag.topics):
            yield f"{what}: the bag has no {name}"


def _hints(bag: Bag, topics: dict[str, str], scene: Scene) -> Iterator[str]:
    for _, description in _read(bag, topics, ("robot_description",)):
        if description.data != scene.urdf:
            yield f"the recorded robot_description is not that of scene {scene.name}"
        break
    if "emulator/events" not in topics:
        yield "without emulator/events changes by hand are unknown"
    if "emulator/status" not in topics:
        yield "without emulator/status the clock is unknown, lock-step is assumed"
