"""Resonances of an arm whose main bearings tilt: joints without motors on springs.

python -m bench.bearing_modes
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator import linearise, load_scene
from arm_emulator_analysis.commands.bode import compute_frequency_response
from bench.measure import show_progress
from bench.tables import format_table

TITLE = "Bearings that tilt"

FOLDER = Path(__file__).resolve().parents[1] / "config" / "validation" / "kr560"
SCENE, URDF = FOLDER / "kr560.yaml", FOLDER / "urdf" / "kr560.urdf"
TILTING = ("joint_1", "joint_2", "joint_3")
AXES = {"x": "1 0 0", "y": "0 1 0"}  # across those of the joints, which are all z
STIFFNESS = (None, 10.0, 3.0, 1.0)  # times that of the joint's gear; None: rigid
REACH = 0.1  # rad, of the springs
FREQUENCIES = np.geomspace(1.0, 100.0, 4001)  # Hz


def run(quick: bool) -> dict[str, Any]:
    """Find the antiresonances of the tilting joints for each stiffness."""
    rows = []
    chosen = STIFFNESS[: 2 if quick else None]
    with tempfile.TemporaryDirectory() as folder, show_progress("scenes", len(chosen)) as done:
        for factor in chosen:
            file = SCENE if factor is None else write_tilting(Path(folder), factor)
            scene = load_scene(str(file))
            linear = linearise(scene, scene.start)
            names = list(scene.joint_names)
            modes = {
                name: compute_frequency_response(
                    linear, names.index(name), FREQUENCIES
                ).antiresonances
                for name in TILTING
            }
            rows.append(
                {
                    "factor": factor,
                    **{name: frequency.tolist() for name, frequency in modes.items()},
                }
            )
            done(str(factor))
    return {"rows": rows}


def write_tilting(folder: Path, factor: float) -> Path:
    """Write the scene with bearings that tilt about two axes across each joint's; return its file.

    Each is a joint without a motor, on a linear spring and a damper between the joint and its link.
    """
    robot = ET.parse(URDF).getroot()
    scene = yaml.safe_load(SCENE.read_text(encoding="utf-8"))
    for name in TILTING:
        gear = scene["joints"][name]["gear"]
        torque, damping = factor * float(gear["stiffness"]) * REACH, factor * float(gear["damping"])
        joint = next(
            joint_element
            for joint_element in robot.findall("joint")
            if joint_element.get("name") == name
        )
        end = joint.find("child")
        assert end is not None
        link, inner = str(end.get("link")), f"{name}_x_side"
        end.set("link", inner)
        outer = f"{name}_y_side"
        for side in (inner, outer):
            body = ET.SubElement(ET.SubElement(robot, "link", name=side), "inertial")
            ET.SubElement(body, "mass", value="0.1")
            inertia = ET.SubElement(body, "inertia", ixy="0", ixz="0", iyz="0")
            inertia.attrib.update({f"i{axis}{axis}": "1e-2" for axis in "xyz"})
        for (axis, direction), parent, child in zip(
            AXES.items(), (inner, outer), (outer, link), strict=True
        ):
            tilt = ET.SubElement(robot, "joint", name=f"{name}_{axis}", type="continuous")
            ET.SubElement(tilt, "parent", link=parent)
            ET.SubElement(tilt, "child", link=child)
            ET.SubElement(tilt, "axis", xyz=direction)
            scene["joints"][f"{name}_{axis}"] = {
                "torque_table": {
                    "angles": [share * REACH for share in (-1.0, -0.3, 0.3, 1.0)],
                    "torques": [-share * torque for share in (-1.0, -0.3, 0.3, 1.0)],
                },
                "friction": {"viscous": damping},
            }
    (folder / "urdf").mkdir(exist_ok=True)
    (folder / "urdf" / URDF.name).write_text(ET.tostring(robot, encoding="unicode"))
    file = folder / SCENE.name
    file.write_text(yaml.safe_dump(scene, sort_keys=False))
    return file


def report(figures: dict[str, Any]) -> str:
    """Return the table."""
    rows = []
    for row in figures["rows"]:
        factor = row["factor"]
        cells = (
            ", ".join(f"{frequency:.1f}" for frequency in row[name]) + " Hz" for name in TILTING
        )
        rows.append(("rigid" if factor is None else f"{factor:g} times the gear", *cells))
    return format_table(("bearings of `kr560`", *(f"`{name}`" for name in TILTING)), rows)


if __name__ == "__main__":
    print(report(run(False)))
