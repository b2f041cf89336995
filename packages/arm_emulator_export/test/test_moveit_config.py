"""A scene's package for MoveIt: its SRDF by Pinocchio's reader, its files by what they mean."""

import ast
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import pinocchio as pin
import pytest
import yaml

from arm_emulator import load_gains, load_scene
from arm_emulator.motion.model.mesh_units import list_package_folders
from arm_emulator_export import control_files
from arm_emulator_export.moveit_package import (
    GROUP,
    LAUNCHES,
    MACHINE,
    make_package_name,
    write_moveit_files,
    write_srdf,
)

SCENES = ("three_axis", "ur5", "panda")
SAMPLED_CONFIGURATIONS = 500


@pytest.fixture(scope="module", params=SCENES)
def files(request: pytest.FixtureRequest) -> tuple[str, dict[str, str]]:
    name = request.param
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "arm_emulator_export.moveit_package.write_srdf.__defaults__", (SAMPLED_CONFIGURATIONS,)
        )
        return name, write_moveit_files(load_scene(name), load_gains(name).motion, name)


@pytest.mark.parametrize("name", SCENES)
def test_pinocchio_reads_the_srdf(name: str) -> None:
    scene = load_scene(name)
    text = write_srdf(scene, SAMPLED_CONFIGURATIONS)
    model = pin.buildModelFromXML(scene.urdf)
    pin.loadReferenceConfigurationsFromXML(model, text)
    places = [model.joints[model.getJointId(joint)] for joint in scene.joint_names]
    for state in ET.fromstring(text).findall("group_state"):
        assert state.get("group") == GROUP
        q = model.referenceConfigurations[state.get("name")]
        # Pinocchio has joints without limits as cosine and sine.
        angles = [q[at.idx_q] if at.nq == 1 else np.arctan2(q[at.idx_q + 1], q[at.idx_q])
               for at in places]  # fmt: skip
        assert np.allclose(angles, scene.start if state.get("name") == "start" else 0.0)
    shapes = pin.buildGeomFromUrdfString(
        model, scene.urdf, pin.GeometryType.COLLISION, package_dirs=list_package_folders()
    )
    shapes.addAllCollisionPairs()
    names = [model.frames[shape.parentFrame].name for shape in shapes.geometryObjects]

    def tested() -> set[tuple[str, ...]]:
        pairs = shapes.collisionPairs
        return {tuple(sorted((names[pair.first], names[pair.second]))) for pair in pairs}

    every = tested()
    pin.removeCollisionPairsFromXML(model, shapes, text)
    listed = ET.fromstring(text).findall("disable_collisions")
    off = {tuple(sorted((shape.get("link1", ""), shape.get("link2", "")))) for shape in listed}
    assert tested() == every - off and bool(off) == bool(every)
    start = model.referenceConfigurations["start"]
    assert not pin.computeCollisions(
        model, model.createData(), shapes, shapes.createData(), start, False
    ), "the arm does not touch itself where it starts"


def test_names_are_those_of_the_robot(files: tuple[str, dict[str, str]]) -> None:
    name, texts = files
    scene = load_scene(name)
    urdf, semantic = ET.fromstring(scene.urdf), ET.fromstring(texts[f"config/{name}.srdf"])
    assert semantic.get("name") == urdf.get("name")
    links = {link.get("name") for link in urdf.findall("link")}
    (chain,) = semantic.findall(f"group[@name='{GROUP}']/chain")
    assert chain.get("tip_link") == scene.tool and chain.get("base_link") in links
    children = {link.get("link") for link in urdf.iter("child")}
    assert chain.get("base_link") not in children, "the root"
    for pair in semantic.findall("disable_collisions"):
        assert {pair.get("link1"), pair.get("link2")} <= links
    for virtual in semantic.findall("virtual_joint"):
        assert virtual.get("child_link") == chain.get("base_link")
        assert virtual.get("parent_frame") not in links
    controllers = yaml.safe_load(texts["config/ros2_controllers.yaml"])
    for file, action in (
        ("moveit_controllers", "joint_trajectory_controller/follow_joint_trajectory"),
        ("network_controllers", "follow_joint_trajectory"),
    ):
        simple = yaml.safe_load(texts[f"config/{file}.yaml"])["moveit_simple_controller_manager"]
        (controller,) = simple["controller_names"]
        assert tuple(simple[controller]["joints"]) == scene.joint_names
        assert "/".join(filter(None, (controller, simple[controller]["action_ns"]))) == action
        assert (controller in controllers) == (file == "moveit_controllers")
    solver = yaml.safe_load(texts["config/kinematics.yaml"])[GROUP]
    assert solver.get("position_only_ik", False) == (len(scene.joints) < 6)


def test_limits_are_the_tighter_of_description_and_motion(
    files: tuple[str, dict[str, str]],
) -> None:
    name, texts = files
    motion = load_gains(name).motion
    limits = yaml.safe_load(texts["config/joint_limits.yaml"])["joint_limits"]
    for joint in ET.fromstring(load_scene(name).urdf).findall("joint"):
        if joint.get("name") not in limits:
            assert joint.get("type") == "fixed"
            continue
        entry, limit = limits[joint.get("name")], joint.find("limit")
        own = float(limit.get("velocity", "inf")) if limit is not None else np.inf
        assert entry["has_velocity_limits"] and entry["has_acceleration_limits"]
        assert entry["max_velocity"] == min(own or np.inf, motion.velocity_limit)
        assert entry["max_acceleration"] <= motion.acceleration_limit
    pilz = yaml.safe_load(texts["config/pilz_cartesian_limits.yaml"])["cartesian_limits"]
    assert pilz["max_trans_vel"] == motion.tool_speed


def test_the_description_finds_its_machine_and_meshes(files: tuple[str, dict[str, str]]) -> None:
    name, texts = files
    scene, package = load_scene(name), f"{name}_moveit_config"
    robot = ET.fromstring(texts[f"config/{name}.urdf.xacro"])
    plain = ET.fromstring(
        control_files.describe_control(scene, f"$(find {package})/{MACHINE}/{name}")
    )
    for element, source in zip(robot.iter(), plain.iter(), strict=True):
        if element.tag == "mesh":
            assert Path(unquote(urlparse(element.get("filename", "")).path)).is_file()
        else:
            assert (element.tag, element.attrib, element.text) == (
                source.tag,
                source.attrib,
                source.text,
            )


def test_a_dollar_of_a_description_stays_a_dollar() -> None:
    scene = load_scene("three_axis")
    object.__setattr__(scene, "urdf", scene.urdf.replace('"three_axis"', '"$(a) ${b}"'))
    texts = write_moveit_files(scene, load_gains("three_axis").motion, "three_axis")
    assert 'name="$$(a) $${b}"' in texts["config/three_axis.urdf.xacro"]


def test_files_are_complete(files: tuple[str, dict[str, str]]) -> None:
    name, texts = files
    package = ET.fromstring(texts["package.xml"])
    assert (
        package.findtext("name") == f"{name}_moveit_config" == make_package_name(load_scene(name))
    )
    assert {f"launch/{launch}.launch.py" for launch in (*LAUNCHES, "network")} <= texts.keys()
    runs = {dependency.text for dependency in package.findall("exec_depend")}
    for path, text in texts.items():
        if path.endswith(".py"):
            imports = [
                statement
                for statement in ast.walk(ast.parse(text))
                if isinstance(statement, ast.ImportFrom)
            ]
            modules = {str(statement.module).split(".")[0] for statement in imports}
            assert modules <= runs | {"launch", "launch_ros"}
    assistant = yaml.safe_load(texts[".setup_assistant"])["moveit_setup_assistant_config"]
    assert assistant["urdf"]["relative_path"] in texts
    assert assistant["srdf"]["relative_path"] in texts


@pytest.mark.parametrize(
    ("name", "package"),
    [("ur5", "ur5"), ("KR 300-2", "kr_300_2"), ("300", "arm_300"), ("-", "arm")],
)
def test_packages_have_names_that_ros_takes(name: str, package: str) -> None:
    scene = load_scene("three_axis")
    object.__setattr__(scene, "name", name)
    assert make_package_name(scene) == f"{package}_moveit_config"
    assert re.fullmatch("[a-z][a-z0-9_]*", package)


def test_moveits_builder_takes_the_package(
    files: tuple[str, dict[str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moveit = pytest.importorskip("moveit_configs_utils")
    name, texts = files
    share = tmp_path / "share" / f"{name}_moveit_config"
    for path, text in texts.items():
        (share / path).parent.mkdir(parents=True, exist_ok=True)
        (share / path).write_text(text)
    index = tmp_path / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / share.name).touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path), prepend=":")
    config = (
        moveit.MoveItConfigsBuilder(name, package_name=share.name).to_moveit_configs().to_dict()
    )
    assert f"{share}/{MACHINE}/{name}" in config["robot_description"]
    assert config["robot_description_kinematics"].keys() == {GROUP}
    assert config["robot_description_planning"]["joint_limits"].keys() == set(
        load_scene(name).joint_names
    )
