"""ROS node `servo`: joint targets and motor states in, motor commands and joint states out."""

from __future__ import annotations

if __name__ == "__main__":  # before slow imports
    import os
    import sys

    # Nothing is imported from the working folder, which -P leaves out by itself.
    if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
        sys.path[:] = [folder for folder in sys.path[1:] if folder != sys.path[0]]

    from arm_emulator.base.wheel import refuse_missing_modules
    from arm_emulator.ros.ctrl_c import end_at_once

    end_at_once(0)
    refuse_missing_modules("servo")

import time
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from arm_emulator.base.bound import BRAKE_CLOSED, COMMAND, CURRENT, EFFORT, POSITION, VELOCITY
from arm_emulator.base.joint_order import JointOrder
from arm_emulator.base.parameters import ROS_PARAMETERS, parameter
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.doubles import Doubles
from arm_emulator.ros.fixed_layout import Taking
from arm_emulator.ros.managed_node import ManagedNode
from arm_emulator.ros.middleware import Outgoing
from arm_emulator.ros.node_parameters import accept_changes, declare_parameters, describe, replaced
from arm_emulator.ros.node_shell import (
    COMMAND_QOS,
    COMMAND_SUB_QOS,
    NANOSECONDS,
    STATE_PUB_QOS,
    STATE_SUB_QOS,
    Diagnostics,
    run_node,
    set_stamp,
    time_of,
    wall_timer,
)
from arm_emulator.ros.precedence import precede
from arm_emulator.servo.drives import Drives, Target
from arm_emulator.servo.servo import Servo
from arm_emulator.servo.servo_config import SETTABLE, ServoConfig, declared
from arm_emulator.servo.watchdog import WatchdogState
from arm_emulator_msgs.msg import MotorCommand, MotorState, ServoState
from servo_node.answered_states import AnsweredStates

PARAMETERS = "parameters of node servo"
SILENCE_CHECK = 0.1  # s, wall
MACHINE_SILENCE = 1.0  # s, wall: an emulator silent for so long may be replaced by another


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

    In lock-step each motor state is answered once, and at the start of a motion period only after
    the joint targets that answer this period's joint states have come.
    """

    def __init__(self) -> None:
        super().__init__("servo")
        self._own = declare_parameters(self, ServoNodeParameters)
        given = self._servo_parameters({})
        if not given:
            raise Refusal(
                "node servo",
                "its parameters",
                "come from a file",
                "no file",
                "--ros-args --params-file config/servo/three_axis.yaml, or that of your arm",
            )
        self._config = ServoConfig.from_mapping(given, PARAMETERS)
        for name in given:
            one = declared(name)
            words = one.described if one else name.replace("_", " ")
            descriptor = ParameterDescriptor(description=words, dynamic_typing=True)
            if name.rsplit(".", 1)[-1] in SETTABLE:
                self.settable.add(name)
            describe(self, name, descriptor, one)
        self._next_config: ServoConfig | None = None  # from the next tick on
        accept_changes(self, self._changed, self._take_parameters)
        self._diagnostics = Diagnostics(self, "servo drives")
        self._doubles = Doubles(
            self,
            self._diagnostics,
            "servo",
            "motor_commands",
            "the emulator takes the commands of the first one",
        )
        self.start()

    def configure(self) -> None:
        """Create the drives, and their topics."""
        own = self._own
        self._lockstep = own.clock == "lockstep"
        if not self._lockstep:
            self._diagnostics.values["nice value"] = precede()
        self._period_ns = round(self._config.period * NANOSECONDS)
        self._motion_ticks = round(self._config.motion_period / self._config.period)
        names = self._config.joint_names
        self._states_order = JointOrder("motor_states", names)
        self._targets_order = JointOrder("joint_targets", names)
        self._counts = self._config.counts
        self._drives = Drives(self._config)
        self._next_config = None
        self.hot = self
        self._hot = AnsweredStates(
            self._config,
            self._drives,
            lockstep=self._lockstep,
            motion_ticks=self._motion_ticks,
            report_ticks=max(1, round(own.joint_states_period / self._config.period)),
        )
        self._at = self._hot.at
        self._heard_at = time.monotonic()
        self._at.tick = -1
        self._start_over()

        zeros = array("d", bytes(8 * len(names)))
        create, hot = self.create_publisher, self._hot
        self._command = Outgoing(
            create(MotorCommand, "motor_commands", COMMAND_QOS),
            MotorCommand(joint_names=names, command=zeros),
            further=[("command", self._drives.servo.commanded)],
        )
        self._state = Outgoing(
            create(ServoState, "servo_states", STATE_PUB_QOS),
            ServoState(joint_names=names, movable=array("q", zeros.tobytes())),
            further=[("movable", hot.movable)],
        )
        self._joint_state = Outgoing(
            create(JointState, "joint_states", STATE_PUB_QOS),
            JointState(name=names, position=zeros, velocity=zeros, effort=zeros),
            further=[("position", hot.q), ("velocity", hot.v), ("effort", hot.tau)],
        )
        refuse, subscribe = self._diagnostics.refuse, self.create_subscription
        states = Taking("motor_states", MotorState, self._on_state, refuse)
        targets = Taking("joint_targets", JointState, self._on_target, refuse)
        state = subscribe(
            MotorState, "motor_states", states.take, STATE_SUB_QOS, only_from="emulator", raw=True
        )
        target = subscribe(
            JointState,
            "joint_targets",
            targets.take,
            COMMAND_SUB_QOS,
            only_from="motion controller",
            raw=True,
        )
        hot.connect(
            (states, state),
            (targets, target),
            (self._command, self._state, self._joint_state),
        )
        self.takes, self.outgoing = hot.takes, hot.outgoing
        self.create_service(Trigger, "~/reset", self._on_reset)
        wall_timer(self, SILENCE_CHECK, self._on_silence_check)
        self._diagnostics.ok("inactive: no commands")

    def activate(self) -> None:
        """Answer motor states. In lock-step time has stood, and the servo goes on."""
        self._doubles.begin()
        if not self._lockstep:
            self._start_over()
        self._diagnostics.ok("active")

    def deactivate(self) -> None:
        """Answer no more; in real time the power is cut at last, since the arm goes on moving."""
        if not self._lockstep and self._at.tick >= 0:
            self._cut()
        self._doubles.end()
        self._diagnostics.ok("inactive: no commands")

    def _servo_parameters(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the servo's parameters, with some changed."""
        others = (*ROS_PARAMETERS, *vars(self._own))
        declared = {name: one.value for name, one in self._parameters.items()}
        return {
            name: value
            for name, value in {**declared, **changes}.items()
            if name.split(".")[0] not in others
        }

    def _changed(self, changes: Mapping[str, Any]) -> tuple[ServoNodeParameters, ServoConfig]:
        own = {name: value for name, value in changes.items() if name in vars(self._own)}
        config = ServoConfig.from_mapping(self._servo_parameters(changes), PARAMETERS)
        Servo(config)  # refuses invalid parameters
        return replaced(self, self._own, own), config

    def _take_parameters(self, both: tuple[ServoNodeParameters, ServoConfig]) -> None:
        self._own, config = both
        if self.configured:
            self._next_config = config
        else:
            self._config = config

    def begin(self) -> None:
        """Let messages be taken in C, see `HotPath`."""
        self._hot.begin(self._at.tick >= 0 and not self._silent and self._next_config is None)

    def end(self) -> None:
        """Take over the results of C, see `HotPath`."""
        at = self._at
        if at.states:
            self._heard_at = time.monotonic()
        if at.answers:
            self._drives.commanded(bool(at.powered))
            self._report_drives()

    def _start_over(self) -> None:
        self._drives.reset()
        # Stamp of targets that may be under way, to a question of before [ns]; None: of none.
        self._asked_before = self._at.cycle if self._at.tick >= 0 else None
        self._at.tick = -1  # no state has come
        self._at.waiting = 0  # for the joint targets of this motion period
        self._at.cycle = 0  # start of this motion period
        self._silent = False  # no motor states, and the power is cut

    @property
    def _time_ns(self) -> int:
        """Logical time of the newest motor state [ns]."""
        return int(self._at.tick) * self._period_ns

    # Topics

    def _on_state(self, message: Any, _: bytes) -> None:
        names, arrange, tick = message.joint_names, self._states_order.arrange, int(message.tick)
        try:
            self._check_time(message)
            counts = arrange(names, message.encoder_counts, self._counts)
            current = arrange(names, message.current, CURRENT)
            applied = arrange(names, message.applied, COMMAND) if len(message.applied) else None
            closed = (
                arrange(names, message.brake_closed, BRAKE_CLOSED)
                if len(message.brake_closed)
                else None
            )
            self._check_machine(int(message.machine))
        except Refusal as reason:
            self._diagnostics.refuse("motor_states", reason)
            return
        self._heard_at = time.monotonic()
        at = self._at
        if at.tick >= 0:
            if tick == at.tick:
                self._report_again()
                return
            # In lock-step no tick is skipped, unless it runs free: then nothing is lost.
            if tick < at.tick or (self._lockstep and tick > at.tick + 1):
                self._diagnostics.ok("the emulator began anew")
                self._start_over()
        at.tick, at.powered = tick, bool(message.powered)
        self._silent = False
        if self._next_config is not None:
            self._config, self._next_config = self._next_config, None
            self._drives.retune(self._config)
        self._drives.measure(self._time_ns, counts, current, applied, closed)
        begins = self._lockstep and self._motion_ticks > 0 and tick % self._motion_ticks == 0
        if begins:
            at.waiting, at.cycle = 1, self._time_ns
        if tick % at.report_ticks == 0 or begins:
            self._report_joint_states(self._time_ns)
        if not at.waiting:
            self._answer()

    def _check_machine(self, machine: int) -> None:
        """Serve the emulator that was started first, as long as it publishes."""
        if machine in (0, self._at.machine):
            return
        silence = time.monotonic() - self._heard_at
        if 0 < self._at.machine < machine and silence < MACHINE_SILENCE:
            raise Refusal(
                "motor_states",
                "machine",
                f"be {self._at.machine}, the emulator that was started first",
                machine,
            )
        if self._at.tick >= 0:
            self._diagnostics.ok("the emulator began anew")
            self._start_over()
        self._at.machine = machine

    def _check_time(self, message: Any) -> None:
        time_ns, tick = time_of("motor_states", message.header.stamp), int(message.tick)
        if time_ns != tick * self._period_ns:
            raise Refusal(
                "motor_states",
                "header.stamp",
                f"be tick x servo period, {tick} x {self._config.period:g} s",
                f"{time_ns / NANOSECONDS:g} s",
            )

    def _on_target(self, message: Any, _: bytes) -> None:
        try:
            target = self._read_target(message)
        except Refusal as reason:
            self._diagnostics.refuse("joint_targets", reason)
            return
        if target is None:
            return
        if self._lockstep and self._motion_ticks and not self._at.waiting:
            return  # this motion period's targets, published again
        self._drives.aim(target)
        if self._at.waiting:
            self._at.waiting = 0
            self._answer()

    def _read_target(self, message: Any) -> Target | None:
        """Return the targets of a message; None of those that are late, which are counted.

        Raises:
            Refusal: they are not valid, or answer no joint states.
        """
        arrange, names = self._targets_order.arrange, message.name
        time_ns = time_of("joint_targets", message.header.stamp)
        target = Target(
            arrange(names, message.position, POSITION),
            arrange(names, message.velocity, VELOCITY) if len(message.velocity) else None,
            arrange(names, message.effort, EFFORT) if len(message.effort) else None,
        )
        if self._lockstep and self._motion_ticks and time_ns != self._at.cycle:
            if late := self._late(time_ns, target):
                self._diagnostics.count(f"joint_targets {late}")
                return None
            raise Refusal(
                "joint_targets",
                "header.stamp",
                f"be that of the joint states it answers, {self._at.cycle / NANOSECONDS:g} s",
                f"{time_ns / NANOSECONDS:g} s",
            )
        return target

    def _late(self, time_ns: int, target: Target) -> str:
        """Return why targets for another time come late; "": they do not.

        A motion controller answers joint states once more that are repeated to it.
        """
        before = self._at.cycle - self._motion_ticks * self._period_ns
        if time_ns == before and np.array_equal(target.q, self._drives.servo.targeted):
            return "repeated"
        return "before the reset" if time_ns == self._asked_before else ""

    # Control law

    def _answer(self) -> None:
        """Compute and publish the commands for the servo period that begins."""
        self._command.layout.message.command[:] = self._drives.command(bool(self._at.powered))
        self._publish_command()
        self._report_drives()

    def _report_drives(self) -> None:
        drives, diagnostics = self._drives, self._diagnostics
        restarts = drives.servo.restarts
        if restarts != diagnostics.values.get("began anew", 0):
            diagnostics.values["began anew"] = restarts
            diagnostics.error("the servo's state was no longer finite and began anew")
        elif drives.state is WatchdogState.OK:
            diagnostics.ok("following")
        elif drives.state is WatchdogState.HOLD:
            diagnostics.warn(f"holding: {drives.reason}")
        else:
            diagnostics.error(drives.reason)

    # Publishing

    def _publish_command(self) -> None:
        """Publish the newest commands, as the answer to the newest motor state."""
        command = self._command.layout.message
        set_stamp(command.header.stamp, self._time_ns)
        command.tick, command.machine = self._at.tick, self._at.machine
        self._command.publish()

    def _report_joint_states(self, time_ns: int) -> None:
        drives, state, joints = self._drives, self._state.layout.message, self._joint_state.layout
        set_stamp(state.header.stamp, time_ns)
        state.movable[:] = drives.movable(bool(self._at.powered))
        self._state.publish()
        set_stamp(joints.message.header.stamp, time_ns)
        joints.message.position[:] = drives.servo.q_measured
        joints.message.velocity[:] = drives.servo.v_measured
        joints.message.effort[:] = drives.servo.tau_measured
        self._joint_state.publish()

    def _report_again(self) -> None:
        """Repeat the answer: a partner came late, or lost a message."""
        if self._at.waiting:
            # As at the motion period's start, even if another servo has answered ticks since.
            self._report_joint_states(self._at.cycle)
            self._diagnostics.warn(
                f"waiting for the joint targets that answer t = {self._at.cycle / NANOSECONDS:g} s"
            )
        else:
            self._publish_command()

    def _on_silence_check(self) -> None:
        """Cut the power when a running machine falls silent.

        In lock-step silence means that logical time stands still, and with it the arm.
        """
        silence = time.monotonic() - self._heard_at
        if self._at.tick < 0 or silence < self._config.cut_after:
            return
        self._diagnostics.warn(f"no motor state for {silence:.0f} s")
        if not self._lockstep and not self._silent:
            self._silent = True
            self._cut()

    def _cut(self) -> None:
        """Publish commands of 0."""
        self._command.layout.message.command[:] = 0.0
        self._publish_command()

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._start_over()
        self._at.machine = 0
        response.success, response.message = True, "servo and watchdog start over"
        return response


def main() -> None:
    """Entry point of `ros2 run arm_emulator servo_node`."""
    run_node(ServoNode)


if __name__ == "__main__":
    main()
