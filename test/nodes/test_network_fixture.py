"""`arm_emulator.testing.network`: acknowledged targets, the bag of a failure, equal bits."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy
from draws import with_slow
from geometry_msgs.msg import PoseStamped
from network import wait_until_met
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Int64

from arm_emulator import Refusal, testing
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.ros.node.network_client import NetworkClient
from arm_emulator.ros.node.network_under_test import NetworkUnderTest
from arm_emulator.ros.node.node_shell import COMMAND_QOS, EVENT_QOS
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator_msgs.msg import MotionStatus

LONGEST = 120.0  # s, wall, for nodes of one process to find each other
TARGET = 0.43, 0.05, 0.64
ANGLES = {"waist": 0.1, "shoulder": 0.6, "elbow": 0.9}


@pytest.mark.slow
def test_a_failure_leaves_a_bag_that_is_driven_again_to_equal_bits(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    with pytest.raises(AssertionError, match="as asked") as failure:
        with testing.network(start="paused", log=tmp_path, keep=bag) as net:
            first = net.send_tool_target(TARGET, at=0.2)
            second = net.send_tool_target((9.0, 0.0, 0.0), at=0.3)
            assert net.state_of(first) == "accepted" and net.status.tick == 0, "time stands"
            with pytest.raises(AssertionError, match="not reached"):
                net.go_on()
                net.wait_for(second)
            net.power(False)
            net.wait_until(net.time + 0.1)
            raise AssertionError("as asked")
    assert failure.value.__notes__ == [f"driven again by: arm_emulator check-bag {bag}"]
    assert check_bag(bag, scene="three_axis") == 0
    assert "equal to the last bit" in capfd.readouterr().out


def test_a_motor_loses_its_torque(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Its joint stays behind the target, and the bag is driven again with the scene written."""
    bag, fault = tmp_path / "bag", "waist.controller_restarts"
    how: dict[str, Any] = {"start": "paused", "log": tmp_path, "keep": bag, "faults": [fault]}
    with pytest.raises(AssertionError, match="as asked") as failure:
        with testing.network(**how) as net:
            net.set_fault(fault)
            with pytest.raises(Refusal, match="elbow"):
                net.set_fault("elbow.controller_restarts")
            start = dict(zip(net.truth.name, net.truth.position, strict=True))
            target = {name: q + 0.2 for name, q in start.items()}
            net.send_joint_target(target, 0.5, at=0.1)
            net.go_on()
            net.wait_until(0.9)
            now = dict(zip(net.truth.name, net.truth.position, strict=True))
            off = {name: abs(target[name] - q) for name, q in now.items()}
            # Others may pull at the waist, but no motor moves it to its target.
            assert off["waist"] > 0.1 > 10.0 * off["elbow"], off
            raise AssertionError("as asked")
    (note,) = failure.value.__notes__
    scene = note.rpartition(" --scene ")[2]
    assert check_bag(bag, scene=scene) == 0
    assert "equal to the last bit" in capfd.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    "call",
    with_slow(
        [
            lambda net: net.power(False),
            lambda net: net.state_of(net.send_tool_target(TARGET)) == "accepted",
            lambda net: net.go_on(),
            lambda net: net.wait_until(0.0),
            lambda net: net.state_of(net.send_joint_target(ANGLES, 0.3)) == "accepted",
        ],
        2,
    ),
)
def test_the_first_call_waits_until_it_can_be_served(
    call: Callable[[NetworkUnderTest], bool | None], tmp_path: Path
) -> None:
    """Nodes start meanwhile: services refuse, and there is no robot description."""
    with testing.network(start="paused", log=tmp_path) as net:
        assert call(net) is not False


def test_a_target_is_heard_when_the_node_that_acts_on_it_listens() -> None:
    with own_domain():
        context = Context()
        context.init()
        try:
            sender, viewer, acting = (
                NetworkClient(name, "", context) for name in ("sender", "viewer", "acting")
            )
            publisher = sender.create_publisher(PoseStamped, "tool_target", COMMAND_QOS)
            viewer.listen_to("tool_target", PoseStamped, COMMAND_QOS)
            acting.create_publisher(MotionStatus, "motion/status", EVENT_QOS)
            status = "motion/status"
            assert sender.spin_until(lambda: publisher.get_subscription_count() > 0, LONGEST)
            assert sender.spin_until(lambda: sender.count_publishers(status) > 0, LONGEST)
            assert not sender.is_heard(publisher, status), "by another one"
            acting.listen_to("tool_target", PoseStamped, COMMAND_QOS)
            assert sender.spin_until(lambda: sender.is_heard(publisher, status), LONGEST)
            publisher.publish(PoseStamped())
            assert acting.spin_until(lambda: "tool_target" in acting.newest, LONGEST)
        finally:
            context.try_shutdown()


@pytest.mark.slow
def test_a_node_that_was_met_gets_every_single_publication() -> None:
    """By a best-effort subscription, which loses what comes from a publisher not known yet."""
    with own_domain() as domain:
        contexts = [Context(), Context()]
        for context in contexts:
            rclpy.init(context=context, domain_id=domain)
        sender, node = NetworkClient("sender", "", contexts[0]), Node("acting", context=contexts[1])
        heard: list[Int64] = []
        node.create_subscription(Int64, "numbers", heard.append, qos_profile_sensor_data)
        executor = SingleThreadedExecutor(context=contexts[1])
        executor.add_node(node)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        try:
            for k in range(20):
                publisher = sender.create_publisher(Int64, "numbers", 1)
                assert sender.spin_until(
                    lambda publisher=publisher: publisher.get_subscription_count(), LONGEST
                )
                assert wait_until_met(sender, "acting", LONGEST)
                publisher.publish(Int64(data=k))
                assert sender.spin_until(lambda k=k: len(heard) > k, LONGEST), f"number {k}"
            assert [message.data for message in heard] == list(range(20))
            assert not wait_until_met(sender, "nobody", 0.5)
        finally:
            executor.shutdown()
            thread.join()
            for context in contexts:
                context.try_shutdown()
