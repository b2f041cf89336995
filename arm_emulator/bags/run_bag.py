"""A bag of a run without a network, with the messages that the emulator sends."""

import time
from array import array
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.build_facts import build_facts
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.change import Change, NumberChange, PowerChange, WrenchChange
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.messages.message_types import get_message_class, read_definition
from arm_emulator.ros.messages.node_topics import TYPES
from arm_emulator.ros.messages.time_stamp import convert_to_stamp
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter
from arm_emulator_msgs.msg import MachineEvent, MotorState

WRITTEN = (
    "motor_states", "emulator/joint_states", "emulator/events", "emulator/status", "diagnostics",
)  # fmt: skip
KINDS: dict[type[Change], int] = {  # of events
    PowerChange: MachineEvent.KIND_POWER,
    NumberChange: MachineEvent.KIND_SET_VARIED,
    WrenchChange: MachineEvent.KIND_EXTERNAL_WRENCH,
}


class RunBag:
    """A bag of a session, written tick by tick by the code that advances it; `check-bag` repeats
    it.

    It begins with the session's present tick, which must be 0.

    Args:
        folder: the new bag.
        session: machine and clock.
        about: further facts for its metadata.

    Raises:
        Refusal: the folder exists, or cannot be made; at its end: the disk does not take it all.
    """

    def __init__(self, folder: Path, session: Session, about: Mapping[str, str]) -> None:
        self._session, scene = session, session.scene
        self._names = list(scene.joint_names)
        self._imus = [imu.name for imu in scene.imus]
        self._fields = MeasuredFields(scene, MotorState.get_fields_and_field_types())
        self._clock, self._events = time.time_ns(), 0
        self._writer = BagWriter(folder, about)
        self._numbers = {}
        for name in WRITTEN:
            topic = Topic(f"/{name}", TYPES[name], read_definition(TYPES[name]))
            self._numbers[name] = self._writer.add_topic(topic)

    def __enter__(self) -> Self:
        self._writer.__enter__()
        session = self._session
        facts = [KeyValue(key=key, value=fact) for key, fact in build_facts(session.plant).items()]
        health = DiagnosticStatus(name="emulator", hardware_id=session.scene.name, values=facts)
        self._write_message("diagnostics", status=[health])
        self._write_message("emulator/status", tick=0)
        if session.plant.save() != Plant(session.scene).save():
            self.write_change(MachineEvent.KIND_RESTORE)
        self.write_state()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._writer.__exit__(kind, error, trace)
        except OSError as at_end:
            error = at_end
        if isinstance(error, OSError):  # the bag is whole up to there
            reason = f"the disk takes no more: {error.strerror or error}"
            where = f"folder {self._writer.folder}"
            raise Refusal("record", where, "accept every message", reason) from None

    def write_state(self) -> None:
        """Write the machine at a new tick, before it is changed there."""
        session = self._session
        state = session.state
        self._write_message(
            "motor_states",
            tick=session.tick,
            powered=session.powered,
            machine=1,
            joint_names=self._names,
            imu_names=self._imus,
        )
        self._write_message(
            "emulator/joint_states",
            name=self._names,
            position=state.q.tolist(),
            velocity=state.v.tolist(),
            effort=state.gear_torque.tolist(),
        )

    def write_change(self, kind: int, saved: bytes | None = None) -> None:
        """Write the event of a machine that was changed by hand.

        Args:
            kind: one of `MachineEvent.KIND_...`.
            saved: the machine after it; None: as it is now.
        """
        self._events += 1
        plant = self._session.plant
        if saved is not None:
            plant = Plant(self._session.scene)
            plant.restore(saved)
        self._write_message(
            "emulator/events",
            tick=self._session.tick,
            number=self._events,
            kind=kind,
            powered=plant.powered,
            machine=1,
            state=array("B", plant.save()),
        )

    def _write_message(self, topic: str, **values: Any) -> None:
        self._clock += 1000  # answers come after their questions
        session = self._session
        message = get_message_class(TYPES[topic])(
            header=Header(stamp=convert_to_stamp(session.logical_ns)), **values
        )
        if topic == "motor_states":
            self._fields.size_message(message, session.measured)
        data = serialize_message(message)
        self._writer.write_message(self._numbers[topic], self._clock, self._clock, data)
