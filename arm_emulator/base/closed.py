"""Objects that refuse attributes that they do not have, and name the nearest that they have."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from arm_emulator.base.refusal import Refusal


class NoAttribute(Refusal, AttributeError):
    """An attribute is read or set that the object does not have."""


class Known:
    """An object that names the nearest of its attributes where an unknown one is read."""

    # Names that some of its attributes have, by those attributes: where to find them.
    _inside: ClassVar[Mapping[str, Iterable[str]]] = {}

    if not TYPE_CHECKING:  # which finds them by itself

        def __getattr__(self, name: str) -> Any:
            if name[0] == "_" or hasattr(type(self), name):
                # Of Python's own protocols; or a property that has failed, which fails again.
                return object.__getattribute__(self, name)
            raise self._unknown(name)

    def _unknown(self, name: str) -> NoAttribute:
        """Return the refusal of an attribute."""
        known = [one for one in dir(self) if one[0] != "_"]
        inside = [f"{at}.{name}" for at, names in self._inside.items() if name in names]
        near = inside or difflib.get_close_matches(name, known) or known
        return NoAttribute(type(self).__name__, "attribute", "be known", name, ", ".join(near))


class _Closing(type):
    """Closes an object when its construction has ended, that of subclasses included."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        made = super().__call__(*arguments, **named)
        made.close_attributes()
        return made


class Closed(Known, metaclass=_Closing):
    """An object whose public attributes are those that it has after its construction."""

    def close_attributes(self) -> None:
        """Refuse new attributes from here on; for what makes an object without its construction."""
        self.__dict__["_closed"] = True

    def __setattr__(self, name: str, value: object) -> None:
        own = self.__dict__
        if name in own:
            own[name] = value
            return
        if "_closed" in own and name[0] != "_" and not hasattr(type(self), name):
            raise self._unknown(name)
        object.__setattr__(self, name, value)
