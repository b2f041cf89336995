"""Full disks, closed outputs and little memory end a command with a line and a true exit code.

A small file system of its own stands for a full disk, where the system lets us mount one;
`/dev/full` takes nothing anywhere.
"""

import contextlib
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from draws import some, with_slow
from machines import own_three_axis

ROOM = 400_000  # bytes of the full disk
RUN = ["run", "three_axis", "--seconds", "0.05"]


def ended(
    words: list[str], shell: str = "", folder: Path | None = None, **more: str
) -> tuple[int, str, str]:
    """Run a command with what a shell does to its files; return code, output and errors."""
    line = f'exec "$@" {shell}'
    command = ["sh", "-c", line, "sh", sys.executable, "-m", "arm_emulator", *words]
    done = subprocess.run(
        command, cwd=folder, env=os.environ | more, capture_output=True, timeout=300, check=False
    )
    return done.returncode, done.stdout.decode(), done.stderr.decode()


@pytest.fixture(scope="module", autouse=True)
def compiled(tmp_path_factory: pytest.TempPathFactory) -> None:
    """All libraries of the commands are compiled, which a first use states in a line of its own.

    The tests count lines.
    """
    code, _, errors = ended([*RUN, "--record", "a.mcap"], "", tmp_path_factory.mktemp("compiled"))
    assert code == 0, errors


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    if os.geteuid() or shutil.which("mount") is None:
        pytest.skip("a file system can be mounted by root alone")
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={ROOM}", "tmpfs", str(folder)]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("this system lets us mount nothing")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize(
    ("words", "shell", "code", "line"),
    [
        (RUN, "> /dev/full", 2, "stdout must accept all that is written, got No space left"),
        (["cache", "--json"], "> /dev/full", 2, "stdout must accept all that is written"),
        (["--help"], "> /dev/full", 2, "stdout must accept all that is written"),
        pytest.param(
            ["udp", "--header"],
            "> /dev/full",
            2,
            "stdout must accept all that is written",
            marks=pytest.mark.slow,
        ),
        pytest.param(RUN, ">&-", 2, "stdout must be open", marks=pytest.mark.slow),
        (["cache", "--json"], ">&-", 2, "stdout must be open"),
        pytest.param(RUN, "2>&-", 0, "", marks=pytest.mark.slow),
        (["run", "nowhere"], "2>&-", 2, ""),
        pytest.param(["run", "nowhere"], "2> /dev/full", 2, "", marks=pytest.mark.slow),
        pytest.param(["run", "nowhere"], ">&- 2>&-", 2, "", marks=pytest.mark.slow),
        pytest.param(RUN, "<&-", 0, "", marks=pytest.mark.slow),
        (["servo-header", "--out", "/dev/full"], "", 2, "file /dev/full must be writable"),
    ],
)
def test_outputs_that_take_nothing(words: list[str], shell: str, code: int, line: str) -> None:
    result, _, errors = ended(words, shell)
    assert result == code, errors
    assert errors.count("\n") == bool(line) and line in errors, errors


@pytest.mark.slow
def test_names_are_printed_where_the_terminal_has_ascii_alone(tmp_path: Path) -> None:
    file = own_three_axis(tmp_path, "").rename(tmp_path / "Gelenkarm é 関節.yaml")
    for more in ([], ["--json"]):
        words = ["check-scene", file.name, *more]
        code, printed, errors = ended(words, "", tmp_path, PYTHONIOENCODING="ascii")
        assert code == 0 and "Traceback" not in errors, errors
        assert "Gelenkarm \\xe9 \\u95a2\\u7bc0" in printed or "Gelenkarm \\u00e9" in printed


RECORDS = (
    ["--record", "disk/a.mcap", "--seconds", "20"],
    ["--record", "disk/a.parquet", "--seconds", "20"],
    ["--rerun", "disk/a.rrd", "--seconds", "60"],
    ["--bag", "disk/bag", "--seconds", "3"],
)
# At first each kind of file once, on either disk in turns.
ON_DISKS = [
    *zip(RECORDS, (0, ROOM // 2) * 2, strict=True),
    *zip(RECORDS, (ROOM // 2, 0) * 2, strict=True),
]


@pytest.mark.slow
@pytest.mark.parametrize(("words", "left"), with_slow(ON_DISKS, 2))
def test_a_record_on_a_full_disk(words: list[str], left: int, disk: Path) -> None:
    """The run ends, whether the disk is full before or on the way, and no process stays."""
    with contextlib.suppress(OSError):
        (disk / "fill").write_bytes(bytes(2 * ROOM if not left else ROOM - left))
    code, _, errors = ended(["run", "three_axis", *words], "", disk.parent)
    assert code == 2 and errors.count("\n") == 1, errors
    assert " must " in errors and "No space left on device" in errors, errors


@pytest.mark.slow
def test_a_campaign_on_a_full_disk(disk: Path, tmp_path: Path) -> None:
    (tmp_path / "drop.yaml").write_text(
        "scene: three_axis\nset: {payload: 1.0}\nscenario: {seconds: 0.01}\ncount: 20000\n"
        "vary:\n  payload.mass: normal(1, 0.1)\n"
        "  joints.*.friction.viscous: nominal * lognormal(1, 0.3)\n"
        "requirements:\n  calm: always abs(v.elbow) <= 0.5\n"
    )
    (disk / "fill").write_bytes(bytes(ROOM - 20_000))
    words = ["campaign", "drop.yaml", "--into", "disk/out", "--workers", "1"]
    code, _, errors = ended(words, "", tmp_path)
    assert code == 2, errors
    assert "Traceback" not in errors and "No space left on device" in errors, errors


SIZES = (400, 80, 60, 100, 160, 200, 240, 280, 320, 360, 450, 500)  # MB


@pytest.mark.parametrize("size", with_slow(some(SIZES, 3), 1))
def test_little_memory_is_a_line(size: int) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (size * 10**6,) * 2)

    done = subprocess.run(
        [sys.executable, "-m", "arm_emulator", "check-scene", "three_axis"],
        preexec_fn=limit, capture_output=True, text=True, timeout=120.0, check=False,
    )  # fmt: skip
    printed = done.stderr.splitlines()
    assert done.returncode in (0, 1, 2) and len(printed) == bool(done.returncode), done.stderr
    if done.returncode == 2:
        assert printed[0].startswith("arm_emulator: memory must suffice, got "), printed
