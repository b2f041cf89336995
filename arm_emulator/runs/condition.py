"""Conditions on a machine as text, such as ``current.elbow > 20 and abs(v.waist) < 0.01``.

The language is that of requirements (`arm_emulator.base.expression.formula`), without its operators
over time.
"""

import numpy as np

from arm_emulator.base.column import Column
from arm_emulator.base.expression.formula import (
    Combined,
    Formula,
    Window,
    bind_signals,
    parse_formula,
)
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.coerce import coerce_kind
from arm_emulator.machine.plant.formula_rows import CONDITION, FormulaRows, formula_library
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.session.record_row import RecordRow, list_columns
from arm_emulator.machine.session.session import Session
from arm_emulator.machine.session.tool_chain import TOOL, ToolChain, list_tool_signals

_KINDS = {"f8": "DOUBLE", "i8": "INT64", "u4": "UINT32"}


class Condition:
    """A condition on the true state and the measurements of a machine.

    Signals are named as in records, such as ``q.elbow`` or ``measured.current.elbow``, and
    ``tool.x``; a comparison with a ``*`` holds if it holds for each signal that is meant.

    Attributes:
        text: the condition.
        formula: the same, over names of signals.

    Args:
        text: of comparisons, joined by ``and``, ``or``, ``not`` and ``implies``.
        scene: the machine.
        where: for refusals.

    Raises:
        Refusal: it states something else, or names signals that the machine has not.
    """

    def __init__(self, text: str, scene: Scene, where: str = "condition") -> None:
        if not isinstance(text, str):
            raise Refusal(where, "condition", "be text", text)
        scene = coerce_kind(scene, Scene, where, "scene", "be a Scene")
        self.text = text
        signals = [*(column.name for column in list_columns(scene)), *list_tool_signals(scene)]
        self.formula = bind_signals(
            parse_formula(text, where, "condition"), signals, where, "condition"
        )
        _check_without_time(self.formula, where)
        self._monitored: MonitoredCondition | None = None

    def __repr__(self) -> str:
        return f"<Condition {self.text}>"

    def holds(self, session: Session) -> bool:
        """Return whether it holds at the tick at which a session is."""
        plant = session.plant
        if self._monitored is None or self._monitored.plant is not plant:
            self._monitored = MonitoredCondition(self.formula, plant)
        return self._monitored.is_met()


class MonitoredCondition:
    """The formula of a condition over the row of a plant, see tick/c/condition.h.

    Attributes:
        plant: the machine.
        struct: ``condition``.

    Args:
        formula: over signals of the plant's scene, without windows.
        plant: see above.
    """

    def __init__(self, formula: Formula, plant: Plant) -> None:
        self.plant, self._record = plant, RecordRow(plant)
        self._columns = {column.name: column for column in list_columns(plant.scene)}
        self._inputs: list[tuple[str, int]] = []
        self._rows = FormulaRows(self._add_signal)
        self._rows.add_formula(formula)  # whose row is the last one
        inputs = CONDITION.make_rows("condition_input", max(1, len(self._inputs)))
        for row, (kind, offset) in zip(inputs, self._inputs, strict=False):
            row["kind"], row["offset"] = CONDITION.get_constant(f"CONDITION_{kind}"), offset
        rows, values = self._rows.make_struct(), np.zeros(len(self._rows))
        record, ffi = self._record.rows, CONDITION.ffi
        self._owned = rows, values, inputs
        self.struct = CONDITION.make_struct(
            "condition",
            rows=len(self._rows),
            row=rows,
            input=inputs,
            values=values,
            measure=plant.core.arm_measure,
            get_truth=plant.core.arm_get_truth,
            measurement=self._record.measurement,
            truth=self._record.truth,
            record=ffi.cast("char *", ffi.from_buffer(record)),
            head=ffi.cast("record_row *", ffi.from_buffer(record)),
            q=self._compute_offset(record["q"]),
        )
        if any(kind == "TOOL" for kind, _ in self._inputs):
            self._tool = ToolChain(plant.scene, plant.parameters)
            self.struct.tool = self._tool.struct

    def is_met(self) -> bool:
        """Return whether it holds for the plant as it is now."""
        with self.plant.turn:
            return bool(formula_library().condition_holds(self.struct, self.plant.machine))

    def _add_signal(self, name: str) -> int:
        if name in TOOL:
            source = "TOOL", TOOL.index(name)
        else:
            source = self._find_place(self._columns[name])
        if source not in self._inputs:
            self._inputs.append(source)
        return self._rows.add_input(self._inputs.index(source))

    def _find_place(self, column: Column) -> tuple[str, int]:
        place = column.select_values(self._record.rows)
        return _KINDS[place.dtype.str[1:]], self._compute_offset(place)

    def _compute_offset(self, place: np.ndarray) -> int:
        base: int = self._record.rows.__array_interface__["data"][0]
        return int(place.__array_interface__["data"][0]) - base


def _check_without_time(formula: Formula, where: str) -> None:
    if isinstance(formula, Window):
        rule = "be about one moment, without always, eventually and until"
        raise Refusal(where, "condition", rule, formula.sign)
    for part in formula.of if isinstance(formula, Combined) else ():
        _check_without_time(part, where)
