"""The page of a finished run, until Ctrl-C."""

import contextlib
import threading

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.commands import output
from arm_emulator.extension.page import TermsNow, Timeline, TorqueTerms
from arm_emulator.extension.runs import OfflineRun
from arm_emulator_page.run_page import RunPage
from arm_emulator_page.run_view import RunView
from arm_emulator_page.what_if import WhatIf


def serve_run(line: Timeline[OfflineRun], at: str) -> None:
    """Serve a page with a run until Ctrl-C.

    Args:
        line: the run, and its moments.
        at: [HOST:]PORT of the page.
    """
    session = line.run.session
    terms = TorqueTerms(session.scene)

    def explain_tick() -> tuple[TermsNow, list[str]]:
        return terms.evaluate_torques(session.plant.save(), session.measured.applied), []

    page = RunPage(RunView.create_from_line(line, line.newest), explain_tick, at)
    try:
        from arm_emulator.extension.bags import write_timeline
    except (ModuleNotFoundError, Refusal):  # without ROS 2
        WhatIf(page, line)
    else:
        WhatIf(page, line, write_timeline)
    output.print_line(page.url)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()
    page.close()
