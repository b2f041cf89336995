"""Every import of our packages is declared: in package.xml for rosdep, or for pip beside it."""

import ast
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Modules whose rosdep key differs from the name, or begins with python3-.
KEYS = {"PIL": "python3-pil", "_cffi_backend": "python3-cffi"}
# Modules whose name for pip differs.
WHEELS = {
    "can": "python-can",
    "elftools": "pyelftools",
    "rerun": "rerun-sdk",
    "rerun_cli": "rerun-sdk",
    "serial": "pyserial",
}
# Imported where they are there, and done without where they are not.
OPTIONAL = {"control_msgs", "simulation_interfaces"}


def packages() -> list[str]:
    """Names of our packages, as setup.py installs them."""
    setup = (ROOT / "setup.py").read_text()
    return re.findall(r'"(\w+)"', setup.split("PACKAGES = (")[1].split(")\n")[0])


def imported(package: str) -> set[str]:
    """Top-level modules that a package imports, other than Python's and ours."""
    result: set[str] = set()
    for file in (ROOT / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                result |= {name.name for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                result.add(node.module)
    tops = {name.partition(".")[0] for name in result}
    return tops - set(sys.stdlib_module_names) - set(packages())


def names_in(file: str) -> set[str]:
    lines = (ROOT / file).read_text().split("# --- what they bring along")[0].splitlines()
    return {line.partition("==")[0] for line in lines if re.match(r"\w", line)}


def test_every_import_is_declared_for_a_stock_ros_machine() -> None:
    depends = {
        element.text
        for element in ET.parse(ROOT / "package.xml").getroot()
        if "depend" in element.tag
    }
    wheels = names_in("requirements-ros.txt") | names_in("requirements-peers.txt")
    missing = {
        module
        for package in packages()
        for module in imported(package) - OPTIONAL
        if not {module, KEYS.get(module, f"python3-{module}")} & depends
        and WHEELS.get(module, module) not in wheels
    }
    assert not missing


def test_wheels_for_ros_are_those_of_the_environment_that_is_tested() -> None:
    everywhere = set((ROOT / "requirements.txt").read_text().splitlines())
    everywhere |= set((ROOT / "requirements-robots.txt").read_text().splitlines())
    ours = {x for x in (ROOT / "requirements-ros.txt").read_text().splitlines() if "==" in x}
    numpy_1 = {x for x in ours if x.startswith("pyarrow==")}  # newer ones want NumPy 2
    assert len(ours) > 5 and ours - numpy_1 <= everywhere


# Requirements of the wheel without ROS are named in requirements*.txt, and follow from these.
BROUGHT = {"coal": "pin", "lz4": "rosbags", "zstandard": "rosbags", "pyarrow": "rerun-sdk"}
BROUGHT |= {"PIL": "matplotlib"}
NAMES = {"pinocchio": "pin", "yaml": "PyYAML", "rerun": "rerun-sdk", "rerun_cli": "rerun-sdk"}
NAMES |= {"can": "python-can", "elftools": "pyelftools", "_cffi_backend": "cffi"}
OF_ROS = re.compile(r"\w+_(msgs|srvs|interfaces)|rclpy|ament_index_python|launch(_ros)?")


def test_the_wheel_names_all_that_it_imports() -> None:
    text = "".join(file.read_text() for file in sorted(ROOT.glob("requirements*.txt")))
    parts = dict(re.findall(r"^# --- (.*)\n((?:.+\n)*)", text, re.M))
    setup = (ROOT / "setup.py").read_text()
    named = [parts[part] for part in re.findall(r'wheels\("(.*?)"\)', setup)]
    wheels = set(re.findall(r"^([\w.-]+)==", "\n".join(named), re.M))
    assert len(wheels) > 10
    modules = {module for module in imported("arm_emulator") if not OF_ROS.fullmatch(module)}
    missing = {
        module for module in modules if NAMES.get(module, BROUGHT.get(module, module)) not in wheels
    }
    assert not missing
