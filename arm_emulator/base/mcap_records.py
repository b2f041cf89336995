"""Records of an MCAP file from any writer, one by one, in bounded time and memory.

A file may end anywhere, since its writer may have been killed; the records before the end are
sound. Any other deviation is damage. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import SEEK_END, BytesIO
from typing import IO

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

MOST_RECORD = 1 << 28  # bytes of a record, and of an unpacked chunk
MOST_UNPACKED = 1 << 26  # bytes that a file unpacks to at most, or by its own size:
MOST_RATIO = 50  # a bomb unpacks to thousands of times, messages of machines to a few
HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; the data follow
_CHUNK = struct.Struct("<QQQII")  # first and last log time, size, CRC, length of a name
# Kinds of records whose content is looked at; what others hold is passed over.
_LOOKED_AT = (
    Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX,
    Opcode.METADATA,
)  # fmt: skip


class CutOff(Exception):
    """The file ends before its end: its writer was killed, or the disk was full."""


class Damaged(Exception):
    """The file differs from what a writer has written; the text gives the difference."""


@contextlib.contextmanager
def _sound(what: str) -> Iterator[None]:
    try:
        yield
    except (McapError, struct.error, ValueError) as error:
        raise Damaged(f"{what}: {error or type(error).__name__}") from None


@dataclass(frozen=True)
class Record:
    """A record, in a file or in an unpacked chunk.

    Attributes:
        opcode: its kind.
        start: its first byte, heading included.
        end: first byte of the next one.
        content: without its heading; empty if it is not read.
    """

    opcode: int
    start: int
    end: int
    content: bytes

    @property
    def schema(self) -> Schema:
        """Content of a schema record."""
        with _sound("a schema"):
            schema: Schema = Schema.read(ReadDataStream(BytesIO(self.content)))
        return schema

    @property
    def channel(self) -> Channel:
        """Content of a channel record."""
        with _sound("a channel"):
            channel: Channel = Channel.read(ReadDataStream(BytesIO(self.content)))
        return channel

    @property
    def metadata(self) -> tuple[str, dict[str, str]]:
        """Name and entries of a metadata record."""
        with _sound("metadata"):
            one = Metadata.read(ReadDataStream(BytesIO(self.content)))
        return one.name, one.metadata

    @property
    def message(self) -> tuple[int, int, int, int]:
        """Channel, sequence, log time and publish time [ns] of a message; its data follow."""
        with _sound("a message"):
            channel, sequence, log_time, publish_time = MESSAGE.unpack_from(self.content)
            return channel, sequence, log_time, publish_time

    @property
    def indexed_channel(self) -> int:
        """The channel whose messages an index of messages lists."""
        with _sound("an index"):
            return int(struct.unpack_from("<H", self.content)[0])


@dataclass(frozen=True)
class Chunk:
    """Records that were packed together, unpacked."""

    first: int  # log time [ns]
    last: int
    compression: str
    packed: int  # bytes
    data: bytes

    def records(self) -> Iterator[Record]:
        """Yield the records in it.

        Raises:
            Damaged: they do not fill it, or are of a kind not permitted in chunks.
        """
        at, data, size = 0, self.data, len(self.data)
        while at < size:
            begin = at + HEAD.size
            if begin > size:
                raise Damaged("a chunk ends within a record")
            opcode, length = HEAD.unpack_from(data, at)
            end = begin + length
            if end > size:
                raise Damaged("a chunk ends within a record")
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                raise Damaged(f"a record of kind {opcode} in a chunk")
            yield Record(opcode, at, end, data[begin:end])
            at = end


class McapFile:
    """The records of a file up to its footer.

    Args:
        stream: the file.

    Attributes:
        ended: whether the signature of a whole file stands at its end.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._size = stream.seek(0, SEEK_END)
        self._unpacked = 0
        stream.seek(max(0, self._size - len(MCAP0_MAGIC)))
        self.ended = self._size >= 2 * len(MCAP0_MAGIC) and stream.read() == MCAP0_MAGIC

    def records(self) -> Iterator[Record]:
        """Yield all records before the footer.

        Raises:
            CutOff: the file ends before its footer.
            Damaged: see above.
        """
        stream, size = self._stream, self._size
        stream.seek(0)
        magic = stream.read(len(MCAP0_MAGIC))
        if not MCAP0_MAGIC.startswith(magic):
            raise Damaged("it does not begin like one")
        at = len(magic)
        while True:
            stream.seek(at)
            head = stream.read(HEAD.size)
            opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
            end = at + HEAD.size + length
            # A computer that lost its power leaves zeros at the end.
            if opcode == 0 or end > size:
                raise Damaged("a record beyond its end") if self.ended else CutOff
            if opcode == Opcode.FOOTER:
                if not self.ended:
                    raise CutOff
                return
            content = b""
            if opcode in _LOOKED_AT:
                if length > MOST_RECORD:
                    raise Damaged(f"a record of {length} bytes, {MOST_RECORD} are the most")
                content = stream.read(length)
            yield Record(opcode, at, end, content)
            at = end

    def chunk(self, record: Record) -> Chunk:
        """Return the content of a chunk's record.

        Raises:
            Damaged: it cannot be unpacked, differs from what was packed, or is too large.
        """
        content = record.content
        try:
            first, last, size, crc, length = _CHUNK.unpack_from(content)
            at = _CHUNK.size + length
            compression = content[_CHUNK.size : at].decode("ascii")
            (packed,) = struct.unpack_from("<Q", content, at)
        except (struct.error, UnicodeDecodeError) as error:
            raise Damaged(f"a chunk's heading: {error}") from None
        body = memoryview(content)[at + 8 :]
        if len(body) != packed:
            raise Damaged(f"a chunk of {len(body)} bytes that promises {packed}")
        self._unpacked += size
        most = MOST_UNPACKED + MOST_RATIO * self._size
        if size > MOST_RECORD or self._unpacked > most:
            raise Damaged(f"chunks that unpack to more than {min(most, MOST_RECORD)} bytes")
        data = _unpacked(compression, body, size)
        if len(data) != size or (crc and zlib.crc32(data) != crc):
            raise Damaged("a chunk of other bytes than were packed")
        return Chunk(first, last, compression, packed, data)


def _unpacked(compression: str, body: memoryview, size: int) -> bytes:
    """Return at most one byte more than `size`."""
    try:
        match compression:
            case "":
                return bytes(body)
            case "zstd":
                with zstandard.ZstdDecompressor().stream_reader(body) as reader:
                    return bytes(reader.read(size + 1))
            case "lz4":
                return bytes(lz4.frame.LZ4FrameDecompressor().decompress(body, size + 1))
    except (zstandard.ZstdError, RuntimeError, ValueError, EOFError) as error:
        raise Damaged(f"a chunk: {error}") from None
    raise Damaged(f"a chunk that is packed as {compression[:20]!r}")
