"""A campaign whose workers, scheduler and client are killed at random moments, here and on Dask.

Each moment is a random time after a random part of the results, so that a busy machine moves it
along with the parts. The last line counts those before, amid and after the parts. Written results
must stay, no process may stay behind, and the final digest must be the same.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import yaml

from arm_emulator.base.process import is_running, list_descendants
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.results.parts import Results, compute_digest, write_part
from arm_emulator_campaign.simulation.batch_simulator import make_simulator
from arm_emulator_campaign.simulation.case import draw_cases
from arm_emulator_campaign.simulation.outcome import Outcomes

CAMPAIGN = {
    "scene": "three_axis",
    "scenario": {"seconds": 0.2, "targets": [{"at": 0.0, "elbow": 1.0}]},
    "vary": {"joints.*.friction.viscous": "nominal * lognormal(1, 0.3)"},
    "requirements": {"near": "always abs(error.*) < 0.3"},
    "count": 60_000,
}
LONGEST = 600.0  # s that a client may take, on a busy machine
ENDING = 60.0  # s until the processes of a client that was killed must have ended
WORKERS = 2
LATER = 0.5  # s after a part, at most, in which somebody is killed

Process = subprocess.Popen[str]


class Place(Protocol):
    """Processes that simulate, and how one of them is killed."""

    options: Sequence[str]  # of the command
    victims: Sequence[str]

    def kill_process(self, victim: str, client: Process, rng: np.random.Generator) -> None:
        """Kill a process of a kind."""

    def end_processes(self) -> None:
        """End what this has begun."""


def has_come_true(condition: Callable[[], bool], patience: float = LONGEST) -> bool:
    """Wait until something is so; return whether it is, at the latest after so many seconds."""
    until = time.monotonic() + patience
    while not condition():
        if time.monotonic() > until:
            return False
        time.sleep(0.01)
    return True


def is_open(port: int) -> bool:
    """Return whether somebody listens at a port of this machine."""
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
        return True
    return False


def kill_client(victim: str, client: Process) -> None:
    """Kill a client, or press Ctrl-C in its terminal, which reaches its whole group, or neither."""
    with contextlib.suppress(ProcessLookupError):  # it had just come to its end
        if victim == "client":
            client.kill()
        elif victim == "ctrl-c":
            os.killpg(client.pid, signal.SIGINT)


class Here:
    """Processes of this machine that the client begins."""

    options: Sequence[str] = ("--workers", str(WORKERS))
    victims: Sequence[str] = ("worker", "client", "ctrl-c")

    def kill_process(self, victim: str, client: Process, rng: np.random.Generator) -> None:
        """Kill a process of a kind."""
        if victim != "worker":
            return kill_client(victim, client)
        workers = list(list_descendants(client.pid))
        with contextlib.suppress(ProcessLookupError):
            if workers:
                os.kill(int(rng.choice(workers)), signal.SIGKILL)

    def end_processes(self) -> None:
        """End what this has begun: nothing."""


class Cluster:
    """A scheduler of Dask and two workers, each a process, of which any may be started again."""

    victims: Sequence[str] = ("scheduler", "worker", "client", "ctrl-c")

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        address = f"tcp://127.0.0.1:{port}"
        self.options: Sequence[str] = ("--dask", address)
        worker = ("worker", address, "--nthreads", "1", "--no-nanny", "--death-timeout", "60")
        self._words: list[tuple[str, ...]] = [
            ("scheduler", "--host", "127.0.0.1", "--port", str(port))
        ]
        self._words += [worker] * WORKERS
        self._processes = [self._begin_process(words) for words in self._words]
        # Its imports take long on a busy machine.
        if not has_come_true(lambda: is_open(port)):
            self.end_processes()
            raise TimeoutError(f"the scheduler does not listen after {LONGEST:g} s")

    @staticmethod
    def _begin_process(words: tuple[str, ...]) -> subprocess.Popen[bytes]:
        kind, *more = words
        module = f"distributed.cli.dask_{kind}"
        process = [sys.executable, "-m", module, "--no-dashboard", *more]
        return subprocess.Popen(process, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def kill_process(self, victim: str, client: Process, rng: np.random.Generator) -> None:
        """Kill a process, and start another one in its place: with a scheduler all workers."""
        if victim not in ("scheduler", "worker"):
            return kill_client(victim, client)
        everyone = range(len(self._words))
        for k in everyone if victim == "scheduler" else [int(rng.choice(everyone[1:]))]:
            self._stop_process(k)
            self._processes[k] = self._begin_process(self._words[k])

    def stop_scheduler(self) -> None:
        """Kill the scheduler; nobody takes its place."""
        self._stop_process(0)

    def _stop_process(self, k: int) -> None:
        self._processes[k].kill()
        self._processes[k].wait()

    def end_processes(self) -> None:
        """End all processes."""
        for k in range(len(self._processes)):
            self._stop_process(k)


PLACES: dict[str, Callable[[], Place]] = {"here": Here, "dask": Cluster}


@dataclass(frozen=True)
class Moment:
    """Result of a campaign of which somebody was killed.

    Attributes:
        digest: in the end; empty: the campaign has not come to its end.
        parts: files of results when it happened, and at the end.
        words: last words of a campaign without a digest.
    """

    digest: str
    parts: tuple[int, int]
    words: str

    @property
    def when(self) -> str:
        """When it happened: before the first part, amid them, or after the last."""
        before, after = self.parts
        return "before" if before == 0 else "amid" if before < after else "after"


def digest_runs(file: Path, folder: Path) -> str:
    """Return the digest of all runs, one after the other in this process."""
    campaign = load_campaign(file)
    simulator, results = make_simulator(campaign), Results(folder, campaign)
    cases = draw_cases(campaign.variation, range(campaign.count))
    write_part(folder, campaign, Outcomes.join_outcomes(list(simulator.simulate_runs(cases))))
    return compute_digest(results.collect_columns())


def start_campaign(file: Path, into: Path, place: Place) -> Process:
    """Begin a campaign, in a group of processes of its own, as from a terminal."""
    words = [sys.executable, "-m", "arm_emulator", "campaign", str(file), "--into", str(into)]
    return subprocess.Popen(
        [*words, "--json", *place.options], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip


def has_begun(client: Process, into: Path) -> bool:
    """Wait until a campaign has begun to work; return whether it has not ended before."""
    has_come_true(lambda: into.exists() or client.poll() is not None)
    return client.poll() is None


def list_parts(into: Path) -> set[Path]:
    """Return the files of results that are written."""
    return set((into / "parts").glob("*.parquet"))


def count_of_parts(file: Path, into: Path, place: Place) -> int:
    """Return how many parts a campaign writes if no process is killed."""
    start_campaign(file, into, place).communicate(timeout=LONGEST)
    return len(list_parts(into))


def simulate_kill(
    file: Path,
    into: Path,
    place: Place,
    victim: str,
    after: float,
    rng: np.random.Generator,
    parts: int = 0,
) -> Moment:
    """Kill somebody at a moment of a campaign's work; see it to its end.

    Args:
        file: of the campaign.
        into: a new folder.
        place: where its runs are simulated.
        victim: of `place.victims`.
        after: time of the kill since there were so many parts; 0: since it has begun [s].
        rng: chooses a worker.
        parts: see `after`.
    """
    client = start_campaign(file, into, place)
    has_begun(client, into)
    before = set[Path]()
    try:
        has_come_true(lambda: len(list_parts(into)) >= parts or client.poll() is not None)
        with contextlib.suppress(subprocess.TimeoutExpired):
            client.wait(after)
        processes, before = [client.pid, *list_descendants(client.pid)], list_parts(into)
        place.kill_process(victim, client, rng)
        if victim in ("client", "ctrl-c"):
            client.communicate(timeout=LONGEST)
            if not has_come_true(lambda: not any(map(is_running, processes)), ENDING):
                return Moment("", (len(before), 0), "somebody stays behind")
            client = start_campaign(file, into, place)
        out, wrong = client.communicate(timeout=LONGEST)
    except subprocess.TimeoutExpired:
        os.killpg(client.pid, signal.SIGKILL)
        return Moment("", (len(before), 0), f"hung: {client.communicate()[1][-600:]}")
    facts, last = json.loads(out) if out.strip() else {}, list_parts(into)
    words = "" if before <= last else "parts are lost"
    digest = "" if words else facts.get("digest", "")
    words = words or facts.get("refused", "") or wrong[-1500:]
    return Moment(digest, (len(before), len(last)), words)


def main() -> None:
    """Print what became of each moment, and the count of those that were survived."""
    parser = argparse.ArgumentParser(prog="bench.campaign_kills", description=__doc__)
    parser.add_argument("--moments", type=int, default=70)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng, survived, when = np.random.default_rng(args.seed), Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory() as empty:
        folder = Path(empty)
        file = folder / "campaign.yaml"
        file.write_text(yaml.safe_dump(CAMPAIGN), encoding="utf-8")
        expected = digest_runs(file, folder / "alone")

        places: dict[str, Place] = {name: make_place() for name, make_place in PLACES.items()}
        kinds = [(name, victim) for name, place in places.items() for victim in place.victims]
        try:
            parts = {
                name: count_of_parts(file, folder / name, place) for name, place in places.items()
            }
            for moment in range(args.moments):
                name, victim = kinds[moment % len(kinds)]
                before, after = int(rng.integers(1, parts[name] + 1)), rng.uniform(0.0, LATER)
                into = folder / f"{moment}"
                trial = simulate_kill(file, into, places[name], victim, after, rng, before)
                survived[f"{name} {victim}"] += trial.digest == expected
                when[trial.when] += 1
                good = "same digest" if trial.digest == expected else f"{trial}"
                at = f"{after:.2f} s after part {before}"
                print(f"{moment}: {name} {victim}, {at}, {trial.when}: {good}", flush=True)
        finally:
            for place in places.values():
                place.end_processes()
    for kind in kinds:
        print(f"{' '.join(kind):<16} {survived[' '.join(kind)]}")
    print(f"{survived.total()} of {args.moments} survived, digest {expected[:16]}")
    print(", ".join(f"{count} {name} the parts were written" for name, count in when.items()))


if __name__ == "__main__":
    main()
