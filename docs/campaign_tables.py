"""Keys of a campaign's file, as tables for its page."""

import inspect
from collections.abc import Callable, Iterable
from dataclasses import fields

from arm_emulator.base.validation.number import list_numbers
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator_campaign.definition import campaign_file
from arm_emulator_campaign.definition.fault import list_faults
from arm_emulator_campaign.definition.scenario import AT, SECONDS
from arm_emulator_campaign.definition.varying_numbers import CORRELATION
from arm_emulator_campaign.sampling.distributions import KINDS
from arm_emulator_campaign.search import METHODS


def _write_table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _list_distributions() -> str:
    rows = []
    for name, function in KINDS.items():
        arguments = [
            str(value).partition(":")[0]
            for value in inspect.signature(function).parameters.values()
        ]
        rows.append((f"`{name}({', '.join(arguments)})`", (function.__doc__ or "").strip()))
    return _write_table(("distribution", "values"), rows)


def _list_faults() -> str:
    rows = []
    for kind, fault in list_faults().items():
        numbers = [f"`{name}`: {number.described}" for name, number in list_numbers(fault).items()]
        others = [
            f"`{field.name}`" for field in fields(fault) if field.name not in list_numbers(fault)
        ]
        about = (fault.__doc__ or "").strip().partition("\n")[0]
        rows.append((f"`{kind}`", about, "<br>".join([*numbers, *others])))
    return _write_table(("kind", "what happens", "keys"), rows)


def _list_methods() -> str:
    rows = []
    for kind, method in METHODS.items():
        numbers = [f"`{name}`: {number.described}" for name, number in list_numbers(method).items()]
        about = (method.__doc__ or "").strip().partition("\n")[0]
        rows.append((f"`{kind}`", about, "<br>".join(numbers)))
    return _write_table(("method", "what it does", "keys"), rows)


def _list_numbers() -> str:
    of = {
        "count": campaign_file.COUNT,
        "seed": campaign_file.SEED,
        "stop.width": campaign_file.WIDTH,
        "stop.confidence": campaign_file.CONFIDENCE,
        "stop.seconds": campaign_file.WALL,
        "scenario.seconds": SECONDS,
        "scenario.targets.N.at, scenario.moves.N.at": AT,
        "correlate.N.by": CORRELATION,
    }
    return _write_table(
        ("key", "what it is"), ((f"`{name}`", number.described) for name, number in of.items())
    )


def _list_signals() -> str:
    from arm_emulator_campaign.judging.signals import list_signal_units

    scene = load_scene("three_axis")
    units: dict[str, str] = {}
    for name, unit in list_signal_units(scene).items():
        head, _, tail = name.rpartition(".")
        units[f"{head}.*" if tail in scene.joint_names else name] = unit
    return _write_table(("signal", "unit"), ((f"`{name}`", unit) for name, unit in units.items()))


TABLES: dict[str, Callable[[], str]] = {
    "distributions": _list_distributions,
    "faults": _list_faults,
    "methods": _list_methods,
    "numbers": _list_numbers,
    "signals": _list_signals,
}
