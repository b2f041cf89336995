"""Listeners of a machine: code in C that is called at the end of each exchange."""

import weakref
from typing import Any

from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.record_ring import LISTENERS, record_ring
from arm_emulator.toolchain.c_header import NULL

_all: weakref.WeakKeyDictionary[Plant, Any] = weakref.WeakKeyDictionary()


def add_listener(plant: Plant, call: Any, with_: Any) -> None:
    """Let a function in C be called at the end of each exchange, after those that listen already.

    Args:
        plant: the machine; no exchange may be under way.
        call: ``void (*)(void* with, const arm_machine* machine)``.
        with_: its first argument, which must outlive its listening.
    """
    with plant.turn:
        if plant not in _all:
            _all[plant] = LISTENERS.make_struct("listeners")
        every = _all[plant]
        added = record_ring().listeners_add(every, call, with_)
        assert added, "a machine has few listeners"
        plant.core.arm_listen(plant.machine, record_ring().listeners_call, every)


def remove_listener(plant: Plant, with_: Any) -> None:
    """End the listening of what is called with `with_`."""
    with plant.turn:
        every = _all.get(plant)
        if every is None:
            return
        record_ring().listeners_remove(every, with_)
        if not every.count:
            plant.core.arm_listen(plant.machine, NULL, NULL)
