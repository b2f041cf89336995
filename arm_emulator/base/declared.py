"""Frozen dataclasses without code generated for each: quicker to import where there are many."""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import MISSING
from typing import Any, ClassVar, NoReturn, dataclass_transform


class _SignatureOfFields:
    """The keywords that a class takes, for `inspect.signature` and `help`; found when read."""

    def __get__(self, one: object, owner: type[Any]) -> inspect.Signature:
        if not dataclasses.is_dataclass(owner):
            raise AttributeError("__signature__")
        parameters = []
        for field in dataclasses.fields(owner):
            default = inspect.Parameter.empty if field.default is MISSING else field.default
            if field.default_factory is not MISSING:
                default = field.default_factory()
            kind = inspect.Parameter.KEYWORD_ONLY
            parameters.append(
                inspect.Parameter(field.name, kind, default=default, annotation=field.type)
            )
        return inspect.Signature(parameters)


@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(dataclasses.field,)
)
class Declared:
    """Base of classes that are frozen dataclasses with keywords, by what they inherit."""

    __signature__ = _SignatureOfFields()
    _fields: ClassVar[list[tuple[str, Any, Any]]]  # name, default and factory of each

    def __init_subclass__(cls) -> None:
        kind: Any = dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=True)(cls)
        fields = dataclasses.fields(kind)
        cls._fields = [(one.name, one.default, one.default_factory) for one in fields]

    def __init__(self, **given: Any) -> None:
        values = vars(self)
        for name, default, factory in self._fields:
            if name in given:
                values[name] = given.pop(name)
            elif default is not MISSING:
                values[name] = default
            elif factory is not MISSING:
                values[name] = factory()
            else:
                raise TypeError(f"{type(self).__name__} needs {name}")
        if given:
            raise TypeError(f"{type(self).__name__} has no {', '.join(given)}")

    def __eq__(self, other: object) -> bool:
        return self._values() == other._values() if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash((type(self), *self._values()))

    def __repr__(self) -> str:
        fields = zip(self._fields, self._values(), strict=True)
        values = ", ".join(f"{name}={value!r}" for (name, *_), value in fields)
        return f"{type(self).__qualname__}({values})"

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")

    def __delattr__(self, name: str) -> NoReturn:
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")

    def _values(self) -> list[Any]:
        return [vars(self)[name] for name, _, _ in self._fields]
