"""modelDescription.xml of FMI 3.0 and 2.0, and the file that describes how to compile the sources.

That of FMI 2.0 does not list the sources: importers take those for C, or for C++ of another year.
They are there for people.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from arm_emulator.extension.base import escape_xml
from arm_emulator.extension.machine import Scene
from arm_emulator_fmu.names import find_convention, make_identifier, write_name
from arm_emulator_fmu.units import BASE, DISPLAYED, OFFSETS, find_powers
from arm_emulator_fmu.variables import Variable

TOOL = "arm_emulator"
# Categories of what is logged, as in log.hpp.
LOG_CATEGORIES = {
    "logEvents": "reset, start, states that were set",
    "logStatusDiscard": "values and steps that are not taken; nothing has changed",
    "logStatusError": "calls that end the simulation, among them a machine that diverged",
}
_CAUSALITY = {"fixed": "parameter", "tunable": "parameter"}
# FMI 2 has no integers of 64 bits, and some attributes beside the type.
_TYPES_2 = {"Float64": "Real", "Int64": "Real", "Int32": "Integer", "Boolean": "Boolean"}
_TYPED_2 = ("unit", "displayUnit", "min", "max", "start")


def describe_model(scene: Scene, variables: Sequence[Variable], token: str) -> bytes:
    """Return modelDescription.xml of FMI 3.0.

    Args:
        scene: the machine.
        variables: of it, in the order of their value references.
        token: that the binary expects.
    """
    naming = find_convention(variable.name for variable in variables)
    root = ET.Element("fmiModelDescription", fmiVersion="3.0", instantiationToken=token)
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=make_identifier(scene.name),
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        canHandleVariableCommunicationStepSize="true",
        canReturnEarlyAfterIntermediateUpdate="true",
        providesIntermediateUpdate="true",
        fixedInternalStepSize=repr(scene.servo_period),
    )
    _write_header(root, scene, variables)
    listed = ET.SubElement(root, "ModelVariables")
    for reference, scalar in enumerate(variables):
        element = ET.SubElement(listed, scalar.type, _list_attributes(scalar, reference, naming))
        if scalar.role == "output":
            element.set("intermediateUpdate", "true")
        for size in scalar.shape:
            ET.SubElement(element, "Dimension", start=str(size))
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [str(k) for k, variable in enumerate(variables) if variable.role == "output"]
    begin = " ".join(str(k) for k, variable in enumerate(variables) if variable.has_effect_at_start)
    for k in outputs:
        ET.SubElement(structure, "Output", valueReference=k, dependencies="")
    for k in outputs:
        ET.SubElement(structure, "InitialUnknown", valueReference=k, dependencies=begin)
    return _encode_xml(root)


def describe_model_2(scene: Scene, variables: Sequence[Variable], token: str) -> bytes:
    """Return modelDescription.xml of FMI 2.0.

    Args:
        scene: the machine.
        variables: of it, single numbers, in the order of their value references.
        token: that the binary expects.
    """
    naming = find_convention(variable.name for variable in variables)
    root = ET.Element("fmiModelDescription", fmiVersion="2.0", guid=token)
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=make_identifier(scene.name),
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    _write_header(root, scene, variables)
    listed = ET.SubElement(root, "ModelVariables")
    for reference, scalar in enumerate(variables):
        attributes = _list_attributes(scalar, reference, naming)
        own = {name: attributes.pop(name) for name in _TYPED_2 if name in attributes}
        element = ET.SubElement(listed, "ScalarVariable", attributes)
        ET.SubElement(element, _TYPES_2[scalar.type], own)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [k for k, variable in enumerate(variables, 1) if variable.role == "output"]
    begin = [k for k, variable in enumerate(variables, 1) if variable.has_effect_at_start]
    for name, dependencies in (
        ("Outputs", ""),
        ("InitialUnknowns", " ".join(map(str, begin))),
    ):
        group = ET.SubElement(structure, name)
        for k in outputs:
            ET.SubElement(group, "Unknown", index=str(k), dependencies=dependencies)
    return _encode_xml(root)


def _write_header(root: ET.Element, scene: Scene, variables: Sequence[Variable]) -> None:
    """Add the parts that all versions share: origin, units, categories."""
    joints = escape_xml(", ".join(scene.joint_names))
    root.attrib.update(
        modelName=escape_xml(scene.name) or "arm",
        description=f"{len(scene.joints)} joints with their drives, base to tool: {joints}",
        generationTool=TOOL,
        variableNamingConvention=find_convention(variable.name for variable in variables),
    )
    root.append(_add_units(variables))
    categories = ET.SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=text)
    period = repr(scene.servo_period)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=period)


def _list_attributes(variable: Variable, reference: int, naming: str) -> dict[str, str]:
    """Return the attributes of a variable."""
    continuous = variable.type == "Float64"
    attributes = {
        "name": write_name(variable.name, variable.element, naming),
        "valueReference": str(reference),
        "description": escape_xml(variable.description),
        "causality": _CAUSALITY.get(variable.role, variable.role),
        "variability": "continuous" if continuous else "discrete",
    }
    if variable.role in _CAUSALITY:
        attributes["variability"] = variable.role
    if variable.unit and continuous:
        attributes["unit"] = variable.unit
        if variable.unit in DISPLAYED:
            attributes["displayUnit"] = DISPLAYED[variable.unit][0]
    if variable.bounds is not None:
        attributes["min"], attributes["max"] = (repr(float(bound)) for bound in variable.bounds)
    if variable.start is not None:
        boolean = variable.type == "Boolean"
        texts = (
            str(bool(value)).lower() if boolean else repr(float(value)) for value in variable.start
        )
        attributes["start"] = " ".join(texts)
    return attributes


def build_description(scene: Scene, sources: Sequence[str], options: str, definition: str) -> bytes:
    """Return sources/buildDescription.xml.

    Args:
        scene: the machine.
        sources: the files to compile.
        options: of the compiler.
        definition: of its preprocessor, ``NAME=VALUE``.
    """
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(
        root, "BuildConfiguration", modelIdentifier=make_identifier(scene.name)
    )
    files = ET.SubElement(
        configuration, "SourceFileSet", language="C++20", compiler="gcc", compilerOptions=options
    )
    for source in sources:
        ET.SubElement(files, "SourceFile", name=source)
    name, _, value = definition.partition("=")
    ET.SubElement(files, "PreprocessorDefinition", name=name, value=value)
    ET.SubElement(files, "IncludeDirectory", name=".")
    ET.SubElement(configuration, "Library", name="pthread", external="true")
    return _encode_xml(root)


def _encode_xml(root: ET.Element) -> bytes:
    """Return an XML file."""
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


def _add_units(variables: Sequence[Variable]) -> ET.Element:
    root = ET.Element("UnitDefinitions")
    for name in dict.fromkeys(variable.unit for variable in variables if variable.unit):
        element = ET.SubElement(root, "Unit", name=name)
        powers = find_powers(name)
        if powers is not None:
            base = {base: str(powers[base]) for base in BASE if base in powers}
            if name in OFFSETS:
                base["offset"] = repr(OFFSETS[name])
            ET.SubElement(element, "BaseUnit", base)
        if name in DISPLAYED:
            unit, factor = DISPLAYED[name]
            ET.SubElement(element, "DisplayUnit", name=unit, factor=repr(factor))
    return root
