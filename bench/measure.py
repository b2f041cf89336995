"""Timing: interleaved, repeated, medians with spread, the machine named."""

from __future__ import annotations

import contextlib
import gc
import importlib.metadata
import io
import multiprocessing
import os
import platform
import shlex
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from arm_emulator.machine.plant.compiler import load_machine
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.toolchain.compiler_command import find_compiler

Case = TypeVar("Case")
Result = TypeVar("Result")

ENOUGH = 0.01  # s of work in one repetition
LONG = 0.2  # s; beyond this a cold cache is nothing


@dataclass(frozen=True)
class Task:
    """A thing to time. Both functions get the number of the repetition; only `work` is timed.

    `about` is how long it will take, roughly [s]: what is short is done several times in each
    repetition, and what is long needs no warm-up.
    """

    work: Callable[[int], object]
    prepare: Callable[[int], object] = lambda repetition: None
    about: float = 0.1

    @property
    def times(self) -> int:
        """Number of calls in one repetition."""
        return max(1, min(50, round(ENOUGH / self.about)))


class Steps(Protocol):
    """A plant, or MuJoCo's of the same machine."""

    def reset(self) -> None:
        """Go back to the start."""

    def run(self, voltages: ArrayLike, steps: int) -> object:
        """Hold each row of voltages for some steps."""


def make_stepping_task(
    machine: Steps, voltages: ArrayLike, steps: int, about: float = ENOUGH
) -> Task:
    """Return the task of running a machine from its start, each row of voltages for `steps`."""
    return Task(lambda _: machine.run(voltages, steps), lambda _: machine.reset(), about)


@dataclass(frozen=True)
class WallTime:
    """Wall time of a task [s]: median and quartiles of the repetitions."""

    median: float
    low: float
    high: float
    repetitions: int

    def divide_by(self, count: float) -> WallTime:
        """Return the time of one of `count` equal parts."""
        return WallTime(self.median / count, self.low / count, self.high / count, self.repetitions)

    @property
    def spread(self) -> float:
        """Half the distance of the quartiles, over the median."""
        return 0.5 * (self.high - self.low) / self.median


def measure_interleaved(
    tasks: Mapping[str, Task], repetitions: int, done: Callable[[str], None] | None = None
) -> dict[str, WallTime]:
    """Time every task `repetitions` times, all of them in turn, after one turn of warm-up.

    In turn, so that a slow spell of the machine hits all tasks alike and not one of them. `done` is
    called after each repetition of each task, with the task's name.
    """
    walls: dict[str, list[float]] = {name: [] for name in tasks}
    for task in tasks.values():
        if task.about < LONG:
            task.prepare(0)
            task.work(0)
    with pause_collector():
        for repetition in range(repetitions):
            for name, task in tasks.items():
                for _ in range(task.times):
                    task.prepare(repetition)
                    started = time.perf_counter()
                    task.work(repetition)
                    walls[name].append(time.perf_counter() - started)
                if done is not None:
                    done(name)
    return {name: make_wall_time(values) for name, values in walls.items()}


def make_wall_time(walls: Iterable[float]) -> WallTime:
    """Return median and quartiles of some wall times [s]."""
    values = np.array(list(walls))
    low, median, high = np.quantile(values, (0.25, 0.5, 0.75))
    return WallTime(float(median), float(low), float(high), len(values))


@contextlib.contextmanager
def pause_collector() -> Iterator[None]:
    """Keep Python's garbage collector away from what is timed."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextlib.contextmanager
def show_progress(title: str, steps: int) -> Iterator[Callable[..., None]]:
    """Show a bar; the function yielded moves it by one step and shows what comes next.

    The bar is drawn in these calls only, never by a thread that would disturb what is timed.
    """
    columns = (
        TextColumn("{task.description:<22}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[now]}"),
    )
    with Progress(*columns, auto_refresh=False) as bar:
        task = bar.add_task(title, total=steps, now="")
        bar.refresh()

        def advance_bar(now: str = "") -> None:
            bar.update(task, advance=1, now=now)
            bar.refresh()

        yield advance_bar


def compile_all(scenes: Iterable[Scene]) -> None:
    """Compile what is not in the cache yet, on all cores, before anything is timed."""
    different = {write_scene_unit(scene): scene for scene in scenes}
    quiet = io.StringIO()
    with (
        contextlib.redirect_stderr(quiet),
        ThreadPoolExecutor(os.cpu_count()) as pool,
        show_progress("compile", len(different)) as done,
    ):
        for scene, _ in zip(
            different.values(), pool.map(load_machine, different.values()), strict=True
        ):
            done(scene.name)


def map_on_all_cores(
    title: str, work: Callable[[Case], Result], cases: Iterable[Case]
) -> list[Result]:
    """Return `work` of every case, on all cores: for what takes long and is not timed.

    Args:
        title: to show above the bar.
        work: a function of a module, which processes of their own import.
        cases: what each process is given, to be pickled.
    """
    cases = list(cases)
    # Processes that start anew inherit no threads that hold a lock.
    start = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(os.cpu_count(), start) as pool,
        show_progress(title, len(cases)) as done,
    ):
        jobs = [pool.submit(work, case) for case in cases]
        for job in as_completed(jobs):
            job.result()
            done()
    return [job.result() for job in jobs]


def choose_compiler() -> None:
    """Let measured code be that of this compiler: without $CXX, that of any compiler would do.

    Raises:
        Refusal: there is no compiler.
    """
    os.environ["CXX"] = shlex.join(find_compiler())


def describe_machine() -> dict[str, Any]:
    """Return what the figures depend on: processor, cores, versions."""
    version = subprocess.run(
        [*find_compiler(), "--version"], capture_output=True, text=True, check=False
    ).stdout.splitlines()
    packages = ("numpy", "scipy", "mujoco", "pin")
    return {
        "processor": _find_processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "compiler": version[0] if version else "unknown",
        "python": platform.python_version(),
        "versions": {name: importlib.metadata.version(name) for name in packages},
        "load_at_start": os.getloadavg()[0],
    }


def _find_processor() -> str:
    """Return the processor's model, generically: a hypervisor may hide the rest."""
    values: dict[str, str] = {}
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            key, colon, value = line.partition(":")
            if colon:
                values.setdefault(key.strip(), value.strip())
    name = values.get("model name", platform.processor() or platform.machine())
    if "cpu family" in values:
        name += f" (family {values['cpu family']}, model {values.get('model', '?')})"
    simd = [flag for flag in ("avx2", "avx512f") if flag in values.get("flags", "").split()]
    return ", ".join([name, *simd])
