"""Files of rows, by their suffix: whole at every moment, or absent.

Rows are written as they arrive. If the disk is full, files of kinds that grow row by row keep the
rows written so far; files of other kinds get their name when they are complete.
"""

import contextlib
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from arm_emulator.base.column import Column, Rows
from arm_emulator.base.io.atomic_write import UnbufferedFile, flush_to_disk
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.required_package import require_package
from arm_emulator.base.run_outputs import SUFFIXES, check_suffix

CHUNK_SIZE = 2**30  # bytes of MCAP: chunks end between rows, not by size
ROWS_OF_CHUNK = 256
ROWS_OF_GROUP = 2**14  # of Parquet
NANOSECONDS = 1_000_000_000
MEASURED = "measured"  # first part of the path of measured values
CLOCK = ("t", "tick")  # in both channels of MCAP


class RecordFile(Protocol):
    """A new file for rows."""

    def write_rows(self, rows: Rows) -> None:
        """Append rows (K,).

        Raises:
            OSError: not all of them were written.
        """

    def close(self) -> None:
        """Complete the file.

        Raises:
            OSError: see `write_rows`.
        """

    def give_up(self) -> None:
        """Leave a whole file of the rows written before the disk failed, or no file."""


def open_record(where: str, file: Path, columns: Sequence[Column]) -> RecordFile:
    """Return a new file of the kind that its suffix names.

    Raises:
        Refusal: another suffix, a file that exists or cannot be made, or a package is missing.
    """
    check_suffix(where, "file", file)
    if file.exists():
        raise Refusal(where, f"file {file}", "be new", "one that exists")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        return KINDS[file.suffix](file, columns)
    except OSError as error:
        raise Refusal(where, f"file {file}", "be writable", error.strerror) from None


class CsvFile:
    """A heading with units, then a line per row; values that are not finite are empty cells."""

    def __init__(self, file: Path, columns: Sequence[Column]) -> None:
        self._file, self._columns, self._stream = file, columns, UnbufferedFile(file)
        self._stream.write(
            ",".join(_format_cell(column.heading) for column in columns).encode() + b"\n"
        )
        # End of the last whole line.
        self._complete_size = self._stream.tell()

    def write_rows(self, rows: Rows) -> None:
        """Append lines."""
        lines = map(",".join, zip(*_format_texts(self._columns, rows, ""), strict=True))
        self._stream.write("".join(f"{line}\n" for line in lines).encode())
        self._complete_size = self._stream.tell()

    def close(self) -> None:
        """Complete the file."""
        flush_to_disk(self._stream.fileno())
        self._stream.close()

    def give_up(self) -> None:
        """Remove an incomplete last line."""
        with self._file.open("rb") as stream:
            stream.seek(self._complete_size)
            taken = stream.read().rfind(b"\n") + 1
        self._stream.truncate(self._complete_size + taken)
        self._stream.close()


class McapFile:
    """Channels ``truth`` and ``measured``, a JSON object each per row, with schemas of units."""

    def __init__(self, file: Path, columns: Sequence[Column]) -> None:
        require_package("record", "mcap", "mcap")
        from mcap.writer import CompressionType, Writer

        self._file, self._stream = file, UnbufferedFile(file)
        self._mcap = Writer(self._stream, CHUNK_SIZE, CompressionType.ZSTD)  # type: ignore[arg-type]
        self._mcap.start("", "arm_emulator")
        self._count = 0
        truth = [column for column in columns if column.path[0] != MEASURED]
        measured = [column for column in columns if column.path[0] == MEASURED]
        clock = [column for column in truth if column.name in CLOCK]
        self._topics = [
            self._add_topic("truth", truth),
            self._add_topic(MEASURED, clock + measured),
        ]

    def _add_topic(self, name: str, columns: list[Column]) -> tuple[int, list[Column], str]:
        """Return number, columns and template of a channel."""
        tree = _build_tree(columns)
        text = json.dumps({"title": name, **_build_schema(tree)}).encode()
        schema = self._mcap.register_schema(f"arm_emulator.{name}", "jsonschema", text)
        return self._mcap.register_channel(name, "json", schema), columns, _build_template(tree)

    def write_rows(self, rows: Rows) -> None:
        """Append a message per row and channel, at its logical time."""
        times = np.rint(rows["t"] * NANOSECONDS).astype(np.int64).tolist()
        lines = [
            [
                (channel, template % texts)
                for texts in zip(*_format_texts(of, rows, "null"), strict=True)
            ]
            for channel, of, template in self._topics
        ]
        for time, *messages in zip(times, *lines, strict=True):
            for channel, text in messages:
                self._mcap.add_message(channel, time, text.encode(), time, self._count)
            self._count += 1
            if self._count % ROWS_OF_CHUNK == 0:
                self._mcap.flush()
        self._mcap.flush()

    def close(self) -> None:
        """Write the index."""
        self._mcap.finish()
        flush_to_disk(self._stream.fileno())
        self._stream.close()

    def give_up(self) -> None:
        """End the file after the last whole chunk."""
        from arm_emulator.base.io.mcap_records import recover_mcap

        self._stream.close()
        recover_mcap(self._file)


class _WrittenAtEnd:
    """A file that is readable only when complete: until then it has another name."""

    def __init__(self, file: Path, columns: Sequence[Column]) -> None:
        self._file, self._columns = file, columns
        self._part = file.with_name(f".{file.name}.{os.getpid()}.part")
        self._part.touch(exist_ok=False)

    def _publish_file(self) -> None:
        with self._part.open("rb") as stream:
            flush_to_disk(stream.fileno())
        self._part.rename(self._file)

    def give_up(self) -> None:
        """Leave no file."""
        self._part.unlink(missing_ok=True)


class ParquetFile(_WrittenAtEnd):
    """A column per number, the unit in the metadata of its field."""

    def __init__(self, file: Path, columns: Sequence[Column]) -> None:
        require_package("record", "pyarrow", "pyarrow")
        import pyarrow.parquet as pq

        super().__init__(file, columns)
        self._waiting: list[Rows] = []
        self._schema: Any = None
        self._open = pq.ParquetWriter
        self._writer: Any = None

    def write_rows(self, rows: Rows) -> None:
        """Append rows, which are written group by group."""
        self._waiting.append(rows)
        if sum(map(len, self._waiting)) >= ROWS_OF_GROUP:
            self._write_group()

    def _write_group(self) -> None:
        if not self._waiting:
            return
        table = build_arrow_table(self._columns, np.concatenate(self._waiting))
        self._waiting = []
        if self._writer is None:
            self._writer = self._open(self._part, table.schema)
        self._writer.write_table(table)

    def close(self) -> None:
        """Write the last group and the index."""
        self._write_group()
        if self._writer is not None:
            self._writer.close()
        self._publish_file()

    def give_up(self) -> None:
        """Leave no file."""
        with contextlib.suppress(Exception):
            self._writer.close()
        super().give_up()


class NpzFile(_WrittenAtEnd):
    """An array per column in a NumPy archive."""

    def __init__(self, file: Path, columns: Sequence[Column]) -> None:
        super().__init__(file, columns)
        self._waiting: list[Rows] = []

    def write_rows(self, rows: Rows) -> None:
        """Collect rows, which are written at the end."""
        self._waiting.append(rows)

    def close(self) -> None:
        """Write all rows."""
        rows = np.concatenate(self._waiting)
        with self._part.open("wb") as stream:
            values = {column.name: column.select_values(rows) for column in self._columns}
            np.savez(stream, **values)  # type: ignore[arg-type]
        self._publish_file()


KINDS: dict[str, Callable[[Path, Sequence[Column]], RecordFile]] = dict(
    zip(SUFFIXES, (McapFile, CsvFile, ParquetFile, NpzFile), strict=True)
)


def build_arrow_table(columns: Sequence[Column], rows: Rows) -> Any:
    """Return rows as an Arrow table, with units in the metadata of its fields."""
    import pyarrow as pa

    arrays = [pa.array(np.ascontiguousarray(column.select_values(rows))) for column in columns]
    fields = [
        pa.field(column.name, array.type, metadata={"unit": column.unit} if column.unit else None)
        for column, array in zip(columns, arrays, strict=True)
    ]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def _format_texts(columns: Sequence[Column], rows: Rows, none: str) -> list[list[str]]:
    """Return columns as texts that give the same bits; `none` for values that are not finite."""
    texts = []
    for column in columns:
        values = column.select_values(rows)
        written = list(map(repr, values.tolist()))
        for k in np.flatnonzero(~np.isfinite(values)):
            written[k] = none
        texts.append(written)
    return texts


def _format_cell(text: str) -> str:
    return '"{}"'.format(text.replace('"', '""')) if set(text) & set(',"\n') else text


Tree = dict[str, Any]  # columns in groups by their paths
_NUMBER = "\0"  # stands for a number in a template; no name has it


def _build_tree(columns: Sequence[Column]) -> Tree:
    tree: Tree = {}
    for column in columns:
        at, path = tree, column.path[1:] if column.path[0] == MEASURED else column.path
        for part in path[:-1]:
            at = at.setdefault(part, {})
        at[path[-1]] = column
    return tree


def _build_template(tree: Tree) -> str:
    """Return a JSON object with `%s` for each number."""
    text = json.dumps(tree, separators=(",", ":"), default=lambda _: _NUMBER)
    return text.replace("%", "%%").replace(json.dumps(_NUMBER), "%s")


def _build_schema(tree: Tree) -> dict[str, Any]:
    properties = {
        key: _build_schema(node)
        if isinstance(node, dict)
        else {"type": ["number", "null"], "description": node.unit}
        for key, node in tree.items()
    }
    return {"type": "object", "properties": properties}
