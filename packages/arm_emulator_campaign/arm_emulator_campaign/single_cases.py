"""Single cases of a campaign: found by their index, replayed, recorded, shrunk."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from arm_emulator.extension.base import KEEP_NOTHING, Refusal, RunOutputs, check_count
from arm_emulator.extension.commands import PageProcess, output, wait_for_ctrl_c
from arm_emulator.extension.machine import Diverged
from arm_emulator.extension.runs import Recorder
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.execution.splitter import read_failures
from arm_emulator_campaign.results.parts import ABOUT, INDEX, Results
from arm_emulator_campaign.simulation.batch_simulator import make_simulator
from arm_emulator_campaign.simulation.case import Case, draw_case, make_case
from arm_emulator_campaign.simulation.case_bag import write_case_bag
from arm_emulator_campaign.simulation.forking import make_forked_case
from arm_emulator_campaign.simulation.outcome import Outcome
from arm_emulator_campaign.simulation.shrinking import shrink_run, write_shrunk
from arm_emulator_campaign.simulation.simulator import Simulator


def replay_run(
    definition: Campaign, case: Case, outputs: RunOutputs, page: str | None, bag: Path | None
) -> int:
    """Simulate a run again: judged as in the campaign, then once more for who records it."""
    outcome = make_simulator(definition).simulate_run(case)
    for name, value in outcome.values.items():
        output.print_line(f"{name:<44} {value!r}")
    for name, value in outcome.robustness.items():
        output.print_line(f"{name:<44} {'holds' if value >= 0.0 else 'FAILS'} by {abs(value):.6g}")
    for name, value in outcome.measures.items():
        output.print_line(f"{name:<44} {value:.6g}")
    output.add_facts({
        "index": case.index, "values": outcome.values, "robustness": outcome.robustness,
        "measures": outcome.measures, "failed": outcome.has_failed,
    })  # fmt: skip
    recorded = outputs != KEEP_NOTHING or page is not None
    code = output.report_miss("campaign", _describe_failures(outcome))
    if bag is None and not recorded:
        return code
    simulator = Simulator(definition)
    if bag is not None:
        write_case_bag(definition, simulator, case, bag)
        output.print_line(f"wrote   {bag}")
    if recorded:
        record_case(simulator, case, outputs, page)
    return code


def _describe_failures(outcome: Outcome) -> str:
    """Return as text what failed in a run; empty: nothing."""
    if math.isfinite(outcome.diverged):
        return f"run {outcome.index} diverged at {outcome.diverged:g} s"
    names = [name for name, value in outcome.robustness.items() if not value >= 0.0]
    return f"run {outcome.index} fails {', '.join(names)}" if names else ""


def find_case(definition: Campaign, into: Path, index: int, option: str) -> Case:
    """Return a run by its index: drawn again, or of a search, from its results.

    Raises:
        Refusal: a search has no such run.
    """
    check_count("campaign", option, index, 0, 10**12)
    if definition.search is None:
        return draw_case(definition.variation, index)
    if not (into / ABOUT).is_file():
        rule = "have the search's runs, from which one is taken"
        raise Refusal("campaign", f"folder {into}", rule, "none", "--into FOLDER")
    results = Results(into, definition)
    if definition.search.forks:
        failures = read_failures(results)
        if index >= len(failures):
            valid = f"0 to {len(failures) - 1}" if failures else None
            raise Refusal("campaign", option, "be a failure of the search", index, valid)
        return replace(make_forked_case(definition, failures[index]), index=index)
    columns = results.collect_columns()
    places = np.flatnonzero(columns[INDEX] == index)
    if not len(places):
        count = len(columns[INDEX])
        raise Refusal("campaign", option, "be a run of the search", index, f"0 to {count - 1}")
    values = {
        name.name: float(columns[name.name][places[0]]) for name in definition.variation.numbers
    }
    return make_case(definition.variation, index, values)


def record_case(
    simulator: Simulator, case: Case, outputs: RunOutputs, page: str | None = None
) -> None:
    """Simulate a run for a recording, or for its page at a port."""
    pieces = simulator.drive_run(case)
    next(pieces)
    plant = simulator.session.plant
    with (
        Recorder(plant, outputs, waits=True, stays=page is None),
        PageProcess(plant, page, waits=True) as page_process,
    ):
        if page is not None:
            print(f"page: {page_process.url}", flush=True)
        try:
            for _ in pieces:
                pass
        except Diverged as fault:
            output.print_line(str(fault))
        if page is not None:
            wait_for_ctrl_c()


def print_shrunk(definition: Campaign, case: Case, into: Path) -> int:
    """Shrink a run that fails, write it, and print its remaining changes."""
    shrunk = shrink_run(definition, case)
    output.print_line(f"run {case.index} fails {shrunk.requirement} by {-shrunk.before:.6g}")
    for name, value in shrunk.changes.items():
        nominal = next(
            number.nominal for number in definition.variation.numbers if number.name == name
        )
        output.print_line(f"  {name:<42} {value:.6g} in the place of {nominal:.6g}")
    for name in shrunk.faults:
        output.print_line(f"  fault {name}")
    if not shrunk.changes and not shrunk.faults:
        output.print_line("  it fails without any change")
    output.print_line(
        f"  {shrunk.seconds:.6g} s, fails by {-shrunk.margin:.6g}, {shrunk.runs} runs tried"
    )
    file = write_shrunk(definition, shrunk, into / f"shrunk_{case.index}")
    margin = Simulator(load_campaign(file)).simulate_run(0).robustness[shrunk.requirement]
    if margin >= 0.0:
        rule = f"fail {shrunk.requirement} when it is simulated again"
        raise Refusal("campaign", str(file), rule, f"holds by {margin:g}")
    output.print_line(f"wrote   {file}")
    output.add_facts({
        "index": case.index, "requirement": shrunk.requirement, "changes": shrunk.changes,
        "faults": shrunk.faults, "seconds": shrunk.seconds, "margin": margin,
        "runs": shrunk.runs, "campaign": file,
    })  # fmt: skip
    return 0
