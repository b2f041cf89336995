"""Fixtures shared by all tests."""

import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

# Packages, and the folders with what tests import.
IMPORTED = (
    "packages/arm_emulator_*",
    "test",
    "test/*",
    "packages/test",
    "packages/*/test",
    "packages/*/test/peers",
)
for folders in IMPORTED:
    sys.path[:0] = [
        str(folder)
        for folder in sorted(Path(__file__).parent.glob(folders))
        if not (folder / "__init__.py").exists()  # else a package, such as `fuzz`
    ]

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
    "devices",
    "doors",
    "faults_at_doors",
    "fleet_pairs",
    "fuzz",
    "hard_cases",
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

# Files that take more than 5 s, the longest first: one that comes late would leave the other half
# of the machine idle.
LONGEST = """
fleet_on_device advice campaign bags mode_loops network recording doctor spoiled_files event_queue
inputs fleet faults_at_doors causal_replay driven_machine formula_users jog stopping_on_the_way
splitting json compiler directed_load_friction lockstep motor_kinds campaign_device command_line
device doubtful_records faults_at_nodes threads faults collisions recorder number brake
duplicate_nodes fork_command extreme_numbers by_hand bearing copied_states fit_numbers fmu firmware
validation portable_bits trees message_reader full_disks
""".split()


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
    items.sort(
        key=lambda item: (turn.get(item.path.stem.removeprefix("test_"), len(turn)), item.path)
    )


def pytest_collection_finish() -> None:
    """Collect garbage of the tests alone: what was imported is not looked through again."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def own_signal_handlers() -> Iterator[None]:
    """Let no handler stay behind: commands that run in this process install theirs."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)
