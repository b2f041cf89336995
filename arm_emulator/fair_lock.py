"""A lock that threads get in turn, however often one of them asks for it."""

from __future__ import annotations

import threading


class FairLock:
    """As `threading.RLock`, but who waits is next.

    A thread that lets an RLock go and asks for it again at once nearly always gets it, and another
    one that waits may wait for ever. Here a thread waits at the front of a queue of one, so that
    whoever comes back stands behind it.
    """

    def __init__(self) -> None:
        self._turn = threading.Lock()  # held by the thread that is next
        self._lock = threading.Lock()
        self._owner: int | None = None
        self._depth = 0

    def __enter__(self) -> None:
        me = threading.get_ident()
        if self._owner != me:
            with self._turn:
                self._lock.acquire()
            self._owner = me
        self._depth += 1

    def __exit__(self, *error: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._owner = None
            self._lock.release()
