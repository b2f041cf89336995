"""Completion of an MCAP file without an end: its writer was killed, or the disk was full.

All whole chunks are kept unchanged. The incomplete rest after them is removed, and the index that
readers expect at the end of a file is written. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import contextlib
import errno
import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from arm_emulator.base.mcap_records import CutOff, Damaged, McapFile, Record
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.text_file import open_file
from arm_emulator.base.whole_file import flush_to_disk, write_all

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass
class _Chunk:
    start: int  # where its record begins in the file
    index: ChunkIndex
    counts: Counter[int] = field(default_factory=Counter)  # of messages, by channel
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)


@dataclass
class _Whole:
    """Contents of a truncated file, up to the cut."""

    chunks: list[_Chunk] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)  # in no chunk
    channels: dict[int, Channel] = field(default_factory=dict)
    loose: Counter[int] = field(default_factory=Counter)  # messages in no chunk, by channel
    end: int = 0  # of the last whole record
    messages: dict[int, MessageIndex] = field(default_factory=dict)  # of the last chunk, by channel
    metadata: int = 0  # records
    followed: bool = False  # the last chunk, by more than its index

    @property
    def all_schemas(self) -> dict[int, Schema]:
        return self.schemas | {k: v for one in self.chunks for k, v in one.schemas.items()}

    @property
    def all_channels(self) -> dict[int, Channel]:
        return self.channels | {k: v for one in self.chunks for k, v in one.channels.items()}


def give_end(file: Path) -> bool:
    """Complete an MCAP file that was cut off anywhere; return False if it is complete already.

    If the disk has no room for the index, the last chunks are removed to make room.

    Raises:
        Refusal: it is not an MCAP file, or damaged before its end.
        OSError: it cannot be written.
    """
    with open_file(file) as stream:
        mcap = McapFile(stream)
        if mcap.ended:
            return False
        try:
            whole = _read(mcap)
        except Damaged as error:
            raise Refusal(str(file), "the bag", "be undamaged MCAP", error) from None
    while True:
        try:
            _write_end(file, whole)
            return True
        except OSError as error:
            # Removing data helps only against a full disk.
            if error.errno not in NO_ROOM or not whole.chunks:
                raise
            # The index of the previous chunk is whole, since another chunk follows it.
            whole.end, whole.followed = whole.chunks.pop().start, True


def _read(mcap: McapFile) -> _Whole:
    whole = _Whole()
    with contextlib.suppress(CutOff):
        for record in mcap.records():
            if record.opcode == Opcode.DATA_END:
                break
            if record.opcode == Opcode.CHUNK:
                _take_chunk(mcap, record, whole)
            elif record.opcode == Opcode.SCHEMA:
                schema = record.schema
                whole.schemas[schema.id] = schema
            elif record.opcode == Opcode.CHANNEL:
                channel = record.channel
                whole.channels[channel.id] = channel
            elif record.opcode == Opcode.METADATA:
                whole.metadata += 1
            elif record.opcode == Opcode.MESSAGE:
                whole.loose[record.message[0]] += 1
            elif record.opcode == Opcode.MESSAGE_INDEX and whole.chunks:
                index = whole.chunks[-1].index
                index.message_index_offsets[record.indexed_channel] = record.start
                index.message_index_length += record.end - record.start
            whole.followed = record.opcode not in (Opcode.CHUNK, Opcode.MESSAGE_INDEX)
            whole.end = record.end
    return whole


def _take_chunk(mcap: McapFile, record: Record, whole: _Whole) -> None:
    chunk = mcap.chunk(record)
    index = ChunkIndex(
        chunk_length=record.end - record.start,
        chunk_start_offset=record.start,
        compression=chunk.compression,
        compressed_size=chunk.packed,
        message_end_time=chunk.last,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=chunk.first,
        uncompressed_size=len(chunk.data),
    )
    one = _Chunk(record.start, index)
    whole.messages = {}
    for inner in chunk.records():
        if inner.opcode == Opcode.SCHEMA:
            schema = inner.schema
            one.schemas[schema.id] = schema
        elif inner.opcode == Opcode.CHANNEL:
            channel = inner.channel
            one.channels[channel.id] = channel
        else:
            channel_id, _, log_time, _ = inner.message
            one.counts[channel_id] += 1
            messages = whole.messages.setdefault(channel_id, MessageIndex(channel_id, []))
            messages.records.append((log_time, inner.start))
    whole.chunks.append(one)


def _write_end(file: Path, whole: _Whole) -> None:
    builder = RecordBuilder()
    if whole.end == 0:  # cut off within the header
        builder.write(MCAP0_MAGIC)
        Header("ros2", "arm_emulator").write(builder)
    elif whole.chunks and not whole.followed:  # its index may be cut off
        last = whole.chunks[-1]
        whole.end = last.start + last.index.chunk_length
        last.index.message_index_offsets = {}
        for channel_id, messages in whole.messages.items():
            last.index.message_index_offsets[channel_id] = whole.end + builder.count
            messages.write(builder)
        last.index.message_index_length = builder.count
    DataEnd(0).write(builder)
    summary_start = whole.end + builder.count
    groups = (
        (Opcode.SCHEMA, list(whole.all_schemas.values())),
        (Opcode.CHANNEL, list(whole.all_channels.values())),
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
    with file.open("r+b", buffering=0) as stream:  # a buffer would keep what it could not write
        stream.truncate(whole.end)
        stream.seek(whole.end)
        write_all(stream, end)
        flush_to_disk(stream.fileno())


def _statistics(whole: _Whole) -> Statistics:
    counts = Counter(whole.loose)
    for one in whole.chunks:
        counts.update(one.counts)
    filled = [one.index for one in whole.chunks if one.counts]
    return Statistics(
        attachment_count=0,
        channel_count=len(whole.all_channels),
        channel_message_counts=dict(counts),
        chunk_count=len(whole.chunks),
        message_count=counts.total(),
        message_end_time=max((one.message_end_time for one in filled), default=0),
        message_start_time=min((one.message_start_time for one in filled), default=0),
        metadata_count=whole.metadata,
        schema_count=len(whole.all_schemas),
    )
