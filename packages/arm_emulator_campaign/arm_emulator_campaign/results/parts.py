"""Results of a campaign: parts in a folder, each whole or absent.

A part holds a row per run, its indices ascending. The parts list the runs that are done; their
division into parts has no meaning and does not affect the digest.

The name of a part ends with the checksum of its bytes, and its metadata have the campaign's key. A
file that has other bytes, or is of another campaign, is moved into a folder of its own: its runs
are missing, and are simulated again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import (
    Constant,
    Expression,
    Formula,
    Margin,
    Refusal,
    Signal,
    bind_signals,
    fold_expression,
    name_hidden_file,
    parse_formula,
    print_warnings,
    require_package,
    write_atomically,
)
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.judging.evaluators import Measure
from arm_emulator_campaign.judging.signals import list_signal_units
from arm_emulator_campaign.simulation.outcome import Outcomes

PARTS, ABOUT, ASIDE = "parts", "campaign.json", "set_aside"
INDEX, FAILED, DIVERGED = "index", "failed", "diverged"
ROBUSTNESS, MEASURE = "robustness.", "measure."


_units: dict[bytes, dict[str, str]] = {}  # by the keys of campaigns


def list_column_units(campaign: Campaign) -> dict[str, str]:
    """Return the columns of results with their units, in their order."""
    if campaign.key not in _units:
        units = {INDEX: "", FAILED: "", DIVERGED: "s"}
        units |= {number.name: number.unit for number in campaign.variation.numbers}
        robustness, measures = find_judged_units(campaign)
        units |= {f"{ROBUSTNESS}{name}": unit for name, unit in robustness.items()}
        _units[campaign.key] = units | {f"{MEASURE}{name}": u for name, u in measures.items()}
    return _units[campaign.key]


def make_schema(campaign: Campaign) -> Any:
    """Return the columns with types and units, as Arrow has them."""
    require_package("campaign", "pyarrow", "pyarrow")
    import pyarrow as pa

    kinds = {INDEX: pa.int64(), FAILED: pa.bool_()}
    return pa.schema(
        [
            pa.field(name, kinds.get(name, pa.float64()), False, {"unit": unit} if unit else None)
            for name, unit in list_column_units(campaign).items()
        ],
        {"campaign": campaign.key.hex()},
    )


def write_part(folder: Path, campaign: Campaign, done: Outcomes) -> Path:
    """Write the rows of some runs, one at least, as a part."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = make_schema(campaign)
    columns = [done.indices, done.failed, done.diverged]
    for rows in (done.values, done.robustness, done.measures):
        columns += [np.ascontiguousarray(column) for column in rows.T]
    first, last = done.indices[0], done.indices[-1]
    hidden = name_hidden_file(folder / PARTS / f"{first:012d}-{last:012d}-{len(done)}.parquet")
    pq.write_table(pa.table(dict(zip(schema.names, columns, strict=True)), schema=schema), hidden)
    with hidden.open("rb") as written:
        os.fsync(written.fileno())
    checksum = compute_checksum(hidden.read_bytes())
    part = folder / PARTS / f"{first:012d}-{last:012d}-{len(done)}-{checksum}.parquet"
    hidden.replace(part)
    return part


def compute_checksum(content: bytes) -> str:
    """Return a checksum of bytes, 16 digits."""
    return hashlib.blake2b(content, digest_size=8).hexdigest()


class Results:
    """The folder of a campaign's results.

    Args:
        folder: of this campaign alone; made if it is not there.
        campaign: which one.

    Raises:
        Refusal: it cannot be written, or has results of another campaign.
    """

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        self.folder, self.campaign = folder, campaign
        self._sound: set[str] = set()
        about = folder / ABOUT
        try:
            (folder / PARTS).mkdir(parents=True, exist_ok=True)
            if about.exists():
                facts = json.loads(about.read_text(encoding="utf-8"))
                key = facts.get("key") if isinstance(facts, dict) else None
                if key != campaign.key.hex():
                    rule = "be new, or have results of this campaign as it is written now"
                    value = f"results of {str(key)[:12]}, this is {campaign.key.hex()[:12]}"
                    raise Refusal("campaign", f"folder {folder}", rule, value, "--into FOLDER")
            else:
                facts = {"key": campaign.key.hex(), "file": str(campaign.file.absolute())}
                write_atomically(about, json.dumps(facts))
        except (OSError, ValueError) as error:
            if isinstance(error, Refusal):
                raise
            raise Refusal("campaign", f"folder {folder}", "be writable", error) from None

    @property
    def parts(self) -> list[Path]:
        """All sound parts; others are set aside."""
        files = sorted((self.folder / PARTS).glob("*.parquet"))
        return [part for part in files if self._is_sound(part)]

    def _is_sound(self, part: Path) -> bool:
        """Return whether a part was written for this campaign; each is read once for it."""
        if part.name in self._sound:
            return True
        import pyarrow.parquet as pq

        # Its bytes first, so that nothing reads the structures of a damaged file.
        if part.stem.rpartition("-")[2] != compute_checksum(part.read_bytes()):
            return self.set_aside(part, "its bytes are not those that were written")
        try:
            metadata = pq.read_schema(part).metadata or {}
        except (OSError, ValueError) as error:
            return self.set_aside(part, f"it is no Parquet file: {error}")
        if metadata.get(b"campaign") != self.campaign.key.hex().encode():
            return self.set_aside(part, "it is of another campaign")
        self._sound.add(part.name)
        return True

    def set_aside(self, file: Path, reason: str) -> Literal[False]:
        """Move a file that cannot be counted into a folder of its own, and warn; return False."""
        aside = self.folder / ASIDE
        aside.mkdir(exist_ok=True)
        file.replace(aside / file.name)
        print_warnings(f"{file.name} is set aside, its runs are simulated again: {reason}")
        return False

    def list_done(self) -> NDArray[np.int64]:
        """Return the indices of the runs that are done, ascending."""
        import pyarrow.parquet as pq

        indices = [pq.read_table(part, columns=[INDEX])[INDEX].to_numpy() for part in self.parts]
        return np.unique(np.concatenate(indices)) if indices else np.zeros(0, np.int64)

    def list_missing(self, count: int) -> list[tuple[int, int]]:
        """Return the runs of the first `count` that are not done, as ranges [first, end)."""
        done = self.list_done()
        ends = np.concatenate([[-1], done[done < count], [count]])
        gaps = np.flatnonzero(np.diff(ends) > 1)
        return [(int(ends[gap]) + 1, int(ends[gap + 1])) for gap in gaps]

    def collect_table(self) -> Any:
        """Return all rows as a table of Arrow, by index."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        schema = make_schema(self.campaign)
        tables = [pq.read_table(part) for part in self.parts]
        table = pa.concat_tables(tables) if tables else schema.empty_table()
        _, places = np.unique(table[INDEX].to_numpy(), return_index=True)
        return table.take(places)

    def collect_columns(self) -> dict[str, NDArray[Any]]:
        """Return all columns by name (K,), by index."""
        table = self.collect_table()
        return {name: table[name].to_numpy() for name in table.column_names}


def compute_digest(columns: dict[str, NDArray[Any]]) -> str:
    """Return a hash of all rows, independent of their division into parts."""
    digest = hashlib.sha256()
    for name, values in columns.items():
        digest.update(f"{name}\0{len(values)}\0".encode())
        kind = np.int64 if values.dtype.kind in "ib" else np.float64
        digest.update(np.ascontiguousarray(values.astype(kind)).tobytes())
    return digest.hexdigest()


def divide_ranges(ranges: Iterable[tuple[int, int]], size: int) -> Iterable[tuple[int, int]]:
    """Yield ranges [first, end) of at most so many runs."""
    for first, end in ranges:
        for start in range(first, end, size):
            yield start, min(start + size, end)


_KEEPS = ("+", "-", "abs", "min", "max")  # operations whose result has the unit of their operands


def find_judged_units(campaign: Campaign) -> tuple[dict[str, str], dict[str, str]]:
    """Return the units of robustness and of measures, by name.

    "": a number, several units, or a function of Python.
    """
    units, where = list_signal_units(campaign.scene), campaign.where
    robustness = {}
    for name, text in campaign.requirements.items():
        unit = None
        if isinstance(text, str):
            formula = parse_formula(text, where, name)
            unit = find_formula_unit(bind_signals(formula, list(units), where, name), units)
        robustness[name] = unit or ""
    measures = {}
    for name, text in campaign.measures.items():
        measure = Measure(text, list(units), where, name)
        measures[name] = (
            _find_common_unit(find_expression_unit(each, units) for each in measure.of) or ""
        )
    return robustness, measures


def find_formula_unit(formula: Formula, units: Mapping[str, str]) -> str | None:
    """Return the unit of a formula's robustness; None: it has constants alone."""
    if isinstance(formula, Margin):
        return _find_common_unit(find_expression_unit(side, units) for side in formula.sides)
    return _find_common_unit(find_formula_unit(operand, units) for operand in formula.of)


def find_expression_unit(expression: Expression, units: Mapping[str, str]) -> str | None:
    """Return the unit of arithmetic; None: of a constant, which has any."""

    def find_unit(part: Expression, of: Sequence[str | None]) -> str | None:
        if isinstance(part, Constant):
            return None
        if isinstance(part, Signal):
            return units[part.name]
        if part.sign in _KEEPS:
            return _find_common_unit(of)
        if part.sign == "*":
            return of[0] if of[1] is None else of[1] if of[0] is None else ""
        if part.sign == "/" and of[1] is None:
            return of[0]
        return None if all(operand_unit is None for operand_unit in of) else ""

    return fold_expression(expression, find_unit)


def _find_common_unit(several: Iterable[str | None]) -> str | None:
    """Return the unit that all have which have one; "": they differ."""
    units = {unit for unit in several if unit is not None}
    return None if not units else units.pop() if len(units) == 1 else ""
