"""Check that a record can be of this machine: motion, consistent speeds, no slips.

Each known slip is tried (data_mistakes.py). If the record fits the machine much better with one
undone, that slip is reported; those that fit nearly as well are named beside it.
"""

import dataclasses
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from arm_emulator.extension.base import Array, Refusal
from arm_emulator.extension.machine import Scene
from arm_emulator_identification.data_mistakes import DataMistakes, Mistake
from arm_emulator_identification.filtered import Filtered, filter_run
from arm_emulator_identification.measured_run import MeasuredRun

# Saving of an undone slip, in squares of deviations and relative to the record's cost. In correct
# measured records, slips save up to 30 and 7 %.
A_DOUBT = 12.0, 0.08
A_SLIP = 25.0, 0.15
CLOSE = 0.15  # of its saving: slips within this share are named, too
DOUBTFUL = 1.5  # times: a smaller error of a torque's scale is a doubt, not a slip
NEAREST = 12  # slips compared again, by the least unexplained torque
MIN_TRAVEL = 1.0e-3  # rad or m: smaller motions do not count
MIN_TORQUE = 1e-9  # N m or N, at the motor's shaft: smaller changes do not count
SPEEDS_AGREE = 0.7  # correlation, and within a factor of 1.5
POOR = 50.0  # %: of an unusable fit
SLOWEST_SAMPLES, FASTEST_SAMPLES = 0.1, 1e-6  # s


def filter_record(scene: Scene, run: MeasuredRun, low_pass: float, *,
                as_is: bool = False) -> tuple[MeasuredRun, Filtered, list[str]]:  # fmt: skip
    """Return a record without outliers, low-passed, and doubts about it, as text.

    Args:
        scene: the machine.
        run: the record.
        low_pass: see `filter_run` [Hz].
        as_is: do not try slips.

    Raises:
        Refusal: it cannot be of this machine.
    """
    check_clock(run)
    run, warnings = replace_outliers(run)
    motion = filter_run(run, scene.gear_ratios, low_pass)
    check_movement(run, motion)
    check_speeds(scene, run, motion)
    if not as_is:
        warnings += check_mistakes(scene, run, motion)
    return run, motion, warnings


def check_clock(run: MeasuredRun) -> None:
    """Refuse times that cannot be in seconds.

    Raises:
        Refusal: names the likely unit.
    """
    if not FASTEST_SAMPLES < run.period <= SLOWEST_SAMPLES:
        slow = (
            "ms, us, or numbers of samples in the place of s?"
            if run.period > SLOWEST_SAMPLES
            else ""
        )
        rule = f"be in s, with samples every {FASTEST_SAMPLES:g} to {SLOWEST_SAMPLES:g} s"
        raise Refusal(run.where, "t", rule, f"samples every {run.period:g} s: {slow}".rstrip(": "))


def check_movement(run: MeasuredRun, data: Filtered) -> None:
    """Refuse a record in which a joint hardly moves, or only one way at one speed.

    Raises:
        Refusal: names the joint, and how much it moves.
    """
    for j, joint in enumerate(run.joints):
        if not np.ptp(run.tau[:, j]) > MIN_TORQUE:
            rule = "change while the joint moves; a joint that nothing drives shows nothing"
            raise Refusal(run.where, f"torque of {joint}", rule, f"{run.tau[0, j]:g} throughout")
        travel = float(np.ptp(run.q_motor[:, j]))
        rule = "move, so that its friction and inertia show"
        if travel < MIN_TRAVEL:
            raise Refusal(run.where, joint, rule, f"a way of {travel:.3g} rad or m in all")
        v = data.v[data.moving[:, j], j]
        if len(v) < 10:
            raise Refusal(run.where, joint, rule, f"{len(v)} samples in motion after filtering")
        if v.min() > 0.0 or v.max() < 0.0:
            rule = "move both ways, so that friction and weight can be separated"
            raise Refusal(run.where, joint, rule, "one direction")
        if np.quantile(np.abs(v), 0.95) < 1.3 * np.quantile(np.abs(v), 0.05):
            rule = "move at different speeds, so that Coulomb and viscous friction can be separated"
            raise Refusal(run.where, joint, rule, f"{np.abs(v).mean():.3g} rad/s or m/s throughout")


def check_speeds(scene: Scene, run: MeasuredRun, data: Filtered) -> None:
    """Refuse speeds that are inconsistent with the angles, if a record has both.

    Raises:
        Refusal: names the joint, and the likely cause.
    """
    if run.v_motor is None:
        return
    own = np.gradient(run.q_motor, run.period, axis=0)
    rule = "be the rate of q_mot"
    factors = np.ones(len(run.joints))
    for j, joint in enumerate(run.joints):
        recorded, computed = run.v_motor[:, j], own[:, j]
        size = float(recorded @ recorded) ** 0.5 * float(computed @ computed) ** 0.5
        alike = float(recorded @ computed) / size if size > 0.0 else 0.0
        if alike < -SPEEDS_AGREE:
            raise Refusal(run.where, f"v_mot of {joint}", rule, "its opposite sign")
        if alike < SPEEDS_AGREE:
            others = np.corrcoef(np.column_stack([recorded, own]).T)[0, 1:]
            best = int(np.argmax(np.abs(others)))
            value = f"a correlation of {alike:.2f}"
            if abs(others[best]) > SPEEDS_AGREE:
                value = f"that of {run.joints[best]}"
            raise Refusal(run.where, f"v_mot of {joint}", rule, value)
        factors[j] = float(recorded @ computed) / float(recorded @ recorded)
    wrong = ~((factors > 1.0 / 1.5) & (factors < 1.5))
    if not wrong.any():
        return
    j = int(np.argmax(wrong))
    actual = f"a rate {factors[j]:.4g} times as large; are units the same?"
    common = float(np.median(factors))
    if wrong.all() and np.ptp(np.log(np.abs(factors))) < 0.1:
        data_mistakes = DataMistakes(scene, data)
        with_clock = data_mistakes.compute_cost(data_mistakes.scale_time(common))
        if with_clock < (1.0 - A_SLIP[1]) * data_mistakes.compute_cost(data_mistakes.as_is):
            actual = f"rates {common:.4g} times as large, since a second of t is {common:.4g} s"
            raise Refusal(run.where, "t", "have the time base of v_mot", actual)
    raise Refusal(run.where, f"v_mot of {run.joints[j]}", rule, actual)


def check_mistakes(scene: Scene, run: MeasuredRun, data: Filtered) -> list[str]:
    """Refuse a record that fits this machine once a slip is undone; return doubts, as text.

    Raises:
        Refusal: names the slip, or those that cannot be distinguished.
    """
    data_mistakes = DataMistakes(scene, data)
    tried = sorted(data_mistakes.try_mistakes(), key=lambda slip: slip.cost)[:NEAREST]
    # With the likeliest slip undone, less may stay unexplained.
    data_mistakes.noise = np.minimum(
        data_mistakes.noise, data_mistakes.compute_unexplained_share(tried[0].view)
    )
    as_is = data_mistakes.compute_cost(data_mistakes.as_is)
    tried = sorted((data_mistakes.update_cost(slip) for slip in tried), key=lambda slip: slip.cost)
    best = tried[0]
    saved = as_is - best.cost
    if saved < A_DOUBT[0] or saved < A_DOUBT[1] * as_is:
        return []
    close = [slip for slip in tried[1:] if slip.cost < best.cost + CLOSE * saved]
    others = [f"{slip.quantity}: {slip.got}" for slip in close if slip.got != best.got][:2]
    actual = " or ".join([best.got, *others])
    clearly = saved > A_SLIP[0] and saved > A_SLIP[1] * as_is
    if not clearly or _is_doubtful(best):
        return [f"{best.quantity}: the record fits the scene better with {actual}"]
    valid = "the record the other way round, or --as-is if it is right as it is"
    raise Refusal(run.where, best.quantity, "be those of the scene", actual, valid)


def _is_doubtful(slip: Mistake) -> bool:
    """Whether a slip is within the uncertainty of scenes."""
    by_scale = slip.scale and abs(np.log(slip.scale)) < np.log(DOUBTFUL)
    return bool(by_scale) or slip.quantity == "load"


def check_fit(where: str, joints: tuple[str, ...], explained: Array) -> None:
    """Refuse a fit that explains too little.

    Raises:
        Refusal: names the joint.
    """
    for joint, share in zip(joints, explained, strict=True):
        if not share >= POOR:
            rule = f"be explained by the machine to {POOR:g} % at least"
            valid = "look for wrong units, signs, order of axes, or a part that the scene has not"
            raise Refusal(where, f"torque of {joint}", rule, f"{share:.1f} %", valid)


SIGNALS = {"tau": "torque", "q_motor": "angle"}
NEIGHBOURS = 7  # samples, of which the middle one is judged
AROUND = 101  # samples, whose usual distance from their neighbours is the reference
TIMES = 12.0  # the usual distance
# Outliers below this share of the signal's spread are harmless: torque may jump at reversals.
MIN_OUTLIER = {"tau": 0.6, "q_motor": 2e-5}
ROUNDS = 3  # since neighbours hide each other
MAX_OUTLIERS = 0.05  # of the samples: with more it is no measurement


def replace_outliers(run: MeasuredRun) -> tuple[MeasuredRun, list[str]]:
    """Return a record without outliers, and a description of those, as text.

    Raises:
        Refusal: too many of them.
    """
    changed, messages = dict[str, Any](), list[str]()
    for name, signal in SIGNALS.items():
        rows = getattr(run, name).copy()
        for j, joint in enumerate(run.joints):
            out = np.zeros(len(rows), bool)
            for _ in range(ROUNDS):
                new = _find_outliers(rows[:, j], MIN_OUTLIER[name]) & ~out
                if not new.any():
                    break
                out |= new
                rows[out, j] = np.interp(run.t[out], run.t[~out], rows[~out, j])
            count = int(out.sum())
            if count > MAX_OUTLIERS * len(out):
                rule = f"have outliers in at most {100 * MAX_OUTLIERS:g} % of the samples"
                share = f"{100.0 * count / len(out):.1f} %"
                raise Refusal(run.where, f"{signal} of {joint}", rule, share)
            if count:
                first = run.t[int(np.argmax(out))]
                messages.append(
                    f"{signal} of {joint}: {count} outliers, the first at t = {first:.4g} s; "
                    "their neighbours stand in their place"
                )
        changed[name] = rows
    return dataclasses.replace(run, **changed), messages


def _find_outliers(signal: Array, threshold: float) -> Array:
    """Return the samples that are farther from their neighbours than usual around them."""
    # For a smooth motion, the error of a parabola through the neighbours is negligible.
    away = np.zeros_like(signal)
    near, far = signal[1:-3] + signal[3:-1], signal[:-4] + signal[4:]
    away[2:-2] = signal[2:-2] - (4.0 * near - far) / 6.0
    beside = np.minimum(
        np.abs(away), 1.5 * np.abs(signal - median_filter(signal, NEIGHBOURS, mode="nearest"))
    )
    typical = 1.4826 * median_filter(np.abs(away), AROUND, mode="nearest")
    width = float(np.quantile(signal, 0.95) - np.quantile(signal, 0.05))
    out: Array = beside > np.maximum(TIMES * typical, threshold * width)
    return out
