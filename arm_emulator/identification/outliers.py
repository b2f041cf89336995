"""Outliers: detected, counted, and replaced by their neighbours."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from arm_emulator.base.refusal import Refusal
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.machine.chain import Array

SIGNALS = {"tau": "torque", "q_motor": "angle"}
NEIGHBOURS = 7  # samples, of which the middle one is judged
AROUND = 101  # samples, whose usual distance from their neighbours is the reference
TIMES = 12.0  # the usual distance
# Of the signal's spread: smaller outliers are harmless, and torque may jump at reversals.
LEAST = {"tau": 0.6, "q_motor": 2e-5}
ROUNDS = 3  # since neighbours hide each other
MOST = 0.05  # of the samples: with more it is no measurement


def without_outliers(run: MeasuredRun) -> tuple[MeasuredRun, list[str]]:
    """Return a record without outliers, and a description of those, as text.

    Raises:
        Refusal: too many of them.
    """
    changed, found = dict[str, Any](), list[str]()
    for name, shown in SIGNALS.items():
        rows = getattr(run, name).copy()
        for j, joint in enumerate(run.joints):
            out = np.zeros(len(rows), bool)
            for _ in range(ROUNDS):
                new = _outliers(rows[:, j], LEAST[name]) & ~out
                if not new.any():
                    break
                out |= new
                rows[out, j] = np.interp(run.t[out], run.t[~out], rows[~out, j])
            count = int(out.sum())
            if count > MOST * len(out):
                rule = f"have outliers in at most {100 * MOST:g} % of the samples"
                got = f"{100.0 * count / len(out):.1f} %"
                raise Refusal(run.where, f"{shown} of {joint}", rule, got)
            if count:
                first = run.t[int(np.argmax(out))]
                found.append(
                    f"{shown} of {joint}: {count} outliers, the first at t = {first:.4g} s; "
                    "their neighbours stand in their place"
                )
        changed[name] = rows
    return dataclasses.replace(run, **changed), found


def _outliers(signal: Array, least: float) -> Array:
    """Return the samples that are farther from their neighbours than usual around them."""
    # For a smooth motion, the error of a parabola through the neighbours is negligible.
    away = np.zeros_like(signal)
    near, far = signal[1:-3] + signal[3:-1], signal[:-4] + signal[4:]
    away[2:-2] = signal[2:-2] - (4.0 * near - far) / 6.0
    beside = np.minimum(
        np.abs(away), 1.5 * np.abs(signal - median_filter(signal, NEIGHBOURS, mode="nearest"))
    )
    usual = 1.4826 * median_filter(np.abs(away), AROUND, mode="nearest")
    spread = float(np.quantile(signal, 0.95) - np.quantile(signal, 0.05))
    out: Array = beside > np.maximum(TIMES * usual, least * spread)
    return out
