"""Runs of a campaign on a device equal those in lanes, to the last bit."""

from pathlib import Path

import numpy as np
import pytest
from draws import some, with_slow
from test_campaign import MOVES, digest_alone, written
from test_campaign_lanes import VARIED, campaign_of, cases_of, rows_of
from test_splitting import DRIFTS

from arm_emulator import Refusal
from arm_emulator_campaign.commands.campaign import execute_campaign as run_command
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.execution.executor import run_campaign
from arm_emulator_campaign.execution.worker_pool import LocalPool, WorkerPool
from arm_emulator_campaign.results.parts import Results, compute_digest
from arm_emulator_campaign.simulation import batch_simulator
from arm_emulator_campaign.simulation.batch_simulator import WIDTH, BatchSimulator, make_simulator
from arm_emulator_campaign.simulation.outcome import Outcomes


@pytest.mark.parametrize("name", with_slow(some(VARIED, 2), 1))
def test_runs_on_a_device_equal_those_in_lanes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    campaign = campaign_of(tmp_path, VARIED[name])
    lanes, count = BatchSimulator(campaign), WIDTH + 5
    expected = rows_of(
        Outcomes.join_outcomes(list(lanes.simulate_runs(cases_of(campaign, range(count)))))
    )
    assert len(np.unique(expected, axis=0)) == count
    for width in (count, 7):  # 7: further batches, and a thread whose second arm is nobody
        monkeypatch.setattr(batch_simulator, "LARGEST_WIDTH", width)
        there = make_simulator(campaign, "processor")
        assert there.width == width
        rows = rows_of(
            Outcomes.join_outcomes(list(there.simulate_runs(cases_of(campaign, range(count)))))
        )
        assert np.array_equal(rows, expected, equal_nan=True)


def test_workers_with_a_device_each_write_the_results_of_lanes(tmp_path: Path) -> None:
    campaign = campaign_of(tmp_path, {"count": 200})
    results = Results(tmp_path / "devices", campaign)
    worker_pool = WorkerPool(lambda: LocalPool(2, ["processor"] * 2), 0.02, lambda progress: None)
    run_campaign(campaign, results, worker_pool)
    columns = results.collect_columns()
    assert np.array_equal(columns["index"], np.arange(campaign.count))
    assert 0 < np.count_nonzero(columns["failed"])
    assert compute_digest(columns) == digest_alone(campaign.file)[0], "that of lanes"
    # A run that fails is repeated in lanes, as `--replay` does.
    failed = int(np.flatnonzero(columns["failed"])[-1])
    again = make_simulator(campaign).simulate_run(*cases_of(campaign, [failed]))
    for kind, values in (("robustness", again.robustness), ("measure", again.measures)):
        for key, value in values.items():
            assert columns[f"{kind}.{key}"][failed] == value


@pytest.mark.parametrize(
    ("options", "refused"),
    [
        ({"device": "card"}, 'device must be known, got card; valid: "processor", "gpu", "gpu:1"'),
        ({"device": "gpu,gpu"}, "--device must name each device once, got gpu,gpu"),
        ({"device": "gpu", "workers": 2}, "--workers must be absent with --device"),
        ({"device": "gpu", "replay": 3}, "--device must be absent with --replay and --shrink"),
        ({"device": "gpu", "shrink": 0}, "--device must be absent with --replay and --shrink"),
        ({"device": "gpu:0,gpu:1", "dask": "localhost:1"}, "--device must be one with --dask"),
    ],
)
def test_options_that_no_device_serves_are_refused(
    tmp_path: Path, options: dict[str, object], refused: str
) -> None:
    campaign_of(tmp_path, {"count": 3})
    with pytest.raises(Refusal) as no:
        run_command(tmp_path / "c.yaml", into=tmp_path / "into", **options)
    assert refused in str(no.value) and "\n" not in str(no.value)


def test_campaigns_of_python_and_forks_are_refused(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match=r"scenario\.moves must be absent on a device, since"):
        make_simulator(load_campaign(written(tmp_path, MOVES)), "processor")
    written(tmp_path, DRIFTS)
    with pytest.raises(Refusal, match="--device must be absent with a search that splits runs"):
        run_command(tmp_path / "c.yaml", device="processor")
