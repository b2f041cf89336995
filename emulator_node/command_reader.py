"""Motor commands that C takes (c/motor_commands.h)."""

from array import array

import numpy as np
from rclpy.serialization import serialize_message

from arm_emulator.base.validation.bound import COMMAND
from arm_emulator.machine.plant.inputs import list_further_inputs
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.ros.messages.message_reader import MessageReader, RowBounds
from arm_emulator.ros.node.duplicate_nodes import get_start_time
from arm_emulator.toolchain.c_header import CData
from arm_emulator_msgs.msg import MotorCommand
from emulator_node.c import MOTOR_COMMANDS

SPARE_BYTES = 64  # bytes of a message, for its frame and padding


class CommandReader:
    """Reads the commands of a machine in C.

    Attributes:
        largest: size of messages that C takes, at most [bytes].

    Args:
        scene: the machine.
        struct: ``motor_commands *``.
        number: of their topic in the log of C.
    """

    def __init__(self, scene: Scene, struct: CData, number: int) -> None:
        names, at = scene.joint_names, MOTOR_COMMANDS.ffi.addressof
        N = len(names)
        commands = np.zeros((1 + len(list_further_inputs(scene))) * N)
        example = MotorCommand(joint_names=names, command=array("d", commands[:N]))
        self.largest = len(serialize_message(example)) + SPARE_BYTES
        self._reader = reader = MessageReader(
            "motor_commands",
            MotorCommand,
            names,
            "joint_names",
            {"command": RowBounds(commands[:N], COMMAND)},
            {"tick": at(struct, "tick"), "machine": at(struct, "machine")},
        )
        MOTOR_COMMANDS.fill_struct(
            struct,
            reader=reader.struct,
            input_names=reader.find_field("input_names"),
            inputs=reader.find_field("inputs"),
            largest=self.largest,
            came=commands,
            emulator=get_start_time(),
            number=number,
        )
