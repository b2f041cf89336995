"""Objects saved in memory, and restored."""

from __future__ import annotations

import io
import pickle
from dataclasses import dataclass, field
from typing import Any

from arm_emulator.base.refusal import Refusal


class SharedObject:
    """Mixin of objects that no motion changes: constants, and scratch memory of algorithms.

    What is saved refers to them, and what is restored has the same ones.
    """


@dataclass(frozen=True)
class Saved:
    """Objects at one moment."""

    data: bytes = field(repr=False)
    owner: SavedObjects = field(repr=False)

    def __len__(self) -> int:
        return len(self.data)


class SavedObjects:
    """Saves objects, all but the `SharedObject` ones among their parts, and restores them."""

    def __init__(self) -> None:
        self._shared: dict[int, SharedObject] = {}

    def copy_objects(self, objects: Any) -> Saved:
        """Return the objects as they are now."""
        into = io.BytesIO()
        _Pickler(into, self._shared).dump(objects)
        return Saved(into.getvalue(), self)

    def restore_objects(self, saved: Saved, where: str) -> Any:
        """Return copies of the objects as they were.

        Raises:
            Refusal: something else; `where` names the caller.
        """
        if not isinstance(saved, Saved) or saved.owner is not self:
            raise Refusal(where, "saved", "be what `save` of the same run returned", saved)
        return _Unpickler(io.BytesIO(saved.data), self._shared).load()


class _Pickler(pickle.Pickler):
    def __init__(self, into: io.BytesIO, shared: dict[int, SharedObject]) -> None:
        super().__init__(into, pickle.HIGHEST_PROTOCOL)
        self._shared = shared

    def persistent_id(self, value: Any) -> int | None:
        if not isinstance(value, SharedObject):
            return None
        self._shared[id(value)] = value
        return id(value)


class _Unpickler(pickle.Unpickler):
    def __init__(self, source: io.BytesIO, shared: dict[int, SharedObject]) -> None:
        super().__init__(source)
        self._shared = shared

    def persistent_load(self, number: int) -> SharedObject:
        return self._shared[number]
