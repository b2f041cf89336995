"""The judges of runs that are on a device: judges_kernels.hpp."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array
from arm_emulator.extension.compiler import (
    BOUNDARY_FOLDER,
    SHARED_FLAGS,
    CData,
    Header,
    Unit,
    c_pointer,
)
from arm_emulator_campaign.judging.device_copy import copy_to_device
from arm_emulator_campaign.judging.program import BLOCK, JUDGES, Program, Targets
from arm_emulator_campaign.judging.requirement import C_FOLDER
from arm_emulator_fleet.device import Device, Memory
from arm_emulator_fleet.device_core import cast_pointer, view_bytes
from arm_emulator_fleet.load_kernels import load_kernels
from arm_emulator_fleet.unit import FOLDER

KERNELS = Header(C_FOLDER / "judges_kernels.h", (C_FOLDER, BOUNDARY_FOLDER))


def build_judges_unit() -> Unit:
    """Return the sources of the kernels, which know no scene."""
    return Unit(
        name="judges-kernels",
        source='#include "judges_kernels.hpp"\n',
        # As the judges in C, of which they are the same code and give the same bits.
        flags=(*"-std=c++20 -O2 -ffp-contract=off".split(), *SHARED_FLAGS),
        folders=(C_FOLDER, BOUNDARY_FOLDER, FOLDER),
        headers=(),
        where="campaign",
        about="the judges of campaigns on a device",
        part="judges",
    )


class DeviceProgram(Program):
    """Judges the samples of runs on a device, where they stay: see `measure_run`, then `move_runs`.

    Its requirements are those of one run, of which the others have copies; nothing is traced.

    Attributes:
        device: where they are, once they have moved.
    """

    def measure_run(self, longest: int) -> int:
        """Return the bytes of the device's memory that a run of so many samples at most needs."""
        assert len(self._requirements) == 1 and not self.kept.size
        requirement_count, measure_count = self._robustness.shape[1], self._reduced.shape[1]
        self._measure_requirements(longest)
        self._sizes = {
            "all": JUDGES.get_size("judges"),
            "values": 8 * BLOCK * self._row_count,
            "at": 8 * self._row_count,
            "copies": 8 * requirement_count,
            "measures": JUDGES.get_size("judges_measure") * measure_count,
            "rooms": sum(whole for _, whole in self._requirement_sizes),
            "counts": 8,
            "robustness": 8 * requirement_count,
            "reduced": 8 * measure_count,
        }
        return sum(self._sizes.values())

    def _measure_requirements(self, longest: int) -> None:
        """Find how much of a run each requirement keeps: that depends on its length alone."""
        block = np.zeros(BLOCK)
        at = JUDGES.ffi.new("double const *[]", [c_pointer(block)] * max(1, self._row_count))
        self._requirement_sizes: list[tuple[int, int]] = []
        size = np.zeros(2, np.int64)
        for requirement in self._requirements[0]:
            for first in range(0, longest, BLOCK):
                count = min(BLOCK, longest - first)
                if self._calls.robustness_feed(requirement.pointer, at, count):
                    raise MemoryError("no memory for a requirement")
            self._calls.robustness_end(requirement.pointer)
            self._calls.robustness_measure(
                requirement.pointer, longest, c_pointer(size[:1]), c_pointer(size[1:])
            )
            self._requirement_sizes.append((int(size[0]), int(size[1])))

    def move_runs(self, device: Device, runs: int) -> None:
        """Judge so many runs there from now on.

        Raises:
            Refusal: the kernels are not cached and no compiler makes them, or there is no memory.
        """
        self.device, self._runs = device, runs
        self._module = load_kernels(device, build_judges_unit())
        self._memory = {
            name: device.allocate(max(8, runs * size)) for name, size in self._sizes.items()
        }
        self._memory["failed"] = device.allocate(4)
        self._targets: Targets | None = None
        self._of_targets: dict[str, Memory] = {}
        own, _, _, of_rows, inputs, _ = self._referenced
        like = JUDGES.ffi.new("judges *")
        like[0] = self._structs[0]
        copied = {
            "rows": copy_to_device(device, of_rows),
            "inputs": copy_to_device(device, inputs),
            "measures": copy_to_device(device, own[0]),
        }
        JUDGES.fill_struct(
            like,
            **{name: JUDGES.ffi.cast("void *", place.pointer) for name, place in copied.items()},
        )
        heads = [
            copy_to_device(device, view_bytes(requirement.pointer, head))
            for requirement, (head, _) in zip(
                self._requirements[0], self._requirement_sizes, strict=True
            )
        ]
        self._like = copied, heads
        self._launch_kernel(
            "judge_build",
            like=copy_to_device(device, view_bytes(like, JUDGES.get_size("judges"))),
            requirements=copy_to_device(
                device, np.array([*(head.pointer for head in heads), 0], np.uint64)
            ),
            room_of=copy_to_device(
                self.device, np.array([0, *(whole for _, whole in self._requirement_sizes)])[1:]
            ),
            room=self._sizes["rooms"],
            **{
                name: self._memory[name] for name in ("values", "at", "copies", "measures", "rooms")
            },
        )
        device.synchronize()  # what it reads may go

    def begin_runs(self) -> None:
        """Begin all runs."""
        self.device.fill(self._memory["failed"], 0)
        self._launch_kernel("judge_begin")

    def take_samples(
        self, samples: Any, counts: NDArray[np.int64], targets: Targets | None = None
    ) -> None:
        """Go on with samples (runs, S, room) on the device, of which there are so many (runs,)."""
        assert targets is not None
        if targets is not self._targets:
            names = ("since", "q", "first")
            self._of_targets = {
                name: copy_to_device(self.device, getattr(targets, name)) for name in names
            }
            self._targets = targets
        padded = np.zeros(self._runs, np.int64)
        padded[: len(counts)] = counts
        self.device.write(self._memory["counts"], padded)
        self._launch_kernel(
            "judge_add_samples",
            samples=samples,
            sample_rows=samples.size // (8 * self._runs * self._room),
            stride=self._room,
            counts=self._memory["counts"],
            since=self._of_targets["since"],
            targets=self._of_targets["q"],
            first=self._of_targets["first"],
            joints=targets.q.shape[1],
            failed=self._memory["failed"],
        )

    def end_runs(self) -> tuple[Array, Array]:
        """Return robustness (runs, requirements) and measures (runs, measures)."""
        places = self._memory["robustness"], self._memory["reduced"]
        self._launch_kernel("judge_end", robustness=places[0], measures=places[1])
        if self.device.read(self._memory["failed"], np.int32, (1,))[0]:
            raise MemoryError("no memory for a requirement")
        robustness, reduced = (
            self.device.read(place, np.float64, (self._runs, of_one_run.shape[1]))
            for place, of_one_run in zip(places, (self._robustness, self._reduced), strict=True)
        )
        return robustness, reduced

    def _launch_kernel(self, kernel: str, **values: Any) -> None:
        places = {
            name: cast_pointer(value) if isinstance(value, Memory) else value
            for name, value in {"all": self._memory["all"], **values}.items()
        }
        call: CData = KERNELS.make_struct(f"{kernel}_call", **places)
        self._module.launch(kernel, self._runs, bytes(KERNELS.ffi.buffer(call)))
