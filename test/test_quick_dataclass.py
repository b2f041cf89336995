"""Quick dataclasses behave as those of the standard library do, made of the same declarations."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from arm_emulator.base import quick_dataclass
from arm_emulator.machine.parts.dc_motor import DcMotor


def declared(dataclass: Callable[..., Any]) -> tuple[Any, Any]:
    """Return a class and one that inherits it."""

    @dataclass(frozen=True)
    class Base:
        name: str
        size: float = 1.0
        seen: list[int] = dataclasses.field(default_factory=list, compare=False, repr=False)
        twice: float = dataclasses.field(init=False)

        def __post_init__(self) -> None:
            object.__setattr__(self, "twice", 2.0 * self.size)

    @dataclass(frozen=True, kw_only=True)
    class More(Base):
        unit: str
        most: int = 3

    return Base, More


CALLS: list[Callable[[Any, Any], Any]] = [
    lambda base, more: base("a"),
    lambda base, more: base("a", 2.0, [1]),
    lambda base, more: base(size=2.0, name="a"),
    lambda base, more: more("a", unit="m"),
    lambda base, more: more("a", 3.0, unit="m", most=4),
    lambda base, more: base(),
    lambda base, more: base("a", name="b"),
    lambda base, more: base("a", 1.0, [], 2.0),
    lambda base, more: base("a", width=1.0),
    lambda base, more: base("a", twice=1.0),
    lambda base, more: more("a"),
    lambda base, more: more("a", 1.0, [], "m"),
    lambda base, more: dataclasses.replace(more("a", unit="m"), size=4.0),
    lambda base, more: dataclasses.asdict(more("a", unit="m")),
    lambda base, more: [one.name for one in dataclasses.fields(more)],
    lambda base, more: base("a") == base("a", seen=[1]),
    lambda base, more: base("a") == base("b") or base("a") == more("a", unit="m"),
    lambda base, more: hash(base("a")) == hash(base("a")) != hash(base("b")),
    lambda base, more: hash(base("a")) == hash(("a", 1.0, 2.0)),
    lambda base, more: setattr(base("a"), "name", "b"),
    lambda base, more: delattr(base("a"), "name"),
    lambda base, more: base("a").seen is base("b").seen,
    lambda base, more: copy.deepcopy(more("a", unit="m")) == more("a", unit="m"),
]


@pytest.mark.parametrize("call", CALLS, ids=range(len(CALLS)))
def test_a_call_gives_what_the_standard_library_gives(call: Callable[[Any, Any], Any]) -> None:
    got = []
    for dataclass in (dataclasses.dataclass, quick_dataclass.dataclass):
        try:
            got.append(repr(call(*declared(dataclass))))
        except Exception as error:
            got.append(type(error).__name__)
    assert got[0] == got[1]


def test_either_kind_may_inherit_the_other() -> None:
    for one, other in ((dataclasses, quick_dataclass), (quick_dataclass, dataclasses)):
        base, _ = declared(one.dataclass)  # type: ignore[attr-defined]

        @other.dataclass(frozen=True, kw_only=True)  # type: ignore[attr-defined]
        class Heir(base):  # type: ignore[misc, valid-type]
            most: int = 3

        assert repr(Heir("a")).endswith("Heir(name='a', size=1.0, twice=2.0, most=3)")


def test_a_part_is_pickled() -> None:
    part = DcMotor(resistance=1.0, torque_constant=0.1, back_emf_constant=0.1, rotor_inertia=1e-4)
    assert pickle.loads(pickle.dumps(part)) == part
