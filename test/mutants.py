"""Show that the tests can fail: apply plausible mistakes one by one, and run the tests named.

    python test/mutants.py             # the tests as they are, then all of mutant_list.py
    python test/mutants.py 12 servo    # number 12, and those of files with "servo" in their path

Each mutant stands in a git worktree of its own at the newest commit. Compiled libraries are cached
by their content, so a mutant of the core shares none with the sources. The exit status is 1 if a
mutant survives.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue

from mutant_list import MUTANTS, Mutant

ROOT = Path(__file__).resolve().parents[1]
LINKED = (".venv", "install")  # which git does not know
LONGEST = 300  # s of one test
CAUGHT, SURVIVED = "caught", "survived"
VERDICTS = {0: SURVIVED, 1: CAUGHT}  # by the exit status of pytest; others: the tests did not run
REFUSED = re.compile(r"compiler \S+ must compile")  # such a mutant shows nothing


def git(*words: str) -> None:
    """Run git in the repository."""
    subprocess.run(["git", "-C", str(ROOT), *words], check=True, stdout=subprocess.DEVNULL)


@contextmanager
def worktree(folder: Path) -> Iterator[Path]:
    """Yield a worktree of the newest commit, and remove it at the end."""
    git("worktree", "add", "--quiet", "--detach", str(folder), "HEAD")
    try:
        for name in LINKED:
            if (ROOT / name).exists():
                (folder / name).symlink_to((ROOT / name).resolve())
        yield folder
    finally:
        git("worktree", "remove", "--force", str(folder))


def pytest(folder: Path, tests: Sequence[str]) -> tuple[int, str]:
    """Run tests of a worktree; return the exit status of pytest, and what it printed."""
    words = ["-q", "-x", "-n0", "-o", f"timeout={LONGEST}", "-p", "no:cacheprovider"]
    files = [f"test/{test}" for test in tests]
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    with subprocess.Popen(
        [sys.executable, "-m", "pytest", *words, *files],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        printed = process.communicate()[0]
    with suppress(ProcessLookupError):  # what a test that failed has left
        os.killpg(process.pid, signal.SIGKILL)
    return process.returncode, printed


def judge(folder: Path, mutant: Mutant) -> tuple[str, str]:
    """Return the verdict on a mutant in a worktree, and the test that failed."""
    file = folder / mutant.file
    source = file.read_text() if file.exists() else ""
    if source.count(mutant.old) != 1:
        return "stale", f"its old text is {source.count(mutant.old)} times in the file"
    file.write_text(source.replace(mutant.old, mutant.new))
    try:
        status, printed = pytest(folder, mutant.tests.split())
    finally:
        file.write_text(source)
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", printed, re.M)
    if status not in VERDICTS or REFUSED.search(printed):
        return "unsound", printed[-2000:]
    return VERDICTS[status], ", ".join(failed)


def chosen(words: Sequence[str]) -> list[int]:
    """Return the numbers of the mutants that arguments name; all without arguments."""
    return [
        number
        for number, mutant in enumerate(MUTANTS)
        if not words
        or any(
            word == str(number) or (not word.isdigit() and word in mutant.file) for word in words
        )
    ]


def main() -> int:
    """Run the mutants that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "which", nargs="*", help="numbers of mutants, or parts of their files' paths"
    )
    parser.add_argument("--jobs", type=int, default=1, help="mutants at a time")
    parser.add_argument(
        "--at-once", action="store_true", help="without the tests as they are first"
    )
    options = parser.parse_args()
    numbers = chosen(options.which)
    free: SimpleQueue[Path] = SimpleQueue()
    counts: Counter[str] = Counter()

    def run(number: int) -> None:
        folder, mutant, began = free.get(), MUTANTS[number], time.monotonic()
        verdict, words = judge(folder, mutant)
        free.put(folder)
        counts[verdict] += 1
        took = time.monotonic() - began
        print(f"{number:3} {verdict:8} {took:4.0f} s {mutant.file}: {words}", flush=True)

    with ExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mutants_")))
        for job in range(options.jobs):
            free.put(stack.enter_context(worktree(place / str(job))))
        if not options.at_once:
            tests = sorted({test for number in numbers for test in MUTANTS[number].tests.split()})
            status, printed = pytest(place / "0", tests)
            if status:
                raise SystemExit(f"the tests fail without a mutant:\n{printed[-4000:]}")
        with ThreadPoolExecutor(options.jobs) as pool:
            list(pool.map(run, numbers))
    print(", ".join(f"{count} {verdict}" for verdict, count in sorted(counts.items())))
    return 0 if set(counts) <= {CAUGHT} else 1


if __name__ == "__main__":
    sys.exit(main())
