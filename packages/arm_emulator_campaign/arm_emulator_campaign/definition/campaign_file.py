"""A campaign's file: its keys, and how they are read."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from arm_emulator.extension.base import (
    LARGEST_YAML_FILE,
    VERSION,
    Number,
    Refusal,
    Section,
    find_beside,
    find_scene,
    read_bytes,
    read_yaml,
)
from arm_emulator.extension.machine import LARGEST_SEED, Scene, load_scene
from arm_emulator.extension.runs import check_fit, load_motion_config, load_servo_config
from arm_emulator_campaign.definition.campaign import Campaign, Stop, read_kind
from arm_emulator_campaign.definition.fault import Fault
from arm_emulator_campaign.definition.servo_gains import change_gains
from arm_emulator_campaign.definition.varying_numbers import (
    VARYING_SECTIONS,
    read_correlations,
    read_varying,
)
from arm_emulator_campaign.sampling.variation import SAMPLINGS, Variation, make_correlation
from arm_emulator_campaign.search import read_method

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
    """Refuse unknown keys of the file; sections are asked on their own."""
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
    return [(read_kind(section), section) for section in sections]
