"""Samples of the arms of a fleet that are on a device, taken there in each period."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.compiler import C_NULL, CData
from arm_emulator_campaign.judging.device_copy import copy_to_device
from arm_emulator_campaign.judging.requirement import C_FOLDER
from arm_emulator_campaign.judging.signals import SAMPLER, FleetSampler
from arm_emulator_fleet import Fleet
from arm_emulator_fleet.device import Memory
from arm_emulator_fleet.device_core import cast_address, cast_pointer, view_bytes
from arm_emulator_fleet.unit import FLEET

KERNELS = (C_FOLDER / "sampler_kernels.hpp",)


class DeviceSampler(FleetSampler):
    """Samples of arms on a device, piece by piece.

    Args:
        fleet: of arms, with `KERNELS`.
        names: of signals, in the order of their rows.
        room: for samples of each.
        stays: `take_samples` returns their memory on the device, not a copy.
    """

    def __init__(self, fleet: Fleet, names: Sequence[str], room: int, stays: bool) -> None:
        self._device, self._stays = fleet.core.device, stays
        self._copied: list[Memory] = []
        super().__init__(fleet, names, room)
        self.look = "sampler_observe"

    def make_sampler(
        self, rows: Mapping[str, NDArray[Any]] | NDArray[np.void], **more: Any
    ) -> CData:
        """Return the address of a sampler on the device, see `FleetSampler`."""
        assert isinstance(rows, Mapping)
        self._rows: dict[int, tuple[NDArray[Any], Memory]] = {}
        for name in ("measurements", "truths"):
            if more[name] != C_NULL:
                more[name] = self._move_struct(more[name], rows)
        fleet = {"fleet": cast_pointer(more["fleet"].memory)}
        struct = super().make_sampler(rows, **more | fleet | {"show": C_NULL})
        for number in self._numbers[: struct.count]:
            number["place"] = self._find_address(int(number["place"]), rows)
        self._of_numbers = copy_to_device(self._device, self._numbers)
        self._of_samples = self._device.allocate(self._samples.nbytes)
        self._of_taken = copy_to_device(self._device, self._taken)
        SAMPLER.fill_struct(
            struct,
            numbers=SAMPLER.ffi.cast("sampler_number *", self._of_numbers.pointer),
            samples=SAMPLER.ffi.cast("double *", self._of_samples.pointer),
            taken=SAMPLER.ffi.cast("int64_t *", self._of_taken.pointer),
        )
        self._of_sampler = copy_to_device(
            self._device, view_bytes(struct, SAMPLER.get_size("sampler"))
        )
        return cast_pointer(self._of_sampler)

    def forget_samples(self) -> None:  # noqa: D102
        super().forget_samples()
        self._device.fill(self._of_taken, 0)

    def take_samples(self) -> tuple[Any, NDArray[np.int64]]:  # noqa: D102
        counts = self._device.read(self._of_taken, np.int64, self._taken.shape)
        self._device.fill(self._of_taken, 0)
        if self._stays:
            return self._of_samples, counts
        self._samples = self._device.read(self._of_samples, np.float64, self._samples.shape)
        self._taken[:] = counts
        return super().take_samples()

    def _move_struct(self, struct: CData, rows: Mapping[str, NDArray[Any]]) -> CData:
        """Return the address of a copy on the device, which points to memory there."""
        for name, field in FLEET.ffi.typeof(struct).item.fields:
            at = getattr(struct, name)
            if field.type.kind == "pointer" and at != C_NULL:
                there = self._find_address(int(FLEET.ffi.cast("uintptr_t", at)), rows)
                setattr(struct, name, cast_address(there))
        copied = copy_to_device(
            self._device, view_bytes(struct, FLEET.ffi.sizeof(FLEET.ffi.typeof(struct).item))
        )
        self._copied.append(copied)
        return cast_pointer(copied)

    def _find_address(self, address: int, rows: Mapping[str, NDArray[Any]]) -> int:
        """Return where on the device a number of some arrays is."""
        for array in rows.values():
            began = int(array.__array_interface__["data"][0])
            if began <= address < began + array.nbytes:
                if began not in self._rows:
                    self._rows[began] = array, copy_to_device(self._device, array.view(np.uint8))
                return self._rows[began][1].pointer + address - began
        raise AssertionError("an address of another array")
