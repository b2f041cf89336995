"""modelDescription.xml of FMI 2.0.

It does not list the sources: importers take those for C, or for C++ of another year. They are there
for people.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from arm_emulator.doors.fmu.model_description import as_bytes, attributes_of, header
from arm_emulator.doors.fmu.names import convention, identifier
from arm_emulator.doors.fmu.variables import Variable
from arm_emulator.machine.scene import Scene

# FMI 2 has no integers of 64 bits.
_TYPES = {"Float64": "Real", "Int64": "Real", "Int32": "Integer", "Boolean": "Boolean"}
_ATTRIBUTES = ("unit", "displayUnit", "min", "max", "start")  # that stand beside the type


def model_description_2(scene: Scene, variables: Sequence[Variable], token: str) -> bytes:
    """Return modelDescription.xml.

    Args:
        scene: the machine.
        variables: of it, single numbers, in the order of their value references.
        token: that the binary expects.
    """
    naming = convention(one.name for one in variables)
    root = ET.Element("fmiModelDescription", fmiVersion="2.0", guid=token)
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier(scene.name),
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    header(root, scene, variables)
    listed = ET.SubElement(root, "ModelVariables")
    for reference, one in enumerate(variables):
        attributes = attributes_of(one, reference, naming)
        own = {name: attributes.pop(name) for name in _ATTRIBUTES if name in attributes}
        element = ET.SubElement(listed, "ScalarVariable", attributes)
        ET.SubElement(element, _TYPES[one.type], own)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [k for k, one in enumerate(variables, 1) if one.role == "output"]
    begin = [k for k, one in enumerate(variables, 1) if one.decides_on_start]
    for name, dependencies in (
        ("Outputs", ""),
        ("InitialUnknowns", " ".join(map(str, begin))),
    ):
        group = ET.SubElement(structure, name)
        for k in outputs:
            ET.SubElement(group, "Unknown", index=str(k), dependencies=dependencies)
    return as_bytes(root)
