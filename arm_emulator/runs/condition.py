"""Conditions on a machine as text, such as ``current.elbow > 20 and abs(v.waist) < 0.01``.

The language is that of requirements (`arm_emulator.base.formula`), without its operators over time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from arm_emulator.base.bound_formula import bound_to, signals_in
from arm_emulator.base.column import Column, Rows
from arm_emulator.base.formula import (
    Combined,
    Constant,
    Expression,
    Formula,
    Margin,
    Signal,
    Window,
    parse_formula,
)
from arm_emulator.base.given import as_kind
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.record_row import RecordRow, columns_of
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.session import Session
from arm_emulator.motion.kinematics import Kinematics

TOOL = ("tool.x", "tool.y", "tool.z")  # position in the world [m]


class Condition:
    """A condition on the true state and the measurements of a machine.

    Signals are named as in records, such as ``q.elbow`` or ``measured.current.elbow``, and
    ``tool.x``; a comparison with a ``*`` holds if it holds for each signal that is meant.

    Attributes:
        text: the condition.
        formula: the same, over names of signals.
        columns: all signals but those of the tool, by name.

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
        scene = as_kind(scene, Scene, where, "scene", "be a Scene")
        self.text = text
        self.columns = {one.name: one for one in columns_of(scene)}
        known = [*self.columns, *(TOOL if scene.tool in scene.chain.carried else ())]
        self.formula = bound_to(parse_formula(text, where, "condition"), known, where, "condition")
        _check_without_time(self.formula, where)
        names = signals_in(self.formula)
        self._own: list[Column] = [self.columns[name] for name in names if name not in TOOL]
        self._kinematics = (
            Kinematics(scene.urdf, scene.joint_names, scene.tool)
            if names.intersection(TOOL)
            else None
        )
        self._row: RecordRow | None = None
        self._session: Session | None = None

    def __repr__(self) -> str:
        return f"<Condition {self.text}>"

    def holds(self, session: Session) -> bool:
        """Return whether it holds at the tick at which a session is."""
        if self._row is None or self._session is not session:
            self._row, self._session = RecordRow(session.plant), session
        return _holds(self.formula, self._values(self._row.take(), session))

    def _values(self, rows: Rows, session: Session) -> dict[str, float]:
        values = {one.name: float(one.of(rows)[0]) for one in self._own}
        if self._kinematics is not None:
            p_WT = self._kinematics.forward(session.state.q)[1]
            values |= dict(zip(TOOL, p_WT.tolist(), strict=True))
        return values


def _check_without_time(what: Formula, where: str) -> None:
    if isinstance(what, Window):
        rule = "be about one moment, without always, eventually and until"
        raise Refusal(where, "condition", rule, what.sign)
    for one in what.of if isinstance(what, Combined) else ():
        _check_without_time(one, where)


def _holds(what: Formula, values: Mapping[str, float]) -> bool:
    if isinstance(what, Margin):
        margin = _value(what.of, values)
        return margin > 0.0 or (margin == 0.0 and not what.strict)
    assert isinstance(what, Combined)
    if what.sign == "not":
        return not _holds(what.of[0], values)
    each = (_holds(one, values) for one in what.of)
    return all(each) if what.sign == "and" else any(each)


def _value(what: Expression, values: Mapping[str, float]) -> float:
    if isinstance(what, Constant):
        return what.value
    if isinstance(what, Signal):
        return values[what.name]
    of = [_value(one, values) for one in what.of]
    match what.sign:
        case "+":
            return of[0] + of[1]
        case "-":
            # Two infinities have no distance; no comparison of them holds strictly.
            return 0.0 if of[0] == of[1] else of[0] - of[1]
        case "*":
            return of[0] * of[1]
        case "/":
            return of[0] / of[1] if of[1] else math.nan
        case "abs":
            return abs(of[0])
        case "sqrt":
            return math.sqrt(of[0]) if of[0] >= 0.0 else math.nan
        case "min":
            return min(of)
        case _:
            return max(of)
