"""An end for an MCAP file that has none: its writer was killed, or the disk was full.

All whole chunks stay as and where they are. What was cut off behind them goes, and the index that
readers look for at the end of a file is written in its place. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from words.refusal import Refusal

_RECORD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct(
    "<HIQ"
)  # channel, sequence, log time; the publish time and the data follow


@dataclass
class _Chunk:
    start: int  # where its record begins in the file
    index: ChunkIndex
    messages: dict[int, MessageIndex]  # by channel


@dataclass
class _Whole:
    """What a file without an end holds, up to where it was cut off."""

    chunks: list[_Chunk] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    loose: Counter[int] = field(default_factory=Counter)  # messages in no chunk, by channel
    end: int = 0  # of the last whole record
    followed: bool = False  # the last chunk, by more than its index


def give_end(file: Path) -> bool:
    """Make a whole MCAP file of one that was cut off anywhere; False if it is whole already.

    When the disk has no room for the index, the last chunks make room for it.

    Raises:
        Refusal: it is no MCAP file, or damaged before its end.
        OSError: it cannot be written.
    """
    with file.open("rb") as stream:
        if _has_end(stream):
            return False
        try:
            whole = _read(stream)
        except (McapError, ZstdError, struct.error, ValueError, RuntimeError) as error:
            what = error or type(error).__name__
            raise Refusal(str(file), "the bag", "be undamaged MCAP", what) from None
    while True:
        try:
            _write_end(file, whole)
            return True
        except OSError:
            if not whole.chunks:
                raise
            whole.end, whole.followed = whole.chunks.pop().start, False


def _has_end(stream: IO[bytes]) -> bool:
    size, length = stream.seek(0, 2), len(MCAP0_MAGIC)
    if size < 2 * length:
        return False
    stream.seek(size - length)
    return stream.read(length) == MCAP0_MAGIC


def _read(stream: IO[bytes]) -> _Whole:
    size = stream.seek(0, 2)
    stream.seek(0)
    magic = stream.read(len(MCAP0_MAGIC))
    if not MCAP0_MAGIC.startswith(magic):
        raise McapError("it does not begin like one")
    whole = _Whole()
    while True:
        start = stream.tell()
        head = stream.read(_RECORD.size)
        if len(head) < _RECORD.size:
            return whole
        opcode, length = _RECORD.unpack(head)
        end = stream.tell() + length
        # Zeros at the end are what a computer leaves that lost its power.
        if end > size or opcode in (0, Opcode.DATA_END, Opcode.FOOTER):
            return whole
        if opcode == Opcode.CHUNK:
            _take_chunk(stream, whole, start, end)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(stream))
            whole.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(stream))
            whole.channels[channel.id] = channel
        elif opcode == Opcode.MESSAGE:
            whole.loose[struct.unpack("<H", stream.read(2))[0]] += 1
        whole.followed = opcode not in (Opcode.CHUNK, Opcode.MESSAGE_INDEX)
        if opcode == Opcode.MESSAGE_INDEX and whole.chunks:
            (channel_id,) = struct.unpack("<H", stream.read(2))
            index = whole.chunks[-1].index
            index.message_index_offsets[channel_id] = start
            index.message_index_length += end - start
        whole.end = end
        stream.seek(end)


def _take_chunk(stream: IO[bytes], whole: _Whole, start: int, end: int) -> None:
    chunk = Chunk.read(ReadDataStream(stream))
    index = ChunkIndex(
        chunk_length=end - start,
        chunk_start_offset=start,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
    one = _Chunk(start, index, {})
    data, size = get_chunk_data_stream(chunk, validate_crc=True)
    for offset, opcode, content in _records(data.read(size)):
        inner = ReadDataStream(content)
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(inner)
            whole.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(inner)
            whole.channels[channel.id] = channel
        elif opcode == Opcode.MESSAGE:
            channel_id, _, log_time = _MESSAGE.unpack(content.read(_MESSAGE.size))
            messages = one.messages.setdefault(channel_id, MessageIndex(channel_id, []))
            messages.records.append((log_time, offset))
    whole.chunks.append(one)


def _records(data: bytes) -> Iterator[tuple[int, int, IO[bytes]]]:
    """Yield offset, opcode and content of the records in a chunk."""
    at = 0
    while at < len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        begin = at + _RECORD.size
        yield at, opcode, BytesIO(data[begin : begin + length])
        at = begin + length


def _write_end(file: Path, whole: _Whole) -> None:
    builder = RecordBuilder()
    if whole.end == 0:  # cut off within the header
        builder.write(MCAP0_MAGIC)
        Header("ros2", "arm_emulator").write(builder)
    elif whole.chunks and not whole.followed:  # its index may be cut off
        last = whole.chunks[-1]
        whole.end = last.start + last.index.chunk_length
        last.index.message_index_offsets = {}
        for channel_id, messages in last.messages.items():
            last.index.message_index_offsets[channel_id] = whole.end + builder.count
            messages.write(builder)
        last.index.message_index_length = builder.count
    DataEnd(0).write(builder)
    summary_start = whole.end + builder.count
    groups = (
        (Opcode.SCHEMA, list(whole.schemas.values())),
        (Opcode.CHANNEL, list(whole.channels.values())),
        (Opcode.STATISTICS, [_statistics(whole)]),
        (Opcode.CHUNK_INDEX, [one.index for one in whole.chunks]),
    )
    summary, offsets = RecordBuilder(), []
    for opcode, records in groups:
        begin = summary.count
        for record in records:
            record.write(summary)
        length = summary.count - begin
        offsets.append(
            SummaryOffset(
                group_opcode=opcode, group_start=summary_start + begin, group_length=length
            )
        )
    summary_offset_start = summary_start + summary.count
    for offset in offsets:
        offset.write(summary)
    text = summary.end()
    places = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, summary_start, summary_offset_start)
    builder.write(text)
    Footer(
        summary_start=summary_start,
        summary_offset_start=summary_offset_start,
        summary_crc=zlib.crc32(places, zlib.crc32(text)),
    ).write(builder)
    builder.write(MCAP0_MAGIC)
    end = builder.end()
    with file.open("r+b", buffering=0) as stream:  # what a buffer could not write, it would keep
        stream.truncate(whole.end)
        stream.seek(whole.end)
        if stream.write(end) != len(end):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _statistics(whole: _Whole) -> Statistics:
    counts = Counter(whole.loose)
    for one in whole.chunks:
        for channel_id, messages in one.messages.items():
            counts[channel_id] += len(messages.records)
    filled = [one.index for one in whole.chunks if one.messages]
    return Statistics(
        attachment_count=0,
        channel_count=len(whole.channels),
        channel_message_counts=dict(counts),
        chunk_count=len(whole.chunks),
        message_count=counts.total(),
        message_end_time=max((one.message_end_time for one in filled), default=0),
        message_start_time=min((one.message_start_time for one in filled), default=0),
        metadata_count=0,
        schema_count=len(whole.schemas),
    )
