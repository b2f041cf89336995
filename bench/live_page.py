"""Cost of the page of a running network, and its memory over time.

    python -m bench.live_page                # factor in lock-step with and without it, in turns
    python -m bench.live_page --chromium     # the same, and Chromium draws it on these processors
    python -m bench.live_page --chromium --minutes 20   # memory of the page and of Chromium

Without `--chromium` a client takes all that the page sends to a browser: drawing it is the work of
another machine, or of a graphics card.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.wheel import need_wheel
from arm_emulator.ros.bringup import Bringup
from arm_emulator.ros.ros_domain import own_domain
from bench.lockstep import listener
from bench.measure import processor_time
from bench.page_browsers import browsers, drawing, page_process, resident, sent, taking

SECONDS = 5.0  # wall, of each run
PATIENCE = 120.0  # s, wall
LOG = Path("out/bench/live_page")


@contextmanager
def network(scene: str, page: bool, **more: object) -> Iterator[Bringup]:
    """Run a network in lock-step in this block, in an own domain."""
    streams = {"page_port": 0} if page else {}
    log = LOG / ("with" if page else "without")
    (log / "emulator.log").unlink(missing_ok=True)
    emulator = streams | more
    with own_domain(), Bringup(scene, start="first_answer", emulator=emulator, log=log) as one:
        yield one


def url_of(log: Path) -> str:
    """Return the address that the emulator prints into its log."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        found = re.search(r"^page: (\S+)$", log.read_text() if log.exists() else "", re.MULTILINE)
        if found:
            return found[1]
        time.sleep(0.1)
    raise TimeoutError("the emulator prints no address")


def turn(scene: str, browser: Any) -> dict[str, float]:
    """Run a network for some seconds, with a browser at its page or without a page.

    Returns:
        How many times faster than real time it runs, processor time of emulator and servo per tick
        [us], and per second of wall time what its page has sent [kB] and pictures drawn.
    """
    with contextlib.ExitStack() as open_:
        one = open_.enter_context(network(scene, browser is not None))
        ticks = open_.enter_context(listener())
        url = "" if browser is None else url_of(LOG / "with/emulator.log")
        drawn = open_.enter_context(browser(url)) if url else lambda: 0
        while ticks() < 500:
            if one.ended() is not None:
                raise RuntimeError(f"a node ended: {one.ended()}")
        lock_step = [one.process(name).pid for name in ("emulator", "servo")]
        begin, began = ticks(anew=True), time.monotonic()
        spent = sum(map(processor_time, lock_step))
        bytes_, pictures, end = sent(url) if url else 0, drawn(), begin
        while time.monotonic() - began < SECONDS:
            end = ticks(anew=True)
        wall = time.monotonic() - began
        return {
            "factor": float(end - begin) * 1e-3 / wall,
            "us": (sum(map(processor_time, lock_step)) - spent) / (end - begin) * 1e6,
            "kB/s": ((sent(url) if url else 0) - bytes_) / wall / 1e3,
            "pictures/s": (drawn() - pictures) / wall,
        }


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="three_axis", help="of servo periods of 1 ms")
    parser.add_argument("--turns", type=int, default=4)
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--chromium", action="store_true", help="draw the page")
    parser.add_argument("--rate", type=float, default=0.0, help="times real time, of --minutes")
    given = parser.parse_args()
    try:
        need_wheel("live_page", "viser", "viser")
    except Refusal as refusal:
        parser.error(str(refusal))
    browser = drawing if given.chromium else taking
    if given.minutes:
        soak(given.scene, given.minutes, browser, given.rate)
        return
    turns = [(turn(given.scene, None), turn(given.scene, browser)) for _ in range(given.turns)]
    without, with_ = ([one["factor"] for one in side] for side in zip(*turns, strict=True))
    each = [one / other for one, other in zip(with_, without, strict=True)]
    rows = {"without a page": without, "with": with_, "ratio": each}
    rows |= {f"{key} to the browser": [one[key] for _, one in turns] for key in ("kB/s",)}
    rows["pictures/s drawn"] = [one["pictures/s"] for _, one in turns]
    print(f"| {given.scene} in lock-step | real-time factor, each turn |\n|---|---|")
    for name, of in rows.items():
        print(f"| {name} | {_list(of)} |")
    print(f"| ratio, median | {median(each):.3f} |")
    without, with_ = ([one["us"] for one in side] for side in zip(*turns, strict=True))
    print(f"| us of emulator and servo per tick, without | {_list(without)} |")
    print(f"| with | {_list(with_)} |")
    print(f"| ratio of the medians | {median(with_) / median(without):.3f} |")


def _list(numbers: list[float]) -> str:
    return ", ".join(f"{one:.3g}" for one in numbers)


def soak(scene: str, minutes: float, browser: Any, rate: float) -> None:
    """Print the memory of page and browser ten times while the browser is connected."""
    more = {"real_time_factor": rate} if rate else {}
    with network(scene, page=True, **more) as one, listener() as ticks:
        url = url_of(LOG / "with/emulator.log")
        with browser(url) as drawn:
            page = page_process(one.process("emulator").pid)
            print(
                "| after [min] | tick | page [MB] | Chromium [MB] | sent [MB] | pictures |"
                "\n|---|---|---|---|---|---|"
            )
            began = time.monotonic()
            for part in range(11):
                while time.monotonic() - began < 6.0 * minutes * part:
                    ticks(anew=True)
                of_browser = sum(map(resident, browsers()))
                row = [part * minutes / 10, ticks(), resident(page), of_browser, sent(url) / 1e6]
                print(f"| {' | '.join(f'{cell:.5g}' for cell in row)} | {drawn()} |", flush=True)


if __name__ == "__main__":
    main()
