"""Look at a recorded run in the browser."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.analysis.torque_terms import TermsNow
from arm_emulator.bags.explanation import explain_moment
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.repetition import KINDS
from arm_emulator.cli.command import command
from arm_emulator.cli.options import RunNumber, SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.scene import load_scene
from arm_emulator.page.run_page import RunPage
from arm_emulator.page.subject import Subject
from arm_emulator.ros.bag import Bag
from arm_emulator.runs.timeline import Timeline


@command(of_ros=True, until_stopped=True)
def look(
    bag: Path,
    /,
    *,
    scene: SceneName | None = None,
    run: RunNumber = -1,
    port: Annotated[int, Parameter(metavar="PORT")] = 0,
) -> int:
    """Serve a page with a recorded run to browsers on this machine, until Ctrl-C.

    Args:
        bag: folder of the bag.
        scene: scene file or name (default: the one that the bag names).
        run: which run of the bag, from 1 on (default: the last).
        port: TCP port (default: any that is free).
    """
    topics = RecordedTopics(Bag(bag))
    machine = RecordedMachine(topics, load_scene(scene or topics.scene), run)
    line = Timeline(machine)
    events = tuple(
        (tick, ", ".join(str(KINDS.get(one.kind, one.kind)) for one in made))
        for tick, made in sorted(machine.changes.items())
    )
    subject = Subject.of(line, machine.last, events)

    def explained() -> tuple[TermsNow, list[str]]:
        now = explain_moment(machine, topics)
        return now.terms, now.active

    page = RunPage(subject, explained, port)
    output.line(page.url)
    output.facts({"url": page.url, "scene": machine.scene.name, "ticks": machine.last})
    try:
        threading.Event().wait()
    finally:
        page.close()
    return 0
