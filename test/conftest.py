"""Fixtures shared by all tests."""

import gc
import os
import signal
from collections.abc import Generator, Iterator

import pytest

# Before NumPy is loaded: matrices of tests are small, and threads that work on them together beside
# other work mostly wait for each other, spinning.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# All files are imported before a test runs, and none of that becomes garbage.
gc.disable()

# In a job that a script has started with `&` it is ignored, by all children as well.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# So that their bare assertions state what was compared, too.
pytest.register_assert_rewrite(
    "doors",
    "fuzz",
    "in_process",
    "machines",
    "network",
    "random_messages",
    "random_scenes",
    "spoiled_archives",
    "spoiled_bags",
    "spoiled_files",
    "spoiled_firmware",
    "stick_slip",
)

# Files that take longest, in turns those that wait for processes and those that wait for a
# compiler: one that comes late would leave the other half of the machine idle.
LONGEST = [
    "test_lockstep",
    "test_sensitivities",
    "test_network",
    "test_hard_cases",
    "test_recording",
    "test_lanes",
    "test_launch",
    "test_fleet",
    "test_up",
    "test_campaign",
    "test_part_contract",
    "test_spoiled_files",
    "test_threads",
    "test_copies",
    "test_fuzz",
    "test_schemes",
    "test_linearised",
    "test_mode_loops",
    "test_fault_replay",
    "test_search",
    "test_predicted_rest",
    "test_by_hand",
    "test_by_hand_bags",
    "test_servo_loop",
    "test_arm_loops",
    "test_new",
    "test_sensors",
    "test_examples",
    "test_identification",
    "test_doubles",
    "test_external_wrench",
    "test_snippets",
    "test_advice",
    "test_library_examples",
    "test_couplings",
    "test_validation",
    "test_motor_kinds",
    "test_doubtful_records",
    "test_load_friction",
    "test_at_rest",
    "test_documents",
    "test_compiler",
    "test_located",
    "test_bags",
    "test_extreme_numbers",
    "test_demo",
    "test_random_machines",
    "test_negative_ratio",
    "test_varied",
    "test_winding",
]


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Begin to import at another file in each worker of pytest-xdist.

    All of them import all files, and what they import is translated at its first import: by one of
    them, not by all at the same time.
    """
    report = yield
    worker, workers = (os.environ.get(f"PYTEST_XDIST_WORKER{end}", "") for end in ("", "_COUNT"))
    if worker and isinstance(collector, pytest.Dir):
        first = len(report.result) * int(worker.removeprefix("gw")) // int(workers)
        report.result = [*report.result[first:], *report.result[:first]]
    return report


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest; the others follow by name."""
    turn = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (turn.get(item.path.stem, len(turn)), item.path))


def pytest_collection_finish() -> None:
    """Collect garbage of the tests alone: what was imported is not looked through again."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def own_signal_handlers() -> Iterator[None]:
    """Let no handler stay behind: commands that run in this process install theirs."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)
