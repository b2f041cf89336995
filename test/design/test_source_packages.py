"""Descriptions in clones of makers' repositories: packages that no shell knows."""

from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest
from test_assumed_bodies import box_stl
from test_new import XACRO
from test_new_drives import untuned

from arm_emulator import Refusal, load_scene
from arm_emulator.design.mesh_file import find_source_packages
from arm_emulator.design.new_scene import write_new

__all__ = ["untuned"]  # a fixture

SOURCE = """<?xml version="1.0"?>
<robot name="cloned" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:include filename="$(find acme_resources)/urdf/rods.xacro"/>
  <link name="plate"><visual><geometry>
    <mesh filename="package://acme_resources/meshes/plate.stl"/></geometry></visual></link>
  <joint name="mount" type="fixed"><parent link="lower"/><child link="plate"/></joint>
</robot>
"""


def package(folder: Path, name: str) -> Path:
    """Make a package whose folder is not called after it."""
    for below in ("urdf", "meshes"):
        (folder / below).mkdir(parents=True)
    text = f"<package>\n<!-- <name>other</name> -->\n  <name> {name} </name></package>"
    (folder / "package.xml").write_text(text)
    return folder


def clone(folder: Path) -> Path:
    """Make a repository of two packages; return the source of the robot."""
    arm, resources = package(folder / "arm", "acme_arm"), package(folder / "res", "acme_resources")
    (resources / "urdf" / "rods.xacro").write_text(XACRO)
    (resources / "meshes" / "plate.stl").write_text(box_stl((0.1, 0.1, 0.1), (0.0, 0.0, 0.0)))
    file = arm / "urdf" / "arm.urdf.xacro"
    file.write_text(SOURCE)
    return file


def mesh_of(scene: Path) -> Path:
    """Return the file that the only mesh of a scene's description names."""
    text = (scene.parent / "urdf" / f"{scene.stem}.urdf").read_text()
    name = text.split('mesh filename="')[1].split('"')[0]
    assert "package://" not in text and urlparse(name).scheme == "file", name
    return Path(unquote(urlparse(name).path))


@pytest.mark.usefixtures("untuned")
def test_packages_of_a_clone_are_located_by_their_manifests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = clone(tmp_path / "a clone")
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    written = write_new(file, tmp_path / "new")
    assert load_scene(written.file).joint_names == ("upper_joint", "lower_joint")
    assert mesh_of(written.file) == (tmp_path / "a clone/res/meshes/plate.stl").resolve()
    assert find_source_packages(file.parent)["acme_arm"] == (tmp_path / "a clone/arm").resolve()


@pytest.mark.usefixtures("untuned")
def test_a_mesh_of_this_shell_is_resolved_from_another_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    prefix = tmp_path / "prefix"
    index = prefix / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "acme_resources").touch()
    package(prefix / "share" / "acme_resources", "acme_resources")
    (prefix / "share/acme_resources/urdf/rods.xacro").write_text(XACRO)
    mesh = prefix / "share/acme_resources/meshes/plate.stl"
    mesh.write_text(box_stl((0.1, 0.1, 0.1), (0.0, 0.0, 0.0)))
    (tmp_path / "alone").mkdir()
    file = tmp_path / "alone" / "arm.xacro"
    file.write_text(SOURCE)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    written = write_new(file, tmp_path / "new")
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert mesh_of(written.file).resolve() == mesh.resolve()
    load_scene(written.file)


def test_a_package_that_is_nowhere_is_named_in_full(tmp_path: Path) -> None:
    file = clone(tmp_path)
    name = "acme_robots_of_the_future_with_a_very_long_name_experimental_support_resources"
    file.write_text(SOURCE.replace("$(find acme_resources)", f"$(find {name})"))
    with pytest.raises(Refusal) as refusal:
        write_new(file, tmp_path / "new")
    line = str(refusal.value)
    assert f"$(find {name}) must name a package" in line and "acme_resources" in line
    deep = "/".join(["folder"] * 10)
    file.write_text(SOURCE.replace("rods.xacro", f"{deep}/rods.xacro"))
    with pytest.raises(Refusal, match=f"got .*{deep}/rods.xacro"):
        write_new(file, tmp_path / "new")


def test_a_manifest_that_cannot_be_read_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "binary").mkdir()
    (tmp_path / "binary" / "package.xml").write_bytes(b"\xff\0<name>")
    (tmp_path / "folder" / "package.xml").mkdir(parents=True)
    package(tmp_path / "good", "good")
    packages = find_source_packages(tmp_path / "good" / "urdf")
    assert packages["good"] == (tmp_path / "good").resolve()
