"""One run after the other: a run is a function of the campaign and its index."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from arm_emulator.extension.base import Array, Refusal
from arm_emulator.extension.machine import Change, Diverged, NumberChange
from arm_emulator.extension.runs import (
    OfflineRun,
    Pose,
    ServoConfig,
    ServoDrives,
    ServoStep,
    TableRun,
    TargetTable,
)
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.fault import schedule_changes
from arm_emulator_campaign.definition.scenario import Move, Scenario, count_ticks
from arm_emulator_campaign.judging.evaluators import Evaluators
from arm_emulator_campaign.judging.program import Targets
from arm_emulator_campaign.judging.signals import Sampler
from arm_emulator_campaign.simulation.case import Case, Cases, draw_case
from arm_emulator_campaign.simulation.outcome import Outcome, Outcomes

ROOM = 4096  # samples in a batch for requirements
MAX_TICKS = 2**31  # ticks of a piece


class Simulator:
    """Simulates the runs of a campaign, with one machine that is reset for each.

    Attributes:
        session: the machine.
        width: runs at a time.

    Args:
        campaign: which one.
    """

    width = 1

    def __init__(self, campaign: Campaign) -> None:
        self._campaign = campaign
        self._evaluators = Evaluators(campaign, ROOM)  # first, since its refusals need no compiler
        scenario, _, servo = campaign.nominal
        self._scene, self._tuned = campaign.scene, servo
        self._parameters = {number.name for number in campaign.scene.varied}
        self._sensed = campaign.scene.has_sensor_errors
        self._run = self._make_run(scenario, servo)
        self.session = self._run.session
        self._fresh = self.session.plant.save()
        self._sampler = Sampler(self.session.plant, self._evaluators.samples, ROOM)

    def _make_run(self, scenario: Scenario, servo: ServoConfig) -> OfflineRun | TableRun:
        """Return machine and controller of the scenario."""
        if scenario.moves:
            return OfflineRun(self._scene, servo, self._campaign.motion)
        names = self._scene.joint_names
        place = [names.index(name) for name in servo.joint_names]
        self._drives = ServoDrives(servo)
        table = TargetTable(np.zeros(1), self._scene.start[None])
        return TableRun(self._scene, table, ServoStep(self._drives, place))

    def simulate_run(self, which: int | Case) -> Outcome:
        """Simulate one run and judge it.

        Args:
            which: the index of a run that is sampled, or any other run.

        Raises:
            Refusal: values of this run that are out of range.
        """
        case = draw_case(self._campaign.variation, which) if isinstance(which, int) else which
        return Outcome.create_from_judged(self._campaign, case, self._judge_run(case))

    def simulate_runs(self, cases: Cases) -> Iterator[Outcomes]:
        """Simulate runs one after the other, see `BatchSimulator.simulate_runs`."""
        return map(self._judge_run, cases)

    def _judge_run(self, case: Case) -> Outcomes:
        self._begin_run(case)
        sampler, evaluators = self._sampler, self._evaluators
        evaluators.begin_runs()
        sampler.begin_sampling()
        diverged = math.nan
        try:
            for _ in self._advance_in_pieces():
                if sampler.left < 1:
                    evaluators.take_samples(*sampler.take_samples(), self._targets)
            evaluators.take_samples(*sampler.take_samples(), self._targets)
        except Diverged as fault:
            diverged = fault.t
            sampler.forget_samples()
        finally:
            sampler.end_sampling()
        robustness, measures = evaluators.end_runs(np.isfinite([diverged]))
        values = np.array([list(case.values.values())], np.float64)
        return Outcomes(np.array([case.index]), values, robustness, measures, np.array([diverged]))

    def drive_run(
        self,
        case: Case,
        max_ticks: int = MAX_TICKS,
        changed: Callable[[Change], None] | None = None,
    ) -> Iterator[int]:
        """Simulate a run piece by piece, for a recorder of the machine.

        Args:
            case: the run.
            max_ticks: of a piece.
            changed: gets what a fault has changed in the machine between two pieces.

        Yields:
            Ticks done so far, 0 first.
        """
        self._begin_run(case)
        yield 0
        yield from self._advance_in_pieces(max_ticks, changed)

    # ------------------------------------------------------------------------------------- a run

    def _begin_run(self, case: Case) -> None:
        """Set machine and controller to the start of a run."""
        campaign, session, values = self._campaign, self.session, case.values
        try:
            self._scenario, servo, self._events, self._last = bind_case(campaign, case)
            self._restart_controller(servo)
            for name, value in values.items():
                if name in self._parameters:
                    session.plant.set_parameter(name, value)
        except Refusal as no:
            where = f"{campaign.where}, run {case.index}"
            raise Refusal(where, no.quantity, no.rule, no.got, no.valid) from None
        if self._sensed and "seed" not in values:
            session.plant.set_parameter("seed", case.seed)
        self._place_joints()
        session.plant.reset(self._scenario.start)
        if isinstance(self._run, OfflineRun):
            self._send_moves(self._run)

    def _place_joints(self) -> None:
        """Let the tool be where the joints stand by this run's numbers."""
        self._sampler.place_joints(np.array([[*self.session.plant.parameters.values()]]))

    def _restart_controller(self, servo: ServoConfig) -> None:
        drives = self._run.drives if isinstance(self._run, OfflineRun) else self._drives
        if servo is not self._tuned:
            drives.set_config(servo)
            self._tuned = servo
        if isinstance(self._run, OfflineRun):
            self._run.restart(self._fresh)
            self._aimed = [(0, self._scenario.start)]
            return
        self._table = table = self._scenario.table
        drives.reset()
        self._run.restart(self._fresh, table)

    def _send_moves(self, run: OfflineRun) -> None:
        """Give the motion controller all moves of the tool, each at its time."""
        R_WT, p_WT = run.controller.kinematics.forward(self._scenario.start)
        for move in self._scenario.moves:
            points = _place_points(move, p_WT)
            at = round(move.at * 1e9)
            if move.way == "along":
                run.instructor.add_path(run.controller, [Pose(p, R_WT) for p in points], at)
            else:
                run.instructor.add(at, Pose(points[0], R_WT))

    def _advance_in_pieces(
        self, max_ticks: int = MAX_TICKS, changed: Callable[[Change], None] | None = None
    ) -> Iterator[int]:
        """Run to the end, piece by piece between events; yield ticks done."""
        session, run = self.session, self._run
        last, events = self._last, self._events
        while session.tick < last:
            while events and events[0][0] <= session.tick:
                change = events.pop(0)[1]
                change.make(session)
                if changed is not None:
                    changed(change)
            until = min([last, *(tick for tick, _ in events[:1])])
            ticks = min(until - session.tick, self._sampler.left, self._longest, max_ticks)
            began = session.tick
            run.advance(ticks)
            if isinstance(run, OfflineRun) and began % run.motion_ticks == 0:
                self._aimed.append((began + 1, self._order_joints(run.aimed)))
            yield session.tick

    @property
    def _longest(self) -> int:
        """Ticks after which targets that were given to the servo are noted."""
        run = self._run
        if isinstance(run, TableRun):
            return MAX_TICKS
        return run.motion_ticks - self.session.tick % run.motion_ticks

    def _order_joints(self, q: Array) -> Array:
        """Return joint targets of the servo in the scene's order of joints."""
        names = self._campaign.servo.joint_names
        return q[[names.index(name) for name in self._scene.joint_names]]

    @property
    def _targets(self) -> Targets:
        """The joint targets so far, with the tick from which on each holds."""
        if isinstance(self._run, OfflineRun):
            since, rows = zip(*self._aimed, strict=True)
            return Targets.stack_runs([(since, np.array(rows))])
        return Targets.stack_runs(
            [(self._table.compute_ticks(self._scene.servo_period), self._table.q)]
        )


def _place_points(move: Move, p_WT: Array) -> Array:
    return move.points if move.way == "to" else p_WT + move.points


class BoundCase(NamedTuple):
    """A run with all that it draws in its file.

    Attributes:
        scenario, servo: of this run.
        changes: what its faults and forks set, with the ticks before which that happens, ascending.
        last: tick at which it ends.
    """

    scenario: Scenario
    servo: ServoConfig
    changes: list[tuple[int, Change]]
    last: int


def bind_case(campaign: Campaign, case: Case) -> BoundCase:
    """Return a run of a campaign as a machine gets it.

    Raises:
        Refusal: a drawn value that is out of range.
    """
    has_random = campaign.has_drawn_sections
    bound = campaign.bind_values(case.values) if has_random else campaign.nominal
    scenario, faults, servo = bound
    there = [fault for name, fault in faults.items() if name not in case.without]
    changes = schedule_changes(there, campaign.scene, case.values) if there else []
    noise: list[tuple[int, Change]]
    noise = [(tick, NumberChange("seed", seed)) for tick, seed in case.reseeds]
    changes = sorted(noise + changes, key=lambda change: change[0])
    seconds = min(case.seconds, scenario.seconds)
    last = max(1, count_ticks(seconds, campaign.scene.servo_period))
    return BoundCase(scenario, servo, changes, last)
