"""The object dictionary of a drive and its modes, as the library of the drives lists them."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from arm_emulator.extension.compiler import Library, c_text
from arm_emulator.extension.machine import LoopMode, ServoLoop
from arm_emulator_fieldbus.drives_unit import DRIVES, drives_library

ACCESS = ("const", "ro", "wo", "rw")
TYPES = {
    1: "BOOLEAN",
    2: "INTEGER8",
    3: "INTEGER16",
    4: "INTEGER32",
    5: "UNSIGNED8",
    6: "UNSIGNED16",
    7: "UNSIGNED32",
    8: "REAL32",
    9: "VISIBLE_STRING",
    17: "REAL64",
}
# Layouts of numbers that are not whole.
REALS = {"REAL32": "<f", "REAL64": "<d"}
SIGNED = ("INTEGER8", "INTEGER16", "INTEGER32")


@dataclass(frozen=True)
class ObjectEntry:
    """One entry of the object dictionary, see core/object_dictionary.hpp."""

    index: int
    sub: int
    object: str
    """Name of its object."""
    name: str
    code: int
    """7 variable, 8 array, 9 record."""
    last_sub: int
    """Last subindex of its object."""
    type: str
    """As CiA 301 calls it."""
    bits: int
    """0: text."""
    access: str
    """const, ro, wo or rw."""
    rx: bool
    """Whether a drive may receive it as process data."""
    tx: bool
    """Whether a drive may transmit it as process data."""
    buses: int
    """Bits ETHERCAT and CANOPEN: where it is there."""
    unit: str
    standard: int
    least: int
    most: int


class Aborted(Exception):
    """An access that a dictionary refuses.

    Attributes:
        code: abort code of an SDO server.
    """

    def __init__(self, index: int, sub: int, code: int) -> None:
        super().__init__(f"0x{index:04X}:{sub}: abort code 0x{code:08X}")
        self.code = code


@cache
def list_entries() -> tuple[ObjectEntry, ...]:
    """Return all entries, in ascending order."""
    return tuple(read_entries(drives_library()))


def read_entries(calls: Library) -> Iterator[ObjectEntry]:
    """Yield the entries that a library with drives has, in ascending order."""
    entry, slot = DRIVES.make_struct("drives_entry"), 0
    while calls.drives_list(slot, entry):
        yield ObjectEntry(
            entry.index,
            entry.sub,
            c_text(entry.object),
            c_text(entry.name),
            entry.code,
            entry.last_sub,
            TYPES[entry.type],
            entry.bits,
            ACCESS[entry.access],
            bool(entry.pdo & 1),
            bool(entry.pdo & 2),
            entry.buses,
            c_text(entry.unit),
            entry.standard,
            entry.least,
            entry.most,
        )
        slot += 1


@cache
def modes() -> tuple[LoopMode, ...]:
    """Return all modes of operation that drives have, see core/modes/modes.hpp."""
    return tuple(_read_modes(drives_library()))


def _read_modes(calls: Library) -> Iterator[LoopMode]:
    mode, row = DRIVES.make_struct("drives_mode"), 0
    while calls.drives_list_mode(row, mode):
        loops = tuple(loop for bit, loop in enumerate(ServoLoop) if mode.loops >> bit & 1)
        yield LoopMode(mode.number, c_text(mode.name), loops)
        row += 1
