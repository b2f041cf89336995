"""Inputs and outputs that parts declare, as objects of CiA 402 drives; see core/declared.hpp."""

import zlib

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Refusal, escape_c_string
from arm_emulator.extension.machine import (
    COMMAND_OUTPUT,
    KNOWN_OUTPUTS,
    PARTS,
    Input,
    Output,
    Part,
    Scene,
    find_input,
    list_further_inputs,
    list_outputs,
    list_rows,
)

FIRST, COUNT = 0x2100, 0xF00  # objects of a manufacturer
_TYPES = {"number": "real32", "count": "integer32", "flag": "unsigned8", "bits": "unsigned8"}
_UNITS = {"count": ("counts",)}
_IN_C = {"readings": "readings[at.in_rows()]", "further": "further[at.in_rows()]"}


def _choose_indices() -> dict[str, int]:
    names = [value.name for value in KNOWN_OUTPUTS.values() if not value.cia]
    names += dict.fromkeys(part_input.name for kind in PARTS for part_input in _list_inputs(kind))
    indices: dict[str, int] = {}
    for name in names:
        # By its name, so that other parts in a later version change nothing.
        place = zlib.crc32(name.encode())
        while FIRST + place % COUNT in indices.values():
            place += 1
        indices[name] = FIRST + place % COUNT
    return dict(sorted(indices.items(), key=lambda pair: pair[1]))


def _list_inputs(kind: type[Part]) -> tuple[Input, ...]:
    return tuple(getattr(kind, "inputs", ())[1:])


_INDICES = _choose_indices()

# Names of what has such an object, by index; of other outputs a drive has objects by itself.
REPORTED = tuple(KNOWN_OUTPUTS[name] for name in _INDICES if name in KNOWN_OUTPUTS)
TAKEN = tuple(name for name in _INDICES if name not in KNOWN_OUTPUTS)


def find_index(output: Output | Input) -> int:
    """Return the object of an output, or of a further input."""
    return output.cia if isinstance(output, Output) and output.cia else _INDICES[output.name]


def write_source() -> str:
    """Return the lists in C++."""
    reported = "".join(f"{{{_format_output(output)}}},\n" for output in REPORTED)
    taken = "".join(f"{{{_format_input(name)}}},\n" for name in TAKEN)
    return (
        '#include "declared.hpp"\nnamespace fieldbus {\n'
        f"inline constexpr std::array<Reported, {len(REPORTED)}> kReported{{{{\n{reported}}}}};\n"
        f"inline constexpr std::array<Taken, {len(TAKEN)}> kTaken{{{{\n{taken}}}}};\n}}\n"
    )


def _format_texts(name: str, *units: str) -> str:
    unit = " or ".join(dict.fromkeys(filter(None, units)))
    return ", ".join(map(escape_c_string, (name.replace("_", " ").capitalize(), unit)))


def _format_input(name: str) -> str:
    units = [
        part_input.unit
        for kind in PARTS
        for part_input in _list_inputs(kind)
        if part_input.name == name
    ]
    return f"0x{_INDICES[name]:04X}, {_format_texts(name, *units)}"


def _format_output(output: Output) -> str:
    array, _, field = output.symbol.partition(".")
    place = _IN_C.get(array, f"{array}[at.joint]")
    if output.per_unit:
        place, field = f"{array}[at.row]", f"{field}[at.axis]"
    units = _UNITS.get(output.kind, (output.unit, output.unit_of_slides))
    members = (
        f"0x{_INDICES[output.name]:04X}",
        _format_texts(output.name, *(unit for unit in units if unit != COMMAND_OUTPUT)),
        f"Type::{_TYPES[output.kind]}",
        str(output.per_unit).lower(),
        "[](const arm_measurement& all, [[maybe_unused]] Place at) { "
        f"return word(all.{place}{field and '.'}{field}); }}",
    )
    return ", ".join(members)


def find_places(scene: Scene, units: int) -> NDArray[np.int32]:
    """Return where each of `REPORTED` is at each joint, by joint, output and unit on its link.

    Args:
        scene: of the machine.
        units: on a link, at most.

    Raises:
        Refusal: a link has more units.
    """
    shafts = (scene.chain.coupling.C != 0.0).argmax(axis=1)  # the first that moves each link
    joints = np.searchsorted(scene.joint_places, shafts, side="right") - 1  # deflections follow
    on = [
        [m for m, imu in enumerate(scene.imus) if joints[imu.place] == j]
        for j in range(len(scene.joints))
    ]
    for joint, there in zip(scene.joints, on, strict=True):
        if len(there) > units:
            rule = f"be at most {units} on the link of {joint.name}, for drives on a field bus"
            raise Refusal(scene.where, "imus", rule, len(there))
    places = np.full((len(scene.joints), len(REPORTED), units), -1, np.int32)
    rows, reported = list_rows(scene), list_outputs(scene)
    for k, output in enumerate(REPORTED):
        if output not in reported:
            continue
        if output.per_unit:
            for j, there in enumerate(on):
                places[j, k, : len(there)] = there
        else:
            of_array = rows.get(output.symbol, ())
            places[:, k, 0] = of_array.index(output.name) if of_array else 0
    return places


def find_input_rows(scene: Scene) -> NDArray[np.int32]:
    """Return the row in C of each of `TAKEN` at each joint; -1: its motor has no such input."""
    names = list_further_inputs(scene)
    return np.array(
        [
            [names.index(name) if find_input(joint, name) else -1 for name in TAKEN]
            for joint in scene.joints
        ],
        np.int32,
    ).reshape(len(scene.joints), len(TAKEN))
