"""Objects that refuse attributes that they do not have: a misspelt one is no new one."""

from __future__ import annotations

import difflib
from typing import Any

from arm_emulator.base.refusal import Refusal


class NoAttribute(Refusal, AttributeError):
    """An attribute is set that the object does not have."""


class _Closing(type):
    """Closes an object when its construction has ended, that of subclasses included."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        made = super().__call__(*arguments, **named)
        made.close_attributes()
        return made


class Closed(metaclass=_Closing):
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
            known = [one for one in dir(self) if one[0] != "_"]
            what = type(self).__name__
            near = difflib.get_close_matches(name, known) or known
            raise NoAttribute(what, "attribute", "be known", name, ", ".join(near))
        object.__setattr__(self, name, value)
