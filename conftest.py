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
    "devices",
    "doors",
    "faults_at_doors",
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
joint_laws campaign fleet_on_device snippets move full_disks recording lockstep library_examples
spoiled_files json collisions advice ways bags up search duplicate_nodes schemes identification
stream faults directed_load_friction recorder formula_users bearing sole_publisher motor_faults
demo by_hand_bags motor_kinds random_scenes portable_bits network doubtful_records new mode_loops
compiler causal_replay examples varied_places launch doctor part_contract sensitivities
managed_nodes network_fixture random_inputs faults_at_doors campaign_device kept_modes linearised
fleet topic_based fleet_follow varied_axes accuracy arm_loops child_kills motion_orders by_hand
load_friction extreme_numbers rerun_stream sensors threads repair gear_temperature device
cia402_profile latency inputs command_line working_folder bound faults_at_nodes hard_cases
firmware couplings candidate_paths brake jog inertia_check driven_machine run_time_parameters
device_examples stability located splitting progressive_gear hysteresis stopping_on_the_way
rotor_friction ideal_motors feedforward new_drives residual tune first_difference part_pairs
mounting negative_ratio at_rest learned_load bode coupled_moves validation standstill rated_tool
network_fork limits firmware_faults lanes backlash hot_path calibration external_wrench
published_joints fork_command
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
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)
