"""The kinds of faults: those of parts, and those in the files of this package."""

import importlib
import pkgutil
from collections.abc import Iterator

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine import faults
from arm_emulator.machine.parts.fault import Fault
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.registry import list_kinds


def _list_declared() -> Iterator[Fault]:
    for info in pkgutil.iter_modules(faults.__path__):
        module = importlib.import_module(f"{faults.__name__}.{info.name}")
        yield from getattr(module, "FAULTS", ())
    for kind in list_kinds(Part):
        yield from kind.list_faults()


def _list_kinds() -> tuple[Fault, ...]:
    """Return all kinds, by their names."""
    by_name: dict[str, Fault] = {}
    for fault in _list_declared():
        if by_name.setdefault(fault.name, fault) != fault:
            raise Refusal("faults", f"fault {fault.name}", "have one meaning", fault.text)
    return tuple(sorted(by_name.values(), key=lambda fault: fault.name))


FAULTS = _list_kinds()
