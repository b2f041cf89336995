"""Parameters declared once, as frozen dataclasses: for ROS nodes and for runs without ROS."""

import dataclasses
import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import (
    REQUIRED,
    Ends,
    Number,
    build_bounds,
    declare_field,
    list_numbers,
)

Parameters = TypeVar("Parameters")

# Parameters that every ROS 2 node has.
ROS_PARAMETERS = (
    "autostart",
    "qos_overrides",
    "start_type_description_service",
    "use_sim_time",
)


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    ends: Ends = (None, None),
    choices: tuple[str, ...] = (),
    settable: bool = False,
) -> Any:
    """Return a dataclass field with the declaration of a parameter: default, unit, range, choices.

    `settable` ones can be set while the node runs, the others are read once at its start.
    """
    more = {"description": description, "choices": choices, "settable": settable}
    if type(default) not in (int, float):
        return dataclasses.field(default=default, metadata=more)
    is_integer = type(default) is int
    number = Number(
        "", unit, whole=is_integer, default=default, text=description, **build_bounds(ends)
    )
    return declare_field(number, **more | {"description": number.described})


def list_parameters(kind: type[Any]) -> dict[str, dataclasses.Field[Any]]:
    """Return the fields of a dataclass that are parameters, by name."""
    return {field.name: field for field in dataclasses.fields(kind) if field.metadata}


def load_parameters(
    path: Path, node: str, kind: type[Parameters], beside: tuple[str, ...] = ()
) -> tuple[Parameters, dict[str, Any]]:
    """Read a node's ROS parameter file into the frozen dataclass `kind`.

    Returns:
        The parameters; and the sections whose names begin with `beside`, unchanged.

    Raises:
        Refusal: no parameters of that node, an unknown name, or a refused value.
    """
    values, sections = dict(read_ros_parameters(path, node)), dict[str, Any]()
    fields = list_parameters(kind)
    for name, value in list(values.items()):
        first, _, rest = name.partition(".")
        if first in beside:
            section = value if not rest else {rest: value}
            if isinstance(section, Mapping):
                sections.setdefault(first, {}).update(section)
            else:
                raise Refusal(path.name, f"section {first}", "be a mapping", repr(value))
            del values[name]
            continue
        if name not in fields:
            names = ", ".join((*fields, *beside))
            actual = f"{value!r}{suggest_nearest_name(name, fields)}"
            raise Refusal(path.name, f"parameter {name}", "be known", actual, names)
        values[name] = check_parameter(value, fields[name], path.name)
    return kind(**values), sections


def read_ros_parameters(path: Path, node: str) -> Mapping[str, Any]:
    """Return the parameters that a ROS parameter file holds for a node, by name or wildcard.

    Raises:
        Refusal: no parameters of that node.
    """
    document = read_yaml(path)
    for name in (node, f"/{node}", f"/**/{node}", "/**"):
        section = document.get(name)
        if isinstance(section, Mapping) and isinstance(section.get("ros__parameters"), Mapping):
            _check_keys(section["ros__parameters"], path.name)
            return dict(section["ros__parameters"])
    rule = f"hold the parameters of the node {node}"
    valid = f"{node}: ros__parameters:"
    raise Refusal(path.name, "the file", rule, ", ".join(map(str, document)), valid)


def split_tables(section_table: object, where: str, section: str) -> dict[str, dict[str, Any]]:
    """Return the tables of a section by name; nested, or with ROS's dotted names.

    A table's name may have dots, a key has none.

    Raises:
        Refusal: no table, or a value in the place of one.
    """
    if not isinstance(section_table, Mapping):
        raise Refusal(where, section, "be a mapping", section_table)
    tables: dict[str, dict[str, Any]] = {}
    for name, value in section_table.items():
        if isinstance(value, Mapping):
            tables.setdefault(str(name), {}).update(value)
            continue
        table, _, key = str(name).rpartition(".")
        if not table:
            raise Refusal(where, f"{section}.{name}", "be a mapping", value)
        tables.setdefault(table, {})[key] = value
    return tables


def read_numbers(
    table: Mapping[str, Any], kind: type[Any], where: str, path: str = ""
) -> dict[str, Any]:
    """Return the numbers that a dataclass declares, as a table has them, or by default.

    Raises:
        Refusal: an unknown, missing or impossible value; `path` is that of the table.
    """
    declared, prefix = list_numbers(kind), f"{path}." if path else ""
    check_keys(table, declared, where, path)
    values = {key: number.default for key, number in declared.items()}
    for key, number in declared.items():
        if key in table:
            values[key] = number.check_value(where, table[key], f"{prefix}{key}")
        elif number.default is REQUIRED:
            raise Refusal(where, f"{prefix}{key}", "be given", "nothing")
    return values


def check_keys(table: Mapping[str, Any], keys: Iterable[str], where: str, path: str) -> None:
    """Refuse keys of the table at a path that are not known."""
    keys = tuple(keys)
    for key in table:
        if key not in keys:
            name = f"{path}.{key}" if path else str(key)
            actual = f"an unknown one{suggest_nearest_name(str(key), keys)}"
            raise Refusal(where, name, "be a known key", actual, ", ".join(keys))


def suggest_nearest_name(name: str, names: Iterable[str]) -> str:
    """Return a hint at the known name nearest to an unknown one, empty if none is near."""
    near = difflib.get_close_matches(name, list(names), n=1)
    return f", perhaps for {near[0]}" if near else ""


def _check_keys(parameters: Mapping[str, Any], where: str) -> None:
    """Refuse a section whose name has dots: ROS's own reader splits it."""
    for key, value in parameters.items():
        if not isinstance(value, Mapping):
            continue
        if "." in key:
            rule = "be written out, since it has dots and ROS would lose its way"
            raise Refusal(where, f"section {key}", rule, "a section", f"SECTION.{key}.NAME: VALUE")
        _check_keys(value, where)


def check_parameter(value: Any, field: dataclasses.Field[Any], where: str) -> Any:
    """Return a parameter's value if its rules hold.

    Raises:
        Refusal: a value of the wrong type, out of its range, or not among its choices.
    """
    label, kind, choices = f"parameter {field.name}", type(field.default), field.metadata["choices"]
    if (number := field.metadata.get("number")) is not None:
        return number.check_value(where, value, label)
    if choices and value not in choices:
        raise Refusal(where, label, "be known", repr(value), ", ".join(choices))
    if type(value) is not kind:
        rule = {bool: "be true or false", str: "be a text"}[kind]
        raise Refusal(where, label, rule, repr(value))
    return value
