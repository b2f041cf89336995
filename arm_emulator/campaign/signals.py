"""Signals of a run by name: true values, measurements, and quantities that follow."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.column import Column
from arm_emulator.build.c_header import NULL, Header, Library, pointer
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.call_arguments import truth_at
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.record_row import RecordRow, columns_of
from arm_emulator.machine.scene import Scene

Array = NDArray[np.float64]
HERE = Path(__file__).resolve().parent
SAMPLER = Header(HERE / "sampler.h", (BOUNDARY,))
ROOM = 4096  # samples in a batch for requirements
_KINDS = {"f8": "DOUBLE", "i8": "INT64", "u4": "UINT32"}
TOOL = ("tool.x", "tool.y", "tool.z")


@cache
def _sampler() -> Library:
    return library(sampler_unit())


def sampler_unit() -> Unit:
    """Return the sources of the sampler."""
    part = "sampler.c"
    source, about = f'#include "{part}"\n', "the samples of campaigns"
    return Unit("sampler", source, C_FLAGS, (HERE, BOUNDARY), (SAMPLER,), "campaign", about, part)


def units_of_signals(scene: Scene) -> dict[str, str]:
    """Return the names of all signals of a scene, with their units."""
    columns = {one.name: one.unit for one in columns_of(scene)}
    units = {joint: columns[f"q.{joint}"] for joint in scene.joint_names}
    columns |= {f"target.{joint}": unit for joint, unit in units.items()}
    columns |= {f"error.{joint}": unit for joint, unit in units.items()}
    return columns | (dict.fromkeys(TOOL, "m") if scene.chain.coupling.plain else {})


class Sampler:
    """Takes some numbers of a plant at every tick.

    Args:
        plant: the machine.
        names: of signals, in the order of their rows.
    """

    def __init__(self, plant: Plant, names: Sequence[str]) -> None:
        scene = plant.scene
        self._plant = plant
        wanted = list(names)
        self._tool = {
            wanted.index(name): place for place, name in enumerate(TOOL) if name in wanted
        }
        own = {one.name: one for one in columns_of(scene)}
        if self._tool:
            wanted += [q for joint in scene.joint_names if (q := f"q.{joint}") not in wanted]
        self._q = [wanted.index(f"q.{joint}") for joint in scene.joint_names if self._tool]
        sampled = [place for place, name in enumerate(wanted) if name not in TOOL]
        self._names = [wanted[place] for place in sampled]
        self._row = RecordRow(plant)
        self._samples = np.zeros((max(1, len(wanted)), ROOM))
        numbers = self._numbers([own[name] for name in self._names])
        numbers["row"][: len(sampled)] = sampled
        truth = {name.partition(".")[0] for name in self._names} - {"measured"}
        rows = self._row.rows
        self._truth = truth_at(**{
            name: rows["energy"] if name == "energy" else rows[name][0] for name in truth
        })  # fmt: skip
        measures = any(name.startswith("measured.") for name in self._names)
        self._keeps = numbers
        self._sampler = SAMPLER.new(
            "sampler",
            count=len(self._names),
            measure=plant.core.arm_measure if measures else NULL,
            get_truth=plant.core.arm_get_truth,
            measurement=self._row.measurement,
            truth=self._truth,
            row=SAMPLER.ffi.cast("char *", SAMPLER.ffi.from_buffer(rows)),
            numbers=SAMPLER.pointer("sampler_number", numbers),
            samples=pointer(self._samples),
            room=ROOM,
        )
        self._calls = _sampler()

    def _numbers(self, columns: Sequence[Column]) -> NDArray[np.void]:
        rows = self._row.rows
        base = rows.__array_interface__["data"][0]
        numbers = SAMPLER.rows("sampler_number", max(1, len(columns)))
        for number, column in zip(numbers, columns, strict=False):
            place = column.of(rows)
            number["offset"] = place.__array_interface__["data"][0] - base
            number["kind"] = SAMPLER.constant(f"SAMPLER_{_KINDS[place.dtype.str[1:]]}")
        return numbers

    def begin(self) -> None:
        """Take the first sample of a run, and one at each tick from now on."""
        self._sampler.taken = 0
        plant = self._plant
        self._calls.sampler_take(self._sampler, plant.machine)
        plant.core.arm_listen(plant.machine, self._calls.sampler_take, self._sampler)

    def end(self) -> None:
        """End sampling."""
        self._plant.core.arm_listen(self._plant.machine, NULL, NULL)

    @property
    def room(self) -> int:
        """Room for samples before `take`."""
        return ROOM - int(self._sampler.taken)

    def take(self) -> tuple[Array, int]:
        """Return rows of samples (S, ROOM), and how many have come since the last call."""
        count = int(self._sampler.taken)
        self._sampler.taken = 0
        if self._tool:
            p = tool_positions(self._plant.scene, self._samples[self._q, :count])
            for row, axis in self._tool.items():
                self._samples[row, :count] = p[axis]
        return self._samples, count


def tool_positions(scene: Scene, q: Array) -> Array:
    """Return the tool's positions in the world (3, K) [m] for joint positions (N, K) [rad or m]."""
    chain = scene.chain
    joint, frame = chain.place_of(scene.tool)
    p = np.repeat(frame.p[:, None], len(q[0]), axis=1)
    for place in chain.way_to(joint)[::-1]:
        link = chain.links[place]
        slides = link.kind == "prismatic"
        angle = link.theta_0 + (0.0 if slides else q[place])
        cos, sin = np.cos(angle), np.sin(angle)
        x, y = cos * p[0] - sin * p[1], sin * p[0] + cos * p[1]
        z = p[2] + (q[place] if slides else 0.0)
        c, s = link.cos_alpha, link.sin_alpha
        y, z = c * y - s * z, s * y + c * z
        c, s = link.cos_gamma, link.sin_gamma
        p = link.p[:, None] + np.array([c * x - s * y, s * x + c * y, z])
    world: Array = chain.R_BW.T @ p
    return world
