"""A failure that was shrunk, as files: a campaign of one run, and the scene alone."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.yaml_file import read_yaml
from arm_emulator.campaign.campaign_file import Campaign, used_files
from arm_emulator.campaign.shrinking import Shrunk
from arm_emulator.campaign.varying_numbers import DRAWN, leaves
from arm_emulator.machine.overrides import override

GAINS = "controller.joints."


class Files(NamedTuple):
    """Files of a failure.

    Attributes:
        campaign: a campaign whose only run is the failure.
        scene: the machine with its changed numbers, for `check-scene`, `up` and `run`.
        record: of the run; not written yet.
    """

    campaign: Path
    scene: Path
    record: Path


def write_shrunk(campaign: Campaign, found: Shrunk, folder: Path) -> Files:
    """Write a failure into a folder, which is made; return its files.

    Raises:
        Refusal: it cannot be written.
    """
    files = Files(folder / "campaign.yaml", folder / "scene.yaml", folder / "run.mcap")
    used = used_files(campaign.data, campaign.file)
    gains = {
        f"joints.{name}": value
        for name, value in leaves((campaign.data.get("controller") or {}).get("joints"))
    } | {
        name.removeprefix("controller."): value
        for name, value in found.changes.items()
        if name.startswith(GAINS)
    }
    of_scene = {
        name: value for name, value in found.changes.items() if name.split(".")[0] not in DRAWN
    }
    contents = {
        files.campaign: _campaign(campaign, found, folder),
        files.scene: scene_data(campaign, dict(campaign.data.get("set") or {}) | of_scene, folder),
    }
    if gains:
        contents[files.scene]["servo"] = "servo.yaml"
        contents[folder / "servo.yaml"] = _servo(used["servo"], gains)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files.record.unlink(missing_ok=True)
        for file, data in contents.items():
            text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)
            file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise Refusal("campaign", f"folder {folder}", "be writable", error.strerror) from None
    return files


def _campaign(campaign: Campaign, found: Shrunk, folder: Path) -> dict[str, Any]:
    """Return the campaign of one run, whose files are named from the new folder."""
    data = {
        key: value
        for key, value in campaign.data.items()
        if key not in ("vary", "correlate", "sampling", "search", "stop", "measures", "count")
    }
    beside, period = campaign.file.parent, campaign.scene.servo_period

    def seen(name: str) -> str:
        return _seen_from(folder, beside / name) if (beside / name).is_file() else name

    data["scene"] = seen(data["scene"])
    data["scenario"] = dict(data["scenario"]) | {"seconds": found.seconds}
    if "table" in data["scenario"]:
        data["scenario"]["table"] = seen(data["scenario"]["table"])
    controller = dict(data.get("controller") or {})
    data["controller"] = controller | {
        key: seen(controller[key]) for key in ("servo", "motion") if key in controller
    }
    requirement = campaign.requirements[found.requirement]
    if isinstance(requirement, Mapping):
        file, _, function = str(requirement["python"]).partition(":")
        requirement = {**requirement, "python": f"{seen(file)}:{function}"}
    data["requirements"] = {found.requirement: requirement}
    noise = {
        f"noise_{k}": {"kind": "number", "name": "seed", "value": seed, "at": tick * period}
        for k, (tick, seed) in enumerate(found.case.reseeds)
        if tick * period < found.seconds
    }
    data["faults"] = {name: campaign.data["faults"][name] for name in found.faults} | noise
    vary = dict(found.changes)
    if campaign.scene.sensed and "seed" not in vary:
        vary["seed"] = found.case.seed
    data |= {"vary": vary, "count": 1}
    return {key: value for key, value in data.items() if value not in ({}, None)}


def scene_data(campaign: Campaign, overrides: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a campaign's scene as it stands in a file.

    Args:
        campaign: which one.
        overrides: values in place of those of its scene's file, as `load_scene` takes them.
        folder: where the file will be, from which others are named.
    """
    used = used_files(campaign.data, campaign.file)
    data, file = read_yaml(used["scene"]), used["scene"]
    for name, value in overrides.items():
        if name == "payload.mass" and not isinstance(data.get("payload"), dict):
            name = "payload"  # a scene's short form
        override(data, name, value, file.name)
    if (file.parent / data["urdf"]).is_file():
        data["urdf"] = _seen_from(folder, file.parent / data["urdf"])
    return data | {key: _seen_from(folder, used[key]) for key in ("servo", "motion")}


def _servo(file: Path, gains: Mapping[str, float]) -> dict[str, Any]:
    data = read_yaml(file)
    node = next(one for one in data.values() if isinstance(one, dict))
    for name, value in gains.items():
        override(node["ros__parameters"], name, value, file.name)
    return data


def _seen_from(folder: Path, file: Path) -> str:
    return os.path.relpath(file.absolute(), folder.absolute())
