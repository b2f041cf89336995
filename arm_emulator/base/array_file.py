"""Arrays from outside: a NumPy archive (``.npz``) with arrays of real numbers.

An archive may unpack to far more than its size, and an array's header may state any size: both are
checked before memory is allocated. Nothing in the file is executed: pickled objects are refused.
"""

from __future__ import annotations

import io
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

from arm_emulator.base.given import FloatArray
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.text_file import open_file

MOST_BYTES = 2**29  # of the file, and of all that is unpacked from it
MOST_ENTRIES = 1000
_END = struct.Struct("<4sHHHHIIH")  # of an archive: entries are the fifth number
_END_SIGNATURE, _ZIP64_SIGNATURE = b"PK\x05\x06", b"PK\x06\x07"
_ZIP64_SIZE, _LONGEST_COMMENT = 20, 2**16
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # the memory of the others is unbounded
_NUMBERS = "fiub"  # kinds of NumPy's types that are real numbers


def read_arrays(file: Path, names: Collection[str]) -> dict[str, FloatArray]:
    """Return those of the named arrays that an archive holds, as doubles.

    Raises:
        Refusal: the file is missing, not an archive, damaged or too large, or an array does not
            hold real numbers.
    """
    where = file.name
    with open_file(file) as stream:
        try:
            _check_entries(stream, where)
            with zipfile.ZipFile(stream) as archive:
                return _arrays(archive, names, where)
        except Refusal:
            raise
        except Exception as error:  # zipfile, zlib and NumPy raise various ones
            reason = f"{type(error).__name__} {error}"
            raise Refusal(where, "file", "be an archive of NumPy arrays", reason) from None


def _check_entries(stream: IO[bytes], where: str) -> None:
    """Refuse an archive whose table of contents is large, before the archive is read."""
    size = stream.seek(0, io.SEEK_END)
    if size > MOST_BYTES:
        raise Refusal(where, "file", f"have at most {MOST_BYTES // 2**20} MiB", "more")
    start = max(0, size - _END.size - _LONGEST_COMMENT - _ZIP64_SIZE)
    stream.seek(start)
    tail = stream.read()
    at = len(tail) - _END.size  # as zipfile: without a comment, else the last one
    if tail[max(0, at) :][:4] != _END_SIGNATURE:
        at = tail.rfind(_END_SIGNATURE)
    if not 0 <= at <= len(tail) - _END.size:
        raise Refusal(where, "file", "be an archive of NumPy arrays", "no end of an archive")
    _, _, _, _, entries, table, *_ = _END.unpack_from(tail, at)
    large = tail[max(0, at - _ZIP64_SIZE) :][:4] == _ZIP64_SIGNATURE
    if large or entries > MOST_ENTRIES or table > MOST_ENTRIES * 1000:
        rule = f"hold at most {MOST_ENTRIES} arrays"
        raise Refusal(where, "archive", rule, "more" if large else entries)


def _arrays(archive: zipfile.ZipFile, names: Collection[str], where: str) -> dict[str, FloatArray]:
    arrays: dict[str, FloatArray] = {}
    left = MOST_BYTES
    for entry in archive.infolist():
        name = entry.filename.removesuffix(".npy")
        if name not in names:
            continue
        if name in arrays:
            raise Refusal(where, "archive", "hold each array once", f"{name} again")
        if entry.flag_bits & 1 or entry.compress_type not in _METHODS:
            raise Refusal(
                where, name, "be stored or deflated, without encryption", "another method"
            )
        if entry.file_size > left:
            rule = f"unpack to at most {MOST_BYTES // 2**20} MiB"
            raise Refusal(where, "archive", rule, f"{entry.file_size} bytes of {name}")
        with archive.open(entry) as packed:
            arrays[name] = _array(packed, entry.file_size, name, where)
        left -= max(entry.file_size, arrays[name].nbytes)
    return arrays


def _array(packed: IO[bytes], size: int, name: str, where: str) -> FloatArray:
    head, shape, fortran, kind = _heading(packed)
    if kind.kind not in _NUMBERS or kind.hasobject:
        raise Refusal(where, name, "be real numbers", f"type {kind}")
    count = math.prod(shape)
    if min(shape, default=1) < 0 or count * kind.itemsize != size - head:
        rule = f"have the {size - head} bytes that its heading promises"
        raise Refusal(where, name, rule, f"shape {shape} of {kind}")
    if count * 8 > MOST_BYTES:
        raise Refusal(where, name, f"have at most {MOST_BYTES // 8} numbers", count)
    body = packed.read(size - head + 1)
    flat = np.frombuffer(body, dtype=kind, count=count)
    with np.errstate(over="ignore", invalid="ignore"):  # of more than 64 bits
        return flat.reshape(shape, order="F" if fortran else "C").astype(np.float64)


def _heading(packed: IO[bytes]) -> tuple[int, tuple[int, ...], bool, np.dtype[np.generic]]:
    """Return size, shape, order and type from the header of an array."""
    counted = _Counted(packed)
    version = npy.read_magic(counted)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    with warnings.catch_warnings(action="ignore"):  # of archives by Python 2
        shape, fortran, kind = read(counted)
    return counted.size, shape, fortran, kind


class _Counted:
    """Counts the bytes read of a header, and refuses a long one."""

    LONGEST = 2**14

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.size = 0

    def read(self, size: int = -1, /) -> bytes:
        if not 0 <= size <= self.LONGEST:
            raise zlib.error("a long heading")
        piece = self._stream.read(size)
        self.size += len(piece)
        return piece
