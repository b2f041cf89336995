"""Claims held against random cases, with a truth that does not share their code.

    python -m bench.claims random_machines --count 500
    python -m bench.claims mixtures --count 300
    python -m bench.claims alone --count 300    each law of friction alone, by smooth equations
    python -m bench.claims advice --count 20

Claims and truths stand in oracles/random_machines.py, oracles/mixtures.py, oracles/alone.py and
packages/arm_emulator_analysis/bench/advice.py.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

from arm_emulator.machine.schemes.known import LOCATING_SCHEMES
from arm_emulator.toolchain.library_cache import CACHE_VARIABLE
from bench import advice
from bench.measure import show_progress
from oracles import alone, mixtures, random_machines

Verdict = Any  # a dataclass; its `claims` state by name which hold

EVALUATORS: dict[str, Callable[[int], Sequence[Verdict]]] = {
    "random_machines": lambda seed: random_machines.judge_machine(seed, LOCATING_SCHEMES),
    "mixtures": lambda seed: [mixtures.judge_mixture(seed)],
    "alone": lambda seed: [alone.judge_mixture(seed)],
    "advice": advice.judge_scene,
}


def main(arguments: list[str] | None = None) -> int:
    """Judge cases and print how many meet each claim; exit code 1 if one is broken."""
    parser = argparse.ArgumentParser(prog="bench.claims", description=__doc__.splitlines()[0])
    parser.add_argument("about", choices=EVALUATORS)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="seed of the first case")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, help="default: out/claims/ABOUT.json")
    args = parser.parse_args(arguments)
    out = args.out or Path("out/claims", f"{args.about}.json")
    out.parent.mkdir(parents=True, exist_ok=True)
    verdicts, broken = list[Verdict](), list[str]()
    with (
        tempfile.TemporaryDirectory() as cache,  # of libraries that nobody needs again
        ProcessPoolExecutor(args.jobs, initializer=_begin_worker, initargs=(cache,)) as pool,
        show_progress(args.about, args.count) as done,
    ):
        seeds = range(args.first, args.first + args.count)
        waiting = {pool.submit(_judge_seed, args.about, seed): seed for seed in seeds}
        try:
            for future in as_completed(waiting):
                if future.exception():
                    broken.append(f"seed {waiting[future]}: {future.exception()!r}")
                else:
                    verdicts += future.result()
                    out.write_text(json.dumps([asdict(each) for each in verdicts], indent=1))
                done(f"seed {waiting[future]}")
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            print(f"ended early, {len(verdicts)} verdicts are made")
    broken += [str(verdict) for verdict in verdicts if not all(verdict.claims.values())]
    claims, true_claims = Counter[str](), Counter[str]()
    for future in verdicts:
        claims.update(future.claims)
        true_claims.update(name for name, holds in future.claims.items() if holds)
    for name, count in sorted(claims.items()):
        print(f"{name}: {true_claims[name]} of {count}")
    print(*broken, f"all verdicts are in {out}", sep="\n")
    return 1 if broken else 0


def _judge_seed(about: str, seed: int) -> Sequence[Verdict]:
    return EVALUATORS[about](seed)


def _begin_worker(cache: str) -> None:
    os.environ[CACHE_VARIABLE] = cache
    # The lines of compilations are not shown; a refusal comes back as an exception. Ctrl-C ends the
    # process that has started this one.
    sys.stderr = open(os.devnull, "w")
    signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    sys.exit(main())
