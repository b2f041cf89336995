"""A rosbag2 bag with MCAP storage: written so that a crash loses little, read whole or cut off.

The files are those of rosbag2 in Jazzy (metadata version 9, MCAP profile `ros2`), so `ros2 bag`
reads them, and what `ros2 bag record` writes is read here.
"""

from __future__ import annotations

import contextlib
import heapq
import re
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import IntEnum
from os import SEEK_END
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

import yaml
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from words.refusal import Refusal
from words.yaml_file import parse_yaml

try:
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader
    from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
    from zstandard import ZstdError

    from ros_shell.mcap_end import give_end
except ImportError as error:  # a stock ROS 2 machine has none
    raise Refusal(
        "bags", "Python package mcap", "be installed", error, "pip install mcap"
    ) from None

METADATA = "metadata.yaml"
UNFINISHED = "metadata.yaml.tmp"
METADATA_VERSION = 9  # of rosbag2 in Jazzy
CHUNK_SIZE = 2**18  # bytes: what is not yet in a chunk is lost in a crash
METADATA_ROOM = 2**16  # bytes: kept free for metadata.yaml, should the disk become full
NANOSECONDS = 1_000_000_000

# How reading a damaged file fails, beside McapError.
_DAMAGE = (struct.error, UnicodeDecodeError, ValueError, MemoryError, RuntimeError, ZstdError)

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
        definition: text of the message's definition and, after lines of ``=``, of all it contains;
            empty if not known.
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


class BagMessage(NamedTuple):
    """A message as it went over the network."""

    topic: str
    received: int  # wall time [ns]
    published: int  # wall time [ns]
    data: bytes


class BagWriter:
    """Writes a new bag; use it in a `with` block.

    Args:
        folder: the bag, which must not exist.

    Raises:
        Refusal: it exists, or cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._file = folder / f"{folder.resolve().name}_0.mcap"
        self._topics: dict[int, Topic] = {}
        self._schemas: dict[str, int] = {}
        self._begin, self._end = 2**63 - 1, 0
        try:
            folder.mkdir(parents=True)
            (folder / UNFINISHED).write_bytes(bytes(METADATA_ROOM))
            self._stream = self._file.open("xb")
            self._mcap = Writer(self._stream, CHUNK_SIZE, CompressionType.ZSTD)
            self._mcap.start("ros2", "arm_emulator")
            self.flush()
        except FileExistsError:
            raise Refusal("record", f"folder {folder}", "be new", "one that exists") from None
        except OSError as error:
            raise Refusal("record", f"folder {folder}", "be writable", error.strerror) from None

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def topics(self) -> list[Topic]:
        """Topics so far, with their counts."""
        return list(self._topics.values())

    @property
    def seconds(self) -> float:
        """Wall time from the first message to the last [s]."""
        return max(0, self._end - self._begin) / NANOSECONDS

    def add_topic(self, topic: Topic) -> int:
        """Take up a topic and return its number in this bag."""
        if topic.type not in self._schemas:
            encoding = "ros2msg" if topic.definition else ""
            self._schemas[topic.type] = self._mcap.register_schema(
                topic.type, encoding, topic.definition.encode()
            )
        number = self._mcap.register_channel(
            topic.name,
            "cdr",
            self._schemas[topic.type],
            {
                "offered_qos_profiles": yaml.safe_dump([_qos_to_yaml(q) for q in topic.offered]),
                "topic_type_hash": topic.type_hash,
            },
        )
        self._topics[number] = topic
        return number

    def write(self, number: int, received: int, published: int, data: bytes) -> None:
        """Write a message of the topic with this number."""
        topic = self._topics[number]
        self._mcap.add_message(number, received, data, published, topic.count)
        topic.count += 1
        self._begin, self._end = min(self._begin, received), max(self._end, received)

    def flush(self) -> None:
        """Hand all that was written to the system: a crash of this process loses none of it."""
        self._mcap.flush()

    def close(self) -> None:
        """Write indices and metadata; without them only readers that scan can read the bag.

        Raises:
            OSError: the disk did not take all, now or before. The bag is whole all the same, with
                what it took.
        """
        if self._stream.closed:
            return
        try:
            count = sum(topic.count for topic in self.topics)
            span = Span(self._file.name, self._begin, self._end, count)
            metadata = _metadata(self.topics, [span])
            self._mcap.flush()
            self._mcap.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(metadata)})
            self._mcap.finish()
            self._stream.close()
            _write_metadata(self.folder, metadata)
        except OSError:
            with contextlib.suppress(OSError):  # what it cannot write; it is closed all the same
                self._stream.close()
            repair(self.folder)
            kept = Bag(self.folder).topics
            for topic in self.topics:
                topic.count = kept[topic.name].count if topic.name in kept else 0
            raise


class Span(NamedTuple):
    """What one file of a bag holds."""

    file: str
    begin: int  # wall time [ns] of the first message
    end: int  # and of the last
    messages: int


def repair(path: Path) -> bool:
    """Make a whole bag of one whose recorder was killed; return False if it is whole already.

    Raises:
        Refusal: no bag, or a damaged one.
        OSError: it cannot be written.
    """
    files = _files(path)
    given = [give_end(file) for file in files]
    if path.is_dir() and (any(given) or not (path / METADATA).exists()):
        bag = Bag(path)
        _write_metadata(path, _metadata(list(bag.topics.values()), bag.spans))
        return True
    return any(given)


def _files(path: Path) -> list[Path]:
    """Return the files of a bag, in their order."""
    if not path.exists():
        raise Refusal(str(path), "the bag", "exist", "no such file or folder")
    files = sorted(path.glob("*.mcap"), key=_place) if path.is_dir() else [path]
    if not files:
        raise Refusal(str(path), "the bag", "hold *.mcap files", "none", "storage mcap")
    return files


def _write_metadata(folder: Path, metadata: dict[str, Any]) -> None:
    text = yaml.safe_dump({"rosbag2_bagfile_information": metadata}, sort_keys=False)
    unfinished = folder / UNFINISHED
    # Written over what is there: its room is needed where the disk is full.
    with unfinished.open("r+b" if unfinished.exists() else "xb") as stream:
        stream.write(text.encode())
        stream.truncate()
    unfinished.replace(folder / METADATA)


def _metadata(topics: Collection[Topic], spans: Collection[Span]) -> dict[str, Any]:
    filled = [span for span in spans if span.messages]
    begin = min((span.begin for span in filled), default=0)
    end = max((span.end for span in filled), default=0)

    def summary(begin: int, end: int, count: int) -> dict[str, Any]:
        return {
            "duration": {"nanoseconds": end - begin if count else 0},
            "starting_time": {"nanoseconds_since_epoch": begin if count else 0},
            "message_count": count,
        }

    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        **summary(begin, end, sum(span.messages for span in spans)),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [_qos_to_yaml(q) for q in topic.offered],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [span.file for span in spans],
        "files": [{"path": s.file, **summary(s.begin, s.end, s.messages)} for s in spans],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


class Bag:
    """A bag to read. It is scanned once, so that later reading cannot fail.

    Attributes:
        topics: by name.
        complete: False for a bag whose recorder was killed; what it had flushed is there.
        spans: of its files.

    Args:
        path: a bag's folder, or one MCAP file.

    Raises:
        Refusal: no bag, or a damaged one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.complete = True
        self._files = _files(path)
        self.spans = [self._scan(file) for file in self._files]

    def _scan(self, file: Path) -> Span:
        begin, end, count = 2**63 - 1, 0, 0
        for message in self.messages(files=[file]):
            self.topics[message.topic].count += 1
            begin, end = min(begin, message.received), max(end, message.received)
            count += 1
        return Span(file.name, begin, end, count)

    def messages(
        self, topics: Collection[str] | None = None, files: Collection[Path] | None = None
    ) -> Iterator[BagMessage]:
        """Yield the messages of some topics, or all, in the order of the files: as received."""
        for file in self._files if files is None else files:
            try:
                with file.open("rb") as stream:
                    try:
                        yield from self._read(stream, topics)
                    except (McapError, *_DAMAGE) as error:
                        if not _cut_off(stream):
                            what = error or type(error).__name__
                            raise Refusal(str(file), "the bag", "be undamaged MCAP", what) from None
                        self.complete = False
            except OSError as error:
                raise Refusal(str(file), "the bag", "be readable", error.strerror) from None

    def as_published(self, topics: Collection[str], window: int = 10_000) -> Iterator[BagMessage]:
        """Yield messages in the order in which they were published: an answer after its question.

        Args:
            topics: their names.
            window: by how many messages the order of reception may differ at most.
        """
        heap: list[tuple[int, int, BagMessage]] = []
        for number, message in enumerate(self.messages(topics)):
            heapq.heappush(heap, (message.published or message.received, number, message))
            if len(heap) > window:
                yield heapq.heappop(heap)[2]
        while heap:
            yield heapq.heappop(heap)[2]

    def _read(self, stream: IO[bytes], topics: Collection[str] | None) -> Iterator[BagMessage]:
        schemas: dict[int, Schema] = {}
        names: dict[int, str] = {}
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Message):
                name = names.get(record.channel_id)
                if name is None:
                    raise McapError(f"a message of channel {record.channel_id}, which is not there")
                if topics is None or name in topics:
                    yield BagMessage(name, record.log_time, record.publish_time, record.data)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                names[record.id] = record.topic
                if record.topic not in self.topics:
                    self.topics[record.topic] = _topic(record, schemas.get(record.schema_id))


def _cut_off(stream: IO[bytes]) -> bool:
    """Whether reading failed because the file ends too early: its recorder was killed."""
    at_end = not stream.read(1)
    size, length = stream.seek(0, SEEK_END), len(MCAP0_MAGIC)
    stream.seek(0)
    begins = MCAP0_MAGIC.startswith(stream.read(length))
    stream.seek(max(0, size - length))
    return at_end and begins and (size <= length or stream.read() != MCAP0_MAGIC)


def _place(file: Path) -> tuple[int, str]:
    """Return where a file of a split bag stands: bag_10.mcap comes after bag_9.mcap."""
    number = re.search(r"_(\d+)$", file.stem)
    return (int(number[1]) if number else 0, file.name)


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    if schema is None or channel.message_encoding != "cdr":
        raise McapError(f"topic {channel.topic}: not a serialized ROS 2 message")
    try:
        text = channel.metadata.get("offered_qos_profiles", "")
        profiles = parse_yaml(text, "offered_qos_profiles") or []
        offered = tuple(_qos_from_yaml(profile) for profile in profiles)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise McapError(f"topic {channel.topic}: QoS profiles: {error!r}") from None
    return Topic(
        channel.topic,
        schema.name,
        schema.data.decode() if schema.encoding == "ros2msg" else "",
        offered,
        channel.metadata.get("topic_type_hash", ""),
    )


def _qos_to_yaml(profile: QoSProfile) -> dict[str, Any]:
    def seconds(duration: Duration) -> dict[str, int]:
        sec, nsec = divmod(duration.nanoseconds, NANOSECONDS)
        return {"sec": sec, "nsec": nsec}

    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": seconds(profile.deadline),
        "lifespan": seconds(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": seconds(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _qos_from_yaml(data: dict[str, Any]) -> QoSProfile:
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
