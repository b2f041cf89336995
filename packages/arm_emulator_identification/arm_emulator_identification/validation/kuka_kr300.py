"""The KUKA KR300 R2500 ultra, identified on one measured run, against that and further ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from arm_emulator.extension.base import Array, find_config_folder
from arm_emulator.extension.machine import Scene, load_scene
from arm_emulator_identification.filtered import Filtered, filter_run, smooth_motion
from arm_emulator_identification.free_run import (
    Starts,
    compute_drift,
    find_starts,
    simulate_free_runs,
)
from arm_emulator_identification.measured_run import MeasuredRun
from arm_emulator_identification.read_run import read_run
from arm_emulator_identification.torque_fit import compute_explained
from arm_emulator_identification.torque_model import TorqueModel
from arm_emulator_identification.validation.figure import Figure, format_table
from arm_emulator_identification.wind_up import WindUp, compute_wind_up

DATA = find_config_folder() / "validation" / "kuka_kr300"
SHIPPED = (DATA / "run_A.npz", DATA / "run_B.npz")
# Found once on run A, the same for every axis and run.
DELAYS = {"tau": 2e-3, "q_link": 3e-3}  # s
LOW_PASS = 10.0  # Hz
MOVES = np.radians(1.0)  # rad/s: at rest stiction leaves torques undetermined
IN_MOTION = np.radians(5.0)  # rad/s: of the fastest axis, where free runs begin
EVERY = 0.1  # s, from one free run to the next
LONG = (0.6, 2.0)  # s, free runs
JUDGED = (1, 2)  # axes whose wind-up is judged: axis 1 carries too little to be judged

# Limits of the identified machine on any run. The shares of null models give a figure its meaning:
# with gears ten times too stiff 0.91 of a wind-up remains, with ours 0.30 to 0.68.
MIN_EXPLAINED, MIN_OF_AXIS = 87.0, 80.0  # %, in motion
MIN_OF_ALL = 65.0  # %, mean over all samples: at rest stiction takes any torque
MIN_CAUSAL = 83.0  # %, mean, in motion, low-passed one way
MAX_DRIFT = {0.6: (8.0, 15.0), 2.0: (40.0, 60.0)}  # %, mean and each axis, after seconds
MAX_OF_NULL = 0.6  # free runs: their mean, of that of the best null model
MAX_OF_RIGID = 0.85  # wind-up: of that of rigid gears, each axis
MAX_BESIDE_WAVE = 0.7  # the same beside the encoder's wave


@dataclass(frozen=True)
class RunComparison:
    """Comparison of one run with the scene."""

    run: MeasuredRun
    data: Filtered  # every sample, low-passed
    torques: Array  # N m at the links (K, N), computed
    wind_up: WindUp
    paths: Array  # of the free runs of the first length: motor angles (K, S, N)
    begins: Array  # their first samples (S,)
    figures: tuple[Figure, ...]

    @property
    def failures(self) -> list[str]:
        """Limits that are not kept, a line each."""
        return [line for figure in self.figures for line in figure.failures]

    @property
    def is_good(self) -> bool:
        """Whether all limits are kept."""
        return not self.failures


@dataclass(frozen=True)
class Prediction:
    """Results of run A beside the machine's numbers."""

    per_axis: PerAxis
    wave_order: Array  # of the encoder at the link, waves per turn (N,)
    wave: Array  # its amplitude [rad] (N,)


@cache
def predict() -> Prediction:
    """Return the null models and the encoder's wave, identified on run A."""
    scene = load_scene("kuka_kr300")
    run = load(SHIPPED[0], scene)
    data = _filter_run(run, scene)
    of_gears = compute_wind_up(run, scene)
    return Prediction(PerAxis.fit_record(data), of_gears.order, of_gears.ripple)


def load(path: Path, scene: Scene) -> MeasuredRun:
    """Read a run as published: degrees, at the link; late signals taken from later."""
    return read_run(path, scene, angles="deg").shift_back(DELAYS)


def compare(path: Path, scene: Scene | None = None) -> RunComparison:
    """Compare a run with the scene.

    Raises:
        Refusal: the file is not such a run.
    """
    scene = scene or load_scene("kuka_kr300")
    run = load(path, scene)
    data, torques = compute_torques(scene, run)
    of_gears = compute_wind_up(run, scene)
    paths, begins, drifting = _free_runs(scene, run)
    figures = (
        *list_torque_figures(scene, run, data, torques),
        *drifting,
        *list_wind_up_figures(run, of_gears),
    )
    return RunComparison(run, data, torques, of_gears, paths, begins, figures)


def _filter_run(run: MeasuredRun, scene: Scene, causal: bool = False) -> Filtered:
    return filter_run(run, scene.gear_ratios, LOW_PASS, slowest=MOVES, every=1, causal=causal)


def _compute_torques(scene: Scene, data: Filtered) -> Array:
    ones = np.ones(len(scene.joints))
    model = TorqueModel(scene, (ones, ones), 1.0)
    return model.bind_motion(data).compute_torques(model.start)


def compute_torques(scene: Scene, run: MeasuredRun) -> tuple[Filtered, Array]:
    """Return a run low-passed, and the machine's torques for it (K, N) [N m]."""
    data = _filter_run(run, scene)
    return data, _compute_torques(scene, data)


def list_torque_figures(
    scene: Scene, run: MeasuredRun, data: Filtered, torques: Array
) -> Iterator[Figure]:
    """Yield the share of the measured torque that a machine explains, see `compute_torques`."""
    every = np.ones_like(data.moving)
    null = predict().per_axis.compute_torques(data)
    alone = compute_explained(data.tau, null - data.tau, data.moving)
    yield Figure("torque explained in motion, %: each axis by itself", alone, ".1f", yardstick=True)
    shares = compute_explained(data.tau, torques - data.tau, data.moving)
    limit = max(MIN_EXPLAINED, float(alone.mean()))
    yield Figure("torque explained in motion, %", shares, ".1f", least=MIN_OF_AXIS, min_mean=limit)
    causal = _filter_run(run, scene, causal=True)
    shares = compute_explained(
        causal.tau, _compute_torques(scene, causal) - causal.tau, causal.moving
    )
    yield Figure("  low-passed one way, %", shares, ".1f", min_mean=MIN_CAUSAL)
    alone = compute_explained(data.tau, null - data.tau, every)
    yield Figure("  all samples, %: each axis by itself", alone, ".1f", yardstick=True)
    shares = compute_explained(data.tau, torques - data.tau, every)
    limit = max(MIN_OF_ALL, float(alone.mean()))
    yield Figure("  all samples, %", shares, ".1f", min_mean=limit)


def _free_runs(scene: Scene, run: MeasuredRun) -> tuple[Array, Array, list[Figure]]:
    paths, begins, figures = np.zeros(0), np.zeros(0), list[Figure]()
    for seconds in LONG:
        begin = find_starts(run, scene, seconds, EVERY, IN_MOTION)
        looks = range(1, round(seconds / run.period) + 1)
        angles = simulate_free_runs(scene, run, begin, looks)
        if not paths.size:
            paths, begins = angles, begin.at
        title = f"free run of {seconds:g} s, % off"
        nulls = {
            "constant speed": predict_constant_speed(run, begin, seconds),
            "constant acceleration": predict_constant_acceleration(run, begin, seconds, LOW_PASS),
            "each axis by itself": predict().per_axis.free_run(
                run, begin, seconds, scene.gear_ratios
            ),
        }
        best = np.full(len(scene.joints), np.inf)
        for name, ends in nulls.items():
            null = 100.0 * compute_drift(run, begin, len(looks), ends).share
            best = min(best, null, key=np.mean)
            figures.append(Figure(f"{title}: {name}", null, ".1f", yardstick=True))
        off = 100.0 * compute_drift(run, begin, len(looks), angles[-1]).share
        mean, each = MAX_DRIFT[seconds]
        figures.append(Figure(title, off, ".1f", most=each, max_mean=mean))
        share = float(off.mean() / best.mean())
        figures.append(
            Figure("  of the best of these", off / best, ".2f", max_mean=MAX_OF_NULL, overall=share)
        )
    return paths, begins, figures


def list_wind_up_figures(run: MeasuredRun, of_gears: WindUp) -> Iterator[Figure]:
    """Yield the measured wind-up that remains beside the computed one."""
    rigid = np.degrees(of_gears.unexplained)
    yield Figure("wind-up, deg rms: rigid gears", rigid, ".4f", yardstick=True)
    share = of_gears.residual / of_gears.unexplained
    yield _compare_with_rigid("  not computed, of that", share, MAX_OF_RIGID)
    # Only the phase of the encoder's wave is specific to the run, as its zero is.
    wave, q = predict(), run.q_motor[np.searchsorted(run.t, of_gears.t)]
    left, all_runs = (
        _remove_wave(error, q, wave.wave_order, wave.wave)
        for error in (of_gears.measured - of_gears.computed, of_gears.measured)
    )
    yield _compare_with_rigid(
        "  the same beside the encoder's wave of run A", left / all_runs, MAX_BESIDE_WAVE
    )


def _compare_with_rigid(title: str, share: Array, limit: float) -> Figure:
    judged = np.full(len(share), np.nan)
    judged[list(JUDGED)] = share[list(JUDGED)]
    return Figure(title, judged, ".2f", most=limit, needed=JUDGED)


def _remove_wave(error: Array, q: Array, order: Array, amplitude: Array) -> Array:
    """Return the root of mean square (N,) of errors (K, N) beside a wave whose phase is free."""
    phase = np.angle(np.mean(error * np.exp(-1j * order * q), axis=0))
    rest = error - amplitude * np.cos(order * q + phase)
    return np.asarray(np.sqrt(np.mean((rest - rest.mean(axis=0)) ** 2, axis=0)))


# Null models of the KUKA KR300: a comparison must distinguish them from our machine.
#
# None of them models the arm. Their numbers, if any, come from run A, as the machine's do.

STEP = 1e-3  # s, of `PerAxis.free_run`


@dataclass(frozen=True)
class PerAxis:
    """Each axis by itself: inertia, viscous and dry friction, a weight that turns with the angle.

    tau = c0 + c1 sign(v) + c2 v + c3 a + c4 cos(q) + c5 sin(q)
    """

    coefficients: Array  # (N, 6)

    @classmethod
    def fit_record(cls, data: Filtered) -> PerAxis:
        """Return the least-squares fit to a record, over its samples in motion."""
        rows = []
        for j in range(data.q.shape[1]):
            A, moving = _list_features(data, j), data.moving[:, j]
            rows.append(np.linalg.lstsq(A[moving], data.tau[moving, j], rcond=None)[0])
        return cls(np.array(rows))

    def compute_torques(self, data: Filtered) -> Array:
        """Return the torques of a motion (K, N) [N m]."""
        axes = range(len(self.coefficients))
        return np.column_stack([_list_features(data, j) @ self.coefficients[j] for j in axes])

    def free_run(self, run: MeasuredRun, begin: Starts, seconds: float, ratio: Array) -> Array:
        """Return angles (S, N) [rad] after some time under the measured torques; gears (N,)."""
        c = self.coefficients.T
        q, v = begin.q.copy(), begin.v.copy()
        every = round(run.period / STEP)
        tau = run.tau / ratio
        for sample in range(round(seconds / run.period)):
            at = begin.at + sample
            torque = 0.5 * (tau[at] + tau[at + 1])
            for _ in range(every):
                rest = c[0] + c[1] * np.sign(v) + c[2] * v + c[4] * np.cos(q) + c[5] * np.sin(q)
                v += STEP * (torque - rest) / c[3]
                q += STEP * v
        end: Array = q
        return end


def predict_constant_speed(run: MeasuredRun, begin: Starts, seconds: float) -> Array:
    """Return angles (S, N) [rad] after some time at the speed of the start."""
    return np.asarray(run.q_motor[begin.at] + seconds * begin.v)


def predict_constant_acceleration(
    run: MeasuredRun, begin: Starts, seconds: float, low: float
) -> Array:
    """Return angles (S, N) [rad] after some time at the acceleration of the start.

    Args:
        run: the record.
        begin: the starts.
        seconds: time of each.
        low: low-pass of the acceleration [Hz]; it looks ahead, so that this one knows more than the
            machine does.
    """
    a = smooth_motion(run.q_motor, run.period, low)[2][begin.at]
    ends: Array = predict_constant_speed(run, begin, seconds) + 0.5 * seconds**2 * a
    return ends


def _list_features(data: Filtered, j: int) -> Array:
    q, v = data.q[:, j], data.v[:, j]
    ones = np.ones(len(q))
    return np.column_stack([ones, data.direction[:, j], v, data.a[:, j], np.cos(q), np.sin(q)])


WIDTH = 150  # characters of the tables


def validate_kuka(runs: Sequence[Path], folder: Path, console: Console) -> dict[str, Any]:
    """Compare with runs, print, draw into a folder, and return the same for programs.

    Args:
        runs: files as run_A.npz; none: the shipped ones.
        folder: of the pictures.
        console: for the tables.

    Raises:
        Refusal: a file is not such a run.
    """
    scene = load_scene("kuka_kr300")
    paths = list(runs) or list(SHIPPED)
    comparisons = [
        compare(path, scene) for path in track(paths, "kuka_kr300", console=Console(stderr=True))
    ]
    compared = []
    for comparison in comparisons:
        title = f"KUKA KR300, identified on run A, beside {comparison.run.where}"
        console.print(format_table(title, scene.joint_names, comparison.figures))
        picture = folder / f"kuka_kr300_{Path(comparison.run.where).stem}.png"
        draw(comparison, scene.joint_names, picture)
        for failure in comparison.failures:
            console.print(f"[red]{failure}")
        verdict = "good" if comparison.is_good else "NOT GOOD"
        console.print(f"{comparison.run.where}: {verdict}; picture: {picture}")
        figures = [
            {"title": f.title, "values": f.values, "mean": f.mean, "limits": f.limits}
            for f in comparison.figures
        ]
        compared.append(
            {
                "record": comparison.run.where,
                "good": comparison.is_good,
                "failures": comparison.failures,
                "figures": figures,
                "picture": picture,
            }
        )
    return {"good": all(comparison.is_good for comparison in comparisons), "runs": compared}


PICTURED = 5  # free runs: one of this many is drawn


def draw(comparison: RunComparison, names: tuple[str, ...], file: Path) -> None:
    """Draw torques, free runs and wind-up of each axis."""
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    N, data, run = len(names), comparison.data, comparison.run
    figure = Figure(figsize=(15, 1.9 * N), layout="constrained")
    axes = figure.subplots(N, 3, sharex=True)
    for j, (row, name) in enumerate(zip(axes, names, strict=True)):
        torque, free, wind_up = row
        moving = np.where(data.moving[:, j], 1.0, np.nan)
        torque.plot(data.t, data.tau[:, j], color="0.6", lw=1.2)
        torque.plot(data.t, comparison.torques[:, j] * moving, "C0", lw=1.0)
        torque.plot(data.t, (data.tau - comparison.torques)[:, j] * moving, "C3", lw=0.7)
        torque.set_ylabel(name)
        free.plot(run.t, np.degrees(run.q_motor[:, j]), color="0.6", lw=1.2)
        for k in range(0, len(comparison.begins), PICTURED):
            at = comparison.begins[k]
            t = run.t[at + 1 : at + 1 + len(comparison.paths)]
            free.plot(t, np.degrees(comparison.paths[:, k, j]), "C0", lw=1.0)
        if np.isfinite(comparison.wind_up.measured[:, j]).any():
            t, measured = comparison.wind_up.t, np.degrees(comparison.wind_up.measured[:, j])
            computed = np.degrees(comparison.wind_up.computed[:, j])
            wind_up.plot(t, measured, color="0.6", lw=0.8)
            wind_up.plot(t, computed, "C0", lw=1.0)
            wind_up.plot(t, measured - computed, "C3", lw=0.6)
        else:
            wind_up.set_axis_off()
        for each in row:
            each.grid(alpha=0.3)
    titles = ("torque at the link, N m, below 10 Hz", "motor at the link, deg: free runs",
              "wind-up, deg")  # fmt: skip
    for each, title in zip(axes[0], titles, strict=True):
        each.set_title(f"{title}\ngrey: measured, blue: computed, red: residual", fontsize="small")
    for each in axes[-1]:
        each.set_xlabel("s")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=85)
