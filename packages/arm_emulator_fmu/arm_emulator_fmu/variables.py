"""Variables of a unit: one list, from which its XML and its C++ are generated."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from arm_emulator.extension.machine import (
    OUTPUT_AXES,
    Output,
    Scene,
    Varied,
    find_input,
    list_further_inputs,
    list_input_units,
    list_outputs,
    list_rows,
    list_units,
)
from arm_emulator_fmu.names import Parts

# Of outputs, by their kind.
_TYPES = {"number": "Float64", "count": "Int64", "bits": "Int32", "flag": "Boolean"}
# The masses of links, arm_emulator/machine/varied.py, by the beginning of their names.
_LINK_UNITS = {"mass": "kg", "moment": "kg m", "inertia": "kg m2"}


@dataclass(frozen=True)
class Variable:
    """A variable; its value reference is its place in the list.

    Attributes:
        name: parts of its name.
        symbol: where its values are in `struct Data` of data.hpp; [] where they are an array's.
        type: Float64, Int64, Int32 or Boolean.
        role: independent, fixed, tunable, input or output.
        description: what it is.
        units: of its values; one for each of `joints` if there are any, else one or none.
        first: its first value in the array.
        rule: what values must satisfy that are set, of `enum class Rule` in variable.hpp.
        shape: of its array; () of a single number.
        start: values that it begins with, in a row; None of outputs.
        bounds: least and largest value.
        joints: names of those that its first index counts, base to tool.
        element: which element of an array it is, from 1; None: none.
    """

    name: Parts
    symbol: str
    type: str
    role: str
    description: str
    units: tuple[str, ...] = ()
    first: int = 0
    rule: str = "finite"
    shape: tuple[int, ...] = ()
    start: tuple[float, ...] | None = None
    bounds: tuple[float, float] | None = None
    joints: tuple[str, ...] = ()
    element: int | None = None

    @property
    def count(self) -> int:
        """Number of its values."""
        return math.prod(self.shape)

    @property
    def has_effect_at_start(self) -> bool:
        """Whether outputs at the start depend on it; other inputs decide on what comes after."""
        return self.role in ("fixed", "tunable") or self.symbol == "values.now.power"

    @property
    def unit(self) -> str | None:
        """Unit of all its values; None if they have no unit, or differ."""
        return self.units[0] if len(set(self.units)) == 1 else None


def list_variables(scene: Scene) -> tuple[Variable, ...]:
    """Return the variables of a scene's machine, in the order of their value references."""
    time = Variable(("time",), "shown.time", "Float64", "independent", "simulation time", ("s",))
    return (
        time,
        *_list_inputs(scene),
        *_list_parameters(scene),
        *_list_measurements(scene),
        *_list_truth(scene),
    )


def list_scalars(scene: Scene) -> tuple[Variable, ...]:
    """Return the same without arrays, for FMI 2: a variable per joint, named after it.

    Time is no variable there, for some importers miss a start value of it, which it must not have.
    """
    scalars: list[Variable] = []
    for array in list_variables(scene)[1:]:
        rows = _split_joints(array) if array.joints else [array]
        for row in rows:
            scalars += _split_elements(row) if row.shape else [row]
    return tuple(scalars)


def _split_joints(array: Variable) -> list[Variable]:
    each = array.count // len(array.joints)
    quantity, _, _ = array.description.partition(", base to tool")
    return [
        replace(
            array,
            name=(*array.name, joint),
            description=f"{quantity}: {joint}",
            units=array.units[j : j + 1],
            first=array.first + j * each,
            shape=array.shape[1:],
            start=None if array.start is None else array.start[j * each : (j + 1) * each],
            joints=(),
        )
        for j, joint in enumerate(array.joints)
    ]


def _split_elements(array: Variable) -> list[Variable]:
    return [
        replace(
            array,
            first=array.first + k,
            shape=(),
            start=None if array.start is None else array.start[k : k + 1],
            element=k + 1,
        )
        for k in range(array.count)
    ]


def _list_inputs(scene: Scene) -> list[Variable]:
    N = len(scene.joints)
    zero = (0.0,) * N
    commands = tuple(joint.unit for joint in scene.joints)
    about = "command to each motor, held over the step"
    inputs = [_make_input(scene, "command", "Float64", about, commands, start=zero, rule="command")]
    for k, name in enumerate(list_further_inputs(scene)):
        abouts = (
            part_input.about for joint in scene.joints if (part_input := find_input(joint, name))
        )
        about, units = " or ".join(dict.fromkeys(abouts)), list_input_units(scene, name)
        row = _make_input(scene, name, "Float64", about, units, start=zero, rule="further")
        inputs.append(replace(row, symbol="values.now.further[]", first=N * k))
    about = "whether each drive is enabled"
    inputs.append(_make_input(scene, "enable", "Boolean", about, (), start=(1.0,) * N))
    if any(joint.brake for joint in scene.joints):
        about = "whether each brake closes though its drive is enabled"
        inputs.append(_make_input(scene, "close_brake", "Boolean", about, (), start=zero))
    about = "power of all drives"
    inputs.append(Variable(("power",), "values.now.power", "Boolean", "input", about, start=(1.0,)))
    if scene.external_wrench:
        scene.refuse_bearings("external wrenches of an FMU")
        for name, unit, about in (
            ("force", "N", "external force on the link that each joint moves"),
            ("moment", "N m", "external moment on the link that each joint moves"),
            ("point", "m", "where the external force acts, in the frame of each link"),
        ):
            moved = tuple(link.name for link in scene.chain.links)
            shape = len(moved), OUTPUT_AXES
            symbol, units = f"values.now.external_{name}[]", (unit,) * len(moved)
            more = {"rule": "wrench", "shape": shape, "start": (0.0,) * math.prod(shape)}
            inputs.append(
                _make_row(
                    moved, ("external", name), symbol, "Float64", "input", about, units, **more
                )
            )
        about = "whether external forces and moments are in axes of the world, not of the links"
        name_ = ("external", "world_axes")
        symbol = "values.now.external_world_axes"
        inputs.append(Variable(name_, symbol, "Boolean", "input", about, start=(0.0,)))
    return inputs


def _list_parameters(scene: Scene) -> list[Variable]:
    q = tuple(joint.start for joint in scene.joints)
    v = (0.0,) * len(q)
    parameters = [
        _make_row(scene.joint_names, ("start", name), f"values.start_{name}[]", "Float64", "fixed",
             f"{quantity} of each joint at the start", units, start=start, rule=f"start_{name}")
        for name, quantity, units, start in (
            ("q", "position", _list_links(scene, "rad", "m"), q),
            ("v", "speed", _list_links(scene, "rad/s", "m/s"), v),
        )
    ]  # fmt: skip
    units = _list_varied_units(scene)
    for k, number in enumerate(scene.varied):
        parameters.append(
            Variable(
                _list_parts(number, scene),
                "values.parameter[]",
                "Float64",
                "tunable",
                f"{number.name} of the scene",
                tuple(filter(None, (units.get(number.name),))),
                first=k,
                rule="parameter",
                start=(number.value,),
                bounds=number.number.ends,
            )
        )
    return parameters


def _list_measurements(scene: Scene) -> list[Variable]:
    outputs = list_outputs(scene)
    measurements = [_make_output(scene, output) for output in outputs if not output.per_unit]
    about = "whether the drives have power"
    measurements.append(Variable(("powered",), "shown.powered", "Boolean", "output", about))
    for m, imu in enumerate(scene.imus):
        for output in outputs:
            if output.per_unit:
                about = f"{output.name.replace('_', ' ')} by {imu.name}, in its frame"
                name, symbol = (output.name, imu.name), _name_in_unit(output, m)
                unit, shape = (output.unit,), (OUTPUT_AXES,)
                measurements.append(
                    Variable(name, symbol, "Float64", "output", about, unit, shape=shape)
                )
    return measurements


def _make_output(scene: Scene, output: Output) -> Variable:
    array, _, field = output.symbol.partition(".")
    symbol = f"shown.{array}[]" + (f".{field}" if field else "")
    rows = list_rows(scene).get(array)
    first = 0 if rows is None else len(scene.joints) * rows.index(output.name)
    kind, units = _TYPES[output.kind], list_units(scene, output)
    name, about = (output.name,), output.about
    return _make_row(scene.joint_names, name, symbol, kind, "output", about, units, first=first)


def _name_in_unit(output: Output, unit: int) -> str:
    array, _, field = output.symbol.partition(".")
    return f"shown.{array}[{unit}].{field}[]"


def _list_truth(scene: Scene) -> list[Variable]:
    N = len(scene.joints)
    joints = scene.joint_names
    truths = [
        _make_row(joints, ("truth", name), f"truth.{name}[]", "Float64", "output", about, units)
        for name, about, units in (
            ("q", "true position of each joint", _list_links(scene, "rad", "m")),
            ("v", "true speed of each joint", _list_links(scene, "rad/s", "m/s")),
            ("gear_torque", "true torque of each gear on its link", _list_links(scene, "N m", "N")),
            ("motor_angle", "true angle of each motor", ("rad",) * N),
            ("motor_speed", "true speed of each motor", ("rad/s",) * N),
            ("current", "true current of each motor", ("A",) * N),
        )
    ]
    of_energy = ("truth", "energy")
    about = "kinetic, potential, elastic and magnetic energy"
    truths.append(Variable(of_energy, "truth.energy", "Float64", "output", about, ("J",)))
    for j, joint in enumerate(scene.joints):
        for output in (truth for part in joint.parts for truth in part.truths):
            name, symbol = ("truth", output.name, joint.name), f"truth.{output.symbol}[]"
            about = f"{output.about} of {joint.name}"
            unit = (output.unit,)
            truths.append(Variable(name, symbol, "Float64", "output", about, unit, first=j))
    return truths


def _make_input(
    scene: Scene, name: str, type_: str, about: str, units: tuple[str, ...], **more: Any
) -> Variable:
    """Return a value per joint that the machine is given; `more`: further fields of it."""
    symbol = f"values.now.{name}[]"
    return _make_row(scene.joint_names, (name,), symbol, type_, "input", about, units, **more)


def _make_row(
    joints: tuple[str, ...],
    name: Parts,
    symbol: str,
    type_: str,
    role: str,
    about: str,
    units: tuple[str, ...],
    **more: Any,
) -> Variable:
    """Return a variable with a value per joint; `more`: further fields of it."""
    each = joints
    if len(set(units)) > 1:
        each = tuple(f"{joint} [{unit}]" for joint, unit in zip(joints, units, strict=True))
    description = f"{about}, base to tool: {', '.join(each)}"
    fields: dict[str, Any] = {"shape": (len(joints),), "joints": joints, **more}
    return Variable(name, symbol, type_, role, description, units, **fields)


def _list_links(scene: Scene, revolute: str, prismatic: str) -> tuple[str, ...]:
    kinds = [joint.kind for joint in scene.chain.joints]
    return tuple(prismatic if kind == "prismatic" else revolute for kind in kinds)


def _list_parts(varied: Varied, scene: Scene) -> Sequence[str]:
    """Return the parts of the name of a varied number; names in it may have dots."""
    group, _, rest = varied.name.partition(".")
    owners_by_group = {
        "joints": scene.joint_names,
        "links": tuple(link.link for link in scene.chain.bodies.values()),
        "imus": tuple(imu.name for imu in scene.imus),
    }
    owners = (
        sum(owners_by_group.values(), ()) if group == "faults" else owners_by_group.get(group, ())
    )
    for owner in sorted(owners, key=len, reverse=True):
        if rest.startswith(f"{owner}."):
            return (group, owner, *rest[len(owner) + 1 :].split("."))
    return varied.name.split(".")


def _list_varied_units(scene: Scene) -> dict[str, str]:
    """Return the units of numbers that may be varied, where they are known.

    Those of parts are declared for joints that turn; of joints that slide they are left out.
    """
    units = {"payload.mass": "kg"}
    for link in scene.chain.bodies.values():
        for name, unit in _LINK_UNITS.items():
            for tail in ("", *(f"_{x}" for x in (*"xyz", "xx", "yy", "zz", "xy", "xz", "yz"))):
                units[f"links.{link.link}.{name}{tail}"] = unit
    for geometry, joint in zip(scene.chain.joints, scene.joints, strict=True):
        if geometry.kind == "prismatic":
            continue
        for part in (*joint.parts, *joint.sensors.parts.values()):
            for key, number in part.list_numbers().items():
                units[f"{part.owners}.{joint.name}.{part.section}.{key}"] = number.unit
    for imu in scene.imus:
        for three in (imu.accelerometer, imu.gyroscope):
            if three is not None:
                for key, number in three.list_numbers().items():
                    units[f"imus.{imu.name}.{three.section}.{key}"] = number.unit
    return units
