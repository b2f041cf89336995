"""A machine at a tick as one row: true and measured values, with units."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.column import Column, Rows
from arm_emulator.base.synchronized import Synchronized, synchronized
from arm_emulator.machine.plant.call_arguments import make_truth
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.measured import Measured, list_rows
from arm_emulator.machine.plant.outputs import list_outputs, list_units
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import ROWS, find_unit
from arm_emulator.machine.scene.scene import Scene

STRUCTS = ("joint", "sensors", "imu")  # what `arm_measurement` has as structs


class RecordRow(Synchronized):
    """Buffer into which the core writes a row of a plant.

    Attributes:
        rows: one row, the newest.
        truth: as ``arm_truth``, with its places in the row.
        measurement: the same as ``arm_measurement``.

    Args:
        plant: the machine.
    """

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        self._plant = plant
        self.rows = rows = np.zeros(1, build_row_type(plant.scene))
        self.truth = make_truth(energy=rows["energy"], **{name: rows[name][0] for name in ROWS})
        places = {name: rows[name][0] for name in (*STRUCTS, "current_d", *list_rows(plant.scene))}
        self.measurement = ARM.make_struct("arm_measurement", **places)

    @synchronized
    def take_row(self) -> Rows:
        """Return the machine as it is now, one row."""
        plant, rows = self._plant, self.rows
        plant.core.arm_measure(plant.machine, self.measurement)
        plant.core.arm_get_truth(plant.machine, self.truth)
        rows["t"], rows["tick"] = self.truth.time, self.measurement.tick
        # As bytes: NumPy copies structs number by number.
        return np.frombuffer(bytearray(rows.tobytes()), rows.dtype)


def build_row_type(scene: Scene) -> np.dtype[np.void]:
    """Return a row as numpy has it: as tick/c/record_ring.h begins it, and then arrays."""
    N, M = len(scene.joints), len(scene.imus)
    counts = dict(zip(STRUCTS, (N, N, M), strict=True))
    kinds = {"joint": "joint_measurement", "sensors": "joint_sensors", "imu": "imu_measurement"}
    return np.dtype([
        ("t", "f8"), ("tick", "i8"), ("energy", "f8"),
        *[(name, "f8", (N,)) for name in ROWS],
        *[(name, ARM.get_dtype(f"arm_{kind}"), (counts[name],)) for name, kind in kinds.items()],
        ("current_d", "f8", (N,)),
        *[(array, "f8", (len(names), N)) for array, names in list_rows(scene).items()],
    ])  # fmt: skip


def view_measured(rows: Rows, scene: Scene) -> Measured:
    """Return what rows (K,) have of `Plant.measured`, (K, N) each."""
    return Measured(rows, list_rows(scene))


def list_columns(scene: Scene) -> list[Column]:
    """Return all numbers of a scene's rows."""
    joints = list(enumerate(scene.chain.joints))
    columns = [Column(("t",), "s", "t"), Column(("tick",), "", "tick")]
    columns.append(Column(("energy",), "J", "energy"))
    for name in ROWS:
        columns += [
            Column((name, joint.name), find_unit(name, joint.kind), name, "", (j,))
            for j, joint in joints
        ]
    arrays = list_rows(scene)
    for output in list_outputs(scene):
        array, _, member = output.symbol.partition(".")
        path = ("measured", output.name)
        if output.per_unit:
            columns += [
                Column((*path, imu.name, axis), output.unit, array, member, (m, k))
                for m, imu in enumerate(scene.imus)
                for k, axis in enumerate("xyz")
            ]
            continue
        row = (arrays[array].index(output.name),) if array in arrays else ()
        units = list_units(scene, output) or ("",) * len(joints)
        columns += [
            Column((*path, joint.name), units[j], array, member, (*row, j)) for j, joint in joints
        ]
    return columns


def select_values(rows: Rows, name: str, scene: Scene) -> NDArray[Any]:
    """Return a quantity of rows (K,): of the truth, or one as ``measured.current``."""
    group, _, output = name.partition(".")
    values: NDArray[Any] = getattr(view_measured(rows, scene), output) if output else rows[group]
    return values
