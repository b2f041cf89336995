"""Search of campaigns: rare failures, falsification, sensitivity, and failures that are shrunk."""

import concurrent.futures as cf
import importlib.util
import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from draws import FULL, with_slow
from scipy import optimize, special, stats

from arm_emulator import Refusal
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.execution.searcher import Searcher
from arm_emulator_campaign.execution.worker_pool import WorkerPool
from arm_emulator_campaign.results.parts import Results, compute_checksum, compute_digest
from arm_emulator_campaign.sampling.intervals import bound_mean
from arm_emulator_campaign.search.falsification import Bayes, CmaEs
from arm_emulator_campaign.search.sensitivity import Morris, Sobol
from arm_emulator_campaign.search.subset import Subset
from arm_emulator_campaign.simulation.batch_simulator import make_simulator
from arm_emulator_campaign.simulation.case import Cases, draw_case, make_case, place_case
from arm_emulator_campaign.simulation.shrinking import find_fewest, shrink_run, write_shrunk
from arm_emulator_campaign.simulation.simulator import Simulator, bind_case

EXAMPLES = Path(__file__).parents[3] / "examples"
PUSHED = {
    "scene": "three_axis",
    "set": {"payload": 1.0},
    "scenario": {"seconds": 0.06, "targets": [{"at": 0.0, "elbow": 0.8}]},
    "vary": {"payload.mass": "triangular(0, 1, 3)", "faults.push.force.2": "normal(0, 100)"},
    "faults": {
        "push": {"kind": "wrench", "at": 0.01, "lasting": 0.02, "link": "tool", "force": [0, 0, 0]},
        "cut": {"kind": "power_cut", "at": 0.02, "lasting": 0.01},
    },
    "requirements": {"near": "always abs(error.*) < 0.05", "other": "always t < 9"},
    "search": {"method": "subset", "of": "near", "per_level": 200, "repetitions": 6},
}


def written(folder, data, name="c.yaml"):
    file = folder / name
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    return file


def run_search(method, outputs_at, D, seed=1, outputs=("g",)):
    """Finding about a function of points (K, D) -> (K, M), and the points that were asked for."""
    sampler, requested = method.make_sampler([f"x{k}" for k in range(D)], list(outputs), seed), []
    try:
        points = next(sampler)
        while True:
            requested.append(points)
            points = sampler.send(np.reshape(outputs_at(points), (len(points), -1)))
    except StopIteration as end:
        return end.value[0], np.concatenate(requested)


# ---------------------------------------------------------------------------------- rare failures


def plane(beta, D):
    """A linear margin; it fails with probability Phi(-beta)."""
    return lambda z: beta - z.sum(axis=1) / math.sqrt(D)


def share_of_intervals(method, margin, p, D, seeds):
    """Share of intervals that have the truth, and the ratio of estimate and truth, of each seed."""
    rows = [run_search(method, margin, D, seed)[0].rows[0] for seed in range(seeds)]
    return np.mean([low <= p <= high for _, _, low, high, _ in rows]), np.array(
        [mean / p for _, mean, *_ in rows]
    )


MARGINS = [
    (plane(4.753424, 5), 1e-6, 5),
    (lambda z: np.ceil(8.0 * (4.0 - z[:, 0])) / 8.0 - 1e-9, stats.norm.sf(4.0), 2),  # stairs
    (lambda z: 5.0 - np.abs(z[:, 0]), 2.0 * stats.norm.sf(5.0), 3),  # two places that fail
    (lambda z: 45.0 - (z * z).sum(axis=1), stats.chi2.sf(45.0, 10), 10),  # a shell
]


@pytest.mark.parametrize(("margin", "p", "D"), with_slow(MARGINS, 1))
def test_intervals_of_rare_failures_hold_as_often_as_they_claim(margin, p, D):
    method, seeds = Subset(per_level=300, confidence=0.9), 1000 if FULL else 150
    share, ratio = share_of_intervals(method, margin, p, D, seeds)
    # Binomial: 0.9 within 4.5 deviations. Above, too, or intervals without end would pass.
    slack = 4.5 * math.sqrt(0.9 * 0.1 / seeds)
    assert 0.9 - slack < share < min(0.999, 0.9 + slack), share
    assert np.mean(ratio) == pytest.approx(1.0, abs=4.5 * np.std(ratio) / math.sqrt(seeds))
    assert np.std(ratio) < 1.0


@pytest.mark.parametrize("per_level", with_slow([20, 1000, 50, 100, 200], 2))
def test_intervals_from_few_runs_a_level_hold_as_often_as_they_claim(per_level):
    """Most repetitions of 50 runs a level lose their chains: the interval must grow with that."""
    seeds = 500 if FULL else 60 if per_level < 1000 else 20
    share, _ = share_of_intervals(Subset(per_level=per_level), plane(4.753424, 5), 1e-6, 5, seeds)
    assert share >= 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / seeds), share


@pytest.mark.parametrize(("beta", "p"), [(4.753424, 1e-6), (5.997807, 1e-9)])
def test_rare_probabilities_are_estimated_from_few_runs(beta, p):
    _, mean, low, high, runs = run_search(Subset(), plane(beta, 20), 20)[0].rows[0]
    assert low <= p <= high and mean == pytest.approx(p, rel=0.5)
    assert high < 3.0 * low and runs <= 2e5


def test_a_requirement_that_never_fails_has_no_probability():
    finding = run_search(Subset(per_level=50), lambda z: 1.0 + 0.0 * z[:, 0], 2)[0]
    assert finding.rows[0][1:4] == (0.0, 0.0, 1.0) and "No level reached" in finding.about
    finding = run_search(Subset(per_level=50, least=1e-3), plane(9.0, 2), 2)[0]
    assert finding.rows[0][1:4] == (0.0, 0.0, 1.0)


def test_subset_simulation_of_a_frequent_failure_is_plain_sampling():
    _, mean, low, high, runs = run_search(Subset(per_level=500), plane(0.5, 2), 2)[0].rows[0]
    assert low <= stats.norm.sf(0.5) <= high and runs == 11 * 500 and mean < 0.4


def test_an_estimate_of_zero_lowers_the_interval():
    low, high = bound_mean(np.array([0.0, 1e-6, 3e-6, 2e-6]), 0.9)
    assert low < bound_mean(np.array([1e-6, 3e-6, 2e-6]), 0.9)[0] and 3e-6 < high < 1e-3
    assert bound_mean(np.zeros(4), 0.9) == (0.0, 1.0)


# ------------------------------------------------------------------ falsification and sensitivity


def bowl(z):
    return np.array([((point - np.linspace(-1.5, 2.5, len(point))) ** 2).sum() for point in z])


@pytest.mark.parametrize("method", with_slow([CmaEs, Bayes], 1))
def test_falsification_reaches_failures_that_sampling_misses(method):
    pytest.importorskip(method.package[0], reason=f"pip install {method.package[1]}")
    some = method(most=400, below=-1e300)
    finding, points = run_search(some, bowl, 3)
    assert len(points) == 400 == finding.rows[0][3] and np.abs(points).max() <= 3.0
    sampled = bowl(np.random.default_rng(1).standard_normal((400, 3))).min()
    assert finding.rows[0][1] == bowl(points).min() < 0.5 * sampled
    assert bowl(points)[finding.rows[0][2]] == finding.rows[0][1]
    again = run_search(some, bowl, 3)[1]
    assert (again == points).all() and (run_search(some, bowl, 3, 2)[1] != points).any()
    stopped, points = run_search(replace(some, below=0.0), lambda z: bowl(z) - 1.0, 3)
    assert len(points) < 400 and stopped.rows[0][1] < 0.0 and stopped.rows[0][4] > 0
    diverging, _ = run_search(some, lambda z: np.where(z[:, 0] > 0.0, -np.inf, bowl(z)), 3)
    assert diverging.rows[0][1] == -math.inf


def test_sobol_indices_are_those_of_ishigami():
    pytest.importorskip("SALib", reason="pip install SALib")

    def ishigami(z):
        x = math.pi * (2.0 * special.ndtr(z) - 1.0)
        g = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
        return np.column_stack([g, 1e6 + g, 0.0 * g, np.where(z[:, 0] > 2.0, -np.inf, g)])

    finding, points = run_search(
        Sobol(base=1024), ishigami, 3, outputs=("g", "moved", "flat", "inf")
    )
    assert len(points) == Sobol(base=1024).count_runs(3) == 5 * 1024
    rows = {(row[0], row[1]): row[2:] for row in finding.rows}
    truth = {"x0": (0.5576, 0.3139), "x1": (0.4424, 0.4424), "x2": (0.2437, 0.0)}
    for output, (name, of_all) in itertools.product(("g", "moved"), truth.items()):
        total, _, alone, _ = rows[output, name]
        assert (total, alone) == pytest.approx(of_all, abs=0.04), (output, name)
    assert {row[0] for row in finding.rows} == {"g", "moved"}
    assert "flat: the same" in finding.about and "inf: not finite" in finding.about


def test_morris_effects_of_a_sum_are_its_factors():
    pytest.importorskip("SALib", reason="pip install SALib")
    finding, points = run_search(
        Morris(trajectories=10), lambda z: special.ndtr(z) @ np.array([3.0, -2.0, 0.0]), 3
    )
    assert len(points) == 40
    effects = {row[1]: (row[4], row[5]) for row in finding.rows}  # mean and spread; 1 % to 99 %
    # The statement beside the effects names the quantiles between which steps lead.
    quantiles = np.unique(np.round(special.ndtr(points), 9))
    assert quantiles == pytest.approx([0.01, 0.01 + 0.98 / 3, 0.01 + 1.96 / 3, 0.99], abs=1e-9)
    steps = np.abs(np.diff(special.ndtr(points).reshape(10, 4, 3), axis=1)).max(axis=2)
    assert steps == pytest.approx(0.98 * 2 / 3, abs=1e-9)
    assert "such as 1 and 66.3 %, divided by 0.667" in finding.about
    assert effects["x0"] == pytest.approx((0.98 * 3.0, 0.0), abs=1e-9)
    assert effects["x1"] == pytest.approx((-0.98 * 2.0, 0.0), abs=1e-9)
    assert effects["x2"] == pytest.approx((0.0, 0.0), abs=1e-9)


# ------------------------------------------------------------------------------------ the machine


class Here:
    """A pool in this process, which may be killed after some chunks."""

    breaks = ()

    def __init__(self, chunks=math.inf):
        self.left = chunks

    def submit(self, function, *arguments):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        future = cf.Future()
        future.set_result(function(*arguments))
        return future

    def check_scheduler(self):
        pass

    def end_workers(self):
        pass


def searched(campaign, folder, pool, workers, seconds=1e-3):
    results, pool.workers = Results(folder, campaign), workers
    worker_pool = WorkerPool(lambda: pool, seconds, lambda _: None)
    return Searcher(campaign, results, worker_pool).run_search(), results.collect_columns()


def probability(campaign):
    """Integral over the payload of what forces fail, by bisection on the machine."""
    simulator = Simulator(campaign)

    def margin(*z):
        return simulator.simulate_run(place_case(campaign.variation, 0, z)).robustness["near"]

    def above(payload, sign):
        return stats.norm.sf(
            optimize.brentq(lambda z: margin(payload, sign * z), 0.1, 8.0, xtol=1e-3)
        )

    nodes, weights = np.polynomial.hermite_e.hermegauss(8)
    each = [above(node, 1.0) + above(node, -1.0) for node in nodes]
    return float(weights @ each / weights.sum())


@pytest.mark.slow
def test_rare_failures_of_a_machine(tmp_path):
    campaign = load_campaign(written(tmp_path, PUSHED))
    (finding,), columns = searched(campaign, tmp_path / "r", Here(), 2)
    _, mean, low, high, runs = finding.rows[0]
    p = probability(campaign)
    assert p < 1e-4 and low <= p <= high and mean < 3.0 * p, (p, low, high)
    assert len(columns["index"]) == runs
    # A row is a function of its values: driven again, in another order.
    rng = np.random.default_rng(2)
    cases, places = [], rng.integers(0, runs, 20)
    for at in places:
        values = {number.name: columns[number.name][at] for number in campaign.variation.numbers}
        cases.append(make_case(campaign.variation, int(at), values))
    (again,) = make_simulator(campaign).simulate_runs(Cases.stack_runs(cases))
    assert np.array_equal(again.robustness[:, 0], columns["robustness.near"][places])


@pytest.mark.skipif(not FULL, reason="FULL=1: 50 000 runs")
def test_the_example_agrees_with_bisection_along_lines(tmp_path):
    """Draws of all numbers but the force; the failing forces of each by bisection."""
    text = (EXAMPLES / "search.yaml").read_text()
    (tmp_path / "c.yaml").write_text(f"{text}\nseed: 4\n")
    campaign = load_campaign(tmp_path / "c.yaml")
    (finding,), _ = searched(campaign, tmp_path / "r", Here(), 2)
    _, _, low, high, _ = finding.rows[0]
    simulator, rng = Simulator(campaign), np.random.default_rng(1)
    names = [number.name for number in campaign.variation.numbers]
    force = names.index("faults.push.force.2")

    def holds(z, size):
        z[force] = size
        return (
            simulator.simulate_run(place_case(campaign.variation, 0, z)).robustness["stays_near"]
            >= 0.0
        )

    p = np.zeros(100)
    for k in range(len(p)):
        z = rng.normal(size=len(names))
        for sign in (1.0, -1.0):
            begin, end = 0.0, 9.0  # standard deviations; beyond them 1e-19
            for _ in range(14):
                middle = 0.5 * (begin + end)
                begin, end = (middle, end) if holds(z, sign * middle) else (begin, middle)
            p[k] += stats.norm.sf(begin)
    mean, error = p.mean(), p.std() / len(p) ** 0.5
    # Four standard errors of the lines. One seed of twenty may miss; this one does not.
    assert low - 4.0 * error < mean < high + 4.0 * error and error < 0.15 * mean, (mean, low, high)


@pytest.mark.slow
def test_a_search_does_not_depend_on_how_it_was_divided(tmp_path):
    data = json.loads(json.dumps(PUSHED))
    data["search"] |= {"per_level": 50, "repetitions": 4}
    data["vary"]["faults.push.force.2"] = "normal(0, 200)"
    campaign = load_campaign(written(tmp_path, data))
    findings, full_results = searched(campaign, tmp_path / "whole", Here(), 1)
    into = tmp_path / "pieces"
    for chunks, workers in ((1, 1), (0, 2), (5, 3), (9, 2)):
        with pytest.raises(KeyboardInterrupt):
            searched(campaign, into, Here(chunks), workers, seconds=0.1)
    assert len(list((into / "parts").iterdir())) == 15
    again, pieces = searched(campaign, into, Here(), 7, seconds=0.05)
    assert again == findings and compute_digest(pieces) == compute_digest(full_results)
    done, _ = searched(campaign, into, Here(0), 1)  # nothing is simulated once more
    assert done == findings and json.loads((into / "search.json").read_text())[0]["title"]
    # Runs that other versions of a package asked for are not taken for ours.
    part = sorted((into / "parts").iterdir())[0]
    changed_table = _change_masses(part)
    part.unlink()
    part.with_name(
        f"{part.stem.rpartition('-')[0]}-{compute_checksum(changed_table)}.parquet"
    ).write_bytes(changed_table)
    with pytest.raises(Refusal, match="have runs of this search"):
        searched(campaign, into, Here(), 1)


def _change_masses(part):
    import io

    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(part)
    at = table.column_names.index("payload.mass")
    changed_masses = pa.array(table["payload.mass"].to_numpy() + 1e-9)
    stream = io.BytesIO()
    pq.write_table(table.set_column(at, table.schema.field(at), changed_masses), stream)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("search", "reason"),
    [
        ({"method": "annealing"}, "search.method must be a known method, got 'annealing'"),
        ({"method": "subset", "of": "far"}, "search.of must name a requirement"),
        ({"method": "subset", "per_levle": 3}, "key search.per_levle must be known"),
        ({"method": "subset", "share": 0.9}, "search.share must be"),
        ({"method": "subset", "share": 0.01, "per_level": 30}, "leave two chains a level"),
        ({"method": "morris", "of": "near"}, "search.of must name"),
        ({"method": "sobol", "base": 100}, "search.base must be a power of two"),
        ({"method": "morris", "levels": 5}, "search.levels must be even"),
        ({"of": "near"}, "search.method must be"),
    ],
)
def test_bad_searches_are_refused_in_a_line(tmp_path, search, reason):
    with pytest.raises(Refusal) as refusal:
        load_campaign(written(tmp_path, PUSHED | {"search": search}))
    assert reason in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"count": 5}, "count must be absent together with search"),
        ({"vary": {}}, "search.method must have numbers that vary"),
        ({"requirements": {}}, "search.method must have a requirement"),
        (
            {
                "correlate": [{"between": ["payload.mass", "faults.*"], "by": 0.5}],
                "search": {"method": "sobol"},
            },
            "have independent numbers",
        ),
        (
            {"vary": {"payload.mass": "uniform(0, 1)"}, "search": {"method": "cma-es"}},
            "at least two numbers",
        ),
    ],
)
def test_searches_refuse_sections_that_they_cannot_have(tmp_path, change, reason):
    with pytest.raises(Refusal, match=reason):
        load_campaign(written(tmp_path, PUSHED | change))


@pytest.mark.parametrize("name", ["cma-es", "bayes", "sobol", "morris"])
def test_packages_that_are_missing_are_named(tmp_path, name, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(
        Refusal, match=r"must be installed, got none; valid: pip install (cma|opt|SA)"
    ):
        load_campaign(written(tmp_path, PUSHED | {"search": {"method": name}}))


# --------------------------------------------------------------------------------------- shrinking


def test_shrinking_leaves_the_fewest_changes():
    rng = np.random.default_rng(5)
    for _ in range(200):
        names = [f"x{k}" for k in range(int(rng.integers(1, 12)))]
        causes = [set(rng.choice(names, int(rng.integers(1, 4)))) for _ in range(2)]

        def fails(some, causes=causes):
            return any(cause <= set(some) for cause in causes)

        left = find_fewest(names, fails)
        assert fails(left) and set(left) in causes
        assert not any(fails([change for change in left if change != name]) for name in left)


def test_a_failure_is_shrunk_to_its_cause_and_written(tmp_path):
    data = PUSHED | {"scenario": {"seconds": 0.2, "targets": [{"at": 0.0, "elbow": 0.8}]}}
    data = {key: value for key, value in data.items() if key != "search"}
    data["faults"] = data["faults"] | {"drop": {"kind": "payload", "at": 0.1, "mass": 0.2}}
    data["vary"] = data["vary"] | {
        "controller.joints.elbow.velocity_gain": "uniform(120, 180)",
        "scenario.targets.0.elbow": "uniform(0.79, 0.81)",
    }
    campaign = load_campaign(written(tmp_path, data))
    values = dict(draw_case(campaign.variation, 3).values) | {"faults.push.force.2": 900.0}
    case = replace(draw_case(campaign.variation, 3), values=values)
    shrunk = shrink_run(campaign, case)
    assert shrunk.changes == {"faults.push.force.2": 900.0} and shrunk.faults == ("push",)
    # A period less does not fail: the machine alone, tick by tick.
    assert 0.01 < shrunk.seconds < 0.06 and shrunk.margin < 0.0 and shrunk.requirement == "near"
    shorter = replace(shrunk.case, seconds=shrunk.seconds - campaign.scene.servo_period)
    assert Simulator(campaign).simulate_run(shorter).robustness["near"] >= 0.0
    again = load_campaign(write_shrunk(campaign, shrunk, tmp_path / "shrunk"))
    assert again.count == 1 and Simulator(again).simulate_run(0).robustness[
        "near"
    ] == pytest.approx(shrunk.margin, abs=1e-9)
    with pytest.raises(Refusal, match="must fail"):
        shrink_run(campaign, draw_case(campaign.variation, 3))


def test_numbers_of_scene_and_servo_are_written(tmp_path):
    data = {key: value for key, value in PUSHED.items() if key != "search"}
    data["vary"] = {
        "payload.mass": "uniform(0, 3)",
        "controller.joints.elbow.velocity_gain": "uniform(120, 180)",
    }
    data["requirements"] = {"short": "always error.elbow < -1"}
    campaign = load_campaign(written(tmp_path, data))
    shrunk = shrink_run(campaign, draw_case(campaign.variation, 0))
    assert shrunk.changes == {} and shrunk.faults == ()  # it fails without any change
    changes = {"payload.mass": 2.5, "controller.joints.elbow.velocity_gain": 133.0}
    again = load_campaign(
        write_shrunk(campaign, replace(shrunk, changes=changes), tmp_path / "shrunk")
    )
    case = draw_case(again.variation, 0)
    assert case.values == changes
    gains = {joint.name: joint.velocity_gain for joint in bind_case(again, case).servo.joints}
    assert gains["elbow"] == 133.0 and gains["waist"] == 150.0


def test_the_page_lists_every_method():
    from arm_emulator_campaign.search import METHODS
    from docs.campaign_tables import TABLES

    page = (Path(__file__).parents[1] / "docs/reference/campaign.md").read_text()
    assert "<!-- generated: campaign methods -->" in page
    for name in METHODS:
        assert f"`{name}`" in TABLES["methods"]()
