"""The machine driven again under the commands of a bag, all bits compared.

A run depends only on the commands of each servo period, and every motor state reports those of the
previous period. The machine, driven by these, must therefore reach the recorded states; and in
lock-step they must equal the recorded commands. Changes by hand are repeated: a reset or a switch
of the power is computed, and a machine that was set or restored takes the state of its event.
A run lies between two resets; it is checked if the bag contains it from tick 0 on.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState

from arm_emulator.analysis.stability import explain_divergence
from arm_emulator.bags.recorded_ticks import (
    JointPlaces,
    Values,
    arrange_state,
    arrange_truth,
    check_length,
    find_first_difference_of_bits,
)
from arm_emulator.bags.tally import Tally
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.output import FURTHER
from arm_emulator.machine.plant.inputs import list_further_inputs, name_inputs
from arm_emulator.machine.plant.measured import list_rows
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import SET
from arm_emulator.machine.session.command_buffer import CommandBuffer
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds
from arm_emulator.ros.recording.bag import Bag
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


def has_command_fault(session: Session) -> bool:
    """Return whether a fault acts now that changes commands before the motors get them."""
    now = session.plant.parameters
    return any(
        now[fault.varied.name] != 0.0
        for fault in session.scene.faults
        if fault.kind.can_change_commands
    )


class BagRepetition:
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
        self._buffer = CommandBuffer(session.scene, lockstep)
        self._lockstep = lockstep
        # A recorder of all topics has recorded all changes by hand.
        self._reports_changes = any(name.endswith("/emulator/events") for name in bag.topics)
        self._reports_commands = any(name.endswith("/motor_commands") for name in bag.topics)
        self._machine = 0  # the emulator whose states form the run
        self._is_in_run = False  # within a run that began at tick 0
        self._further = list_rows(session.scene)[FURTHER]  # applied further inputs of motors
        self._places = JointPlaces(session.scene.joint_names, self._where)
        self._measured = MeasuredFields(session.scene, MotorState.get_fields_and_field_types())
        self._reported = Plant(session.scene)  # machines as events report them
        self._event = (0, 0)  # emulator and number of the newest one
        self._waiting: list[MachineEvent] = []  # at tick 0, before the run's first state
        self._fresh = session.plant.save()
        self._begin_run()

    @property
    def fields(self) -> dict[str, str]:
        """Compared fields of each message."""
        fields = self._measured
        own = (output.name for output in fields.own)
        names = "stamp", "tick", *fields.in_all, *own, *fields.listed
        return {
            "motor_states": ", ".join(names),
            "motor_commands": ", ".join(("command", *list_further_inputs(self._session.scene))),
            "emulator/joint_states": "position, velocity, effort",
            "emulator/events": "tick, stamp, state",
        }

    def repeat_message(self, name: str, message: Any) -> None:
        """Repeat a message of a topic, by its name.

        Raises:
            Difference: a bit differs.
            Refusal: the bag is not of this machine, or has gaps.
        """
        {
            "motor_commands": self._take_command,
            "motor_states": self._take_state,
            "emulator/joint_states": self._take_truth,
            "emulator/events": self._take_event,
        }[name](message)

    def _begin_run(self) -> None:
        """Clear the previous run."""
        self._session.reset()
        self._was_commanded = False  # by commands: some command was not 0
        self._commands: dict[int, list[NDArray[np.float64]]] = {}  # by the tick that they answer

    def _take_command(self, command: MotorCommand) -> None:
        if not self._is_in_run:
            return
        try:
            names, inputs = command.joint_names, (command.input_names, command.inputs)
            further = name_inputs("motor_commands", *inputs, len(names))
            rows = self._buffer.arrange_rows(names, command.command, further)
        except Refusal:
            self.tally.refused += 1
            return
        tick = int(command.tick)
        self._skip_lost_state(tick)
        if tick > self._session.tick:
            self.tally.refused += 1
            return
        self._commands.setdefault(tick, []).append(rows)

    def _skip_lost_state(self, tick: int) -> None:
        """Advance to a tick whose state is missing in the bag, if the command before it exists."""
        session = self._session
        recorded = self._commands.get(session.tick)
        if tick == session.tick + 1 and recorded and self._lockstep:
            self.tally.lost += 1
            self._advance_session(recorded[-1] if session.powered else np.zeros_like(recorded[-1]))

    def _take_event(self, event: MachineEvent) -> None:
        session, number = self._session, int(event.number)
        machine, before = self._event
        self._event = int(event.machine), number
        if event.kind == MachineEvent.KIND_RESET:
            self._is_in_run = False
            self._waiting = [event]
            return
        if not self._is_in_run:
            if event.tick == 0:
                self._waiting.append(event)
            return
        if machine == event.machine and number != before + 1:
            rule = f"report change {before + 1} by hand"
            raise Refusal(self._where, "emulator/events", rule, f"{number}", "a bag without gaps")
        self._skip_lost_state(int(event.tick))
        if (
            event.tick != session.tick
            or convert_to_nanoseconds(event.header.stamp) != session.logical_ns
        ):
            raise Difference(
                f"run {self.tally.runs}, tick {session.tick}, change {number} by hand: "
                f"recorded at tick {event.tick}, "
                f"stamp {convert_to_nanoseconds(event.header.stamp)} ns"
            )
        self._repeat_change(event)

    def _repeat_change(self, event: MachineEvent) -> None:
        """Repeat a change by hand."""
        session = self._session
        kind = KINDS.get(event.kind, f"kind {event.kind}")
        place = (
            f"run {self.tally.runs}, tick {session.tick}, change {event.number} by hand ({kind})"
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
            quantity = f"{name} after {kind} by hand"
            self._compare_values(quantity, getattr(reported, name), getattr(now, name))

    def _set_varied(self) -> None:
        now = self._session.plant.parameters
        for name, value in self._reported.parameters.items():
            if now.get(name) != value:
                self._session.set_varied(name, value)

    def _take_state(self, state: MotorState) -> None:
        session, tick = self._session, int(state.tick)
        self._places.find_places(state.joint_names)
        if tick < session.tick and self._is_in_run:
            self._end_run(state)
        begins = tick == 0 and not self._is_in_run
        if begins:
            self._begin_run()
            if self._machine != state.machine:  # a fault of the one before is not its own
                session.restore(self._fresh)
            self._is_in_run = True
            self._machine = int(state.machine)
            self.tally.runs += 1
            for event in self._waiting:
                self._repeat_change(event)
            self._waiting.clear()
        elif not self._is_in_run:
            # A reset whose first state is not in the bag, or a bag that begins within a run.
            self.tally.leave_out(f"one of tick {tick}")
            return
        values = arrange_state(state, self._places)
        if tick > session.tick + 1:
            rule = f"report tick {session.tick + 1}"
            actual = f"nothing, and the next state is that of tick {tick}"
            raise Refusal(self._where, "motor_states", rule, actual, "a bag without gaps")
        first = begins or tick == session.tick + 1
        if tick == session.tick + 1:
            self._advance_session(self._check_applied(state, values))
        self.tally.states += 1
        stamp = convert_to_nanoseconds(state.header.stamp)
        if stamp != session.logical_ns:
            raise Difference(
                f"run {self.tally.runs}, tick {session.tick}, stamp: "
                f"recorded {stamp} ns, computed {session.logical_ns} ns"
            )
        now = session.measured
        per_joint = (output.name for output in self._measured.own if not output.per_unit)
        for name in (*self._measured.in_all, *per_joint):
            if name == "applied" and not first:
                continue  # a machine that diverges then, and is reported again, has others
            self._compare_values(name, values[name], getattr(now, name))
        self._check_names("reading_names", state.reading_names, self._measured.listed)
        for name in self._measured.listed:
            self._compare_values(name, values[name], getattr(now, name))
        for name in (*self._measured.absent, "imu_names"):
            if len(getattr(state, name)) and (name != "imu_names" or not session.scene.imus):
                raise Difference(
                    f"run {self.tally.runs}, tick {session.tick}, {name}: "
                    "recorded, and the scene has no such sensor"
                )
        if session.scene.imus:
            units = [imu.name for imu in session.scene.imus]
            self._check_names("imu_names", state.imu_names, units)
            owners = [unit for unit in units for _ in range(3)]
            for name in (output.name for output in self._measured.own if output.per_unit):
                self._compare_values(name, values[name], getattr(now, name).ravel(), owners)

    def _end_run(self, state: MotorState) -> None:
        """Take a tick that goes back: without a reset it must be of another machine."""
        self._is_in_run = False
        if self._reports_changes and state.machine == self._machine:
            raise Difference(
                f"run {self.tally.runs}: tick {state.tick} comes after tick {self._session.tick}, "
                "and no reset is recorded"
            )

    def _check_names(self, field: str, recorded: Sequence[str], expected: Sequence[str]) -> None:
        if list(recorded) != list(expected):
            actual, valid = ", ".join(recorded) or "none", ", ".join(expected) or "none"
            raise Refusal(self._where, field, "be those of the scene", actual, valid)

    def _check_applied(self, state: MotorState, values: dict[str, Values]) -> NDArray[np.float64]:
        """Return the commands of the period before this state, compared with the recorded ones."""
        session = self._session
        session.powered = bool(state.powered)  # of the period before: switched between ticks
        quantities = "applied", *self._further
        rows = [values.get(name, np.zeros(0)) for name in quantities]
        for name, row in zip(quantities, rows, strict=True):
            check_length(self._where, name, row, len(session.scene.joints))
        applied = np.array(rows)
        commands = self._commands.pop(session.tick, [])
        self._was_commanded = self._was_commanded or bool(applied.any())
        self.tally.free += not self._was_commanded and not commands
        led = self._was_commanded and session.powered
        self.tally.uncommanded += led and self._lockstep and self._reports_commands and not commands
        self.tally.held += 0 if self._lockstep else len(commands)
        # In real time a command may answer any tick, and before the first one was taken it may
        # answer a tick that is past. Power may be switched while nothing moves.
        if commands and self._lockstep and led:
            self.tally.commands += 1
            fits = (self._is_possible(applied, command) for command in commands)
            if not any(fits) and not has_command_fault(session):
                index, joint = np.argwhere(applied != commands[-1])[0].tolist()
                commanded, actual = (rows[index, joint].item() for rows in (commands[-1], applied))
                raise Difference(
                    f"run {self.tally.runs}, tick {session.tick}, "
                    f"joint {session.scene.joint_names[joint]}, {quantities[index]}: "
                    f"commanded {commanded!r}, applied {actual!r}"
                )
        return applied

    def _is_possible(self, applied: NDArray[np.float64], commanded: NDArray[np.float64]) -> bool:
        """Return whether the values can be the applied ones of inputs (1 + I, N).

        A motor with several inputs limits all of them together: each may be reduced.
        """
        scene = self._session.scene
        U = scene.largest_commands
        several = np.array([len(joint.inputs) > 1 for joint in scene.joints])
        clamped = np.clip(commanded[0], -U, U)
        if applied[0, ~several].tobytes() != clamped[~several].tobytes():
            return False
        actual, commanded_values = applied[:, several], commanded[:, several]
        less = (np.abs(actual) < np.abs(commanded_values)) & (
            (np.sign(actual) == np.sign(commanded_values)) | (actual == 0.0)
        )
        return bool((less | (actual == commanded_values)).all())

    def _take_truth(self, truth: JointState) -> None:
        session, now = self._session, self._session.state
        if not self._is_in_run or convert_to_nanoseconds(truth.header.stamp) != session.logical_ns:
            self.tally.stray_truths += self._is_in_run
            return
        values = arrange_truth(truth, self._places)
        self.tally.truths += 1
        for (field, row), computed in zip(
            values.items(), (now.q, now.v, now.gear_torque), strict=True
        ):
            self._compare_values(field, row, computed)

    def _advance_session(self, command: NDArray[np.float64]) -> None:
        self._session.advance_under(command, came=True)
        self.tally.periods += 1
        if self._session.fault is not None:
            fault = explain_divergence(self._session.fault)
            raise Difference(f"run {self.tally.runs}, {fault}; the recorded run went on")

    def _compare_values(
        self, quantity: str, recorded: Values, computed: Values, owners: Sequence[str] | None = None
    ) -> None:
        """Raise the first difference; the owners are the joints if None."""
        check_length(self._where, quantity, recorded, len(computed))
        if (difference := find_first_difference_of_bits(recorded, computed)) is not None:
            place, (recorded_value, computed_value) = difference
            joints = [f"joint {name}" for name in self._session.scene.joint_names]
            owner = owners[place] if owners else joints[place]
            raise Difference(
                f"run {self.tally.runs}, tick {self._session.tick}, {owner}, {quantity}: "
                f"recorded {recorded_value!r}, computed {computed_value!r}"
            )
