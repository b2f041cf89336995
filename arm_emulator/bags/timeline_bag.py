"""A timeline written as a bag, which names the bag of the run that it forked from."""

from __future__ import annotations

import json
import time
from array import array
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.build_facts import build_facts
from arm_emulator.machine.measured_fields import MeasuredFields
from arm_emulator.machine.plant import Plant
from arm_emulator.ros.bag import Bag
from arm_emulator.ros.bag_metadata import FORKED_AT, PARENT, Topic
from arm_emulator.ros.bag_writer import BagWriter
from arm_emulator.ros.message_types import definition_of
from arm_emulator.ros.node_shell import stamp
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.order import Order, Push, SetVaried, SwitchPower, as_data
from arm_emulator.runs.timeline import Change, Timeline
from arm_emulator_msgs.msg import EmulatorStatus, MachineEvent, MotorState

CHANGES, ORDERS = "changes", "orders"  # in words, and as data
KINDS: dict[type, int] = {  # of orders that change the machine
    SwitchPower: MachineEvent.KIND_POWER,
    SetVaried: MachineEvent.KIND_SET_VARIED,
    Push: MachineEvent.KIND_EXTERNAL_WRENCH,
}
TYPES: dict[str, Any] = {
    "motor_states": MotorState,
    "emulator/joint_states": JointState,
    "emulator/events": MachineEvent,
    "emulator/status": EmulatorStatus,
    "diagnostics": DiagnosticArray,
}


def write_timeline(line: Timeline[OfflineRun], folder: Path, parent: Path | None = None) -> None:
    """Write a run from tick 0 to the newest one as a bag that `check-bag` repeats.

    An `Order` that changes the machine is an event of its kind, and the bag has all of them as
    data; any other change is the event of a machine that was restored. Afterwards the timeline is
    where it was.

    Args:
        line: the timeline.
        folder: the new bag.
        parent: the bag of the timeline that it forked from.

    Raises:
        Refusal: it begins later, has no parent, the parent's bag cannot be read, or the folder
            exists or cannot be made.
    """
    if line.first != 0:
        raise Refusal("write_timeline", "the timeline", "begin at tick 0", f"tick {line.first}")
    about = {CHANGES: ", ".join(f"{one.name} at tick {one.tick}" for one in line.changes)}
    orders = [(one.tick, one.made) for one in line.changes if isinstance(one.made, Order)]
    if len(orders) == len(line.changes):
        about[ORDERS] = json.dumps([{"tick": tick, **as_data(one)} for tick, one in orders])
    if parent is not None:
        if line.parent is None:
            raise Refusal("write_timeline", "the timeline", "be a fork of a parent", "none")
        Bag(parent)
        about |= {PARENT: str(parent), FORKED_AT: str(line.begins)}
    here = line.tick
    with BagWriter(folder, about) as writer:
        _Messages(line.run.session.scene, writer).write(line)
    line.go_to(here)


class _Messages:
    """Messages of a machine, as the emulator sends them."""

    def __init__(self, scene: Any, writer: BagWriter) -> None:
        self._scene, self._writer = scene, writer
        self._names = list(scene.joint_names)
        self._fields = MeasuredFields(scene, MotorState.get_fields_and_field_types())
        self._clock, self._events = time.time_ns(), 0
        self._numbers = {}
        for topic, kind in TYPES.items():
            name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
            self._numbers[topic] = writer.add_topic(Topic(f"/{topic}", name, definition_of(name)))

    def write(self, line: Timeline[OfflineRun]) -> None:
        """Write all ticks of a timeline, and what was changed by hand."""
        line.go_to(0)
        session = line.run.session
        facts = [KeyValue(key=key, value=one) for key, one in build_facts(session.plant).items()]
        health = DiagnosticStatus(name="emulator", hardware_id=self._scene.name, values=facts)
        self._send("diagnostics", session, status=[health])
        self._send("emulator/status", session, tick=0)
        changed: dict[int, list[Change]] = {}
        for one in line.changes:
            changed.setdefault(one.tick, []).append(one)
        if session.plant.save() != Plant(self._scene).save():
            self._event(session, MachineEvent.KIND_RESTORE)
        self._report(session)
        for tick in range(1, line.newest + 1):
            line.run.advance(1)  # not by the timeline: the state before changes is reported
            self._report(session)
            made = changed.get(tick, [])
            if all(isinstance(one.made, Order) for one in made):
                for one in made:
                    one.made(line.run)
                    if (kind := KINDS.get(type(one.made))) is not None:
                        self._event(session, kind)
            before = session.plant.save() if made else b""
            line.go_to(tick)
            if made and session.plant.save() != before:
                self._event(session, MachineEvent.KIND_RESTORE)

    def _report(self, session: Any) -> None:
        state = session.state
        self._send(
            "motor_states",
            session,
            tick=session.tick,
            powered=session.powered,
            machine=1,
            joint_names=self._names,
            imu_names=[one.name for one in self._scene.imus],
        )
        self._send(
            "emulator/joint_states",
            session,
            name=self._names,
            position=state.q.tolist(),
            velocity=state.v.tolist(),
            effort=state.gear_torque.tolist(),
        )

    def _event(self, session: Any, kind: int) -> None:
        self._events += 1
        self._send(
            "emulator/events",
            session,
            tick=session.tick,
            number=self._events,
            kind=kind,
            powered=session.powered,
            machine=1,
            state=array("B", session.plant.save()),
        )

    def _send(self, topic: str, session: Any, **values: Any) -> None:
        self._clock += 1000  # answers come after their questions
        message = TYPES[topic](header=Header(stamp=stamp(session.logical_ns)), **values)
        if topic == "motor_states":
            self._fields.begin(message, session.measured)
        data = serialize_message(message)
        self._writer.write(self._numbers[topic], self._clock, self._clock, data)
