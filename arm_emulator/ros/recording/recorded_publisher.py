"""A publisher that soon leaves again: what it publishes is to be in the bags of the run."""

from rcl_interfaces.srv import GetParameters
from rclpy.publisher import Publisher

from arm_emulator.ros.node.network_client import NetworkClient
from arm_emulator.ros.recording.recorder_presence import NAME, STATES, list_recorders

REPORTS = "emulator/recorders"  # every recorder publishes there
PATIENCE = 1.0  # s, wall: recorders look for new topics every 0.1 s


def await_recorders(node: NetworkClient, publisher: Publisher) -> None:
    """Wait until recorders, and an emulator with its own record, take messages of a publisher.

    Those that act on a topic may be found before those that record it. Recorders on this computer
    announce their topics; others, and an emulator that is not ours, cost `PATIENCE`.
    """
    states = node.resolve_topic_name(STATES)
    is_own = _has_own_record(node)

    def is_recorded() -> bool:
        reports = node.get_publishers_info_by_topic(node.resolve_topic_name(REPORTS))
        names = {NAME, *(endpoint.node_name for endpoint in reports)}
        readers = [
            endpoint.node_name
            for endpoint in node.get_subscriptions_info_by_topic(publisher.topic_name)
        ]
        recorders = sum(name in names for name in readers)
        elsewhere = max(0, len(reports) - len(list_recorders(states)))
        return (
            recorders >= len(list_recorders(publisher.topic_name)) + elsewhere
            and (not is_own or "emulator" in readers)
            and publisher.get_subscription_count() >= len(readers)
        )

    node.spin_until(is_recorded, PATIENCE)


def _has_own_record(node: NetworkClient) -> bool:
    """Return whether the emulator writes a record."""
    if not node.spin_until(lambda: node.count_publishers("emulator/status") > 0, PATIENCE):
        return False
    client = node.create_client(GetParameters, "emulator/get_parameters")
    answer = node.call_service(client, GetParameters.Request(names=["record"]), PATIENCE)
    node.destroy_client(client)
    return answer is not None and any(value.string_value for value in answer.values)
