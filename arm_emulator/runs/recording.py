"""A run kept as a table: what was true and what was measured, row by row."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.arrays import Array
from arm_emulator.base.column import Column, Rows
from arm_emulator.base.io.record_file import build_arrow_table, open_record
from arm_emulator.base.non_copyable import NonCopyable
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.run_outputs import check_suffix
from arm_emulator.base.validation.bound import ANY_COMMANDS
from arm_emulator.base.validation.count import check_count
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import ROWS
from arm_emulator.machine.session.record_row import (
    RecordRow,
    build_row_type,
    list_columns,
    select_values,
)
from arm_emulator.runs.view_of import get_view

TRUTH = (*ROWS, "energy")
RERUN = ".rrd"
MEASURED = tuple(f"measured.{name}" for name in KNOWN)


class Recording(NonCopyable):
    """Rows of a plant's quantities, taken whenever `take` is called.

    As a context it writes its file at the end.

    Args:
        plant: the machine.
        file: .mcap, .csv, .parquet or .npz; .rrd: the arm in motion and its signals, for Rerun;
            None: nothing is written.
        names: quantities of the true state (`PlantState`, energy), or measured ones as
            ``measured.current``.

    Raises:
        Refusal: another quantity or kind of file, or no such folder.
    """

    instead = "its rows, as arrays by name"

    def __init__(
        self,
        plant: Plant,
        file: str | Path | None = None,
        *,
        names: Sequence[str] = ("q", "v", "measured.encoder_counts", "measured.current"),
    ) -> None:
        if not isinstance(plant, Plant):
            raise Refusal("Recording", "plant", "be a Plant", plant)
        if isinstance(names, str) or not isinstance(names, Iterable):
            raise Refusal("Recording", "names", "be several, as in a tuple", names)
        for name in names:
            if not isinstance(name, str) or name not in (*TRUTH, *MEASURED):
                valid = ", ".join((*TRUTH, *MEASURED))
                raise Refusal("Recording", "name", "be a quantity", name, valid)
        self._file = None if file is None else Path(file)
        if self._file is not None and self._file.suffix != RERUN:
            check_suffix("Recording", "file", self._file)
        if self._file is not None and not self._file.parent.is_dir():
            raise Refusal("Recording", "file", "be in a folder that exists", self._file)
        self._plant, self._names = plant, tuple(names)
        self._row = RecordRow(plant)
        self._taken: list[Rows] = [np.zeros(0, build_row_type(plant.scene))]

    def __repr__(self) -> str:
        rows, names = sum(map(len, self._taken)), ", ".join(self._names)
        return f"<Recording of {self._plant.scene.name}: {rows} rows of {names}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self.write(self._file)

    def take(self) -> None:
        """Take a row: the machine as it is now."""
        self._taken.append(self._row.take_row())

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
        rows = np.atleast_2d(ANY_COMMANDS.check_numbers("Recording.run", commands))
        for first in range(0, len(rows), every):
            self._plant.run(rows[first : first + every], steps)
            self.take()

    @property
    def _rows(self) -> Rows:
        if len(self._taken) > 1:
            # As bytes: NumPy joins records field by field, in more time than their steps took.
            joined = bytearray().join(record.tobytes() for record in self._taken)
            self._taken = [np.frombuffer(joined, self._taken[0].dtype)]
        return self._taken[0]

    @property
    def t(self) -> Array:
        """Logical times of the rows (K,) [s]."""
        return self._rows["t"].copy()

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the rows of a quantity that was asked for, (K, N).

        Raises:
            Refusal: it was not.
        """
        if not isinstance(name, str) or name not in self._names:
            raise Refusal("Recording", "name", "be recorded", name, ", ".join(self._names))
        return select_values(self._rows, name, self._plant.scene).copy()

    @property
    def _columns(self) -> list[Column]:
        """Columns of the requested quantities."""
        columns = list_columns(self._plant.scene)
        paths = [("t",), *(tuple(name.split(".")) for name in self._names)]
        return [column for path in paths for column in columns if column.path[: len(path)] == path]

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all quantities as columns (K,): ``q.elbow``, ``measured.current.elbow``."""
        return {column.name: column.select_values(self._rows) for column in self._columns}

    def table(self) -> Any:
        """Return the columns as a table of Arrow, with units (pyarrow must be installed)."""
        return build_arrow_table(self._columns, self._rows)

    def write(self, file: str | Path) -> None:
        """Write the columns to a file, by its suffix; one that exists is replaced.

        Raises:
            Refusal: another suffix, or a file that cannot be written.
        """
        if not isinstance(file, str | Path) or not Path(file).name:
            raise Refusal("Recording", "file", "be a file", file)
        file = Path(file)
        part = file.with_name(f".{file.stem}.part{file.suffix}")
        part.unlink(missing_ok=True)
        if file.suffix == RERUN:
            self._write_rerun(part)
            part.replace(file)
            return
        check_suffix("Recording", "file", file)
        record = open_record("Recording", part, self._columns)
        try:
            record.write_rows(self._rows)
            record.close()
            part.replace(file)
        except OSError as error:
            record.give_up()
            part.unlink(missing_ok=True)
            raise Refusal("Recording", f"file {file}", "be writable", error.strerror) from None

    def _write_rerun(self, file: Path) -> None:
        """Write all quantities as a recording of Rerun."""
        from arm_emulator.view.rerun_rows import RerunRows

        scene, angle = self._plant.scene, self._plant.link_angle_per_count
        rows = RerunRows(str(file), list_columns(scene), angle, get_view(scene))
        rows.show_rows(self._rows)
        if trouble := rows.close():
            raise Refusal("Recording", f"file {file}", "accept every row", trouble)
