"""Tables of targets: held from row to row, and spoiled ones."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from own_firmware import NAMES, SCENE, N, builder, code, random_table, row_at

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.firmware import Firmware
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import load_target_table


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    return builder(tmp_path_factory.mktemp("built"))


def test_targets_hold_from_their_row_to_the_next(
    build: Callable[..., Path], tmp_path: Path
) -> None:
    """A library that gives its targets as voltages, against the rows by hand."""
    library = build(
        code("for (int j = 0; j < 3; ++j) out->joint[j].value = in->q_target[j] * in->new_targets;")
    )
    rng = np.random.default_rng(15)
    for _ in range(5):
        rows = random_table(rng, tmp_path / "table.csv")
        late = float(rng.integers(0, 4)) / 1000  # before the first row: where the arm starts
        table = load_target_table(tmp_path / "table.csv", NAMES)
        table = type(table)(table.t + late, table.q)
        rows = [[-1.0, *SCENE.start], *([t + late, *q] for t, *q in rows)]
        run = TableRun(SCENE, table, Firmware(library))
        for tick in range(50):
            run.advance(1)
            np.testing.assert_array_equal(
                run.session.measured.applied, row_at(rows, tick), err_msg=f"targets of tick {tick}"
            )


GOOD = "t,waist,shoulder,elbow\n0,0.1,0.2,0.3\n0.5,0.1,0.2,0.3\n"


BAD_TABLES = {
    "": "columns must be t and every joint of the scene once, got none",
    "\n\n": "columns must be t",
    "t,waist,shoulder\n0,0,0\n": "every joint of the scene once, got t, waist, shoulder; valid",
    "t,waist,shoulder,elbow,elbow\n0,0,0,0,0\n": "columns must be t",
    "t,waist,shoulder,knee\n0,0,0,0\n": "got t, waist, shoulder, knee; valid: t, waist",
    "waist,shoulder,elbow\n0,0,0\n": "columns must be t",
    "0,0.1,0.2,0.3\n": "columns must be t",
    "t,waist,shoulder,elbow\n": "table must have a row of targets, got none",
    GOOD + "1.0,0.1,0.2\n": "line 4 must have 4 values, as the columns, got 3",
    GOOD + "1.0,0.1,0.2,0.3,0.4\n": "line 4 must have 4 values, as the columns, got 5",
    GOOD + "1.0,0.1,,0.3\n": "line 4, shoulder must be a number [rad or m], got nothing",
    GOOD + ",0.1,0.2,0.3\n": "line 4, t must be a number [s], got nothing",
    GOOD + "1.0,0.1,nan,0.3\n": "line 4, shoulder must be a number [rad or m], got nan",
    GOOD + "1.0,0.1,0.2,-inf\n": "line 4, elbow must be a number",
    GOOD + "1.0,0.1,0.2,1e400\n": "line 4, elbow must be a number",
    GOOD + "1.0,0.1,0.2,three\n": "line 4, elbow must be a number [rad or m], got three",
    GOOD + "1.0,0.1,0.2,1_0\n": "line 4, elbow must be a number",
    GOOD + "1.0,0.1,0.2,2e6\n": "line 4, elbow must be within +-1e+06 rad or m, got 2000000.0",
    GOOD + "0.5,0.1,0.2,0.3\n": "line 4, t must be later than the previous row's, 0.5 s",
    GOOD + "0.4,0.1,0.2,0.3\n": "line 4, t must be later than the previous row's, 0.5 s",
    GOOD + "nan,0.1,0.2,0.3\n": "line 4, t must be a number [s], got nan",
    GOOD + "1e12,0.1,0.2,0.3\n": "line 4, t must be from 0 to 1e+09 s",
    "t,waist,shoulder,elbow\n-1,0,0,0\n": "line 2, t must be from 0 to 1e+09 s, got -1.0",
    GOOD + '1.0,"0.1,0.2,0.3\n': "must be well-formed CSV",
    "t;waist;shoulder;elbow\n0;0,1;0,2;0,3\n": "must separate columns by commas, got semicolons",
    "t\twaist\tshoulder\telbow\n0\t1\t2\t3\n": "must separate columns by commas, got tabs",
    "\udcff\udcfe": "file must be text in UTF-8",
    "\0": "table.csv: ",
}


@pytest.mark.parametrize("text", BAD_TABLES)
def test_files_without_a_table_are_refused_in_a_line(text: str, tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(Refusal) as refusal:
        load_target_table(file, NAMES)
    assert BAD_TABLES[text] in str(refusal.value) and str(refusal.value).startswith("table.csv: ")
    assert len(str(refusal.value).splitlines()) == 1, f"one line, got {refusal.value}"


def test_tables_that_are_spoiled_at_random_are_taken_in_full_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(16)
    taken, file = 0, tmp_path / "table.csv"
    for _ in range(200):
        random_table(rng, file)
        body = bytearray(file.read_bytes())
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(body)))
            match int(rng.integers(3)):
                case 0:
                    body[at] = int(rng.choice(list(b'0123456789.,-e\n\r"nt \xff\0')))
                case 1:
                    del body[at : at + int(rng.integers(1, 9))]
                case _:
                    body[at:at] = body[: int(rng.integers(1, 30))]
        file.write_bytes(bytes(body))
        try:
            table = load_target_table(file, NAMES)
        except Refusal as refusal:
            assert len(str(refusal).splitlines()) == 1, f"one line, got {refusal}"
            continue
        taken += 1
        assert np.isfinite(table.q).all() and (np.diff(table.t) > 0.0).all(), body
        assert table.q.shape == (len(table.t), N), body
    assert 0 < taken < 200, f"{taken} taken: the draws are one-sided"
