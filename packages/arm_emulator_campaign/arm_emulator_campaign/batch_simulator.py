"""Runs of a campaign side by side: each is an arm of a fleet, its servo in the same lanes.

What varies is bound once for the campaign: a run is then a row of numbers, rows of targets, and
changes at their ticks, and its whole way is C.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array, Refusal
from arm_emulator_campaign.case import Case
from arm_emulator_campaign.definition.campaign_file import Campaign
from arm_emulator_campaign.definition.scenario import Scenario
from arm_emulator_campaign.evaluators import Evaluators, count_most_samples
from arm_emulator_campaign.program import BLOCK, Program, Targets
from arm_emulator_campaign.results.outcome import Outcome, Outcomes
from arm_emulator_campaign.signals import FleetSampler
from arm_emulator_campaign.simulator import BoundCase, Simulator, bind_case
from arm_emulator_fleet import Fleet, FleetWay, ServoFleet

if TYPE_CHECKING:
    from arm_emulator_campaign.device_program import DeviceProgram

WIDTH = 64  # runs at a time
# On a device: as many as samples and judges have memory for, at most so many.
LARGEST_WIDTH = 2**14
MEMORY = 2**30  # bytes of both
# Samples in a piece: whole blocks of the judges, which the processor's cache holds. Rows of a power
# of two would all begin in the same set of that cache.
ROOM = 7 * BLOCK


class _Run(NamedTuple):
    """A run as its arm gets it, with the numbers of the arm."""

    numbers: Array
    bound: BoundCase


class BatchSimulator:
    """Simulates runs of a campaign whose targets go to the servo, many at a time.

    A run is the same to the last bit whatever runs are beside it, and equals that of a `Simulator`
    but for the rounding of lanes, some 1e-16 a step.

    Attributes:
        width: runs at a time.

    Args:
        campaign: which one.
        device: of the arms, see `Fleet`; None: the processor's lanes.

    Raises:
        Refusal: the campaign is one that cannot run there, or no such device.
    """

    def __init__(self, campaign: Campaign, device: str | None = None) -> None:
        self._campaign = campaign
        if device is not None and campaign.scene.threads > 1:
            rule = "be 1 on a device: its arms are its threads"
            raise Refusal(campaign.where, "threads", rule, campaign.scene.threads)
        # First, since its refusals need no compiler.
        self.width, self._evaluators, program = _choose_judges(campaign, device)
        width = self.width
        scenario, _, servo = campaign.nominal
        self._scene = scene = campaign.scene
        self._names = [number.name for number in campaign.variation.numbers]
        self._numbers = {number.name: (k, number.number) for k, number in enumerate(scene.varied)}
        self._seed = self._numbers["seed"][0] if scene.has_sensor_errors else None
        self._own = np.array([number.value for number in scene.varied], np.float64)
        make_sampler, kernels = _choose_sampler(device, program is not None)
        self._fleet = Fleet(scene, width, workers=1, device=device, kernels=kernels)
        if program is not None:
            program.move(self._fleet.core.device, width)
        self._servos = ServoFleet(self._fleet, servo)
        self._tuned = [servo] * width
        self._sampler = make_sampler(self._fleet, self._evaluators.samples, ROOM)
        self._schedule = FleetWay(scene, width, self._sampler.look, self._sampler.with_)
        self._frame = self._fleet.frame()
        self._aimed: list[Scenario] = []
        self._aim([scenario])

    def runs(self, cases: Sequence[Case]) -> Iterator[Outcomes]:
        """Simulate runs and judge them; yield some after the other.

        Raises:
            Refusal: values of a run that are out of range; those before it have been yielded.
        """
        for first in range(0, len(cases), self.width):
            runs: list[_Run] = []
            refused = None
            for case in cases[first : first + self.width]:
                try:
                    runs.append(self._bind(case))
                except Refusal as no:
                    where = f"{self._campaign.where}, run {case.index}"
                    refused = Refusal(where, no.quantity, no.rule, no.got, no.valid)
                    break
            if runs:
                yield self._run(cases[first : first + len(runs)], runs)
            if refused is not None:
                raise refused

    def run(self, case: Case) -> Outcome:
        """Simulate one run and judge it: to the last bit as beside others.

        Raises:
            Refusal: values of this run that are out of range.
        """
        (outcomes,) = self.runs([case])
        return Outcome.of(self._campaign, case, outcomes)

    def _bind(self, case: Case) -> _Run:
        """Return a run as its arm gets it.

        Raises:
            Refusal: a value that is out of range.
        """
        bound_case, numbers = bind_case(self._campaign, case), self._own.copy()
        for name, value in case.values.items():
            if name in self._numbers:
                place, number = self._numbers[name]
                numbers[place] = number.take("", value)
        if self._seed is not None and "seed" not in case.values:
            numbers[self._seed] = case.seed
        return _Run(numbers, bound_case)

    def _run(self, cases: Sequence[Case], runs: Sequence[_Run]) -> Outcomes:
        self._begin(runs)
        evaluators, sampler, fleet, frame = (
            self._evaluators,
            self._sampler,
            self._fleet,
            self._frame,
        )
        count, last = len(runs), np.array([run.bound.last for run in runs])
        evaluators.begin()
        sampler.forget()
        fleet.look(self._schedule)
        taken = np.zeros(count, np.int64)
        while True:
            some = int(min(ROOM - (taken[0] == 0), last.max() + 1 - max(1, taken.max())))
            fleet.follow(self._servos, some, frame, way=self._schedule, arms=count)
            samples, counts = sampler.take()
            fresh = np.maximum(np.minimum(last + 1 - taken, counts[:count]), 0)
            evaluators.take(samples, fresh, self._targets)
            taken += counts[:count]
            # An arm stands still where it diverged; one whose run has ended goes on for nothing.
            ended = taken > last
            faults, t = _copy_out(frame.faults)[:count], _copy_out(frame.t)[:count]
            diverged = (faults >= 0) & (t < (last - 0.5) * self._scene.servo_period)
            if np.all(ended | diverged):
                break
        robustness, measures = evaluators.end(diverged)
        values = [[case.values[name] for name in self._names] for case in cases]
        return Outcomes(
            np.array([case.index for case in cases], np.int64),
            np.array(values, np.float64).reshape(count, len(self._names)),
            robustness,
            measures,
            np.where(diverged, t, np.nan),
        )

    def _begin(self, runs: Sequence[_Run]) -> None:
        """Set arms and servos to the starts of runs; further arms begin as the last one."""
        fleet, servos = self._fleet, self._servos
        rows = [*runs, *[runs[-1]] * (self.width - len(runs))]
        every = [row.bound for row in rows]
        fleet.powered = True
        numbers = np.array([row.numbers for row in rows])
        fleet.set_parameters(numbers)
        self._sampler.place_joints(numbers)
        fleet.reset(q=np.array([run.scenario.start for run in every]))
        for arm, run in enumerate(every):
            if run.servo is not self._tuned[arm]:
                servos.retune(arm, run.servo)
                self._tuned[arm] = run.servo
        self._schedule.set_changes([run.changes for run in every])
        self._aim([run.scenario for run in every])
        servos.reset()

    def _aim(self, scenarios: Sequence[Scenario]) -> None:
        """Give the servos the targets of each arm; one scenario is that of all."""
        every = [*scenarios] * (self.width if len(scenarios) == 1 else 1)
        if len(self._aimed) == len(every) and all(map(operator.is_, self._aimed, every)):
            return
        period = self._scene.servo_period
        tables = [run.table for run in every]
        self._targets = Targets.of([(table.ticks(period), table.q) for table in tables])
        self._servos.aim_at(self._targets.since, self._targets.q, self._targets.first)
        self._aimed = every


def _choose_judges(
    campaign: Campaign, device: str | None
) -> tuple[int, Evaluators, DeviceProgram | None]:
    """Return how many runs go at a time, what judges them, and its program if it is on a device.

    The processor judges functions of Python, positions of the tool, which it computes, and runs of
    any length, of which nobody knows how much a requirement keeps.
    """
    if device is None:
        return WIDTH, Evaluators(campaign, ROOM, WIDTH), None
    one, program = Evaluators(campaign, ROOM), None
    most = count_most_samples(campaign)
    if not (one.needs_processor or most is None):
        # Nothing of it is loaded for the processor's lanes.
        from arm_emulator_campaign.device_program import DeviceProgram

        def make_program(*of_program: Any) -> Program:
            nonlocal program
            program = DeviceProgram(most, *of_program)
            return program

        one = Evaluators(campaign, ROOM, make_program=make_program)
    bytes_per_run = 8 * ROOM * (len(one.samples) + len(campaign.scene.joints))
    if program is not None:
        bytes_per_run += program.bytes_per_run
    width = max(1, min(LARGEST_WIDTH, MEMORY // bytes_per_run))
    if campaign.search is None:
        width = min(width, campaign.count)
    return width, one if program is not None else Evaluators(campaign, ROOM, width), program


def _choose_sampler(
    device: str | None, stays: bool
) -> tuple[Callable[[Fleet, Sequence[str], int], FleetSampler], Sequence[Path]]:
    if device is None:
        return FleetSampler, ()
    from arm_emulator_campaign.device_sampler import KERNELS, DeviceSampler

    return partial(DeviceSampler, stays=stays), KERNELS


def _copy_out(row: Any) -> NDArray[Any]:
    """Return numbers of a frame as an array of the processor."""
    copy: NDArray[Any] = row if isinstance(row, np.ndarray) else row.numpy()
    return copy


def make_simulator(campaign: Campaign, device: str | None = None) -> Simulator | BatchSimulator:
    """Return what simulates a campaign's runs.

    In lanes, but for moves of the tool: the motion controller that leads them is Python.

    Args:
        campaign: which one.
        device: see `BatchSimulator`.

    Raises:
        Refusal: see there; or moves of the tool for a device.
    """
    if device is not None:
        if campaign.nominal[0].moves:
            rule = "be absent on a device, since the motion controller is Python"
            raise Refusal(campaign.where, "scenario.moves", rule, "moves of the tool", "targets")
        return BatchSimulator(campaign, device)
    return Simulator(campaign) if campaign.nominal[0].moves else BatchSimulator(campaign)
