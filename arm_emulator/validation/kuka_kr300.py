"""The KUKA KR300 R2500 ultra, identified on one measured run, against that and further ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arm_emulator.identification.filtered import Filtered, filtered
from arm_emulator.identification.free_run import Drift, drift, free_runs, starts
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.read_run import read_run
from arm_emulator.identification.torque_fit import explained
from arm_emulator.identification.torque_model import TorqueModel
from arm_emulator.identification.wind_up import WindUp, wind_up
from arm_emulator.validation.kuka_closed_loop import ClosedLoop, closed_loop
from emulator_node.chain import Array
from emulator_node.scene import Scene, load_scene
from words.config_files import config_folder

DATA = config_folder() / "validation" / "kuka_kr300"
SHIPPED = (DATA / "run_A.npz", DATA / "run_B.npz")
# Found once on run A, the same for every axis and run.
DELAYS = {"tau": 2e-3, "q_link": 3e-3}  # s
LOW_PASS = 10.0  # Hz
MOVES = np.radians(1.0)  # rad/s: at rest stiction leaves torques undetermined
IN_MOTION = np.radians(5.0)  # rad/s: of the fastest axis, where free runs begin
EVERY = 0.1  # s, from one free run to the next
LONG = (0.6, 2.0)  # s, free runs
ELASTIC = slice(1, 3)  # axes whose wind-up is judged: axis 1 carries too little to tell

# What the identified machine must reach on any run.
LEAST_EXPLAINED, LEAST_OF_AXIS = 87.0, 80.0  # %
MOST_DRIFT, MOST_OF_AXIS = 8.0, 15.0  # %, after 0.6 s
MOST_RESIDUAL = 0.004  # deg, of the wind-up, the ripple of the encoder at the link apart


@dataclass(frozen=True)
class Comparison:
    """One run beside the scene."""

    run: MeasuredRun
    data: Filtered  # every sample, low-passed
    torques: Array  # N m at the links (K, N), computed
    explained: Array  # % (N,)
    wind_up: WindUp
    drifts: tuple[Drift, ...]  # one of each length of `LONG`
    paths: Array  # of the free runs of the first length: motor angles (K, S, N)
    begins: Array  # their first samples (S,)
    closed_loop: ClosedLoop | None  # under our own servo; None: the run tells no command

    @property
    def good(self) -> bool:
        """Whether it is as close as it should be."""
        short = 100.0 * self.drifts[0].share
        return bool(
            self.explained.mean() >= LEAST_EXPLAINED
            and self.explained.min() >= LEAST_OF_AXIS
            and short.mean() <= MOST_DRIFT
            and short.max() <= MOST_OF_AXIS
            and np.degrees(self.wind_up.rest[ELASTIC]).max() <= MOST_RESIDUAL
        )


def load(path: Path, scene: Scene) -> MeasuredRun:
    """Read a run as published: degrees, at the link; late signals taken from later."""
    return read_run(path, scene, angles="deg").shifted(DELAYS)


def compare(path: Path, scene: Scene | None = None) -> Comparison:
    """Hold a run against the scene.

    Raises:
        Refusal: the file is no such run.
    """
    scene = scene or load_scene("kuka_kr300")
    run = load(path, scene)
    ratio = scene.gear_ratios
    data = filtered(run, ratio, LOW_PASS, slowest=MOVES, every=1)
    one = np.ones(len(ratio))
    model = TorqueModel(scene, (one, one), 1.0)
    torques = model.of(data).torques(model.start)
    drifts, paths, begins = list[Drift](), np.zeros(0), np.zeros(0)
    for seconds in LONG:
        begin = starts(run, scene, seconds, EVERY, IN_MOTION)
        looks = range(1, round(seconds / run.period) + 1)
        angles = free_runs(scene, run, begin, looks)[0]
        drifts.append(drift(run, begin, angles))
        if not paths.size:
            paths, begins = angles, begin.at
    shares = explained(data.tau, torques - data.tau, data.moving)
    closed = closed_loop(run, data, LOW_PASS)
    of_gears = wind_up(run, scene)
    return Comparison(run, data, torques, shares, of_gears, tuple(drifts), paths, begins, closed)
