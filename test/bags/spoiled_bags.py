"""Bags, sound and spoiled, for check-bag and what else reads them."""

import io
import struct
import tempfile
import zlib
from functools import cache
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from damaged_bytes import damaged
from made_bags import synthetic
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

Rng = np.random.Generator


@cache
def _sound_bag(ticks: int = 15) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        bag = synthetic(Path(folder) / "bag", [True] * ticks, runs=1)
        return (bag / "bag_0.mcap").read_bytes()


def write_bag(rng: Rng, folder: Path, ticks: int = 15) -> Path:
    file = folder / "bag" / "spoiled_0.mcap"
    file.parent.mkdir()
    body = _sound_bag(ticks)
    if rng.random() < 0.3:  # of a recorder that was killed
        body = body[: -int(rng.integers(1, len(body)))]
    file.write_bytes(body)
    return file


def bag_odd(rng: Rng, file: Path) -> None:
    """Write chunks that are sound by their heading and their CRC, and not by what is in them."""
    stream = io.BytesIO(_sound_bag(210))
    ((packed,),) = [
        (record.data,)
        for record in StreamReader(stream, emit_chunks=True).records
        if isinstance(record, Chunk)
    ]
    inner = zstandard.decompress(packed)
    match int(rng.integers(9)):
        case 0:
            inner = damaged(rng, inner)
        case 1:
            inner = bytes(int(10 ** rng.uniform(1, 8)))
        case 2:  # a bomb
            _write_chunks(file, [_packed_zeros("zstd")] * 50)
            return
        case 3:
            _write_chunks(file, [(*_packed_zeros("lz4")[:2], *_heading(bytes(100)))])
            return
        case 4:
            compression = str(rng.choice(["lz4", "bz2", "", "zstd"]))
            _write_chunks(file, [(compression, packed, *_heading(inner))])
            return
        case 5:
            size = int(rng.choice(np.array([0, 1, 2**31, 2**40, 2**63, 2**64 - 1], dtype=object)))
            inner += struct.pack("<BQ", int(rng.integers(256)), size)
        case 6:  # messages of another content
            at = inner.find(b"joint") % len(inner)
            inner = inner[:at] + damaged(rng, inner[at:])
        case 7:  # records of all kinds, without a chunk
            body = io.BytesIO()
            for _ in range(int(rng.integers(1, 100))):
                content = rng.bytes(int(rng.integers(100)))
                body.write(struct.pack("<BQ", int(rng.integers(1, 16)), len(content)) + content)
            file.write_bytes(MCAP0_MAGIC + body.getvalue() + MCAP0_MAGIC)
            return
        case _:
            many = int(10 ** rng.uniform(1, 7))
            text = str(rng.choice(["[", "{a: ", "- &a [*a]\n", "x", "&", "- depth: 1e99\n"])) * many
            writer = Writer(str(file), compression=CompressionType.NONE)
            writer.start("ros2")
            schema = writer.register_schema("std_msgs/msg/String", "ros2msg", text.encode())
            qos = {"offered_qos_profiles": text[: 1 << 16]}
            writer.add_message(writer.register_channel("/a", "cdr", schema, qos), 1, b"", 1)
            writer.finish()
            return
    _write_chunks(file, [("zstd", zstandard.compress(inner), *_heading(inner))])


def _heading(inner: bytes) -> tuple[int, int]:
    """CRC and size that a chunk states of what is in it."""
    return zlib.crc32(inner), len(inner)


@cache
def _packed_zeros(compression: str) -> tuple[str, bytes, int, int]:
    zeros = bytes(1 << 28)
    pack = zstandard.compress if compression == "zstd" else lz4.frame.compress
    return compression, pack(zeros), *_heading(zeros)


def _write_chunks(file: Path, chunks: list[tuple[str, bytes, int, int]]) -> None:
    """Write chunks: compression, packed bytes, CRC, size."""
    with file.open("wb") as stream:
        stream.write(MCAP0_MAGIC)
        for compression, packed, crc, size in chunks:
            builder = RecordBuilder()
            Chunk(compression, packed, 1, 0, crc, size).write(builder)
            stream.write(builder.end())
