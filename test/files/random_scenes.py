"""Scenes and URDFs drawn at random, good and bad: what people, tools and malice put into files.

`draw(rng, folder)` writes a scene (scene.yaml, and robot.urdf beside it) into an empty `folder`. It
returns the path to load, which need not be that of a file. `verdict(path)` loads it up to the C++
unit and returns "" if it was taken, or the one line that refuses it; it raises AssertionError if
the outcome is another: more than one line, a line that names no file, a number in the unit that is
not finite, or more than 2 s; and it lets any other exception and any warning pass, as an error.

    rng = np.random.default_rng(seed)
    line = verdict(draw(rng, tmp_path / "1"))
"""

import copy
import math
import os
import re
import socket
import time
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator import Refusal, load_scene
from arm_emulator.machine.plant.scene_unit import write_scene_unit

Rng = np.random.Generator

CONFIG = Path(__file__).resolve().parents[2] / "config"
SCENE = (CONFIG / "three_axis.yaml").read_text()
URDF = (CONFIG / "urdf" / "three_axis.urdf").read_text()
PATIENCE = 2.0  # s, for one file

NUMBERS = (
    0, 1, -1, 2, 7, 0.5, -0.0, 1e-4, 1e-9, 1e-12, 1e-30, 1e-300, 5e-324, 1e3, 1e6, 1e9, 1e12, 1e15,
    1e30, 1e154, 1e155, 1e200, 1e300, 1.7e308, -1e-300, -1e300, 2**31, 2**53, 2**63, 2**64,
    -(2**63),
    10**18, math.inf, -math.inf, math.nan,
)  # fmt: skip
NAMES = (
    "", " ", "a", "elbow", "waist", "tool", "base", "world", "universe", "root_joint", "joint.1",
    "a.b.c", ".", "..", ".a", "a.", "a..b", "*", "~", "<<", "null", "true", "yes", "1", "1.5",
    "-", "#",
    "a b", " a", "a\tb", "a\nb", "a\r\nb", "a\0b", "a\x1bb", "a/b", "/a", "../a", "a:b", "a: b",
    "{a}",
    '"', "'", "a\"b'c", "\\", "\\n", "%s", "{0}", "$(a)", "`a`", ";", "*/", "//", "??/", "é",
    "ÄÖ", "関節",
    "\u202ea", "\u2028", "\ufeffa", "😀", "a" * 300, "é" * 300, "x." * 150, "-p", "--ros-args",
    "use_sim_time", "joints", "joint_names", "period", "int", "class", "struct", "N", "nan", "inf",
)  # fmt: skip


def draw(rng: Rng, folder: Path) -> Path:
    """Write a random case into `folder`, which is made, and return the path to load."""
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(URDF)
    (folder / "scene.yaml").write_text(SCENE.replace("urdf/three_axis.urdf", "robot.urdf"))
    makers, weights = zip(*_MAKERS, strict=True)
    chosen = makers[int(rng.choice(len(makers), p=np.array(weights) / sum(weights)))]
    path: Path = chosen(rng, folder)
    return path


def verdict(path: Path) -> str:
    """Load a scene and return the line that refuses it, "" if it is taken."""
    # Of this process: others may be busy. Only waiting (for a pipe) is measured by the wall clock.
    started, began = time.process_time(), time.monotonic()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        line = ""
        try:
            unit = write_scene_unit(load_scene(path))
        except Refusal as refusal:
            line = str(refusal)
    seconds = max(time.process_time() - started, 0.1 * (time.monotonic() - began))
    assert seconds < PATIENCE, f"{path} took {seconds:.1f} s"
    if line:
        assert line.isprintable(), f"more than one line, or not printable: {line!r}"
        name = path.name[:40] if path.name.isprintable() else "file "  # escaped in the line
        is_named = name in line or not line.startswith("arm_emulator: ")
        assert is_named, f"no file is named: {line!r}"
    else:
        odd = re.search(r"\b(nan|inf)\b", unit)
        assert odd is None, f"the unit holds {odd}"
    return line


def names(rng: Rng) -> str:
    """Return a usual name of robots, or a hostile one."""
    if rng.random() < 0.5:
        return str(rng.choice(np.array(NAMES, dtype=object)))
    letters = list("abcABC012_-. /\\:'\"{}[]*&#%\n\té関")
    return "".join(map(str, rng.choice(letters, size=rng.integers(1, 12))))


def number(rng: Rng) -> float:
    """Return a number of any size, of either sign, rarely none."""
    if rng.random() < 0.4:
        return NUMBERS[int(rng.integers(len(NUMBERS)))]
    return float(rng.choice([-1.0, 1.0], p=[0.2, 0.8]) * 10.0 ** rng.uniform(-12, 12))


# YAML


def _value(rng: Rng, depth: int = 0) -> Any:
    """Return anything that YAML can state."""
    kind = rng.integers(9 if depth < 4 else 6)
    if kind < 2:
        return number(rng)
    if kind == 2:
        return names(rng).replace("\0", "")
    if kind == 3:
        return bool(rng.integers(2))
    if kind == 4:
        return None
    if kind == 5:
        return 10 ** int(rng.integers(18, 500)) * int(rng.choice([-1, 1]))
    size = int(rng.integers(0, 7))
    if kind == 6:
        return [_value(rng, depth + 1) for _ in range(size)]
    return {names(rng): _value(rng, depth + 1) for _ in range(size)}


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Return every (collection, key or index) of a tree."""
    places: list[tuple[Any, Any]] = []
    for key, child in tree.items() if isinstance(tree, dict) else enumerate(tree):
        places.append((tree, key))
        if isinstance(child, dict | list):
            places += _places(child)
    return places


def _change_values(rng: Rng, folder: Path) -> Path:
    """Change, remove, add or rename a few entries of a sound scene."""
    file = folder / "scene.yaml"
    data = copy.deepcopy(yaml.safe_load(file.read_text()))
    data = yaml.safe_load(yaml.dump(data, Dumper=_Plain))
    for _ in range(int(rng.integers(1, 4))):
        places = _places(data)
        tree, key = places[int(rng.integers(len(places)))]
        change = rng.integers(5)
        if change <= 1:
            tree[key] = number(rng) if change else _value(rng)
        elif change == 2:
            del tree[key]
        elif change == 3 and isinstance(tree, dict):
            tree[names(rng)] = tree.pop(key)
        elif isinstance(tree, dict):
            tree[
                str(rng.choice(["gravity", "payload", "locked", "cores", "friction", "servo"]))
            ] = _value(rng)
    file.write_text(yaml.dump(data, Dumper=_Plain, allow_unicode=True))
    return file


class _Plain(yaml.SafeDumper):
    """Writes no anchors, so that a change stays where it is."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _cut_up(rng: Rng, content: bytes) -> bytes:
    """Change a few bytes, or move, repeat or lose a part."""
    for _ in range(int(rng.integers(1, 5))):
        a, b = sorted(rng.integers(0, len(content) + 1, 2).tolist())
        b = min(b, a + int(rng.integers(1, 200)))
        change = rng.integers(5)
        if change == 0:
            content = content[:a] + content[b:]
        elif change == 1:
            content = content[:b] + content[a:]
        elif change == 2:
            content = content[:a] + bytes(rng.integers(0, 256, 3).tolist()) + content[a:]
        elif change == 3:
            odd = rng.choice(
                ["[", "{", "*", "&a ", "!!x ", "\n", "---\n", "<<: ", "'", "<", "&#0;"]
            )
            content = content[:a] + str(odd).encode() + content[a:]
        else:
            content = content[:a] + str(number(rng)).encode() + content[b:]
        content = content or b" "
    return content


def _yaml_cut_up(rng: Rng, folder: Path) -> Path:
    file = folder / "scene.yaml"
    file.write_bytes(_cut_up(rng, file.read_bytes()))
    return file


def _yaml_that_is_no_scene(rng: Rng, folder: Path) -> Path:
    file = folder / "scene.yaml"
    many = int(10 ** rng.uniform(0.0, 6.0))
    bomb = "a0: &a0 [x, x]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
    )
    merged = "a0: &a0 {x: 1}\n" + "".join(
        f"a{i}: &a{i}\n  <<: [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 9)
    )
    text = str(
        rng.choice(
            np.array(
                [
                    "[" * many, "{a: " * many, "- " * many, "? " * many, "a: [" * many,
                    "- a\n" * many,
                    "[" * many + "]" * many, "{" * many + "}" * many, "a" * many, "\n" * many,
                    "\t" * many, "x: " + "1" * many, "x: 1e" + "9" * many,
                    "x: -" + "1" * many + ".5",
                    "[" + "1, " * many + "]", ":" * many, "#" * many, "'" * many, '"' + "\\" * many,
                    "? [1, 2]\n: 3", "{a: 1}: 2", "? {a: 1}\n: 2", "[a]: b", "1: 2\n1.0: 3", "~: 1",
                    "a: 1\na: 2", "name: 1\n'name': 2", "a: &a [*a]", "&a {b: *a}", "a: *b", bomb,
                    merged,
                    "!!python/object/apply:os.system [true]", "a: !!int x", "!!set {a, b}",
                    "a: !b c",
                    "a: !!binary x", "!!map [1]", "a: !!timestamp x", "a: 2001-99-99", "a: 1:99",
                    "a: 1\n---\nb: 2", "---\n---\n", "%YAML 9.9\n---\na: 1",
                    "%TAG ! x\n---\na: !b 1",
                    "\ufeff" + SCENE, "\ufeff", "", " ", "---", "...", "null", "3", "a", "- a",
                    "true",
                    "a: \0", "\0" * many, "a: \x07", '"\\ud800"', '"\\x00"',
                    "a: |\n" + " x\n" * many,
                    "x: 0x" + "f" * many, "x: 0o7", "x: 1_000", "<<: 1", "<<: {a: 1}", "<<: [1]",
                    "=: 1",
                    yaml.safe_dump(_value(rng, 1), allow_unicode=True),
                ],
                dtype=object,
            )
        )
    )  # fmt: skip
    encoding = str(rng.choice(["utf-8", "utf-16", "utf-32", "latin-1"], p=[0.85, 0.05, 0.05, 0.05]))
    file.write_bytes(text.encode(encoding, errors="replace"))
    return file


# Paths


def _paths(rng: Rng, folder: Path) -> Path:
    """Let the scene, or what it names, be no file."""
    (folder / "folder").mkdir()
    os.mkfifo(folder / "pipe")
    with socket.socket(socket.AF_UNIX) as unix_socket:
        here = os.open(folder, os.O_RDONLY)
        unix_socket.bind(f"/proc/self/fd/{here}/socket")
        os.close(here)
    (folder / "loop").symlink_to("loop")
    (folder / "gone").symlink_to("nothing")
    (folder / "link.urdf").symlink_to("robot.urdf")
    (folder / "closed").write_text(URDF)
    (folder / "closed").chmod(0)
    odd = (
        "folder", "pipe", "socket", "loop", "gone", "link.urdf", "closed", "", ".", "..", "/",
        "a" * 300,
        "a" * 3000, "a/" * 1500, "../" * 200 + "etc/passwd", "/dev/zero", "/dev/full",
        "/dev/random",
        "/dev/stdin", "/proc/self/mem", "/proc/self/environ", "/proc/kmsg", "/proc/self/fd/0",
        "/proc/kcore", "/sys/kernel/notes", "robot.urdf/", "robot.urdf/x", "scene.yaml", "\0",
        "a\nb",
        "é" * 200, "~/robot.urdf", "$HOME", "package://", "package://nowhere/robot.urdf",
        "file:///etc",
        "example-robot-data:", "example-robot-data:..", "example-robot-data:/etc/passwd",
        "example-robot-data:" + "../" * 30 + "etc/passwd", "example-robot-data:ur_description",
        "example-robot-data:" + "a" * 3000, "http://127.0.0.1/robot.urdf", "other:robot.urdf", ":",
    )  # fmt: skip
    text = str(rng.choice(np.array(odd, dtype=object)))
    if rng.random() < 0.3:
        return folder / text.replace("example-robot-data:", "")
    file = folder / "scene.yaml"
    data = yaml.safe_load(file.read_text())
    data[str(rng.choice(["urdf", "urdf", "urdf", "tool", "name"]))] = text
    file.write_text(yaml.safe_dump(data))
    return file


# URDF


def _urdf_cut_up(rng: Rng, folder: Path) -> Path:
    file = folder / "robot.urdf"
    file.write_bytes(_cut_up(rng, file.read_bytes()))
    return folder / "scene.yaml"


def _change_parts(rng: Rng, folder: Path) -> Path:
    """Change, remove, repeat or move a few elements or attributes of a sound URDF."""
    robot = ET.fromstring(URDF)
    for _ in range(int(rng.integers(1, 4))):
        elements = list(robot.iter())
        element = elements[int(rng.integers(len(elements)))]
        parents = {child: parent for parent in elements for child in parent}
        change = rng.integers(6)
        if change <= 1 and element.attrib:
            key = str(rng.choice(list(element.attrib)))
            values = (
                names(rng), repr(number(rng)), " ".join(repr(number(rng)) for _ in range(3)),
                str(rng.choice(["floating", "planar", "ball", "prismatic", "revolute", "fixed"])),
            )  # fmt: skip
            element.set(key, _xml_text(str(rng.choice(np.array(values, dtype=object)))))
        elif change == 2 and element in parents:
            parents[element].remove(element)
        elif change == 3 and element in parents:
            parents[element].append(copy.deepcopy(element))
        elif change == 4 and element in parents and len(element.attrib):
            element.attrib.pop(str(rng.choice(list(element.attrib))))
        else:
            extra = str(rng.choice(["joint", "link", "limit", "mimic", "inertial", "transmission"]))
            ET.SubElement(element, extra, name=_xml_text(names(rng)))
    (folder / "robot.urdf").write_text(ET.tostring(robot, encoding="unicode"), encoding="utf-8")
    return folder / "scene.yaml"


def _xml_text(text: str) -> str:
    """Return a text without what XML 1.0 cannot hold."""
    return "".join(c for c in text if c in "\t\n\r" or (" " <= c and c not in "\ufffe\uffff"))


def _arm(rng: Rng, folder: Path) -> Path:
    """Write an arm as people publish them: odd names, thin and massless links, second mentions."""
    tidy = rng.random() < 0.5
    link_names = ["world"]
    robot = ET.Element("robot", name=_xml_text(names(rng)) or "r")
    ET.SubElement(robot, "link", name="world")
    moving: list[str] = []
    for index in range(int(rng.integers(1, 9))):
        name = f"l.{index}" if tidy else _xml_text(names(rng))
        parent = link_names[-1] if rng.random() < 0.9 else str(rng.choice(link_names))
        link = ET.SubElement(robot, "link", name=name)
        if rng.random() < 0.8:
            _inertial(rng, link, tidy)
        kind = str(
            rng.choice(
                ["fixed", "revolute", "continuous", "prismatic", "floating", "planar", ""],
                p=[0.28, 0.28, 0.2, 0.2, 0.02, 0.01, 0.01],
            )
        )
        joint_name = name if rng.random() < 0.5 else f"j{index}.{name}"
        joint = ET.SubElement(robot, "joint", name=joint_name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=name)
        if rng.random() < 0.7:
            ET.SubElement(joint, "origin", xyz=_three(rng, tidy), rpy=_three(rng, tidy))
        if rng.random() < 0.8:
            ET.SubElement(joint, "axis", xyz=_three(rng, True))
        if rng.random() < 0.5:
            ET.SubElement(joint, "limit", lower="-1", upper="1", effort="9", velocity="2")
        if rng.random() < 0.05:
            ET.SubElement(joint, "mimic", joint=joint_name)
        for tag in ("transmission", "ros2_control", "gazebo"):
            if rng.random() < 0.1:
                again = ET.SubElement(ET.SubElement(robot, tag, name="t"), "joint", name=joint_name)
                ET.SubElement(again, "hardwareInterface").text = "effort"
        if kind not in ("fixed", ""):
            moving.append(joint_name)
        link_names.append(name)
    (folder / "robot.urdf").write_text(ET.tostring(robot, encoding="unicode"), encoding="utf-8")
    data = yaml.safe_load((folder / "scene.yaml").read_text())
    motor = data["joints"]["elbow"]
    data["tool"] = link_names[-1]
    data["joints"] = {name: motor if rng.random() < 0.5 else {} for name in moving}
    locked = [name for name in data["joints"] if rng.random() < 0.1]
    if locked:
        data["locked"] = {name: 0.0 for name in locked}
        for name in locked:
            del data["joints"][name]
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump(data, allow_unicode=True), encoding="utf-8")
    return file


def _inertial(rng: Rng, link: ET.Element, tidy: bool) -> None:
    inertial = ET.SubElement(link, "inertial")
    if rng.random() < 0.7:
        ET.SubElement(inertial, "origin", xyz=_three(rng, tidy), rpy=_three(rng, tidy))
    mass = rng.uniform(0.1, 5.0) if tidy else abs(number(rng))
    A = rng.normal(size=(3, 3)) if tidy else np.full((3, 3), float(number(rng)))
    with np.errstate(all="ignore"):
        I = A @ A.T  # noqa: E741
    shape = rng.integers(5)
    I = np.nan_to_num(I)  # noqa: E741
    if shape == 1:  # a rod
        I = np.diag([0.0, 0.1, 0.1])  # noqa: E741
    elif shape == 2:  # a point
        I = np.zeros((3, 3))  # noqa: E741
    elif shape == 3:  # nothing, or no mass with an inertia
        mass = 0.0
        I *= rng.integers(2)  # noqa: E741
    ET.SubElement(inertial, "mass", value=repr(float(mass)))
    entries = {
        f"i{'xyz'[i]}{'xyz'[j]}": repr(float(I[i, j])) for i in range(3) for j in range(i, 3)
    }
    ET.SubElement(inertial, "inertia", entries)


def _three(rng: Rng, tidy: bool) -> str:
    values = (
        rng.normal(0.0, 0.5, 3) * (rng.random(3) < 0.6) if tidy else [number(rng) for _ in "xyz"]
    )
    return " ".join(repr(float(value)) for value in values)


def _xml_that_is_no_robot(rng: Rng, folder: Path) -> Path:
    many = int(10 ** rng.uniform(0.0, 6.0))
    depth = int(rng.integers(1, 50))
    laughs = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10))
    texts = (
        f'<!DOCTYPE r [<!ENTITY a0 "ha">{laughs}]><robot name="&a9;"/>',
        f'<!DOCTYPE r [<!ENTITY a0 "{"x" * 50000}">]><robot>{"&a0;" * min(many, 50000)}</robot>',
        '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="r">&a;</robot>',
        '<!DOCTYPE r SYSTEM "file:///dev/zero"><robot name="r"/>',
        '<!DOCTYPE robot><robot name="r"/>', "<a>" * many, "<robot>" * many, "<robot/>" * many,
        "<robot>" + "<a>" * many + "</a>" * many + "</robot>",
        "<robot>" + "<a/>" * many + "</robot>",
        "<robot " + " ".join(f'a{i}=""' for i in range(many)) + "/>",
        "<robot>" + "x" * many + "</robot>",
        '<robot name="' + "x" * many + '"/>', "<?a b?>" * many + "<robot/>", "<!--" + "-" * many,
        "<robot>" + '<link name="a"/>' * many + "</robot>", "<![CDATA[" * many, "&" * many, "",
        '<?xml version="1.0" encoding="utf-16"?>' + URDF.split("?>", 1)[1],
        '<?xml version="1.0" encoding="latin-1"?><!-- é -->' + URDF.split("?>", 1)[1],
        '<?xml version="1.0" encoding="nonesuch"?>' + URDF.split("?>", 1)[1],
        '<?xml version="1.0" encoding="rot13"?>' + URDF.split("?>", 1)[1],
        '<?xml version="2.0"?>' + URDF.split("?>", 1)[1], "\ufeff" + URDF, URDF + "\0", URDF + URDF,
        URDF.replace("<robot", '<robot xmlns="http://a" xmlns:b="http://b"'),
        URDF.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"'),
        URDF.replace("</robot>", '<xacro:include filename="a"/></robot>'),
        URDF.replace("</robot>", '<b:c xmlns:b="http://b"/></robot>'),
        URDF.replace("</robot>", "<gazebo><joint name='elbow'/></gazebo></robot>"),
        URDF.replace("</robot>", "<gazebo>" + "<x>" * depth + "</x>" * depth + "</gazebo></robot>"),
    )  # fmt: skip
    text = str(rng.choice(np.array(texts, dtype=object)))
    encoding = str(rng.choice(["utf-8", "utf-16", "latin-1"], p=[0.8, 0.1, 0.1]))
    (folder / "robot.urdf").write_bytes(text.encode(encoding, errors="replace"))
    return folder / "scene.yaml"


def _many_links(rng: Rng, folder: Path) -> Path:
    """Write an arm with thousands of links fixed to it, in a chain or side by side."""
    count = int(rng.integers(1, 5000))
    in_a_row = rng.random() < 0.5
    parts = []
    for index in range(count):
        parent = f"f{index - 1}" if in_a_row and index else "forearm"
        parts.append(
            f'<link name="f{index}"><inertial><mass value="0.001"/><inertia ixx="1e-6" iyy="1e-6" '
            f'izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j{index}" '
            f'type="fixed"><origin xyz="0 0 1e-4" rpy="0 0.1 0"/><parent link="{parent}"/>'
            f'<child link="f{index}"/></joint>'
        )
    (folder / "robot.urdf").write_text(URDF.replace("</robot>", "".join(parts) + "</robot>"))
    return folder / "scene.yaml"


_MAKERS: list[tuple[Callable[[Rng, Path], Path], float]] = [
    (_change_values, 5.0),
    (_yaml_cut_up, 3.0),
    (_yaml_that_is_no_scene, 2.0),
    (_paths, 2.0),
    (_urdf_cut_up, 3.0),
    (_change_parts, 5.0),
    (_arm, 6.0),
    (_xml_that_is_no_robot, 2.0),
    (_many_links, 0.05),
]
