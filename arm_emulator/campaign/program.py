"""All that judges the runs of a campaign as one program in C: judges.c."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.formula import Constant, Expression, Operation, Signal
from arm_emulator.build.c_header import NULL, Header, Library, pointer
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.campaign.requirement import Robustness

Array = NDArray[np.float64]
Row = tuple[str, int, int, float]
HERE = Path(__file__).resolve().parent
JUDGES = Header(HERE / "judges.h", (HERE,))
BLOCK = JUDGES.constant("JUDGES_BLOCK")
_ARITHMETIC = {
    "+": "ADD",
    "-": "SUBTRACT",
    "*": "MULTIPLY",
    "/": "DIVIDE",
    "min": "LEAST",
    "max": "MOST",
    "abs": "ABS",
    "sqrt": "ROOT",
}


@cache
def judges() -> Library:
    """Return the compiled program, compiling it if no cached library fits."""
    return library(judges_unit())


def judges_unit() -> Unit:
    """Return the sources of the program."""
    source, about = '#include "robustness.c"\n#include "judges.c"\n', "the judges of campaigns"
    headers = (JUDGES, Header(HERE / "robustness.h"))
    return Unit("judges", source, C_FLAGS, (HERE,), headers, "campaign", about, "robustness.c")


class Rows:
    """Rows of values over time, each of which is computed once whoever asks for it.

    Attributes:
        samples: signals that are sampled, in the order of their rows.

    Args:
        joints: of which there are targets.
        period: of the samples [s].
    """

    def __init__(self, joints: Sequence[str], period: float) -> None:
        self.samples: list[str] = []
        self._joints, self._period = list(joints), period
        self._rows: dict[Row, int] = {}

    def of(self, what: Expression) -> int:
        """Return the row of arithmetic."""
        if isinstance(what, Constant):
            return self._row("CONSTANT", value=what.value)
        if isinstance(what, Signal):
            return self._signal(what.name)
        kind, first, *others = _ARITHMETIC[what.sign], *map(self.of, what.of)
        if not others:
            return self._row(kind, first, first)
        return functools.reduce(lambda left, right: self._row(kind, left, right), others, first)

    def _signal(self, name: str) -> int:
        head, _, joint = name.partition(".")
        if name == "tick":
            return self._row("TICK")
        if name == "t":
            return self.of(Operation("*", (Signal("tick"), Constant(self._period))))
        if head == "target":
            return self._row("TARGET", self._joints.index(joint))
        if head == "error":
            return self.of(Operation("-", (Signal(f"q.{joint}"), Signal(f"target.{joint}"))))
        if name not in self.samples:
            self.samples.append(name)
        return self._row("SIGNAL", self.samples.index(name))

    def _row(self, kind: str, left: int = 0, right: int = 0, value: float = 0.0) -> int:
        return self._rows.setdefault((kind, left, right, value), len(self._rows))

    def struct(self) -> NDArray[np.void]:
        """Return them as the program takes them."""
        rows = JUDGES.rows("judges_row", max(1, len(self._rows)))
        for row, (kind, left, right, value) in zip(rows, self._rows, strict=False):
            row["kind"] = JUDGES.constant(f"JUDGES_{kind}")
            row["left"], row["right"], row["value"] = left, right, value
        return rows

    def __len__(self) -> int:
        return len(self._rows)


@dataclass(frozen=True)
class Targets:
    """Targets of joints.

    Attributes:
        since: samples from which each holds (T,), ascending from 0.
        q: joint positions (T, N) [rad or m].
    """

    since: NDArray[np.int64]
    q: Array


class Program:
    """Judges the samples of a run, piece by piece.

    Args:
        rows: all that are needed.
        requirements: over these rows.
        measures: kind of reduction and row of each.
        kept: rows that are wanted as they are.
        room: samples in a piece at most.
    """

    def __init__(
        self,
        rows: Rows,
        requirements: Sequence[Robustness],
        measures: Sequence[tuple[str, int]],
        kept: Sequence[int],
        room: int,
    ) -> None:
        self._requirements = list(requirements)  # they own what the program uses
        self._calls = judges()
        self._pointers = JUDGES.ffi.new("robustness *[]", [one.pointer for one in requirements])
        self._measures = JUDGES.rows("judges_measure", max(1, len(measures)))
        for place, (kind, row) in zip(self._measures, measures, strict=False):
            place["reduction"] = JUDGES.constant(f"JUDGES_{kind.upper()}")
            place["row"] = row
        self.kept = np.zeros((len(kept), room))
        self._robustness, self._found = np.zeros(len(requirements)), np.zeros(len(measures))
        self._struct = JUDGES.new(
            "judges",
            row_count=len(rows),
            requirement_count=len(requirements),
            measure_count=len(measures),
            kept_count=len(kept),
            rows=JUDGES.pointer("judges_row", self._hold(rows.struct())),
            values=self._hold(np.zeros((max(1, len(rows)), BLOCK))),
            requirements=self._pointers,
            measures=JUDGES.pointer("judges_measure", self._measures),
            kept_rows=self._hold(np.array([*kept, 0], np.int32)),
            kept=pointer(self.kept) if len(kept) else NULL,
            kept_stride=room,
        )

    def _hold(self, array: NDArray[np.generic]) -> NDArray[np.generic]:
        self._held = [*getattr(self, "_held", []), array]
        return array

    def begin(self) -> None:
        """Begin a run."""
        self._calls.judges_begin(self._struct)

    def go_on(self, taken: int) -> None:
        """Continue a run of which so many samples were taken elsewhere; of rows alone."""
        self._calls.judges_begin(self._struct)
        self._struct.taken = taken

    def take(self, samples: Array, count: int, targets: Targets | None = None) -> None:
        """Go on with `count` samples of the rows of `samples` (S, room)."""
        piece = JUDGES.new(
            "judges_samples", count=count, stride=samples.shape[1], rows=pointer(samples)
        )
        if targets is not None:
            JUDGES.fill(
                piece,
                since=targets.since,
                targets=targets.q,
                target_count=len(targets.since),
                joints=targets.q.shape[1],
            )
        if self._calls.judges_take(self._struct, piece):
            raise MemoryError("no memory for a requirement")

    def end(self) -> tuple[list[float], list[float]]:
        """Return the robustness of each requirement, and the value of each measure."""
        self._calls.judges_end(self._struct, pointer(self._robustness), pointer(self._found))
        return self._robustness.tolist(), self._found.tolist()
