"""A campaign, and what its file means for one run after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.extension.base import Array, Refusal, Section
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.runs import MotionConfig, ServoConfig
from arm_emulator_campaign.definition.fault import Fault, list_faults
from arm_emulator_campaign.definition.scenario import Scenario, read_scenario
from arm_emulator_campaign.definition.servo_gains import change_gain
from arm_emulator_campaign.definition.varying_numbers import VARYING_SECTIONS
from arm_emulator_campaign.sampling.intervals import bound_share
from arm_emulator_campaign.sampling.variation import Variation
from arm_emulator_campaign.search.method import Method


@dataclass(frozen=True)
class Stop:
    """When a campaign ends before all of its runs are done.

    Attributes:
        width: of the intervals of all shares; 0: it is not looked at.
        confidence: of intervals.
        seconds: of time; 0: any.
    """

    width: float
    confidence: float
    seconds: float

    def compute_interval(self, hits: int, count: int) -> tuple[float, float]:
        """Return the interval of a share by the failures among so many runs.

        A campaign that may end by `width` looks at its runs several times, and ends sooner where
        its failures happen to be few. Half of the risk for each end makes up for it: without, 92.9
        and 87.5 % were covered for 95 and 90 % stated.
        """
        risk = 1.0 - self.confidence
        return bound_share(hits, count, 1.0 - (0.5 * risk if self.width > 0.0 else risk))


@dataclass(frozen=True)
class Campaign:
    """A campaign as its file has it.

    Attributes:
        file: that it was read from.
        scene: with all that varies as data of the machine.
        overrides: what the scene has in place of its file's values, as `load_scene` takes them.
        servo, motion: parameters of the controller, before what varies.
        data: the file's sections that are read anew where numbers in them vary.
        variation: of the numbers that vary.
        requirements: by name, as written: a formula, or a section with a function of Python.
        measures: by name, as written.
        count: of runs.
        stop: when it may end before.
        search: the method that chooses the runs; None: they are sampled.
        key: of all that decides what a run is, 32 bytes.
    """

    file: Path
    scene: Scene
    overrides: Mapping[str, Any]
    servo: ServoConfig
    motion: MotionConfig
    data: Mapping[str, Any]
    variation: Variation
    requirements: Mapping[str, Any]
    measures: Mapping[str, str]
    count: int
    stop: Stop
    search: Method | None
    key: bytes

    @property
    def where(self) -> str:
        """The file, for refusals."""
        return self.file.name

    @property
    def has_drawn_sections(self) -> bool:
        """Whether numbers of the file itself, or of the controller, vary."""
        return any(
            number.name.split(".")[0] in VARYING_SECTIONS for number in self.variation.numbers
        )

    @cached_property
    def nominal(self) -> tuple[Scenario, Mapping[str, Fault], ServoConfig]:
        """Scenario, faults and servo where nothing varies."""
        return self.bind_values({})

    def bind_values(
        self, values: Mapping[str, float]
    ) -> tuple[Scenario, Mapping[str, Fault], ServoConfig]:
        """Return scenario, faults and servo with values of what varies in them.

        Raises:
            Refusal: a value that is out of its range.
        """
        servo, varied_sections = self.servo, {name.split(".")[0] for name in values}
        nominal = self.nominal if values else None  # what does not vary is not read anew
        changed = {
            key
            for key in VARYING_SECTIONS
            if key in self.data and (nominal is None or key in varied_sections)
        }
        set_by_number = self._bind_numbers(values) if nominal and "faults" in changed else None
        if set_by_number is not None:
            changed.remove("faults")
        data = _copy_unshared({key: self.data[key] for key in changed})
        for name, value in values.items():
            section = name.split(".")[0]
            if section == "controller":
                servo = change_gain(servo, name, value, self.where)
            elif section in changed:
                _put_number(data, name.split("."), value)
        root = Section(data, self.where)
        root.has_key("controller")
        scenario = nominal[0] if nominal else None
        faults = set_by_number or (nominal[1] if nominal else {})
        if scenario is None or "scenario" in changed:
            section_of = root.require_section("scenario")
            scenario = read_scenario(section_of, self.scene, self.file.parent)
            section_of.refuse_unread_keys()
        if "faults" in changed:
            faults = _read_faults(root, self.scene)
        return scenario, faults, servo

    def bind_servos(self, names: Sequence[str], values: Array) -> list[ServoConfig]:
        """Return the servo of each run, or one of all where nothing of the controller varies.

        Args:
            names: of what varies.
            values: of runs (K, D).

        Raises:
            Refusal: a value that is out of its range.
        """
        places = [place for place, name in enumerate(names) if name.startswith("controller.")]
        servos = [self.servo]
        if places:
            servos *= len(values)
        for run, row in enumerate(values[:, places].tolist() if places else ()):
            for place, value in zip(places, row, strict=True):
                servos[run] = change_gain(servos[run], names[place], value, self.where)
        return servos

    @cached_property
    def _places(self) -> dict[str, tuple[str, list[str]]]:
        """Fault and path in it of each number of faults that varies."""
        places = {}
        for number in self.variation.numbers:
            section, _, rest = number.name.partition(".")
            of = [name for name in self.nominal[1] if rest.startswith(f"{name}.")]
            if section == "faults" and of:
                fault = max(of, key=len)
                places[number.name] = fault, rest[len(fault) + 1 :].split(".")
        return places

    def bind_faults(self, values: Mapping[str, Array]) -> Mapping[str, Fault]:
        """Return the faults of many runs, by name in the order of the file.

        What they set is checked where it is computed, see `make_change_rows`.

        Args:
            values: of what varies, an array of all runs for each (K,).

        Raises:
            Refusal: a value that is out of its range.
        """
        faults = self._bind_numbers(values)
        if faults is None:
            raise Refusal(self.where, "faults", "have numbers in their ranges", "another one")
        return faults

    def _bind_numbers(self, values: Mapping[str, float | Array]) -> dict[str, Fault] | None:
        """Return the faults with other numbers; None: their section must be read."""
        numbers: dict[str, list[tuple[Sequence[str], float | Array]]] = {}
        for name, value in values.items():
            if name.startswith("faults."):
                fault, path = self._places.get(name, ("", []))
                numbers.setdefault(fault, []).append((path, value))
        faults = dict(self.nominal[1])
        for fault, fault_numbers in numbers.items():
            varied_fault = faults[fault].replace_numbers(fault_numbers) if fault else None
            if varied_fault is None:
                return None
            if not any(isinstance(value, np.ndarray) for _, value in fault_numbers):
                varied_fault.check_scene(self.scene, f"{self.where}: faults.{fault}")
            faults[fault] = varied_fault
        return faults


def read_kind(section: Section) -> type[Fault]:
    """Return the kind of fault that a section names.

    Raises:
        Refusal: there is no such kind.
    """
    kinds = list_faults()
    kind = section.read_text("kind")
    if kind not in kinds:
        raise section.make_refusal("kind", "be a known fault", repr(kind), ", ".join(kinds))
    return kinds[kind]


def _read_faults(root: Section, scene: Scene) -> dict[str, Fault]:
    section = root.require_section("faults")
    faults = {}
    for name in section.list_keys():
        below = section.require_section(name)
        faults[name] = read_kind(below).read_section(below)
        faults[name].check_scene(scene, f"{root.where}: faults.{name}")
    section.refuse_unread_keys()
    return faults


def _copy_unshared(data: Any) -> Any:
    """Return a copy in which nothing is shared, as anchors of YAML do."""
    if isinstance(data, dict):
        return {key: _copy_unshared(value) for key, value in data.items()}
    return [_copy_unshared(value) for value in data] if isinstance(data, list) else data


def _put_number(data: Any, path: Sequence[str], value: float) -> None:
    """Put a number in its place, which is there; names of joints may have dots."""
    key: int | str = ""
    if isinstance(data, list):
        key, size = int(path[0]), 1
    else:
        sizes = range(len(path), 0, -1)
        size = next(size for size in sizes if ".".join(path[:size]) in data)
        key = ".".join(path[:size])
    if size == len(path):
        data[key] = value
    else:
        _put_number(data[key], path[size:], value)
