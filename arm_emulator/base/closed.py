"""Objects that name the nearest of their attributes for an unknown one, or refuse to be copied."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

from arm_emulator.base.refusal import Refusal


class NoAttribute(Refusal, AttributeError):
    """An attribute is read or set that the object does not have.

    Its line, with the search for what was meant, is made when it is read: programs that ask
    whether an attribute is there read none.

    Args:
        name: of the attribute.
        obj: the object.
    """

    if not TYPE_CHECKING:
        __init__ = AttributeError.__init__  # which is quick, and keeps both

    else:

        def __init__(self, *, name: str, obj: object) -> None: ...

    def __str__(self) -> str:
        return str(self._refusal())

    def __reduce__(self) -> tuple[Any, ...]:
        return AttributeError, (str(self),)  # without the object

    def __getattr__(self, name: str) -> Any:
        if name in ("where", "quantity", "rule", "got", "valid"):
            return getattr(self._refusal(), name)
        raise AttributeError(name)

    def _refusal(self) -> Refusal:
        name, known = self.name or "", [one for one in dir(self.obj) if one[0] != "_"]
        places = getattr(type(self.obj), "_inside", {})
        inside = [f"{at}.{name}" for at, names in places.items() if name in names]
        near = inside or difflib.get_close_matches(name, known) or known
        where = type(self.obj).__name__
        return Refusal(where, "attribute", "be known", name, ", ".join(near))


class Known:
    """An object that names the nearest of its attributes where an unknown one is read."""

    # Names that some of its attributes have, by those attributes: where to find them.
    _inside: ClassVar[Mapping[str, Iterable[str]]] = {}

    if not TYPE_CHECKING:  # which finds them by itself

        def __getattr__(self, name: str) -> Any:
            if name[0] == "_" or hasattr(type(self), name):
                # Of Python's own protocols; or a property that has failed, which fails again.
                return object.__getattribute__(self, name)
            raise NoAttribute(name=name, obj=self)


class Closed(Known):
    """An object whose public attributes are those that it has after its construction."""

    def __init_subclass__(cls, **named: Any) -> None:
        super().__init_subclass__(**named)
        construct = vars(cls).get("__init__")
        if construct is None:
            return

        @functools.wraps(construct)
        def construct_and_close(self: Closed, *arguments: Any, **named: Any) -> None:
            construct(self, *arguments, **named)
            # A subclass goes on after this, and closes the object at its own end.
            if type(self).__init__ is construct_and_close:
                self.close_attributes()

        cls.__init__ = construct_and_close  # type: ignore[method-assign, assignment]

    def close_attributes(self) -> None:
        """Refuse new attributes from here on; for what makes an object without its construction."""
        self.__dict__["_closed"] = True

    def __setattr__(self, name: str, value: object) -> None:
        own = self.__dict__
        if name in own:
            own[name] = value
            return
        if "_closed" in own and name[0] != "_" and not hasattr(type(self), name):
            raise NoAttribute(name=name, obj=self)
        object.__setattr__(self, name, value)


class Uncopied:
    """Mixin that refuses `copy`, `deepcopy` and `pickle`.

    Attributes:
        instead: replaces a copy, for refusals.
    """

    instead: ClassVar[str]

    def __reduce_ex__(self, protocol: Any) -> NoReturn:
        raise Refusal(type(self).__name__, "the object", "stay one", "a copy", self.instead)
