"""Random mixtures of all parts of a drive: order, energy and lanes.

    python -m bench.mixtures --count 300

The claims and the truth stand in oracles/mixtures.py.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from rich.console import Console

from bench.measure import progress
from oracles.mixtures import PERIOD, Verdict, judge


def main(arguments: list[str] | None = None) -> int:
    """Judge mixtures and print what came out."""
    parser = argparse.ArgumentParser(prog="bench.mixtures", description=__doc__)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/mixtures.json"))
    options = parser.parse_args(arguments)
    verdicts: list[Verdict] = []
    console = Console(stderr=True)
    seeds = range(options.first, options.first + options.count)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with progress("mixtures", len(seeds)) as step:
        for seed in seeds:
            verdicts.append(one := judge(seed))
            if not one.sound:
                console.print(f"{one}")
            options.out.write_text(json.dumps([asdict(one) for one in verdicts], indent=1))
            step(f"seed {seed}")
    met: Counter[str] = Counter(part for one in verdicts for part in one.parts)
    failed = [one for one in verdicts if not one.sound]
    print(f"{len(verdicts)} mixtures, of {dict(met)}")
    print(f"Diverged {sum(one.note != '' for one in verdicts)}")
    needed = Counter(one.steps[-1] for one in verdicts if one.steps)
    finest = ", ".join(f"{PERIOD / steps * 1e6:.4g} us {needed[steps]}" for steps in sorted(needed))
    print(f"finest step: {finest}")
    for claim in ("in_order", "balanced", "alike"):
        print(f"{claim}: {sum(getattr(one, claim) for one in verdicts)} of {len(verdicts)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
