"""All that judges the runs of a campaign as one program in C: judges.c."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array, Constant, Operation, Signal
from arm_emulator.extension.compiler import (
    BOUNDARY_FOLDER,
    C_FLAGS,
    C_NULL,
    Header,
    Unit,
    c_pointer,
    compile_once,
)
from arm_emulator.extension.machine import FORMULA_HEADER, FormulaRows
from arm_emulator_campaign.judging.requirement import C_FOLDER, Robustness

JUDGES = Header(C_FOLDER / "judges.h", (C_FOLDER, BOUNDARY_FOLDER))
BLOCK = FORMULA_HEADER.get_constant("FORMULA_BLOCK")


def judges_unit() -> Unit:
    """Return the sources of the program."""
    parts = "formula.c", "robustness.c", "judges.c"
    source = "".join(f'#include "{part}"\n' for part in parts)
    headers = (JUDGES, Header(C_FOLDER / "robustness.h"))
    about = "the judges of campaigns"
    return Unit(
        "judges", source, C_FLAGS, (C_FOLDER, BOUNDARY_FOLDER), headers, "campaign", about, parts[1]
    )


judges = compile_once(judges_unit)


class Rows(FormulaRows):
    """Rows of values over time, from samples, targets and the tick.

    Attributes:
        samples: signals that are sampled, in the order of their rows.

    Args:
        joints: of which there are targets.
        step: of the integrator [s].
        steps: from a sample to the next.
    """

    def __init__(self, joints: Sequence[str], step: float, steps: int = 1) -> None:
        super().__init__(self._find_row)
        self.samples: list[str] = []
        self._joints = list(joints)
        # Time as the machine computes it, which rounds the product of all steps and their size.
        count = Operation("*", (Signal("tick"), Constant(float(steps))))
        self._time = Operation("*", (count, Constant(step)))
        self._inputs: list[tuple[str, int]] = []

    def make_inputs(self) -> NDArray[Any]:
        """Return ``judges_input``, one at least."""
        inputs = JUDGES.make_rows("judges_input", max(1, len(self._inputs)))
        for row, (kind, place) in zip(inputs, self._inputs, strict=False):
            row["kind"], row["place"] = JUDGES.get_constant(f"JUDGES_{kind}"), place
        return inputs

    def _find_row(self, name: str) -> int:
        head, _, joint = name.partition(".")
        if name == "tick":
            return self._add_input("TICK")
        if name == "t":
            return self.add_expression(self._time)
        if head == "target":
            return self._add_input("TARGET", self._joints.index(joint))
        if head == "error":
            return self.add_expression(
                Operation("-", (Signal(f"q.{joint}"), Signal(f"target.{joint}")))
            )
        if name not in self.samples:
            self.samples.append(name)
        return self._add_input("SAMPLE", self.samples.index(name))

    def _add_input(self, kind: str, place: int = 0) -> int:
        if (kind, place) not in self._inputs:
            self._inputs.append((kind, place))
        return self.add_input(self._inputs.index((kind, place)))


@dataclass(frozen=True)
class Targets:
    """Targets of joints in runs.

    Attributes:
        since: samples from which each holds (T,), of each run ascending from 0.
        q: joint positions (T, N) [rad or m].
        first: place of the first one of each run, and the end (runs + 1,).
    """

    since: NDArray[np.int64]
    q: Array
    first: NDArray[np.int64]

    def take_runs(self, runs: NDArray[np.int64]) -> Targets:
        """Return those of some runs, which may be named several times."""
        sizes = np.diff(self.first)[runs]
        first = np.concatenate([[0], np.cumsum(sizes)])
        places = np.repeat(self.first[runs] - first[:-1], sizes) + np.arange(first[-1])
        return Targets(self.since[places], self.q[places], first)

    @classmethod
    def stack_runs(cls, runs: Sequence[tuple[Sequence[int], Array]]) -> Targets:
        """Return those of runs, of each the samples and the positions."""
        first = np.concatenate([[0], np.cumsum([len(since) for since, _ in runs])])
        since = np.concatenate([np.asarray(run, np.int64) for run, _ in runs])
        q = np.ascontiguousarray(np.concatenate([rows for _, rows in runs]))
        return cls(since, q, first.astype(np.int64))


class Program:
    """Judges the samples of runs, piece by piece.

    Args:
        rows: all that are needed.
        requirements: over these rows, a list for each run that is judged at the same time.
        measures: kind of reduction and row of each.
        traced: rows whose samples are returned.
        room: samples in a piece at most.
    """

    def __init__(
        self,
        rows: Rows,
        requirements: Sequence[Sequence[Robustness]],
        measures: Sequence[tuple[str, int]],
        traced: Sequence[int],
        room: int,
    ) -> None:
        self._requirements = requirements  # they own what the program uses
        self._room, self._row_count = room, len(rows)
        self._calls, runs = judges(), len(requirements)
        own = JUDGES.make_rows("judges_measure", runs, max(1, len(measures)))
        for place, (kind, row) in enumerate(measures):
            own[:, place]["reduction"] = JUDGES.get_constant(f"JUDGES_{kind.upper()}")
            own[:, place]["row"] = row
        self.kept = np.zeros((runs, len(traced), room))
        self._robustness = np.zeros((runs, len(requirements[0])))
        self._reduced = np.zeros((runs, len(measures)))
        values = np.zeros((max(1, len(rows)), BLOCK))  # of one run at a time
        traced_rows, of_rows = np.array([*traced, 0], np.int32), rows.make_struct()
        inputs = rows.make_inputs()
        at = JUDGES.ffi.new("double const *[]", max(1, len(rows)))
        self._referenced = own, values, traced_rows, of_rows, inputs, at
        self._pointers = [
            JUDGES.ffi.new("robustness *[]", [requirement.pointer for requirement in of_run])
            for of_run in requirements
        ]
        self._structs = JUDGES.ffi.new("judges[]", runs)
        for run in range(runs):
            JUDGES.fill_struct(
                JUDGES.ffi.addressof(self._structs, run),
                row_count=len(rows),
                requirement_count=len(requirements[0]),
                measure_count=len(measures),
                kept_count=len(traced),
                rows=JUDGES.make_pointer("formula_row", of_rows),
                inputs=inputs,
                values=values,
                at=at,
                requirements=self._pointers[run],
                measures=JUDGES.make_pointer("judges_measure", own[run]),
                kept_rows=traced_rows,
                kept=c_pointer(self.kept[run]) if len(traced) else C_NULL,
                kept_stride=room,
            )
        self._pieces = JUDGES.make_rows("judges_samples", runs)

    def begin_runs(self) -> None:
        """Begin all runs."""
        self._calls.judges_begin(self._structs, len(self._pieces))

    def go_on(self, taken: int) -> None:
        """Continue a run of which so many samples were taken elsewhere; of rows alone."""
        self.begin_runs()
        self._structs[0].taken = taken

    def take_samples(
        self, samples: Array, counts: NDArray[np.int64], targets: Targets | None = None
    ) -> None:
        """Go on with samples (runs, S, room), of which there are so many (runs,)."""
        pieces, runs = self._pieces, len(counts)
        pieces["count"][:runs], pieces["stride"] = counts, samples.shape[2]
        pieces["rows"][:runs] = _get_addresses(samples, np.arange(runs))
        if targets is not None:
            first = targets.first[: runs + 1]
            pieces["since"][:runs] = _get_addresses(targets.since, first[:-1])
            pieces["targets"][:runs] = _get_addresses(targets.q, first[:-1])
            pieces["target_count"][:runs], pieces["joints"] = np.diff(first), targets.q.shape[1]
        pointers = JUDGES.make_pointer("judges_samples", pieces)
        if self._calls.judges_add_samples(self._structs, runs, pointers):
            raise MemoryError("no memory for a requirement")

    def end_runs(self) -> tuple[Array, Array]:
        """Return robustness (runs, requirements) and measures (runs, measures), as copies."""
        places = c_pointer(self._robustness), c_pointer(self._reduced)
        self._calls.judges_end(self._structs, len(self._pieces), *places)
        return self._robustness.copy(), self._reduced.copy()


def _get_addresses(rows: NDArray[Any], which: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the addresses of some rows of a contiguous array."""
    assert rows.flags.c_contiguous
    address: int = rows.__array_interface__["data"][0]
    return address + rows.strides[0] * which
