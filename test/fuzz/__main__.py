"""`make fuzz`: python -m fuzz [--minutes 10] [--seed 1] [--scenes N] [--files N] [--messages N]
[--machines N] [--frames N].

Without numbers, scenes, files, machines and frames share the time that messages leave. A failure is
printed with the command that repeats it.
"""

import argparse
import contextlib
import json
import os
import selectors
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from fuzz.cores import environment
from fuzz.line import FAILED, REFUSED, TAKEN

WORKERS = 2
MESSAGES_PER_MINUTE = 1000  # of the time for all, where no number is asked for
MESSAGES_PER_NETWORK = 5000
HANGS = {
    "scenes": 20.0,
    "files": 150.0,
    "cores": 300.0,
    "messages": 120.0,
    "frames": 300.0,
}  # s without a word; a compiler may take
OUT = Path("out/fuzz")


@dataclass
class Worker:
    """A process that tries cases FIRST, FIRST + STEP, ... of a part; it goes on after a crash."""

    part: str
    arguments: list[str]
    first: int = 0
    environment: dict[str, str] | None = None
    case: int = -1
    heard: float = 0.0
    rest: bytes = b""
    process: subprocess.Popen[bytes] = field(init=False)

    def start(self) -> None:
        """Start, or go on with the case `first`."""
        words = [str(self.first), str(WORKERS)] if self.part != "messages" else []
        seed, *more = self.arguments
        self.errors = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            [sys.executable, "-m", f"fuzz.{self.part}", seed, *more, *words],
            stdout=subprocess.PIPE,
            stderr=self.errors,
            env=self.environment,
        )
        self.heard = time.monotonic()

    def lines(self) -> Iterator[dict[str, Any]]:
        """Return what it has reported since."""
        assert self.process.stdout is not None
        data = os.read(self.process.stdout.fileno(), 1 << 16)
        self.heard = time.monotonic()
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in lines:
            with contextlib.suppress(json.JSONDecodeError):  # what a library prints
                yield json.loads(line)

    def stop(self) -> None:
        """End it."""
        self.process.kill()
        self.process.wait()
        self.errors.close()

    def last_words(self) -> str:
        """Return the end of what it wrote to standard error."""
        self.errors.seek(0)
        return self.errors.read().decode(errors="replace")[-4000:]


class Fuzzer:
    """Runs workers and counts what came of their cases."""

    def __init__(self, seed: int, progress: Progress, console: Console) -> None:
        self.seed = seed
        self.counts: dict[str, Counter[str]] = {}
        self.seconds: Counter[str] = Counter()
        self._progress, self._console = progress, console
        self._bars: dict[str, TaskID] = {}

    def run(self, part: str, workers: list[Worker], cases: int | None, until: float) -> None:
        """Run the workers until so many cases are done, or `until`, a time.monotonic()."""
        started = time.monotonic()
        name = part if workers[0].part != "messages" else f"{part}, {workers[0].arguments[1]}"
        count = self.counts.setdefault(name, Counter())
        total = cases if cases is not None else max(1.0, until - started)
        bar = self._bars.get(name)
        if bar is None:
            bar = self._bars[name] = self._progress.add_task(name, total=total, words="")
        done = 0
        with selectors.DefaultSelector() as selector:

            def watch(worker: Worker) -> None:
                worker.start()
                selector.register(worker.process.stdout, selectors.EVENT_READ, worker)  # type: ignore[arg-type]

            for worker in workers:
                watch(worker)
            running = list(workers)
            while running and (cases is None or done < cases):
                if cases is None and time.monotonic() > until:
                    break
                for key, _ in selector.select(timeout=0.5):
                    worker = key.data
                    for line in worker.lines():
                        done += self._take(name, worker, count, line)
                for worker in list(running):
                    silent = time.monotonic() - worker.heard > HANGS[worker.part]
                    if worker.process.poll() is None and not silent:
                        continue
                    for line in worker.lines() if not silent else ():
                        done += self._take(name, worker, count, line)
                    selector.unregister(worker.process.stdout)  # type: ignore[arg-type]
                    code = worker.process.poll()
                    if code != 0:
                        failure = (
                            f"hangs for {HANGS[worker.part]:g} s" if silent else f"exit {code}"
                        )
                        self._fail(name, worker, count, f"{failure}\n{worker.last_words()}")
                        done += 1
                    worker.stop()
                    if worker.part == "messages":
                        running.remove(worker)
                    else:
                        worker.first = worker.case + WORKERS
                        watch(worker)
                now = done if cases is not None else time.monotonic() - started
                words = ", ".join(f"{event} {number}" for event, number in sorted(count.items()))
                self._progress.update(bar, completed=min(now, total), words=words)
            for worker in running:
                worker.stop()
        self.seconds[name] += round(time.monotonic() - started)

    def _take(self, name: str, worker: Worker, count: Counter[str], line: dict[str, Any]) -> int:
        """Note a line; return how many cases it ends."""
        if "begin" in line:
            worker.case = line["begin"]
        elif "sent" in line:
            return int(line["sent"])
        elif line.get("outcome") == FAILED:
            self._fail(name, worker, count, line["what"])
            return 1
        elif "outcome" in line:
            count[line["outcome"]] += line["count"]
            return int(worker.part in ("scenes", "files"))
        return int(worker.part == "cores" and "done" in line)

    def _fail(self, name: str, worker: Worker, count: Counter[str], failure: str) -> None:
        count[FAILED] += 1
        OUT.mkdir(parents=True, exist_ok=True)
        words = "-".join([worker.part, *worker.arguments[:2], str(worker.case)])
        file = OUT / f"{words}.txt"
        file.write_text(f"{failure}\n", errors="replace")
        last = failure.strip().splitlines()[-1][:160] if failure.strip() else ""
        self._console.print(f"{name}, case {worker.case}: {last} ({file})", markup=False)


def divide_networks(messages: int) -> list[int]:
    """Share messages out to networks, each with a seed of its own: every state of a run is kept."""
    full_networks, rest = divmod(messages, MESSAGES_PER_NETWORK)
    return [MESSAGES_PER_NETWORK] * full_networks + ([rest] if rest else [])


def properties(examples: int, seed: int) -> Counter[str]:
    """Let Hypothesis look for messages that break a node; what it finds, it keeps."""
    words = [f"--hypothesis-seed={seed}", "-k", "_message_", "test/test_fuzz.py"]
    return _tested("hypothesis", words, {"FUZZ_EXAMPLES": str(examples)}, 2 * examples)


def reader(sanitized: dict[str, str]) -> Counter[str]:
    """Let a reader that was compiled with sanitizers read spoiled messages, each from its heap."""
    words = ["test/ros/test_message_reader.py"]
    return _tested("reader", words, {**sanitized, "PYTHONMALLOC": "malloc"}, 1)


def _tested(name: str, words: list[str], more: dict[str, str], count: int) -> Counter[str]:
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / f"{name}.txt").open("w") as out:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", *words],
            env={**os.environ, **more},
            stdout=out,
            stderr=subprocess.STDOUT,
            check=False,
        )
    failed = int(done.returncode != 0)
    return Counter({TAKEN: count * (1 - failed), FAILED: failed})


def main() -> None:
    """Fuzz, show a table, exit with code 1 if anything failed."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="where no number is asked for")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scenes", type=int, help="how many scenes and URDFs")
    parser.add_argument("--files", type=int, help="how many spoiled files, of all kinds in turns")
    parser.add_argument("--messages", type=int, help="how many messages, half in each clock")
    parser.add_argument("--machines", type=int, help="how many machines, compiled with sanitizers")
    parser.add_argument("--frames", type=int, help="how many of EtherCAT, with sanitizers")
    arguments = parser.parse_args()
    console = Console(highlight=False)
    numbered = (
        arguments.scenes, arguments.files, arguments.messages, arguments.machines, arguments.frames,
    )  # fmt: skip
    bounded = any(number is not None for number in numbered)
    messages = arguments.messages
    if messages is None and not bounded:
        messages = round(MESSAGES_PER_MINUTE * arguments.minutes)
    deadline = time.monotonic() + 60.0 * arguments.minutes
    seed = str(arguments.seed)
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[words]}"),
        TimeElapsedColumn(),
        console=console,
    )
    with progress, tempfile.TemporaryDirectory(prefix="fuzz-cache-") as cache:
        fuzzer = Fuzzer(arguments.seed, progress, console)
        for clock in ("lockstep", "realtime") if messages else ():
            for turn, count in enumerate(divide_networks(messages // 2)):
                worker = Worker("messages", [str(arguments.seed + turn), clock, str(count)])
                fuzzer.run("messages", [worker], None, deadline + 1e9)
        if not bounded:
            started = time.monotonic()
            name = "messages, Hypothesis"
            fuzzer.counts[name] = properties(round(200 * arguments.minutes), arguments.seed)
            fuzzer.seconds[name] = round(time.monotonic() - started)
        now = time.monotonic()
        left = max(0.0, deadline - now)
        half = now + left / 2
        if arguments.scenes is not None or not bounded:
            workers = [Worker("scenes", [seed], first) for first in range(WORKERS)]
            fuzzer.run("scenes", workers, arguments.scenes, half)
        if arguments.files is not None or not bounded:
            workers = [Worker("files", [seed], first) for first in range(WORKERS)]
            fuzzer.run("files", workers, arguments.files, half + left / 8)
        sanitized = environment(Path(cache))
        if not bounded:
            fuzzer.counts["messages, in C"] = reader(sanitized)
        if arguments.frames is not None or not bounded:
            workers = [Worker("frames", [seed], first, sanitized) for first in range(WORKERS)]
            fuzzer.run("frames", workers, arguments.frames, half + left / 4)
        if arguments.machines is not None or not bounded:
            workers = [Worker("cores", [seed], first, sanitized) for first in range(WORKERS)]
            fuzzer.run("machines", workers, arguments.machines, deadline)
    table = Table("part", TAKEN, REFUSED, FAILED, "seconds")
    for name, count in fuzzer.counts.items():
        figures = (count[TAKEN], count[REFUSED], count[FAILED], fuzzer.seconds[name])
        table.add_row(name, *map(str, figures))
    console.print(table)
    sys.exit(any(count[FAILED] for count in fuzzer.counts.values()))


if __name__ == "__main__":
    main()
