"""A run of a campaign as a bag with its scene, which all commands that read bags take."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from arm_emulator.extension.base import read_yaml
from arm_emulator.extension.machine import Change, Diverged, override_keys
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.campaign_file import find_files
from arm_emulator_campaign.simulation.case import Case
from arm_emulator_campaign.simulation.shrinking import make_path
from arm_emulator_campaign.simulation.simulator import Simulator


def write_case_bag(campaign: Campaign, simulator: Simulator, case: Case, folder: Path) -> None:
    """Simulate a run tick by tick into a new bag; a machine that diverges ends it.

    Args:
        campaign: whose run it is.
        simulator: of the campaign.
        case: the run.
        folder: the bag; its file `scene.yaml` is the campaign's scene.
    """
    # ROS 2 need not be installed for a campaign.
    from arm_emulator.extension.bags import BAG_SCENE_FILE, CHANGE_KINDS, RunBag

    def record_change(change: Change) -> None:
        bag.write_change(CHANGE_KINDS[type(change)])

    pieces = simulator.drive_run(case, 1, record_change)
    next(pieces)
    with RunBag(
        folder, simulator.session, {"campaign": f"run {case.index} of {campaign.file}"}
    ) as bag:
        data = _make_scene_data(campaign, folder)
        (folder / BAG_SCENE_FILE).write_text(yaml.safe_dump(data, sort_keys=False, width=100))
        try:
            for _ in pieces:
                bag.write_state()
        except Diverged:
            pass  # `check-bag` reports the same


def _make_scene_data(campaign: Campaign, folder: Path) -> dict[str, Any]:
    """Return a campaign's scene as it stands in a file of a folder, from which it names others."""
    used = find_files(campaign.data, campaign.file)
    data, file = read_yaml(used["scene"]), used["scene"]
    for name, value in campaign.overrides.items():
        if name == "payload.mass" and not isinstance(data.get("payload"), dict):
            name = "payload"  # a scene's short form
        override_keys(data, name, value, file.name)
    if (file.parent / data["urdf"]).is_file():
        data["urdf"] = make_path(folder, file.parent / data["urdf"])
    return data | {key: make_path(folder, used[key]) for key in ("servo", "motion")}
