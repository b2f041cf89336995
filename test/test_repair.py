"""Bags that were cut off anywhere, or met a full disk: every whole chunk is there afterwards."""

from __future__ import annotations

import errno
import os
import random
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml
from draws import FULL
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

import ros_shell.bag
from arm_emulator.__main__ import main
from ros_shell.bag import Bag, BagWriter, Topic, repair
from ros_shell.message_types import definition_of
from words.refusal import Refusal

CUTS = 60 if FULL else 20


def talk(folder: Path, words: int, seed: int = 0) -> None:
    """Write a bag of two topics, one of them taken up late, in chunks of random lengths."""
    draw = random.Random(seed)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    numbers = []
    with BagWriter(folder) as writer:
        for k in range(words):
            if k in (0, words // 3):
                kind = "std_msgs/msg/String"
                topic = Topic(f"/talk{len(numbers)}", kind, definition_of(kind), (latched,))
                numbers.append(writer.add_topic(topic))
            word = "".join(draw.choices("abcdefgh", k=draw.randrange(300)))
            data = serialize_message(String(data=f"{k} {word}"))
            writer.write(draw.choice(numbers), 10**18 + k, 10**18 + k, data)
            if draw.random() < 0.05:
                writer.flush()


def words_of(bag: Path) -> list[str]:
    return [deserialize_message(m.data, String).data for m in Bag(bag).messages()]


def whole_chunks(file: Path) -> list[tuple[int, int]]:
    """Return where each chunk of a whole file ends, and how many messages it has."""
    found = []
    with file.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                messages = [one for one in breakup_chunk(record) if isinstance(one, Message)]
                found.append((stream.tell(), len(messages)))
    return found


def assert_whole(bag: Path, words: list[str]) -> None:
    """Ask independent readers: rosbags by its metadata, mcap by the index at the end."""
    file = bag / f"{bag.name}_0.mcap"
    told = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert told["message_count"] == len(words), "messages in the metadata"
    assert told["files"][0]["message_count"] == len(words), "messages in the metadata of the file"
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None, "the file has no index"
        assert summary.statistics.message_count == len(words), "messages in the file's statistics"
        indexed = [m.data for _, _, m in reader.iter_messages(log_time_order=True)]
        # By the index of each chunk, as `ros2 bag play` does.
        per_topic = [
            sum(1 for _ in reader.iter_messages(topics=[channel.topic]))
            for channel in summary.channels.values()
        ]
    assert [deserialize_message(data, String).data for data in indexed] == words, "what is indexed"
    assert sum(per_topic) == len(words), "messages by topic"
    with Reader(bag) as other:
        assert other.message_count == len(words), "messages that rosbags counts"
        assert [m for _, _, m in other.messages()] == indexed, "what rosbags reads"
    assert Bag(bag).complete, "our own reader finds it cut off"
    assert sorted(one.name for one in bag.iterdir()) == [file.name, "metadata.yaml"]


def test_every_whole_chunk_of_a_bag_that_was_cut_anywhere_is_kept(tmp_path: Path) -> None:
    talk(tmp_path / "whole", 500)
    file = tmp_path / "whole" / "whole_0.mcap"
    words, data, chunks = words_of(tmp_path / "whole"), file.read_bytes(), whole_chunks(file)
    assert len(chunks) > 20, "the test is of many chunks"
    draw = random.Random(1)
    ends = [end for end, _ in chunks]
    lengths = [
        *range(12),  # in the magic, in the header
        *(draw.choice(ends) + draw.randrange(-12, 12) for _ in range(CUTS // 4)),
        *(draw.randrange(len(data)) for _ in range(CUTS)),
        len(data) - 1,
    ]
    bag = tmp_path / "cut"
    for length in lengths:
        shutil.rmtree(bag, ignore_errors=True)
        bag.mkdir()
        (bag / "cut_0.mcap").write_bytes(data[:length])
        (bag / "metadata.yaml.tmp").write_bytes(bytes(100))
        kept = sum(messages for end, messages in chunks if end <= length)
        assert repair(bag), f"cut at {length}: taken for whole"
        assert words_of(bag) == words[:kept], f"cut at {length} of {len(data)}"
        assert_whole(bag, words[:kept])
        assert not repair(bag), f"cut at {length}: mended, and not whole"


def test_zeros_that_a_lost_power_leaves_are_cut_off(tmp_path: Path) -> None:
    talk(tmp_path / "bag", 100)
    file = tmp_path / "bag" / "bag_0.mcap"
    chunks, words = whole_chunks(file), words_of(tmp_path / "bag")
    end, _ = chunks[-2]
    os.truncate(file, end)
    os.truncate(file, end + 5000)
    assert repair(tmp_path / "bag")
    assert_whole(tmp_path / "bag", words[: sum(messages for _, messages in chunks[:-1])])


def test_repair_says_what_it_did(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    talk(tmp_path / "bag", 50)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    for expected in ("50 messages, mended", "50 messages, was whole already"):
        monkeypatch.setattr("sys.argv", ["arm_emulator", "repair", str(tmp_path / "bag")])
        with pytest.raises(SystemExit) as code:
            main()
        assert code.value.code == 0
        assert capsys.readouterr().out == f"{tmp_path / 'bag'}: {expected}\n"


def test_what_is_no_bag_is_not_touched(tmp_path: Path) -> None:
    talk(tmp_path / "bag", 200)
    file = tmp_path / "bag" / "bag_0.mcap"
    (end, _), *_ = whole_chunks(file)
    damaged = bytearray(file.read_bytes()[:-30])
    damaged[end - 20] ^= 1
    for data in (b"this is not a bag\n", bytes(damaged)):
        file.write_bytes(data)
        with pytest.raises(Refusal, match="be undamaged MCAP"):
            repair(tmp_path / "bag")
        assert file.read_bytes() == data, "a file that is refused was changed"


def test_a_full_disk_leaves_a_whole_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes no more at a random length: the end has to find its room, too."""
    draw = random.Random(2)
    talk(tmp_path / "whole", 300)
    size = (tmp_path / "whole" / "whole_0.mcap").stat().st_size
    words = words_of(tmp_path / "whole")
    real_open = Path.open

    class Full:
        """A file on a disk with room for so many bytes."""

        def __init__(self, stream: Any, room: int) -> None:
            self.stream, self.room = stream, room

        def __getattr__(self, name: str) -> Any:
            return getattr(self.stream, name)

        def __enter__(self) -> Any:
            return self

        def __exit__(self, *_: object) -> None:
            self.stream.close()

        def write(self, data: Any) -> int:
            at = self.stream.tell()
            written = self.stream.write(data[: max(0, self.room - at)])
            if written < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return int(written)

    lost = 0
    for case in range(20):
        room = draw.randrange(2000, size - 1)

        def open_full(
            path: Path, mode: str = "r", *rest: Any, room: int = room, **more: Any
        ) -> Any:
            stream = real_open(path, mode, *rest, **more)
            return Full(stream, room) if path.suffix == ".mcap" and mode != "rb" else stream

        bag = tmp_path / f"full{case}"
        with monkeypatch.context() as patch:
            patch.setattr(ros_shell.bag.Path, "open", open_full)
            with pytest.raises(OSError, match="No space left"):
                talk(bag, 300)
        kept = words_of(bag)
        assert kept == words[: len(kept)], f"with room for {room} bytes"
        assert_whole(bag, kept)
        lost += len(words) - len(kept)
    assert lost > 0, "the disk was never full"
