"""Random mixtures of the parts of drives, and the claims that hold of them.

    python -m bench.mixtures --count 300           order, energy and lanes of all parts
    python -m bench.mixtures --count 300 --alone   each law of friction alone, by smooth equations

The claims and the truth stand in oracles/mixtures.py and oracles/alone.py.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from arm_emulator.build.library_cache import CACHE_VARIABLE
from bench.measure import progress
from oracles import alone, mixtures

Verdict = mixtures.Verdict | alone.Verdict


def main(arguments: list[str] | None = None) -> int:
    """Judge mixtures and print the results; exit code 1 if a claim is broken."""
    parser = argparse.ArgumentParser(prog="bench.mixtures", description=__doc__)
    parser.add_argument("--alone", action="store_true", help="each law of friction alone")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("out/mixtures.json"))
    options = parser.parse_args(arguments)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.count)
    judge: Callable[[int], Verdict] = alone.judge if options.alone else mixtures.judge
    verdicts: list[Verdict] = []
    with (
        tempfile.TemporaryDirectory() as cache,  # of libraries that nobody needs again
        ProcessPoolExecutor(options.jobs, initializer=_begin, initargs=(cache,)) as pool,
        progress("mixtures", len(seeds)) as done,
    ):
        waiting = {pool.submit(judge, seed): seed for seed in seeds}
        for judged in as_completed(waiting):
            verdicts.append(one := judged.result())
            broken = [name for name, holds in one.claims.items() if not holds]
            if broken:
                Console(stderr=True).print(f"{broken}: {one}")
            options.out.write_text(json.dumps([asdict(one) for one in verdicts], indent=1))
            done(f"seed {waiting[judged]}")
    met: Counter[str] = Counter(part for one in verdicts for part in one.parts)
    print(f"{len(verdicts)} mixtures, of {dict(met)}")
    for name in verdicts[0].claims:
        print(f"{name}: {sum(one.claims[name] for one in verdicts)} of {len(verdicts)}")
    return 0 if all(all(one.claims.values()) for one in verdicts) else 1


def _begin(cache: str) -> None:
    os.environ[CACHE_VARIABLE] = cache
    sys.stderr = open(os.devnull, "w")  # of compilations


if __name__ == "__main__":
    sys.exit(main())
