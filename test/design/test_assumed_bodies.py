"""Bodies that a description leaves out, from shapes of a density, against closed forms."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from arm_emulator import Refusal, load_scene
from arm_emulator.base.urdf.frames import make_frame
from arm_emulator.cli.commands.check_scene import check_scene
from arm_emulator.design import new_scene
from arm_emulator.design.assumed_bodies import DENSITY, SLENDER, assume_bodies
from arm_emulator.design.new_scene import write_new
from arm_emulator.machine.chain import Body
from arm_emulator.motion.collision.shapes import CollisionShapes

RHO = 800.0  # kg/m3
JOINT = (
    '<joint name="j{0}" type="revolute"><parent link="l{1}"/><child link="l{0}"/>'
    '<origin xyz="{2}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="{3}" velocity="1"/>'
    "</joint>"
)


def shape(text: str, xyz: str = "0 0 0", rpy: str = "0 0 0", kind: str = "collision") -> str:
    return f'<{kind}><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{text}</geometry></{kind}>'


def arm(links: list[str], reach: str = "0.3 0.1 0.2") -> str:
    joints = [JOINT.format(k + 1, k, "0 0 0" if k == 0 else reach, 900) for k in range(len(links))]
    bodies = [f'<link name="l{k}">{inside}</link>' for k, inside in enumerate(["", *links])]
    return f'<robot name="arm">{"".join(bodies + joints)}</robot>'


def body_of(link: ET.Element) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass and tensor about it, as the description has them."""
    mass, origin, tensor = (link.find(f"inertial/{tag}") for tag in ("mass", "origin", "inertia"))
    assert mass is not None and origin is not None and tensor is not None
    xx, yy, zz, xy, xz, yz = (
        float(tensor.get(key, "")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    com = np.array([float(word) for word in origin.get("xyz", "").split()])
    return float(mass.get("value", "")), com, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def assumed(inside: str, folder: Path, end: tuple[float, ...] = (0.3, 0.0, 0.0)) -> ET.Element:
    robot = ET.fromstring(f'<robot name="r"><link name="l">{inside}</link></robot>')
    assume_bodies(robot, folder, {"l": np.array(end)}, RHO)
    link = robot.find("link")
    assert link is not None
    return link


def box_stl(size: tuple[float, float, float], at: np.ndarray) -> str:
    """A box, some faces missing, with a corner inside."""
    corners = np.array(list(np.ndindex(2, 2, 2))) * np.array(size) + at
    facets = [corners[[0, 1, 3]], corners[[4, 5, 7]], corners[[2, 6, 7]],
              np.array([corners[0], corners[4], corners.mean(axis=0)])]  # fmt: skip
    text = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in facet)
        + "endloop\nendfacet\n"
        for facet in facets
    )
    return f"solid box\n{text}endsolid box\n"


def of_box(a: float, b: float, c: float, mass: float) -> np.ndarray:
    return np.diag([b * b + c * c, a * a + c * c, a * a + b * b]) * mass / 12.0


def test_shapes_are_integrated(tmp_path: Path) -> None:
    """Box, cylinder, sphere; turned, displaced, and two of them: the parallel-axis theorem."""
    a, b, c, r, l = 0.2, 0.3, 0.5, 0.1, 0.4  # noqa: E741
    box, rod, ball = a * b * c * RHO, math.pi * r * r * l * RHO, 4 / 3 * math.pi * r**3 * RHO
    across = rod * (3 * r * r + l * l) / 12
    of = {
        f'<box size="{a} {b} {c}"/>': (box, of_box(a, b, c, box)),
        f'<cylinder radius="{r}" length="{l}"/>': (rod, np.diag([across, across, rod * r * r / 2])),
        f'<sphere radius="{r}"/>': (ball, np.eye(3) * 0.4 * ball * r * r),
    }  # fmt: skip
    draw = np.random.default_rng(0)
    full, inside = Body(), ""
    for text, (mass, tensor) in of.items():
        xyz, rpy = draw.uniform(-1, 1, 3), draw.uniform(-3, 3, 3)
        words = " ".join(map(repr, xyz.tolist())), " ".join(map(repr, rpy.tolist()))
        at = make_frame(xyz, rpy)
        actual = body_of(assumed(shape(text, *words), tmp_path))
        np.testing.assert_allclose(actual[0], mass, rtol=1e-5)
        np.testing.assert_allclose(actual[1], xyz, rtol=1e-5)
        np.testing.assert_allclose(actual[2], at.R @ tensor @ at.R.T, rtol=1e-4, atol=1e-6)
        full = full + Body.from_center(mass, np.zeros(3), tensor).transform_to(at)
        inside += shape(text, *words)
    actual = body_of(assumed(inside, tmp_path))
    np.testing.assert_allclose(actual[0], full.mass, rtol=1e-5)
    np.testing.assert_allclose(actual[1], full.moment / full.mass, rtol=1e-5)
    about = Body.from_center(*actual)
    np.testing.assert_allclose(about.inertia, full.inertia, rtol=1e-4)


def test_a_mesh_in_a_package_is_its_convex_hull(tmp_path: Path) -> None:
    size, at = (0.2, 0.3, 0.5), np.array([0.1, -0.4, 0.2])
    (tmp_path / "my_arm" / "meshes").mkdir(parents=True)
    (tmp_path / "my_arm" / "urdf").mkdir()
    (tmp_path / "my_arm" / "meshes" / "a b.stl").write_text(box_stl(size, at))
    x, y, z = 2.0 * np.array(size)
    for name in ("package://my_arm/meshes/a b.stl", "../meshes/a b.stl"):
        text = f'<mesh filename="{name}" scale="2 2 2"/>'
        mass, com, tensor = body_of(assumed(shape(text), tmp_path / "my_arm" / "urdf"))
        assert mass == pytest.approx(x * y * z * RHO, rel=1e-5)
        np.testing.assert_allclose(com, 2.0 * (at + 0.5 * np.array(size)), rtol=1e-5)
        expected = of_box(x, y, z, mass)
        np.testing.assert_allclose(tensor, expected, rtol=1e-5, atol=1e-5 * expected.max())


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>{unit}<up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="24">{corners}</float_array><technique_common>
<accessor source="#a" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 1 3 4 5 7 2 6 7 1 2 5</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


@pytest.mark.parametrize(
    ("unit", "per_metre"),
    [('<unit name="millimeters" meter="0.001"/>', 1e3), ("<unit meter='0.0254'/>", 1 / 0.0254),
     ('<unit meter="1"/>', 1.0), ("", 1.0)],
)  # fmt: skip
def test_a_mesh_is_in_the_unit_that_its_file_names(
    tmp_path: Path, unit: str, per_metre: float
) -> None:
    """For masses as for contacts; a scale of the description multiplies it."""
    size, at = np.array([0.3, 0.2, 0.1]), np.array([0.1, -0.2, 0.05])
    corners = (np.array(list(np.ndindex(2, 2, 2))) * size + at) * per_metre / 0.5
    text = " ".join(map(repr, corners.ravel().tolist()))
    (tmp_path / "box.dae").write_text(DAE.format(unit=unit, corners=text))
    name = (tmp_path / "box.dae").as_uri()
    mesh = shape(f'<mesh filename="{name}" scale="0.5 0.5 0.5"/>')
    mass, com, _ = body_of(assumed(mesh, tmp_path))
    assert mass == pytest.approx(RHO * size.prod(), rel=1e-5), "single precision in the file"
    assert com == pytest.approx(at + 0.5 * size, abs=1e-6)
    shapes = CollisionShapes(arm([mesh]), ["j1"])
    (box,) = shapes.meshes.geometryObjects
    box.geometry.computeLocalAABB()
    assert np.array(box.geometry.aabb_local.min_).ravel() == pytest.approx(at, abs=1e-6)
    assert np.array(box.geometry.aabb_local.max_).ravel() == pytest.approx(at + size, abs=1e-6)


def test_a_link_without_shape_is_a_rod_and_keeps_its_mass(tmp_path: Path) -> None:
    end = np.array([0.3, 0.0, -0.4])
    lost = shape('<mesh filename="package://nowhere/a.stl"/>')
    for inside in ("", lost, shape('<box size="1 x 1"/>')):
        mass, com, tensor = body_of(assumed(inside, tmp_path, tuple(end)))
        volume = math.pi * (SLENDER * 0.5) ** 2 * 0.5
        assert mass == pytest.approx(RHO * volume, rel=1e-5)
        np.testing.assert_allclose(com, end / 2, rtol=1e-5)
        along = end / 0.5
        assert along @ tensor @ along == pytest.approx(0.5 * mass * 0.05**2, rel=1e-4)
    weighed = (
        '<inertial><mass value="7"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    )
    mass, _, tensor = body_of(
        assumed(f"{weighed}</inertial>" + shape('<sphere radius="0.2"/>'), tmp_path)
    )
    assert mass == 7.0
    np.testing.assert_allclose(tensor, np.eye(3) * 0.4 * 7.0 * 0.04, rtol=1e-5, atol=1e-9)


def test_an_arm_without_inertia_becomes_a_scene_that_names_assumed_bodies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(new_scene, "tune_servo", lambda _, servo: servo)
    box = shape('<box size="0.3 0.1 0.1"/>', xyz="0.15 0 0", kind="visual")
    tensor = '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
    measured = f'<inertial><mass value="2"/>{tensor}</inertial>'
    file = tmp_path / "arm.urdf"
    file.write_text(arm([box, measured + box, ""]))
    written = write_new(file, tmp_path / "new", density=500.0)
    assert [body.link for body in written.assumed] == ["l1", "l3"], "what is measured stays"
    scene = load_scene(written.file)
    assert scene.assumed == ("l1", "l3")
    masses = [joint.body.mass for joint in scene.chain.joints]
    assert masses[:2] == pytest.approx([0.003 * 500.0, 2.0])
    assert "visual: box" in written.file.read_text()
    (written.file.parent / "servo" / "arm.yaml").unlink()
    assert "bodies assumed: l1, l3" in check_scene(str(written.file)).line
    with pytest.raises(Refusal, match="--density must be > 0 and at most"):
        write_new(file, tmp_path / "other", density=0.0)
    assert DENSITY == 1200.0, "the page has it"


def test_a_scene_of_bodies_without_inertia_is_refused_with_all_causes(tmp_path: Path) -> None:
    """By one refusal, which has the way out."""
    (tmp_path / "arm.urdf").write_text(arm(["", "", ""]))
    file = tmp_path / "arm.yaml"
    head = "name: arm\nurdf: arm.urdf\ntool: l3\nsupply_voltage: 24\nservo_period: 0.001\n"
    file.write_text(head + "integrator: {dt: 0.001}\njoints: {j1: {}, j2: {}, j3: {}}\n")
    with pytest.raises(Refusal) as refusal:
        load_scene(file)
    line = str(refusal.value)
    assert "bodies of 3 joints must have mass and inertia" in line
    assert all(f"joint j{k}" in line for k in (1, 2, 3)) and "arm_emulator new" in line
    assert "\n" not in line
    file.write_text(file.read_text() + "assumed: [l7]\n")
    of_links = ET.fromstring(arm([shape('<sphere radius="1"/>')] * 3))
    assume_bodies(of_links, tmp_path, {f"l{k}": np.zeros(3) for k in (1, 2, 3)})
    (tmp_path / "arm.urdf").write_bytes(ET.tostring(of_links))
    with pytest.raises(Refusal, match="assumed must name links of the URDF, got l7"):
        load_scene(file)
