"""A short part of `make fuzz`, and all that ever broke (test/corpus/)."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doors import Doors, doors
from draws import FULL, some
from fuzz import cores, messages, scenes
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.database import DirectoryBasedExampleDatabase
from random_messages import RECEIVER, TOPICS, bad_message, random_message
from random_scenes import verdict

CORPUS = Path(__file__).resolve().parent / "corpus"
# `make fuzz` asks for more.
LONG = "FUZZ_EXAMPLES" in os.environ
examples = settings(
    max_examples=int(os.environ.get("FUZZ_EXAMPLES", "100")),
    derandomize=not LONG,
    # A case that failed once is tried first from then on.
    database=DirectoryBasedExampleDatabase(CORPUS / "hypothesis") if LONG else None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
randoms = st.randoms(use_true_random=False)
topics = st.sampled_from(TOPICS)


@pytest.mark.parametrize("number", some(range(60), 20))
def test_a_random_scene_is_taken_or_refused_in_a_line(number: int, tmp_path: Path) -> None:
    scenes.case(0, number, tmp_path / "case")


@pytest.mark.parametrize("folder", sorted((CORPUS / "scenes").iterdir()), ids=lambda f: f.name)
def test_a_scene_that_broke_something_is_taken_or_refused(folder: Path) -> None:
    verdict(folder / "scene.yaml")


@pytest.fixture(scope="module")
def at_the_doors() -> Iterator[Doors]:
    with doors() as opened:
        yield opened


@pytest.mark.slow
@given(rng=randoms, topic=topics, tick=st.integers(0, 10**6))
@examples
def test_a_bad_message_is_refused_and_changes_nothing(
    at_the_doors: Doors, rng: Any, topic: str, tick: int
) -> None:
    node = RECEIVER[topic]
    message = bad_message(rng, topic, at_the_doors.joint_names, 1000 + tick)
    state, refused = at_the_doors.state(node), at_the_doors.refused(node)
    at_the_doors.give(node, topic, message)
    assert at_the_doors.refused(node) == refused + 1, f"{node} has not refused {message}"
    after = at_the_doors.state(node)
    changed = {name: (state[name], after[name]) for name in state if state[name] != after[name]}
    assert not changed, f"{node} refused {topic} and changed {changed}"


@given(rng=randoms, topic=topics, tick=st.integers(0, 10**6))
@examples
def test_any_message_is_taken_or_refused(
    at_the_doors: Doors, rng: Any, topic: str, tick: int
) -> None:
    message = random_message(rng, topic, at_the_doors.joint_names, tick)
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        at_the_doors.give(RECEIVER[topic], topic, message)


@pytest.mark.slow
@pytest.mark.parametrize("clock", some(["lockstep", "realtime"], 1))
def test_a_network_survives_random_messages(clock: str, tmp_path: Path) -> None:
    number = 480 if FULL else 60
    count = messages.fuzz(0, clock, number, tmp_path)
    assert count["refused"] > number // 5, f"of bad messages, hardly one was refused: {count}"


# The second one once broke something: no steps under rows of voltages, out of bounds already.
@pytest.mark.slow
@pytest.mark.parametrize(("seed", "number", "largest"), some([(1, 1, 4), (0, 0, 2), (0, 1, 2)], 1))
def test_a_random_machine_responds_or_refuses(
    seed: int, number: int, largest: int, tmp_path: Path
) -> None:
    cores.case(seed, number, tmp_path / "case", largest)


SANITIZED = """
import sys
from pathlib import Path
from fuzz import cores
cores.case(0, 0, Path(sys.argv[1]), largest=1)
"""


@pytest.mark.slow
def test_the_core_is_clean_under_its_sanitizers(tmp_path: Path) -> None:
    """One machine of one joint: a compiler takes long with sanitizers."""
    environment = cores.environment(tmp_path)
    environment["PYTHONPATH"] = ":".join(sys.path)
    command = [sys.executable, "-c", SANITIZED, str(tmp_path / "case")]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=300.0, check=False
    )
    assert done.returncode == 0, done.stderr[-5000:]


@pytest.mark.parametrize(
    "source",
    [
        'extern "C" int f(int i) { int a[3] = {1, 2, 3}; return a[i]; }',
        "struct A { int n = 0, a[1] = {}; }; struct B { A a; int after[4] = {}; } b; "
        'extern "C" int f(int i) { return b.a.a[i]; }',
    ],
    ids=["array", "last of a struct"],
)
def test_the_sanitizers_detect_accesses_out_of_bounds(source: str, tmp_path: Path) -> None:
    """The compiler that is used is one that would report, of an array within a struct, too."""
    unit, library = tmp_path / "unit.cpp", tmp_path / "unit.so"
    unit.write_text(source)
    environment = cores.environment(tmp_path)
    command = [environment["CXX"], "-shared", "-fPIC", str(unit), "-o", str(library)]
    subprocess.run(command, check=True)
    code = f"import ctypes; ctypes.CDLL({str(library)!r}).f(3)"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0 and "out of bounds" in done.stderr, done.stderr
