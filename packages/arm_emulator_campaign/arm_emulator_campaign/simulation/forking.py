"""A run that can be forked in mid-run: machine, servo, motion and margin saved to the last bit."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from arm_emulator.extension.base import Formula, Refusal, Window, bind_signals, parse_formula
from arm_emulator.extension.machine import LARGEST_SEED, Change, Diverged, is_at_one_instant
from arm_emulator.extension.runs import OfflineRun
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.scenario import count_ticks
from arm_emulator_campaign.judging.program import Program, Rows
from arm_emulator_campaign.judging.signals import Sampler, list_signal_units
from arm_emulator_campaign.search.splitting import ForkOrigin, Splitting
from arm_emulator_campaign.simulation.case import Case, draw_case
from arm_emulator_campaign.simulation.simulator import ROOM, Simulator


@dataclass(frozen=True)
class Fork:
    """A run at a tick."""

    machine: Any
    drives: Any
    coupled: Any
    rest: tuple[Any, ...]
    events: tuple[tuple[int, Change], ...]
    least: float


class ForkingRun(Simulator):
    """The runs of a campaign for `Splitting`: the margin of a requirement while the run goes on.

    Args:
        campaign: whose search is `Splitting`.

    Raises:
        Refusal: no noise, so that forks would be alike, or a requirement that is not `always` of
            comparisons: its margin is not known before the end.
    """

    def __init__(self, campaign: Campaign) -> None:
        formula, of = _find_margin(campaign)
        super().__init__(campaign)
        assert isinstance(campaign.search, Splitting)
        scene = campaign.scene
        period = scene.servo_period
        self._from = math.ceil(formula.begin / period - 1e-6)
        self._to = math.inf if math.isinf(formula.end) else math.floor(formula.end / period + 1e-6)
        rows = Rows(scene.joint_names, scene.integrator.dt, scene.steps_per_period)
        self._margin = Program(rows, [()], (), [rows.add_formula(of)], ROOM)
        self._sampler = Sampler(self.session.plant, rows.samples, ROOM)
        self._look = self._longest_look = max(1, count_ticks(campaign.search.look, period))

    @staticmethod
    def check_campaign(campaign: Campaign) -> None:
        """Refuse what cannot be forked, before anything is compiled."""
        _find_margin(campaign)

    def begin_run(self, index: int, seed: int) -> None:
        """Begin a run with the values of an index, and noise of a seed."""
        self._begin_run(draw_case(self._campaign.variation, index))
        self._set_seed(seed)
        self.session.plant.reset(self._scenario.start)
        self._lowest = math.inf

    def go_on(self, state: Fork, seed: int) -> None:
        """Continue from a fork with other noise."""
        self._return_to(state)
        self._set_seed(seed)

    def _return_to(self, state: Fork) -> None:
        run = self._run
        if isinstance(run, OfflineRun):
            run.restore(state.coupled)
            self._aimed = list(state.rest[2])
        else:
            self.session.return_to(state.machine)
            self._drives.restore(state.drives)
            self._tuned = self._drives.servo.config
            self._table = state.rest[2]
            run.set_table(self._table)
        self._place_joints()
        self._scenario, self._last = state.rest[:2]
        self._events, self._lowest = list(state.events), state.least

    @property
    def now(self) -> int:
        """The present tick."""
        return self.session.tick

    def _set_seed(self, seed: int) -> None:
        self.session.set_varied("seed", _fold_seed(seed))

    def fork_run(self) -> Fork:
        """Return the run as it is now."""
        run = self._run
        offline = isinstance(run, OfflineRun)
        rest = self._scenario, self._last, tuple(self._aimed) if offline else self._table
        return Fork(
            None if offline else self.session.save(),
            None if offline else self._drives.save(),
            run.save() if isinstance(run, OfflineRun) else None,
            rest,
            tuple(self._events),
            self._lowest,
        )

    def reach_level(self, level: float) -> tuple[bool, float]:
        """Advance until the margin is at most a level, see `Process`.

        A run goes piece by piece. The one in which it reaches the level is taken back, and goes to
        that very tick: what makes a failure likely there may be gone at the end of the piece.
        """
        if self._is_at(level):
            return True, self._lowest
        self._sampler.begin_sampling()
        self._margin.go_on(self.session.tick)
        try:
            self._judge_piece(level)  # the sample at which the run is, before any piece
            if self._is_at(level):
                return True, self._lowest
            pieces, before = self._advance_in_pieces(), self.fork_run()
            while next(pieces, None) is not None:
                later = self._judge_piece(level)
                if later > 0:
                    tick = self.session.tick - later
                    self._return_to(before)
                    self._longest_look = tick - self.session.tick
                    self._margin.go_on(self.session.tick + 1)
                    next(self._advance_in_pieces())
                    self._judge_piece(level)
                if self._is_at(level):
                    break
                if level > -math.inf:
                    before = self.fork_run()
        except Diverged:
            self._lowest = -math.inf
        finally:
            self._sampler.end_sampling()
            self._longest_look = self._look
        return self._is_at(level), self._lowest

    def _is_at(self, level: float) -> bool:
        return self._lowest < 0.0 if level == 0.0 else self._lowest <= level

    def _judge_piece(self, level: float) -> int:
        """Judge a piece; return how many ticks before its end it was at the level first."""
        samples, counts = self._sampler.take_samples()
        end, count = self.session.tick + 1, int(counts[0])
        self._margin.take_samples(samples, counts, self._targets)
        first = end - count
        begin, stop = max(self._from - first, 0), int(min(self._to + 1 - first, count))
        if begin >= stop:
            return 0
        truth = self._margin.kept[0, 0, begin:stop]
        margins = np.where(truth == 0.0, -math.inf, truth)  # undefined, see core/boundary/formula.h
        self._lowest = min(self._lowest, float(np.min(margins)))
        if not self._is_at(level):
            return 0
        at = np.flatnonzero(margins < 0.0 if level == 0.0 else margins <= level)[0]
        return count - 1 - begin - int(at)

    @property
    def _longest(self) -> int:
        return min(super()._longest, self._longest_look)


def make_forked_case(campaign: Campaign, origin: ForkOrigin) -> Case:
    """Return a run that was forked as one that needs no fork: its noise changes on the way."""
    case = draw_case(campaign.variation, origin.index)
    first, *later = ((tick, _fold_seed(seed)) for tick, seed in origin.seeds)
    own = {"seed": first[1]} if "seed" in case.values else {}
    return replace(case, values={**case.values, **own}, seed=first[1], reseeds=tuple(later))


def _fold_seed(seed: int) -> float:
    """Return a seed as machines take it."""
    return float(seed % LARGEST_SEED)


def _find_margin(campaign: Campaign) -> tuple[Window, Formula]:
    """Return the requirement of the search, and what shall always hold."""
    assert campaign.search is not None
    name, where = campaign.search.of, campaign.where
    if not campaign.scene.has_sensor_errors:
        rule = "have noise, with which forks of a run differ"
        raise Refusal(where, "search.method", rule, "a scene whose sensors have no errors")
    text, quantity = campaign.requirements[name], f"requirements.{name}"
    rule = "be `always` of comparisons: splitting must know its margin during the run"
    if not isinstance(text, str):
        raise Refusal(where, quantity, rule, "a function of Python")
    signal_names = list(list_signal_units(campaign.scene))
    formula = bind_signals(parse_formula(text, where, quantity), signal_names, where, quantity)
    if isinstance(formula, Window) and formula.sign == "always":
        (of,) = formula.of
        if is_at_one_instant(of):
            return formula, of
    raise Refusal(where, quantity, rule, text)
