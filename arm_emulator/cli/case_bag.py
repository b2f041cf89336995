"""A run of a campaign as a bag with its scene, which all commands that read bags take."""

from __future__ import annotations

from pathlib import Path

import yaml

from arm_emulator.base.refusal import Refusal
from arm_emulator.campaign.campaign_file import Campaign
from arm_emulator.campaign.case import Case
from arm_emulator.campaign.shrinking import scene_data
from arm_emulator.campaign.simulator import Simulator
from arm_emulator.machine.change import Change
from arm_emulator.machine.diverged import Diverged


def write_case_bag(campaign: Campaign, simulator: Simulator, case: Case, folder: Path) -> None:
    """Simulate a run tick by tick into a new bag; a machine that diverges ends it.

    Args:
        campaign: whose run it is.
        simulator: of the campaign.
        case: the run.
        folder: the bag; its file `scene.yaml` is the campaign's scene.
    """
    # ROS 2 need not be installed for a campaign.
    from arm_emulator.bags.run_bag import KINDS, RunBag
    from arm_emulator.ros.bag_metadata import SCENE

    def changed(change: Change) -> None:
        bag.changed(KINDS[type(change)])

    pieces = simulator.drive(case, 1, changed)
    next(pieces)
    with RunBag(
        folder, simulator.session, {"campaign": f"run {case.index} of {campaign.file}"}
    ) as bag:
        data = scene_data(campaign, campaign.overrides, folder)
        (folder / SCENE).write_text(yaml.safe_dump(data, sort_keys=False, width=100))
        try:
            for _ in pieces:
                bag.report()
        except Diverged:
            pass  # `check-bag` reports the same


def check_new_bag(where: str, folder: Path) -> None:
    """Refuse a bag that cannot be written, before the run.

    Raises:
        Refusal: it exists, or ROS 2 is not found.
    """
    try:
        import arm_emulator.bags.run_bag  # noqa: F401
    except ModuleNotFoundError as error:
        raise Refusal(where, "--bag", "find ROS 2", error) from None
    if folder.exists():
        raise Refusal(where, f"folder {folder}", "be new", "one that exists")
