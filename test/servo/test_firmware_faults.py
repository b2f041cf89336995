"""Libraries that cannot be run, end the process, or do not return."""

import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import numpy as np
import pytest
from draws import some
from own_firmware import NO_TABLE, builder, code, command

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.firmware import Firmware, RunningCode
from arm_emulator.runs import guarded
from arm_emulator.toolchain.c_header import CData


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    return builder(tmp_path_factory.mktemp("built"))


STEP = "out->joint[1].value = in->measured->tick"


BAD_LIBRARIES: dict[str, tuple[str | bytes | None, str]] = {
    "missing": (None, "mine.so: file must be readable, got no such file"),
    "text": (
        b"int main;",
        "file must be a shared library with arm_firmware, got it is not a 64-bit",
    ),
    "empty": (b"", "got it is empty"),
    "entry": ("int other(void);\nint other(void) { return 1; }\n", "got it lacks arm_firmware"),
    "null": (
        '#include "firmware.h"\nconst firmware* arm_firmware(void) { return 0; }\n',
        "arm_firmware must return the library's functions, got a null pointer",
    ),
    "version": (code("", version="7"), "version must be 1, that of firmware.h, got 7"),
    "no step": (
        '#include "firmware.h"\nconst firmware* arm_firmware(void) {'
        " static const firmware mine = {1, 0, 0, 0}; return &mine; }\n",
        "step must be a function, got a null pointer",
    ),
    "declines": (
        '#include "firmware.h"\nstatic const char* no(const firmware_machine* m) '
        '{ return m->joints == 3 ? "made for\\nfive joints" : 0; }\n' + code("", "no"),
        "start must take scene three_axis, got made for five joints",
    ),
    "nan": (
        code(f"{STEP} == 7 ? 0.0 / ((double)in->time - 7e6) : 0.0;"),
        "tick 7: command of shoulder must be finite, got",
    ),
    "inf": (code(f"{STEP} == 2 ? 1e308 * (double)in->time : 0.0;"), "tick 2: command of shoulder"),
    "mode": (code("out->joint[2].mode = 99;"), "tick 0: mode of elbow must be one that the drive"),
    "lacking": (
        "extern int nowhere(int);\n" + code("out->joint[0].value = nowhere(1);"),
        "file must be loaded by the system, got ",
    ),
}


@pytest.mark.parametrize("kind", BAD_LIBRARIES)
def test_a_library_that_cannot_be_run_is_refused_in_a_line(
    kind: str,
    build: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    compiled, words = BAD_LIBRARIES[kind]
    library, table = tmp_path / "mine.so", tmp_path / "table.csv"
    table.write_text(NO_TABLE)
    if isinstance(compiled, bytes):
        library.write_bytes(compiled)
    elif compiled is not None:
        shutil.copy(build(compiled), library)
    arguments = ("run", "three_axis", "--servo", library, "--targets", table)
    exit_code, out, printed = command(monkeypatch, capfd, *arguments)
    assert (exit_code, out) == (2, ""), printed
    assert printed.startswith("mine.so") and words in printed and printed.count("\n") == 1, printed


# Ways in which a library ends the process, and what is reported of it.
ENDS = {
    "exit(0);": "exit with code 0",
    "exit(3);": "exit with code 3",
    "_exit(0);": "exit with code 0",
    "quick_exit(0);": "exit with code 0",
    "abort();": "SIGABRT",
    "*(volatile int*)8 = 1;": "SIGSEGV",
    "raise(SIGFPE);": "SIGFPE",
    "__builtin_trap();": "SIG(ILL|TRAP)",
    "raise(SIGKILL);": "SIGKILL",
    "deeper(1);": "SIGSEGV",
    "pthread_exit(0);": "exit with code 0",
    'execl("/bin/true", "true", (char*)0);': "exit with code 0",
}


HEADERS = """
#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <unistd.h>
static volatile int sum;
static void deeper(int k) {
  volatile char room[4096];
  room[0] = (char)k, deeper(k + room[0]), sum = room[0];
}
static void end(void) { (void)deeper; END }
"""


PLACES = {
    "loading": ("__attribute__((constructor)) static void go(void) { end(); }\n", ""),
    "arm_firmware": ("", ""),
    "start": ("static const char* go(const firmware_machine* m) { (void)m; end(); return 0; }", ""),
    "step": ("", "if (in->measured->tick == TICK) end();"),
    "end": ("__attribute__((destructor)) static void go(void) { end(); }\n", ""),
    "atexit": ("", "if (in->measured->tick == 0) atexit(end);"),
}


# In a process without ROS: exit() waits for threads of its middleware, which a fork leaves behind.
RUNS = """
import sys
from arm_emulator.cli.command_line import main
table, *libraries = sys.argv[1:]
for library in libraries:
    sys.argv = ["", "run", "three_axis", "--servo", library, "--targets", table]
    try:
        main()
    except SystemExit as end:
        print("exit code", end.code, flush=True)
"""


@pytest.mark.slow
def test_a_library_that_ends_the_process_is_reported_with_its_tick(
    build: Callable[..., Path], tmp_path: Path
) -> None:
    """One line, and an exit code that is not 0; at a tick, and (in full) wherever its code runs."""
    (tmp_path / "table.csv").write_text(NO_TABLE)
    cases = [
        (place, how, tick)
        for place in some(["step", *PLACES], 1)
        for tick, how in enumerate(ENDS, random.Random(place).randrange(1800))
        # An end of the process in its usual place is harmless.
        if place not in ("end", "atexit") or "0" not in ENDS[how]
    ]
    libraries = []
    for place, how, tick in cases:
        before, body = PLACES[place]
        text = '#include "firmware.h"\n' + HEADERS.replace("END", how) + before
        compiled = code(body.replace("TICK", str(tick)), "go" if place == "start" else "0")
        if place == "arm_firmware":
            compiled = compiled.replace("  static const", "  end();\n  static const")
        libraries.append(build(text + compiled, "-w", "-D_GNU_SOURCE"))
    words = [sys.executable, "-c", RUNS, tmp_path / "table.csv", *libraries]
    done = subprocess.run(
        list(map(str, words)),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300, check=True,
    )  # fmt: skip
    reported = re.split(r"exit code (.*)\n", done.stdout)
    for (place, how, tick), printed, exit_code in zip(
        cases, reported[::2], reported[1::2], strict=False
    ):
        where = {
            "step": f", tick {tick}: step must return",
            "loading": ": file must be loaded by the system",
            "end": ": what runs at its end must return",
            "atexit": ": what runs at its end must return",
        }.get(place, f": {place} must return")
        line = rf"mine_\d+\.so{where}, got {ENDS[how]}\n"
        last = printed.splitlines(keepends=True)[-1]
        assert re.fullmatch(line, last) and exit_code == "2", (place, exit_code, printed)
        assert printed == last or place in ("end", "atexit"), printed
    assert len(reported) == 2 * len(cases) + 1, "every run has ended"


def test_a_library_that_does_not_return_is_reported_and_ends_with_ctrl_c(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(guarded, "LOOK", 0.05)
    monkeypatch.setattr(guarded, "REPORT_STALL", 0.1)

    def work(progress: CData) -> int:
        progress.doing, progress.controller.tick = RunningCode.STEP, 12
        while True:
            time.sleep(1.0)

    def printing(words: str, file: TextIO) -> None:
        print(words, file=file)
        if "has not returned" in words:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(guarded, "print", printing, raising=False)
    with pytest.raises(KeyboardInterrupt):
        guarded.run_guarded("mine.so", work)
    printed = capfd.readouterr().err
    assert printed == (
        "mine.so, tick 12: step has not returned for 0.1 s; Ctrl-C ends it\n"
        "mine.so, tick 12: ended by a signal\n"
    )


def test_a_library_cut_short_is_refused(build: Callable[..., Path], tmp_path: Path) -> None:
    rng, body = np.random.default_rng(17), build().read_bytes()
    for _ in range(20):
        (tmp_path / "mine.so").write_bytes(body[: int(rng.integers(len(body) - 100))])
        with pytest.raises(Refusal, match=r"^mine.so: file must be a shared library"):
            Firmware(tmp_path / "mine.so")
