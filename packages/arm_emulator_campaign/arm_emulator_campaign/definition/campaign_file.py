"""A campaign's file, read once, and what it means for one run after the other."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.extension.base import (
    LARGEST_YAML_FILE,
    VERSION,
    Array,
    Number,
    Refusal,
    Section,
    find_beside,
    find_scene,
    read_bytes,
    read_yaml,
)
from arm_emulator.extension.machine import LARGEST_SEED, Scene, load_scene
from arm_emulator.extension.runs import (
    MotionConfig,
    ServoConfig,
    check_fit,
    load_motion_config,
    load_servo_config,
)
from arm_emulator_campaign.definition.fault import Fault, list_faults
from arm_emulator_campaign.definition.scenario import Scenario, read_scenario
from arm_emulator_campaign.definition.servo_gains import change_gain, change_gains
from arm_emulator_campaign.definition.varying_numbers import (
    VARYING_SECTIONS,
    read_correlations,
    read_varying,
)
from arm_emulator_campaign.sampling.intervals import bound_share
from arm_emulator_campaign.sampling.variation import SAMPLINGS, Variation, make_correlation
from arm_emulator_campaign.search import read_method
from arm_emulator_campaign.search.method import Method

COUNT = Number("count", at_least=1, at_most=10**12, whole=True, text="runs at most")
SEED = Number("seed", at_least=0, at_most=LARGEST_SEED, whole=True, default=0,
              text="another one draws other runs")  # fmt: skip
WIDTH = Number("width", at_least=1e-9, at_most=1.0, default=0.0,
               text="of the intervals of all shares of failures, at which it may end")  # fmt: skip
CONFIDENCE = Number("confidence", above=0.5, at_most=0.999999, default=0.95, text="of intervals")
WALL = Number("seconds", "s", above=0.0, at_most=1e9, default=math.inf, text="of wall time")
ALL = 1000  # runs of a campaign that states no count
KEYS = (
    *("scene", "set", "controller", "scenario", "vary", "correlate", "sampling", "faults"),
    *("requirements", "measures", "count", "stop", "seed", "search"),
)


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


def load_campaign(file: Path) -> Campaign:
    """Read a campaign's file.

    Raises:
        Refusal: a key or value that is not taken, there or in a file that it names.
    """
    data = read_yaml(file)
    root = Section(data, file.name)
    root.read_text("scene")
    controller = root.get_section("controller") or Section({}, file.name, "controller")
    files = find_files(data, file)
    for kind in ("servo", "motion"):
        controller.has_key(kind)
    scene_file = files["scene"]
    servo, motion = load_servo_config(files["servo"]), load_motion_config(files["motion"])
    servo = change_gains(servo, controller, file.name)
    patterns = _read_patterns(root)
    of_scene = [pattern for pattern in patterns if pattern.split(".")[0] not in VARYING_SECTIONS]
    scene, overrides = _load_varied_scene(root, scene_file, of_scene)
    check_fit(scene, servo, motion)
    count = root.read_integer(replace(COUNT, default=0))
    used = {"scene": read_bytes(scene_file, LARGEST_YAML_FILE), "urdf": scene.true_urdf.encode()}
    used |= {name: files[name].read_bytes() for name in ("servo", "motion")}
    used |= _read_named_files(data, file.parent)
    sampling = root.read_choice("sampling", SAMPLINGS, default=SAMPLINGS[0])
    numbers = read_varying(root, patterns, scene, servo, data)
    pairs = read_correlations(root, [number.name for number in numbers])
    correlation = make_correlation(pairs, numbers, file.name)
    levels = Variation(numbers, "random", bytes(32), 1).levels
    count = count or (levels if levels > 1 else ALL)
    key = _hash_definition(data, used, root, count if sampling == "latin" else 0)
    variation = Variation(numbers, sampling, key, count, correlation, file.name)
    stop = root.get_section("stop")
    campaign = Campaign(
        file=file,
        scene=scene,
        overrides=overrides,
        servo=servo,
        motion=motion,
        data=data,
        variation=variation,
        requirements=_read_texts(root, "requirements", (str, dict)),
        measures=_read_texts(root, "measures", (str,)),
        count=count,
        stop=_read_stop(stop or Section({}, file.name, "stop")),
        search=read_method(root, variation),
        key=key,
    )
    for section in (*VARYING_SECTIONS, "requirements", "measures"):
        root.has_key(section)
    controller.refuse_unread_keys()
    if stop is not None:
        stop.refuse_unread_keys()
    _check_keys(data, file.name)
    _check_times(campaign)
    return campaign


def find_files(data: Mapping[str, Any], file: Path) -> dict[str, Path]:
    """Return the files of ``scene``, ``servo`` and ``motion`` of a campaign's file.

    Raises:
        Refusal: one is not there.
    """
    root = Section(dict(data), file.name)
    beside = file.parent / root.read_text("scene")
    scene = find_scene(beside if beside.is_file() else root.read_text("scene"))
    controller = root.get_section("controller") or Section({}, file.name, "controller")
    paths = {"scene": scene}
    for key in ("servo", "motion"):
        paths[key] = _find_file(controller, key, file) or find_beside(scene, key)
    return paths


def _check_keys(data: Mapping[str, Any], where: str) -> None:
    """Refuse keys of the file that nobody knows; sections are asked on their own."""
    for key in data:
        if key not in KEYS:
            raise Refusal(where, f"key {key}", "be known", repr(key), ", ".join(KEYS))


def _check_times(campaign: Campaign) -> None:
    """Refuse faults of the file that begin when no run lasts so long."""
    scenario, faults, _ = campaign.nominal
    varied_names = {number.name for number in campaign.variation.numbers}
    for name, fault in faults.items():
        if {f"faults.{name}.at", "scenario.seconds"} & varied_names or fault.at < scenario.seconds:
            continue
        rule = f"be before the end of a run, {scenario.seconds:g} s"
        raise Refusal(campaign.where, f"faults.{name}.at", rule, fault.at)


def _find_file(section: Section, key: str, campaign: Path) -> Path | None:
    if not section.has_key(key):
        return None
    path = campaign.parent / section.read_text(key)
    if not path.is_file():
        raise section.make_refusal(key, "be a file beside the campaign's", section.read_text(key))
    return path


def _read_named_files(data: Mapping[str, Any], folder: Path) -> dict[str, bytes]:
    """Return the contents of further files that decide what a run is."""
    scenario = data.get("scenario")
    table = scenario.get("table") if isinstance(scenario, dict) else None
    named = [table] if isinstance(table, str) else []
    requirements = data.get("requirements")
    for requirement in requirements.values() if isinstance(requirements, dict) else ():
        if isinstance(requirement, dict) and isinstance(requirement.get("python"), str):
            named.append(requirement["python"].partition(":")[0])
    return {name: read_bytes(folder / name, 2**28) for name in named if (folder / name).is_file()}


def _hash_definition(
    data: Mapping[str, Any], used: Mapping[str, bytes], root: Section, count: int
) -> bytes:
    """Return the hash of all that decides what a run with an index is."""
    deciding = {key: value for key, value in data.items() if key not in ("count", "stop")}
    digest = hashlib.sha256(f"{VERSION} {root.read_integer(SEED)} {count}\0".encode())
    digest.update(json.dumps(deciding, sort_keys=True, default=str).encode())
    for name, content in sorted(used.items()):
        digest.update(f"\0{name} {len(content)}\0".encode())
        digest.update(content)
    return digest.digest()


def _read_stop(section: Section) -> Stop:
    width, confidence = section.read_number(WIDTH), section.read_number(CONFIDENCE)
    return Stop(width, confidence, section.read_number(WALL))


def _read_texts(root: Section, key: str, kinds: tuple[type, ...]) -> dict[str, Any]:
    section = root.get_section(key)
    if section is None:
        return {}
    texts = {}
    for name in section.list_keys():
        value = section.read_value(name)
        if not re.fullmatch(r"[A-Za-z_][\w-]*", name):
            raise section.make_refusal(name, "have a name of letters, digits, _ and -", repr(name))
        if not isinstance(value, kinds):
            raise section.make_refusal(name, "be a text", repr(value))
        texts[name] = value
    return texts


def _read_patterns(root: Section) -> list[str]:
    section = root.get_section("vary")
    if section is None:
        return []
    for name in section.list_keys():
        if section.read_value(name) is None:  # such as `1)` of {a: uniform(0, 1)}
            valid = "within braces a text with a comma needs quotes, {name: 'uniform(0, 1)'}"
            raise section.make_refusal(name, "have a distribution", "nothing", valid)
    return section.list_keys()


def _load_varied_scene(
    root: Section, file: Path, patterns: Sequence[str]
) -> tuple[Scene, Mapping[str, Any]]:
    """Return the scene, with all that varies as data of the machine, and its overrides."""
    scene_data = read_yaml(file)
    set_section = root.get_section("set")
    overrides: dict[str, Any] = {} if set_section is None else {
        key: set_section.read_value(key) for key in set_section.list_keys()
    }  # fmt: skip
    varied, of_faults = list(scene_data.get("varied") or []), dict[str, Section]()
    for kind, section in _read_kinds(root):
        overrides = kind.list_needed_keys({**scene_data, **overrides}) | overrides
        of_faults |= dict.fromkeys(kind.list_set_numbers(section), section)
    varied += of_faults
    scene = _load_changed_scene(file, overrides, root.where)
    if scene.has_sensor_errors:
        varied.append("seed")
        overrides = {"seed": scene.seed} | overrides
    if not patterns and not varied:
        return scene, overrides
    overrides = overrides | {"varied": [*varied, *patterns]}
    try:
        return load_scene(file, overrides), overrides
    except Refusal as no:
        if no.quantity != "varied":
            raise
        rule = "name a number that can vary"
        if no.got in of_faults:
            raise of_faults[no.got].make_refusal("name", rule, no.got, no.valid) from None
        valid = f"{no.valid}, or numbers of {', '.join(f'{group}.' for group in VARYING_SECTIONS)}"
        raise Refusal(root.where, f"vary.{no.got}", rule, no.got, valid) from None


def _load_changed_scene(file: Path, overrides: Mapping[str, Any], where: str) -> Scene:
    """Return a scene with overrides; a refusal names the file that has what is not taken."""
    try:
        return load_scene(file, overrides)
    except Refusal as no:
        load_scene(file)  # refuses its own
        raise Refusal(f"{where}, set", no.quantity, no.rule, no.got, no.valid) from None


def _read_kinds(root: Section) -> list[tuple[type[Fault], Section]]:
    """Return the kind of each fault, and its section."""
    faults = root.get_section("faults")
    sections = (
        [] if faults is None else [faults.require_section(name) for name in faults.list_keys()]
    )
    return [(_read_kind(section), section) for section in sections]


def _read_kind(section: Section) -> type[Fault]:
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
        faults[name] = _read_kind(below).read_section(below)
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
