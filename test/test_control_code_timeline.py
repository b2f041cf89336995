"""Control code in C in a timeline: any tick of its past and its forks, to the last bit."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from own_firmware import SCENE, builder, code, random_table
from visits import random_visits

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.firmware import Firmware
from arm_emulator.runs.table_run import TableRun, load_table_run
from arm_emulator.runs.timeline import Timeline


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    return builder(tmp_path_factory.mktemp("built"))


@pytest.mark.parametrize("kind", ["library", "our servo"])
def test_any_tick_of_a_table_run_can_be_visited(
    kind: str, build: Callable[..., Path], tmp_path: Path
) -> None:
    rng = np.random.default_rng(31)
    random_table(rng, tmp_path / "table.csv", 20)
    # Two libraries of one file would share their variables.
    number = itertools.count()

    def fresh() -> TableRun:
        library = None
        if kind == "library":
            library = tmp_path / f"mine_{next(number)}.so"
            shutil.copy(build(), library)
        return load_table_run("three_axis", tmp_path / "table.csv", library)[0]

    random_visits(fresh, rng)


def test_a_library_that_remembers_elsewhere_has_no_timeline(build: Callable[..., Path]) -> None:
    pure = "static double sum; sum += sin(in->time); out->joint[0].value = sum;"
    Timeline(TableRun(SCENE, None, Firmware(build(f"#include <math.h>\n{code(pure)}"))))
    for step, named in (
        ("static int* p; if (!p) p = calloc(1, 4); out->joint[0].value = ++*p;", "calloc"),
        ("out->joint[0].value = rand() % 2;", "rand"),
        ("static __thread int k; out->joint[0].value = ++k;", "variables of threads"),
    ):
        run = TableRun(SCENE, None, Firmware(build(f"#include <stdlib.h>\n{code(step)}")))
        run.advance(2)
        with pytest.raises(Refusal, match=rf"nothing but its variables.*{named}"):
            Timeline(run)


def test_only_states_that_the_same_run_has_saved_are_restored(tmp_path: Path) -> None:
    random_table(np.random.default_rng(3), tmp_path / "table.csv")
    first, second = (
        load_table_run("three_axis", tmp_path / "table.csv", None)[0] for _ in range(2)
    )
    with pytest.raises(Refusal, match="of the same run"):
        first.restore(second.save())
