"""Context shared by the objects of the emulator's node."""

import threading
from dataclasses import dataclass, field

from arm_emulator.machine.session.pace import Pace
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_shell import Diagnostics
from emulator_node.outgoing_messages import OutgoingMessages
from emulator_node.recorder_gate import RecorderGate
from emulator_node.view import MachineView


@dataclass(frozen=True)
class Context:
    """The node, its machine, and its outgoing messages.

    Attributes:
        node: whose topics, services and log are used.
        session: the machine.
        diagnostics: of the node.
        gate: recorders that have to keep up.
        outgoing: outgoing messages.
        view: display of ticks.
        pace: limit of how fast logical time passes in lock-step.
        lock: guards all of it: between the executor, which serves topics and services, and a thread
            of the pacer.
    """

    node: ManagedNode
    session: Session
    diagnostics: Diagnostics
    gate: RecorderGate
    outgoing: OutgoingMessages
    view: MachineView
    pace: Pace
    lock: threading.RLock = field(default_factory=threading.RLock)
