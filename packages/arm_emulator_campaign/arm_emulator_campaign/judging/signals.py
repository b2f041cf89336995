"""Signals of a run by name: true values, measurements, and quantities that follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array
from arm_emulator.extension.compiler import (
    BOUNDARY_FOLDER,
    C_FLAGS,
    C_NULL,
    CData,
    Header,
    Unit,
    c_pointer,
    compile_once,
)
from arm_emulator.extension.machine import (
    STATE_NAMES_IN_C,
    TOOL_SIGNALS_NAME,
    MeasuredPlace,
    Plant,
    RecordRow,
    Scene,
    ToolChain,
    list_columns,
    list_tool_signals,
    make_truth,
)
from arm_emulator_campaign.judging.requirement import C_FOLDER
from arm_emulator_fleet import Fleet
from arm_emulator_fleet.unit import FLEET
from arm_emulator_fleet.unit import FOLDER as FLEET_FOLDER

SAMPLER = Header(C_FOLDER / "sampler.h", (BOUNDARY_FOLDER, FLEET_FOLDER))
_KINDS = {"f8": "DOUBLE", "i8": "INT64", "u4": "UINT32"}


def sampler_unit() -> Unit:
    """Return the sources of the sampler."""
    part = "sampler.c"
    source, about = f'#include "{part}"\n', "the samples of campaigns"
    folders = C_FOLDER, BOUNDARY_FOLDER, FLEET_FOLDER
    return Unit("sampler", source, C_FLAGS, folders, (SAMPLER,), "campaign", about, part)


_sampler = compile_once(sampler_unit)


def list_signal_units(scene: Scene) -> dict[str, str]:
    """Return the names of all signals of a scene, with their units."""
    columns = {column.name: column.unit for column in list_columns(scene)}
    units = {joint: columns[f"q.{joint}"] for joint in scene.joint_names}
    columns |= {f"target.{joint}": unit for joint, unit in units.items()}
    columns |= {f"error.{joint}": unit for joint, unit in units.items()}
    return columns | dict.fromkeys(list_tool_signals(scene), "m")


def has_tool_signals(names: Sequence[str]) -> bool:
    """Return whether positions of the tool are among signals: `Samples` computes them."""
    return any(name in TOOL_SIGNALS_NAME for name in names)


class Samples:
    """Numbers of machines at every tick.

    Attributes:
        room: for so many samples of each machine.

    Args:
        scene: the machine.
        names: of signals, in the order of their rows.
        arms: how many machines.
        room: see above.
    """

    def __init__(self, scene: Scene, names: Sequence[str], arms: int, room: int) -> None:
        self.room = room
        columns = list(names)
        self._tool = {
            columns.index(name): place
            for place, name in enumerate(TOOL_SIGNALS_NAME)
            if name in columns
        }
        self._scene, self._chains = scene, [ToolChain(scene)] if self._tool else []
        if self._tool:
            columns += [q for joint in scene.joint_names if (q := f"q.{joint}") not in columns]
        self._q = [columns.index(f"q.{joint}") for joint in scene.joint_names if self._tool]
        own = {column.name: column for column in list_columns(scene)}
        self._columns = {
            place: own[name] for place, name in enumerate(columns) if name not in TOOL_SIGNALS_NAME
        }
        kinds = {value.path[0] for value in self._columns.values()}
        self.measures, self.truth = "measured" in kinds, kinds - {"measured"}
        self._samples = np.zeros((arms, max(1, len(columns)), room))
        self._taken = np.zeros(arms, np.int64)
        self.calls = _sampler()

    def make_sampler(
        self, rows: Mapping[str, NDArray[Any]] | NDArray[np.void], **more: Any
    ) -> CData:
        """Return the struct of a sampler that reads from rows, one of each machine."""
        self._numbers = SAMPLER.make_rows("sampler_number", max(1, len(self._columns)))
        for number, (row, column) in zip(self._numbers, self._columns.items(), strict=False):
            place = column.select_values(rows)  # type: ignore[arg-type]
            number["place"] = place.__array_interface__["data"][0]
            number["stride"] = place.strides[0]
            number["kind"] = SAMPLER.get_constant(f"SAMPLER_{_KINDS[place.dtype.str[1:]]}")
            number["row"] = row
        return SAMPLER.make_struct(
            "sampler",
            count=len(self._columns),
            rows=self._samples.shape[1],
            numbers=SAMPLER.make_pointer("sampler_number", self._numbers),
            samples=c_pointer(self._samples),
            room=self.room,
            taken=self._taken,
            **more,
        )

    def place_joints(self, numbers: Array) -> None:
        """Let tools be where joints stand by varied numbers of machines (arms, P)."""
        names = [number.name for number in self._scene.varied]
        if self._tool and any(name.startswith("calibration.") for name in names):
            rows = (dict(zip(names, map(float, row), strict=True)) for row in numbers)
            self._chains = [ToolChain(self._scene, row) for row in rows]

    def forget_samples(self) -> None:
        """Forget the samples so far."""
        self._taken[:] = 0

    def take_samples(self) -> tuple[Array, NDArray[np.int64]]:
        """Return samples (arms, S, room), and how many have come since the last call (arms,)."""
        counts = self._taken.copy()
        self._taken[:] = 0
        if self._tool:
            longest = int(counts.max())
            arms = np.array_split(np.arange(len(counts)), len(self._chains))
            for chain, some in zip(self._chains, arms, strict=True):
                q = np.moveaxis(self._samples[some][:, self._q, :longest], 1, 0)
                p_WT = chain.compute_positions(q.reshape(len(self._q), -1))
                for row, axis in self._tool.items():
                    self._samples[some, row, :longest] = p_WT[axis].reshape(len(some), longest)
        return self._samples, counts


class Sampler(Samples):
    """Samples of a plant.

    Args:
        plant: the machine.
        names: of signals, in the order of their rows.
        room: for samples.
    """

    def __init__(self, plant: Plant, names: Sequence[str], room: int) -> None:
        super().__init__(plant.scene, names, 1, room)
        self._plant, self._row = plant, RecordRow(plant)
        rows = self._row.rows
        self._at = make_truth(**{
            name: rows["energy"] if name == "energy" else rows[name][0] for name in self.truth
        })  # fmt: skip
        self._sampler = self.make_sampler(
            rows,
            measure=plant.core.arm_measure if self.measures else C_NULL,
            get_truth=plant.core.arm_get_truth,
            measurement=self._row.measurement,
            truth=self._at,
        )

    def begin_sampling(self) -> None:
        """Take the first sample of a run, and one at each tick from now on."""
        self.forget_samples()
        plant = self._plant
        self.calls.sampler_record(self._sampler, plant.machine)
        plant.core.arm_listen(plant.machine, self.calls.sampler_record, self._sampler)

    def end_sampling(self) -> None:
        """End sampling."""
        self._plant.core.arm_listen(self._plant.machine, C_NULL, C_NULL)

    @property
    def left(self) -> int:
        """Room for samples before `take_samples`."""
        return self.room - int(self._taken[0])


class FleetSampler(Samples):
    """Samples of the arms of a fleet.

    Attributes:
        look, with_: function and argument of a `FleetWay` that takes samples.

    Args:
        fleet: of arms.
        names: of signals, in the order of their rows.
        room: for samples of each.
    """

    def __init__(self, fleet: Fleet, names: Sequence[str], room: int) -> None:
        scene, count = fleet.scene, len(fleet)
        super().__init__(scene, names, count, room)
        N = len(scene.joints)
        place = MeasuredPlace(scene, count)
        shapes = {name: (count, N) for name in self.truth} | dict.fromkeys(("energy",), (count,))
        truth = {name: np.zeros(shapes[name]) for name in self.truth}
        arrays = {value.field for value in self._columns.values() if value.path[0] == "measured"}
        self._measurement = FLEET.make_struct(
            "arm_fleet_measurement", **{name: place.arrays[name] for name in arrays}
        )
        self._truth = FLEET.make_struct(
            "arm_fleet_truth",
            **{STATE_NAMES_IN_C.get(name, name): rows for name, rows in truth.items()},
        )
        self._keeps = place, truth
        self.with_ = self.make_sampler(
            place.arrays | truth,
            show=fleet.core.arm_fleet_step,
            fleet=fleet.handle,
            measurements=self._measurement if self.measures else C_NULL,
            truths=self._truth,
        )
        self.look: CData | str = self.calls.sampler_record_group
