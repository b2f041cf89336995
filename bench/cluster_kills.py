"""A campaign on a Dask cluster whose scheduler, workers and client are killed at random moments."""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import yaml

from arm_emulator.campaign.campaign_file import load_campaign
from arm_emulator.campaign.case import drawn_case
from arm_emulator.campaign.lanes import runs_of
from arm_emulator.campaign.outcome import Outcomes
from arm_emulator.campaign.results import Results, digest_of, write_part

CAMPAIGN = {
    "scene": "three_axis",
    "scenario": {"seconds": 0.2, "targets": [{"at": 0.0, "elbow": 1.0}]},
    "vary": {"joints.*.friction.viscous": "nominal * lognormal(1, 0.3)"},
    "requirements": {"near": "always abs(error.*) < 0.3"},
    "count": 4000,
}
VICTIMS = ("scheduler", "worker", "client")
LONGEST = 600.0  # s that a client may take, on a busy machine


class Cluster:
    """A scheduler and two workers, each a process, of which any may be started again."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        worker = ("worker", self.address, "--nthreads", "1", "--no-nanny", "--death-timeout", "60")
        self._words = [("scheduler", "--host", "127.0.0.1", "--port", str(port)), worker, worker]
        self._processes = [self._begun(words) for words in self._words]

    @staticmethod
    def _begun(words: tuple[str, ...]) -> subprocess.Popen[bytes]:
        kind, *more = words
        module = f"distributed.cli.dask_{kind}"
        process = [sys.executable, "-m", module, "--no-dashboard", *more]
        return subprocess.Popen(process, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def kill(self, place: int) -> None:
        """Kill a process, and start another one in its place: with a scheduler all workers."""
        for k in range(len(self._words)) if place == 0 else (place,):
            self._processes[k].kill()
            self._processes[k].wait()
            self._processes[k] = self._begun(self._words[k])

    def end(self) -> None:
        """End all processes."""
        for one in self._processes:
            one.kill()
            one.wait()


def digest_alone(file: Path, folder: Path) -> str:
    """Return the digest of all runs, one after the other in this process."""
    campaign = load_campaign(file)
    runs, results = runs_of(campaign), Results(folder, campaign)
    cases = [drawn_case(campaign.variation, index) for index in range(campaign.count)]
    write_part(folder, campaign, Outcomes.joined(list(runs.runs(cases))))
    return digest_of(results.columns())


def one_moment(file: Path, into: Path, victim: str, rng: np.random.Generator) -> tuple[str, str]:
    """Kill one process while a campaign runs; return the digest in the end, and the last words."""
    cluster = Cluster()
    words = [sys.executable, "-m", "arm_emulator", "campaign", str(file), "--into", str(into)]
    words += ["--json", "--dask", cluster.address]

    def begun() -> subprocess.Popen[str]:
        return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    try:
        client = begun()
        until = time.monotonic() + LONGEST
        while not into.exists() and client.poll() is None and time.monotonic() < until:
            time.sleep(0.02)
        time.sleep(rng.uniform(0.0, 4.0))
        if victim == "client":
            client.kill()
            client.communicate()
            client = begun()
        else:
            cluster.kill(0 if victim == "scheduler" else int(rng.integers(1, 3)))
        try:
            out, wrong = client.communicate(timeout=LONGEST)
        except subprocess.TimeoutExpired:
            client.kill()
            out, wrong = client.communicate()
            return "", f"hung: {wrong[-600:]}"
        facts = json.loads(out) if out.strip() else {}
        return facts.get("digest", ""), facts.get("refused", "") or wrong[-1500:]
    finally:
        cluster.end()


def main() -> None:
    """Print what became of each moment, and the count of those that were survived."""
    parser = argparse.ArgumentParser(prog="bench.cluster_kills", description=__doc__)
    parser.add_argument("--moments", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng, survived = np.random.default_rng(given.seed), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "campaign.yaml"
        file.write_text(yaml.safe_dump(CAMPAIGN), encoding="utf-8")
        wanted = digest_alone(file, Path(folder) / "alone")
        for moment in range(given.moments):
            victim = VICTIMS[moment % len(VICTIMS)]
            digest, words = one_moment(file, Path(folder) / f"{moment}", victim, rng)
            survived[victim] += digest == wanted
            if digest != wanted:
                print(f"moment {moment}, {victim} killed: {words}", flush=True)
    shares = ", ".join(f"{name} {survived[name]}" for name in VICTIMS)
    print(f"{survived.total()} of {given.moments} survived: {shares}")


if __name__ == "__main__":
    main()
