"""Every command finds the files beside a scene, from any folder."""

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from draws import some

from arm_emulator import Refusal, load_gains, load_scene
from arm_emulator.base.io import config_files
from arm_emulator.base.io.config_files import BESIDE, find_beside, find_scene
from arm_emulator.cli.command_line import main
from arm_emulator.cli.commands.check_scene import check_scene
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.runs.offline import load_offline_run

CONFIG = Path(__file__).resolve().parents[2] / "config"


def own_scene(folder: Path, name: str, places: dict[str, str]) -> Path:
    """Write three_axis as a scene of one's own; `places`: kind -> file, relative to the scene."""
    (folder / "urdf").mkdir(parents=True)
    shutil.copy(CONFIG / "urdf" / "three_axis.urdf", folder / "urdf")
    text = (CONFIG / "three_axis.yaml").read_text()  # with its name, and so with its library
    for kind, place in places.items():
        file = folder / place
        file.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(CONFIG / kind / "three_axis.yaml", file)
        if place != f"{kind}/{name}.yaml":
            text += f"{kind}: {place}\n"
    scene = folder / f"{name}.yaml"
    scene.write_text(text)
    return scene


def spellings(scene: Path, folder: Path) -> list[str]:
    """Return paths of a scene as people state them, the working directory being `folder`."""
    link = folder / "a link"
    link.symlink_to(scene.parent)
    relative = os.path.relpath(scene, folder)
    roundabout = f"../{folder.name}/{relative}"
    return [str(scene), relative, f"./{relative}", roundabout, str(link / scene.name)]


@pytest.mark.parametrize("seed", some([1, *range(2, 11), 0], 1))
def test_gains_are_located_from_any_folder(
    tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever scene, gains and working directory are, all commands find the same files."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(["own", "three_axis", "an arm", "x.y"]))
    places = {
        kind: str(rng.choice([f"{kind}/{name}.yaml", f"{kind}.yaml", f"../{seed}/deep/er/{kind}"]))
        for kind in BESIDE
    }
    scene = own_scene(tmp_path / str(seed), name, places)
    here = tmp_path / "elsewhere" / "deep"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    for spelling in spellings(scene, here):
        file = find_scene(spelling)
        for kind in BESIDE:
            result = find_beside(file, kind)
            assert result.is_absolute() and result.samefile(scene.parent / places[kind]), spelling
        line = check_scene(spelling).line
        assert "servo: /" in line and "motion: /" in line
        commands = Bringup(spelling)._words
        assert str(find_beside(file, "servo")) in commands["servo"], spelling
        assert str(find_beside(file, "motion")) in commands["motion_controller"], spelling
        assert f"scene:={file}" in commands["emulator"], spelling
        assert load_gains(file).servo.joint_names == load_scene(spelling).joint_names
        assert DemoPlan.load_plan(file, 50_000_000).instructions == 40
    run = load_offline_run(str(scene))
    run.advance(3)
    assert run.session.tick == 3


def test_shipped_scenes_find_theirs_installed_without_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As colcon installs them: share/arm_emulator/config, and no source tree beside."""
    shutil.copytree(CONFIG, tmp_path / "share" / "arm_emulator" / "config")
    monkeypatch.setattr(config_files, "__file__", str(tmp_path / "lib" / "x" / "config_files.py"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    monkeypatch.chdir(tmp_path)
    for name in ("three_axis", "ur5", "panda", "so_arm100"):
        for kind in BESIDE:
            result = find_beside(find_scene(name), kind)
            assert result == tmp_path / "share/arm_emulator/config" / kind / f"{name}.yaml"
    named = own_scene(tmp_path / "mine", "own", {})
    named.write_text(named.read_text() + "servo: three_axis\n")
    assert find_beside(named, "servo").is_relative_to(tmp_path / "share")


def test_a_scene_of_ones_own_never_gets_the_gains_of_another(tmp_path: Path) -> None:
    """Also if it is called as a shipped one; the line states where they were looked for."""
    scene = own_scene(tmp_path, "three_axis", {})
    for kind in BESIDE:
        with pytest.raises(Refusal) as refusal:
            find_beside(scene, kind)
        expected = tmp_path / kind / "three_axis.yaml"
        assert str(refusal.value) == (
            f"three_axis.yaml: {kind} parameters must be in {expected}, got no such file; "
            f"valid: write that file, or name one in the scene: `{kind}: FILE`"
        )
    printed = check_scene(str(scene)).line
    assert (
        "valid, 3 joints" in printed
        and f"no servo parameters: they must be in {tmp_path}" in printed
    )


CHANGES: list[tuple[Callable[[str], str], str, str]] = [
    (lambda text: text.replace("waist", "hip"), "servo", "servo.joint_names must name every"),
    (lambda text: text.replace("    period: 1.0e-3", "    period: 2.0e-3"), "servo",
     "servo.period must be the scene's servo_period, 0.001 s, got 0.002 s"),
    (lambda text: text.replace("period: 5.0e-2", "period: 1.0e-1"), "motion",
     "servo.motion_period must be motion_controller.period, 0.1 s, got 0.05 s"),
    (lambda text: text.replace("tool: tool ", "tool: hand "), "motion",
     "own: tool must be a link of the robot description, got hand"),
    (lambda text: "a: [", "servo", "own: file must be well-formed YAML"),
    (lambda text: text.replace("resistance: 1.0", "resistance: 1e999"), "servo", "own: joints."),
]  # fmt: skip


@pytest.mark.parametrize(("change", "kind", "words"), CHANGES, ids=[c[2][:30] for c in CHANGES])
def test_check_scene_holds_gains_against_the_scene(
    tmp_path: Path,
    change: Callable[[str], str],
    kind: str,
    words: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = own_scene(tmp_path, "own", {"servo": "s/own", "motion": "m/own"})
    file = tmp_path / f"{kind[0]}/own"
    before = file.read_text()
    assert change(before) != before, "the change does not apply"
    file.write_text(change(before))
    monkeypatch.setattr(sys, "argv", ["arm_emulator", "check-scene", str(scene)])
    with pytest.raises(SystemExit) as ended:
        main()
    printed = capsys.readouterr().err
    assert ended.value.code == 2 and words in printed and printed.count("\n") == 1, printed
