"""Print the state of a running network: its clock, its nodes' health, its newest target."""

from typing import Annotated, Any, cast

from cyclopts import Parameter
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState

from arm_emulator.cli.command import command
from arm_emulator.cli.output import output
from arm_emulator.ros.messages.event_words import STATES
from arm_emulator.ros.node.network_client import NetworkClient, check_timeout, join_network
from arm_emulator.ros.node.node_shell import DIAGNOSTICS_QOS, EVENT_QOS, STATE_SUB_QOS
from arm_emulator.ros.node.sole_publisher import get_full_name, has_name
from arm_emulator_msgs.msg import EmulatorStatus, MachineEvent, MotionStatus

# Our nodes, and the topic on which a node of another maker publishes in the place of each.
NODES = {
    "emulator": "motor_states",
    "servo": "motor_commands",
    "motion_controller": "joint_targets",
}
OTHERS_WITHIN = 0.3  # s, for the arrival of all kept statuses
NAMED_WITHIN = 1.0  # s, for the names of nodes that publish
TARGET_WITHIN = 1.0  # s, for the arrival of the newest status of a target
PHASES = {
    EmulatorStatus.PHASE_FREE_RUNNING: "free running",
    EmulatorStatus.PHASE_WAITING: "waiting",
    EmulatorStatus.PHASE_RUNNING: "running",
    EmulatorStatus.PHASE_PAUSED: "paused",
    EmulatorStatus.PHASE_STOPPED: "stopped",
}


@command(keys="`nodes`, `clock`, `joints`, `target` (those that the network has)")
def show_status(
    *,
    timeout: Annotated[float, Parameter(metavar="S")] = 3.0,
    namespace: str = "",
) -> int:
    """Print the state of a running network; the exit code is 1 if a node is missing or not healthy.

    A node of another maker in the place of ours is `other`: its health is not known.

    Args:
        timeout: wall time to wait for missing nodes.
        namespace: of the network, such as /cell1.
    """
    check_timeout("status", timeout)
    health: dict[str, DiagnosticStatus] = {}
    prefix = f"{namespace.strip('/')}/" if namespace.strip("/") else ""

    def take_diagnostics(array: DiagnosticArray) -> None:
        health.update(
            {diagnostic.name.removeprefix(prefix): diagnostic for diagnostic in array.status}
        )

    sent_at = {"reset": 0, "target": 0}  # of the newest messages, wall time [ns]

    def take_event(event: MachineEvent, info: dict[str, int]) -> None:
        if event.kind == MachineEvent.KIND_RESET:
            sent_at["reset"] = max(sent_at["reset"], info["source_timestamp"])

    def take_target(target: MotionStatus, info: dict[str, int]) -> None:
        node.newest["motion/status"] = target
        sent_at["target"] = info["source_timestamp"]

    with join_network("status", namespace) as node:
        node.create_subscription(DiagnosticArray, "diagnostics", take_diagnostics, DIAGNOSTICS_QOS)
        # rclpy's type hint lacks callbacks that take the times of a message, too.
        events, statuses = cast("Any", take_event), cast("Any", take_target)
        node.create_subscription(MachineEvent, "emulator/events", events, EVENT_QOS)
        node.create_subscription(MotionStatus, "motion/status", statuses, EVENT_QOS)
        node.listen_to("emulator/status", EmulatorStatus, STATE_SUB_QOS)
        node.listen_to("joint_states", JointState, STATE_SUB_QOS)
        topics = {"emulator/status", "joint_states"}
        node.spin_until(lambda: topics <= set(node.newest) and set(NODES) <= set(health), timeout)
        # A network without a target publishes no status.
        # Of a network with targets, the kept statuses arrive one after the other.
        if node.spin_until(lambda: "motion/status" in node.newest, min(timeout, TARGET_WITHIN)):
            node.spin_until(lambda: False, OTHERS_WITHIN)
        newest = node.newest
        others = {name: _find_other_nodes(node, topic) for name, topic in NODES.items()}
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
        output.print_line(
            f"machine            {facts['clock']['phase']}, power {power}, tick {clock.tick}, "
            f"{clock.logical_time:g} s of logical time, {clock.real_time_factor:.2f} of real time"
        )
    if "joint_states" in newest:
        now = newest["joint_states"]
        facts["joints"] = dict(zip(now.name, now.position, strict=True))
        words = ", ".join(f"{name} {value:+.4f}" for name, value in facts["joints"].items())
        output.print_line(f"joints             {words} (rad or m)")
    if "motion/status" in newest:
        target = newest["motion/status"]
        before = sent_at["target"] < sent_at["reset"]
        facts["target"] = {"state": STATES.get(target.state, ""), "reason": target.reason}
        facts["target"]["before_reset"] = before
        reason = f": {target.reason}" if target.reason else ""
        when = " (before the newest reset)" if before else ""
        output.print_line(f"newest target      {facts['target']['state']}{reason}{when}")
    bad = 0
    for name in NODES:
        diagnostic = health.get(name)
        level = _get_level(diagnostic) if diagnostic else "other" if others[name] else "missing"
        words = _describe_health(diagnostic) if diagnostic else ", ".join(others[name])
        facts["nodes"][name] = {"level": level, "message": words}
        bad += level not in ("ok", "other")
        output.print_line(f"{name:<18} {level}{f': {words}' if words else ''}")
    if len(health.keys() & set(NODES)) == 0 and not any(others.values()):
        output.print_line(
            "no network: start one (`arm_emulator up`) in this ROS_DOMAIN_ID and namespace"
        )
    output.add_facts(facts)
    return int(bad > 0)


def _find_other_nodes(node: NetworkClient, topic: str) -> list[str]:
    """Return the nodes that publish a topic."""
    endpoints: list[Any] = []

    def has_all_names() -> bool:
        endpoints[:] = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
        return all(has_name(endpoint.node_name) for endpoint in endpoints)

    # The middleware finds a publisher before it knows of which node it is.
    node.spin_until(has_all_names, NAMED_WITHIN)
    names = {get_full_name(endpoint) for endpoint in endpoints}
    return sorted(f"node {name}" for name in names)


def _describe_health(health: DiagnosticStatus) -> str:
    """Return the health of a node in words, with the newest input that it has refused."""
    values = {pair.key: pair.value for pair in health.values}
    refused = sum(int(v) for k, v in values.items() if k.startswith("refused ") and v.isdecimal())
    if not refused:
        return str(health.message)
    newest = values.get("newest refusal", "")
    return f"{health.message}; refused so far: {refused}, the newest {newest}"


def _get_level(health: DiagnosticStatus) -> str:
    levels = {DiagnosticStatus.OK: "ok", DiagnosticStatus.WARN: "warning"}
    return levels.get(health.level, "error")
