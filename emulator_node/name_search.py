"""Search for names by a regular expression of a client, which may take any time."""

import json
import re
import signal
import subprocess
import sys
from collections.abc import Sequence

from arm_emulator.base.refusal import Refusal

LONGEST = 1  # s of processor time
_PLAIN = re.compile(r"[\w /-]*")
# In a process of its own: nothing else ends a search of Python, and it holds Python's lock.
_SEARCH = f"""
import json, re, resource, sys
resource.setrlimit(resource.RLIMIT_CPU, ({LONGEST}, {LONGEST}))
expression, names = json.load(sys.stdin)
json.dump([name for name in names if re.search(expression, name)], sys.stdout)
"""


def search_names(expression: str, names: Sequence[str]) -> list[str]:
    """Return the names in which an expression of Python's `re` is found.

    Raises:
        Refusal: it is not valid, or takes longer than `LONGEST`.
    """
    if _PLAIN.fullmatch(expression):
        return [name for name in names if expression in name]
    try:
        re.compile(expression)
    except (re.error, OverflowError, RecursionError) as error:
        raise _refuse_filter("be a regular expression", f"{expression!r}: {error}") from None
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", _SEARCH],
        input=json.dumps([expression, [*names]]), capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise _refuse_filter(f"be found or not within {LONGEST} s", repr(expression))
    done.check_returncode()
    return [str(name) for name in json.loads(done.stdout)]


def _refuse_filter(rule: str, actual: str) -> Refusal:
    return Refusal("filters", "filter", rule, actual)
