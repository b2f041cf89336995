"""Real-time priority for the threads of a node that take and publish messages."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path

PRIORITY = 10  # of SCHED_FIFO: ahead of all usual processes, behind the core's own threads (50)
MIDDLEWARE = "dds."  # names of Fast DDS's threads begin so


def go_ahead_of_others() -> bool:
    """Run the threads of Python and of the middleware under SCHED_FIFO; processes do not inherit it.

    All threads of Python share its lock: one that is behind other processes and keeps the lock
    would hold up those that carry messages.

    Returns:
        Whether the system permits it.
    """
    threads = [one.native_id for one in threading.enumerate()]
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has just ended
            if (task / "comm").read_text().startswith(MIDDLEWARE):
                threads.append(int(task.name))
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        for thread in threads:
            with contextlib.suppress(ProcessLookupError):
                os.sched_setscheduler(thread or 0, policy, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True
