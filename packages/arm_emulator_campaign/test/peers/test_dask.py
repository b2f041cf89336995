"""Campaigns on a cluster of Dask: processes come and go, the digest is that of one process."""

import json
import time

import numpy as np
import pytest
import yaml
from draws import some

from bench.campaign_kills import (
    CAMPAIGN,
    WORKERS,
    Cluster,
    digest_runs,
    has_begun,
    simulate_kill,
    start_campaign,
)

pytest.importorskip("distributed", reason="Dask: pip install distributed")


@pytest.fixture
def cluster():
    dask_cluster = Cluster()
    yield dask_cluster
    dask_cluster.end_processes()


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "campaign.yaml"
    path.write_text(yaml.safe_dump(CAMPAIGN | {"count": 8000}))
    return path


@pytest.mark.parametrize("victim", ("", *some(Cluster.victims, 2)))
def test_a_kill_of_any_process_leaves_the_digest_the_same(tmp_path, file, cluster, victim):
    # The time counts from the first part: a client that has no scheduler yet waits less for one.
    rng = np.random.default_rng(7)
    after = rng.uniform(0.0, 0.5)
    trial = simulate_kill(file, tmp_path / "r", cluster, victim, after, rng, parts=1)
    assert trial.digest == digest_runs(file, tmp_path / "alone"), trial


def test_without_a_scheduler_the_client_ends_with_a_line(tmp_path, file, cluster):
    client = start_campaign(file, tmp_path / "r", cluster)
    assert has_begun(client, tmp_path / "r")
    cluster.stop_scheduler()
    out, _ = client.communicate(timeout=300)
    refused = json.loads(out)["refused"]
    assert client.returncode == 2
    assert refused.startswith("campaign: --dask must be the address of a Dask scheduler")


def test_a_campaign_takes_all_workers_of_a_cluster(cluster):
    from arm_emulator_campaign.execution.worker_pool import DaskPool

    _, address = cluster.options
    limited, every = DaskPool(address, 60.0, 7), DaskPool(address, 60.0)
    try:
        until = time.monotonic() + 60.0
        while every.workers < WORKERS and time.monotonic() < until:
            time.sleep(0.1)
        assert every.workers == WORKERS and limited.workers == 7
    finally:
        limited.end_workers()
        every.end_workers()


def test_a_pool_notices_that_its_scheduler_was_replaced(cluster, monkeypatch):
    # A client that misses the end of its tasks is imitated: Dask's own notice is taken away.
    from distributed.client import FutureState

    from arm_emulator_campaign.execution.worker_pool import DaskPool, iterate_completed

    pool = DaskPool(cluster.options[1], 60.0)
    try:
        future = pool.submit(time.sleep, 3600.0)
        monkeypatch.setattr(FutureState, "cancel", lambda *_, **__: None)
        cluster.kill_process("scheduler", None, np.random.default_rng(7))
        with pytest.raises(pool.breaks, match="another scheduler"):
            list(iterate_completed(pool, [future]))
    finally:
        pool.end_workers()
