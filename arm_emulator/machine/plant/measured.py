"""Measurement of the drive electronics at one tick."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.machine.parts.output import FURTHER, READINGS, Output
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.inputs import list_further_inputs
from arm_emulator.machine.plant.outputs import KNOWN, find_output_input, list_outputs, list_readings
from arm_emulator.machine.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Measured(ArrayEquality):
    """Measurements of one tick: an attribute for each of `outputs.KNOWN`.

    Arrays are (N,), base to tool, 0 where a joint has no such sensor; those of inertial measurement
    units are (M, 3). Of a fleet they are (count, N) and (count, M, 3).

    Args:
        arrays: of ``arm_measurement``, by their names there, as one record.
        rows: names of the outputs that are rows of readings, and of further inputs.
    """

    arrays: NDArray[np.void]
    rows: dict[str, tuple[str, ...]]

    def __getattr__(self, name: str) -> NDArray[Any]:
        values = self.find(name)
        return values.astype(np.int64) if values.dtype.kind == "u" else values

    def find(self, name: str) -> NDArray[Any]:
        """Return an output by its name, as a view of the arrays.

        Raises:
            AttributeError: there is no such output.
        """
        output = KNOWN.get(name)
        if output is None:
            raise AttributeError(f"Measured has no {name}", name=name, obj=self)
        return self.place(output)

    def place(self, output: Output) -> NDArray[Any]:
        """Return an output as a view of the arrays."""
        array, _, field = output.symbol.partition(".")
        rows = self.rows.get(array)
        if rows is not None and output.name not in rows:
            return np.zeros(self.arrays["joint"].shape)
        values = self.arrays[array]
        if rows is not None:
            return values[..., rows.index(output.name), :]
        return values[field] if field else values

    def __repr__(self) -> str:
        values = (
            f"{name}={getattr(self, name).tolist()}" for name in ("encoder_counts", "current")
        )
        return f"<Measured {', '.join(values)}, ...>"

    def __dir__(self) -> list[str]:
        return sorted((*super().__dir__(), *KNOWN))


class MeasuredPlace:
    """Arrays into which the core writes measurements.

    Attributes:
        arrays: by their names in ``arm_measurement``.

    Args:
        scene: of the machine.
        arms: how many of a fleet; nothing for one machine.
    """

    def __init__(self, scene: Scene, *arms: int) -> None:
        N, M = len(scene.joints), len(scene.imus)
        self._rows = list_rows(scene)
        kinds = {
            "joint": (ARM.get_dtype("arm_joint_measurement"), (*arms, N)),
            "sensors": (ARM.get_dtype("arm_joint_sensors"), (*arms, N)),
            "imu": (ARM.get_dtype("arm_imu_measurement"), (*arms, M)),
            "current_d": ("f8", (*arms, N)),
            **{array: ("f8", (*arms, len(rows), N)) for array, rows in self._rows.items()},
        }
        # One record, copied as bytes: NumPy copies structs number by number.
        self._type = np.dtype([(name, *kind) for name, kind in kinds.items()])
        self._bytes = np.zeros(self._type.itemsize, np.uint8)
        self._record = np.ndarray((), self._type, self._bytes.data)
        self.arrays: dict[str, NDArray[Any]] = {name: self._record[name] for name in kinds}
        self.joints = self.arrays["joint"]

    def read_values(self) -> Measured:
        """Return the present values, as a copy."""
        return Measured(np.ndarray((), self._type, self._bytes.copy().data), self._rows)

    def make_view(self) -> Measured:
        """Return a view of the arrays."""
        return Measured(self._record, self._rows)


def list_rows(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the outputs that are rows of an array, by its name in ``arm_measurement``."""
    of = {
        find_output_input(scene, output): output.name
        for output in list_outputs(scene)
        if output.symbol == FURTHER
    }
    return {
        READINGS: tuple(output.name for output in list_readings(scene)),
        FURTHER: tuple(of[name] for name in list_further_inputs(scene)),
    }
