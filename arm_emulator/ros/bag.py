"""A rosbag2 bag with MCAP storage: written so that a crash loses little, read whole or cut off.

The files are those of rosbag2 in Jazzy (metadata version 9, MCAP profile `ros2`), so `ros2 bag`
reads them, and bags of `ros2 bag record` are read here.
"""

from __future__ import annotations

import contextlib
import heapq
import os
import re
import shutil
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
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

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.text_file import open_file
from arm_emulator.base.yaml_file import parse_yaml, read_yaml

try:
    from mcap.opcode import Opcode
    from mcap.records import Channel, Schema
    from mcap.writer import CompressionType, Writer

    from arm_emulator.base.mcap_end import NO_ROOM, flush_to_disk, give_end, write_all
    from arm_emulator.base.mcap_records import MESSAGE, CutOff, Damaged, McapFile, Record
    from arm_emulator.base.unbuffered_file import UnbufferedFile
except ImportError as error:  # a stock ROS 2 machine has none
    raise Refusal(
        "bags", "Python package mcap", "be installed", error, "pip install mcap"
    ) from None

METADATA = "metadata.yaml"
UNFINISHED = "metadata.yaml.tmp"
METADATA_VERSION = 9  # of rosbag2 in Jazzy
CHUNK_SIZE = 2**18  # bytes: messages not yet in a chunk are lost in a crash
METADATA_ROOM = 2**16  # bytes: reserved for metadata.yaml, in case the disk becomes full
SHORT_METADATA = 2**12  # bytes: of a bag without messages
NANOSECONDS = 1_000_000_000

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


class BagMessage(NamedTuple):
    """A message as it went over the network."""

    topic: str
    received: int  # wall time [ns]
    published: int  # wall time [ns]
    data: bytes


class BagWriter:
    """Writes a new bag; use it in a `with` block.

    Attributes:
        whole: whether it has been closed as a whole bag, mended or not.

    Args:
        folder: the bag, which must not exist.

    Raises:
        Refusal: it exists, or cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.whole = False
        self._file = folder / f"{folder.resolve().name}_0.mcap"
        self._topics: dict[int, Topic] = {}
        self._schemas: dict[str, int] = {}
        self._begin, self._end = 2**63 - 1, 0
        self._failure: Exception | None = None
        self._room = METADATA_ROOM
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            raise Refusal("record", f"folder {folder}", "be new", "one that exists") from None
        except OSError as error:
            raise Refusal("record", f"folder {folder}", "be writable", error.strerror) from None
        try:
            (folder / UNFINISHED).write_bytes(bytes(self._room))
            self._stream = UnbufferedFile(self._file)
            self._mcap = Writer(self._stream, CHUNK_SIZE, CompressionType.ZSTD)  # type: ignore[arg-type]
            self._mcap.start("ros2", "arm_emulator")
            self.flush()
        except OSError as error:
            shutil.rmtree(folder, ignore_errors=True)  # which is ours, and empty
            raise Refusal("record", f"folder {folder}", "be writable", error.strerror) from None

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
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
        """Register a topic and return its number in this bag.

        Raises:
            OSError: see `write`.
        """
        with self._noting_failure():
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
                    "offered_qos_profiles": yaml.safe_dump(
                        [_qos_to_yaml(q) for q in topic.offered]
                    ),
                    "topic_type_hash": topic.type_hash,
                },
            )
            self._topics[number] = topic
            self._keep_room()
        return number

    def write(self, number: int, received: int, published: int, data: bytes) -> None:
        """Write a message of the topic with this number.

        Raises:
            OSError: the disk is full or has failed. After a failure nothing more is written: a file
                never has a gap.
        """
        topic = self._topics[number]
        with self._noting_failure():
            self._mcap.add_message(number, received, data, published, topic.count)
        topic.count += 1
        self._begin, self._end = min(self._begin, received), max(self._end, received)

    def flush(self) -> None:
        """Hand all written data to the system: a crash of this process loses none of it.

        Raises:
            OSError: see `write`.
        """
        with self._noting_failure():
            self._mcap.flush()

    def close(self) -> None:
        """Write indices and metadata; without them only readers that scan can read the bag.

        Raises:
            OSError: not all was written, now or before. The bag is mended then, and the counts of
                its topics are those of the messages in it; `whole` is False if even that found no
                room.
        """
        if self._stream.closed:
            return
        try:
            with self._noting_failure():
                metadata = self._reported()
                self._mcap.flush()
                text = yaml.safe_dump(metadata)
                self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})
                self._mcap.finish()
                flush_to_disk(self._stream.fileno())
                self._stream.close()
                _write_metadata(self.folder, metadata)
            self.whole = True
        except (OSError, MemoryError):
            with contextlib.suppress(OSError):  # closed anyway
                self._stream.close()
            self._mend()
            raise

    @contextlib.contextmanager
    def _noting_failure(self) -> Iterator[None]:
        """Keep the first failure: the data of that write are not in the file."""
        if self._failure is not None:
            raise self._failure
        try:
            yield
        except (OSError, MemoryError) as error:
            self._failure = error
            raise

    def _reported(self) -> dict[str, Any]:
        count = sum(topic.count for topic in self.topics)
        span = Span(self._file.name, self._begin, self._end, count)
        return _metadata(self.topics, [span])

    def _keep_room(self) -> None:
        """Reserve room for metadata, in case the disk becomes full."""
        needed = len(_text_of(self._reported())) + 64 * (len(self._topics) + 4)  # as counts grow
        if needed > self._room:
            self._room = needed + METADATA_ROOM
            with (self.folder / UNFINISHED).open("r+b") as stream:
                stream.write(bytes(self._room))

    def _mend(self) -> None:
        with contextlib.suppress(OSError, Refusal, MemoryError):
            try:
                repair(self.folder)
            except OSError as error:
                if error.errno not in NO_ROOM:
                    raise
                # The reserve of the metadata, which are short by now.
                os.truncate(self.folder / UNFINISHED, SHORT_METADATA)
                repair(self.folder)
            self.whole = True
        kept: dict[str, Topic] = {}
        with contextlib.suppress(OSError, Refusal, MemoryError):
            bag = Bag(self.folder)
            kept = bag.topics
            self._begin, self._end = bag.spans[0].begin, bag.spans[0].end
        for topic in self.topics:
            topic.count = kept[topic.name].count if topic.name in kept else 0


class Span(NamedTuple):
    """Content of one file of a bag."""

    file: str
    begin: int  # wall time [ns] of the first message
    end: int  # and of the last
    messages: int


def repair(path: Path) -> bool:
    """Make a whole bag of one whose recorder was killed; return False if it is whole already.

    Raises:
        Refusal: not a bag, or a damaged one.
        OSError: it cannot be written.
    """
    given = [give_end(file) for file in _files(path)]
    if not path.is_dir():
        return any(given)
    bag = Bag(path)
    metadata = _metadata(list(bag.topics.values()), bag.spans)
    if any(given) or _count_in(path / METADATA) != metadata["message_count"]:
        _write_metadata(path, metadata)
        return True
    return False


def _count_in(metadata: Path) -> object:
    """Return the number of messages in metadata, None if they have none."""
    try:
        body = read_yaml(metadata).get("rosbag2_bagfile_information")
    except Refusal:
        return None
    return body.get("message_count") if isinstance(body, dict) else None


def _files(path: Path) -> list[Path]:
    """Return the files of a bag, in their order."""
    if not path.exists():
        raise Refusal(str(path), "the bag", "exist", "no such file or folder")
    files = sorted(path.glob("*.mcap"), key=_place) if path.is_dir() else [path]
    if not files:
        raise Refusal(str(path), "the bag", "hold *.mcap files", "none", "storage mcap")
    return files


def _text_of(metadata: dict[str, Any]) -> bytes:
    return yaml.safe_dump({"rosbag2_bagfile_information": metadata}, sort_keys=False).encode()


def _write_metadata(folder: Path, metadata: dict[str, Any]) -> None:
    unfinished = folder / UNFINISHED
    # Written in place: on a full disk there is no other room.
    mode = "r+b" if unfinished.exists() else "xb"
    with unfinished.open(mode, buffering=0) as stream:
        text = _text_of(metadata)
        write_all(stream, text)
        stream.truncate(len(text))
        flush_to_disk(stream.fileno())
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
        complete: False for a bag whose recorder was killed; it contains the flushed messages.
        spans: of its files.

    Args:
        path: a bag's folder, or one MCAP file.

    Raises:
        Refusal: not a bag, or a damaged one.
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
        """Yield the messages of some topics, or of all, in the order of reception."""
        for file in self._files if files is None else files:
            try:
                with open_file(file) as stream:
                    yield from self._read(McapFile(stream), topics)
            except CutOff:
                self.complete = False
            except Damaged as error:
                raise Refusal(str(file), "the bag", "be undamaged MCAP", error) from None
            except OSError as error:
                raise Refusal(str(file), "the bag", "be readable", error.strerror) from None

    def as_published(self, topics: Collection[str], window: int = 10_000) -> Iterator[BagMessage]:
        """Yield messages in the order of publication: an answer after its question.

        Args:
            topics: their names.
            window: largest difference from the order of reception [messages].
        """
        heap: list[tuple[int, int, BagMessage]] = []
        for number, message in enumerate(self.messages(topics)):
            heapq.heappush(heap, (message.published or message.received, number, message))
            if len(heap) > window:
                yield heapq.heappop(heap)[2]
        while heap:
            yield heapq.heappop(heap)[2]

    def _read(self, mcap: McapFile, topics: Collection[str] | None) -> Iterator[BagMessage]:
        schemas: dict[int, Schema] = {}
        names: dict[int, str] = {}
        for record in _contents(mcap):
            if record.opcode == Opcode.MESSAGE:
                channel_id, _, log_time, publish_time = record.message
                name = names.get(channel_id)
                if name is None:
                    raise Damaged(f"a message of channel {channel_id}, which does not exist")
                if topics is None or name in topics:
                    data = record.content[MESSAGE.size :]
                    yield BagMessage(name, log_time, publish_time, data)
            elif record.opcode == Opcode.SCHEMA:
                schema = record.schema
                schemas[schema.id] = schema
            else:
                channel = record.channel
                names[channel.id] = channel.topic
                if channel.topic not in self.topics:
                    self.topics[channel.topic] = _topic(channel, schemas.get(channel.schema_id))


def _contents(mcap: McapFile) -> Iterator[Record]:
    """Yield schemas, channels and messages, in chunks or not."""
    kinds = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
    for record in mcap.records():
        if record.opcode == Opcode.CHUNK:
            yield from mcap.chunk(record).records()
        elif record.opcode in kinds:
            yield record


def _place(file: Path) -> tuple[int, str]:
    """Return where a file of a split bag stands: bag_10.mcap comes after bag_9.mcap."""
    number = re.search(r"_(\d+)$", file.stem)
    return (int(number[1]) if number else 0, file.name)


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    if schema is None or channel.message_encoding != "cdr":
        raise Damaged(f"topic {channel.topic}: not a serialized ROS 2 message")
    try:
        text = channel.metadata.get("offered_qos_profiles", "")
        profiles = parse_yaml(text, "offered_qos_profiles") or []
        offered = tuple(_qos_from_yaml(profile) for profile in profiles)
        definition = schema.data.decode() if schema.encoding == "ros2msg" else ""
    except Exception as error:  # arbitrary input, parsed by rclpy
        raise Damaged(f"topic {channel.topic}: QoS or definition: {error!r}") from None
    type_hash = channel.metadata.get("topic_type_hash", "")
    return Topic(channel.topic, schema.name, definition, offered, type_hash)


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
