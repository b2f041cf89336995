"""Every compiler, level and kind of processor computes the same bits.

With FULL=1 these are the first of the digests by all builds; with WHOLE=1, too, all of them.
"""

import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from draws import some
from portable_bits import STORED
from test_compilers import compilers

from arm_emulator.toolchain.targets import PORTABLE_TARGETS

KINDS = [*compilers("clang++"), *compilers("g++")]
TARGETS = ("native", *PORTABLE_TARGETS)
# Two builds that differ in everything come first.
BUILDS = [
    ("g++", "x86-64-v2", "-O3"),
    (KINDS[0], "native", "-O1"),
    *itertools.product(KINDS, TARGETS, ("-O3", "-O1")),
]


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="targets of other processors")
@pytest.mark.parametrize(("compiler", "target", "level"), some(BUILDS, 2))
def test_builds_compute_the_same_bits(
    compiler: str, target: str, level: str, tmp_path: Path
) -> None:
    root = Path(__file__).parents[3]
    places = [str(root), str(root / "packages" / "arm_emulator_fleet")]
    done = subprocess.run(
        [sys.executable, root / "test" / "portable_bits.py", target, level],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ
        | {
            "CXX": compiler,
            "ARM_EMULATOR_CACHE": str(tmp_path),
            "PYTHONPATH": os.pathsep.join(places),
        }
        # The short run of a build takes a minute, the whole one half an hour.
        | {"FULL": os.environ.get("WHOLE", "")},
    )
    assert done.returncode == 0, done.stderr
    digests, stored = json.loads(done.stdout), json.loads(STORED.read_text())
    assert digests == {name: stored[name] for name in digests}, f"{compiler} {target} {level}"
