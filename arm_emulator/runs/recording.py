"""A run kept as a table: what was true and what was measured, row by row."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.count import check_count
from arm_emulator.base.given import as_numbers
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.machine.outputs import KNOWN
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.plant_state import ROWS

TRUTH = (*ROWS, "energy")
MEASURED = tuple(f"measured.{name}" for name in KNOWN)
SUFFIXES = (".parquet", ".csv", ".npz")


class Recording:
    """Rows of a plant's quantities, taken whenever `take` is called.

    As a context it writes its file at the end.

    Args:
        plant: the machine.
        file: .parquet, .csv or .npz; None: nothing is written.
        names: quantities of the true state (`PlantState`, energy), or measured ones as
            ``measured.current``.

    Raises:
        Refusal: another quantity or kind of file.
    """

    def __init__(
        self,
        plant: Plant,
        file: str | Path | None = None,
        *,
        names: tuple[str, ...] = ("q", "v", "measured.encoder_counts", "measured.current"),
    ) -> None:
        for name in names:
            if name not in (*TRUTH, *MEASURED):
                valid = ", ".join((*TRUTH, *MEASURED))
                raise Refusal("Recording", "name", "be a quantity", name, valid)
        self._file = None if file is None else Path(file)
        if self._file is not None and self._file.suffix not in SUFFIXES:
            rule = "end in a known kind"
            raise Refusal("Recording", "file", rule, self._file.name, ", ".join(SUFFIXES))
        self._plant, self._names = plant, tuple(names)
        self._t: list[float] = []
        self._rows: dict[str, list[Any]] = {name: [] for name in self._names}

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self.write(self._file)

    def take(self) -> None:
        """Take a row: the machine as it is now."""
        state, measured = self._plant.state, self._plant.measured
        self._t.append(state.t)
        for name, rows in self._rows.items():
            if name == "energy":
                rows.append(self._plant.energy)
            elif name in ROWS:
                rows.append(getattr(state, name))
            else:
                rows.append(getattr(measured, name.removeprefix("measured.")))

    def run(self, commands: ArrayLike, steps: int, *, every: int = 1) -> None:
        """Apply rows of commands as `Plant.run` does, and take a row after each or some of them.

        Args:
            commands: (K, N) [V, N m, A].
            steps: integration steps under each row.
            every: rows of commands for each row that is taken.

        Raises:
            Refusal: see `Plant.run`; or no such count.
            Diverged: see there; what was taken before is kept.
        """
        every = check_count("Recording.run", "every", every, 1)
        rows = np.atleast_2d(as_numbers(commands, "Recording.run", "commands", "V, N m or A"))
        for first in range(0, len(rows), every):
            self._plant.run(rows[first : first + every], steps)
            self.take()

    @property
    def t(self) -> Array:
        """Logical times of the rows (K,) [s]."""
        return np.array(self._t)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the rows of a quantity, (K, N)."""
        return np.array(self._rows[name])

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all quantities as columns (K,): ``q.elbow``, ``measured.current.elbow``."""
        columns: dict[str, NDArray[Any]] = {"t": self.t}
        joints = self._plant.scene.joint_names
        for name in self._names:
            rows = self[name]
            rows = rows.reshape(len(rows), -1)
            of = joints if rows.shape[1] == len(joints) else range(rows.shape[1])
            single = name == "energy"
            for one, column in zip(of, rows.T, strict=False):
                columns[name if single else f"{name}.{one}"] = column
        return columns

    def table(self) -> Any:
        """Return the columns as a table of Arrow (pyarrow must be installed)."""
        import pyarrow as pa

        return pa.table(self.columns())

    def write(self, file: Path) -> None:
        """Write the columns to a file, by its suffix."""
        columns = self.columns()
        if file.suffix == ".parquet":
            import pyarrow.parquet as pq

            pq.write_table(self.table(), file)
        elif file.suffix == ".npz":
            np.savez(file, **columns)  # type: ignore[arg-type]
        else:
            names, rows = ",".join(columns), np.column_stack(list(columns.values()))
            np.savetxt(file, rows, "%.17g", ",", header=names, comments="")
