"""Bags that were cut off anywhere, or met a full disk: every whole chunk is there afterwards."""

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from draws import FULL, some, with_slow
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import String

from arm_emulator.base.io.atomic_write import write_all
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command_line import main
from arm_emulator.ros.messages.message_types import read_definition
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import FORKED_AT, PARENT, Topic
from arm_emulator.ros.recording.bag_writer import BagWriter, repair_bag

CUTS = 60 if FULL else 20
FACTS = {PARENT: "other", FORKED_AT: "7"}


def talk(folder: Path, words: int, seed: int = 0) -> None:
    """Write a bag of two topics, one of them taken up late, in chunks of random lengths."""
    draw = random.Random(seed)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    numbers = []
    with BagWriter(folder, FACTS) as writer:
        for k in range(words):
            if k in (0, words // 3):
                kind = "std_msgs/msg/String"
                topic = Topic(f"/talk{len(numbers)}", kind, read_definition(kind), (latched,))
                numbers.append(writer.add_topic(topic))
            word = "".join(draw.choices("abcdefgh", k=draw.randrange(300)))
            data = serialize_message(String(data=f"{k} {word}"))
            writer.write_message(draw.choice(numbers), 10**18 + k, 10**18 + k, data)
            if draw.random() < 0.05:
                writer.flush()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own that is soon full."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=300k", "small", str(disk)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if mounted.returncode != 0:
        pytest.skip(f"no disk can be mounted: {mounted.stderr.strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def words_of(bag: Path) -> list[str]:
    return [deserialize_message(m.data, String).data for m in Bag(bag).read_messages()]


def list_complete_chunks(file: Path) -> list[tuple[int, int]]:
    """Return where each chunk of a whole file ends, and how many messages it has."""
    ends = []
    with file.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                messages = [
                    message for message in breakup_chunk(record) if isinstance(message, Message)
                ]
                ends.append((stream.tell(), len(messages)))
    return ends


def assert_complete(bag: Path, words: list[str]) -> None:
    """Ask independent readers: rosbags by its metadata, mcap by its files alone."""
    file = bag / f"{bag.name}_0.mcap"
    reported = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert reported["message_count"] == len(words), "messages in the metadata"
    assert reported["files"][0]["message_count"] == len(words), (
        "messages in the metadata of the file"
    )
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        read = [m.data for _, _, m in reader.iter_messages(log_time_order=True)]
    assert [deserialize_message(data, String).data for data in read] == words, "what mcap reads"
    with Reader(bag) as rosbag:
        assert rosbag.message_count == len(words), "messages that rosbags counts"
        assert [m for _, _, m in rosbag.messages()] == read, "what rosbags reads"
    assert Bag(bag).complete, "our own reader finds it cut off"
    assert sorted(file.name for file in bag.iterdir()) == [file.name, "metadata.yaml"]


def test_every_complete_chunk_of_a_bag_that_was_cut_anywhere_remains(tmp_path: Path) -> None:
    talk(tmp_path / "whole", 500)
    file = tmp_path / "whole" / "whole_0.mcap"
    words, data, chunks = (
        words_of(tmp_path / "whole"),
        file.read_bytes(),
        list_complete_chunks(file),
    )
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
        count = sum(messages for end, messages in chunks if end <= length)
        assert repair_bag(bag), f"cut at {length}: taken for whole"
        assert words_of(bag) == words[:count], f"cut at {length} of {len(data)}"
        assert not count or Bag(bag).about.items() >= FACTS.items(), "facts precede all chunks"
        assert_complete(bag, words[:count])
        assert not repair_bag(bag), f"cut at {length}: mended, and not whole"


def test_zeros_that_a_lost_power_leaves_are_cut_off(tmp_path: Path) -> None:
    talk(tmp_path / "bag", 100)
    file = tmp_path / "bag" / "bag_0.mcap"
    chunks, words = list_complete_chunks(file), words_of(tmp_path / "bag")
    end, _ = chunks[-2]
    os.truncate(file, end)
    os.truncate(file, end + 5000)
    assert repair_bag(tmp_path / "bag")
    assert_complete(tmp_path / "bag", words[: sum(messages for _, messages in chunks[:-1])])


def test_repair_reports_its_changes(tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    talk(tmp_path / "bag", 50)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    for expected in ("50 messages, mended", "50 messages, was whole already"):
        monkeypatch.setattr("sys.argv", ["arm_emulator", "repair", str(tmp_path / "bag")])
        with pytest.raises(SystemExit) as code:
            main()
        assert code.value.code == 0
        assert capsys.readouterr().out == f"{tmp_path / 'bag'}: {expected}\n"


def test_a_folder_without_a_bag_stays_as_it_is(tmp_path: Path) -> None:
    talk(tmp_path / "bag", 200)
    file = tmp_path / "bag" / "bag_0.mcap"
    (end, _), *_ = list_complete_chunks(file)
    damaged = bytearray(file.read_bytes()[:-30])
    damaged[end - 20] ^= 1
    for data in (b"this is not a bag\n", bytes(damaged)):
        file.write_bytes(data)
        with pytest.raises(Refusal, match="be undamaged MCAP"):
            repair_bag(tmp_path / "bag")
        assert file.read_bytes() == data, "a file that is refused was changed"


def record_until_full(
    bag: BagWriter, seed: int, words: list[str], reported: dict[Path, object]
) -> None:
    """Record words that hardly pack, as a recorder does: what fails ends it."""
    draw = random.Random(seed)
    kind = "std_msgs/msg/String"
    try:
        with bag:
            number = bag.add_topic(Topic("/talk", kind, read_definition(kind)))
            for k in range(100_000):
                words.append(f"{k} {draw.randbytes(draw.randrange(1500)).hex()}")
                try:
                    bag.write_message(number, k, k, serialize_message(String(data=words[-1])))
                    if draw.random() < 0.1:
                        bag.flush()
                except OSError:
                    # Somebody else makes room, as a recorder that mends its bag does.
                    (bag.folder.parent / "other").unlink(missing_ok=True)
                    raise
    except OSError as error:
        reported[bag.folder] = error.errno, bag.is_complete, bag.topics[0].count


@pytest.mark.parametrize("seed", with_slow(some(range(40), 6), 2))
@pytest.mark.parametrize("recorders", [1, 2])
def test_recorders_on_a_disk_that_becomes_full_leave_complete_bags(
    recorders: int, seed: int, small_disk: Path
) -> None:
    """There is room again by then: what would be written behind a gap is not."""
    reported: dict[Path, object] = {}
    words: dict[Path, list[str]] = {}
    threads = []
    with (small_disk / "other").open("wb") as filler:
        filler.write(bytes(random.Random(seed).randrange(100_000)))
    for k in range(recorders):
        bag = small_disk / f"bag{k}"
        words[bag] = []
        arguments = BagWriter(bag), 2 * seed + k, words[bag], reported
        threads.append(threading.Thread(target=record_until_full, args=arguments))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for bag, printed in words.items():
        readable = words_of(bag)
        assert reported[bag] == (errno.ENOSPC, True, len(readable)), (
            f"{bag.name}: error, whole, count"
        )
        assert readable == printed[: len(readable)], "what is kept"
        assert_complete(bag, readable)


@pytest.mark.slow
@pytest.mark.parametrize("number", [errno.EIO, errno.EDQUOT, errno.ENOSPC, None])
@pytest.mark.parametrize("heals", with_slow([False, True], 1))
def test_no_row_is_written_after_the_first_failure(
    number: int | None, heals: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Writes that fail once, or for good, take a part first; None: they only take parts."""
    draw = random.Random(f"{number} {heals}")
    for case in range(6):
        talk(tmp_path / f"whole{case}", 100, case)
        printed = words_of(tmp_path / f"whole{case}")
        size = (tmp_path / f"whole{case}" / f"whole{case}_0.mcap").stat().st_size
        writes = _Writes(draw, number, draw.randrange(200, size), heals)
        bag = tmp_path / f"{case}"
        with monkeypatch.context() as patch:
            patch.setattr("arm_emulator.ros.recording.bag_writer.write_all", writes)
            patch.setattr("arm_emulator.base.io.atomic_write.write_all", writes)
            if number is None:
                talk(bag, 100, case)
            else:
                with pytest.raises(OSError, match=os.strerror(number)):
                    talk(bag, 100, case)
        if not (bag / "metadata.yaml").exists():
            assert not heals and number is not None, "the disk takes metadata again"
            assert repair_bag(bag), "a bag without metadata"
        readable = words_of(bag)
        assert readable == printed[: len(readable)], "what is kept"
        assert len(readable) == 100 or number is not None, "what is lost"
        assert_complete(bag, readable)


class _Writes:
    """Takes what a bag writes in parts, and fails with an error from some byte on."""

    def __init__(self, draw: random.Random, error: int | None, at: int, heals: bool) -> None:
        self._draw, self._error, self._at, self._heals = draw, error, at, heals
        self._written = 0

    def __call__(self, stream: Any, data: bytes) -> None:
        self._written += len(data)
        if self._error is not None and self._written > self._at:
            stream.write(data[: len(data) // 2])
            error = self._error
            self._error = None if self._heals else error
            raise OSError(error, os.strerror(error))
        write_all(_Parts(stream, self._draw), data)


class _Parts:
    """A file that takes a part of what it is given."""

    def __init__(self, stream: Any, draw: random.Random) -> None:
        self._stream, self._draw = stream, draw

    def write(self, data: Any) -> int:
        return int(self._stream.write(data[: self._draw.randint(1, len(data))]))


KILLED = """
import os, random, signal, sys, threading, time
from pathlib import Path
sys.path[:0] = {folders!r}
from test_repair import talk
draw = random.Random(int(sys.argv[2]))
threading.Timer(draw.uniform(0.0, 0.25), lambda: os.kill(os.getpid(), signal.SIGKILL)).start()
for turn in range(10_000):
    talk(Path(sys.argv[1]) / f"bag{{turn}}", 300, turn)
"""


@pytest.mark.parametrize("seed", with_slow(some(range(60), 4), 1))
def test_a_recorder_killed_at_any_moment_leaves_a_bag_that_repair_completes(
    seed: int, tmp_path: Path
) -> None:
    code = KILLED.format(folders=[str(folder) for folder in Path(__file__).parents[:2]])
    command = [sys.executable, "-c", code, str(tmp_path / "bags"), str(seed)]
    (tmp_path / "bags").mkdir()
    done = subprocess.run(command, capture_output=True, timeout=60.0, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()
    bags = sorted((tmp_path / "bags").iterdir(), key=lambda bag: int(bag.name[3:]))
    for bag in bags:
        turn = int(bag.name[3:])
        if turn < len(bags) - 1:
            assert not repair_bag(bag), "one that was closed is whole"
            continue
        if not any(bag.glob("*.mcap")):
            continue  # killed before it was made
        repair_bag(bag)
        talk(tmp_path / "whole", 300, turn)
        readable, all_words = words_of(bag), words_of(tmp_path / "whole")
        assert readable == all_words[: len(readable)], "what is kept"
        assert_complete(bag, readable)


def test_metadata_that_count_wrongly_are_written_again(tmp_path: Path) -> None:
    talk(tmp_path / "bag", 50)
    file = tmp_path / "bag" / "metadata.yaml"
    words, sound = words_of(tmp_path / "bag"), file.read_text()
    for text in (sound.replace("message_count: 50", "message_count: 51"), "", "[", sound[:200]):
        file.write_text(text)
        assert repair_bag(tmp_path / "bag"), f"taken for whole: {text[:80]!r}"
        assert_complete(tmp_path / "bag", words)
