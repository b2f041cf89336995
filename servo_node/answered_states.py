"""The servo's messages in C (c/answered_states.h): what it works on."""

import numpy as np
from sensor_msgs.msg import JointState

from arm_emulator.base.validation.bound import (
    BRAKE_CLOSED,
    COMMAND,
    CURRENT,
    EFFORT,
    POSITION,
    VELOCITY,
)
from arm_emulator.ros.messages.message_reader import STAMP, MessageReader, RowBounds
from arm_emulator.ros.messages.middleware import Outgoing, get_middleware
from arm_emulator.servo.servo_arm import ServoArm
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator_msgs.msg import MotorState
from servo_node.c import ANSWERED_STATES, make_answered_states_unit

MACHINE_SILENCE = 1.0  # s, wall: an emulator silent for so long may be replaced by another

answered_states = compile_once(make_answered_states_unit)


class AnsweredStates:
    """The state of the servo among its messages.

    Attributes:
        at: ``answered_states *``.
        states, targets: readers of motor states and joint targets.
        movable, q, v, tau: what is published of the joints, (N,) each.

    Args:
        config: of the servo.
        drives: the drives.
        lockstep: whether each motion period waits for its targets.
        motion_ticks: servo periods in a motion period.
        report_ticks: servo periods between joint states.
    """

    def __init__(
        self,
        config: ServoConfig,
        drives: ServoArm,
        *,
        lockstep: bool,
        motion_ticks: int,
        report_ticks: int,
    ) -> None:
        servo, names = drives.servo, config.joint_names
        N = len(names)
        counts, brake = np.zeros((2, N), np.int64)
        current, applied, q, v, tau = np.zeros((5, N))
        self._aimed = np.zeros(N)
        self.movable = np.zeros(N, np.int64)
        self.q, self.v, self.tau = np.zeros((3, N))
        self.at = ANSWERED_STATES.make_struct(
            "answered_states",
            lockstep=lockstep,
            arm=servo.arm,
            publish=get_middleware().ros_publish,
            counts=counts,
            brake=brake,
            movable=self.movable,
            current=current,
            applied=applied,
            q=q,
            v=v,
            tau=tau,
            aimed=self._aimed,
            volts=servo.commanded,
            q_measured=self.q,
            v_measured=self.v,
            tau_measured=self.tau,
            period=round(config.period * 1e9),
            motion_ticks=motion_ticks,
            report_ticks=report_ticks,
            longest_quiet=round(MACHINE_SILENCE * 1e9),
            tick=-1,
            cycle_before_reset=-1,
        )
        ffi, at = ANSWERED_STATES.ffi, self.at
        self.states = MessageReader(
            "motor_states",
            MotorState,
            names,
            "joint_names",
            {
                "encoder_counts": RowBounds(counts, config.counts),
                "current": RowBounds(current, CURRENT),
                "applied": RowBounds(applied, COMMAND, is_optional=True),
                "brake_closed": RowBounds(brake, BRAKE_CLOSED, is_optional=True),
            },
            {
                STAMP: ffi.addressof(at, "state_time"),
                "tick": ffi.addressof(at, "state_tick"),
                "powered": ffi.addressof(at, "state_powered"),
                "machine": ffi.addressof(at, "state_machine"),
            },
        )
        self.targets = MessageReader(
            "joint_targets",
            JointState,
            names,
            "name",
            {
                "position": RowBounds(q, POSITION),
                "velocity": RowBounds(v, VELOCITY, is_optional=True),
                "effort": RowBounds(tau, EFFORT, is_optional=True),
            },
            {STAMP: ffi.addressof(at, "target_time")},
        )
        at.state, at.target = self.states.struct, self.targets.struct
        at.applied_field, at.brake_field = map(self.states.find_field, ("applied", "brake_closed"))
        at.v_field, at.tau_field = map(self.targets.find_field, ("velocity", "effort"))

    def publish_on(self, command: Outgoing, state: Outgoing, joint_state: Outgoing) -> None:
        """Let C publish motor commands, servo states and joint states."""
        at = self.at
        for outgoing in (command, state, joint_state):
            outgoing.bind_to_c()  # nothing is taken once the node has no publishers
        at.motor_command, at.servo_state, at.joint_state = (
            outgoing.struct for outgoing in (command, state, joint_state)
        )
        at.machine_at = command.layout.places["machine"]
