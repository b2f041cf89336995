"""Benches without what they measure: their modules, scenes and published report."""

import inspect
import itertools
import json
from pathlib import Path
from typing import Any

import pytest

from arm_emulator.base.io.config_files import find_config_folder
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.machine.schemes.known import SCHEMES
from bench import PACKAGES, import_bench, report
from bench.speed.bare import BARE, list_odd_parts

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED = ROOT / "docs" / "validation" / "report"
FOLDERS = (ROOT / "bench", *ROOT.glob("bench/[!_]*/"), *PACKAGES)
MODULES = sorted(file.stem for folder in FOLDERS for file in folder.glob("[!_]*.py"))
SHIPPED = sorted(file.stem for file in find_config_folder().glob("*.yaml"))


@pytest.mark.parametrize(("name", "scheme"), [*zip(SHIPPED, itertools.cycle(SCHEMES))])
def test_a_scene_without_its_extras_has_the_parts_of_peers(name: str, scheme: str) -> None:
    scene = load_scene(name, {**BARE, "integrator.scheme": scheme})
    assert not [part for part in list_odd_parts(scene) if not part.endswith(".motor")]  # they stay
    assert scene.integrator.events == "step"


@pytest.mark.parametrize("name", MODULES)
def test_every_bench_can_be_imported(name: str) -> None:
    import_bench(name)


@pytest.mark.parametrize("name", report.SECTIONS + report.BY_NAME)
def test_a_section_measures_reports_and_draws_its_figures(name: str) -> None:
    section = import_bench(name)
    assert isinstance(section.TITLE, str)
    inspect.signature(section.run_bench).bind(True)
    inspect.signature(section.write_report).bind({})
    if hasattr(section, "draw_figures"):
        inspect.signature(section.draw_figures).bind({}, ROOT)


def test_the_published_report_follows_from_its_figures() -> None:
    figures = json.loads((PUBLISHED / "figures.json").read_text())
    assert report.report_text(figures) == (PUBLISHED / "report.md").read_text()


MACHINE = {
    "processor": "a processor", "cores": 2, "system": "Linux", "compiler": "a compiler",
    "python": "3.11", "versions": {}, "load_at_start": 0.0,
}  # fmt: skip


class Section:
    """A section of a report that counts its runs."""

    TITLE = "Small numbers"

    def __init__(self) -> None:
        self.runs = 0

    def run_bench(self, quick: bool) -> dict[str, Any]:
        self.runs += 1
        return {"runs": self.runs, "quick": quick}

    def write_report(self, figures: dict[str, Any]) -> str:
        return f"run {figures['runs']}, quick: {figures['quick']}"


def test_a_section_of_a_published_report_is_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sections = {"one": Section(), "two": Section()}
    monkeypatch.setattr(report, "SECTIONS", tuple(sections))
    monkeypatch.setattr(report, "import_bench", sections.get)
    monkeypatch.setattr(report, "describe_machine", lambda: MACHINE)
    out, page = tmp_path / "out", tmp_path / "page"
    assert (
        report.run_benches(False, [], out, page)
        == report.run_benches(False, ["two"], out, page)
        == 0
    )
    text = (page / "report.md").read_text()
    assert "run 1, quick: False" in text and "run 2, quick: False" in text
    assert text.count("was measured anew on") == 1
    with pytest.raises(Refusal, match="come with sections of the report, got --quick"):
        report.run_benches(True, ["two"], out, page)
    assert (page / "report.md").read_text() == text
