"""Reports of the fuzzer's parts to the process that runs them: one JSON object per line."""

import json
from typing import Any

# Counters that a line may change.
TAKEN, REFUSED, FAILED = "taken", "refused", "failed"


def report(**words: Any) -> None:
    """Print one line: `begin` with the case, or `outcome` with `count`, and what else there is."""
    print(json.dumps(words), flush=True)
