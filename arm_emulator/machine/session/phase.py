"""Phases of a session."""

import enum


class Phase(enum.IntEnum):
    """Phase of the session; the values are those of EmulatorStatus."""

    FREE_RUNNING = 0
    WAITING = 1
    RUNNING = 2
    PAUSED = 3
    STOPPED = 4
