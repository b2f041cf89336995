"""Records of an MCAP file from any writer, one by one, in bounded time and memory.

A file may end anywhere, since its writer may have been killed; the records before the end are
sound, and `recover_mcap` makes a whole file of them. Any other deviation is damage.
Format: https://mcap.dev/spec
"""

import contextlib
import errno
import struct
import zlib
from collections.abc import Iterator
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import IO, Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from arm_emulator.base.io.atomic_write import flush_to_disk, write_all
from arm_emulator.base.io.text_file import open_file
from arm_emulator.base.refusal import Refusal

MAX_RECORD = 1 << 28  # bytes of a record, and of an unpacked chunk
MAX_UNPACKED = 1 << 26  # bytes that a file unpacks to at most, or by its own size:
MAX_RATIO = 50  # a bomb unpacks to thousands of times, messages of machines to a few
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; the data follow
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.METADATA: Metadata, Opcode.CHUNK: Chunk,
}  # fmt: skip
_IN_CHUNKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)


class CutOff(Exception):
    """The file ends before its end: its writer was killed, or the disk was full."""


class DamagedRecords(Exception):
    """The file differs from what a writer has written; the text gives the difference."""


def is_complete(stream: IO[bytes]) -> bool:
    """Return whether the signature of a whole file stands at its end."""
    size = stream.seek(0, SEEK_END)
    stream.seek(max(0, size - len(MCAP0_MAGIC)))
    return size >= 2 * len(MCAP0_MAGIC) and stream.read() == MCAP0_MAGIC


def read_records(stream: IO[bytes]) -> Iterator[tuple[McapRecord | None, int]]:
    """Yield the content of a file, and where its record ends.

    Schemas, channels, messages and metadata are yielded, whether they are in chunks or not; None
    stands for any other record.

    Raises:
        CutOff: the file ends before its end.
        DamagedRecords: see above.
    """
    complete, size = is_complete(stream), stream.seek(0, SEEK_END)
    left = MAX_UNPACKED + MAX_RATIO * size  # bytes that may still be unpacked
    stream.seek(0)
    if not MCAP0_MAGIC.startswith(stream.read(len(MCAP0_MAGIC))):
        raise DamagedRecords("it does not begin like one")
    try:
        for opcode, content, end in _split_records(stream, size):
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                if complete:
                    return
                break
            record = _parse_records(opcode, content)
            if not isinstance(record, Chunk):
                yield record, end
                continue
            left -= record.uncompressed_size
            if record.uncompressed_size > MAX_RECORD or left < 0:
                raise DamagedRecords("chunks that unpack to more than a bag may")
            at, data = 0, BytesIO(_unpack_chunk(record))
            with contextlib.suppress(EOFError):
                for inner, text, ends in _split_records(data, record.uncompressed_size):
                    if inner not in _IN_CHUNKS:
                        raise DamagedRecords(f"a record of kind {inner} in a chunk")
                    at = ends
                    yield _parse_records(inner, text), end
            if at != record.uncompressed_size:
                raise DamagedRecords("a chunk ends within a record")
            yield None, end
    except EOFError:
        if complete:
            raise DamagedRecords("a record beyond its end") from None
    raise CutOff


def recover_mcap(file: Path) -> bool:
    """Complete an MCAP file that was cut off anywhere; return False if it is complete already.

    All whole records are kept unchanged, what follows them is removed, and an end without an index
    is written: readers scan such a file. If the disk has no room for that end, the last records are
    removed to make room.

    Raises:
        Refusal: it is not an MCAP file, or damaged before its end.
        OSError: it cannot be written.
    """
    ends = [0]
    with open_file(file) as stream:
        if is_complete(stream):
            return False
        try:
            with contextlib.suppress(CutOff):
                ends += (end for _, end in read_records(stream))
        except DamagedRecords as error:
            raise Refusal(str(file), "the bag", "be undamaged MCAP", error) from None
    while True:
        try:
            _write_end(file, ends[-1])
            return True
        except OSError as error:
            # Removing data helps only against a full disk.
            if error.errno not in NO_ROOM or len(ends) == 1:
                raise
            ends = ends[: ends.index(ends[-1])]


def _write_end(file: Path, at: int) -> None:
    builder = RecordBuilder()
    if at == 0:  # cut off within the header
        builder.write(MCAP0_MAGIC)
        Header("ros2", "arm_emulator").write(builder)
    DataEnd(0).write(builder)
    Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
    builder.write(MCAP0_MAGIC)
    with file.open("r+b", buffering=0) as stream:  # a buffer would keep what it could not write
        stream.truncate(at)
        stream.seek(at)
        write_all(stream, builder.end())
        flush_to_disk(stream.fileno())


def _split_records(stream: IO[bytes], size: int) -> Iterator[tuple[int, bytes, int]]:
    """Yield opcode, content and end of each record of a file or chunk; the content only if used.

    Raises:
        EOFError: no whole record follows.
        DamagedRecords: a record is too large.
    """
    while True:
        head = stream.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
        end = stream.tell() + length
        # A computer that lost its power leaves zeros at the end.
        if opcode == 0 or end > size:
            raise EOFError
        content = b""
        if opcode == Opcode.MESSAGE or opcode in _KINDS:
            if length > MAX_RECORD:
                raise DamagedRecords(f"a record of {length} bytes, {MAX_RECORD} are the most")
            content = stream.read(length)
        yield opcode, content, end
        stream.seek(end)


def _parse_records(opcode: int, content: bytes) -> McapRecord | None:
    try:
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
            return Message(channel, log_time, content[_MESSAGE.size :], publish_time, sequence)
        kind = _KINDS.get(opcode)
        return None if kind is None else kind.read(ReadDataStream(BytesIO(content)))
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise DamagedRecords(
            f"a record of kind {opcode}: {error or type(error).__name__}"
        ) from None


def _unpack_chunk(chunk: Chunk) -> bytes:
    """Return the records in a chunk; at most a byte more than it promises is unpacked."""
    packed, size = chunk.data, chunk.uncompressed_size
    try:
        match chunk.compression:
            case "":
                data = packed
            case "zstd":
                with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
                    data = bytes(reader.read(size + 1))
            case "lz4":
                data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, size + 1))
            case other:
                raise DamagedRecords(f"a chunk that is packed as {other[:20]!r}")
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError) as error:
        raise DamagedRecords(f"a chunk: {error}") from None
    crc = chunk.uncompressed_crc
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise DamagedRecords("a chunk of other bytes than were packed")
    return data
