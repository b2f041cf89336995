"""Rows of a machine for a reader in another process: tick/c/record_ring.h."""

import mmap
from typing import Any

import numpy as np

from arm_emulator.base.column import Rows
from arm_emulator.tick.c import FOLDER, FOLDERS
from arm_emulator.toolchain.c_header import Header, Library
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

RING = Header(FOLDER / "record_ring.h", FOLDERS)
LISTENERS = Header(FOLDER / "listeners.h", FOLDERS)
CAPACITY = 2**13  # rows: 8 s at 1 kHz


def build_record_ring_unit() -> Unit:
    """Return the ring as what is compiled."""
    name, part, about = "record_ring", "record_ring.c", "the ring of records"
    source, headers = f'#include "{part}"\n#include "listeners.c"\n', (RING, LISTENERS)
    return Unit(name, source, C_FLAGS, FOLDERS, headers, name, about, part)


record_ring = compile_once(build_record_ring_unit)


class SharedRing:
    """Memory that both processes map.

    Attributes:
        pointer: to ``record_ring``.
        rows: all its places (CAPACITY,).

    Args:
        descriptor: of the memory, of `compute_size` bytes.
        kind: of a row.
    """

    def __init__(self, descriptor: int, kind: np.dtype[Any]) -> None:
        self._memory = mmap.mmap(descriptor, SharedRing.compute_size(kind))
        head = RING.get_size("record_ring")
        self.pointer = RING.ffi.cast("record_ring *", RING.ffi.from_buffer(self._memory))
        self.rows: Rows = np.frombuffer(self._memory, kind, CAPACITY, head)
        self._calls = record_ring()

    @staticmethod
    def compute_size(kind: np.dtype[Any]) -> int:
        """Return the bytes of a ring."""
        return RING.get_size("record_ring") + CAPACITY * kind.itemsize

    @property
    def dropped(self) -> int:
        """Rows that found no room."""
        return int(self.pointer.dropped)

    def take_rows(self) -> Rows:
        """Return the rows that wait, as a copy, which may be none; their places are free then."""
        count = self._calls.record_waiting(self.pointer)
        places = (self.pointer.taken + np.arange(count)) % CAPACITY
        rows: Rows = self.rows[places]
        self._calls.record_release(self.pointer, count)
        return rows


class RingWriter:
    """The machine's side.

    Attributes:
        take: writes a row of the machine: what is called at the end of each exchange.
        struct: ``record_writer``, the first argument of `take_rows`.

    Args:
        ring: the memory.
        core: library of the machine.
        row: where the core writes a row.
        reader: the end of a pipe that reports when the reader has ended.
        waits: whether the machine waits for room, or drops what finds none.
    """

    def __init__(self, ring: SharedRing, core: Library, row: Any, reader: int, waits: bool) -> None:
        self._keeps = ring, row  # what the struct points to
        self.take = record_ring().record_take
        self.struct = RING.make_struct(
            "record_writer",
            waits=waits,
            reader=reader,
            measure=core.arm_measure,
            get_truth=core.arm_get_truth,
            measurement=row.measurement,
            truth=row.truth,
            row=RING.ffi.cast("record_row *", RING.ffi.from_buffer(row.rows)),
            row_bytes=row.rows.itemsize,
            capacity=CAPACITY,
            ring=ring.pointer,
            rows=RING.ffi.cast("char *", RING.ffi.from_buffer(ring.rows)),
        )
