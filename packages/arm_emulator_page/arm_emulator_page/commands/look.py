"""Look at a recorded run in the browser, or at two, one over the other."""

import threading
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.extension.bags import EVENT_KINDS, RecordedMachine, explain_moment
from arm_emulator.extension.commands import RunNumber, SceneName, command, output
from arm_emulator.extension.page import TermsNow, Timeline
from arm_emulator_page.run_page import RunPage
from arm_emulator_page.run_view import RunView


@command(until_stopped=True, keys="`url`, `scene`, `ticks`")
def serve_recorded_run(
    bag: Path,
    other: Path | None = None,
    /,
    *,
    scene: SceneName | None = None,
    other_scene: SceneName | None = None,
    run: RunNumber = -1,
    other_run: RunNumber = -1,
    port: Annotated[str, Parameter(metavar="[HOST:]PORT")] = "0",
) -> int:
    """Serve a page with a recorded run to browsers, until Ctrl-C.

    A second run is laid over the first, at the same ticks, and its signals can be subtracted.

    Args:
        bag: folder of the bag.
        other: folder of the bag whose run is laid over it.
        scene: scene file or name (default: the one that the bag names).
        other_scene: likewise of the other bag.
        run: which run of the bag, from 1 on (default: the last).
        other_run: likewise of the other bag.
        port: TCP port (default: any that is free); on this machine alone without HOST.
    """
    machine = RecordedMachine.open_run(bag, scene, run)
    over = (
        None
        if other is None
        else _make_view(RecordedMachine.open_run(other, other_scene, other_run))
    )

    def explain_tick() -> tuple[TermsNow, list[str]]:
        now = explain_moment(machine)
        return now.terms, now.active

    page = RunPage(_make_view(machine), explain_tick, port, over)
    output.print_line(page.url)
    output.add_facts({"url": page.url, "scene": machine.scene.name, "ticks": machine.last})
    try:
        threading.Event().wait()
    finally:
        page.close()
    return 0


def _make_view(machine: RecordedMachine) -> RunView:
    events = tuple(
        (tick, ", ".join(str(EVENT_KINDS.get(event.kind, event.kind)) for event in tick_events))
        for tick, tick_events in sorted(machine.changes.items())
    )
    return RunView.create_from_line(Timeline(machine), machine.last, events)
