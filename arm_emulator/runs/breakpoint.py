"""Breakpoints on physics: a condition that is looked at at the end of each exchange, in C."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from arm_emulator.base.column import Column
from arm_emulator.base.formula import (
    Constant,
    Expression,
    Formula,
    Margin,
    Signal,
)
from arm_emulator.base.given import as_kind
from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import Header, Library
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.listeners import leave, listen
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.record_row import RecordRow
from arm_emulator.runs.condition import TOOL, Condition

BREAKPOINT = Header(BOUNDARY / "breakpoint.h")
_CODES = {
    "+": "ADD", "-": "SUBTRACT", "*": "MULTIPLY", "/": "DIVIDE", "abs": "ABS", "sqrt": "SQRT",
    "min": "LEAST", "max": "LARGEST", "and": "LEAST", "or": "LARGEST", "not": "NOT",
}  # fmt: skip
_KINDS = {"f8": "DOUBLE", "i8": "INT64", "u4": "UINT32"}
_DEEPEST = BREAKPOINT.constant("BREAKPOINT_DEEPEST")


@cache
def breakpoint_library() -> Library:
    """Return the compiled breakpoint.h, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return library(breakpoint_unit())


def breakpoint_unit() -> Unit:
    """Return breakpoint.h as what is compiled."""
    part, about = "breakpoint.c", "breakpoints"
    source, headers = f'#include "{part}"\n', (BREAKPOINT,)
    return Unit("breakpoint", source, C_FLAGS, (BOUNDARY,), headers, "breakpoint", about, part)


class Breakpoint:
    """A condition on a plant, looked at at the end of each exchange from now on.

    Attributes:
        condition: the condition.
        struct: ``breakpoint``, whose `hit` loops in C look at.

    Args:
        plant: the machine; no exchange may be under way.
        text: see `Condition`.
        where: for refusals.

    Raises:
        Refusal: see `Condition`; or it is nested too deeply.
    """

    def __init__(self, plant: Plant, text: str, where: str = "breakpoint") -> None:
        plant = as_kind(plant, Plant, where, "plant", "be a Plant")
        self.condition = condition = Condition(text, plant.scene, where)
        self._plant, self._row = plant, RecordRow(plant)
        steps = list(self._steps(condition.formula, condition.columns))
        if _depth(steps) > _DEEPEST:
            raise Refusal(where, "condition", f"need at most {_DEEPEST} values at a time", text)
        self._steps_ = BREAKPOINT.rows("breakpoint_step", max(1, len(steps)))
        for row, (code, offset, value) in zip(self._steps_, steps, strict=True):
            row["code"] = BREAKPOINT.constant(f"BREAKPOINT_{code}")
            row["offset"], row["value"] = offset, value
        self.struct = BREAKPOINT.new(
            "breakpoint",
            steps=len(steps),
            measure=plant.core.arm_measure,
            get_truth=plant.core.arm_get_truth,
            measurement=self._row.measurement,
            truth=self._row.truth,
            row=BREAKPOINT.ffi.cast("char *", BREAKPOINT.ffi.from_buffer(self._row.rows)),
            head=BREAKPOINT.ffi.cast("record_row *", BREAKPOINT.ffi.from_buffer(self._row.rows)),
            step=self._steps_,
            tick=-1,
        )
        self._put_tool()
        with plant.turn:  # it stops where it begins to hold
            self.struct.held = breakpoint_library().breakpoint_holds(self.struct, plant.machine)
            listen(plant, breakpoint_library().breakpoint_take, self.struct)

    def __repr__(self) -> str:
        return f"<Breakpoint {self.condition.text}>"

    @property
    def hit(self) -> bool:
        """Whether it began to hold and this has not been seen yet."""
        return bool(self.struct.hit)

    @property
    def tick(self) -> int:
        """Servo periods of the machine when it began to hold last; -1: never."""
        return int(self.struct.tick)

    @property
    def stop(self) -> Any:
        """Pointer to a flag by which loops stop."""
        return BREAKPOINT.ffi.addressof(self.struct, "hit")

    def take_hit(self) -> bool:
        """Return whether it has begun to hold since the last call."""
        hit, self.struct.hit = self.hit, 0
        return hit

    def close(self) -> None:
        """Look no more."""
        leave(self._plant, self.struct)

    def _place(self, column: Column) -> tuple[str, int, float]:
        rows = self._row.rows
        place = column.of(rows)
        base = rows.__array_interface__["data"][0]
        return _KINDS[place.dtype.str[1:]], place.__array_interface__["data"][0] - base, 0.0

    def _steps(
        self, what: Formula | Expression, columns: dict[str, Column]
    ) -> Iterator[tuple[str, int, float]]:
        """Yield operations on a stack: code, offset and value."""
        match what:
            case Constant(value=value):
                yield "CONSTANT", 0, value
            case Signal(name=name) if name in TOOL:
                yield "TOOL", TOOL.index(name), 0.0
            case Signal(name=name):
                yield self._place(columns[name])
            case Margin(of=of, strict=strict):
                yield from self._steps(of, columns)
                yield "ABOVE_0" if strict else "AT_LEAST_0", 0, 0.0
            case _:
                assert not isinstance(what, (Constant, Signal, Margin))
                parts: tuple[Formula | Expression, ...] = what.of
                yield from self._steps(parts[0], columns)
                code = _CODES[what.sign]
                for one in parts[1:]:
                    yield from self._steps(one, columns)
                    yield code, 0, 0.0
                if code in ("ABS", "SQRT", "NOT"):
                    yield code, 0, 0.0

    def _put_tool(self) -> None:
        chain, rows = self._plant.scene.chain, self._row.rows
        if self._plant.scene.tool not in chain.carried:
            return  # nor is there a condition on it
        last, frame = chain.place_of(self._plant.scene.tool)
        way = chain.way_to(last)[::-1]
        joints = BREAKPOINT.rows("breakpoint_joint", len(way))
        self._shares = np.ascontiguousarray(chain.coupling.C[way])
        q, shares = (one.__array_interface__["data"][0] for one in (rows["q"], self._shares))
        for row, place, share in zip(joints, way, range(len(way)), strict=True):
            link = chain.links[place]
            row["share"] = shares + share * self._shares.strides[0]
            row["q_0"] = chain.coupling.offset[place]
            for name in ("theta_0", "cos_alpha", "sin_alpha", "cos_gamma", "sin_gamma", "p"):
                row[name] = getattr(link, name)
            row["slides"] = link.kind == "prismatic"
        self._joints = joints
        BREAKPOINT.fill(self.struct, joint=joints, joints=len(way), drives=rows["q"].shape[1])
        self.struct.q = q - rows.__array_interface__["data"][0]
        self.struct.p = frame.p.tolist()
        self.struct.R = chain.R_BW.T.ravel().tolist()


def _depth(steps: list[tuple[str, int, float]]) -> int:
    """Return how many values are on the stack at most."""
    depth = deepest = 0
    for code, _, _ in steps:
        if code in ("CONSTANT", "TOOL", *_KINDS.values()):
            depth += 1
        elif code in ("ADD", "SUBTRACT", "MULTIPLY", "DIVIDE", "LEAST", "LARGEST"):
            depth -= 1
        deepest = max(deepest, depth)
    return deepest
