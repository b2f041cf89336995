"""Frozen dataclasses whose making takes a quarter of the time.

`dataclasses.dataclass` writes each method of each class as text and compiles it: 0.5 ms a class, at
every start. These share methods that go through the fields. Making an object takes longer, which
does not matter for what is made once per part of a scene; the same classes otherwise, for
`dataclasses.fields` and `replace`, for pickle and copy, for type checkers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(*, frozen: bool, kw_only: bool = False) -> Callable[[type], type]:
        """Return what makes a class with fields, as `dataclasses.dataclass(frozen=True)` does."""

        def made(kind: type) -> type:
            for name, method in _METHODS.items():
                if name not in kind.__dict__:
                    setattr(kind, name, method)
            return dataclasses.dataclass(
                init=False, repr=False, eq=False, frozen=frozen, kw_only=kw_only
            )(kind)

        return made


def _init(self: Any, *args: Any, **given: Any) -> None:
    fields = [one for one in dataclasses.fields(self) if one.init]
    places = [one.name for one in fields if not one.kw_only]
    if len(args) > len(places):
        raise TypeError(f"{type(self).__name__}: at most {len(places)} arguments without a name")
    for name, value in zip(places, args, strict=False):
        if name in given:
            raise TypeError(f"{type(self).__name__}: {name} is given twice")
        given[name] = value
    values = self.__dict__
    for one in fields:
        if one.name in given:
            values[one.name] = given.pop(one.name)
        elif one.default_factory is not dataclasses.MISSING:
            values[one.name] = one.default_factory()
        elif one.default is not dataclasses.MISSING:
            values[one.name] = one.default
        else:
            raise TypeError(f"{type(self).__name__}: {one.name} is missing")
    if given:
        raise TypeError(f"{type(self).__name__}: there is no {', '.join(given)}")
    if prepare := getattr(self, "__post_init__", None):
        prepare()


def _compared(self: Any) -> tuple[Any, ...]:
    return tuple(getattr(self, one.name) for one in dataclasses.fields(self) if one.compare)


def _eq(self: Any, other: object) -> Any:
    return _compared(self) == _compared(other) if type(other) is type(self) else NotImplemented


def _hash(self: Any) -> int:
    return hash(_compared(self))


def _repr(self: Any) -> str:
    shown = [one.name for one in dataclasses.fields(self) if one.repr]
    values = ", ".join(f"{name}={getattr(self, name)!r}" for name in shown)
    return f"{type(self).__qualname__}({values})"


_METHODS: dict[str, Callable[..., Any]] = {
    "__init__": _init,
    "__eq__": _eq,
    "__hash__": _hash,
    "__repr__": _repr,
}
