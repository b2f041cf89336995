"""Arrays of all arms of a fleet that a step fills in place."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.closed import Closed
from arm_emulator.machine.chain import Array
from arm_emulator.machine.core_calls import FLEET, PLACES
from arm_emulator.machine.measured import Measured, MeasuredPlace
from arm_emulator.machine.outputs import outputs_of
from arm_emulator.machine.scene import Scene


class FleetFrame(Closed):
    """Measured and true values of all arms after a step.

    The arrays are reused in every step; copy them to keep values.

    Attributes:
        of: scene and count.
        measured: what the sensors give, as `Fleet.measured`, in place.
        powered: whether the drives have power (count,).
        faults: the joint at which each arm diverged (count,); -1: it goes on.
        t: logical time (count,) [s].
        current: (count, N) [A].
        theta_m: motor angle (count, N) [rad].
        omega_m: motor speed (count, N) [rad/s].
        q: link side (count, N) [rad or m].
        v: link side (count, N) [rad/s or m/s].

    Args:
        scene: of the fleet.
        count: of arms.
    """

    def __init__(self, scene: Scene, count: int) -> None:
        self.of = scene, count
        shape = count, len(scene.joints)
        place = MeasuredPlace(scene, count)
        self.measured: Measured = place.view()
        self.faults: NDArray[np.int32] = np.full(count, -1, np.int32)
        self.t: Array = np.zeros(count)
        self.current: Array = np.zeros(shape)
        self.theta_m: Array = np.zeros(shape)
        self.omega_m: Array = np.zeros(shape)
        self.q: Array = np.zeros(shape)
        self.v: Array = np.zeros(shape)
        powered = np.ones(count, np.uint8)
        self.powered: NDArray[np.bool_] = powered.view(np.bool_)
        names = ("t", "current", "theta_m", "omega_m", "q", "v")
        places = {PLACES.get(name, name): getattr(self, name) for name in names}
        self._rows = (*places.values(), self.faults, self.powered, *place.arrays.values())
        # For the core.
        # Outputs that the scene does not have stay 0.
        there = {one.symbol.partition(".")[0] for one in outputs_of(scene)}
        arrays = {name: rows for name, rows in place.arrays.items() if name in there}
        self.measurement = FLEET.new("arm_fleet_measurement", powered=powered, **arrays)
        self.truth = FLEET.new("arm_fleet_truth", fault=self.faults, **places)

    def __reduce__(self) -> tuple[Any, ...]:
        return FleetFrame, self.of, self.__getstate__()

    def __getstate__(self) -> list[NDArray[Any]]:
        return [rows.copy() for rows in self._rows]

    def __setstate__(self, rows: list[NDArray[Any]]) -> None:
        for own, given in zip(self._rows, rows, strict=True):
            own[...] = given

    def __repr__(self) -> str:
        return f"<FleetFrame of {self.of[1]} {self.of[0].name}>"
