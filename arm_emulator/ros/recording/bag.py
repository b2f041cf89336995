"""A rosbag2 bag with MCAP storage, read whole or cut off.

The files are those of rosbag2 in Jazzy (metadata version 9, MCAP profile `ros2`), so `ros2 bag`
reads them, and bags of `ros2 bag record` are read here.
"""

import contextlib
import heapq
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO, NamedTuple

from arm_emulator.base.io.text_file import open_file
from arm_emulator.base.io.yaml_file import parse_yaml, read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.recording.bag_metadata import ABOUT, Span, Topic, read_qos

try:
    from mcap.records import Channel, Message, Metadata, Schema

    from arm_emulator.base.io.mcap_records import CutOff, DamagedRecords, read_records
except ImportError as error:  # a stock ROS 2 machine has none
    raise Refusal(
        "bags", "Python package mcap", "be installed", error, "pip install mcap"
    ) from None


SQLITE = ".db3"  # suffix of rosbag2's other storage, the default before Iron
WINDOW = 10_000  # messages: largest difference of the orders of reception and publication


class BagMessage(NamedTuple):
    """A message as it was sent."""

    topic: str
    received: int  # wall time [ns]
    published: int  # wall time [ns]
    data: bytes


class Bag:
    """A bag to read. It is scanned once, so that later reading cannot fail.

    Attributes:
        topics: by name.
        complete: False for a bag whose recorder was killed; it contains the flushed messages.
        spans: of its files.

    Args:
        path: a bag's folder, or one MCAP file.

    Raises:
        Refusal: not a bag, one of other messages, or a damaged one.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, Topic] = {}
        self.complete = True
        self._facts: dict[str, str] = {}  # as the files have them, from their begin on
        self._files = list_bag_files(path)
        self.spans = [self._scan_file(file) for file in self._files]

    @property
    def about(self) -> dict[str, str]:
        """Further facts that its writer has put into its metadata, or into its file at first."""
        facts = None
        with contextlib.suppress(Refusal):  # no metadata, or damaged ones
            body = read_yaml(self.path / "metadata.yaml").get("rosbag2_bagfile_information")
            facts = body.get("custom_data") if isinstance(body, dict) else None
        stated = {str(k): str(v) for k, v in facts.items()} if isinstance(facts, dict) else {}
        return self._facts | stated

    def _scan_file(self, file: Path) -> Span:
        begin, end, count = 2**63 - 1, 0, 0
        for message in self.read_messages(files=[file]):
            self.topics[message.topic].count += 1
            begin, end = min(begin, message.received), max(end, message.received)
            count += 1
        return Span(file.name, begin, end, count)

    def read_messages(
        self, topics: Collection[str] | None = None, files: Collection[Path] | None = None
    ) -> Iterator[BagMessage]:
        """Yield the messages of some topics, or of all, in the order of reception."""
        for file in self._files if files is None else files:
            try:
                with open_file(file) as stream:
                    yield from self._read_file(stream, topics)
            except CutOff:
                self.complete = False
            except DamagedRecords as error:
                raise Refusal(str(file), "the bag", "be undamaged MCAP", error) from None
            except OSError as error:
                raise Refusal(str(file), "the bag", "be readable", error.strerror) from None

    def read_as_published(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield messages in the order of publication: an answer after its question.

        Args:
            topics: their names.
        """
        heap: list[tuple[int, int, BagMessage]] = []
        for number, message in enumerate(self.read_messages(topics)):
            heapq.heappush(heap, (message.published or message.received, number, message))
            if len(heap) > WINDOW:
                yield heapq.heappop(heap)[2]
        while heap:
            yield heapq.heappop(heap)[2]

    def _read_file(self, stream: IO[bytes], topics: Collection[str] | None) -> Iterator[BagMessage]:
        schemas: dict[int, Schema] = {}
        names: dict[int, str] = {}
        for record, _ in read_records(stream):
            if isinstance(record, Message):
                name = names.get(record.channel_id)
                if name is None:
                    raise DamagedRecords(
                        f"a message of channel {record.channel_id}, which does not exist"
                    )
                if topics is None or name in topics:
                    yield BagMessage(name, record.log_time, record.publish_time, record.data)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Metadata):
                self._facts |= record.metadata if record.name == ABOUT else {}
            elif isinstance(record, Channel):
                names[record.id] = record.topic
                if record.message_encoding != "cdr":
                    raise Refusal(
                        str(self.path),
                        "the bag",
                        "have ROS 2 messages (encoding cdr)",
                        f"{record.message_encoding or 'no encoding'} in channel {record.topic}",
                        "bags of `up --record`, `run --bag`, `record` and `ros2 bag record`; "
                        "a file of `run --record` is a table of the run, not a bag",
                    )
                if record.topic not in self.topics:
                    self.topics[record.topic] = _read_topic(record, schemas.get(record.schema_id))


def _read_topic(channel: Channel, schema: Schema | None) -> Topic:
    if schema is None:
        raise DamagedRecords(f"topic {channel.topic}: it has no schema")
    try:
        text = channel.metadata.get("offered_qos_profiles", "")
        profiles = parse_yaml(text, "offered_qos_profiles") or []
        offered = tuple(read_qos(profile) for profile in profiles)
        definition = schema.data.decode() if schema.encoding == "ros2msg" else ""
    except Exception as error:  # arbitrary input, parsed by rclpy
        raise DamagedRecords(f"topic {channel.topic}: QoS or definition: {error!r}") from None
    type_hash = channel.metadata.get("topic_type_hash", "")
    return Topic(channel.topic, schema.name, definition, offered, type_hash)


def list_bag_files(path: Path) -> list[Path]:
    """Return the files of a bag, in their order.

    Raises:
        Refusal: it has none.
    """
    if not path.exists():
        raise Refusal(str(path), "the bag", "exist", "no such file or folder")
    if path.suffix == SQLITE or (path.is_dir() and any(path.glob(f"*{SQLITE}"))):
        valid = "`ros2 bag convert` with storage_id: mcap, or `ros2 bag record --storage mcap`"
        raise Refusal(str(path), "the bag's storage", "be mcap", f"sqlite3 (*{SQLITE})", valid)
    files = sorted(path.glob("*.mcap"), key=_sort_key) if path.is_dir() else [path]
    if not files:
        raise Refusal(str(path), "the bag", "hold *.mcap files", "none", "storage mcap")
    return files


def _sort_key(file: Path) -> tuple[int, str]:
    """Return where a file of a split bag stands: bag_10.mcap comes after bag_9.mcap."""
    number = re.search(r"_(\d+)$", file.stem)
    return (int(number[1]) if number else 0, file.name)
