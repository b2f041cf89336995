"""Processes that simulate runs of a campaign together, and how far they are."""

from __future__ import annotations

import concurrent.futures as cf
import math
import multiprocessing as mp
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Any, Self, TypeVar

from arm_emulator.extension.base import Refusal, require_package
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.execution.worker import Done, begin_worker, call_on

POLL_PERIOD = 2.0  # s between questions for the workers of a cluster
CHUNK = 1.5  # s of simulation: more than a task costs, and little to lose
LARGEST_CHUNK = 100_000  # runs
MAX_BREAKS = 3  # of pools that end without a finished chunk
Left = TypeVar("Left")
Result = TypeVar("Result")


class LocalPool(cf.ProcessPoolExecutor):
    """Processes on this machine, which end with this one.

    Args:
        workers: processes.
        devices: one for each of them to simulate on; none: in lanes of the processor.
    """

    breaks: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, workers: int, devices: Sequence[str] = ()) -> None:
        self.workers = workers
        spawned = mp.get_context("spawn")
        device_queue = None
        if devices:
            device_queue = spawned.Queue()
            for device in devices:
                device_queue.put(device)
        super().__init__(
            workers, spawned, initializer=begin_worker, initargs=(os.getpid(), device_queue)
        )

    def check_scheduler(self) -> None:
        """Do nothing: the futures of a process that was killed end by themselves."""

    def end_workers(self) -> None:
        """Let all workers write finished runs, and end them."""
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            processes = list((self._processes or {}).values())
            for process in processes:
                process.terminate()
            self.shutdown(wait=True, cancel_futures=True)
            for process in processes:
                process.join(30.0)
        finally:
            signal.signal(signal.SIGINT, before)


class DaskPool:
    """The workers of a Dask cluster, which must see the same files.

    Args:
        address: of the scheduler.
        patience: for so long it may not answer [s].
        workers: chunks are for so many; None: for all that the cluster has, come and gone ones too.
        device: that each worker simulates on, as it sees it; None: in lanes of the processor.

    Raises:
        Refusal: Dask is not installed, or no scheduler answers.
    """

    def __init__(
        self, address: str, patience: float, workers: int | None = None, device: str | None = None
    ) -> None:
        require_package("campaign", "distributed", "distributed")
        from distributed import Client
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker

        # A scheduler that ends cancels its tasks.
        self.breaks: tuple[type[BaseException], ...] = (
            cf.CancelledError, CommClosedError, KilledWorker
        )  # fmt: skip
        try:
            self._client = Client(address, timeout=patience)
        except (OSError, ValueError) as error:
            rule = "be the address of a Dask scheduler"
            raise Refusal("campaign", "--dask", rule, f"{address}: {error}") from None
        self._executor = self._client.get_executor(pure=False, retries=3)
        self._device, self._patience, self._fixed_workers = device, patience, workers
        self._scheduler: str = self._client.scheduler_info()["id"]
        self._asked_at, self._answered_at = -math.inf, time.monotonic()
        self._threads = 1

    @property
    def workers(self) -> int:
        """Number given, or of the cluster's threads, asked now and then; at least 1."""
        if self._fixed_workers is not None:
            return self._fixed_workers
        self.check_scheduler()
        return self._threads

    def check_scheduler(self) -> None:
        """Ask the scheduler now and then whether it still is the one that has the tasks.

        A client may miss that its scheduler was replaced, and then waits for ever.

        Raises:
            CancelledError: it is another one, or has not answered for as long as it may.
        """
        now = time.monotonic()
        if now - self._asked_at < POLL_PERIOD:
            return
        self._asked_at = now
        try:
            answer = self._client.scheduler_info()
        except OSError:
            if now - self._answered_at > self._patience:
                raise cf.CancelledError("the scheduler does not answer") from None
            return
        self._answered_at = time.monotonic()
        if answer["id"] != self._scheduler:
            raise cf.CancelledError("another scheduler is at the address")
        threads = sum(worker["nthreads"] for worker in answer["workers"].values())
        self._threads = max(1, threads)

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> cf.Future[Any]:
        """Submit a call."""
        call = (function, *arguments)
        if self._device is not None:
            call = (call_on, self._device, *call)
        future: cf.Future[Any] = self._executor.submit(*call)
        return future

    def end_workers(self) -> None:
        """Leave the cluster."""
        self._executor.shutdown(wait=False)
        self._client.close()


Pool = LocalPool | DaskPool


def wait_for_any(
    pool: Pool, waiting: Iterable[cf.Future[Result]]
) -> tuple[set[cf.Future[Result]], set[cf.Future[Result]]]:
    """Return the futures of a pool that are done, after a moment perhaps none, and the others.

    Raises:
        Exception: one of `pool.breaks`, if the pool cannot complete them.
    """
    pool.check_scheduler()
    done, others = cf.wait(waiting, timeout=0.5, return_when=cf.FIRST_COMPLETED)
    return done, others


def iterate_completed(
    pool: Pool, futures: Iterable[cf.Future[Result]]
) -> Iterator[cf.Future[Result]]:
    """Yield the futures of a pool as they are done.

    Raises:
        Exception: see `wait_for_any`.
    """
    waiting = set(futures)
    while waiting:
        done, waiting = wait_for_any(pool, waiting)
        yield from done


@dataclass
class CampaignProgress:
    """Progress of a campaign.

    Attributes:
        count: of runs in all.
        before: runs that were done when it began.
        done: runs since then.
        failures: of each requirement, and of any last, in all of these.
        began: when it began, by `time.monotonic`.
    """

    count: int
    before: int
    done: int = 0
    failures: list[int] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)

    def add_result(self, done: Done) -> None:
        """Count the result of a chunk."""
        self.done += done.runs
        pairs = zip(self.failures, done.failures, strict=True)
        self.failures = [before + more for before, more in pairs]

    def is_late(self, seconds: float) -> bool:
        """Whether so much wall time has passed."""
        return time.monotonic() - self.began >= seconds

    @property
    def rate(self) -> float:
        """Runs per second of wall time."""
        return self.done / max(1e-9, time.monotonic() - self.began)

    @property
    def left(self) -> float:
        """Seconds that the rest will take; NaN: not known yet."""
        rest = self.count - self.before - self.done
        return rest / self.rate if self.done else math.nan


@dataclass(frozen=True)
class WorkerPool:
    """Processes that simulate, and who is informed of it.

    Attributes:
        make_pool: makes processes; called again after one of them was killed.
        seconds: of a run, measured beforehand.
        report: is called after each chunk.
    """

    make_pool: Callable[[], Pool]
    seconds: float
    report: Callable[[CampaignProgress], None]

    @property
    def largest(self) -> int:
        """Runs of a chunk, at most."""
        return max(1, min(LARGEST_CHUNK, round(CHUNK / self.seconds)))


class Work:
    """Work of a pool: where one of its processes is killed, others do the remaining work.

    Use it as a context, at whose end the processes end.

    Args:
        campaign: whose runs these are.
        worker_pool: does it.
        progress: of this work; a chunk that is done counts there.
    """

    def __init__(
        self, campaign: Campaign, worker_pool: WorkerPool, progress: CampaignProgress
    ) -> None:
        self._campaign, self._worker_pool, self._progress = campaign, worker_pool, progress
        self._pool: Pool | None = None

    def complete_missing(
        self,
        missing: Callable[[int], Sequence[Left]],
        work: Callable[[Pool, Sequence[Left], int], None],
    ) -> None:
        """Call work(pool, missing(killed), killed), again for each pool that is killed.

        Raises:
            Refusal: pools end again and again without a finished chunk.
        """
        breaks = killed = 0
        while left := missing(killed):
            before = self._progress.done
            pool = self._pool = self._pool or self._worker_pool.make_pool()
            try:
                return work(pool, left, killed)
            except pool.breaks:
                killed += 1
                breaks = breaks + 1 if self._progress.done == before else 0
                self.end_processes()
            if breaks >= MAX_BREAKS:
                where, ended = self._campaign.where, f"ended {breaks} times"
                raise Refusal(where, "workers", "not end by themselves", ended)

    def end_processes(self) -> None:
        """End the processes."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.end_workers()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end_processes()
