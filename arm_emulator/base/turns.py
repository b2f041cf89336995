"""Who may use a machine when: threads one after the other, and a forked child for itself.

A call on a machine takes its turn, so that two threads find it between two calls and never within
one. A fork waits until no call is under way: the child has a sound copy of every machine. Threads
are not copied, so what rests on threads is renewed there.
"""

from __future__ import annotations

import functools
import os
import threading
import weakref
from collections.abc import Callable
from typing import Concatenate, ParamSpec, TypeVar

_all: weakref.WeakSet[Turns] = weakref.WeakSet()
_held: list[Turns] = []  # while the process forks


class Turns:
    """What is called in turns.

    Attributes:
        turn: held while a call lasts.

    Args:
        shared: with which it takes turns, and which renews its threads; None: with nothing.
    """

    def __init__(self, shared: Turns | None = None) -> None:
        self.turn: threading.RLock = threading.RLock() if shared is None else shared.turn
        if shared is None:
            _all.add(self)

    def renew_threads(self) -> None:
        """Start anew what the parent's threads did; called in a forked child."""


This = TypeVar("This", bound=Turns)
Given = ParamSpec("Given")
Result = TypeVar("Result")


def in_turn(
    method: Callable[Concatenate[This, Given], Result],
) -> Callable[Concatenate[This, Given], Result]:
    """Return a method that takes its turn."""

    @functools.wraps(method)
    def call(self: This, *args: Given.args, **kwargs: Given.kwargs) -> Result:
        with self.turn:
            return method(self, *args, **kwargs)

    return call  # type: ignore[return-value]  # self can be given by position alone


def _before_fork() -> None:
    _held[:] = _all
    for one in _held:
        one.turn.acquire()


def _after_fork() -> None:
    while _held:
        _held.pop().turn.release()


def _in_child() -> None:
    machines = list(_held)
    _after_fork()
    for one in machines:
        one.renew_threads()


os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_in_child)
