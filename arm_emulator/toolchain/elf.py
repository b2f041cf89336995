"""Detection of shared libraries in ELF without loading them."""

import struct
from collections.abc import Iterable, Iterator
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
LOADED, THREADS, READ_ONLY = 1, 7, 0x6474E552  # kinds of segments
WRITABLE = 2  # of its flags
PAGE = 4096  # bytes
WEAK = 2  # binding of a symbol
DYNAMIC_SYMBOLS = 11
UNDEFINED = 0
LONGEST = 200  # bytes of a name that we may ask for


def explain_no_library(content: bytes, functions: Iterable[str]) -> str:
    """Return why bytes are not a shared library for this machine with these functions, or "".

    A truncated file is detected, since the table of sections is at its end. The time is bounded by
    the number of bytes, for any content.
    """
    if not content:
        return "it is empty"
    if not content.startswith(IDENTIFICATION):
        return "it is not a 64-bit ELF file"
    try:
        kind, machine, _, _, programs_at, _, *_, programs, _, _, _ = HEADER.unpack_from(
            content, IDENTIFICATION_SIZE
        )
        if kind != SHARED_OBJECT:
            return "it is not a shared library"
        if machine != _read_own_machine():
            return f"it is for another machine (ELF number {machine})"
        for index in range(programs):
            _, _, at, _, _, size, *_ = PROGRAM.unpack_from(
                content, programs_at + index * PROGRAM.size
            )
            if at + size > len(content):
                return "it is cut short"
        table = _read_sections(content)
        missing = set(functions) - set(_list_exported(content, table))
    except (struct.error, IndexError, OverflowError):
        return "it is cut short"
    return f"it lacks {', '.join(sorted(missing))}" if missing else ""


def list_written_memory(content: bytes) -> list[tuple[int, int]]:
    """Return addresses and sizes of the memory of a sound library that its code writes to.

    Of threads each has its own: then it is empty.
    """
    _, _, _, _, at, _, _, _, _, count, *_ = HEADER.unpack_from(content, IDENTIFICATION_SIZE)
    segments = [PROGRAM.unpack_from(content, at + k * PROGRAM.size) for k in range(count)]
    if any(kind == THREADS for kind, *_ in segments):
        return []
    # Memory that the loader has relocated is read only afterwards, in whole pages.
    fixed = [
        (segment[3], (segment[3] + segment[6]) // PAGE * PAGE)
        for segment in segments
        if segment[0] == READ_ONLY
    ]
    regions = []
    for kind, flags, _, begin, _, _, size, _ in segments:
        if kind == LOADED and flags & WRITABLE:
            end = begin + size
            begin = max([begin, *(till for since, till in fixed if begin <= since < end)])
            regions.append((begin, end - begin))
    return regions


def list_called_functions(content: bytes) -> set[str]:
    """Return the names that a sound library takes from others, but for those it can do without."""
    symbols = _read_symbols(content, _read_sections(content))
    return {name for name, binding, section, *_ in symbols if not section and binding != WEAK} - {
        ""
    }


def find_address(content: bytes, name: str) -> int:
    """Return the address of an exported symbol of a sound library."""
    return _list_exported(content, _read_sections(content))[name][1]


def replace_data(content: bytes, name: str, data: bytes) -> bytes:
    """Return a library of ours with other bytes in an exported object."""
    table = _read_sections(content)
    section, address, size = _list_exported(content, table)[name]
    assert size == len(data), f"{name} has {size} bytes"
    _, _, _, begins, stands_at, *_ = table[section]
    place = stands_at + address - begins
    return content[:place] + data + content[place + size :]


def _read_sections(content: bytes) -> list[tuple[int, ...]]:
    _, _, _, _, _, at, *_, count, _ = HEADER.unpack_from(content, IDENTIFICATION_SIZE)
    return [SECTION.unpack_from(content, at + index * SECTION.size) for index in range(count)]


def _list_exported(content: bytes, table: list[tuple[int, ...]]) -> dict[str, tuple[int, int, int]]:
    """Return section, address and size of the exported symbols."""
    return {
        name: (section, address, size)
        for name, _, section, address, size in _read_symbols(content, table)
        if section != UNDEFINED
    }


def _read_symbols(
    content: bytes, table: list[tuple[int, ...]]
) -> Iterator[tuple[str, int, int, int, int]]:
    """Yield name, binding, section, address and size of the first dynamic symbol table.

    A library has one such table.
    """
    symbols = next((section for section in table if section[1] == DYNAMIC_SYMBOLS), None)
    if symbols is None:
        return
    _, _, _, _, at, size, link, *_ = symbols
    strings_at = table[link][4]
    for symbol in range(at, at + size, SYMBOL.size):
        name, info, _, section, address, room = SYMBOL.unpack_from(content, symbol)
        begin = strings_at + name
        text = content[begin : begin + LONGEST].split(b"\0", 1)[0].decode(errors="replace")
        yield text, info >> 4, section, address, room


@cache
def _read_own_machine() -> int:
    with open("/proc/self/exe", "rb") as python:
        machine: int = HEADER.unpack(python.read(IDENTIFICATION_SIZE + HEADER.size)[16:])[1]
    return machine
