"""Splitting: probabilities known in closed form, and forks of a campaign's runs to the last bit."""

import concurrent.futures as cf
import math

import numpy as np
import pytest
import yaml
from scipy import stats

from arm_emulator.base.refusal import Refusal
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.execution.splitter import Splitter, read_failures
from arm_emulator_campaign.execution.worker_pool import WorkerPool
from arm_emulator_campaign.results.parts import Results
from arm_emulator_campaign.results.report import write_report
from arm_emulator_campaign.results.summary import compute_summary
from arm_emulator_campaign.search.splitting import ForkOrigin, Splitting
from arm_emulator_campaign.simulation.batch_simulator import make_simulator
from arm_emulator_campaign.simulation.case import Cases
from arm_emulator_campaign.simulation.forking import ForkingRun, make_forked_case
from arm_emulator_campaign.simulation.shrinking import shrink_run, write_shrunk
from arm_emulator_campaign.simulation.simulator import Simulator
from arm_emulator_campaign.single_cases import find_case

DRIFTS = {
    "scene": "three_axis",
    "set": {"faults": ["elbow.encoder_misses_edges"]},
    "scenario": {"seconds": 0.1, "targets": [{"at": 0.0, "elbow": 1.0}]},
    "vary": {"faults.push.at": "uniform(0.01, 0.03)"},
    "faults": {
        "edges": {
            "kind": "machine", "at": 0.0, "fault": "elbow.encoder_misses_edges", "magnitude": 0.1,
        },
        "push": {"kind": "power_cut", "at": 0.02, "lasting": 0.03},
    },
    # A count is 6.14e-5 rad at the link.
    "requirements": {
        "counts": "always abs(q.elbow - 6.13592315e-5 * measured.encoder_counts.elbow) < 0.004",
        "comes": "eventually q.elbow > 0.9",
    },
    "search": {"method": "splitting", "of": "counts", "per_level": 20, "repetitions": 4},
}  # fmt: skip
# The seed follows from the scene's file: all of 12 seeds lead to failures over a level or two.
EDGES = {**DRIFTS["faults"]["edges"], "magnitude": 0.016}
RARE = DRIFTS | {
    "faults": {**DRIFTS["faults"], "edges": EDGES},
    "search": {**DRIFTS["search"], "per_level": 60},
}


def read(folder, data=DRIFTS):
    file = folder / "c.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    return load_campaign(file)


def bits(run):
    """Of the machine and its readings. (Setting the seed begins the energy's account anew.)"""
    state, measured = run.session.plant.state, run.session.plant.measured
    rows = state.q, state.v, state.current, state.theta_m, state.omega_m, measured.encoder_counts
    return b"".join(row.tobytes() for row in rows)


class Walk:
    """x' = 0.9 x + w with normal w; it fails where x passes `bound` within 50 steps."""

    def __init__(self, bound):
        self.bound = bound

    def begin_run(self, index, seed):
        self.go_on((0, 0.0, self.bound), seed)

    @property
    def now(self):
        return self.t

    def go_on(self, state, seed):
        (self.t, self.x, self.least), self.rng = state, np.random.default_rng(seed)

    def fork_run(self):
        return self.t, self.x, self.least

    def at(self, level):
        return self.least < 0.0 if level == 0.0 else self.least <= level

    def reach_level(self, level):
        while not self.at(level) and self.t < 50:
            self.x = 0.9 * self.x + self.rng.standard_normal()
            self.t, self.least = self.t + 1, min(self.least, self.bound - self.x)
        return self.at(level), self.least


def of_walk(bound):
    """Its probability, by integration over a grid: 1e-6 of itself."""
    x, step = np.linspace(-25.0, bound, 1500, retstep=True)
    kernel = step * stats.norm.pdf(x[:, None] - 0.9 * x[None])
    density, weight = stats.norm.pdf(x), np.ones(len(x))
    weight[[0, -1]] = 0.5
    for _ in range(49):
        density = kernel @ (density * weight)
    return 1.0 - step * (density * weight).sum()


def test_repetitions_have_the_true_probability_in_their_mean():
    method, process = Splitting(of="g", per_level=60, repetitions=40), Walk(9.0)
    levels, leads = method.run_pilot(process, 1)
    repetitions = [method.run_repetition(process, levels, 1, k) for k in range(1, 41)]
    p = np.array([repetition.probability for repetition in repetitions])
    truth = of_walk(9.0)
    assert leads and truth == pytest.approx(9.9e-4, rel=0.01)
    # Four standard errors of the mean: once in 16 000 draws of the seed.
    assert np.mean(p) == pytest.approx(truth, abs=4.0 * np.std(p) / math.sqrt(len(p)))
    assert np.std(p) < 2.0 * truth, "sampling as many runs would have 4 times that"
    _, _, low, high, runs = method.make_finding("g", levels, repetitions).rows[0]
    assert low <= truth <= high and runs == sum(repetition.runs for repetition in repetitions)


def test_a_failure_that_no_level_leads_to_is_reported():
    method = Splitting(of="g", per_level=20, least=1e-2)
    levels, leads = method.run_pilot(Walk(100.0), 1)
    assert not leads and "No level led" in method.make_finding("g", levels, []).about


MOVES = {
    "scenario": {
        "seconds": 0.3,
        "moves": [
            {"at": 0.0, "by": [0.01, -0.02, 0.03]},
            {"at": 0.1, "by": [-0.02, 0.01, 0.02]},
        ],
    },
}


@pytest.mark.parametrize("change", [{}, MOVES], ids=["targets", "moves"])
def test_a_fork_with_the_noise_of_its_run_is_that_run(tmp_path, change):
    """Faults that have begun and ended, power, servo and counts with it; whatever is between."""
    run = ForkingRun(read(tmp_path, DRIFTS | change))
    run.begin_run(3, 5)
    minimum = run.reach_level(-math.inf)[1]
    state = bits(run)
    run.begin_run(3, 5)
    level = 0.9 * 0.004 + 0.1 * minimum
    assert run.reach_level(level)[0]
    fork, tick = run.fork_run(), run.session.tick
    run.begin_run(4, 6)  # another run between
    run.reach_level(-math.inf)
    run.go_on(fork, 5)
    assert run.session.tick == tick
    assert run.reach_level(-math.inf)[1] == minimum and bits(run) == state
    run.go_on(fork, 7)
    run.reach_level(-math.inf)
    assert bits(run) != state, "other noise"


def test_a_level_is_reached_at_its_tick(tmp_path):
    """Pieces of any length find the same tick."""
    run, states = ForkingRun(read(tmp_path)), set()
    for look in (1, 7, 1000):
        run._look = run._longest_look = look
        run.begin_run(2, 9)
        reached, minimum = run.reach_level(0.003)
        states.add((reached, minimum, run.session.tick, bits(run)))
    assert len(states) == 1 and states.pop()[0]


@pytest.mark.parametrize("change", [{}, MOVES], ids=["targets", "moves"])
def test_a_failure_of_forks_is_a_run_whose_noise_changes_after_its_start(tmp_path, change):
    """Bits of the machine where it fails, and its margin over the whole run, alone and in lanes."""
    own = {"faults.push.at": "uniform(0.01, 0.03)", "seed": "uniform(0, 1000)"}
    campaign = read(tmp_path, DRIFTS | change | {"vary": own})
    forks, seeds = ForkingRun(campaign), (5, 7, 2**31 + 9)
    forks.begin_run(3, seeds[0])
    origin = ForkOrigin(3, ((0, seeds[0]),))
    for level, seed in zip((0.003, 0.002), seeds[1:], strict=True):
        assert forks.reach_level(level)[0]
        forks.go_on(forks.fork_run(), seed)
        origin = ForkOrigin(3, (*origin.seeds, (forks.now, seed)))
    assert forks.reach_level(0.0)[0] and 0 < origin.seeds[1][0] < origin.seeds[2][0] < forks.now
    alone, case = Simulator(campaign), make_forked_case(campaign, origin)
    for done in alone.drive_run(case, 1):
        if done == forks.now:
            assert bits(alone) == bits(forks)
    minimum = forks.reach_level(-math.inf)[1]
    assert alone.simulate_run(case).robustness["counts"] == pytest.approx(minimum, abs=1e-15)
    (outcomes,) = make_simulator(campaign).simulate_runs(Cases.stack_runs([case]))
    assert outcomes.robustness[0, 0] == pytest.approx(minimum, abs=1e-12)


def test_a_failure_is_replayed_and_shrunk_by_its_number(tmp_path):
    campaign, into = read(tmp_path, RARE), tmp_path / "results"
    results = Results(into, campaign)
    findings = Splitter(campaign, results, WorkerPool(Here, 1.0, lambda _: None)).run_search()
    assert findings[2].title == "Failures" and len(findings[2].rows) == 10
    first, *_ = read_failures(results)
    assert findings[2].rows[0][:3] == (0, first.index, len(first.seeds) - 1)
    count = len(read_failures(results))
    simulator = Simulator(campaign)
    for k in range(0, count, max(1, count // 5)):
        assert (
            simulator.simulate_run(find_case(campaign, into, k, "--replay")).robustness["counts"]
            < 0.0
        )
    with pytest.raises(Refusal, match=f"be a failure of the search, got {count}"):
        find_case(campaign, into, count, "--replay")
    k = next(k for k, failure in enumerate(read_failures(results)) if len(failure.seeds) > 1)
    shrunk = shrink_run(campaign, find_case(campaign, into, k, "--shrink"))
    file = write_shrunk(campaign, shrunk, tmp_path / "shrunk")
    again = Simulator(load_campaign(file)).simulate_run(0)
    assert again.robustness == {"counts": pytest.approx(shrunk.margin, abs=1e-15)}


class Here:
    """A pool in this process."""

    breaks = (RuntimeError,)

    def submit(self, function, *arguments):
        future = cf.Future()
        future.set_result(function(*arguments))
        return future

    def check_scheduler(self):
        pass

    def end_workers(self):
        pass


@pytest.mark.slow
def test_a_search_goes_on_and_has_the_same_end(tmp_path):
    campaign = read(tmp_path, RARE)
    results = Results(tmp_path / "results", campaign)
    first = Splitter(campaign, results, WorkerPool(Here, 1.0, lambda _: None)).run_search()
    for name in ("pilot", "0003"):  # as if it had been interrupted
        (results.folder / f"splitting/{name}.json").unlink()
    progress = []
    worker_pool = WorkerPool(Here, 1.0, lambda now: progress.append(now.done))
    assert Splitter(campaign, results, worker_pool).run_search() == first
    assert len(progress) == 2, "what was there was not done again"
    damaged = results.folder / "splitting/0002.json"
    damaged.write_text(damaged.read_text().replace("0", "1"))
    assert Splitter(campaign, results, worker_pool).run_search() == first
    assert len(progress) == 3 and (results.folder / "set_aside/0002.json").exists()
    ((name, mean, low, high, _),) = first[0].rows
    assert name == "counts" and low <= mean <= high
    rows = first[1].rows
    assert [row[0] for row in rows] == [
        *(f"level {k + 1}" for k in range(len(rows) - 1)),
        "failure",
    ]
    assert all(row[3] <= row[2] <= row[4] for row in rows)
    margins = [row[1] for row in rows]
    assert margins == sorted(margins, reverse=True) and margins[-1] == 0.0 and len(rows) > 1
    columns = results.collect_columns()
    report = write_report(
        campaign, results, columns, compute_summary(campaign, columns), first
    ).read_text()
    for row in rows:
        assert f"<td>{row[0]}<td class=n>{row[1]:.4g}<td class=n>{row[2]:.4g}" in report


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"set": {}, "vary": {}, "faults": {}}, "search.method must have noise"),
        ({"search": {"method": "splitting", "of": "comes"}}, "must be `always` of comparisons"),
        ({"search": {"method": "splitting"}}, "search.of must name the requirement"),
    ],
)
def test_runs_that_cannot_be_split_are_refused(tmp_path, change, words):
    with pytest.raises(Refusal, match=words):
        ForkingRun.check_campaign(read(tmp_path, DRIFTS | change))
