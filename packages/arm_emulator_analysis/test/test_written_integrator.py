"""Advised settings written into a scene's file: two values and nothing else."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from machines import CONFIG

from arm_emulator import Refusal, load_scene
from arm_emulator.base.io.config_files import BESIDE, check_own
from arm_emulator.cli.commands.tune import tune_scene
from arm_emulator.design.new_scene import write_new
from arm_emulator_analysis.commands.advise import find_cheapest_setting as advise_scene
from arm_emulator_analysis.integrator_text import write_integrator
from arm_emulator_analysis.true_motion import IntegrationMethod
from arm_emulator_identification.identified import write_fitted


def scene_copy(folder: Path, **replaced: str) -> Path:
    shutil.copytree(CONFIG / "urdf", folder / "urdf")
    text = (CONFIG / "three_axis.yaml").read_text()
    for old, new in replaced.items():
        assert old in text, f"{old} is not in the scene"
        text = text.replace(old, new)
    file = folder / "three_axis.yaml"
    file.write_bytes(text.encode())
    return file


def add_demo(file: Path) -> None:
    """Name the shipped files of three_axis in a scene elsewhere."""
    named = "".join(f"{kind}: three_axis\n" for kind in BESIDE)
    file.write_text(named + file.read_text())


def test_writing_changes_two_values_and_nothing_else(tmp_path: Path) -> None:
    file = scene_copy(tmp_path)
    before = file.read_text().splitlines()
    write_integrator(file, IntegrationMethod("implicit", "step"), 2.5e-5)
    after = file.read_text().splitlines()
    changed = [(old, new) for old, new in zip(before, after, strict=True) if old != new]
    assert [new.split("#")[0].split() for _, new in changed] == [
        ["scheme:", "implicit"],
        ["dt:", "2.5e-5"],
    ], "lines that changed"
    columns = [(old.find("#"), new.find("#")) for old, new in changed]
    assert all(old == new for old, new in columns), f"columns of the comments: {columns}"
    assert load_scene(file).integrator.dt == 2.5e-5, "the step in the file"
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["three_axis.yaml", "urdf"], "files that are left"
    shipped = load_scene(CONFIG / "three_axis.yaml").integrator
    write_integrator(file, IntegrationMethod(shipped.scheme, shipped.events), shipped.dt)
    assert file.read_text().splitlines() == before, "written back"


SECTIONS = {
    "one line": ("{scheme: paper, dt: 1e-4}  # mine", "{scheme: implicit, dt: 5.0e-5}  # mine"),
    "no scheme, one line": ("{dt: 1e-4}", "{scheme: implicit, dt: 5.0e-5}"),
    "no scheme": ("\n    dt: 1e-4 # coarse", "\n    scheme: implicit\n    dt: 5.0e-5 # coarse"),
    "quoted": ("\n  'dt': 1e-4\n  scheme: 'paper'", "\n  'dt': 5.0e-5\n  scheme: implicit"),
    "Windows": ("\r\n  dt: 1e-4\r\n  scheme: paper\r", "\r\n  dt: 5.0e-5\r\n  scheme: implicit\r"),
}  # fmt: skip


@pytest.mark.parametrize("kind", SECTIONS)
def test_sections_as_people_write_them(tmp_path: Path, kind: str) -> None:
    old, new = SECTIONS[kind]
    file = scene_copy(tmp_path)
    text = file.read_text()
    head = text[: text.index("integrator:")]
    tail = "\nservo_period: 1.0e-3\nthreads: 1\n"
    file.write_bytes(f"{head}integrator: {old}{tail}".encode())
    write_integrator(file, IntegrationMethod("implicit", "step"), 5e-5)
    assert file.read_bytes().decode() == f"{head}integrator: {new}{tail}", "the file"


def test_writing_that_would_change_more_is_refused(tmp_path: Path) -> None:
    """The step is an anchor that the servo period uses too."""
    file = scene_copy(tmp_path)
    text = file.read_text()
    text = text[: text.index("integrator:")] + "integrator: {dt: &dt 1e-3}\nservo_period: *dt\n"
    file.write_text(text)
    with pytest.raises(Refusal, match=r"three_axis.yaml: |advised.yaml: "):
        write_integrator(file, IntegrationMethod("implicit", "step"), 5e-4)
    assert file.read_text() == text, "a refused change has changed the file"
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["three_axis.yaml", "urdf"], "files that are left"


def run(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(CONFIG.parent), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", "arm_emulator", "advise", *arguments],
        capture_output=True, text=True, timeout=600, check=False, cwd=cwd,
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "200"},
    )  # fmt: skip


def test_located_events_and_a_thread_less_are_written(tmp_path: Path) -> None:
    file = scene_copy(tmp_path, **{"threads: 1": "threads: 2"})
    text = file.read_text().replace("scheme: rosenbrock", "scheme: extrapolated")
    file.write_text(text)
    write_integrator(file, IntegrationMethod("rosenbrock", "located"), 1e-3 / 3.0)
    scene = load_scene(file)
    integrator = scene.integrator
    written = integrator.scheme, integrator.events, integrator.dt, scene.threads
    assert written == ("rosenbrock", "located", 1e-3 / 3.0, 1), file.read_text()
    write_integrator(file, IntegrationMethod("implicit", "step", 2), 5e-4)
    scene = load_scene(file)
    integrator = scene.integrator
    written = integrator.scheme, integrator.events, integrator.dt, scene.threads
    assert written == ("implicit", "step", 5e-4, 2), file.read_text()


def test_shipped_files_are_never_written_into(tmp_path: Path) -> None:
    """By its name, by its path, through links, by every command that writes scenes or gains."""
    before = {path: path.read_bytes() for path in CONFIG.rglob("*") if path.is_file()}
    link = tmp_path / "link.yaml"
    link.symlink_to(CONFIG / "three_axis.yaml")
    folder = tmp_path / "config"
    folder.symlink_to(CONFIG)
    paths = [CONFIG / "three_axis.yaml", link, folder / "three_axis.yaml",
             tmp_path / ".." / tmp_path.name / "link.yaml"]  # fmt: skip
    scene = load_scene("three_axis")
    for path in paths:
        with pytest.raises(Refusal, match="must be one of yours, to be written into"):
            write_integrator(path, IntegrationMethod("implicit", "step"), 5e-4)
        with pytest.raises(Refusal, match=r"identify: file .* must be one of yours"):
            write_fitted(path, CONFIG / "three_axis.yaml", scene, {}, [], "")
    with pytest.raises(Refusal, match=r"tune: file .* must be one of yours"):
        tune_scene("three_axis", write=True)
    mine = scene_copy(tmp_path)
    add_demo(mine)  # whose servo's parameters are the shipped ones
    with pytest.raises(Refusal, match=r"tune: file .* must be one of yours"):
        tune_scene(str(mine), write=True)
    robot = CONFIG / "urdf" / "three_axis.urdf"
    with pytest.raises(Refusal, match=r"new: file .* must be one of yours"):
        write_new(robot, CONFIG, force=True)
    with pytest.raises(Refusal, match=r"advise: file .*three_axis.yaml must be one of yours"):
        advise_scene("three_axis", error=1e-4, write=True)
    with pytest.raises(Refusal, match="must be one of yours"):
        check_own("here", Path(yaml.__file__))  # of an installed package
    check_own("here", mine)
    assert before == {path: path.read_bytes() for path in before}, "a shipped file has changed"
