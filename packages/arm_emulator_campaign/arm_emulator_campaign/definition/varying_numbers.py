"""Numbers of a campaign that vary, and those that vary together."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from arm_emulator.extension.base import Number, Refusal, Section, list_numbers
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.runs import ServoConfig
from arm_emulator_campaign.definition.fault import list_faults
from arm_emulator_campaign.sampling.distributions import parse_distribution
from arm_emulator_campaign.sampling.variation import Varying

VARYING_SECTIONS = ("scenario", "faults", "controller")  # sections whose numbers can vary
CORRELATION = Number("by", at_least=-1.0, at_most=1.0, text="correlation of each with each")


def read_varying(
    root: Section,
    patterns: Sequence[str],
    scene: Scene,
    servo: ServoConfig,
    data: Mapping[str, Any],
) -> list[Varying]:
    """Return what varies, in the order of the file."""
    nominal_values = {number.name: (number.number.unit, number.value) for number in scene.varied}
    for name, value in list_leaves(data.get("scenario")):
        nominal_values[f"scenario.{name}"] = "", value
    faults = root.get_section("faults")
    for fault in () if faults is None else faults.list_keys():
        kind = list_faults()[data["faults"][fault]["kind"]]
        for name, value in list_leaves(data["faults"][fault]):
            nominal_values[f"faults.{fault}.{name}"] = kind.get_unit(name.split(".")[0]), value
    for joint in servo.joints:
        for name, number in list_numbers(type(joint)).items():
            value = getattr(joint, name)
            nominal_values[f"controller.joints.{joint.name}.{name}"] = number.unit, value
    section_of_vary = root.get_section("vary")
    varying: dict[str, Varying] = {}
    for pattern in patterns:
        assert section_of_vary is not None
        quantity = f"vary.{pattern}"
        distribution = parse_distribution(section_of_vary.read_value(pattern), root.where, quantity)
        names = fnmatch.filter(nominal_values, pattern)
        if not names:
            prefix = pattern.split(".")[0]
            valid = ", ".join(name for name in nominal_values if name.startswith(prefix)) or "none"
            raise Refusal(root.where, quantity, "name existing numbers", pattern, valid)
        for name in names:
            if name in varying:
                raise Refusal(root.where, quantity, "name each number once", name)
            unit, value = nominal_values[name]
            varying[name] = Varying(name, unit, distribution, float(value))
    return list(varying.values())


def read_correlations(root: Section, names: Sequence[str]) -> list[tuple[list[str], float]]:
    """Return groups of these names, and the correlation of each with each."""
    pairs = []
    for place, entry in enumerate(root.read_entries("correlate")):
        root.set_value(f"correlate.{place}", entry)
        section = root.require_section(f"correlate.{place}")
        patterns = section.read_entries("between")
        of = [name for name in names if any(fnmatch.fnmatch(name, str(p)) for p in patterns)]
        missing = [str(p) for p in patterns if not fnmatch.filter(names, str(p))]
        if missing or len(of) < 2:
            patterns_text = ", ".join(missing) or ", ".join(of) or "none"
            raise section.make_refusal(
                "between", "name two numbers that vary", patterns_text, ", ".join(names)
            )
        pairs.append((of, section.read_number(CORRELATION)))
        section.refuse_unread_keys()
    return pairs


def list_leaves(data: object, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield all numbers below a section, by their dotted names."""
    items: Any = ()
    if isinstance(data, dict):
        items = data.items()
    elif isinstance(data, list):
        items = enumerate(data)
    elif isinstance(data, int | float) and not isinstance(data, bool):
        yield path, float(data)
    for key, value in items:
        yield from list_leaves(value, f"{path}.{key}" if path else str(key))
