"""Films of recorded runs: as many pictures as asked for, in which the arm moves."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from made_bags import synthetic

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.commands.film import film
from arm_emulator.view.film import check_film

av = pytest.importorskip("av", reason="see requirements-peers.txt")
LAST = 400  # ticks of 1 ms


def test_a_film_has_the_pictures_that_were_asked_for(tmp_path: Path) -> None:
    bag = synthetic(tmp_path / "bag", [True] * LAST, runs=1)
    file = tmp_path / "run.mp4"
    try:
        assert film(bag, file, begin=0.1, end=0.3, rate=20.0, size=(640, 360)) == 0
    except Refusal as no:
        if "without a screen" in str(no):
            pytest.skip(str(no))
        raise
    with av.open(str(file)) as container:
        (stream,) = container.streams.video
        pictures = [one.to_ndarray(format="rgb24") for one in container.decode(stream)]
        assert stream.average_rate == 20
    assert len(pictures) == 5 and pictures[0].shape == (360, 640, 3)
    assert np.any(pictures[0] != pictures[-1]), "something moves"
    with pytest.raises(Refusal, match="must be new"):
        film(bag, file)


def test_other_kinds_sizes_and_times_are_refused(tmp_path: Path) -> None:
    bag = synthetic(tmp_path / "bag", [True] * 20, runs=1)
    with pytest.raises(Refusal, match="end in a known kind"):
        check_film("film", tmp_path / "run.avi")
    for words, rule in (
        ({"begin": 0.01, "end": 0.5}, "within 0 to 0.02"), ({"rate": 0.0}, "--rate"),
        ({"size": (641, 360)}, "even numbers"), ({"speed": 1e-9}, "at most 20000"),
    ):  # fmt: skip
        with pytest.raises(Refusal, match=rule):
            film(bag, tmp_path / "run.gif", **words)
