"""ROS node `servo`: joint targets and motor states in, motor commands and joint states out."""

if __name__ == "__main__":  # before slow imports
    import os
    import sys

    # Nothing is imported from the working folder, which -P leaves out by itself.
    if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
        sys.path[:] = [folder for folder in sys.path[1:] if folder != sys.path[0]]

    from arm_emulator.base.required_package import refuse_missing_modules
    from arm_emulator.ros.process.ctrl_c import end_at_once

    end_at_once(0)
    refuse_missing_modules("servo")

import time
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.parameters import ROS_PARAMETERS, parameter
from arm_emulator.ros.messages.middleware import Outgoing
from arm_emulator.ros.messages.time_stamp import NANOSECONDS
from arm_emulator.ros.node.duplicate_nodes import DuplicateNodes
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_parameters import (
    accept_changes,
    declare_parameters,
    describe_parameter,
    replace_parameters,
)
from arm_emulator.ros.node.node_shell import (
    COMMAND_QOS,
    COMMAND_SUB_QOS,
    STATE_PUB_QOS,
    STATE_SUB_QOS,
    Diagnostics,
    create_wall_timer,
    run_node,
)
from arm_emulator.ros.process.priority import raise_priority
from arm_emulator.servo.servo import Servo
from arm_emulator.servo.servo_arm import ServoArm
from arm_emulator.servo.servo_config import SETTABLE, ServoConfig, find_declared_number
from arm_emulator.servo.watchdog import WatchdogState
from arm_emulator_msgs.msg import MotorCommand, MotorState, ServoState
from servo_node.answered_states import AnsweredStates, answered_states
from servo_node.c import ANSWERED_STATES

PARAMETERS = "parameters of node servo"
SILENCE_CHECK = 0.1  # s, wall
REPEATED, RESTARTED, STATE_OFF_TIME, OF_ANOTHER = map(
    ANSWERED_STATES.get_constant,
    ("STATE_REPEATED", "STATE_RESTARTED", "STATE_OFF_TIME", "STATE_OF_ANOTHER"),
)
DUE, TARGET_OFF_TIME = map(ANSWERED_STATES.get_constant, ("TARGET_DUE", "TARGET_OFF_TIME"))
LATE = {  # words for diagnostics
    ANSWERED_STATES.get_constant("TARGET_REPEATED"): "repeated",
    ANSWERED_STATES.get_constant("TARGET_BEFORE_RESET"): "before the reset",
}


@dataclass(frozen=True)
class ServoNodeParameters:
    """The node's own parameters; the servo's are those of `ServoConfig`."""

    clock: str = parameter(
        "lockstep",
        "lockstep: wait for the joint targets of each motion period; realtime: take the newest",
        choices=("lockstep", "realtime"),
    )
    joint_states_period: float = parameter(
        0.01, "logical time between messages on joint_states", unit="s", ends=(1e-6, 10.0)
    )


class ServoNode(ManagedNode):
    """The servo as a ROS node.

    In lock-step each motor state is answered once. At the start of a motion period the answer waits
    for the joint targets that answer this period's joint states.
    """

    def __init__(self) -> None:
        super().__init__("servo")
        self._own = declare_parameters(self, ServoNodeParameters)
        parameters = self._read_servo_parameters({})
        if not parameters:
            raise Refusal(
                "node servo",
                "its parameters",
                "come from a file",
                "no file",
                "--ros-args --params-file config/servo/three_axis.yaml, or that of your arm",
            )
        self._config = ServoConfig.from_mapping(parameters, PARAMETERS)
        for name in parameters:
            number = find_declared_number(name)
            words = number.described if number else name.replace("_", " ")
            descriptor = ParameterDescriptor(description=words, dynamic_typing=True)
            if name.rsplit(".", 1)[-1] in SETTABLE:
                self.settable.add(name)
            describe_parameter(self, name, descriptor, number)
        self._next_config: ServoConfig | None = None  # from the next tick on
        accept_changes(self, self._check_changes, self._take_parameters)
        self._diagnostics = Diagnostics(self, "servo drives")
        self._duplicates = DuplicateNodes(
            self,
            self._diagnostics,
            "servo",
            "motor_commands",
            "the emulator takes the commands of the first one",
        )
        self.start_lifecycle()

    def create_entities(self) -> None:
        """Create the drives, and their topics."""
        own, names = self._own, self._config.joint_names
        self._lockstep = own.clock == "lockstep"
        if not self._lockstep:
            self._diagnostics.values["nice value"] = raise_priority()
        self._drives = ServoArm(self._config)
        self._next_config = None
        self._hot = hot = AnsweredStates(
            self._config,
            self._drives,
            lockstep=self._lockstep,
            motion_ticks=round(self._config.motion_period / self._config.period),
            report_ticks=max(1, round(own.joint_states_period / self._config.period)),
        )
        self._at, self._calls = hot.at, answered_states()
        self._at.heard = read_clock()
        zeros = array("d", bytes(8 * len(names)))
        create, subscribe = self.create_publisher, self.create_subscription
        self.outgoing = (
            Outgoing(
                create(MotorCommand, "motor_commands", COMMAND_QOS),
                MotorCommand(joint_names=names, command=zeros),
                further=[("command", self._drives.servo.commanded)],
            ),
            Outgoing(
                create(ServoState, "servo_states", STATE_PUB_QOS),
                ServoState(joint_names=names, movable=array("q", zeros.tobytes())),
                further=[("movable", hot.movable)],
            ),
            Outgoing(
                create(JointState, "joint_states", STATE_PUB_QOS),
                JointState(name=names, position=zeros, velocity=zeros, effort=zeros),
                further=[("position", hot.q), ("velocity", hot.v), ("effort", hot.tau)],
            ),
        )
        hot.publish_on(*self.outgoing)
        state = subscribe(
            MotorState,
            "motor_states",
            self._handle_state,
            STATE_SUB_QOS,
            only_from="emulator",
            raw=True,
        )
        target = subscribe(
            JointState,
            "joint_targets",
            self._take_target,
            COMMAND_SUB_QOS,
            only_from="motion controller",
            raw=True,
        )
        argument = ANSWERED_STATES.ffi.cast("void *", hot.at)
        self.takes = (
            (state, self._calls.answered_states_receive, argument),
            (target, self._calls.answered_states_receive_target, argument),
        )
        self.hot = self
        self.create_service(Trigger, "~/reset", self._handle_reset)
        create_wall_timer(self, SILENCE_CHECK, self._check_silence)
        self._diagnostics.report_ok("inactive: no commands")

    def begin_work(self) -> None:
        """Answer motor states. In lock-step time has stood, and the servo goes on."""
        self._duplicates.announce_node()
        if not self._lockstep:
            self._start_over()
        self._diagnostics.report_ok("active")

    def stop_work(self) -> None:
        """Answer no more; in real time the power is cut at last, since the arm goes on moving."""
        if not self._lockstep and self._at.tick >= 0:
            self._cut_power()
        self._duplicates.withdraw_node()
        self._diagnostics.report_ok("inactive: no commands")

    def _read_servo_parameters(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the servo's parameters, with some changed."""
        others = (*ROS_PARAMETERS, *vars(self._own))
        declared = {name: number.value for name, number in self._parameters.items()}
        return {
            name: value
            for name, value in {**declared, **changes}.items()
            if name.split(".")[0] not in others
        }

    def _check_changes(self, changes: Mapping[str, Any]) -> tuple[ServoNodeParameters, ServoConfig]:
        own = {name: value for name, value in changes.items() if name in vars(self._own)}
        config = ServoConfig.from_mapping(self._read_servo_parameters(changes), PARAMETERS)
        Servo(config)  # refuses invalid parameters
        return replace_parameters(self, self._own, own), config

    def _take_parameters(self, both: tuple[ServoNodeParameters, ServoConfig]) -> None:
        self._own, config = both
        if self.configured:
            self._next_config = config
        else:
            self._config = config

    def begin_in_c(self) -> None:
        """Let messages be taken in C, see `HotPath`."""
        self._at.open = self._next_config is None
        self._at.states = self._at.answers = 0

    def end_in_c(self) -> None:
        """Take over the results of C, see `HotPath`."""
        at = self._at
        if at.states:
            at.heard = read_clock()
        if at.answers:
            self._drives.note_command(bool(at.powered))
            self._report_drives()

    def _start_over(self) -> None:
        self._drives.reset()
        at = self._at
        at.cycle_before_reset = at.cycle if at.tick >= 0 else -1
        at.tick = -1
        at.waiting = at.cycle = at.silent = 0

    # Topics

    def _handle_state(self, data: bytes) -> None:
        at, calls, diagnostics = self._at, self._calls, self._diagnostics
        at.now = read_clock()
        verdict = calls.answered_states_classify(at, data, len(data))
        if refusal := self._find_refusal(verdict, data):
            diagnostics.refuse_input("motor_states", refusal)
            return
        at.heard = at.now
        if verdict == REPEATED:  # a partner came late, or lost a message
            calls.answered_states_repeat(at)
            if at.waiting:
                diagnostics.report_warning(
                    f"waiting for the joint targets that answer t = {_format_seconds(at.cycle)}"
                )
            return
        if verdict == RESTARTED:
            diagnostics.report_ok("the emulator began anew")
            self._start_over()
        if self._next_config is not None:
            self._config, self._next_config = self._next_config, None
            self._drives.set_config(self._config)
        at.answers = 0
        calls.answered_states_accept(at)
        self.end_in_c()

    def _find_refusal(self, verdict: int, data: bytes) -> Refusal | None:
        at = self._at
        if verdict == STATE_OFF_TIME:
            rule = f"be tick x servo period, {at.state_tick} x {self._config.period:g} s"
            return Refusal("motor_states", "header.stamp", rule, _format_seconds(at.state_time))
        if verdict == OF_ANOTHER:
            rule = f"be {at.machine}, the emulator that was started first"
            return Refusal("motor_states", "machine", rule, at.state_machine)
        return self._hot.states.make_refusal(data)

    def _take_target(self, data: bytes) -> None:
        at, calls, diagnostics = self._at, self._calls, self._diagnostics
        verdict = calls.answered_states_classify_target(at, data, len(data))
        if verdict in LATE:
            diagnostics.count_input(f"joint_targets {LATE[verdict]}")
        elif verdict == TARGET_OFF_TIME:
            rule = f"be that of the joint states it answers, {_format_seconds(at.cycle)}"
            refusal = Refusal(
                "joint_targets", "header.stamp", rule, _format_seconds(at.target_time)
            )
            diagnostics.refuse_input("joint_targets", refusal)
        elif malformed := self._hot.targets.make_refusal(data):
            diagnostics.refuse_input("joint_targets", malformed)
        elif verdict == DUE:
            at.states = at.answers = 0
            calls.answered_states_set_target(at)
            self.end_in_c()

    def _report_drives(self) -> None:
        drives, diagnostics = self._drives, self._diagnostics
        restarts = drives.servo.restarts
        if restarts != diagnostics.values.get("began anew", 0):
            diagnostics.values["began anew"] = restarts
            diagnostics.report_error("the servo's state was no longer finite and began anew")
        elif drives.state is WatchdogState.OK:
            diagnostics.report_ok("following")
        elif drives.state is WatchdogState.HOLD:
            diagnostics.report_warning(f"holding: {drives.reason}")
        else:
            diagnostics.report_error(drives.reason)

    def _check_silence(self) -> None:
        """Cut the power when a running machine falls silent.

        In lock-step silence means that logical time stands still, and with it the arm.
        """
        silence = (read_clock() - self._at.heard) / NANOSECONDS
        if self._at.tick < 0 or silence < self._config.cut_after:
            return
        self._diagnostics.report_warning(f"no motor state for {silence:.0f} s")
        if not self._lockstep and not self._at.silent:
            self._at.silent = 1
            self._cut_power()

    def _cut_power(self) -> None:
        """Publish commands of 0."""
        self._drives.servo.commanded[:] = 0.0
        self._calls.answered_states_repeat(self._at)

    def _handle_reset(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self._start_over()
        self._at.machine = 0
        response.success, response.message = True, "servo and watchdog start over"
        return response


def read_clock() -> int:
    """Return the monotonic wall time [ns]."""
    return round(time.monotonic() * NANOSECONDS)


def _format_seconds(nanoseconds: int) -> str:
    return f"{nanoseconds / NANOSECONDS:g} s"


def main() -> None:
    """Entry point of `ros2 run arm_emulator servo_node`."""
    run_node(ServoNode)


if __name__ == "__main__":
    main()
