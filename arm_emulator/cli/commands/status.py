"""Print the state of a running network: its clock, its nodes' health, its newest target."""

from __future__ import annotations

from typing import Annotated, Any

from cyclopts import Parameter
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState

from arm_emulator.cli.command import command
from arm_emulator.cli.output import output
from arm_emulator.ros.network_guest import STATES, guest
from arm_emulator.ros.node_shell import DIAGNOSTICS_QOS, EVENT_QOS, STATE_SUB_QOS
from arm_emulator_msgs.msg import EmulatorStatus, MotionStatus

NODES = ("emulator", "servo", "motion_controller")
OTHERS_WITHIN = 0.3  # s, for the arrival of all kept statuses
TARGET_WITHIN = 1.0  # s, for the arrival of the newest status of a target
PHASES = {
    EmulatorStatus.PHASE_FREE_RUNNING: "free running",
    EmulatorStatus.PHASE_WAITING: "waiting",
    EmulatorStatus.PHASE_RUNNING: "running",
    EmulatorStatus.PHASE_PAUSED: "paused",
    EmulatorStatus.PHASE_STOPPED: "stopped",
}


@command(of_ros=True, keys="`nodes`, `clock`, `joints`, `target` (those that the network has)")
def status(
    *,
    timeout: Annotated[float, Parameter(metavar="S")] = 3.0,
    namespace: str = "",
) -> int:
    """Print the state of a running network; the exit code is 1 if a node is missing or not healthy.

    Args:
        timeout: wall time to wait for missing nodes.
        namespace: of the network, such as /cell1.
    """
    health: dict[str, DiagnosticStatus] = {}
    prefix = f"{namespace.strip('/')}/" if namespace.strip("/") else ""

    def take(array: DiagnosticArray) -> None:
        health.update({one.name.removeprefix(prefix): one for one in array.status})

    with guest("status", namespace) as node:
        node.create_subscription(DiagnosticArray, "diagnostics", take, DIAGNOSTICS_QOS)
        node.listen("emulator/status", EmulatorStatus, STATE_SUB_QOS)
        node.listen("joint_states", JointState, STATE_SUB_QOS)
        node.listen("motion/status", MotionStatus, EVENT_QOS)
        wanted = {"emulator/status", "joint_states"}
        node.spin_until(lambda: wanted <= set(node.newest) and set(NODES) <= set(health), timeout)
        # A network without a target publishes no status.
        # Of a network with targets, the kept statuses arrive one after the other.
        if node.spin_until(lambda: "motion/status" in node.newest, min(timeout, TARGET_WITHIN)):
            node.spin_until(lambda: False, OTHERS_WITHIN)
        newest = node.newest
    facts: dict[str, Any] = {"nodes": {}}
    if "emulator/status" in newest:
        clock = newest["emulator/status"]
        facts["clock"] = {
            "phase": PHASES.get(clock.phase, str(clock.phase)),
            "powered": clock.powered,
            "tick": clock.tick,
            "logical_time": clock.logical_time,
            "real_time_factor": clock.real_time_factor,
        }
        power = "on" if clock.powered else "off"
        output.line(
            f"machine            {facts['clock']['phase']}, power {power}, tick {clock.tick}, "
            f"{clock.logical_time:g} s of logical time, {clock.real_time_factor:.2f} of real time"
        )
    if "joint_states" in newest:
        now = newest["joint_states"]
        facts["joints"] = dict(zip(now.name, now.position, strict=True))
        words = ", ".join(f"{name} {value:+.4f}" for name, value in facts["joints"].items())
        output.line(f"joints             {words} (rad or m)")
    if "motion/status" in newest:
        target = newest["motion/status"]
        facts["target"] = {"state": STATES.get(target.state, ""), "reason": target.reason}
        reason = f": {target.reason}" if target.reason else ""
        output.line(f"newest target      {facts['target']['state']}{reason}")
    bad = 0
    for name in NODES:
        one = health.get(name)
        level = "missing" if one is None else _level(one)
        facts["nodes"][name] = {"level": level, "message": one.message if one else ""}
        bad += level != "ok"
        output.line(f"{name:<18} {level}{f': {one.message}' if one and one.message else ''}")
    if len(health.keys() & set(NODES)) == 0:
        output.line("no network: start one (`arm_emulator up`) in this ROS_DOMAIN_ID and namespace")
    output.facts(facts)
    return int(bad > 0)


def _level(one: DiagnosticStatus) -> str:
    levels = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning"}
    return levels.get(one.level, "error")
