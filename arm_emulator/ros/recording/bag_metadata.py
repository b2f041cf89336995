"""Metadata of a rosbag2 bag: topics, their quality of service, counts and times."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import yaml
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

METADATA_VERSION = 9  # of rosbag2 in Jazzy
NANOSECONDS = 1_000_000_000
PARENT, FORKED_AT = "parent", "forked at tick"  # further facts of a bag
ARITHMETIC_OF = "arithmetic"  # likewise: in which its machine was computed
ABOUT = "arm_emulator"  # metadata record of an MCAP file with them
SCENE = "scene.yaml"  # in a bag's folder, if its machine is that of no other file
_POLICIES: dict[str, type[IntEnum]] = {
    "history": HistoryPolicy,
    "reliability": ReliabilityPolicy,
    "durability": DurabilityPolicy,
    "liveliness": LivelinessPolicy,
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")


@dataclass
class Topic:
    """A topic in a bag.

    Attributes:
        name: with its namespace, such as ``/motor_states``.
        type: such as ``arm_emulator_msgs/msg/MotorState``.
        definition: text of the message's definition and, after lines of ``=``, of all types it
            contains; empty if unknown.
        offered: QoS of each publisher.
        type_hash: RIHS01 hash of the type, empty if not known.
        count: messages.
    """

    name: str
    type: str
    definition: str = ""
    offered: tuple[QoSProfile, ...] = ()
    type_hash: str = ""
    count: int = 0


class Span(NamedTuple):
    """Content of one file of a bag."""

    file: str
    begin: int  # wall time [ns] of the first message
    end: int  # and of the last
    messages: int


def dump_metadata(metadata: dict[str, Any]) -> bytes:
    """Return metadata as the text of their file."""
    information = {"rosbag2_bagfile_information": metadata}
    return yaml.dump(information, Dumper=yaml.CSafeDumper, sort_keys=False).encode()


def build_metadata(
    topics: Collection[Topic], spans: Collection[Span], about: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return the metadata of a bag; `about` has further facts."""
    filled = [span for span in spans if span.messages]
    begin = min((span.begin for span in filled), default=0)
    end = max((span.end for span in filled), default=0)

    def summarise_files(begin: int, end: int, count: int) -> dict[str, Any]:
        return {
            "duration": {"nanoseconds": end - begin if count else 0},
            "starting_time": {"nanoseconds_since_epoch": begin if count else 0},
            "message_count": count,
        }

    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        **summarise_files(begin, end, sum(span.messages for span in spans)),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [write_qos(q) for q in topic.offered],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [span.file for span in spans],
        "files": [{"path": s.file, **summarise_files(s.begin, s.end, s.messages)} for s in spans],
        "custom_data": dict(about) if about else None,
        "ros_distro": "jazzy",
    }


def write_qos(profile: QoSProfile) -> dict[str, Any]:
    """Return a profile as version 9 writes it."""

    def split_seconds(duration: Duration) -> dict[str, int]:
        sec, nsec = divmod(duration.nanoseconds, NANOSECONDS)
        return {"sec": sec, "nsec": nsec}

    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": split_seconds(profile.deadline),
        "lifespan": split_seconds(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": split_seconds(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def read_qos(data: dict[str, Any]) -> QoSProfile:
    """Read names, as version 9 has them, or numbers, as before."""
    values: dict[str, Any] = {"depth": int(data["depth"])}
    for key, policy in _POLICIES.items():
        value = data[key]
        values[key] = policy(value) if isinstance(value, int) else policy[value.upper()]
    for key in _DURATIONS:
        sec, nsec = int(data[key]["sec"]), int(data[key]["nsec"])
        # Fast DDS before Humble wrote another infinity.
        values[key] = Duration(nanoseconds=min(sec * NANOSECONDS + nsec, 2**63 - 1))
    values["avoid_ros_namespace_conventions"] = bool(data["avoid_ros_namespace_conventions"])
    return QoSProfile(**values)
