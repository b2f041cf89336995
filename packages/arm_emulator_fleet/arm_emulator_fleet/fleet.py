"""Many arms of one scene, each with its own numbers and state, advanced side by side.

One public class, whose methods are the calls of a fleet, hence the length.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.extension.base import (
    ANY_COMMAND,
    ANY_COMMANDS,
    Array,
    Refusal,
    check_count,
    synchronized,
)
from arm_emulator.extension.compiler import C_NULL as NULL
from arm_emulator.extension.compiler import c_pointer as pointer
from arm_emulator.extension.machine import ARM_HEADER as ARM
from arm_emulator.extension.machine import ARM_REFUSED as REFUSED
from arm_emulator.extension.machine import (
    LARGEST_STEPS,
    BorrowedMachine,
    Commands,
    Diverged,
    Plant,
    Scene,
    arrange_further_rows,
    check_inputs,
    coerce_scene,
    make_commands,
)
from arm_emulator.extension.machine import STEPS_BETWEEN_CHECKS as PIECE
from arm_emulator_fleet.fleet_control import FleetControl, FleetFrame
from arm_emulator_fleet.fleet_machines import CoreMachines
from arm_emulator_fleet.fleet_schedule import FleetWay
from arm_emulator_fleet.unit import FLEET
from arm_emulator_fleet.work_threads import WorkThreads

_LOOK = "void (*)(void *, int32_t, int32_t)"


class Fleet(CoreMachines):
    """Arms of one structure. They are independent: each moves as a `Plant` alone, bit for bit.

    `measured` has the readings of the sensors, for controllers; `state` is the true state. Copies,
    forks and threads: as of a `Plant`. ``fleet[k]`` is one of the arms, and a `Plant`;
    ``fleet[3:7]`` is a list of them.

    Attributes:
        scene: of all arms.
        lanes: arms that advance together; 1 for scenes with two threads, or with a drive that is
            never in its usual modes: play, dry friction of a rotor behind an elastic gear.
        compute_count_angle: what one encoder count means at the link (N,) [rad or m].

    Args:
        scene: from `load_scene`, or what that takes: a name or a file.
        count: of arms.
        varied: values of numbers that the scene lists as varied, by name: one for all arms, or one
            each (count,). The scene's own where none are given.
        q: link positions, (N,) for all or (count, N) [rad or m]; the scene's start if None.
        v: link speeds alike [rad/s or m/s]; zero if None.
        workers: threads of the processor's lanes; None: as many as there are processor cores for
            this process.
        device: where the arms are, a thread for each few of them: "gpu" (the first card of NVIDIA),
            "gpu:1" (the second), or "processor", on which the kernels of cards run as loops; None:
            in the lanes of the processor.
        kernels: files in C++ that are compiled with the kernels of a device, behind them, such as
            functions for `FleetWay`; see core/kernel.hpp.

    Raises:
        Refusal: the scene's core cannot be compiled, no such device, a scene that it cannot
            advance, or an argument that makes no sense.
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        count: int,
        *,
        varied: Mapping[str, ArrayLike] | None = None,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        workers: int | None = None,
        device: str | None = None,
        kernels: Sequence[Path] = (),
    ) -> None:
        if workers is None:
            workers = len(os.sched_getaffinity(0)) if device is None else 1
        workers = check_count("Fleet", "workers", workers, 1, 4096)
        if device is not None and workers > 1:
            rule = "be 1 on a device, which divides its arms itself"
            raise Refusal("Fleet", "workers", rule, workers)
        self._kernels = _coerce_kernels(kernels, device)
        super().__init__(coerce_scene(scene, "Fleet"), count, device, self._kernels)
        self._arms: weakref.WeakValueDictionary[int, Plant] = weakref.WeakValueDictionary()
        self._shares = WorkThreads(self._count, self.lanes, workers)
        self._period_worth = self._count * self.scene.steps_per_period
        self._batch_size = self.lanes if device is None else self._count
        self._longest = max(1, PIECE * self._batch_size // self._period_worth)  # periods of a piece
        self._commands = np.tile(make_commands(self.scene), (self._count, 1))
        self._zoh_command = ARM.make_struct("arm_command", tick=-1, joint=self._commands)
        self.reset(q=q, v=v, varied=varied)

    def __del__(self) -> None:
        if hasattr(self, "_shares"):
            self._shares.end_threads()
        super().__del__()

    def __repr__(self) -> str:
        return f"<Fleet of {self._count} {self.scene.name}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore_fleet, self._of, self.__getstate__()

    @property
    def _of(self) -> tuple[Any, ...]:
        return self.scene, self._count, self._shares.workers, self.device, self._kernels

    def __copy__(self) -> Fleet:
        fleet = _restore_fleet(*self._of)
        fleet.__setstate__(self.__getstate__())
        return fleet

    @synchronized
    def __getstate__(self) -> bytes:
        return self.save()

    def __setstate__(self, saved: bytes) -> None:
        self.restore(saved)

    def __deepcopy__(self, memo: dict[int, object]) -> Fleet:
        return self.__copy__()

    def restart_threads(self) -> None:  # noqa: D102
        self._shares.start_threads()
        if self.scene.threads > 1:
            for arm in range(self._count):
                self.core.arm_begin_threads(self.core.arm_fleet_machine(self._fleet, arm))

    @overload
    def __getitem__(self, arm: int) -> Plant: ...
    @overload
    def __getitem__(self, arm: slice) -> list[Plant]: ...
    @synchronized
    def __getitem__(self, arm: int | slice) -> Plant | list[Plant]:
        """Return one of the arms as a `Plant`, or a list of them; they share the state.

        Raises:
            Refusal: no such arm, or the arms are on a device.
        """
        if self.device is not None:
            rule = "be in lanes of the processor for a single arm"
            raise Refusal("Fleet", "arms", rule, f"arms on {self.device}", "copy_arm")
        if isinstance(arm, slice):
            return [self[k] for k in range(self._count)[arm]]
        arm = check_count("Fleet", "arm", arm, -self._count, self._count - 1) % self._count
        if (view := self._arms.get(arm)) is not None:
            return view
        machine = self.core.arm_fleet_machine(self._fleet, arm)
        plant = self._arms[arm] = Plant(self.scene, of=BorrowedMachine(self, self.core, machine))
        weakref.finalize(plant, _give_back, weakref.WeakMethod(self._give_back), arm)
        return plant

    @synchronized
    def copy_arm(self, arm: int) -> Plant:
        """Return a `Plant` of its own that continues from where an arm is, to the last bit.

        Args:
            arm: its index.

        Raises:
            Refusal: no such arm.
        """
        arm = check_count("Fleet.copy_arm", "arm", arm, -self._count, self._count - 1)
        plant, saved = Plant(self.scene), self.save_arm(arm)
        if self.device is not None:
            saved = self.core.device.read(saved, np.uint8, (saved.size,)).tobytes()
        plant.restore(saved)
        return plant

    def _give_back(self, arm: int) -> None:
        """Return an arm that was used alone to its lane."""
        if self._fleet:
            self.core.arm_fleet_give_back(self._fleet, arm)

    def __iter__(self) -> Iterator[Plant]:
        return (self[arm] for arm in range(self._count))

    @synchronized
    def advance(self, command: Commands, steps: int) -> Array:
        """Take `steps` integration steps with the commands of the motors held.

        Args:
            command: (N,) for all arms or (count, N), or by names of all joints a number each or
                (count,) [V, N m, A]; clamped as the drives do, and 0 without power.
            steps: of `scene.integrator.dt`, 0 to 1e15.

        Returns:
            Link positions after them (count, N) [rad or m].

        Raises:
            Refusal: wrong shape, not finite, or no such count; the states are as before.
        """
        where = "Fleet.advance"
        steps = check_count(where, "steps", steps, 0, LARGEST_STEPS)
        q: Array = self._run_rows(self._arguments.read_commands(command, where)[np.newaxis], steps)[
            0
        ]
        return q

    def exchange(self, command: Commands, tick: int = -1, **further: Commands) -> None:
        """Advance by one servo period under commands that answer a tick, see `Plant.exchange`.

        An arm that diverges stays at its last sound state, and the others go on; see `diverged`.

        Args:
            command: as for `advance`.
            tick: that they answer; -1: none.
            further: inputs of motors beside their command, by name, given alike; 0 otherwise.

        Raises:
            Refusal: wrong shape, not finite, or an input that no motor has; nothing has changed.
        """
        where = "Fleet.exchange"
        rows = self._arguments.read_commands(command, where)
        tick = check_count(where, "tick", tick, -1)
        check_inputs(where, self.scene, further)
        named_rows = {
            name: self._arguments.read_commands(row, where, ANY_COMMAND.rename(name))
            for name, row in further.items()
        }
        others = arrange_further_rows(where, self.scene, named_rows, self._count)
        exchange = self.core.arm_fleet_exchange
        with self.turn:
            self._commands["value"] = rows
            places = {"joint": self._commands} | ({} if others is None else {"further": others})
            struct = ARM.make_struct("arm_command", tick=tick, **places)
            self._shares.do_work(
                self._period_worth, lambda *share: exchange(self._fleet, *share, struct)
            )

    @synchronized
    def step(
        self, command: Commands, periods: int = 1, out: FleetFrame | None = None
    ) -> FleetFrame:
        """Advance by servo periods with the commands of the motors held: the fast way for loops.

        As `exchange` and a look at `measured` and `state`, in one call and without copies. Energy
        and gear torques are in `state` alone. An arm that diverges stays at its last sound state,
        and the others go on.

        Args:
            command: as for `advance`.
            periods: servo periods, 0 to 1e9.
            out: of `frame`, to be filled; None: a new one.

        Returns:
            `out`.

        Raises:
            Refusal: wrong shape, not finite, no such count, or a frame of another fleet; nothing
                has changed.
        """
        where = "Fleet.step"
        periods = check_count(where, "periods", periods, 0, 10**9)
        out = self._check_frame(where, out)
        self._put_commands(where, command)
        step, fleet, zoh_command = self.core.arm_fleet_step, self._fleet, self._zoh_command
        places, results = (out.measurement, out.truth), []
        for _, some in self._divide_periods(periods):
            self._shares.do_work(
                self._period_worth * some,
                lambda *share, n=some: results.append(step(fleet, *share, zoh_command, n, *places)),
            )
            if REFUSED in results:  # of a device, whose commands nobody else checks
                raise self._make_refusal(where, "")
        return out

    def _put_commands(self, where: str, command: Any) -> None:
        """Set the commands that are held."""
        if self.device is None:
            self._commands["value"] = self._arguments.read_commands(command, where)
            return
        from arm_emulator_fleet.device_array import is_device_array, take_array

        if not is_device_array(command):
            command = self._arguments.read_commands(command, where)
        shape, name = (self._count, self._N), ANY_COMMAND.name
        rows = take_array(where, name, self.core.device, command, shape, np.float64)
        self.core.put_commands(self._fleet, rows)

    @synchronized
    def follow(
        self,
        control: FleetControl,
        periods: int,
        out: FleetFrame | None = None,
        *,
        links: Array | None = None,
        way: FleetWay | None = None,
        arms: int | None = None,
    ) -> FleetFrame:
        """Advance by servo periods under commands of control code in C, without Python in between.

        In each the control code reads the measurements of all arms, and commands the coming period.
        An arm that diverges stays at its last sound state; the others continue.

        Args:
            control: as `ServoFleet`, or a function of yours.
            periods: servo periods, 0 to 1e9.
            out: of `frame`, to be filled after the last of them; None: a new one.
            links: filled with the links' positions after each period (periods, count, N) [rad or
                m]; None: nothing.
            way: what is set in the arms at their ticks, and what looks at them; None: nothing.
            arms: only the first so many advance, and those in their groups of lanes; None: all.

        Returns:
            `out`.

        Raises:
            Refusal: wrong arrays, no such count, control code that cannot command this fleet, and
                nothing has changed; or a command that is not finite, and the arms of that group
                are where it came.
        """
        where = "Fleet.follow"
        if not isinstance(control, FleetControl):
            raise Refusal(where, "control", "be a FleetControl", control)
        periods = check_count(where, "periods", periods, 0, 10**9)
        out = self._check_frame(where, out)
        if links is not None:
            shape = periods, self._count, self._N
            fits = isinstance(links, np.ndarray) and links.shape == shape
            if not fits or links.dtype != np.float64 or not links.flags.carray:
                rule = f"be a contiguous array {shape} of float64"
                raise Refusal(where, "links", rule, getattr(links, "shape", links))
        self._place_control(where, control)
        control.begin(self.scene, self._count)
        of = self.scene, self._count
        if way is not None and (not isinstance(way, FleetWay) or way.of != of):
            raise Refusal(where, "way", "be a FleetWay for this fleet", way)
        if way is not None:
            self._place_look(where, way)
        by = FLEET.make_struct("arm_fleet_way") if way is None else way.struct
        if arms is not None:
            arms = check_count(where, "arms", arms, 1, self._count)
        arguments = FLEET.make_struct(
            "arm_fleet_control",
            joint=self._commands,
            **control.functions,
            **{"with": control.with_},
        )
        places = out.measurement, out.truth
        follow, fleet, refused = self.core.arm_fleet_follow, self._fleet, []

        def follow_arms(some: int, first: int, arms: int) -> None:
            if follow(fleet, first, arms, arguments, some, by, *places) == REFUSED:
                refused.append(first)

        for done, some in self._divide_periods(periods):
            by.links = NULL if links is None else pointer(links[done:])
            if arms is None:
                self._shares.do_work(self._period_worth * some, partial(follow_arms, some))
            else:
                follow_arms(some, 0, arms)
            if refused:
                raise self._make_refusal(where, "")
        return out

    def look(self, way: FleetWay) -> None:
        """Let the function of a way look at all arms as they are now.

        Raises:
            Refusal: a way of another fleet, or one without a function.
        """
        where = "Fleet.look"
        if not isinstance(way, FleetWay) or way.of != (self.scene, self._count) or not way.looks:
            raise Refusal(where, "way", "be a FleetWay for this fleet, with a look", way)
        self._place_look(where, way)
        with self.turn:
            if self.device is None:
                way.struct.look(getattr(way.struct, "with"), 0, self._count)
            else:
                self.core.look(self._fleet, way.struct)

    def _place_control(self, where: str, control: FleetControl) -> None:
        """Find the function of control code where the arms are."""
        if control.name is not None and self.device is not None:
            control.place_function(self.core.find_function)
        elif control.name is not None or control.device != self.device:
            rule = f"run where the fleet is, on {self.device or 'the processor'}"
            place = f"on {control.device or 'the processor'}"
            raise Refusal(where, "control", rule, control.name or place)

    def _place_look(self, where: str, schedule: FleetWay) -> None:
        """Find the function of a way where the arms are."""
        if schedule.looks and (schedule.look_name is None) != (self.device is None):
            rule = "be a pointer in lanes, and on a device a name"
            raise Refusal(where, "look", rule, schedule.look_name or "a function of the processor")
        if schedule.look_name is not None:
            address = self.core.find_function(schedule.look_name)
            FLEET.fill_struct(schedule.struct, look=FLEET.ffi.cast(_LOOK, address))

    def _divide_periods(self, periods: int) -> Iterator[tuple[int, int]]:
        """Yield begin and length of pieces between checks for Ctrl-C."""
        for done in range(0, periods or 1, self._longest):
            yield done, min(self._longest, periods - done)

    def _check_frame(self, where: str, out: FleetFrame | None) -> FleetFrame:
        out = self.frame() if out is None else out
        of = self.scene, self._count, self.device
        if not isinstance(out, FleetFrame) or out.of != of:
            raise Refusal(where, "out", "be a frame of this fleet", out)
        return out

    def frame(self) -> FleetFrame:
        """Return arrays for `step` and `follow` to fill; on a device, a `DeviceFrame`."""
        if self.device is None:
            return FleetFrame(self.scene, self._count)
        from arm_emulator_fleet.device_frame import DeviceFrame

        return DeviceFrame(self.scene, self._count, self.device, self.core)

    @synchronized
    def run(self, commands: ArrayLike, steps: int) -> Array:
        """Apply rows of commands one after the other.

        An arm that diverges stays at its last sound state, and the others go on; see `diverged`.

        Args:
            commands: (K, N) for all arms or (K, count, N) [V, N m, A].
            steps: integration steps under each row, >= 0; with all rows at most 1e15.

        Returns:
            Link positions after each row, (K, count, N) [rad or m].

        Raises:
            Refusal: wrong shape, not finite, or no such count; the states are as before.
        """
        where, N = "Fleet.run", self._N
        rows = ANY_COMMANDS.check_numbers(where, commands)
        if rows.ndim == 2 and rows.shape[1] == N:
            rows = np.repeat(rows[:, np.newaxis], self._count, axis=1)
        if rows.ndim != 3 or rows.shape[1:] != (self._count, N):
            rule = f"have shape (K, {N}) or (K, {self._count}, {N})"
            raise Refusal(where, ANY_COMMANDS.name, rule, rows.shape)
        steps = check_count(where, "steps", steps, 0, LARGEST_STEPS // max(1, len(rows)))
        return self._run_rows(rows, steps)

    @property
    @synchronized
    def diverged(self) -> dict[int, Diverged]:
        """Reasons for which arms have stopped, by their index."""
        get_arm = self.__getitem__ if self.device is None else self.copy_arm
        divergences = {
            int(arm): get_arm(int(arm)).diverged for arm in np.flatnonzero(self.faults >= 0)
        }
        return {arm: why for arm, why in divergences.items() if why is not None}

    def _run_rows(self, rows: Array, steps: int) -> Array:
        # A sum is quick, and not finite if any of them is not.
        if not np.isfinite(rows.sum()):
            ANY_COMMANDS.check_values("Fleet.run", rows)
        rows = np.ascontiguousarray(rows)
        q = np.empty_like(rows)
        longest = max(1, PIECE * self._batch_size // self._count)  # steps between checks for Ctrl-C
        if steps > longest:
            for row, after in zip(rows, q, strict=True):
                for done in range(0, steps, longest):
                    self._advance_arms(
                        row[np.newaxis], min(longest, steps - done), after[np.newaxis]
                    )
            return q
        at_once = longest // max(1, steps)
        for first in range(0, len(rows), at_once):
            end = first + at_once
            self._advance_arms(rows[first:end], steps, q[first:end])
        return q

    def _advance_arms(self, rows: Array, steps: int, q: Array) -> None:
        arguments = pointer(rows), len(rows), steps, pointer(q)
        run = self.core.arm_fleet_run
        worth = rows[..., 0].size * steps
        self._shares.do_work(worth, lambda *share: run(self._fleet, *share, *arguments))


def _restore_fleet(
    scene: Scene,
    count: int,
    workers: int,
    device: str | None = None,
    kernels: Sequence[Path] = (),
) -> Fleet:
    """Return a fleet like one that was pickled, before its state."""
    return Fleet(scene, count, workers=workers, device=device, kernels=kernels)


def _give_back(method: weakref.WeakMethod[Callable[[int], None]], arm: int) -> None:
    give_back = method()
    if give_back is not None:
        give_back(arm)


def _coerce_kernels(kernels: object, device: str | None) -> tuple[Path, ...]:
    """Return the files of kernels.

    Raises:
        Refusal: no list of files that exist, or files for the processor's lanes.
    """
    if not isinstance(kernels, list | tuple):
        raise Refusal("Fleet", "kernels", "be a list of files", kernels)
    if kernels and device is None:
        raise Refusal("Fleet", "kernels", "be none in lanes of the processor", kernels)
    for file in kernels:
        if not (isinstance(file, str | Path) and Path(file).is_file()):
            raise Refusal("Fleet", "kernels", "be files", file)
    return tuple(map(Path, kernels))
