"""Measurements in messages, written and read by one list.

A message has fields of its own for some outputs, and readings by name for all others.
"""

from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.outputs import ALWAYS, KNOWN, list_reported_by_parts
from arm_emulator.machine.scene.scene import Scene


class MeasuredFields:
    """Places of measurements in the messages of a scene.

    Args:
        scene: the scene.
        types: of the message's fields, by name.

    Attributes:
        in_all: outputs with a field that is never empty.
        own: further ones with a field of their own.
        listed: those among the readings.
        absent: fields that are empty, for the scene has no such sensor.
    """

    def __init__(self, scene: Scene, types: Mapping[str, str]) -> None:
        self.in_all = tuple(output.name for output in ALWAYS if output.name in types)
        further = [part for part in list_reported_by_parts(scene) if part.name not in self.in_all]
        self.own: tuple[Output, ...] = tuple(output for output in further if output.name in types)
        self.listed = tuple(output.name for output in further if output.name not in types)
        self._names = (*self.in_all, *(output.name for output in self.own))
        self.absent = tuple(name for name in KNOWN if name in types and name not in self._names)
        self._types = types

    def size_message(self, message: Any, measured: Measured) -> None:
        """Give a message its names and the lengths of its arrays."""
        for name in self._names:
            kind = "d" if "double" in self._types[name] else "q"
            setattr(message, name, array(kind, getattr(measured, name).tobytes()))
        message.reading_names = list(self.listed)
        message.readings = array("d", self._join_readings(measured).tobytes())

    def fill_message(self, message: Any, measured: Measured) -> None:
        """Write measurements into a message with these lengths."""
        for name in self._names:
            getattr(message, name)[:] = getattr(measured, name).ravel()
        if self.listed:
            message.readings[:] = self._join_readings(measured)

    def list_places(self, measured: Measured) -> list[tuple[str, NDArray[Any]]]:
        """Return the views from which `fill_message` writes, with the fields of a message."""
        into = [(name, name) for name in self._names] + [("readings", name) for name in self.listed]
        return [(field, measured.place(KNOWN[name])) for field, name in into]

    def _join_readings(self, measured: Measured) -> NDArray[np.float64]:
        rows = [getattr(measured, name).astype(np.float64) for name in self.listed]
        return np.concatenate(rows) if rows else np.zeros(0)
