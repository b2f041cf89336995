"""`arm_emulator campaign`: what a search found, single runs, and failures that are shrunk."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from arm_emulator.base.count import check_count
from arm_emulator.base.kept import Kept
from arm_emulator.base.refusal import Refusal
from arm_emulator.campaign.campaign_file import Campaign, load_campaign
from arm_emulator.campaign.case import Case, case_with, drawn_case
from arm_emulator.campaign.forking import forked_case
from arm_emulator.campaign.results import ABOUT, INDEX, Results
from arm_emulator.campaign.search.method import Finding
from arm_emulator.campaign.shrinking import shrink, write_shrunk
from arm_emulator.campaign.simulator import Simulator
from arm_emulator.campaign.splitter import failed_forks
from arm_emulator.cli.case_bag import check_new_bag, write_case_bag
from arm_emulator.cli.output import output
from arm_emulator.machine.diverged import Diverged
from arm_emulator.page.watched import Watched, stay
from arm_emulator.runs.recorder import Recorder


def case_of(one: Campaign, into: Path, index: int, option: str) -> Case:
    """Return a run by its index: drawn again, or of a search, from its results.

    Raises:
        Refusal: a search has no such run.
    """
    check_count("campaign", option, index, 0, 10**12)
    if one.search is None:
        return drawn_case(one.variation, index)
    if not (into / ABOUT).is_file():
        rule = "have the search's runs, from which one is taken"
        raise Refusal("campaign", f"folder {into}", rule, "none", "--into FOLDER")
    results = Results(into, one)
    if one.search.forks:
        failures = failed_forks(results)
        if index >= len(failures):
            valid = f"0 to {len(failures) - 1}" if failures else None
            raise Refusal("campaign", option, "be a failure of the search", index, valid)
        return replace(forked_case(one, failures[index]), index=index)
    columns = results.columns()
    places = np.flatnonzero(columns[INDEX] == index)
    if not len(places):
        count = len(columns[INDEX])
        raise Refusal("campaign", option, "be a run of the search", index, f"0 to {count - 1}")
    values = {name.name: float(columns[name.name][places[0]]) for name in one.variation.numbers}
    return case_with(one.variation, index, values)


def record_case(simulator: Simulator, case: Case, kept: Kept, page: str | None = None) -> None:
    """Simulate a run for who records it, or looks at its page at a port."""
    pieces = simulator.drive(case)
    next(pieces)
    plant = simulator.session.plant
    with (
        Recorder(plant, kept, waits=True, stays=page is None),
        Watched(plant, page, waits=True) as watched,
    ):
        if page is not None:
            print(f"page: {watched.url}", flush=True)
        try:
            for _ in pieces:
                pass
        except Diverged as fault:
            output.line(str(fault))
        if page is not None:
            stay()


def print_findings(findings: Sequence[Finding], digest: str, count: int, folder: Path) -> None:
    """Print what a search found."""
    for one in findings:
        output.line(one.about)
        table = [one.head, *one.texts()] if one.rows else []
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        for row in table:
            cells = (text.ljust(width) for text, width in zip(row, widths, strict=True))
            output.line(f"  {'  '.join(cells)}".rstrip())
    output.line(f"digest  {digest}")
    output.facts({
        "findings": [asdict(one) for one in findings], "count": count, "digest": digest,
        "results": str(folder),
    })  # fmt: skip


def print_shrunk(one: Campaign, case: Case, into: Path) -> int:
    """Shrink a run that fails, write it, and print what is left of it."""
    found = shrink(one, case)
    output.line(f"run {case.index} fails {found.requirement} by {-found.before:.6g}")
    for name, value in found.changes.items():
        nominal = next(number.nominal for number in one.variation.numbers if number.name == name)
        output.line(f"  {name:<42} {value:.6g} in the place of {nominal:.6g}")
    for name in found.faults:
        output.line(f"  fault {name}")
    if not found.changes and not found.faults:
        output.line("  it fails without any change")
    output.line(f"  {found.seconds:.6g} s, fails by {-found.margin:.6g}, {found.runs} runs tried")
    files = write_shrunk(one, found, into / f"shrunk_{case.index}")
    again = load_campaign(files.campaign)
    simulator = Simulator(again)
    margin = simulator.run(0).robustness[found.requirement]
    if margin >= 0.0:
        rule = f"fail {found.requirement} when it is simulated again"
        raise Refusal("campaign", str(files.campaign), rule, f"holds by {margin:g}")
    record_case(simulator, drawn_case(again.variation, 0), Kept(record=files.record))
    bag = _bag(again, simulator, files.campaign.parent / "bag")
    for file in (files.campaign, files.scene, files.record, *filter(None, [bag])):
        output.line(f"wrote   {file}")
    output.facts({
        "index": case.index, "requirement": found.requirement, "changes": found.changes,
        "faults": found.faults, "seconds": found.seconds, "margin": margin,
        "runs": found.runs, "campaign": files.campaign, "scene": files.scene,
        "record": files.record, "bag": bag,
    })  # fmt: skip
    return 0


def _bag(campaign: Campaign, simulator: Simulator, folder: Path) -> Path | None:
    """Write a campaign's only run as a bag in the place of an earlier one; None without ROS 2."""
    shutil.rmtree(folder, ignore_errors=True)
    try:
        check_new_bag("campaign", folder)
    except Refusal:
        return None
    write_case_bag(campaign, simulator, drawn_case(campaign.variation, 0), folder)
    return folder
