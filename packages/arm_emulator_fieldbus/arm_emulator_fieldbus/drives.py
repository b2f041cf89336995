"""All drives of a scene behind one machine: core/drives.h, called from Python."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

from arm_emulator.extension.base import Refusal, read_shaft_limits
from arm_emulator.extension.compiler import CData, Library
from arm_emulator.extension.machine import (
    Joint,
    Plant,
    Scene,
    list_further_inputs,
    list_modes,
    list_withheld_modes,
)
from arm_emulator.extension.runs import ServoConfig, ServoRows, check_servo, make_servo_numbers
from arm_emulator_fieldbus import declared
from arm_emulator_fieldbus.drives_unit import DRIVES, UNITS, drives_library
from arm_emulator_fieldbus.object_dictionary import (
    REALS,
    SIGNED,
    Aborted,
    ObjectEntry,
    modes,
    read_entries,
)

_HOME_OFFSETS = {
    "home_to_zero": DRIVES.get_constant("DRIVES_HOME_TO_ZERO"),
    "zero_to_home": DRIVES.get_constant("DRIVES_ZERO_TO_HOME"),
}
_SDO_REPLIES = DRIVES.get_constant("DRIVES_SDO_REPLIES")


@dataclass(frozen=True)
class SavedDrives:
    """Machine and drives at one moment."""

    machine: bytes = field(repr=False)
    drives: CData = field(repr=False)
    owner: Drives = field(repr=False)

    def __len__(self) -> int:
        size = self.owner.calls.drives_state_size(self.owner.pointer)
        return len(self.machine) + int(size)


class Drives:
    """CiA 402 drives, one per joint of a scene in its order, on a plant.

    Attributes:
        plant: the machine.
        withheld: the modes that drives do not offer (0x6502), because they would not hold the
            machine.
        calls: the library.
        pointer: to ``drives``.

    Args:
        plant: the machine.
        servo: gains and data sheets of its joints, in any order.
        bus: ETHERCAT or CANOPEN.
        calls: the library, if it has more in it than `drives_library`.

    Raises:
        Refusal: a motor that our servo cannot drive, a servo of other joints or of another period.
    """

    def __init__(
        self, plant: Plant, servo: ServoConfig, bus: int, calls: Library | None = None
    ) -> None:
        self.plant = plant
        self.calls = calls or drives_library()
        scene = plant.scene
        check_servo(scene, servo)
        self._joints = _make_joints(scene, servo)
        self.withheld = list_withheld_modes(scene, servo, modes())
        for loop in self.withheld:
            self._joints["modes"][loop.joint] &= 0xFFFFFFFF ^ 1 << loop.mode.number - 1
        names = [_make_text(name) for name in (*scene.joint_names, scene.name)]
        self._joints["name"] = [int(DRIVES.ffi.cast("uintptr_t", name)) for name in names[:-1]]
        places, inputs = declared.find_places(scene, UNITS), declared.find_input_rows(scene)
        faults = [_make_text(fault.varied.name) for fault in scene.faults]
        fault = DRIVES.ffi.new("char *[]", faults)
        self._referenced = names, places, inputs, faults, fault  # they must outlive the drives
        self._machine = DRIVES.make_struct(
            "drives_machine",
            bus=bus,
            home_offset=_HOME_OFFSETS[scene.home_offset],
            at=plant.ticks,
            supply_voltage=scene.supply_voltage,
            device_name=names[-1],
            joint=self._joints,
            further=len(list_further_inputs(scene)),
            outputs=len(declared.REPORTED),
            inputs=len(declared.TAKEN),
            place=places,
            input=inputs,
            get_parameter=plant.core.arm_get_parameter,
            set_parameter=plant.core.arm_set_parameter,
            faults=len(faults),
            fault=fault,
        )
        self.pointer = self.calls.drives_new(self._machine)
        self._room = DRIVES.ffi.new("uint8_t[]", 256)
        self._replies = DRIVES.ffi.new("uint8_t[]", 8 * _SDO_REPLIES)
        self._size = DRIVES.ffi.new("uint32_t *")
        self._entries = {(entry.index, entry.sub): entry for entry in read_entries(self.calls)}

    def __del__(self) -> None:
        pointer, self.pointer = getattr(self, "pointer", None), None
        if pointer:
            self.calls.drives_delete(pointer)

    @property
    def entries(self) -> tuple[ObjectEntry, ...]:
        """All entries of the dictionary, in ascending order."""
        return tuple(self._entries.values())

    @property
    def tick(self) -> int:
        """Number of the present tick."""
        return int(self.calls.drives_tick(self.pointer))

    def begin(self) -> None:
        """Begin anew at the present state of the machine, after its reset or restore."""
        self.calls.drives_begin(self.pointer)

    def save(self) -> SavedDrives:
        """Return machine and drives as they are now, for `restore` of these drives."""
        state = self.calls.drives_save(self.pointer)
        saved = DRIVES.ffi.gc(state, self.calls.drives_state_delete)
        return SavedDrives(self.plant.save(), saved, self)

    def restore(self, saved: SavedDrives) -> None:
        """Go on from the tick at which `save` of these drives has returned this, to the last bit.

        Transfers of service data in progress end.

        Raises:
            Refusal: something else; nothing has changed.
        """
        if not isinstance(saved, SavedDrives) or saved.owner is not self:
            raise Refusal("drives", "saved", "be what `save` of the same drives returned", saved)
        self.plant.restore(saved.machine)
        self.calls.drives_restore(self.pointer, saved.drives)

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods, as a run of `Timeline`; see `period`."""
        self.period(ticks)

    def period(self, periods: int = 1) -> None:
        """Advance by so many servo periods.

        Raises:
            Refusal: the machine refused a command.
            Diverged: the machine did; the drives are in Fault.
        """
        self.plant.exchange_in(lambda: int(self.calls.drives_periods(self.pointer, periods)))

    def upload_entry(self, drive: int, index: int, sub: int = 0) -> bytes:
        """Return the bytes of an entry, little-endian.

        Raises:
            Aborted: no such entry, or it cannot be read.
        """
        code = self.calls.drives_read(
            self.pointer, drive, index, sub, self._room, len(self._room), self._size
        )
        if code:
            raise Aborted(index, sub, code)
        return bytes(DRIVES.ffi.buffer(self._room, self._size[0]))

    def download_entry(self, drive: int, index: int, sub: int, value: bytes) -> None:
        """Write bytes to an entry.

        Raises:
            Aborted: it is not taken, and nothing has changed.
        """
        code = self.calls.drives_write(self.pointer, drive, index, sub, value, len(value))
        if code:
            raise Aborted(index, sub, code)

    def read(self, drive: int, index: int, sub: int = 0) -> int:
        """Return the whole number that an entry holds.

        Raises:
            Aborted: see `upload_entry`.
        """
        value = self.upload_entry(drive, index, sub)
        return int.from_bytes(value, "little", signed=self._entries[index, sub].type in SIGNED)

    def read_number(self, drive: int, index: int, sub: int = 0) -> float:
        """Return the number that an entry of any type holds.

        Raises:
            Aborted: see `upload_entry`.
        """
        layout = REALS.get(self._entries[index, sub].type)
        if layout is None:
            return self.read(drive, index, sub)
        (value,) = struct.unpack(layout, self.upload_entry(drive, index, sub))
        return float(value)

    def write(self, drive: int, index: int, value: int, sub: int = 0) -> None:
        """Write a number to an entry, in as many bytes as it has.

        Raises:
            Aborted: see `download_entry`; or a number that so many bytes do not hold.
        """
        value = max(-(2**63), min(value, 2**63 - 1))  # beyond what any entry holds
        code = self.calls.drives_write_number(self.pointer, drive, index, sub, value)
        if code:
            raise Aborted(index, sub, code)

    def write_real(self, drive: int, index: int, value: float) -> None:
        """Write a number to an entry of type REAL32 or REAL64.

        Raises:
            Aborted: see `download_entry`.
        """
        layout = REALS[self._entries[index, 0].type]
        self.download_entry(drive, index, 0, struct.pack(layout, value))

    def set_entry(self, drive: int, index: int, value: int, sub: int = 0) -> None:
        """Set an entry that belongs to the bus, whatever its access and range."""
        is_set = self.calls.drives_set(self.pointer, drive, index, sub, value)
        assert is_set, "the dictionary has it"

    def serve_sdo(self, drive: int, request: bytes) -> list[bytes]:
        """Return the replies of a drive's SDO server on CANopen to a request of 8 bytes."""
        count = self.calls.drives_sdo(self.pointer, drive, request, self._replies)
        raw = bytes(DRIVES.ffi.buffer(self._replies, 8 * count))
        return [raw[k : k + 8] for k in range(0, len(raw), 8)]

    def begin_sdo(self, drive: int) -> None:
        """Forget a transfer of that server that is under way."""
        self.calls.drives_sdo_begin(self.pointer, drive)

    def count_communication_writes(self, drive: int) -> int:
        """Return how often an object of a drive's communication, 0x1005 to 0x1FFF, was written."""
        return int(self.calls.drives_communication(self.pointer, drive))

    def count_periods_per_target(self, drive: int) -> int:
        """Return the number of servo periods in a drive's interpolation time."""
        return int(self.calls.drives_periods_per_target(self.pointer, drive))

    def set_cycle(self, drive: int, cycle: int) -> None:
        """Report to a drive the cycle of the bus in which targets come [ns]; 0: unknown."""
        self.calls.drives_set_cycle(self.pointer, drive, cycle)

    def report_loss(self, drive: int = -1, error: int = 0x8100) -> None:
        """Report to a drive, -1: all, that its master is gone."""
        self.calls.drives_lost(self.pointer, drive, error)

    def lock_mapping(self, locked: bool, drive: int = -1) -> None:
        """Forbid or allow changes of the mapping of process data."""
        self.calls.drives_lock_mapping(self.pointer, drive, locked)

    def restart_drive(self, drive: int = -1) -> None:
        """Return a drive, -1: all, to its initial state."""
        self.calls.drives_restart(self.pointer, drive)


def _make_text(words: str) -> CData:
    return DRIVES.ffi.new("char[]", words.encode())


def _make_joints(scene: Scene, servo: ServoConfig) -> ServoRows:
    """Return rows of ``drives_joint`` in the scene's order of joints; names are left out."""
    servo_joints = {joint.name: joint for joint in servo.joints}
    reported = tuple(servo_joints[name] for name in scene.joint_names)
    rows = DRIVES.make_rows("drives_joint", len(reported))
    rows["servo"] = make_servo_numbers(reported, servo.period, servo.supply_voltage)
    limits = read_shaft_limits(scene.urdf, scene.joint_names)
    for row, joint, takes in zip(rows, scene.joints, list_modes(scene), strict=True):
        if not math.isfinite(
            servo_joints[joint.name].compute_largest_command(servo.supply_voltage)
        ):
            where = f"servo.joints.{joint.name}.current_limit"
            rule = "be given: the rated torque of its drive (0x6076) follows from it"
            raise Refusal(scene.where, where, rule, "nothing")
        row["counts_per_turn"] = joint.counts_per_turn
        row["lower"], row["upper"] = _count_limits(joint, limits.get(joint.name))
        row["brake"] = joint.brake is not None
        row["index"] = joint.encoder is not None and joint.encoder.index != "none"
        row["stops"] = joint.stops is not None
        row["mode"] = takes
        row["motor_type"] = 0 if joint.motor is None else joint.motor.cia_type
        row["modes"] = sum(1 << mode.number - 1 for mode in modes())
    return rows


_FARTHEST = 2**31 - 1  # counts


def _count_limits(joint: Joint, limits: tuple[float, float] | None) -> tuple[int, int]:
    """Return the counts between which a joint is within its limits [rad or m]."""
    if limits is None:
        return -_FARTHEST - 1, _FARTHEST
    per_rad = joint.counts_per_turn / (2.0 * math.pi) / joint.gear.ratio
    low, high = sorted(per_rad * limit for limit in limits)
    return max(math.ceil(low), -_FARTHEST - 1), min(math.floor(high), _FARTHEST)
