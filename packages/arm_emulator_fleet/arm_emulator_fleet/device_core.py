"""The functions of core/arm_fleet.h for arms that stay on a device.

One class with a method for each of these functions, hence the length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.compiler import C_NULL as NULL
from arm_emulator.extension.compiler import CData
from arm_emulator.extension.machine import ARM_HEADER as ARM
from arm_emulator.extension.machine import ARM_REFUSED as REFUSED
from arm_emulator.extension.machine import Scene, bound_start, list_rows, make_commands
from arm_emulator_fleet.device import DEFAULT_BLOCK, Device, DevicePointer, Memory
from arm_emulator_fleet.device_array import DeviceArray
from arm_emulator_fleet.load_kernels import load_parts
from arm_emulator_fleet.unit import FLEET, KERNELS, NATIVE, build_card_units

OK = ARM.get_constant("ARM_OK")
_COMMAND = ARM.get_size("arm_joint_command")
NONE_REFUSED = KERNELS.get_constant("FLEET_NONE_REFUSED")
_UNDER_ROWS, _UNDER_ZOH_COMMANDS, _UNDER_CONTROL = (
    KERNELS.get_constant(f"FLEET_UNDER_{name}") for name in ("ROWS", "HELD_COMMANDS", "CONTROL")
)
ALIGNMENT = 256  # bytes, of an object in the pool of kernel.hpp
HALVED = 8  # one arm in so many may halve its steps
MIN_HALVED = 4096  # arms that may, in any fleet
_QUEUE_BEGINS = KERNELS.get_constant("FLEET_QUEUE_BEGINS")
_Call = tuple[str, Mapping[str, Any]]  # a kernel, and values of its struct
# Bytes of a thread: 6 kB for three_axis; 88 kB for panda with located events, where steps that are
# halved call themselves. A card keeps as many for every thread that it can hold.
STACK, STACK_WITH_EVENTS = 16 * 1024, 96 * 1024


@dataclass
class DeviceFleet:
    """Arms on a device.

    Attributes:
        count: of arms.
        groups: of arms, a thread each.
        memory: the `arm_fleet`.
        pool: what it has allocated.
        refused: the arm that refused the newest call; -1: none.
        rooms: memory that calls reuse, by its purpose.
    """

    count: int
    groups: int
    memory: Memory
    pool: Memory
    refused: int
    rooms: dict[str, Memory]


class DeviceCore:
    """The calls of core/arm_fleet.h that `Fleet` makes, carried out by kernels.

    Pointers in arguments are of the processor: numbers are copied to the device and back. Frames of
    the device are filled where they are.

    Attributes:
        device: where the arms are.
        block: threads of a block on a card.

    Args:
        scene: of all arms.
        device: see there.
        kernels: see `Fleet`.

    Raises:
        Refusal: the scene cannot be compiled for it.
    """

    def __init__(self, scene: Scene, device: Device, kernels: Sequence[Path] = ()) -> None:
        self.device = device
        self._scene = scene
        self._N = len(scene.joints)
        self._saved_size, self.block = 0, DEFAULT_BLOCK
        self._module, self._smooth_module = load_parts(device, build_card_units(scene, kernels))
        self._functions: dict[str, int] = {}
        self._smooth_functions: dict[int, int] = {}  # by their addresses in the first module
        *_, self._lanes, has_events, self._has_queue = self._measure_room(1)
        device.set_stack(STACK_WITH_EVENTS if has_events else STACK)

    def _measure_room(self, count: int) -> list[int]:
        return self.read_sizes("fleet_measure_memory", 7, count=count)

    def read_sizes(self, kernel: str, numbers: int, **values: Any) -> list[int]:
        """Return the numbers that a kernel writes to its `bytes`."""
        room = self.device.allocate(8 * numbers)
        self.launch(kernel, 1, bytes=room, **values)
        return [int(size) for size in self.device.read(room, np.int64, (numbers,))]

    def count_groups(self, arms: int) -> int:
        """Return how many threads advance so many arms."""
        return -(-arms // self._lanes)

    def arm_fleet_lanes(self) -> int:
        """Return how many arms a thread advances."""
        return self._lanes

    def arm_fleet_new(self, options: CData, count: int) -> DeviceFleet:
        """Return arms at rest at q = 0.

        Raises:
            Refusal: the device has no room for them.
        """
        of_fleet, of_places, of_group, of_half, lanes, *_ = self._measure_room(count)
        groups = self.count_groups(count)
        halved = min(count, max(MIN_HALVED, count // HALVED)) * of_half
        size = of_places + groups * (of_group + ALIGNMENT * (lanes + 2)) + halved + 8 * ALIGNMENT
        memory, pool = self.device.allocate(of_fleet), self.device.allocate(size)
        if self.device.architecture != NATIVE:  # a processor has its heap
            ends = np.array([pool.pointer, pool.pointer + size], np.uint64)
            self.device.write(self._module.find_global_memory("arm_pool"), ends)
        own = ARM.make_struct("arm_options")
        own[0] = options[0]
        numbers = self.copy_in(options.parameters, 8 * count * len(self._scene.varied))
        own.parameters = cast_pointer(numbers)
        fleet = DeviceFleet(count, groups, memory, pool, -1, {})
        saved = self.device.allocate(8)
        self.launch("fleet_begin", 1, fleet=memory, options=own[0], count=count)
        self.launch("fleet_build", groups, fleet=memory, options=own[0], saved_size=saved)
        self._saved_size = int(self.device.read(saved, np.int64, (1,))[0])
        return fleet

    def arm_fleet_delete(self, fleet: DeviceFleet) -> None:
        """Free the arms."""
        if self.device.architecture == NATIVE:
            self.launch("fleet_end", 1, fleet=fleet.memory)

    def arm_fleet_machine(self, fleet: DeviceFleet, arm: int) -> tuple[DeviceFleet, int]:
        """Return what `arm_why` takes for an arm."""
        return fleet, arm

    def arm_fleet_give_back(self, fleet: DeviceFleet, arm: int) -> None:
        """Do nothing: no arm leaves the device."""

    def arm_why(self, arm: tuple[DeviceFleet, int], why: CData) -> int:
        """Write why an arm refused the newest call."""
        fleet, index = arm
        room = self.device.allocate(ARM.get_size("arm_refusal"))
        self.launch("fleet_get_refusal", 1, fleet=fleet.memory, arm=index, why=room)
        self._copy_out(room, why, room.size)
        return OK

    def arm_fleet_refused(self, fleet: DeviceFleet) -> int:
        """Return the arm that refused the newest call; -1: none."""
        return fleet.refused

    def arm_fleet_reset(self, fleet: DeviceFleet, mask: CData, q: CData, v: CData) -> int:
        """See core/arm_fleet.h."""
        rows = 8 * fleet.count * self._N
        kernels, bounds = ("fleet_check_start", "fleet_reset"), self._bounds(fleet)
        places = {"q": self.copy_in(q, rows), "v": self.copy_in(v, rows), "bounds": bounds}
        return self._check_and_do(fleet, kernels, mask=self._mask(fleet, mask), **places)

    def arm_fleet_get_parameter(self, fleet: DeviceFleet, name: bytes, values: CData) -> int:
        """See core/arm_fleet.h; the name is known."""
        room = self.device.allocate(8 * fleet.count)
        self._launch_on(fleet, "fleet_get_parameters", place=self._place(name), values=room)
        self._copy_out(room, values, room.size)
        return OK

    def arm_fleet_set_parameter(
        self, fleet: DeviceFleet, mask: CData, name: bytes, values: CData
    ) -> int:
        """See core/arm_fleet.h; the name is known."""
        return self._set_parameters(fleet, mask, self._place(name), values, 1)

    def arm_fleet_set_parameters(self, fleet: DeviceFleet, mask: CData, values: CData) -> int:
        """See core/arm_fleet.h."""
        return self._set_parameters(fleet, mask, -1, values, len(self._scene.varied))

    def _set_parameters(
        self, fleet: DeviceFleet, mask: CData, place: int, values: CData, columns: int
    ) -> int:
        return self._check_and_do(
            fleet,
            ("fleet_check_parameters", "fleet_set_parameters"),
            mask=self._mask(fleet, mask),
            place=place,
            values=self.copy_in(values, 8 * fleet.count * columns),
        )

    def arm_fleet_set_external_wrench(
        self, fleet: DeviceFleet, mask: CData, link: int, wrench: CData
    ) -> int:
        """See core/arm_fleet.h; the link is one, and the wrench finite."""
        wrenches = self.copy_in(wrench, fleet.count * ARM.get_size("arm_wrench"))
        mask = self._mask(fleet, mask)
        self._launch_on(fleet, "fleet_set_wrench", mask=mask, link=link, wrench=wrenches)
        return OK

    def arm_fleet_power(self, fleet: DeviceFleet, on: CData) -> None:
        """See core/arm_fleet.h."""
        self._launch_on(fleet, "fleet_power", on=self.copy_in(on, fleet.count))

    def arm_saved_size(self) -> int:
        """Return the bytes of an arm that is saved; 0 before there is a fleet."""
        return self._saved_size

    def arm_fleet_save(self, fleet: DeviceFleet, out: CData, size: int) -> int:
        """See core/arm_fleet.h."""
        room = self.device.allocate(size)
        self._launch_on(fleet, "fleet_save", saved=room, size=self._saved_size)
        self._copy_out(room, out, size)
        return OK

    def save_arm(self, fleet: DeviceFleet, arm: int) -> Memory:
        """Return what `Plant.save` returns, of an arm, on the device."""
        saved = self.device.allocate(self._saved_size)
        self.launch("fleet_save_arm", 1, fleet=fleet.memory, arm=arm, saved=saved)
        return saved

    def arm_fleet_restore(
        self, fleet: DeviceFleet, mask: CData, saved: bytes | Memory, size: int
    ) -> int:
        """See core/arm_fleet.h; there are as many bytes, which may be on the device."""
        if not isinstance(saved, Memory):
            saved = self.copy_in(FLEET.ffi.from_buffer(saved), size)
        return self._check_and_do(
            fleet,
            ("fleet_check_saved", "fleet_restore"),
            mask=self._mask(fleet, mask),
            saved=saved,
            size=self._saved_size,
            stride=0 if size == self._saved_size else self._saved_size,
        )

    def arm_fleet_run(
        self,
        fleet: DeviceFleet,
        first: int,
        arms: int,
        command: CData,
        rows: int,
        steps: int,
        q: CData,
    ) -> int:
        """See core/arm_fleet.h; of all arms, and the commands are finite."""
        size = 8 * rows * fleet.count * self._N
        commands, reached = self.copy_in(command, size), self.device.allocate(size)
        self._check_and_do(
            fleet,
            ("fleet_advance",),
            motion=_UNDER_ROWS,
            command=commands,
            periods=rows,
            steps=steps,
            q=reached,
        )
        self._copy_out(reached, q, size)
        return OK

    def arm_fleet_exchange(self, fleet: DeviceFleet, first: int, arms: int, command: CData) -> int:
        """See core/arm_fleet.h; of all arms."""
        rows = fleet.count * self._N
        self._keep_commands(fleet, view_bytes(command.joint, rows * _COMMAND))
        further = NULL
        if command.further != NULL:
            further = self.copy_in(command.further, 8 * rows * self._count_inputs())
        return self._step(fleet, 1, further=further, tick=command.tick)

    def put_commands(self, fleet: DeviceFleet, values: DeviceArray) -> None:
        """Set the commands that are held (count, N) [V, N m, A]."""
        joint = self._joint_commands(fleet)
        self._launch_on(fleet, "fleet_put_commands", value=cast_pointer(values), joint=joint)

    def arm_fleet_step(
        self,
        fleet: DeviceFleet,
        first: int,
        arms: int,
        command: CData,
        periods: int,
        measurement: CData,
        truth: CData,
    ) -> int:
        """See core/arm_fleet.h; of all arms, under the commands that were put.

        Measurement and truth have pointers of the device.
        """
        show = "fleet_observe", {"measurement": measurement[0], "truth": truth[0]}
        return self._step(fleet, periods, show, tick=-1)

    def _step(self, fleet: DeviceFleet, periods: int, *more: _Call, **values: Any) -> int:
        values |= {"motion": _UNDER_ZOH_COMMANDS, "joint": self._joint_commands(fleet)}
        values["periods"] = periods
        kernels = ("fleet_check_commands", values), ("fleet_advance", values), *more
        return self._check_and_do_each(fleet, kernels)

    def _advance(self, fleet: DeviceFleet, threads: int | None = None, **values: Any) -> None:
        """Let time go on, see core/fleet_kernels.h."""
        threads = fleet.groups if threads is None else threads
        call = _make_call("fleet_advance", fleet=fleet.memory, **values)
        smooth = _make_call("fleet_advance_to_event", fleet=fleet.memory, **values)
        if not (self._has_queue and call.step == NULL and self._find_smooth_functions(smooth)):
            self._module.launch("fleet_advance", threads, _view_call(call), block=self.block)
            return
        queue = self._room(fleet, "queue", 4 * (_QUEUE_BEGINS + fleet.groups))
        self.device.fill(queue, 0)
        call.queue = smooth.queue = cast_pointer(queue)
        for period in range(call.periods):
            smooth.period = call.period = period
            for module, kernel, given in (
                (self._smooth_module, "fleet_advance_to_event", smooth),
                (self._module, "fleet_advance", call),
            ):
                module.launch(kernel, threads, _view_call(given), block=self.block)

    def _find_smooth_functions(self, call: CData) -> bool:
        """Replace functions of the module of all kernels by those of the other; whether they are.

        Each module has copies of all functions.
        """
        for struct, name in ((call, "step_rows"), (call.way, "look")):
            function = getattr(struct, name)
            if function == NULL:
                continue
            address = self._smooth_functions.get(int(KERNELS.ffi.cast("uintptr_t", function)))
            if address is None:
                return False
            setattr(struct, name, KERNELS.ffi.cast(KERNELS.ffi.typeof(function), address))
        return True

    def _joint_commands(self, fleet: DeviceFleet) -> Memory:
        if "joint commands" not in fleet.rooms:
            commands = np.tile(make_commands(self._scene), (fleet.count, 1))
            self._keep_commands(fleet, commands.view(np.uint8))
        return fleet.rooms["joint commands"]

    def _keep_commands(self, fleet: DeviceFleet, commands: NDArray[np.uint8]) -> None:
        room = self._room(fleet, "joint commands", commands.size)
        self.device.write(room, commands)

    def reset_in_place(
        self,
        fleet: DeviceFleet,
        mask: DeviceArray,
        start: tuple[DeviceArray, DeviceArray],
        columns: Mapping[str, DeviceArray],
    ) -> int:
        """Reset arms; all numbers are on the device.

        Args:
            fleet: the arms.
            mask: a byte for each arm.
            start: link positions and speeds (count, N); those of other arms are not read.
            columns: varied numbers by name (count,), alike.

        Returns:
            ARM_REFUSED if a number is out of its range; then nothing has changed.
        """
        q, v = map(cast_pointer, start)
        rows = [
            {"place": self._place(name.encode()), "values": cast_pointer(values)}
            for name, values in columns.items()
        ]
        starts = {"q": q, "v": v, "bounds": self._bounds(fleet)}
        calls = [
            *(("fleet_check_parameters", row) for row in rows),
            ("fleet_check_start", starts),
            *(("fleet_set_parameters", row) for row in rows),
            ("fleet_reset", starts),
        ]
        return self._check_and_do_each(
            fleet, [(kernel, {"mask": cast_pointer(mask), **values}) for kernel, values in calls]
        )

    def _bounds(self, fleet: DeviceFleet) -> Memory:
        if "bounds" not in fleet.rooms:
            bounds = [np.broadcast_to(bound.most, self._N) for bound in bound_start(self._scene)]
            self._keep(fleet, "bounds", np.concatenate(bounds))
        return fleet.rooms["bounds"]

    def arm_fleet_follow(
        self,
        fleet: DeviceFleet,
        first: int,
        arms: int,
        control: CData,
        periods: int,
        schedule: CData,
        measurement: CData,
        truth: CData,
    ) -> int:
        """See core/arm_fleet.h; `look` and its data are of the device.

        Measurement and truth have pointers of the device.
        """
        own = FLEET.make_struct(
            "arm_fleet_way", look=schedule.look, **{"with": getattr(schedule, "with")}
        )
        links, stays = None, arms < fleet.count  # rows of the others stay as they are
        if schedule.links != NULL:
            links = self.device.allocate(8 * periods * fleet.count * self._N)
            if stays:
                self.device.write(links, view_bytes(schedule.links, links.size))
            own.links = cast_pointer(links)
        self._put_changes(fleet, schedule, own)
        threads = self.count_groups(arms)
        values = {
            "motion": _UNDER_CONTROL,
            "threads": threads,
            "joint": self._joint_commands(fleet),
            **{name: getattr(control, name) for name in ("step", "step_rows", "with")},
            "periods": periods,
            "way": own[0],
            "measurement": measurement[0],
        }
        seen = {"threads": threads, "measurement": measurement[0], "truth": truth[0]}
        kernels = (
            ("fleet_check_changes", values),
            ("fleet_advance", values),
            ("fleet_observe", seen),
        )
        result = self._check_and_do_each(fleet, kernels)
        if links is not None:
            self._copy_out(links, schedule.links, links.size)
        return result

    def look(self, fleet: DeviceFleet, schedule: CData) -> None:
        """Let a function of the device look at all arms, see `find_function`."""
        self._launch_on(fleet, "fleet_look", way=schedule[0])

    def find_function(self, name: str) -> int:
        """Return the address of a function of the device that ARM_ADDRESS names (core/kernel.hpp).

        Raises:
            Refusal: no variable has that name.
        """
        if name not in self._functions:
            own, smooth = (
                int(self.device.read(module.find_global_memory(name), np.uint64, (1,))[0])
                for module in (self._module, self._smooth_module)
            )
            self._functions[name], self._smooth_functions[own] = own, smooth
        return self._functions[name]

    def _put_changes(self, fleet: DeviceFleet, schedule: CData, own: CData) -> None:
        """Copy changes of arms, and the wrenches that they point to."""
        if schedule.change == NULL:
            return
        count = int(schedule.first_change[fleet.count])
        size = count * FLEET.get_size("arm_fleet_change")
        changes = view_bytes(schedule.change, size).view(FLEET.get_dtype("arm_fleet_change")).copy()
        pushes = np.flatnonzero(changes["wrench"])
        each = ARM.get_size("arm_wrench")
        wrenches = np.zeros((1, each), np.uint8)
        if len(pushes):
            # One gather by addresses: a loop over wrenches would take longer than their runs.
            hosts = changes["wrench"][pushes]
            span = view_bytes(
                ARM.ffi.cast("arm_wrench *", int(hosts.min())), int(np.ptp(hosts)) + each
            )
            wrenches = span[(hosts - hosts.min())[:, None] + np.arange(each, dtype=np.uint64)]
        wrench_array = self._keep(fleet, "wrenches", wrenches)
        changes["wrench"][pushes] = wrench_array.pointer + each * np.arange(len(pushes))
        own.change = cast_pointer(self._keep(fleet, "changes", changes.view(np.uint8)))
        first = view_bytes(schedule.first_change, 8 * (fleet.count + 1))
        own.first_change = cast_pointer(self._keep(fleet, "first_change", first))

    def _keep(self, fleet: DeviceFleet, purpose: str, array: NDArray[Any]) -> Memory:
        """Copy numbers to memory that lives until the next ones for the same purpose."""
        memory = fleet.rooms[purpose] = self.device.allocate(array.nbytes)
        self.device.write(memory, array)
        return memory

    def arm_fleet_measure(self, fleet: DeviceFleet, measurement: CData) -> int:
        """See core/arm_fleet.h."""
        return self._show(
            fleet, "measurement", measurement, self._sizes_of_measurement(fleet.count)
        )

    def arm_fleet_get_truth(self, fleet: DeviceFleet, truth: CData) -> int:
        """See core/arm_fleet.h."""
        return self._show(fleet, "truth", truth, self._sizes_of_truth(fleet.count))

    def _show(self, fleet: DeviceFleet, name: str, struct: CData, sizes: dict[str, int]) -> int:
        """Fill a struct of the processor."""
        own = FLEET.make_struct(f"arm_fleet_{name}")
        back: list[tuple[Memory, CData, int]] = []
        for field, size in sizes.items():
            host = getattr(struct, field)
            if host != NULL and size:
                room = self.device.allocate(size)
                setattr(own, field, cast_pointer(room))
                back.append((room, host, size))
        self._launch_on(fleet, "fleet_observe", **{name: own[0]})
        for room, host, size in back:
            self._copy_out(room, host, size)
        return OK

    def _sizes_of_measurement(self, count: int) -> dict[str, int]:
        rows = count * self._N
        return {
            "powered": count,
            "tick": 8 * count,
            "answered": 8 * count,
            "joint": rows * ARM.get_size("arm_joint_measurement"),
            "sensors": rows * ARM.get_size("arm_joint_sensors"),
            "imu": count * len(self._scene.imus) * ARM.get_size("arm_imu_measurement"),
            "current_d": 8 * rows,
            "readings": 8 * rows * self._count_readings(),
            "further": 8 * rows * self._count_inputs(),
        }

    def _sizes_of_truth(self, count: int) -> dict[str, int]:
        rows = dict.fromkeys(
            ("encoder", "current", "motor_angle", "motor_speed", "q", "v", "gear_torque"),
            8 * count * self._N,
        )
        return {"fault": 4 * count, "time": 8 * count, "energy": 8 * count, **rows}

    def _count_readings(self) -> int:
        return len(list_rows(self._scene)["readings"])

    def _count_inputs(self) -> int:
        return len(list_rows(self._scene)["further"])

    def _place(self, name: bytes) -> int:
        return [number.name for number in self._scene.varied].index(name.decode())

    def _mask(self, fleet: DeviceFleet, mask: CData) -> Memory | CData:
        return mask if mask == NULL else self.copy_in(mask, fleet.count)

    def _check_and_do(self, fleet: DeviceFleet, kernels: tuple[str, ...], **values: Any) -> int:
        """Launch kernels that check, and those that do nothing if an arm has refused."""
        return self._check_and_do_each(fleet, [(kernel, values) for kernel in kernels])

    def _check_and_do_each(self, fleet: DeviceFleet, calls: Sequence[_Call]) -> int:
        refused = self._room(fleet, "refused", 8)
        self.device.write(refused, np.full(2, NONE_REFUSED, np.int32))
        for kernel, values in calls:
            if kernel == "fleet_advance":
                self._advance(fleet, refused=refused, **values)
            else:
                self._launch_on(fleet, kernel, refused=refused, **values)
        lowest = int(self.device.read(refused, np.int32, (2,)).min())
        fleet.refused = -1 if lowest == NONE_REFUSED else lowest
        return OK if fleet.refused < 0 else REFUSED

    def _launch_on(
        self, fleet: DeviceFleet, kernel: str, threads: int | None = None, **values: Any
    ) -> None:
        self.launch(
            kernel, fleet.groups if threads is None else threads, fleet=fleet.memory, **values
        )

    def launch(self, kernel: str, threads: int, **values: Any) -> None:
        """Launch a kernel of core/fleet_kernels.h, with values of its struct."""
        call = _make_call(kernel, **values)
        self._module.launch(kernel, threads, _view_call(call), block=self.block)

    def _room(self, fleet: DeviceFleet, purpose: str, size: int) -> Memory:
        if purpose not in fleet.rooms:
            fleet.rooms[purpose] = self.device.allocate(size)
        return fleet.rooms[purpose]

    def copy_in(self, host: CData, size: int) -> Memory:
        """Return a copy of bytes of the processor."""
        memory = self.device.allocate(size)
        if size:
            self.device.write(memory, view_bytes(host, size))
        return memory

    def _copy_out(self, memory: Memory, host: CData, size: int) -> None:
        view_bytes(host, size)[:] = self.device.read(memory, np.uint8, (size,))


def _make_call(kernel: str, **values: Any) -> CData:
    places = {
        name: cast_pointer(value) if isinstance(value, Memory) else value
        for name, value in values.items()
    }
    return KERNELS.make_struct(f"{kernel}_call", **places)


def _view_call(call: CData) -> bytes:
    return bytes(KERNELS.ffi.buffer(call))


def view_bytes(host: CData, size: int) -> NDArray[np.uint8]:
    """Return bytes of the processor as an array that shares them."""
    return np.frombuffer(FLEET.ffi.buffer(FLEET.ffi.cast("char *", host), size), np.uint8)


def cast_pointer(memory: DevicePointer) -> CData:
    """Return the address of memory of a device."""
    return cast_address(memory.pointer)


def cast_address(address: int) -> CData:
    """Return an address as the structs of kernels take it."""
    return FLEET.ffi.cast("void *", address)
