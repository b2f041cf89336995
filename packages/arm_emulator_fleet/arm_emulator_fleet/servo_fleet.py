"""Our servo on every arm of a fleet, in their lanes: servo_fleet.cpp."""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.extension.base import (
    EFFORT,
    POSITION,
    VELOCITY,
    Array,
    Number,
    Refusal,
    check_count,
    check_whole_numbers,
)
from arm_emulator.extension.compiler import BOUNDARY_FOLDER as BOUNDARY
from arm_emulator.extension.compiler import C_NULL as NULL
from arm_emulator.extension.compiler import SERVO_FOLDER, CData, Library, Unit
from arm_emulator.extension.compiler import SHARED_FLAGS as SHARED
from arm_emulator.extension.compiler import c_pointer as pointer
from arm_emulator.extension.compiler import compiled_library as library
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.runs import (
    ServoConfig,
    check_joints,
    check_servo,
    count_nanoseconds,
    load_servo_config,
    make_servo_numbers,
)
from arm_emulator.extension.runs import ServoDrives as ServoArm
from arm_emulator_fleet.fleet import Fleet
from arm_emulator_fleet.fleet_arguments import choose_arms
from arm_emulator_fleet.fleet_control import FleetControl
from arm_emulator_fleet.unit import FOLDER, SERVOS

_MAX_PERIODS = 10**9

if TYPE_CHECKING:
    from arm_emulator_fleet.device_servos import DeviceServos


# The bits are those of the servo in C, see `arm_emulator.toolchain.flags.C_FLAGS`.
_FLAGS = (*"-std=c++20 -O2 -ffp-contract=off -fno-semantic-interposition".split(), *SHARED)


def _load_servos(fleet: Fleet) -> Library | DeviceServos:
    if isinstance(fleet.core, Library):
        return _load_library(fleet.lanes)
    # Nothing of it is loaded for the processor's lanes.
    from arm_emulator_fleet.device_servos import DeviceServos

    return DeviceServos(fleet.core)


@cache
def _load_library(lanes: int) -> Library:
    return library(build_servo_unit(lanes))


def build_servo_unit(lanes: int) -> Unit:
    """Return servo and loop for arms in so many lanes as what is compiled."""
    source = f'#define SERVO_FLEET_LANES {lanes}\n#include "servo_fleet.cpp"\n'
    about = f"the servos of a fleet in {lanes} lanes"
    folders = (SERVO_FOLDER, BOUNDARY, FOLDER)
    return Unit("servo_fleet", source, _FLAGS, folders, (SERVOS,), "servo", about, "servo.c")


class ServoFleet(FleetControl):
    """A servo under its watchdog on every arm of a fleet, for `Fleet.follow`.

    Each does what `Drives` does alone, to the last bit: measure, aim, command. Without targets the
    arms are held where they stand.

    Args:
        fleet: of arms.
        config: data-sheet values, gains and limits, or what `load_servo_config` takes; or a
            sequence with one for each arm.

    Raises:
        Refusal: a config that does not fit the scene, or not one for each arm.
    """

    def __init__(
        self, fleet: Fleet, config: ServoConfig | str | Path | Sequence[ServoConfig]
    ) -> None:
        if not isinstance(fleet, Fleet):
            raise Refusal("ServoFleet", "fleet", "be a Fleet", fleet)
        scene, self._count = fleet.scene, len(fleet)
        several = not isinstance(config, ServoConfig | str) and isinstance(config, Iterable)
        configs: list[Any] = [*config] if several else [config]  # type: ignore[misc]
        if len(configs) not in (1, self._count):
            rule = f"be one, or one for each of {self._count} arms"
            raise Refusal("ServoFleet", "config", rule, len(configs))
        read = [
            load_servo_config(source) if isinstance(source, str | Path) else source
            for source in configs
        ]
        for servo_config in read:
            if not isinstance(servo_config, ServoConfig):
                raise Refusal(
                    "ServoFleet", "config", "be a ServoConfig, a name or a file", servo_config
                )
            check_servo(scene, servo_config)
        if len({servo_config.joint_names for servo_config in read}) > 1:
            raise Refusal("ServoFleet", "config", "have the joints in one order", "several")
        self._scene, self._N = scene, len(scene.joints)
        self._joint_names = read[0].joint_names
        self._period, self._hold_after = (
            scene.servo_period,
            min(servo_config.hold_after for servo_config in read),
        )
        self._place = np.array([scene.joint_names.index(n) for n in read[0].joint_names], np.int32)
        drives = [ServoArm(servo_config) for servo_config in read]
        self._drives = drives  # they own the numbers
        N, count = self._N, self._count
        self._calls: Library | DeviceServos = _load_servos(fleet)
        self._arms = SERVOS.ffi.new("servo[]", count)
        for k in range(count):
            self._arms[k] = drives[k % len(drives)].servo.arm[0]
        self._rows: tuple[Any, ...] = ()
        self.struct: CData = SERVOS.make_struct(
            "servo_fleet",
            joints=N,
            arm=self._arms,
            place=self._place,
            period=round(self._period * 1e9),
            periods_per_row=1,
        )
        self._calls.servo_fleet_begin(self.struct, count)
        weakref.finalize(self, self._calls.servo_fleet_end, self.struct)
        if isinstance(self._calls, Library):
            step = int(SERVOS.ffi.cast("uintptr_t", self._calls.servo_fleet_step))
            super().__init__(step, int(SERVOS.ffi.cast("uintptr_t", self.struct)), in_lanes=True)
        else:
            self.device, self.functions, self.with_ = fleet.device, {}, self._calls.pointer
            self.name = None

    def __repr__(self) -> str:
        return f"<ServoFleet of {self._count} {self._scene.name}>"

    def aim(
        self,
        q: ArrayLike,
        v: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        *,
        every: int = 1,
    ) -> None:
        """Set rows of joint targets that the servos follow from their reset on.

        Each holds for `every` servo periods, and goes on with its speed meanwhile. The last one
        stays.

        Args:
            q: link angles, (K, N) for all arms or (K, count, N) [rad or m], in the scene's order
                of joints.
            v: link speeds with which they go on, alike [rad/s or m/s]; None: 0.
            tau: link torques known beforehand, alike [N m or N]; None: 0.
            every: servo periods of a row.

        Raises:
            Refusal: wrong shapes, not finite, too large, or rows so seldom that the servos would
                take their targets for late; nothing has changed.
        """
        where = "ServoFleet.aim"
        every = check_count(where, "every", every, 1, _MAX_PERIODS)
        if every * self._period > self._hold_after:
            rule = f"be at most {int(self._hold_after / self._period)}: hold_after of the servo"
            raise Refusal(where, "every", rule, every)
        rows = [self._read_targets(where, POSITION.rename("q"), q)]
        for bound, values in ((VELOCITY.rename("v"), v), (EFFORT.rename("tau"), tau)):
            targets = None if values is None else self._read_targets(where, bound, values)
            if targets is not None and targets.shape != rows[0].shape:
                raise Refusal(
                    where, bound.name, f"have the shape of q, {rows[0].shape}", targets.shape
                )
            rows.append(targets)  # type: ignore[arg-type]
        self._rows = tuple(rows)
        self.struct.since = NULL
        of_arms = rows[0].ndim == 3
        places = [NULL if row is None else pointer(row) for row in rows]
        SERVOS.fill_struct(
            self.struct,
            rows=len(rows[0]),
            periods_per_row=every,
            row_stride=self._N * (self._count if of_arms else 1),
            arm_stride=self._N if of_arms else 0,
            **dict(zip(("q", "v", "tau"), places, strict=True)),
        )
        for k in range(self._count):
            self._arms[k].motion_period = every * round(self._period * 1e9)
        self._calls.servo_fleet_aim(self.struct, self._count)

    def aim_at(self, since: ArrayLike, q: ArrayLike, first: ArrayLike) -> None:
        """Set rows of joint targets for each arm, which hold from periods on since its reset.

        A target is given in every period, the newest one again until the next, as
        `arm_emulator.runs.table_run` does.

        Args:
            since: periods of the rows (K,), of each arm ascending from 0.
            q: link angles (K, N) [rad or m], in the scene's order of joints.
            first: place of the first row of each arm, and the end (count + 1,).

        Raises:
            Refusal: wrong shapes, not finite, too large, or periods that do not ascend from 0;
                nothing has changed.
        """
        where = "ServoFleet.aim_at"
        periods = check_whole_numbers(where, "since", since)
        places = check_whole_numbers(where, "first", first)
        rows = POSITION.rename("q").check_numbers(where, q)
        POSITION.rename("q").check_values(where, rows)
        shape = len(periods), self._N
        if rows.shape != shape:
            raise Refusal(where, "q", f"have shape {shape}", rows.shape)
        if places.shape != (self._count + 1,) or places[0] != 0 or places[-1] != len(periods):
            rule = f"be {self._count + 1} places from 0 to {len(periods)}"
            raise Refusal(where, "first", rule, places)
        begins = np.isin(np.arange(len(periods)), places[:-1])
        ascend = np.diff(periods, prepend=-1) > 0
        if np.any(np.diff(places) <= 0) or np.any(periods[begins]) or not np.all(begins | ascend):
            raise Refusal(where, "since", "ascend from 0 for each arm", periods)
        self._rows = np.ascontiguousarray(rows[:, self._place]), periods, places
        self._row = places[:-1].copy()
        SERVOS.fill_struct(
            self.struct,
            q=self._rows[0],
            since=periods,
            first_row=places,
            row=self._row,
        )
        for k in range(self._count):
            motion_period = self._drives[k % len(self._drives)].servo.config.motion_period
            self._arms[k].motion_period = count_nanoseconds(motion_period)
        self._calls.servo_fleet_aim(self.struct, self._count)

    def retune(self, arm: int, config: ServoConfig) -> None:
        """Change gains and limits of an arm's servo; what was observed and the integrals stay.

        Raises:
            Refusal: no such arm, other joints or another order of them, or numbers that cannot be
                computed with; nothing has changed.
        """
        where = "ServoFleet.retune"
        arm = check_count(where, "arm", arm, 0, self._count - 1)
        check_joints(where, config, self._joint_names)
        rows = make_servo_numbers(config.joints, config.period, config.supply_voltage)
        joints = SERVOS.make_pointer("servo_joint", rows)
        self._calls.servo_fleet_retune(self.struct, arm, joints)

    def _read_targets(self, where: str, bound: Number, values: ArrayLike) -> Array:
        numbers = bound.check_numbers(where, values)
        shapes = (self._N,), (self._count, self._N)
        if numbers.ndim not in (2, 3) or numbers.shape[1:] not in shapes or not len(numbers):
            rule = f"have shape (K, {self._N}) or (K, {self._count}, {self._N})"
            raise Refusal(where, bound.name, rule, numbers.shape)
        bound.check_values(where, numbers)
        return np.ascontiguousarray(numbers[..., self._place])

    def reset(self, arms: ArrayLike | None = None) -> None:
        """Forget what was measured; targets begin with their first row again.

        Args:
            arms: a mask (count,) or indices; None: all.

        Raises:
            Refusal: no such arms.
        """
        mask = choose_arms("ServoFleet.reset", arms, self._count)
        self._calls.servo_fleet_reset(self.struct, self._count, pointer(mask.view(np.uint8)))

    def begin(self, scene: Scene, count: int) -> None:
        """Refuse a fleet of another scene or count, see `FleetControl.begin`."""
        if scene is not self._scene or count != self._count:
            rule = f"be {self._count} arms of the same scene"
            raise Refusal("ServoFleet", "fleet", rule, f"{count} {scene.name}")
