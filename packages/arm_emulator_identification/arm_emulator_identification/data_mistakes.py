"""Usual slips in records, each compared with the others.

The cost of a record consists of the unexplained torque, the distance of bodies and rotors from the
scene's, and friction that would drive. Each slip is undone in the filtered record, over a search of
its size, and the costs are compared.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize_scalar

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import Scene, ShaftMotion
from arm_emulator_identification import inertia
from arm_emulator_identification.filtered import Filtered, Mask
from arm_emulator_identification.link_regressor import LinkRegressor
from arm_emulator_identification.residual_effects import estimate_correlation

Order = NDArray[np.signedinteger[Any]]

ROWS = 120  # of the record: enough to detect a slip
SHARE = 0.3  # relative accuracy of a body's numbers
LOADED = 20.0  # times that for the last link, if its load differs
NOISE = 0.02, 0.1  # of a joint's torque: smallest and largest unexplained part
ROUNDS = 2  # updates of the widths
LARGE = 4.0  # times a number: from this width on its size carries no information
FREE = 10.0  # times the widths, in the fit for the unexplained part
DRIVES = 0.02  # of a joint's torque: negative friction beyond this drives
# Prior cost of a slip: one without a size, one of any size, a rare one.
PLAIN, SEARCHED, RARE = 3.0, 6.0, 20.0
SIZES = np.exp(np.linspace(-3.0, 3.0, 13))  # scales tried
TIMES = np.array([0.1, 0.2, 0.33, 0.5, 0.67, 1.5, 2.0, 3.0, 5.0, 10.0])
LATEST = 0.12  # s
TURN = np.pi / 12.0  # rad, between zeros of angles tried
DEG = np.pi / 180.0
# Torques in other units, with their factors.
UNITS = {
    1e3: "in N mm", 1e-3: "in kN m", 1.0 / 9.80665: "in kgf m", 0.737562: "in lbf ft",
    8.85075: "in lbf in",
}  # fmt: skip


@dataclass(frozen=True)
class RecordView:
    """Rows of a record with a slip undone. Arrays are (K, N)."""

    t: Array  # (K,)
    q: Array
    v: Array
    a: Array
    direction: Array
    tau: Array  # at the links
    rows: Mask
    scale: Array  # of torques (N,): factor by which they are too large
    time: float  # of the clock: length of its second [s]
    offset: int = -1  # joint whose torque may have any offset
    loaded: bool = False  # whether the last link may have any load


@dataclass(frozen=True)
class Mistake:
    """A slip that was tried."""

    quantity: str
    got: str
    cost: float  # of the record once it is undone, and of the slip
    view: RecordView  # with the slip undone
    alone: float  # prior cost of the slip
    scale: float = 0.0  # of torques, if it is that; 0: another slip


class DataMistakes:
    """Costs of a record, unchanged and with slips undone."""

    def __init__(self, scene: Scene, data: Filtered) -> None:
        self.scene = scene
        self.names = scene.joint_names
        self.N = len(self.names)
        self._regressor = LinkRegressor(scene)
        self._phi = np.concatenate(
            [inertia.list_dynamic(joint.body) for joint in scene.chain.links]
        )
        Jm = [getattr(joint.motor, "rotor_inertia", 0.0) for joint in scene.joints]
        self._carried = np.array(Jm) / scene.gear_ratios**2
        widths = []
        for joint in scene.chain.links:
            body = joint.body
            length = np.sqrt(max(np.trace(body.inertia), 1e-12) / max(body.mass, 1e-12))
            second = max(float(np.trace(body.inertia)), 1e-12)
            widths += [body.mass, *(3 * [body.mass * length]), *(6 * [second])]
        self._widths = SHARE * np.array(widths)
        # Width of each number relative to itself, over SHARE, unless the number is small.
        size = np.array(widths) / np.where(self._phi != 0.0, self._phi, np.inf)
        size = np.where(np.abs(size) < LARGE, size, 0.0)
        self._relative = np.concatenate([size, np.ones(self.N)])
        some = slice(None, None, max(1, len(data.t) // ROWS))
        self._torque = CubicSpline(data.t, data.tau)
        self.as_is = RecordView(
            data.t[some], data.q[some], data.v[some], data.a[some], data.direction[some],
            data.tau[some], data.moving[some], np.ones(self.N), 1.0,
        )  # fmt: skip
        self._cache = dict[bytes, tuple[Array, Array, Array]]()
        self.noise = self.compute_unexplained_share(self.as_is)

    def compute_cost(self, view: RecordView) -> float:
        """Return the misfit of a record."""
        wider = np.ones(len(self._phi) + self.N)
        for _ in range(ROUNDS):
            solution = self._fit_view(view, wider, self.noise)
            if solution is None:
                return np.inf
            error, moved, coulomb = solution
            # Half the size deviates as much as twice the size.
            share = 1.0 + SHARE * wider * moved[: len(wider)] * self._relative
            wider = np.where(self._relative != 0.0, np.sqrt(np.clip(share, 0.1, 1.0)), 1.0)
        deviation = view.tau.std(axis=0)
        driven = view.rows[:, coulomb < -DRIVES * deviation].sum()
        total = float(np.sum(error[view.rows] ** 2) + moved @ moved + driven)
        return total if np.isfinite(total) else np.inf

    def compute_unexplained_share(self, view: RecordView) -> Array:
        """Return the share of each joint's torque that no such machine explains (N,), within NOISE.

        Correlated errors count with their correlation length.
        """
        solution = self._fit_view(
            view, np.full(len(self._phi) + self.N, FREE), np.full(self.N, NOISE[0])
        )
        if solution is None:
            return np.full(self.N, NOISE[1])
        shares = [
            np.sqrt(np.mean(e[r] ** 2) * estimate_correlation(e, r)) if r.any() else NOISE[1]
            for e, r in zip(solution[0].T, view.rows.T, strict=True)
        ]
        return np.clip(NOISE[0] * np.array(shares), *NOISE)

    def _fit_view(self, view: RecordView, wider: Array,
             noise: Array) -> tuple[Array, Array, Array] | None:  # fmt: skip
        """Return errors per noise (K, N), numbers in their widths, and Coulomb friction (N,)."""
        weight, moved, locked = self._compute_regressors(view)
        N, K = self.N, len(view.t)
        deviation = np.maximum(view.tau.std(axis=0), 1e-12)
        Y = (weight + moved / view.time**2) * view.scale[:, None]
        a = view.scale * self._carried * view.a / view.time**2
        X = np.zeros((K, N, 3 * N + 1))
        for j in range(N):
            X[:, j, j], X[:, j, N + j], X[:, j, 2 * N + j] = (
                a[:, j], view.direction[:, j], view.v[:, j]
            )  # fmt: skip
        if view.offset >= 0:
            X[:, view.offset, 3 * N] = 1.0
        top = np.maximum(np.abs(view.v).max(axis=0), 1e-12)
        of_friction = 3.0 * deviation, 3.0 * deviation / top
        of_links = wider[:-N] * self._widths
        if view.loaded:
            of_links[-inertia.NUMBERS :] *= LOADED
        widths = np.concatenate([of_links, SHARE * wider[-N:], *of_friction, [deviation.max()]])
        per_noise = 1.0 / (noise * deviation)
        every = np.concatenate([Y, X], axis=2) * widths * per_noise[:, None]
        torque = (view.tau - Y @ self._phi - view.scale * locked - a) * per_noise
        A, b = every[view.rows], torque[view.rows]
        try:
            coefficients = cho_solve(cho_factor(A.T @ A + np.eye(A.shape[1])), A.T @ b)
        except (LinAlgError, ValueError):
            return None
        return (
            torque - every @ coefficients,
            coefficients,
            (widths * coefficients)[-2 * N - 1 : -N - 1],
        )

    def scale_time(self, times: float) -> RecordView:
        """Return the record with its seconds scaled."""
        return replace(self.as_is, time=times)

    def _compute_regressors(self, view: RecordView) -> tuple[Array, Array, Array]:
        """Return the links' regressor for weight and for motion, and spring torques (K, N)."""
        key = view.q.tobytes() + view.a.tobytes()
        if key not in self._cache:
            if len(self._cache) > 4:
                self._cache.popitem()
            none = np.zeros_like(view.q)
            weight = self._regressor(view.q, none, none)
            moved = self._regressor(view.q, view.v, view.a) - weight
            self._cache[key] = weight, moved, self._compute_locked(view)
        return self._cache[key]

    def _compute_locked(self, view: RecordView) -> Array:
        """Return the torques of parts at the links without friction (K, N)."""
        locked, none = np.zeros_like(view.q), np.zeros_like(view.t)
        for j, joint in enumerate(self.scene.joints):
            at = ShaftMotion(view.t, view.q[:, j], none, none, none, none, joint.gear.ratio)
            for part in joint.parts:
                taken = part.compute_effort(at) if part.shaft == "link" else None
                locked[:, j] += 0.0 if taken is None else taken
        return locked

    def try_mistakes(self) -> Iterator[Mistake]:
        """Return every slip at the size of least cost."""
        yield from self._try_units()
        yield from self._try_scales()
        yield from self._try_signs()
        yield from self._try_times()
        yield from self._try_zeros()
        loaded = replace(self.as_is, loaded=True)
        another = "another load at the tool than the scene's payload"
        yield self._try_view("load", another, loaded, SEARCHED)

    def update_cost(self, slip: Mistake) -> Mistake:
        """Return a slip with its cost at the present noise."""
        return replace(slip, cost=self.compute_cost(slip.view) + slip.alone)

    def _try_view(self, quantity: str, got: str, view: RecordView, alone: float = PLAIN,
             scale: float = 0.0) -> Mistake:  # fmt: skip
        return Mistake(quantity, got, self.compute_cost(view) + alone, view, alone, scale)

    def _list_groups(self) -> Iterator[tuple[int, str, Mask]]:
        """Yield all joints as -1, then each of several: number, words, and which they are (N,)."""
        yield -1, "", np.full(self.N, True)
        for j in range(self.N) if self.N > 1 else ():
            yield j, f" of {self.names[j]}", np.arange(self.N) == j

    def _try_units(self) -> Iterator[Mistake]:
        view = self.as_is
        yield self._try_view("angles", "deg, given as rad", self._scale_angles(DEG))
        yield self._try_view("angles", "rad, given as deg", self._scale_angles(1.0 / DEG))
        yield self._try_view("angles", "turns, given as rad", self._scale_angles(2.0 * np.pi))
        for factor, actual_unit in UNITS.items():
            scaled = replace(view, scale=np.full(self.N, factor))
            yield self._try_view("torques", f"torques {actual_unit}", scaled, scale=factor)
        at_links = 1.0 / np.abs(self.scene.gear_ratios)
        if not np.allclose(at_links, 1.0):
            actual_unit = "torques at the links, not at the motors' shafts"
            yield self._try_view("torques", actual_unit, replace(view, scale=at_links), scale=1e3)
        constants = [getattr(joint.motor, "torque_constant", None) for joint in self.scene.joints]
        if None not in constants:
            amps = 1.0 / np.array(constants, np.float64)
            actual_unit = "currents in A, given as torques"
            yield self._try_view("torques", actual_unit, replace(view, scale=amps), scale=1e3)

    def _try_scales(self) -> Iterator[Mistake]:
        """Torques and angles of all joints or of one, scaled."""
        view = self.as_is
        for j, of, here in self._list_groups():

            def scale_torque(size: float, here: Mask = here) -> RecordView:
                return replace(view, scale=np.where(here, size, 1.0))

            sizes = SIZES if j >= 0 else np.concatenate([SIZES, 10.0 ** np.arange(-6.0, 7.0)])
            size = self._search_size(scale_torque, sizes, True)
            actual = f"torques{of} {_describe_scale(size)}"
            if j >= 0 and abs(size * abs(self.scene.gear_ratios[j]) - 1.0) < 0.1:
                actual = f"torque{of} at the link, not at the motor's shaft"
            scaled = scale_torque(size)
            yield self._try_view(f"scale of the torques{of}", actual, scaled, SEARCHED, size)

            def scale_angle(size: float, here: Mask = here) -> RecordView:
                return self._scale_angles(np.where(here, 1.0 / size, 1.0))

            size = self._search_size(scale_angle, SIZES[2:-2:2], True)
            actual = f"angles{of} {_describe_scale(size)}"
            yield self._try_view(f"scale of the angles{of}", actual, scale_angle(size), SEARCHED)
            if j >= 0:
                for factor, actual in (
                    (DEG, "deg, given as rad"),
                    (1.0 / DEG, "rad, given as deg"),
                ):
                    turned = self._scale_angles(np.where(here, factor, 1.0))
                    yield self._try_view(f"angles{of}", actual, turned)

    def _try_signs(self) -> Iterator[Mistake]:
        view, every = self.as_is, np.arange(self.N)
        opposite = "the opposite ones"
        yield self._try_view("signs of all torques", opposite, replace(view, tau=-view.tau))
        yield self._try_view("signs of all angles", opposite, self._scale_angles(-1.0))
        for j, name in enumerate(self.names):
            flip = np.where(every == j, -1.0, 1.0)
            flipped = replace(view, tau=view.tau * flip)
            yield self._try_view(f"signs of {name}'s torque", opposite, flipped)
            yield self._try_view(f"signs of {name}'s angle", opposite, self._scale_angles(flip))
        orders = [
            (f"{self.names[i]} and {self.names[j]}", _swap_joints(every, i, j))
            for i, j in combinations(range(self.N), 2)
        ]
        if self.N > 2:
            orders += [("all joints", every[::-1]), ("all joints", np.roll(every, 1)),
                       ("all joints", np.roll(every, -1))]  # fmt: skip
        ratio = self.scene.gear_ratios
        for names, order in orders:
            # Torques were referred to the links by the ratios of the assumed joints.
            tau = (view.tau * ratio)[:, order] / ratio
            moved = self._reorder_angles(order)
            actual = "swapped ones"
            yield self._try_view(f"torques of {names}", actual, replace(view, tau=tau))
            yield self._try_view(f"angles of {names}", actual, moved)
            yield self._try_view(f"columns of {names}", actual, replace(moved, tau=tau))

    def _try_times(self) -> Iterator[Mistake]:
        view = self.as_is
        size = self._search_size(self.scale_time, TIMES, True)
        actual = f"a time base in which a second is {size:.3g} s"
        yield self._try_view("t", actual, self.scale_time(size), SEARCHED)

        delays = LATEST * np.array([-1.0, -0.5, -0.25, -0.1, 0.1, 0.25, 0.5, 1.0])
        for j, of, here in self._list_groups():

            def shift_torques(seconds: float, here: Mask = here) -> RecordView:
                tau = self._torque(np.clip(view.t + seconds, *self._torque.x[[0, -1]]))
                return replace(view, tau=np.where(here, tau, view.tau))

            seconds = self._search_size(shift_torques, delays, False)
            direction = "late" if seconds > 0.0 else "early"
            actual = f"torques that come {1e3 * abs(seconds):.3g} ms {direction}"
            # The torques of all joints have the same delay.
            alone = SEARCHED if j < 0 and seconds > 0.0 else RARE
            yield self._try_view(f"time of the torques{of}", actual, shift_torques(seconds), alone)

    def _try_zeros(self) -> Iterator[Mistake]:
        view = self.as_is
        for j, name in enumerate(self.names):
            offset = replace(view, offset=j)
            yield self._try_view(
                f"zero of {name}'s torque", "another one, an offset", offset, SEARCHED
            )
            slides = self.scene.chain.joints[j].kind == "prismatic"
            if slides:
                continue

            def turn_zero(zero: float, j: int = j) -> RecordView:
                return replace(view, q=view.q - np.where(np.arange(self.N) == j, zero, 0.0))

            zeros = TURN * np.array([k for k in range(-12, 13) if k])
            zero = self._search_size(turn_zero, zeros, False)
            actual = f"one that is off by {zero:.3g} rad ({zero / DEG:.3g} deg)"
            yield self._try_view(f"zero of {name}'s angle", actual, turn_zero(zero), SEARCHED)

    def _search_size(self, of: Callable[[float], RecordView], sizes: Array,
                by_ratio: bool) -> float:  # fmt: skip
        """Return the size of a slip with the least cost."""
        places = np.log(sizes) if by_ratio else sizes

        def compute_cost(place: float) -> float:
            return self.compute_cost(of(float(np.exp(place)) if by_ratio else float(place)))

        order = np.argsort(places)
        places = places[order]
        costs = [compute_cost(place) for place in places]
        best = int(np.argmin(costs))
        low, high = places[max(best - 1, 0)], places[min(best + 1, len(places) - 1)]
        optimum = minimize_scalar(
            compute_cost,
            bounds=(low, high),
            method="bounded",
            options={"maxiter": 12, "xatol": 1e-3},
        )
        place = optimum.x if optimum.fun < costs[best] else places[best]
        return float(np.exp(place)) if by_ratio else float(place)

    def _scale_angles(self, by: float | Array) -> RecordView:
        """Return the record with angles scaled, by a number or one per joint."""
        slides = np.array([joint.kind == "prismatic" for joint in self.scene.chain.joints])
        by = np.where(slides & (np.abs(by) != 1.0), 1.0, by)
        view = self.as_is
        return replace(view, q=view.q * by, v=view.v * by, a=view.a * by,
                       direction=view.direction * np.sign(by))  # fmt: skip

    def _reorder_angles(self, order: Order) -> RecordView:
        """Return the record with the angles of joints in another order."""
        view = self.as_is
        return replace(
            view, q=view.q[:, order], v=view.v[:, order], a=view.a[:, order],
            direction=view.direction[:, order], rows=view.rows[:, order],
        )  # fmt: skip


def _swap_joints(every: Order, i: int, j: int) -> Order:
    order = every.copy()
    order[[i, j]] = j, i
    return order


def _describe_scale(size: float) -> str:
    return f"{size:.3g} times as large as they can be" if size > 1.0 else (
        f"{1.0 / size:.3g} times as small as they can be"
    )  # fmt: skip
