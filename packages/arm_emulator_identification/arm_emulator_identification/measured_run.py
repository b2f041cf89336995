"""A record of a machine's motion, as measured by its drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from arm_emulator.extension.base import EFFORT, POSITION, VELOCITY, Array, Number, Refusal

SHORTEST = 200  # samples
UNEVEN = 0.01  # of a sample: jitter of clocks
FROZEN = 8  # equal samples in a row while a joint moves are no measurement
BOUNDS = {
    "q_motor": POSITION, "q_link": POSITION, "v_motor": VELOCITY, "tau": EFFORT,
}  # fmt: skip
LATEST = 1e9  # s
SLOWEST = 0.04  # of a joint's top speed: slower joints count as standing


@dataclass(frozen=True)
class MeasuredRun:
    """Evenly spaced samples. Arrays are (K, N), joints base to tool."""

    where: str  # the file, for refusals
    joints: tuple[str, ...]
    t: Array  # s, (K,)
    q_motor: Array  # rad or m: the motor's angle times the gear ratio, as seen at the link
    tau: Array  # N m, at the motor's shaft
    q_link: Array | None = None  # rad or m, by encoders at the links; NaN without one
    v_motor: Array | None = None  # rad/s or m/s, as the drives measure them

    @property
    def period(self) -> float:
        """Time from sample to sample [s]."""
        return float(self.t[-1] - self.t[0]) / (len(self.t) - 1)

    def shift_back(self, delays: Mapping[str, float]) -> MeasuredRun:
        """Return the record with delayed signals [s] shifted back."""
        changed = {}
        for name, delay in delays.items():
            rows = getattr(self, name)
            if rows is not None and delay:
                columns = [np.interp(self.t + delay, self.t, column) for column in rows.T]
                changed[name] = np.column_stack(columns)
        return MeasuredRun(**(vars(self) | changed))


def check_samples(run: MeasuredRun) -> None:
    """Refuse a record with gaps, missing numbers, or sensors that have stopped.

    Raises:
        Refusal: names the signal, the joint and the time.
    """
    t = run.t
    if len(t) < SHORTEST:
        raise Refusal(run.where, "record", f"have at least {SHORTEST} samples", len(t))
    if not np.isfinite(t).all():
        at = int(np.flatnonzero(~np.isfinite(t))[0])
        raise Refusal(run.where, f"t of sample {at}", "be finite [s]", t[at])
    Number.bound_size("t", "s", LATEST).check_values(run.where, [float(np.abs(t).max())])
    steps = np.diff(t)
    interval = float(np.median(steps))
    bad = np.flatnonzero(steps <= 0.0)
    if bad.size:
        rule = "increase from sample to sample [s]"
        raise Refusal(run.where, "t", rule, f"{t[bad[0] + 1]:g} after {t[bad[0]]:g}")
    bad = np.flatnonzero(np.abs(steps - interval) > max(UNEVEN, 0.5) * interval)
    if bad.size:
        at = int(bad[0])
        rule = f"come every {interval:g} s, without gaps"
        raise Refusal(run.where, "samples", rule, f"{steps[at]:g} s after t = {t[at]:g} s")
    for name in ("q_motor", "tau", "v_motor", "q_link"):
        rows = getattr(run, name)
        if rows is None:
            continue
        for joint, column in zip(run.joints, rows.T, strict=True):
            missing = np.flatnonzero(~np.isfinite(column))
            if name == "q_link" and missing.size == len(column):
                continue  # no encoder at this link
            if missing.size:
                at = int(missing[0])
                raise Refusal(
                    run.where, f"{name} of {joint}", "be finite in every sample",
                    f"{column[at]} at t = {t[at]:g} s, {missing.size} of {len(column)}",
                )  # fmt: skip
            bound = BOUNDS[name].rename(f"{name} of {joint}")
            bound.check_values(run.where, [float(np.abs(column).max())])
            if name in ("q_motor", "q_link"):
                _check_frozen(run, name, joint, column)


def _check_frozen(run: MeasuredRun, name: str, joint: str, column: Array) -> None:
    """Refuse intervals in which a moving joint reports a constant number."""
    steps = np.abs(np.diff(column))
    moving = SLOWEST * np.quantile(steps, 0.99)
    edges = np.flatnonzero(steps > 0.0)
    if moving == 0.0:
        return
    for edge, following in pairwise(edges):
        if following - edge < FROZEN:
            continue
        before, after = steps[max(0, edge - 2) : edge + 1].min(), steps[following + 1 :][:3]
        if before > 2.0 * moving and after.size and after.min() > 2.0 * moving:
            rule = "change while the joint moves"
            frozen = (
                f"{column[edge + 1]:.6g} for {following - edge} samples from t = {run.t[edge]:g} s"
            )
            raise Refusal(run.where, f"{name} of {joint}", rule, frozen)
