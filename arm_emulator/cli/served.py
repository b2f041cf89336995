"""A machine that a command serves to a client: its clock, what is kept of it, its page."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from arm_emulator.base.kept import Kept
from arm_emulator.base.warning import warn
from arm_emulator.machine.real_time import real_time_session
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.session import Session
from arm_emulator.page.desk import watched
from arm_emulator.runs.recorder import Recorder


@contextmanager
def served_session(scene: Scene, clock: str, kept: Kept, page: str | None) -> Iterator[Session]:
    """Context in which a session that waits for its first answer is recorded and watched.

    Args:
        scene: of the machine.
        clock: "realtime", or another one, in which ticks wait for their answers.
        kept: records of it.
        page: address of its page in the browser, if any.
    """
    warn(*scene.warnings)
    waits = clock != "realtime"
    if waits:
        session = Session(scene, "lockstep", "first_answer")
    else:
        session = real_time_session(scene, "first_answer")
    with session, Recorder(session.plant, kept, waits), watched(session, page):
        yield session
