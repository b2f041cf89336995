"""Detection of shared libraries in ELF without loading them."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from functools import cache

# System V ABI, chapters 4 and 5, for 64 bits: the header after its 16 bytes of identification, a
# program header, a section header, a symbol.
HEADER = struct.Struct("<HHIQQQIHHHHHH")
PROGRAM = struct.Struct("<IIQQQQQQ")
SECTION = struct.Struct("<IIQQQQIIQQ")
SYMBOL = struct.Struct("<IBBHQQ")
IDENTIFICATION = b"\x7fELF\x02\x01\x01"  # 64 bits, little end first, version 1
IDENTIFICATION_SIZE = 16
SHARED_OBJECT = 3
DYNAMIC_SYMBOLS = 11
UNDEFINED = 0
LONGEST = 200  # bytes of a name that we may ask for


def why_no_library(content: bytes, functions: Iterable[str]) -> str:
    """Return why bytes are not a shared library for this machine with these functions, or "".

    A truncated file is detected, since the table of sections is at its end. The time is bounded by
    the number of bytes, for any content.
    """
    if not content:
        return "it is empty"
    if not content.startswith(IDENTIFICATION):
        return "it is not a 64-bit ELF file"
    try:
        kind, machine, _, _, programs_at, sections_at, *_, programs, _, sections, _ = (
            HEADER.unpack_from(content, IDENTIFICATION_SIZE)
        )
        if kind != SHARED_OBJECT:
            return "it is not a shared library"
        if machine != _this_machine():
            return f"it is for another machine (ELF number {machine})"
        for index in range(programs):
            _, _, at, _, _, size, *_ = PROGRAM.unpack_from(
                content, programs_at + index * PROGRAM.size
            )
            if at + size > len(content):
                return "it is cut short"
        table = _sections(content, sections_at, sections)
        missing = set(functions) - set(_exported(content, table))
    except (struct.error, IndexError, OverflowError):
        return "it is cut short"
    return f"it lacks {', '.join(sorted(missing))}" if missing else ""


def with_data(content: bytes, name: str, data: bytes) -> bytes:
    """Return a library of ours with other bytes in an exported object."""
    _, _, _, _, _, sections_at, *_, sections, _ = HEADER.unpack_from(content, IDENTIFICATION_SIZE)
    table = _sections(content, sections_at, sections)
    section, address, size = _exported(content, table)[name]
    assert size == len(data), f"{name} has {size} bytes"
    _, _, _, begins, stands_at, *_ = table[section]
    place = stands_at + address - begins
    return content[:place] + data + content[place + size :]


def _sections(content: bytes, at: int, count: int) -> list[tuple[int, ...]]:
    return [SECTION.unpack_from(content, at + index * SECTION.size) for index in range(count)]


def _exported(content: bytes, table: list[tuple[int, ...]]) -> dict[str, tuple[int, int, int]]:
    """Return section, address and size of the symbols in the first dynamic symbol table.

    A library has one such table.
    """
    found = next((section for section in table if section[1] == DYNAMIC_SYMBOLS), None)
    if found is None:
        return {}
    _, _, _, _, at, size, link, *_ = found
    strings_at = table[link][4]
    names = {}
    for symbol in range(at, at + size, SYMBOL.size):
        name, _, _, section, address, room = SYMBOL.unpack_from(content, symbol)
        if section != UNDEFINED:
            begin = strings_at + name
            text = content[begin : begin + LONGEST].split(b"\0", 1)[0].decode(errors="replace")
            names[text] = section, address, room
    return names


@cache
def _this_machine() -> int:
    with open("/proc/self/exe", "rb") as python:
        machine: int = HEADER.unpack(python.read(IDENTIFICATION_SIZE + HEADER.size)[16:])[1]
    return machine
