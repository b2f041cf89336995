"""Exclusive access to a machine: threads take turns, and a forked child gets a copy of its own.

Each call on a machine holds a lock, so that no thread sees a machine in the middle of a call. A
fork waits until no call is running: the child has a sound copy of every machine. Threads are not
copied; objects that depend on threads start them again in the child.
"""

from __future__ import annotations

import functools
import os
import threading
import weakref
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

_all: weakref.WeakSet[Synchronized] = weakref.WeakSet()
_acquired: list[Synchronized] = []  # while the process forks


class Synchronized:
    """An object whose methods take turns.

    Attributes:
        turn: lock, held during a call.

    Args:
        shared: object whose lock and renewal it shares; None: none.
    """

    def __init__(self, shared: Synchronized | None = None) -> None:
        self.turn: threading.RLock = threading.RLock() if shared is None else shared.turn
        if shared is None:
            _all.add(self)

    def restart_threads(self) -> None:
        """Restart the parent's threads; called in a forked child."""


This = TypeVar("This", bound=Synchronized)
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def synchronized(
    method: Callable[Concatenate[This, Arguments], Result],
) -> Callable[Concatenate[This, Arguments], Result]:
    """Return a method that holds the lock."""

    @functools.wraps(method)
    def call_locked(self: This, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with self.turn:
            return method(self, *args, **kwargs)

    return call_locked  # type: ignore[return-value]  # self can be given by position alone


def _acquire_all() -> None:
    _acquired[:] = _all
    for owner in _acquired:
        owner.turn.acquire()


def _release_all() -> None:
    while _acquired:
        _acquired.pop().turn.release()


def _restart_in_child() -> None:
    machines = list(_acquired)
    _release_all()
    for machine in machines:
        machine.restart_threads()


os.register_at_fork(
    before=_acquire_all, after_in_parent=_release_all, after_in_child=_restart_in_child
)
