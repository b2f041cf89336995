"""The whole benchmark: sections one after the other, their figures, pictures and report."""

from __future__ import annotations

import datetime
import json
import shutil
import time
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from rich.console import Console

from arm_emulator.base.refusal import Refusal
from bench import import_bench
from bench.measure import describe_machine
from bench.must_show import list_requirements
from bench.tables import format_table

# A section is a module of this folder with TITLE, run(quick) -> figures (JSON) and report(figures)
# -> Markdown. A section with pictures has draw(figures, folder), too.
SECTIONS = (
    "work_precision",
    "ns_per_step",
    "fleet",
    "stability_map",
    "sticking",
    "self_locking",
    "warp_error",
    "threads",
    "clocks",
    "first_use",
)
# Sections that run only when they are named, of which the pages have the figures.
BY_NAME = (
    "feedforward",
    "tool_paths",
    "vibration",
    "published_joints",
    "published_responses",
    "bearing_modes",
    "assumed",
    "left_out",
    "beside_mujoco",
    "shipped_scenes",
    "identification",
    "doubtful_records",
)

NOT_PROVEN = """\
These are times of one processor, in one run, of arms of a few joints. They state nothing about
contacts, closed kinematic loops or many bodies, which MuJoCo and Pinocchio are made for and the
emulator leaves out: part of what they do in a step is looking after what is not there. They do not
state how the times are on another processor; ratios carry over better than nanoseconds. Spread is
that within this run; from run to run a virtual machine differs by more. MuJoCo and Pinocchio are
used as published, their wheels compiled for any x86-64 processor, where the emulator compiles each
scene for the processor at hand: that is part of its idea, and part of the ratio. The motions are
smooth but for the jumps of the voltages; friction that sticks, limits that are reached and encoders
are not in the work-precision curves."""


def run_benches(quick: bool, only: list[str], out: Path, publish: Path | None) -> int:
    """Measure, write figures, pictures and report into `out`, and print how it went.

    Args:
        quick: fewer cases and repetitions, for trying things out.
        only: names of sections; empty: all of SECTIONS.
        out: folder for figures.json, report.md and the pictures.
        publish: folder into which to copy them when all has gone well, sections that were named in
            the place of those of the report there; None: nowhere.

    Raises:
        Refusal: a section that does not exist, or publishing a trial or what is in no report.
    """
    if publish is not None and (quick or not set(only) <= set(SECTIONS)):
        value = "--quick" if quick else ", ".join(only)
        raise Refusal("bench", "--publish", "come with sections of the report", value)
    for name in only:
        if name not in SECTIONS + BY_NAME:
            raise Refusal("bench", "section", "be known", name, ", ".join(SECTIONS + BY_NAME))
    console = Console()
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    figures: dict[str, Any] = {
        "machine": describe_machine(),
        "date": datetime.date.today().isoformat(),
        "quick": quick,
        "seconds": {},
        "sections": {},
        "failed": {},
    }
    for name in only or SECTIONS:
        section = import_bench(name)
        console.rule(section.TITLE)
        started = time.monotonic()
        try:
            figures["sections"][name] = section.run_bench(quick)
        except Exception as error:
            # One section that fails does not discard minutes of measurements.
            traceback.print_exc()
            figures["failed"][name] = f"{type(error).__name__}: {error}"
        figures["seconds"][name] = time.monotonic() - started
        _write_figures(figures, out)
    if publish is not None and only:
        figures = _merge_reports(_read_figures(publish), figures)
        _write_figures(figures, out)
    write_report(figures, out)
    for quantity, required, reached, met in list_requirements(figures["sections"]):
        colour = {True: "green", False: "red", None: "dim"}[met]
        console.print(
            f"[{colour}]{_format_verdict(met):>12}[/{colour}]  {quantity}: {reached} ({required})"
        )
    minutes = (time.monotonic() - began) / 60.0
    console.print(f"{minutes:.1f} min; look at {out / 'report.md'}")
    for name, reason in figures["failed"].items():
        console.print(f"[red]section {name} failed[/red]: {reason}")
    if publish is not None and not figures["failed"]:
        _publish_report(out, publish)
        console.print(f"published in {publish}")
    return 1 if figures["failed"] else 0


def write_report(figures: dict[str, Any], out: Path) -> None:
    """Write report.md and the pictures from figures."""
    for name, values in _convert_to_json(figures)["sections"].items():
        section: ModuleType = import_bench(name)
        if hasattr(section, "draw_figures"):
            section.draw_figures(values, out)
    (out / "report.md").write_text(report_text(figures), encoding="utf-8")


def report_text(figures: dict[str, Any]) -> str:
    """Return the report in Markdown."""
    figures = _convert_to_json(figures)
    lines = [
        "# Speed against error",
        "",
        *_write_heading(figures),
        "",
        _write_requirements(figures),
        "",
    ]
    lines += ["## What this does not prove", "", NOT_PROVEN]
    for name, values in figures["sections"].items():
        section: ModuleType = import_bench(name)
        lines += ["", f"## {section.TITLE}", "", section.write_report(values)]
    for name, reason in figures["failed"].items():
        lines += ["", f"## {name}", "", f"**Failed**: {reason}"]
    return "\n".join(lines) + "\n"


def _convert_to_json(figures: dict[str, Any]) -> dict[str, Any]:
    """Return figures as JSON keeps them."""
    plain: dict[str, Any] = json.loads(json.dumps(figures))
    return plain


def _write_figures(figures: dict[str, Any], folder: Path) -> None:
    (folder / "figures.json").write_text(json.dumps(figures), encoding="utf-8")


def _read_figures(folder: Path) -> dict[str, Any]:
    figures: dict[str, Any] = json.loads((folder / "figures.json").read_text(encoding="utf-8"))
    return figures


def _merge_reports(published: dict[str, Any], measured: dict[str, Any]) -> dict[str, Any]:
    """Return a published report's figures with the sections that were measured anew."""
    renewal = {"date": measured["date"], "machine": measured["machine"]}
    sections = published["sections"] | measured["sections"]
    return published | {
        "seconds": published["seconds"] | measured["seconds"],
        "sections": {name: sections[name] for name in SECTIONS if name in sections},
        "failed": measured["failed"],
        "anew": published.get("anew", {}) | dict.fromkeys(measured["sections"], renewal),
    }


def _write_heading(figures: dict[str, Any]) -> list[str]:
    m = figures["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in m["versions"].items())
    minutes = sum(figures["seconds"].values()) / 60.0
    title = "A quick trial, not a measurement" if figures["quick"] else "One run of `make bench`"
    lines = [
        f"{title} on {figures['date']}, {minutes:.1f} min. {m['processor']}, {m['cores']} cores, "
        f"{m['system']}; {m['compiler']}; Python {m['python']}, {versions}. Load average at the "
        f"beginning: {m['load_at_start']:.1f}. All figures are in figures.json.",
    ]
    for name, at in figures.get("anew", {}).items():
        title = import_bench(name).TITLE
        on = (
            ""
            if at["machine"]["processor"] == m["processor"]
            else f", {at['machine']['processor']}"
        )
        load = at["machine"]["load_at_start"]
        lines += ["", f"*{title}* was measured anew on {at['date']}{on}; load average {load:.1f}."]
    return lines


def _write_requirements(figures: dict[str, Any]) -> str:
    rows = list_requirements(figures["sections"])
    return format_table(
        ("", "wanted", "reached", ""), ((*row, _format_verdict(met)) for *row, met in rows)
    )


def _format_verdict(met: bool | None) -> str:
    return {True: "reached", False: "**not reached**", None: ""}[met]


def _publish_report(out: Path, publish: Path) -> None:
    publish.mkdir(parents=True, exist_ok=True)
    for pattern in ("report.md", "figures.json", "*.png"):
        for file in out.glob(pattern):
            shutil.copyfile(file, publish / file.name)
