"""Files from outside, whatever they are: taken, or refused in one line that names the file."""

from pathlib import Path

import numpy as np
import pytest
from draws import FULL
from spoiled_files import KINDS, case, verdict

CASES = range(3000 if FULL else 25)
FIRST = 2  # draws of `make test`
SLOW = ("xacro",)  # a process for each
NEEDS = dict.fromkeys(("board", "firmware"), ("elftools", "unicorn"))  # `make test-peers` has them


@pytest.mark.parametrize(
    ("kind", "draws"),
    [(kind, CASES[:FIRST]) for kind in KINDS]
    + [pytest.param(kind, CASES[FIRST:], marks=pytest.mark.slow) for kind in KINDS],
    ids=lambda case: case if isinstance(case, str) else f"from {case.start}",
)
def test_a_spoiled_file_is_taken_or_refused_in_a_line(
    kind: str, draws: range, tmp_path: Path
) -> None:
    """A sound one is taken: a refusal names the damage as its reason."""
    for module in NEEDS.get(kind, ()):
        pytest.importorskip(module, reason="see requirements-peers.txt")
    file_kind, number = KINDS[kind], list(KINDS).index(kind)
    (tmp_path / "sound").mkdir()
    file = file_kind.write(np.random.default_rng(1), tmp_path / "sound")
    assert (verdict(file, file_kind.words(file)) == "") == file_kind.taken, "a sound file"
    refused = 0
    for turn in draws[:: 5 if kind in SLOW and not FULL else 1]:
        rng = np.random.default_rng([0, number, turn])
        refused += bool(case(kind, rng, tmp_path / str(turn)))
    assert refused, "no file was refused: the draws are too kind"
