"""Outputs of a machine, as its parts declare them."""

from collections.abc import Iterable, Iterator
from typing import ClassVar, Protocol

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.parts.measuring.sensors import SENSORS
from arm_emulator.machine.parts.output import COMMAND, FAULTS, FURTHER, READINGS, Output
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.inputs import find_input, list_further_inputs, list_input_units
from arm_emulator.machine.scene.known_parts import MOTORS, PARTS
from arm_emulator.machine.scene.scene import Scene

# Of every drive, whatever its parts.
_COUNTS = Output(
    "encoder_counts",
    "counts of the encoder at each motor",
    "joint.encoder",
    kind="count",
    cia=0x6063,
)
_CURRENT = Output(
    "current", "current of each motor, by its sensor", "joint.current", "A", cia=0x2005
)
_APPLIED = Output(
    "applied",
    "command that acted on each motor in the past servo period",
    "joint.applied",
    COMMAND,
    cia=0x2006,
)
ALWAYS = (_COUNTS, _CURRENT, _APPLIED, FAULTS)


class OutputSource(Protocol):
    """A kind of part, or of unit, with outputs."""

    outputs: ClassVar[tuple[Output, ...]]


def _list_declared(owners: Iterable[type[OutputSource]]) -> list[Output]:
    declared: dict[Output, None] = {}
    for owner in owners:
        declared |= dict.fromkeys(owner.outputs)
    return list(declared)


# All outputs of parts, by name, in the order of all lists.
KNOWN: dict[str, Output] = {
    output.name: output
    for output in (
        *(_COUNTS, _CURRENT),
        *_list_declared(MOTORS),
        *(_APPLIED, FAULTS),
        *_list_declared((*PARTS, *SENSORS)),
    )
}


def _list_symbols() -> Iterator[str]:
    for name, field in ARM.ffi.typeof("arm_measurement").fields:
        if field.type.kind == "pointer":
            array = field.type.item
            yield from (
                [f"{name}.{member}" for member, _ in array.fields]
                if array.kind == "struct"
                else [name]
            )


SYMBOLS = set(_list_symbols())  # where arm.h has outputs


def list_outputs(scene: Scene) -> tuple[Output, ...]:
    """Return the outputs of a scene's parts.

    Raises:
        Refusal: an output that is declared without a place in arm.h.
    """
    there = {*ALWAYS, *_list_reported(scene)}
    for output in there:
        if KNOWN.get(output.name) != output or output.symbol not in SYMBOLS:
            rule = "be declared by its class, with a place in arm.h as its symbol"
            actual, valid = repr(output.symbol), ", ".join(sorted(SYMBOLS))
            raise Refusal(scene.where, f"output {output.name}", rule, actual, valid)
    return tuple(value for value in KNOWN.values() if value in there)


def _list_reported(scene: Scene) -> set[Output]:
    parts = (
        part for joint in scene.joints for part in (*joint.parts, *joint.sensors.parts.values())
    )
    of_units = (output for unit in scene.imus for output in unit.outputs)
    return {*of_units, *(output for part in parts for output in part.reports)}


def list_reported_by_parts(scene: Scene) -> tuple[Output, ...]:
    """Return the outputs that a part of a scene declares."""
    there = _list_reported(scene)
    return tuple(output for output in list_outputs(scene) if output in there)


def list_readings(scene: Scene) -> tuple[Output, ...]:
    """Return the outputs in ``arm_measurement.readings``, a row each."""
    return tuple(output for output in list_outputs(scene) if output.symbol == READINGS)


def find_output_input(scene: Scene, output: Output) -> str:
    """Return the further input whose applied value an output reports."""
    return next(
        name
        for name in list_further_inputs(scene)
        for joint in scene.joints
        if (input_ := find_input(joint, name)) and input_.applied == output.name
    )


def list_units(scene: Scene, output: Output) -> tuple[str, ...]:
    """Return the unit of an output at each joint; none where its values have none."""
    if output.unit == COMMAND:
        return tuple(joint.unit for joint in scene.joints)
    if output.symbol == FURTHER:
        return list_input_units(scene, find_output_input(scene, output))
    if not output.unit:
        return ()
    return tuple(output.choose_unit(joint.kind) for joint in scene.chain.joints)
