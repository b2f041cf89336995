"""Whom a publisher that soon leaves again waits for, in networks that are made up."""

from collections.abc import Callable
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import pytest

from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.ros.recording.recorded_publisher import await_recorders
from arm_emulator.ros.recording.recorder_presence import RecorderPresence

LONG = ["x" * 200, "y" * 200]  # for which the announcement has no room


class MadeUpNetwork:
    """Recorders that report to an emulator, and readers of a topic, as a node sees them."""

    def __init__(self, reports: int, readers: list[str]) -> None:
        self._reports, self._readers = reports, readers
        self.is_satisfied = False

    def resolve_topic_name(self, name: str) -> str:
        return f"/{name}"

    def count_publishers(self, topic: str) -> int:
        return 0

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return [SimpleNamespace(node_name="recorder")] * self._reports

    def get_subscriptions_info_by_topic(self, topic: str) -> list[Any]:
        return [SimpleNamespace(node_name=name) for name in self._readers]

    def spin_until(self, condition: Callable[[], bool], patience: float) -> bool:
        self.is_satisfied = condition()
        return self.is_satisfied


@pytest.mark.parametrize(
    ("announced", "reports", "recorders", "is_satisfied"),
    [
        ([], 0, 0, True),
        ([["motor_states", *LONG]], 1, 0, True),
        ([["/tool_target", "tool_target"]], 0, 0, False),
        ([["/tool_target"]], 0, 1, True),
        ([None], 1, 0, False),
        ([None], 1, 1, True),
        ([None, ["motor_states"]], 2, 1, True),
        ([["motor_states"]], 2, 0, False),  # one on another computer, whose topics are not known
    ],
)
def test_a_message_waits_for_recorders_of_its_topic(
    announced: list[list[str] | None], reports: int, recorders: int, is_satisfied: bool
) -> None:
    readers = ["motion_controller", *["recorder"] * recorders]
    network: Any = MadeUpNetwork(reports, readers)
    publisher: Any = SimpleNamespace(
        topic_name="/tool_target", get_subscription_count=lambda: len(readers)
    )
    with own_domain(), ExitStack() as stack:
        for topics in announced:
            stack.enter_context(RecorderPresence(topics))
        await_recorders(network, publisher)
    assert network.is_satisfied == is_satisfied
