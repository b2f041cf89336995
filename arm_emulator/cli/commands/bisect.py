"""Find the first difference of two recorded runs, or of a run and the present code."""

from __future__ import annotations

import dataclasses
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.bags.first_difference import FirstDifference, Side, first_difference
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Commit, RunNumber, SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.build_facts import other_builds


@command(
    keys=(
        "`sides`, `equal_ticks`, `difference` (null if they are equal), `builds` (sentences on "
        "how builds differ); with the options good and bad `commit`, `title`"
    ),
)
def bisect(
    bag: Path,
    other: Path | None = None,
    /,
    *,
    scene: SceneName | None = None,
    other_scene: SceneName | None = None,
    run: RunNumber = -1,
    other_run: RunNumber = -1,
    good: Commit = None,
    bad: Commit = None,
) -> int:
    """Find the first tick and bit in which two runs differ, and the step that leads there.

    Args:
        bag: folder of a bag.
        other: folder of another bag (default: the machine, driven again by the first one).
        scene: scene file or name of the bag (default: the one that the bag names).
        other_scene: likewise of the other run (default: that of the first).
        run: which run of the bag, from 1 on (default: the last).
        other_run: likewise of the other bag.
        good: a commit of the emulator that repeats the bag, to find the first that does not.
        bad: a commit that does not; with --good.
    """
    if (good is None) != (bad is None):
        raise Refusal("bisect", "--good and --bad", "be given both", "one")
    if good is not None and bad is not None:
        if other is not None:
            raise Refusal("bisect", "the other bag", "be left out with commits", str(other))
        commit, title = first_bad_commit(bag, scene, good, bad)
        output.line(f"the first commit that does not repeat it: {commit[:12]} {title}")
        output.facts({"commit": commit, "title": title})
        return 1
    one = Side.of(bag, scene, run)
    if other is None:
        two = dataclasses.replace(Side.of(bag, other_scene or scene, run), again=True)
    else:
        two = Side.of(other, other_scene or scene, other_run)
    names = (bag.name, "driven again" if other is None else other.name)
    found, equal = first_difference(one, two)
    builds = other_builds(names, one.build, two.build)
    facts = {"sides": names, "equal_ticks": equal, "difference": _facts(found), "builds": builds}
    output.facts(facts)
    for sentence in builds:
        output.line(f"other builds: {sentence}")
    if found is None:
        output.line(f"equal to the last bit in what both have recorded: {equal} ticks")
        return 0
    t = found.tick * one.scene.servo_period
    output.line(f"first difference: tick {found.tick}, {t:g} s, after {equal} equal ticks")
    owner = f"{found.owner}, " if found.owner else ""
    output.line(f"{found.kind}: {owner}{found.quantity}{_distance(found)}")
    for name, value in zip(names, found.values, strict=True):
        output.line(f"  {name}: {value!r}")
    for name, rows in zip(names, found.inputs, strict=True):
        if rows:
            output.line(f"the step that leads there, {name}:")
            for quantity, row in rows.items():
                numbers = "  ".join(repr(float(one)) for one in row)
                output.line(f"  {quantity:12} {numbers}")
    return 1


def _distance(found: FirstDifference) -> str:
    if found.ulps is None:
        return ""
    return f", {found.ulps} representable number{'s' if found.ulps > 1 else ''} apart"


def _facts(found: FirstDifference | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "tick": found.tick,
        "kind": found.kind,
        "quantity": found.quantity,
        "owner": found.owner,
        "values": [one if isinstance(one, int | float | str) else str(one) for one in found.values],
        "ulps": found.ulps,
        "inputs": [{name: np.asarray(row) for name, row in side.items()} for side in found.inputs],
    }


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
