"""A run that fails, with the fewest changes and in the shortest time that leave it failing.

Changes are the numbers that differ from their nominal values, and the faults. Delta debugging
(Zeller and Hildebrandt, IEEE Transactions on Software Engineering 28, 2002) leaves a set of them of
which none can be left out.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator.extension.base import Refusal
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.scenario import count_ticks
from arm_emulator_campaign.simulation.case import Case
from arm_emulator_campaign.simulation.simulator import Simulator

FAULT = "faults."


@dataclass(frozen=True)
class Shrunk:
    """Rest of a run that fails.

    Attributes:
        requirement: that it fails; the one with the least margin.
        before, margin: its margin in the whole run, and now.
        changes: numbers that differ from their nominal values, by name.
        faults: that happen.
        seconds: that it lasts.
        runs: that were tried.
        case: the run.
    """

    requirement: str
    before: float
    margin: float
    changes: dict[str, float]
    faults: tuple[str, ...]
    seconds: float
    runs: int
    case: Case


def shrink_run(campaign: Campaign, case: Case) -> Shrunk:
    """Return the fewest changes and the shortest time with which a run fails as it does.

    Raises:
        Refusal: it does not fail.
    """
    tries = _Tries(campaign, case)
    before = tries.compute_margins(case)
    requirement = min(before, key=lambda name: before[name], default="")
    if not requirement or before[requirement] >= 0.0:
        where, valid = f"{campaign.where}, run {case.index}", "a run with `failed` in the results"
        raise Refusal(where, "the run", "fail", "all requirements hold", valid)
    changes = tries.list_changes()

    def has_failure(some: Sequence[str]) -> bool:
        return not tries.compute_margins(tries.keep_only(some))[requirement] >= 0.0

    changes = [] if has_failure([]) else find_fewest(changes, has_failure)
    shortened = tries.keep_only(changes)
    if changes:
        shortened = tries.find_shortest(shortened, requirement)
    changes_left = {name: shortened.values[name] for name in changes if name in shortened.values}
    faults = tuple(name.removeprefix(FAULT) for name in changes if name not in shortened.values)
    margin = tries.compute_margins(shortened)[requirement]
    runs, seconds = tries.runs, min(shortened.seconds, campaign.nominal[0].seconds)
    return Shrunk(
        requirement, before[requirement], margin, changes_left, faults, seconds, runs, shortened
    )


def find_fewest(changes: Sequence[str], fails: Callable[[Sequence[str]], bool]) -> list[str]:
    """Return some of the changes with which it fails, and without any of which it does not."""
    left, parts = list(changes), 2
    while len(left) > 1:
        pieces = [part.tolist() for part in np.array_split(np.array(left, object), parts)]
        rests = [[change for change in left if change not in piece] for piece in pieces]
        failing = next((piece for piece in pieces if fails(piece)), None)
        if failing is not None:
            left, parts = failing, 2
            continue
        failing = next((rest for rest in rests if len(rest) < len(left) and fails(rest)), None)
        if failing is not None:
            left, parts = failing, max(2, parts - 1)
        elif parts >= len(left):
            break
        else:
            parts = min(len(left), 2 * parts)
    return left


class _Tries:
    """Runs that have some of the changes of one run."""

    def __init__(self, campaign: Campaign, case: Case) -> None:
        self._campaign, self._case = campaign, case
        self._simulator = Simulator(campaign)
        self._nominal = {number.name: number.nominal for number in campaign.variation.numbers}
        self._faults = [*campaign.nominal[1]]
        self._cache: dict[str, dict[str, float]] = {}
        self.runs = 0

    def list_changes(self) -> list[str]:
        """Return all changes; the faults first."""
        values = self._case.values
        moved = [name for name, value in values.items() if value != self._nominal[name]]
        return [*(f"{FAULT}{name}" for name in self._faults), *moved]

    def keep_only(self, changes: Sequence[str]) -> Case:
        """Return the run with some of the changes, and its noise."""
        values = {
            name: value if name in changes else self._nominal[name]
            for name, value in self._case.values.items()
        }
        without = frozenset(name for name in self._faults if f"{FAULT}{name}" not in changes)
        return replace(self._case, values=values, without=without)

    def compute_margins(self, case: Case) -> dict[str, float]:
        """Return the margins of a run, which is simulated once."""
        key = repr((sorted(case.values.items()), sorted(case.without), case.seconds))
        if key not in self._cache:
            self.runs += 1
            self._cache[key] = dict(self._simulator.simulate_run(case).robustness)
        return self._cache[key]

    def find_shortest(self, case: Case, requirement: str) -> Case:
        """Return the run, ended as soon as it has failed.

        A requirement that is not decided yet may fail because time is short; so an end counts only
        if the run without changes holds there.
        """
        period = self._campaign.scene.servo_period
        plain = self.keep_only([])
        low, high = 0, max(1, count_ticks(self._campaign.nominal[0].seconds, period))
        while high - low > 1:
            middle = (low + high) // 2
            ended = replace(case, seconds=middle * period)
            holds = self.compute_margins(replace(plain, seconds=ended.seconds))[requirement] >= 0.0
            if holds and not self.compute_margins(ended)[requirement] >= 0.0:
                high = middle
            else:
                low = middle
        return replace(case, seconds=high * period)


def write_shrunk(campaign: Campaign, shrunk: Shrunk, folder: Path) -> Path:
    """Write a campaign whose only run is the failure into a folder, which is made; return its file.

    Raises:
        Refusal: it cannot be written.
    """
    file, data = folder / "campaign.yaml", _make_campaign(campaign, shrunk, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise Refusal("campaign", f"folder {folder}", "be writable", error.strerror) from None
    return file


def _make_campaign(campaign: Campaign, shrunk: Shrunk, folder: Path) -> dict[str, Any]:
    """Return the campaign of one run, whose files are named from the new folder."""
    data = {
        key: value
        for key, value in campaign.data.items()
        if key not in ("vary", "correlate", "sampling", "search", "stop", "measures", "count")
    }
    beside, period = campaign.file.parent, campaign.scene.servo_period

    def join_folder(name: str) -> str:
        return make_path(folder, beside / name) if (beside / name).is_file() else name

    data["scene"] = join_folder(data["scene"])
    data["scenario"] = dict(data["scenario"]) | {"seconds": shrunk.seconds}
    if "table" in data["scenario"]:
        data["scenario"]["table"] = join_folder(data["scenario"]["table"])
    controller = dict(data.get("controller") or {})
    data["controller"] = controller | {
        key: join_folder(controller[key]) for key in ("servo", "motion") if key in controller
    }
    requirement = campaign.requirements[shrunk.requirement]
    if isinstance(requirement, Mapping) and "python" in requirement:
        file, _, function = str(requirement["python"]).partition(":")
        requirement = {**requirement, "python": f"{join_folder(file)}:{function}"}
    data["requirements"] = {shrunk.requirement: requirement}
    noise = {
        f"noise_{k}": {"kind": "number", "name": "seed", "value": seed, "at": tick * period}
        for k, (tick, seed) in enumerate(shrunk.case.reseeds)
        if tick * period < shrunk.seconds
    }
    data["faults"] = {name: campaign.data["faults"][name] for name in shrunk.faults} | noise
    vary = dict(shrunk.changes)
    if campaign.scene.has_sensor_errors and "seed" not in vary:
        vary["seed"] = shrunk.case.seed
    data |= {"vary": vary, "count": 1}
    return {key: value for key, value in data.items() if value not in ({}, None)}


def make_path(folder: Path, file: Path) -> str:
    """Return how a file is named in files of a folder."""
    return os.path.relpath(file.absolute(), folder.absolute())
