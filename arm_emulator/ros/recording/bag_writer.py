"""Writes a rosbag2 bag so that a crash loses little, and mends one whose recorder was killed."""

import contextlib
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

import yaml

from arm_emulator.ros.recording.bag import (  # first: refuses where mcap is missing
    Bag,
    list_bag_files,
)

# isort: split
from mcap.writer import CompressionType, Writer

from arm_emulator.base.io.atomic_write import UnbufferedFile, flush_to_disk, write_all
from arm_emulator.base.io.mcap_records import NO_ROOM, recover_mcap
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.recording.bag_metadata import (
    ABOUT,
    ARITHMETIC_OF,
    NANOSECONDS,
    Span,
    Topic,
    build_metadata,
    dump_metadata,
    write_qos,
)
from arm_emulator.toolchain.flags import ARITHMETIC

METADATA = "metadata.yaml"
UNFINISHED = "metadata.yaml.tmp"
CHUNK_SIZE = 2**18  # bytes: messages not yet in a chunk are lost in a crash
METADATA_ROOM = 2**16  # bytes: reserved for metadata.yaml, in case the disk becomes full
SHORT_METADATA = 2**12  # bytes: of a bag without messages


class BagWriter:
    """Writes a new bag; use it in a `with` block.

    Attributes:
        is_complete: whether it has been closed as a whole bag, mended or not.

    Args:
        folder: the bag, which must not exist.
        about: further facts for its metadata.

    Raises:
        Refusal: it exists, or cannot be made.
    """

    def __init__(self, folder: Path, about: Mapping[str, str] | None = None) -> None:
        self.folder = folder
        self._about = {ARITHMETIC_OF: ARITHMETIC, **(about or {})}
        self.is_complete = False
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
            # A killed writer leaves no other place for them.
            self._mcap.add_metadata(ABOUT, self._about)
            self.flush()
        except OSError as error:
            shutil.rmtree(folder, ignore_errors=True)  # which is ours, and empty
            raise Refusal("record", f"folder {folder}", "be writable", error.strerror) from None

    def __enter__(self) -> Self:
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
            OSError: see `write_message`.
        """
        with self._record_failure():
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
                    "offered_qos_profiles": yaml.safe_dump([write_qos(q) for q in topic.offered]),
                    "topic_type_hash": topic.type_hash,
                },
            )
            self._topics[number] = topic
            self._keep_room()
        return number

    def write_message(self, number: int, received: int, published: int, data: bytes) -> None:
        """Write a message of the topic with this number.

        Raises:
            OSError: the disk is full or has failed. After a failure nothing more is written: a file
                never has a gap.
        """
        topic = self._topics[number]
        with self._record_failure():
            self._mcap.add_message(number, received, data, published, topic.count)
        topic.count += 1
        self._begin, self._end = min(self._begin, received), max(self._end, received)

    def flush(self) -> None:
        """Hand all written data to the system: a crash of this process loses none of it.

        Raises:
            OSError: see `write_message`.
        """
        with self._record_failure():
            self._mcap.flush()

    def close(self) -> None:
        """Write indices and metadata; without them only readers that scan can read the bag.

        Raises:
            OSError: not all was written, now or before. The bag is mended then, and the counts of
                its topics are those of the messages in it; `is_complete` is False if even that
                found no room.
        """
        if self._stream.closed:
            return
        try:
            with self._record_failure():
                metadata = self._build_metadata()
                self._mcap.flush()
                text = yaml.safe_dump(metadata)
                self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})
                self._mcap.finish()
                flush_to_disk(self._stream.fileno())
                self._stream.close()
                _write_metadata(self.folder, metadata)
            self.is_complete = True
        except (OSError, MemoryError):
            with contextlib.suppress(OSError):  # closed anyway
                self._stream.close()
            self._repair_file()
            raise

    @contextlib.contextmanager
    def _record_failure(self) -> Iterator[None]:
        """Keep the first failure: the data of that write are not in the file."""
        if self._failure is not None:
            raise self._failure
        try:
            yield
        except (OSError, MemoryError) as error:
            self._failure = error
            raise

    def _build_metadata(self) -> dict[str, Any]:
        count = sum(topic.count for topic in self.topics)
        span = Span(self._file.name, self._begin, self._end, count)
        return build_metadata(self.topics, [span], self._about)

    def _keep_room(self) -> None:
        """Reserve room for metadata, in case the disk becomes full."""
        needed = len(dump_metadata(self._build_metadata())) + 64 * (
            len(self._topics) + 4
        )  # as counts grow
        if needed > self._room:
            self._room = needed + METADATA_ROOM
            with (self.folder / UNFINISHED).open("r+b") as stream:
                stream.write(bytes(self._room))

    def _repair_file(self) -> None:
        with contextlib.suppress(OSError, Refusal, MemoryError):
            try:
                repair_bag(self.folder)
            except OSError as error:
                if error.errno not in NO_ROOM:
                    raise
                # The reserve of the metadata, which are short by now.
                os.truncate(self.folder / UNFINISHED, SHORT_METADATA)
                repair_bag(self.folder)
            self.is_complete = True
        repaired: dict[str, Topic] = {}
        with contextlib.suppress(OSError, Refusal, MemoryError):
            bag = Bag(self.folder)
            repaired = bag.topics
            self._begin, self._end = bag.spans[0].begin, bag.spans[0].end
        for topic in self.topics:
            topic.count = repaired[topic.name].count if topic.name in repaired else 0


def repair_bag(path: Path) -> bool:
    """Make a whole bag of one whose recorder was killed; return False if it is whole already.

    Raises:
        Refusal: not a bag, or a damaged one.
        OSError: it cannot be written.
    """
    recovered = [recover_mcap(file) for file in list_bag_files(path)]
    if not path.is_dir():
        return any(recovered)
    bag = Bag(path)
    metadata = build_metadata(list(bag.topics.values()), bag.spans, bag.about)
    if any(recovered) or _count_in(path / METADATA) != metadata["message_count"]:
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


def _write_metadata(folder: Path, metadata: dict[str, Any]) -> None:
    unfinished = folder / UNFINISHED
    # Written in place: on a full disk there is no other room.
    mode = "r+b" if unfinished.exists() else "xb"
    with unfinished.open(mode, buffering=0) as stream:
        text = dump_metadata(metadata)
        write_all(stream, text)
        stream.truncate(len(text))
        flush_to_disk(stream.fileno())
    unfinished.replace(folder / METADATA)
