"""Many machines of one compiled core: all that is asked of them and set between their steps.

One class: all of its calls share the machines of the core, hence the length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.extension.base import (
    Array,
    ArrayEquality,
    Refusal,
    Synchronized,
    check_count,
    coerce_flag,
    synchronized,
)
from arm_emulator.extension.compiler import C_NULL as NULL
from arm_emulator.extension.compiler import CData, Library
from arm_emulator.extension.compiler import c_pointer as pointer
from arm_emulator.extension.machine import ARM_HEADER as ARM
from arm_emulator.extension.machine import ARM_REFUSED as REFUSED
from arm_emulator.extension.machine import STATE_NAMES_IN_C as PLACES
from arm_emulator.extension.machine import STATE_ROWS as ROWS
from arm_emulator.extension.machine import WRENCH_AXES as AXES
from arm_emulator.extension.machine import (
    ExternalWrench,
    Measured,
    MeasuredPlace,
    Scene,
    bound_start,
    build_refusal,
    compute_count_angle,
    find_varied,
    make_options,
    move_to_moving_link,
)
from arm_emulator_fleet.fleet_arguments import FleetArguments, choose_arms
from arm_emulator_fleet.unit import FLEET, load_fleet

if TYPE_CHECKING:
    from arm_emulator_fleet.device_core import DeviceCore

LARGEST_FLEET = 10**6  # arms; some 10 kB each


class CoreMachines(Synchronized):
    """Machines as the core keeps them: their numbers, their true states, outside forces.

    How they go on under commands is `Fleet`'s.

    Attributes:
        scene: of all machines.
        core: the compiled core (core/arm_fleet.h).
        device: where the machines are; None: in lanes of the processor.
        lanes: machines that advance together.
        compute_count_angle: meaning of one encoder count at the link (N,) [rad or m].

    Args:
        scene: of all machines.
        count: of machines.
        device: see there.
        kernels: see `Fleet`.

    Raises:
        Refusal: the scene's core cannot be compiled, no such device, or no such count.
    """

    def __init__(
        self,
        scene: Scene,
        count: int,
        device: str | None = None,
        kernels: Sequence[Path] = (),
    ) -> None:
        super().__init__()
        self.scene = scene
        self._count = check_count("Fleet", "count", count, 1, LARGEST_FLEET)
        self._N = len(scene.joints)
        self._arguments = FleetArguments(scene, self._count)
        self.device = device
        self.core: Any = load_core(scene, device, kernels)  # the functions of core/arm_fleet.h
        self.lanes = int(self.core.arm_fleet_lanes())
        self.link_angle_per_count = compute_count_angle(scene)
        values = np.tile([number.value for number in scene.varied], (self._count, 1))
        options = make_options(scene, np.ascontiguousarray(values, np.float64))
        self._fleet = self.core.arm_fleet_new(options, self._count)
        self._place = MeasuredPlace(scene, self._count)
        self._powered = np.zeros(self._count, np.uint8)
        self._measurement = FLEET.make_struct(
            "arm_fleet_measurement", powered=self._powered, **self._place.arrays
        )

    def __del__(self) -> None:
        fleet, self._fleet = getattr(self, "_fleet", None), None
        if fleet:
            self.core.arm_fleet_delete(fleet)

    def __len__(self) -> int:
        return self._count

    @property
    def handle(self) -> CData:
        """The machines as the functions of core/arm_fleet.h take them."""
        return self._fleet

    @synchronized
    def reset(
        self,
        arms: ArrayLike | None = None,
        *,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        varied: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """Set arms to logical time 0, the motors to match the links.

        No current flows, and the gears carry no torque.

        Args:
            arms: a mask (count,) or indices; None: all.
            q: link positions [rad or m], (N,) for all of these or a row each, or (count, N); rows
                of other arms are not read; the scene's start if None.
            v: link speeds alike [rad/s or m/s]; zero if None.
            varied: values of varied numbers by name, one for all of these or one each, or
                (count,); those that are not named stay.

        Raises:
            Refusal: wrong shape, not finite, out of range or too far away to be computed with; the
                arms are as before.
        """
        where = "Fleet.reset"
        if not isinstance(varied, Mapping | None):
            raise Refusal(where, "varied", "be values by name", varied)
        numbers = arms, q, v, *(varied or {}).values()
        if self.device is not None and has_device_array(numbers):
            return self._reset_in_place(where, arms, q, v, varied or {})
        mask = choose_arms(where, arms, self._count)
        of_q, of_v = bound_start(self.scene)
        at = self._arguments.read_rows(self.scene.start if q is None else q, mask, where, of_q)
        speed = self._arguments.read_rows(np.zeros(self._N) if v is None else v, mask, where, of_v)
        columns = {
            n: self._arguments.read_column(where, n, values, mask)
            for n, values in (varied or {}).items()
        }
        for name, column in columns.items():
            self._set_parameter(name, column, mask)
        self.core.arm_fleet_reset(self._fleet, get_mask_bytes(mask), pointer(at), pointer(speed))

    def _reset_in_place(
        self, where: str, arms: Any, q: Any, v: Any, varied: Mapping[str, Any]
    ) -> None:
        """Reset arms of a device with numbers that are there."""
        from arm_emulator_fleet.device_array import is_device_array, take_array

        device, count, shape = self.core.device, self._count, (self._count, self._N)
        if not is_device_array(arms):
            arms = choose_arms(where, arms, count).view(np.uint8)
        mask = take_array(where, "arms", device, arms, (count,), None)
        if mask.dtype.itemsize != 1:
            raise Refusal(where, "arms", "be a mask of bool or uint8", mask.dtype)
        starts = (("q", q, self.scene.start), ("v", v, np.zeros(self._N)))
        rows = [
            take_array(where, name, device, _make_rows(start_values, at, count), shape, np.float64)
            for name, start_values, at in starts
        ]
        for name in varied:
            find_varied(self.scene.varied, name, where)
        columns = {
            name: take_array(where, name, device, values, (count,), np.float64)
            for name, values in varied.items()
        }
        if self.core.reset_in_place(self._fleet, mask, (rows[0], rows[1]), columns) == REFUSED:
            raise self._make_refusal(where, "another value")

    def to_device(self, values: ArrayLike) -> Any:
        """Return a copy of numbers where the arms are.

        Libraries with ``from_dlpack`` take it, and the arrays of frames, without a copy.

        Args:
            values: any numbers.

        Returns:
            A `DeviceArray`; of NumPy for lanes of the processor.

        Raises:
            Refusal: they are no numbers.
        """
        if self.device is None:
            return np.array(values)
        from arm_emulator_fleet.device_array import convert_to_device_array

        return convert_to_device_array(self.core.device, np.array(values))

    @property
    @synchronized
    def powered(self) -> NDArray[np.bool_]:
        """Whether the drives of each arm have power (count,); without it every command is 0.

        It can be set, for all arms or for each.
        """
        self._measure_arms()
        powered = self._powered.astype(bool)
        powered.flags.writeable = False  # an element set in a copy would stop no arm
        return powered

    @powered.setter
    def powered(self, on: ArrayLike) -> None:
        if np.ndim(on) == 0:
            on = np.full(self._count, coerce_flag(on, "Fleet", "powered"))
        flags = np.asarray(on)
        if flags.dtype != np.bool_ or flags.shape != (self._count,):
            rule = f"be True or False, or ({self._count},) of them"
            raise Refusal("Fleet", "powered", rule, on)
        with self.turn:
            self.core.arm_fleet_power(self._fleet, get_mask_bytes(flags))

    @property
    @synchronized
    def measured(self) -> Measured:
        """Readings of the sensors of all arms at their newest ticks, as a copy.

        As `Plant.measured`, with arrays (count, N).
        """
        self._measure_arms()
        return self._place.read_values()

    def _measure_arms(self) -> None:
        self.core.arm_fleet_measure(self._fleet, self._measurement)

    @property
    @synchronized
    def parameters(self) -> dict[str, Array]:
        """The numbers that the scene lists as varied, by name, with each arm's value (count,)."""
        values = {number.name: np.zeros(self._count) for number in self.scene.varied}
        for name, column in values.items():
            self.core.arm_fleet_get_parameter(self._fleet, name.encode(), pointer(column))
        return values

    @synchronized
    def set_parameter(self, name: str, values: ArrayLike, *, arms: ArrayLike | None = None) -> None:
        """Set a varied number; the motion goes on from where it is. A reset leaves it as it is.

        Args:
            name: of the number.
            values: one for all of these arms, one each, or (count,).
            arms: a mask (count,) or indices; None: all.

        Raises:
            Refusal: the scene does not list it as varied, wrong shape, or a value out of its range;
                nothing has changed.
        """
        where = "Fleet.set_parameter"
        mask = choose_arms(where, arms, self._count)
        self._set_parameter(name, self._arguments.read_column(where, name, values, mask), mask)

    @synchronized
    def set_parameters(self, rows: Array) -> None:
        """Set all varied numbers of all arms at once, in the scene's order.

        Args:
            rows: (count, numbers).

        Raises:
            Refusal: wrong shape, or a value out of its range; nothing has changed.
        """
        where, shape = "Fleet.set_parameters", (self._count, len(self.scene.varied))
        if np.shape(rows) != shape:
            raise Refusal(where, "rows", f"have shape {shape}", np.shape(rows))
        values = np.ascontiguousarray(rows, np.float64)
        if self.core.arm_fleet_set_parameters(self._fleet, NULL, pointer(values)) == REFUSED:
            raise self._make_refusal(where, "another value")

    def _set_parameter(self, name: str, column: Array, mask: NDArray[np.bool_]) -> None:
        arguments = get_mask_bytes(mask), name.encode(), pointer(column)
        if self.core.arm_fleet_set_parameter(self._fleet, *arguments) == REFUSED:
            raise self._make_refusal("Fleet.set_parameter", "another value")

    @synchronized
    def set_external_wrench(
        self, link: str, wrench: ExternalWrench, *, arms: ArrayLike | None = None
    ) -> None:
        """Let a force and a moment act on a link of arms, see `Plant.set_external_wrench`.

        Args:
            link: any link of the URDF that moves.
            wrench: what acts; each vector (3,) for all of these arms, or (count, 3), of which the
                rows of other arms are not used.
            arms: a mask (count,) or indices; None: all.

        Raises:
            Refusal: see there; nothing has changed.
        """
        where = "Fleet.set_external_wrench"
        mask = choose_arms(where, arms, self._count)
        place, moved = move_to_moving_link(self.scene, where, link, wrench, self._count)
        rows = ARM.make_rows("arm_wrench", self._count)
        rows["size"], rows["axes"] = rows.itemsize, AXES.index(moved.axes)
        for name in ("point", "force", "moment"):
            rows[name] = getattr(moved, name)
        places = get_mask_bytes(mask), place, ARM.make_pointer("arm_wrench", rows)
        self.core.arm_fleet_set_external_wrench(self._fleet, *places)

    @synchronized
    def save(self) -> bytes:
        """Return the whole state of the arms as bytes."""
        size = self._count * self.core.arm_saved_size()
        saved = np.zeros(size, np.uint8)
        self.core.arm_fleet_save(self._fleet, pointer(saved), size)
        return saved.tobytes()

    @synchronized
    def restore(self, saved: bytes, *, arms: ArrayLike | None = None) -> None:
        """Continue from what `save` of a fleet of as many arms has returned, to the last bit.

        Args:
            saved: of all arms; or of one, by `Plant.save`, from which all of these continue.
            arms: those that are restored: a mask (count,) or indices; None: all.

        Raises:
            Refusal: it is of another scene, core, count, step or servo period, or it was spoiled;
                nothing has changed.
        """
        where = "Fleet.restore"
        size = self.core.arm_saved_size()
        valid = isinstance(saved, bytes | bytearray | memoryview)
        if not valid or len(bytes(saved)) not in (size, self._count * size):
            rule = f"be the {self._count * size} bytes of `save`, or {size} of one arm"
            raise Refusal(where, "saved fleet", rule, saved)
        self._restore_arms(where, bytes(saved), len(bytes(saved)), arms)

    def copy_state(
        self, arm: int, arms: ArrayLike | None = None, *, of: CoreMachines | None = None
    ) -> None:
        """Let arms continue from where one arm is, to the last bit; on a device without the host.

        All of its state is copied, with varied numbers and external wrenches, as by `restore`.

        Args:
            arm: index of the one that is copied.
            arms: those that become like it: a mask (count,) or indices; None: all.
            of: the fleet that has it, of the same scene and on the same device; None: this one.

        Raises:
            Refusal: no such arm, or a fleet of another scene, device, step or servo period;
                nothing has changed.
        """
        where, source = "Fleet.copy_state", self if of is None else of
        if not isinstance(source, CoreMachines) or source.device != self.device:
            rule = f"be a fleet on {self.device or 'lanes of the processor'}"
            raise Refusal(where, "of", rule, getattr(source, "device", source))
        size = source.core.arm_saved_size()
        if size != self.core.arm_saved_size():
            raise Refusal(where, "of", "be a fleet of this scene", source.scene.name)
        saved = source.save_arm(check_count(where, "arm", arm, -len(source), len(source) - 1))
        with self.turn:
            self._restore_arms(where, saved, size, arms)

    @synchronized
    def save_arm(self, arm: int) -> Any:
        """Return the whole state of one arm, as `restore` takes it.

        Args:
            arm: its index.

        Returns:
            Bytes; of a device, `Memory` there.

        Raises:
            Refusal: no such arm.
        """
        last = self._count - 1
        arm = check_count("Fleet.save_arm", "arm", arm, -self._count, last) % self._count
        if self.device is not None:
            return self.core.save_arm(self._fleet, arm)
        saved = np.zeros(self.core.arm_saved_size(), np.uint8)
        machine = self.core.arm_fleet_machine(self._fleet, arm)
        self.core.arm_save(machine, pointer(saved), len(saved))
        self.core.arm_fleet_give_back(self._fleet, arm)
        return saved.tobytes()

    def _restore_arms(self, where: str, saved: Any, size: int, arms: ArrayLike | None) -> None:
        mask = NULL if arms is None else get_mask_bytes(choose_arms(where, arms, self._count))
        if self.core.arm_fleet_restore(self._fleet, mask, saved, size) == REFUSED:
            raise self._make_refusal(where, "another one")

    @property
    @synchronized
    def state(self) -> FleetState:
        """The true states now, as a copy. An arm's own can be set: ``fleet[k].state = ...``."""
        shape = self._count, self._N
        numbers = {name: np.zeros(shape) for name in ROWS}
        of_arm = {name: np.zeros(self._count) for name in ("t", "energy")}
        self._read_truth(**numbers, **of_arm)
        for rows in (*numbers.values(), *of_arm.values()):
            rows.flags.writeable = False
        return FleetState(**numbers, **of_arm)

    @property
    @synchronized
    def faults(self) -> NDArray[np.int32]:
        """The joint at which each arm diverged (count,); -1: it goes on."""
        faults = np.zeros(self._count, np.int32)
        self._read_truth(fault=faults)
        return faults

    def _read_truth(self, **to: NDArray[Any]) -> None:
        places = {PLACES.get(name, name): rows for name, rows in to.items()}
        self.core.arm_fleet_get_truth(self._fleet, FLEET.make_struct("arm_fleet_truth", **places))

    def _make_refusal(self, where: str, otherwise: str) -> Refusal:
        """Return the refusal of a call for one of the arms."""
        arm = self.core.arm_fleet_refused(self._fleet)
        machine = self.core.arm_fleet_machine(self._fleet, arm)
        why = build_refusal(self.core, machine, self.scene, f"{where}: arm {arm}", otherwise)
        self.core.arm_fleet_give_back(self._fleet, arm)
        return why


def has_device_array(numbers: Sequence[object]) -> bool:
    """Return whether one of these is an array of a library with devices."""
    from arm_emulator_fleet.device_array import is_device_array

    return any(map(is_device_array, numbers))


def _make_rows(rows: Any, otherwise: Array, count: int) -> Any:
    """Return numbers with a row for each arm, as they are if they are on a device."""
    if rows is not None and not isinstance(rows, np.ndarray):
        return rows
    return np.ascontiguousarray(
        np.broadcast_to(otherwise if rows is None else rows, (count, len(otherwise))), np.float64
    )


def load_core(scene: Scene, device: str | None, kernels: Sequence[Path]) -> Library | DeviceCore:
    """Return the core of many machines of a scene, for a device or for the processor's lanes.

    Raises:
        Refusal: it cannot be compiled, or no such device.
    """
    if device is None:
        return load_fleet(scene)
    # Nothing of it is loaded for the processor's lanes.
    from arm_emulator_fleet.device_core import DeviceCore
    from arm_emulator_fleet.open_device import open_device

    return DeviceCore(scene, open_device("Fleet", device), kernels)


def get_mask_bytes(mask: NDArray[np.bool_]) -> CData:
    """Return a mask of arms as the core takes it."""
    return pointer(np.ascontiguousarray(mask).view(np.uint8))


@dataclass(frozen=True, eq=False)
class FleetState(ArrayEquality):
    """True states of all arms: a row each, and in a row the joints, base to tool."""

    t: Array  # (count,) s; arms that have diverged stay where they are
    energy: Array  # (count,) J
    current: Array  # (count, N) A
    theta_m: Array  # rad, motor angle
    omega_m: Array  # rad/s, motor speed
    q: Array  # rad or m, link side
    v: Array  # rad/s or m/s, link side
    gear_torque: Array  # N m or N, on the link
