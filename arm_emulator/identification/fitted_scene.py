"""A scene and its URDF with numbers that were found, the rest of the texts as they were."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from emulator_node.chain import Body, Frame
from emulator_node.scene import Scene, load_scene
from words.refusal import Refusal
from words.text_file import read_text
from words.yaml_edit import edited
from words.yaml_file import MOST_BYTES


def write_fitted(file: Path, scene_file: Path, scene: Scene, numbers: Mapping[str, float],
                 bodies: Mapping[str, Body], heading: str) -> None:  # fmt: skip
    """Write a scene with other numbers, and a URDF with other bodies beside it.

    Args:
        file: the scene to write; its URDF goes to ``urdf/NAME.urdf`` beside it.
        scene_file: the scene that it is made of.
        scene: the same, loaded.
        numbers: values by their dotted names below the scene.
        bodies: what each moving link of the URDF is, with all that is fixed to it, see `in_urdf`.
        heading: lines to stand at its top, as comments.

    Raises:
        Refusal: it cannot be written, or what is found is no sound scene.
    """
    urdf = file.parent / "urdf" / f"{file.stem}.urdf"
    text = read_text(scene_file, MOST_BYTES)
    values = {name: f"{value:.6g}" for name, value in numbers.items()} | {
        "name": file.stem, "urdf": f"urdf/{urdf.name}"
    }  # fmt: skip
    comments = "".join(f"# {line}".rstrip() + "\n" for line in heading.splitlines())
    try:
        urdf.parent.mkdir(parents=True, exist_ok=True)
        urdf.write_text(_with_bodies(scene, bodies), encoding="utf-8")
        file.write_text(comments + _replaced(text, values, scene.where), encoding="utf-8")
    except OSError as error:
        raise Refusal("identify", f"file {file}", "be writable", error.strerror) from None
    load_scene(file)


def _replaced(text: str, values: Mapping[str, str], where: str) -> str:
    """Return a YAML text with some values replaced, by their dotted places."""
    nodes = dict[str, yaml.Node]()
    _collect(yaml.compose(text, yaml.SafeLoader), "", nodes)
    edits = []
    for name, value in values.items():
        node = nodes.get(name)
        if not isinstance(node, yaml.ScalarNode):
            rule = "stand in the scene by itself to be fitted, if only as 0"
            raise Refusal(where, name, rule, "nothing")
        edits.append((node.start_mark.index, node.end_mark.index, value))
    return edited(text, edits)


def _collect(node: yaml.Node | None, place: str, nodes: dict[str, yaml.Node]) -> None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            _collect(value, f"{place}.{key.value}" if place else str(key.value), nodes)
    elif node is not None:
        nodes[place] = node


def _with_bodies(scene: Scene, bodies: Mapping[str, Body]) -> str:
    """Return the URDF with the bodies of its moving links; what is fixed to them has none then."""
    robot = ET.fromstring(scene.urdf)
    links = {element.get("name"): element for element in robot.findall("link")}
    for joint in scene.chain.joints:
        body = bodies.get(joint.link)
        if body is None:
            continue
        for name in joint.links:
            for old in links[name].findall("inertial"):
                links[name].remove(old)
        links[joint.link].insert(0, _inertial(body))
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _inertial(body: Body) -> ET.Element:
    com = body.moment / body.mass
    tensor = body.inertia - body.mass * (com @ com * np.eye(3) - np.outer(com, com))
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=" ".join(f"{x:.6g}" for x in com))
    ET.SubElement(element, "mass", value=f"{body.mass:.7g}")
    places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    numbers = {f"i{name}": f"{tensor[at]:.7g}" for name, at in places.items()}
    ET.SubElement(element, "inertia", numbers)
    return element


def in_urdf(scene: Scene, scene_file: Path, bodies: Sequence[Body]) -> dict[str, Body]:
    """Return what the joints' child links are, in their frames, without the scene's payload.

    Args:
        scene: the machine.
        scene_file: the file that it was loaded from.
        bodies: of its chain, in the core's frames.
    """
    bare = load_scene(scene_file, {"payload": None, "varied": []})
    found = {}
    for joint, light, body in zip(scene.chain.joints, bare.chain.joints, bodies, strict=True):
        payload = joint.body + light.body.scaled(-1.0)
        found[joint.link] = (body + payload.scaled(-1.0)).seen_from(Frame(joint.axes.T))
    return found
