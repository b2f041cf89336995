"""The first commit of the emulator whose machine does not repeat a bag to the last bit."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from arm_emulator.base.refusal import Refusal

ROOT = Path(__file__).resolve().parents[2]
# `git bisect run` skips a commit at 125: one that refuses the bag or the scene.
_JUDGE = 'python -m arm_emulator check-bag "$@"; code=$?; [ $code -eq 2 ] && exit 125; exit $code'


def first_bad_commit(bag: Path, scene: str | None, good: str, bad: str) -> tuple[str, str]:
    """Return the first commit after `good`, up to `bad`, that does not repeat a bag, and its title.

    The sources of every commit tried are checked out in a temporary folder; messages are those that
    are installed.

    Raises:
        Refusal: the emulator is not a git checkout, there are no such commits, `good` does not
            repeat the bag, `bad` does, or none in between can be judged.
    """
    words = [str(bag.resolve()), *(["--scene", _absolute(scene)] if scene else [])]
    _check_repository()
    # Names such as HEAD mean the repository's, not those of the checkout.
    good, bad = (
        _git(ROOT, "rev-parse", "--verify", f"{one}^{{commit}}").strip() for one in (good, bad)
    )
    with _checkout(bad) as tree:
        for commit, wanted, rule in (
            (good, 0, "repeat the bag"), (bad, 1, "not repeat the bag"),
        ):  # fmt: skip
            _git(tree, "checkout", "--quiet", "--detach", commit)
            code = _judged(tree, words)
            if code != wanted:
                got = {0: "equal bits", 1: "a difference"}.get(code, "a refusal")
                raise Refusal("bisect", f"commit {commit[:12]}", rule, got)
        _git(tree, "bisect", "start", bad, good)
        try:
            done = subprocess.run(
                ["git", "bisect", "run", "sh", "-c", _JUDGE, "sh", *words],
                cwd=tree, env=_environment(tree), capture_output=True, text=True, check=False,
            )  # fmt: skip
        finally:
            _git(tree, "bisect", "reset")
        found = re.search(r"^([0-9a-f]{7,40}) is the first bad commit", done.stdout, re.MULTILINE)
        if found is None:
            rule = "have one that can be judged"
            raise Refusal("bisect", f"commits {good}..{bad}", rule, "none, or too many that refuse")
        return found[1], _git(tree, "log", "-1", "--format=%s", found[1]).strip()


def _absolute(scene: str) -> str:
    return str(Path(scene).resolve()) if Path(scene).is_file() else scene


def _check_repository() -> None:
    if not (ROOT / ".git").exists():
        raise Refusal("bisect", "the emulator", "be a git checkout", str(ROOT))


@contextmanager
def _checkout(commit: str) -> Iterator[Path]:
    """Yield a temporary checkout."""
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        _git(ROOT, "worktree", "add", "--quiet", "--detach", str(tree), commit)
        try:
            yield tree
        finally:
            _git(ROOT, "worktree", "remove", "--force", str(tree))


def _git(tree: Path, *words: str) -> str:
    done = subprocess.run(["git", *words], cwd=tree, capture_output=True, text=True, check=False)
    if done.returncode:
        got = (done.stderr.strip().splitlines() or ["a failure"])[-1]
        raise Refusal("bisect", f"git {words[0]}", "succeed", got)
    return done.stdout


def _environment(tree: Path) -> dict[str, str]:
    paths = [str(tree), os.environ.get("PYTHONPATH", "")]
    folder = str(Path(sys.executable).parent)
    return os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "PATH": os.pathsep.join((folder, os.environ.get("PATH", ""))),
    }


def _judged(tree: Path, words: list[str]) -> int:
    command = ["python", "-m", "arm_emulator", "check-bag", *words]
    done = subprocess.run(
        command, cwd=tree, env=_environment(tree), capture_output=True, check=False
    )
    return done.returncode
