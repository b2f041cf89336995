"""Runs of a campaign side by side: each is an arm of a fleet, its servo in the same lanes.

What varies is bound once for the campaign: a run is then a row of numbers, rows of targets, and
changes at their ticks, and its whole way is C.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.runs import ServoConfig
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.judging.evaluators import Evaluators, count_most_samples
from arm_emulator_campaign.judging.program import BLOCK, Targets
from arm_emulator_campaign.judging.signals import FleetSampler
from arm_emulator_campaign.simulation.bound_cases import BoundCases, bind_cases
from arm_emulator_campaign.simulation.case import Case, Cases
from arm_emulator_campaign.simulation.outcome import Outcome, Outcomes
from arm_emulator_campaign.simulation.simulator import Simulator, bind_case
from arm_emulator_fleet import Fleet, FleetWay, ServoFleet

if TYPE_CHECKING:
    from arm_emulator_campaign.judging.device_program import DeviceProgram

WIDTH = 64  # runs at a time
# Runs that are bound at a time, at least: for vectors of more than 10 000 numbers OpenBLAS would
# start threads.
BOUND = 3072
# On a device: as many as samples and judges have memory for, at most so many.
LARGEST_WIDTH = 2**14
MEMORY = 2**30  # bytes of both
# Samples in a piece: whole blocks of the judges, which the processor's cache holds. Rows of a power
# of two would all begin in the same set of that cache.
ROOM = 7 * BLOCK


class BatchSimulator:
    """Simulates runs of a campaign whose targets go to the servo, many at a time.

    A run is the same to the last bit whatever runs are beside it. It equals that of a `Simulator`
    except for the rounding of lanes, some 1e-16 a step.

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
        self._block = width * max(1, BOUND // width)
        make_sampler, kernels = _choose_sampler(device, program is not None)
        self._fleet = Fleet(scene, width, workers=1, device=device, kernels=kernels)
        if program is not None:
            program.move_runs(self._fleet.core.device, width)
        self._servos = ServoFleet(self._fleet, servo)
        self._tuned = [servo] * width
        self._sampler = make_sampler(self._fleet, self._evaluators.samples, ROOM)
        self._schedule = FleetWay(scene, width, self._sampler.look, self._sampler.with_)
        self._frame = self._fleet.frame()
        table = scenario.table
        self._nominal = Targets.stack_runs(
            [(table.compute_ticks(scene.servo_period), table.q)] * width
        )
        self._targets = self._nominal
        self._servos.aim_at(self._targets.since, self._targets.q, self._targets.first)

    def simulate_runs(self, cases: Cases) -> Iterator[Outcomes]:
        """Simulate runs and judge them; yield some after the other.

        Raises:
            Refusal: values of a run that are out of range; those before it have been yielded.
        """
        for first in range(0, len(cases), self._block):
            some = cases[first : first + self._block]
            try:
                bound = bind_cases(self._campaign, some)
            except Refusal as no:
                place, refused = self._find_refused(some, no)
                yield from self.simulate_runs(some[:place])
                raise refused from None
            for begin in range(0, len(some), self.width):
                yield self._simulate_bound(some, bound, begin, min(begin + self.width, len(some)))

    def simulate_run(self, case: Case) -> Outcome:
        """Simulate one run and judge it: to the last bit as beside others.

        Raises:
            Refusal: values of this run that are out of range.
        """
        (outcomes,) = self.simulate_runs(Cases.stack_runs([case]))
        return Outcome.create_from_judged(self._campaign, case, outcomes)

    def _find_refused(self, cases: Cases, otherwise: Refusal) -> tuple[int, Refusal]:
        """Return the place of the first run that is refused alone, and its refusal."""
        varied = {number.name: number.number for number in self._scene.varied}
        for place, case in enumerate(cases):
            try:
                bind_case(self._campaign, case)
                for name in varied.keys() & case.values.keys():
                    varied[name].check_value("", case.values[name])
            except Refusal as no:
                where = f"{self._campaign.where}, run {case.index}"
                return place, Refusal(where, no.quantity, no.rule, no.got, no.valid)
        return 0, otherwise

    def _simulate_bound(self, cases: Cases, bound: BoundCases, first: int, end: int) -> Outcomes:
        """Simulate the runs [first, end) of those that are bound."""
        self.begin_runs(bound, first, end)
        evaluators, sampler, fleet, frame = (
            self._evaluators,
            self._sampler,
            self._fleet,
            self._frame,
        )
        count, last = end - first, bound.last[first:end]
        evaluators.begin_runs()
        sampler.forget_samples()
        fleet.look(self._schedule)
        taken = np.zeros(count, np.int64)
        while True:
            some = int(min(ROOM - (taken[0] == 0), last.max() + 1 - max(1, taken.max())))
            fleet.follow(self._servos, some, frame, way=self._schedule, arms=count)
            samples, counts = sampler.take_samples()
            fresh = np.maximum(np.minimum(last + 1 - taken, counts[:count]), 0)
            evaluators.take_samples(samples, fresh, self._targets)
            taken += counts[:count]
            # An arm stands still where it diverged; one whose run has ended goes on for nothing.
            ended = taken > last
            faults, t = _copy_out(frame.faults)[:count], _copy_out(frame.t)[:count]
            diverged = (faults >= 0) & (t < (last - 0.5) * self._scene.servo_period)
            if np.all(ended | diverged):
                break
        robustness, measures = evaluators.end_runs(diverged)
        return Outcomes(
            cases.indices[first:end],
            cases.values[first:end],
            robustness,
            measures,
            np.where(diverged, t, np.nan),
        )

    def begin_runs(self, bound: BoundCases, first: int, end: int) -> None:
        """Set arms and servos to the starts of runs; further arms begin as the last one."""
        fleet, servos = self._fleet, self._servos
        runs = np.minimum(np.arange(first, first + self.width), end - 1)
        fleet.powered = True
        numbers = bound.numbers[runs]
        fleet.set_parameters(numbers)
        self._sampler.place_joints(numbers)
        fleet.reset(q=bound.start[runs if len(bound.start) > 1 else 0])
        self._tune_servos(
            [bound.servos[run] for run in runs] if len(bound.servos) > 1 else bound.servos
        )
        self._referenced = bound, bound.changes.give_to(self._schedule, first, end)
        self._set_targets(self._nominal if bound.targets is None else bound.targets.take_runs(runs))
        servos.reset()

    def _tune_servos(self, configs: Sequence[ServoConfig]) -> None:
        """Give each servo its gains; one config is that of all."""
        every = [*configs] * (self.width if len(configs) == 1 else 1)
        for arm in range(self.width) if every != self._tuned else ():
            if every[arm] is not self._tuned[arm]:
                self._servos.retune(arm, every[arm])
        self._tuned = every

    def _set_targets(self, targets: Targets) -> None:
        """Give the servos the targets of each arm."""
        if targets is not self._targets:
            self._servos.aim_at(targets.since, targets.q, targets.first)
        self._targets = targets


def _choose_judges(
    campaign: Campaign, device: str | None
) -> tuple[int, Evaluators, DeviceProgram | None]:
    """Return how many runs go at a time, what judges them, and its program if it is on a device.

    The processor judges functions of Python, and positions of the tool, which it computes. It
    judges runs of any length, since the memory of their requirements is unknown.
    """
    if device is None:
        return WIDTH, Evaluators(campaign, ROOM, WIDTH), None
    one, program = Evaluators(campaign, ROOM), None
    bytes_per_run = 8 * ROOM * (len(one.samples) + len(campaign.scene.joints))
    most = count_most_samples(campaign)
    if not (one.needs_processor or most is None):
        # Nothing of it is loaded for the processor's lanes.
        from arm_emulator_campaign.judging.device_program import DeviceProgram

        one = Evaluators(campaign, ROOM, make_program=DeviceProgram)
        assert isinstance(one.program, DeviceProgram)
        program = one.program
        bytes_per_run += program.measure_run(most)
    width = max(1, min(LARGEST_WIDTH, MEMORY // bytes_per_run))
    if campaign.search is None:
        width = min(width, campaign.count)
    return width, one if program is not None else Evaluators(campaign, ROOM, width), program


def _choose_sampler(
    device: str | None, stays: bool
) -> tuple[Callable[[Fleet, Sequence[str], int], FleetSampler], Sequence[Path]]:
    if device is None:
        return FleetSampler, ()
    from arm_emulator_campaign.judging.device_sampler import KERNELS, DeviceSampler

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
