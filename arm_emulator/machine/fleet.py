"""Many arms of one scene, each with numbers and a state of its own, advanced side by side."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.count import check_count
from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import pointer
from arm_emulator.machine.chain import Array
from arm_emulator.machine.compiler import fleet_library_of
from arm_emulator.machine.core_calls import FLEET, PLACES
from arm_emulator.machine.plant import (
    LARGEST_STEPS,
    PIECE,
    ROWS,
    Borrowed,
    Diverged,
    Plant,
    as_numbers,
    check_start,
    options_of,
)
from arm_emulator.machine.scene import Scene

SHARES_OF_WORKER = 4
WORTH_A_THREAD = 5000  # steps of arms in one call; fewer take no longer than it takes to share them
LARGEST_FLEET = 10**6  # arms; some 10 kB each


@dataclass(frozen=True)
class FleetState:
    """States of all arms: a row each, and in a row the joints, base to tool."""

    t: Array  # (count,) s; arms that have diverged stay where they are
    energy: Array  # (count,) J
    current: Array  # (count, N) A
    theta_m: Array  # rad, motor angle
    omega_m: Array  # rad/s, motor speed
    q: Array  # rad or m, link side
    v: Array  # rad/s or m/s, link side
    gear_torque: Array  # N m or N, on the link
    encoder_counts: NDArray[np.int64]  # (count, N), at the motor, as the encoders tell them


class Fleet:
    """Arms of one structure. They know nothing of each other: each moves as a `Plant` alone.

    In lanes of vector registers they take the same steps at the same time, which rounds otherwise
    than a single arm's: after a step they differ by some 1e-16 of their size.

    Attributes:
        scene: of all arms.
        lanes: arms that advance together; 1 for scenes with two threads or located events.

    Args:
        scene: from `arm_emulator.machine.scene.load_scene`.
        count: of arms.
        varied: values of numbers that the scene lists as varied, by name: one for all arms, or one
            each (count,). The scene's own where none are given.
        q: link positions, (N,) for all or (count, N) [rad or m]; the scene's start if None.
        v: link speeds alike [rad/s or m/s]; zero if None.
        workers: threads; None: as many as there are processor cores for this process.

    Raises:
        Refusal: the scene's core cannot be compiled, or an argument that makes no sense.
    """

    def __init__(
        self,
        scene: Scene,
        count: int,
        *,
        varied: Mapping[str, ArrayLike] | None = None,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        workers: int | None = None,
    ) -> None:
        check_count("Fleet", "count", count, 1, LARGEST_FLEET)
        if workers is None:
            workers = len(os.sched_getaffinity(0))
        check_count("Fleet", "workers", workers, 1, 4096)
        self.scene, self._count, self._N = scene, int(count), len(scene.joints)
        self.core = fleet_library_of(scene)
        self.lanes = int(self.core.arm_fleet_lanes())
        values = self._values(varied or {})
        options = options_of(scene, values)
        self._fleet = self.core.arm_fleet_new(options, self._count)
        groups = -(-self._count // self.lanes)
        workers = min(workers, groups)
        # More shares than workers: cores need not be equally fast.
        shares = min(SHARES_OF_WORKER * workers if workers > 1 else 1, groups)
        bounds = [groups * k // shares * self.lanes for k in range(shares + 1)]
        self._shares = [
            (first, min(end, self._count) - first) for first, end in itertools.pairwise(bounds)
        ]
        self._pool = ThreadPoolExecutor(workers) if workers > 1 else None
        self.reset(q, v)

    def __del__(self) -> None:
        fleet, self._fleet = getattr(self, "_fleet", None), None
        if fleet:
            if self._pool:
                self._pool.shutdown()
            self.core.arm_fleet_delete(fleet)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, arm: int) -> Plant:
        """Return one of the arms with all that a `Plant` can do; they share the state."""
        check_count("Fleet", "arm", arm, -self._count, self._count - 1)
        machine = self.core.arm_fleet_machine(self._fleet, arm % self._count)
        began = self._began[0][arm], self._began[1][arm]
        return Plant(self.scene, of=Borrowed(self, self.core, machine, began))

    def reset(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> None:
        """Put all arms at logical time 0, at rest behind their links; `q` and `v` as for `Fleet`.

        Raises:
            Refusal: wrong shape, not finite, or too far away to be computed with; the states are as
                before.
        """
        where = "Fleet.reset"
        at = self._rows(self.scene.start if q is None else q, where, "q", "rad or m")
        speed = self._rows(np.zeros(self._N) if v is None else v, where, "v", "rad/s or m/s")
        check_start(where, self.scene, at, speed)
        self._began = at.copy(), speed.copy()
        for arm, (of_q, of_v) in enumerate(zip(at, speed, strict=True)):
            machine = self.core.arm_fleet_machine(self._fleet, arm)
            self.core.arm_reset(machine, pointer(of_q), pointer(of_v))

    def advance(self, voltage: ArrayLike, steps: int) -> Array:
        """Take `steps` integration steps with the motor voltages held.

        Args:
            voltage: (N,) for all arms or (count, N) [V], clamped to the supply; arms without
                power get none of it.
            steps: of `scene.integrator.dt`, 0 to 1e15.

        Returns:
            Link positions after them (count, N) [rad or m].

        Raises:
            Refusal: wrong shape, not finite, or no such count; the states are as before.
        """
        check_count("Fleet.advance", "steps", steps, 0, LARGEST_STEPS)
        rows = self._rows(voltage, "Fleet.advance", "voltage", "V")[np.newaxis]
        q: Array = self._run(rows, int(steps))[0]
        return q

    def run(self, voltages: ArrayLike, steps: int) -> Array:
        """Apply rows of voltages one after the other.

        An arm that diverges stays at its last sound state, and the others go on; see `diverged`.

        Args:
            voltages: (K, N) for all arms or (K, count, N) [V].
            steps: integration steps under each row, >= 0; with all rows at most 1e15.

        Returns:
            Link positions after each row, (K, count, N) [rad or m].

        Raises:
            Refusal: wrong shape, not finite, or no such count; the states are as before.
        """
        where, N = "Fleet.run", self._N
        rows = as_numbers(voltages, where, "voltages", "V")
        if rows.ndim == 2 and rows.shape[1] == N:
            rows = np.repeat(rows[:, np.newaxis], self._count, axis=1)
        if rows.ndim != 3 or rows.shape[1:] != (self._count, N):
            rule = f"have shape (K, {N}) or (K, {self._count}, {N})"
            raise Refusal(where, "voltages", rule, rows.shape)
        check_count(where, "steps", steps, 0, LARGEST_STEPS // max(1, len(rows)))
        return self._run(rows, int(steps))

    def set_parameter(self, name: str, values: ArrayLike) -> None:
        """Set a varied number of all arms, to one value or one each (count,); see `Plant`.

        Raises:
            Refusal: the scene does not list it as varied, wrong shape, or a value out of its range;
                nothing has changed.
        """
        column = self._column("Fleet.set_parameter", name, values)
        for arm, value in enumerate(column):
            machine = self.core.arm_fleet_machine(self._fleet, arm)
            self.core.arm_set_parameter(machine, name.encode(), float(value))

    @property
    def state(self) -> FleetState:
        """The states now, as a copy. An arm's own can be set: ``fleet[k].state = ...``."""
        count, N = self._count, self._N
        counts = np.zeros((count, N), np.int64)
        numbers = {name: np.zeros((count, N)) for name in ROWS}
        of_arm = {name: np.zeros(count) for name in ("t", "energy")}
        self._look(encoder_counts=counts, **numbers, **of_arm)
        return FleetState(encoder_counts=counts, **numbers, **of_arm)

    @property
    def faults(self) -> NDArray[np.int32]:
        """The joint at which each arm diverged (count,); -1: it goes on."""
        faults = np.zeros(self._count, np.int32)
        self._look(fault=faults)
        return faults

    @property
    def diverged(self) -> dict[int, Diverged]:
        """Why arms stay where they are, by their index."""
        found = {int(arm): self[int(arm)].diverged for arm in np.flatnonzero(self.faults >= 0)}
        return {arm: why for arm, why in found.items() if why is not None}

    def _look(self, **to: NDArray[Any]) -> None:
        places = {PLACES.get(name, name): rows for name, rows in to.items()}
        self.core.arm_fleet_get_truth(self._fleet, FLEET.new("arm_fleet_truth", **places))

    def _run(self, rows: Array, steps: int) -> Array:
        # A sum is quick, and not finite if any of them is not.
        if not np.isfinite(rows.sum()) and not np.isfinite(rows).all():
            raise Refusal("Fleet.run", "voltages", "be finite [V]", rows)
        rows = np.ascontiguousarray(rows)
        q = np.empty_like(rows)
        longest = max(1, PIECE * self.lanes // self._count)  # steps after which Ctrl-C is heard
        if steps > longest:
            for row, after in zip(rows, q, strict=True):
                for done in range(0, steps, longest):
                    self._advance(row[np.newaxis], min(longest, steps - done), after[np.newaxis])
            return q
        at_once = longest // max(1, steps)
        for first in range(0, len(rows), at_once):
            end = first + at_once
            self._advance(rows[first:end], steps, q[first:end])
        return q

    def _advance(self, rows: Array, steps: int, q: Array) -> None:
        def share(of: tuple[int, int]) -> None:
            run: Callable[..., int] = self.core.arm_fleet_run
            run(self._fleet, *of, pointer(rows), len(rows), steps, pointer(q))

        if self._pool and rows[..., 0].size * steps > WORTH_A_THREAD:
            list(self._pool.map(share, self._shares))
        else:
            share((0, self._count))

    def _values(self, varied: Mapping[str, ArrayLike]) -> Array:
        """Return the varied numbers' values, a row for each arm."""
        names = [one.name for one in self.scene.varied]
        values = np.tile([one.value for one in self.scene.varied], (self._count, 1))
        for name, of_arms in varied.items():
            column = self._column("Fleet", name, of_arms)
            values[:, names.index(name)] = column
        return np.ascontiguousarray(values, np.float64)

    def _column(self, where: str, name: str, values: ArrayLike) -> Array:
        """Return the values of a varied number (count,), checked."""
        known = {one.name: one for one in self.scene.varied}
        if name not in known:
            listed = ", ".join(known) or "none, see `varied` in docs/reference/scene.md"
            raise Refusal(where, "name", "be varied in the scene", name, listed)
        column = as_numbers(values, where, name, "number")
        if column.shape not in ((), (1,), (self._count,)):
            raise Refusal(where, name, f"have shape ({self._count},) or ()", column.shape)
        least, most = known[name].least, known[name].most
        wrong = column[~((column >= least) & (column <= most))]
        if wrong.size:
            raise Refusal(where, name, f"be a number from {least:g} to {most:g}", wrong[0])
        return np.broadcast_to(column, (self._count,))

    def _rows(self, values: ArrayLike, where: str, quantity: str, unit: str) -> Array:
        """Return a row for each arm, checked."""
        rows = as_numbers(values, where, quantity, unit)
        shape = (self._count, self._N)
        if rows.shape not in ((self._N,), shape):
            raise Refusal(where, quantity, f"have shape ({self._N},) or {shape}", rows.shape)
        if not np.isfinite(rows).all():
            raise Refusal(where, quantity, f"be finite [{unit}]", rows)
        return np.ascontiguousarray(np.broadcast_to(rows, shape))
