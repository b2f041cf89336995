"""Cost of the page of a running network, and its memory over time.

    python -m bench.live_page                # factor in lock-step with and without it, in turns
    python -m bench.live_page --minutes 20   # memory of its process while a browser is connected

The browser is a client that takes all that the page sends: drawing it is the work of another
machine, or of a graphics card.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from arm_emulator.ros.bringup import Bringup
from arm_emulator.ros.ros_domain import own_domain
from bench.lockstep import listener

SECONDS = 5.0  # wall, of each run
PATIENCE = 120.0  # s, wall
LOG = Path("out/bench/live_page")


@contextmanager
def network(scene: str, page: bool) -> Iterator[Bringup]:
    """Run a network in lock-step in this block, in an own domain."""
    streams = {"page_port": 0} if page else {}
    log = LOG / ("with" if page else "without")
    (log / "emulator.log").unlink(missing_ok=True)
    with own_domain(), Bringup(scene, start="first_answer", emulator=streams, log=log) as one:
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


@contextmanager
def client(url: str) -> Iterator[list[int]]:
    """Take all that a page sends in this block; yield the numbers of bytes.

    A page sends the first picture alone to a connection without a camera, as this one.
    """
    from websockets.sync.client import connect

    got: list[int] = []
    with connect(url.replace("http:", "ws:"), max_size=None, subprotocols=_protocol()) as socket:
        thread = threading.Thread(target=lambda: got.extend(len(one) for one in socket))
        thread.start()
        yield got
        socket.close()
        thread.join()


def _protocol() -> list:  # type: ignore[type-arg]
    import viser

    return [f"viser-v{viser.__version__}"]


def factor(scene: str, page: bool) -> float:
    """Return how many times faster than real time a network runs."""
    with contextlib.ExitStack() as open_:
        one = open_.enter_context(network(scene, page))
        ticks = open_.enter_context(listener())
        if page:
            open_.enter_context(client(url_of(LOG / "with/emulator.log")))
        while ticks() < 500:
            if one.ended() is not None:
                raise RuntimeError(f"a node ended: {one.ended()}")
        begin, began = ticks(anew=True), time.monotonic()
        end = begin
        while time.monotonic() - began < SECONDS:
            end = ticks(anew=True)
        return float(end - begin) * 1e-3 / (time.monotonic() - began)


def resident(process: int) -> float:
    """Return the memory of a process [MB]."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(re.findall(r"VmRSS:\s+(\d+)", status)[0]) / 1e3


def page_process(emulator: int) -> int:
    """Return the process of the page that an emulator has started."""
    for task in Path(f"/proc/{emulator}/task").iterdir():
        for child in (task / "children").read_text().split():
            if "live_process" in Path(f"/proc/{child}/cmdline").read_text():
                return int(child)
    raise LookupError("the emulator has no page")


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="three_axis", help="of servo periods of 1 ms")
    parser.add_argument("--turns", type=int, default=4)
    parser.add_argument("--minutes", type=float, default=0.0)
    given = parser.parse_args()
    if given.minutes:
        soak(given.scene, given.minutes)
        return
    without, with_ = [], []
    for _ in range(given.turns):
        without.append(factor(given.scene, page=False))
        with_.append(factor(given.scene, page=True))
    each = [one / other for one, other in zip(with_, without, strict=True)]
    print(f"| {given.scene} in lock-step | real-time factor, each turn |\n|---|---|")
    for name, of in (("without a page", without), ("with", with_), ("ratio", each)):
        print(f"| {name} | {', '.join(f'{one:.3g}' for one in of)} |")
    print(f"| ratio, median | {median(each):.3f} |")


def soak(scene: str, minutes: float) -> None:
    """Print the memory of a page's process ten times while a client is connected."""
    with network(scene, page=True) as one, client(url_of(LOG / "with/emulator.log")) as got:
        process = page_process(one.process("emulator").pid)
        print("| after [min] | memory [MB] | to the browser [MB] |\n|---|---|---|")
        for turn in range(11):
            print(f"| {turn * minutes / 10:.3g} | {resident(process):.1f} | {sum(got) / 1e6:.1f} |")
            time.sleep(6.0 * minutes)


if __name__ == "__main__":
    main()
