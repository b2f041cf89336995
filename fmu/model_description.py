"""modelDescription.xml of FMI 3.0, and what says how to compile the sources."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from emulator_node.scene import Scene
from fmu.names import convention, identifier, plain_text, written
from fmu.units import BASE, displayed_in, unit_of
from fmu.variables import Variable

TOOL = "arm_emulator"
# Categories of what is logged, as in instance.hpp.
LOG_CATEGORIES = {
    "logEvents": "reset, start, states that were set",
    "logStatusDiscard": "values and steps that are not taken; nothing has changed",
    "logStatusError": "calls that end the simulation, among them a machine that diverged",
}
_CAUSALITY = {"fixed": "parameter", "tunable": "parameter"}


def model_description(scene: Scene, variables: Sequence[Variable], token: str) -> bytes:
    """Return modelDescription.xml.

    Args:
        scene: the machine.
        variables: of it, in the order of their value references.
        token: that the binary expects.
    """
    naming = convention(one.name for one in variables)
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=plain_text(scene.name) or "arm",
        instantiationToken=token,
        description=f"{len(scene.joints)} joints with their drives, base to tool: "
        + plain_text(", ".join(scene.joint_names)),
        generationTool=TOOL,
        variableNamingConvention=naming,
    )
    period = repr(scene.servo_period)
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier(scene.name),
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        canHandleVariableCommunicationStepSize="true",
        fixedInternalStepSize=period,
    )
    root.append(_units(variables))
    categories = ET.SubElement(root, "LogCategories")
    for name, what in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=what)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=period)
    listed = ET.SubElement(root, "ModelVariables")
    for reference, one in enumerate(variables):
        listed.append(_variable(one, reference, naming))
    root.append(_structure(variables))
    return as_bytes(root)


def build_description(scene: Scene, source: str, options: str, definition: str) -> bytes:
    """Return sources/buildDescription.xml.

    Args:
        scene: the machine.
        source: the file to compile.
        options: of the compiler.
        definition: of its preprocessor, ``NAME=VALUE``.
    """
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(
        root, "BuildConfiguration", modelIdentifier=identifier(scene.name)
    )
    files = ET.SubElement(
        configuration, "SourceFileSet", language="C++20", compiler="gcc", compilerOptions=options
    )
    ET.SubElement(files, "SourceFile", name=source)
    name, _, value = definition.partition("=")
    ET.SubElement(files, "PreprocessorDefinition", name=name, value=value)
    ET.SubElement(files, "IncludeDirectory", name=".")
    ET.SubElement(configuration, "Library", name="pthread", external="true")
    return as_bytes(root)


def as_bytes(root: ET.Element) -> bytes:
    """Return an XML file."""
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def values(one: Variable) -> str:
    """Return the start values of a variable as XML writes them."""
    start = one.start or ()
    if one.type == "Boolean":
        return " ".join("true" if value else "false" for value in start)
    return " ".join(repr(float(value)) for value in start)


def _units(variables: Sequence[Variable]) -> ET.Element:
    root = ET.Element("UnitDefinitions")
    for name in dict.fromkeys(one.unit for one in variables if one.unit):
        unit = unit_of(name)
        element = ET.SubElement(root, "Unit", name=name)
        if unit.powers is not None:
            base = {base: str(unit.powers[base]) for base in BASE if base in unit.powers}
            if unit.offset:
                base["offset"] = repr(unit.offset)
            ET.SubElement(element, "BaseUnit", base)
        for displayed in unit.displayed:
            ET.SubElement(
                element, "DisplayUnit", name=displayed.name, factor=repr(displayed.factor)
            )
    return root


def _variable(one: Variable, reference: int, naming: str) -> ET.Element:
    continuous = one.type == "Float64"
    attributes = {
        "name": written(one.name, one.element, naming),
        "valueReference": str(reference),
        "description": plain_text(one.description),
        "causality": _CAUSALITY.get(one.role, one.role),
        "variability": one.role
        if one.role in _CAUSALITY
        else ("continuous" if continuous else "discrete"),
    }
    if one.unit and continuous:
        attributes["unit"] = one.unit
        displayed = displayed_in(one.unit)
        if displayed:
            attributes["displayUnit"] = displayed
    if one.bounds is not None:
        attributes["min"], attributes["max"] = map(repr, one.bounds)
    if one.start is not None:
        attributes["start"] = values(one)
    element = ET.Element(one.type, attributes)
    for size in one.shape:
        ET.SubElement(element, "Dimension", start=str(size))
    return element


def _structure(variables: Sequence[Variable]) -> ET.Element:
    root = ET.Element("ModelStructure")
    outputs = [k for k, one in enumerate(variables) if one.role == "output"]
    # What decides on the start of the motion; other inputs decide on what comes after it.
    begin = [
        k for k, one in enumerate(variables) if one.role in _CAUSALITY or one.quantity == "power"
    ]
    for k in outputs:
        ET.SubElement(root, "Output", valueReference=str(k), dependencies="")
    for k in outputs:
        ET.SubElement(
            root, "InitialUnknown", valueReference=str(k), dependencies=" ".join(map(str, begin))
        )
    return root
