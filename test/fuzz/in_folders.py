"""Cases one after the other, each in a folder of its own that is removed after it."""

import itertools
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

from fuzz.line import FAILED, REFUSED, TAKEN, report


def run(name: str, case: Callable[[int, int, Path], str]) -> None:
    """Report each case before and after it; seed, first case and step are the program's arguments.

    Args:
        name: of what is tried.
        case: returns the line that refuses case `number` of a seed, an empty one if it is taken.
    """
    seed, first, step = map(int, sys.argv[1:])
    scratch = Path(tempfile.mkdtemp(prefix=f"fuzz-{name}-"))
    try:
        for number in itertools.count(first, step):
            folder = scratch / str(number)
            report(begin=number)
            try:
                line = case(seed, number, folder)
            except Exception:  # whatever it is, it is what is looked for
                report(outcome=FAILED, count=1, what=traceback.format_exc(limit=-4))
            else:
                report(outcome=REFUSED if line else TAKEN, count=1)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
