"""The machine driven again under the commands of a bag, all bits compared.

A run depends only on the commands of each servo period, and every motor state reports those of the
previous period. The machine, driven by these, must therefore reach the recorded states; and in
lock-step they must equal the recorded commands. Changes by hand are repeated: a reset or a switch
of the power is computed, and a machine that was set or restored takes the state of its event.
A run lies between two resets; it is checked if the bag contains it from tick 0 on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from arm_emulator.analysis.stability import explain
from arm_emulator.bags.tally import Tally
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.output import FURTHER
from arm_emulator.machine.plant.inputs import further_inputs, named_inputs
from arm_emulator.machine.plant.measured import rows_of
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import SET
from arm_emulator.machine.session.command_buffer import CommandBuffer
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.bag import Bag
from arm_emulator.ros.node_shell import nanoseconds_of
from arm_emulator_msgs.msg import MachineEvent, MotorCommand, MotorState

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


def changed_on_the_way(session: Session) -> bool:
    """Return whether a fault acts now that changes commands before the motors get them."""
    now = session.plant.parameters
    return any(
        now[fault.varied.name] != 0.0
        for fault in session.scene.faults
        if fault.kind.changes_commands
    )


class Repetition:
    """Takes the messages of a bag in the order of publication, and repeats the actions.

    Attributes:
        tally: counts of compared and omitted messages.

    Args:
        session: the machine.
        bag: the record.
        lockstep: whether the record is of lock-step.
    """

    def __init__(self, session: Session, bag: Bag, lockstep: bool) -> None:
        self.tally = Tally()
        self._session = session
        self._where = str(bag.path)
        self._answers = CommandBuffer(session.scene, lockstep)
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
        self._fresh = session.plant.save()
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
        """Repeat a message of a topic, by its name.

        Raises:
            Difference: a bit differs.
            Refusal: the bag is not of this machine, or has gaps.
        """
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
            rows = self._answers.arranged(names, command.command, further)
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
        now = self._session.plant.parameters
        for name, value in self._reported.parameters.items():
            if now.get(name) != value:
                self._session.set_varied(name, value)

    def _on_state(self, state: MotorState) -> None:
        session, tick = self._session, int(state.tick)
        self._same_joints("motor_states", state.joint_names)
        if tick < session.tick and self._inside:
            self._end_run(state)
        begins = tick == 0 and not self._inside
        if begins:
            self._begin()
            if self._machine != state.machine:  # a fault of the one before is not its own
                session.restore(self._fresh)
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
            fits = (self._could_be(applied, command) for command in commands)
            if not any(fits) and not changed_on_the_way(session):
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
        clamped = np.clip(commanded[0], -U, U)
        if applied[0, ~several].tobytes() != clamped[~several].tobytes():
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
        self._session.advance_under(command, came=True)
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
