"""A worker: simulates chunks of runs and writes each as a part of the results."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import cache
from multiprocessing.queues import Queue
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from arm_emulator.extension.base import Array, Refusal
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.results.parts import write_part
from arm_emulator_campaign.simulation.batch_simulator import BatchSimulator, make_simulator
from arm_emulator_campaign.simulation.case import Cases, draw_cases, place_cases
from arm_emulator_campaign.simulation.outcome import Outcomes
from arm_emulator_campaign.simulation.simulator import Simulator

_PR_SET_PDEATHSIG = 1
_requests = {"end": False, "busy": False}
_own = threading.local()  # `device` of this thread
Result = TypeVar("Result")


class Done(NamedTuple):
    """Result of a chunk.

    Attributes:
        runs: that were simulated.
        failures: of each requirement, and of any of them last (R + 1,).
        seconds: of this process that they took.
        whole: whether all runs of the chunk are done.
        outputs: robustness and measures of each run, if it is one of a search (K, M).
    """

    runs: int
    failures: tuple[int, ...]
    seconds: float
    whole: bool
    outputs: Array | None = None


def get_simulator(file: str, key: bytes) -> tuple[Campaign, Simulator | BatchSimulator]:
    """Return a campaign and this thread's machines for it, on its device.

    Raises:
        Refusal: the campaign is not the same here, or cannot run on the device.
    """
    return _make_simulator(file, key, threading.get_ident(), getattr(_own, "device", None))


@cache
def _make_simulator(
    file: str, key: bytes, thread: int, device: str | None
) -> tuple[Campaign, Simulator | BatchSimulator]:
    campaign = load_same_campaign(file, key)
    return campaign, make_simulator(campaign, device)


def use_device(device: str | None) -> None:
    """Let this thread simulate on a device from now on; None: in lanes of the processor."""
    _own.device = device


def call_on(device: str, function: Callable[..., Result], *arguments: Any) -> Result:
    """Return what a function returns in a thread that simulates on a device."""
    use_device(device)
    try:
        return function(*arguments)
    finally:
        use_device(None)


def load_same_campaign(file: str, key: bytes) -> Campaign:
    """Return a campaign.

    Raises:
        Refusal: it is not the same here.
    """
    campaign = load_campaign(Path(file))
    if campaign.key != key:
        rule = "be the same for all workers"
        raise Refusal(campaign.where, "the campaign", rule, "another one, or other files")
    return campaign


def simulate_chunk(
    file: str, key: bytes, folder: str, first: int, end: int, points: Array | None = None
) -> Done:
    """Simulate the runs [first, end) and write those that are done as a part.

    Args:
        file: of the campaign.
        key: of the campaign.
        folder: of the results.
        first: index of a run.
        end: index after the last one.
        points: of these runs, in normal scores (K, D); None: they are sampled.

    Raises:
        Refusal: values of a run that are out of range; the runs before it are written.
    """
    campaign, simulator = get_simulator(file, key)
    outcomes: list[Outcomes] = []
    began = time.process_time()
    _requests["busy"] = True
    try:
        for run in simulator.simulate_runs(_make_cases(campaign, first, end, points)):
            outcomes.append(run)  # those before a run that is refused, too
            if _requests["end"]:
                break
    finally:
        done = Outcomes.join_outcomes(outcomes) if outcomes else None
        if done is not None:
            write_part(Path(folder), campaign, done)
        _requests["busy"] = False
    if _requests["end"]:
        os._exit(0)
    failures: tuple[int, ...] = (0,) * (len(campaign.requirements) + 1)
    runs, points_values = 0, None
    if done is not None:
        broken = np.count_nonzero(~(done.robustness >= 0.0), axis=0)
        failures, runs = (*broken.tolist(), int(np.count_nonzero(done.failed))), len(done)
        points_values = np.hstack([done.robustness, done.measures])
    spent = time.process_time() - began
    return Done(
        runs, failures, spent, runs == end - first, None if points is None else points_values
    )


def _make_cases(campaign: Campaign, first: int, end: int, points: Array | None) -> Cases:
    """Return the runs of a chunk."""
    indices = np.arange(first, end)
    if points is None:
        return draw_cases(campaign.variation, indices)
    return place_cases(campaign.variation, indices, points)


def begin_worker(parent: int, devices: Queue[str] | None) -> None:
    """Prepare this process as a worker of a parent; it takes one of the devices, if there are any.

    It follows the parent, see `follow_parent`.
    """
    follow_parent(parent)
    if devices is not None:
        use_device(devices.get())


def follow_parent(parent: int) -> None:
    """End this process, with its results written, when its parent ends or requests it.

    Ctrl-C in a terminal, or its end, reaches all processes of a group: the parent decides.
    """
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end_worker)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        sys.exit(0)


def _end_worker(signal_number: int, frame: object) -> None:
    _requests["end"] = True
    if not _requests["busy"]:
        os._exit(0)
