"""README.md, CONTRIBUTING.md and docs/ agree with the code."""

import math
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from documents import DOCS, DOCUMENTS, ROOT, page_of

from arm_emulator import Refusal, load_scene
from arm_emulator.cli.command import command_names
from arm_emulator.ros.node.node_shell import (
    COMMAND_QOS,
    COMMAND_SUB_QOS,
    STATE_PUB_QOS,
    STATE_SUB_QOS,
)
from arm_emulator.toolchain.compiler_command import find_compiler
from bench import import_bench, pages
from docs import generated, hooks, scene_keys

GENERATED = ("build", "install", "log", "out")  # by commands; a clean checkout has none of them
FOLDERS = "|".join(
    sorted(
        path.name
        for path in ROOT.iterdir()
        if path.is_dir() and path.name[0] not in "._" and path.name not in GENERATED
    )
)


def test_the_tutorial_shows_the_servo_as_it_is() -> None:
    source = (ROOT / "examples" / "my_servo.py").read_text()
    assert source[source.index("import math") :].rstrip() in page_of("your_servo").read_text()


def test_the_site_has_every_page_once() -> None:
    """`make docs` refuses other pages; this one takes no packages."""

    def pages_in(nav: Any) -> list[str]:
        if isinstance(nav, str):
            return [nav]
        return [
            page
            for entry in nav
            for page in pages_in(entry.values() if type(entry) is dict else entry)
        ]

    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    compiled = set(hooks.TOP.values()) - {"index.md"}
    listed = pages_in(hooks.expand_pages(site["nav"]))
    assert len(listed) == len(set(listed))
    assert set(listed) == set(hooks.list_page_files()) | compiled


def test_the_page_of_python_has_every_public_name() -> None:
    import arm_emulator

    text = re.findall(r"^::: (?:\w+\.)*(\w+)$", page_of("python").read_text(), re.M)
    assert set(arm_emulator.__all__) <= set(text)


@pytest.mark.slow
def test_generated_parts_of_pages_follow_from_the_code() -> None:
    """As `make tables` writes them, and `make lint` checks."""
    assert dict(generated.list_outdated_pages()) == {}
    titles = re.findall("^## (.+)", page_of("command_line").read_text(), re.M)
    assert set(command_names()) <= set(titles)


def test_a_generated_part_that_has_fallen_behind_is_written_again() -> None:
    page = page_of("brake").read_text()
    assert page.count("`brake.torque`") >= 1
    old = page.replace("`brake.torque`", "`brake.force`")
    assert generated.fill_page(old) == page


@pytest.mark.parametrize(
    ("text", "missing"),
    [
        ("<!-- generated: file nowhere.h -->\n<!-- end generated -->", r"nowhere\.h"),
        ("<!-- generated: tabel x -->\n<!-- end generated -->", "generator tabel; valid: "),
        ("<!-- generated: parts x -->\n", "end generated"),
    ],
)
def test_a_generated_part_that_cannot_be_generated_is_named(text: str, missing: str) -> None:
    with pytest.raises(hooks.Missing, match=missing):
        generated.fill_page(text)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document: Path) -> None:
    text = document.read_text()
    for link in re.findall(r"\]\(([^)]+)\)", text):
        path, _, anchor = link.partition("#")
        target = document.parent / path if path else document
        assert "://" in link or target.exists(), link
        if anchor:
            titles = re.findall(r"^#+ (.*)$", target.read_text(), re.M)
            anchors = [re.sub(r"[^a-z0-9 -]", "", t.lower()).replace(" ", "-") for t in titles]
            assert anchor in anchors, link


def present(document: Path) -> str:
    """Return a document's text, of a change log what is not released yet."""
    text = document.read_text()
    return text.split("\n## ")[1] if document.name == "CHANGELOG.md" else text


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_files_named_in_text_exist(document: Path) -> None:
    for path in re.findall(rf"`((?:{FOLDERS})/[^`* ]*)`", present(document)):
        if "my_arm" not in path:
            assert (ROOT / path).exists(), path


@pytest.mark.parametrize("section", ["", "integrator", "payload"])
def test_every_key_of_a_scene_is_listed(section: str) -> None:
    """Keys of parts are compared in test_parts.py."""
    inputs = {"payload.mass": 1.0, f"{section}.no_key".lstrip("."): 1}
    with pytest.raises(Refusal) as refused:
        load_scene("three_axis", inputs)
    requested = set(str(refused.value.valid).split(", ")) - {"joints", "integrator"}
    listed = {*scene_keys.MACHINE, *scene_keys.TIME}
    paths = {f"{section}.{key}" if section else key for key in requested}
    assert paths == {path for path in listed if path.rpartition(".")[0] == section}


def test_every_topic_and_service_is_listed() -> None:
    text = page_of("topics").read_text()
    for file in ROOT.glob("*_node/node.py"):
        source = file.read_text()
        node = file.parent.name.removesuffix("_node")
        for topic in re.findall(r"create_(?:publisher|subscription)\(\s*\w+, \"([\w/]+)\"", source):
            assert f"| `{topic}` |" in text, topic
        for service in re.findall(r"create_service\(\w+, \"~/(\w+)\"", source):
            assert f"| `{node}/{service}` |" in text, service


def test_no_page_neglects_a_part_that_has_a_page() -> None:
    text = page_of("physics").read_text()
    neglected = text[text.index("## What is neglected") :].lower()
    for page in (DOCS / "reference" / "parts").glob("*.md"):
        words = page.stem.replace("_gear", "").replace("_", " ")
        if page.stem not in ("README", "friction"):
            assert words not in neglected, f"{page.name} states how a scene has it"


def test_the_depths_of_queues_are_those_of_the_nodes() -> None:
    page = page_of("topics").read_text()
    text = " ".join(
        page[page.index("QoS: commands") : page.index("`tool_target`: `header")].split()
    )
    for words, profile in (
        ("receivers queue {} messages", COMMAND_SUB_QOS),
        ("subscribed best effort, depth {}", STATE_SUB_QOS),
        ("Publishers keep {} messages", STATE_PUB_QOS),
        ("Publishers keep {} messages", COMMAND_QOS),
    ):
        assert words.format(profile.depth) in text
    nodes = "".join(file.read_text() for file in ROOT.glob("*_node/node.py"))
    assert not re.search(r"create_subscription\([^)]*, \d+\s*\)", nodes), "a depth of its own"


def test_tolerances_named_in_the_physics_are_those_of_the_core() -> None:
    text = page_of("physics").read_text()
    located = (ROOT / "arm_emulator" / "core" / "schemes" / "event_location.hpp").read_text()
    instant = re.search(r"kInstant = (\S+);", located)
    assert instant and f"ceased to hold, to {instant[1]} of the step." in text


def _constants(file: Path) -> dict[str, Any]:
    """Return the numbers that an example assigns to names in capitals."""
    result = {}
    for name, value in re.findall(r"^([A-Z_]+) = ([^#\n]*)", file.read_text(), re.M):
        result[name] = eval(value, {"math": math, "np": np, **result})
    return result


def test_examples_have_the_numbers_of_the_scene() -> None:
    from arm_emulator.motion.model.config import load_motion_config
    from arm_emulator.servo.servo_config import load_servo_config

    scene = load_scene("three_axis")
    servo = load_servo_config(ROOT / "config" / "servo" / "three_axis.yaml")
    motion = load_motion_config(ROOT / "config" / "motion" / "three_axis.yaml")
    counts = {joint.count_angle for joint in servo.joints}
    ratios = {joint.gear_ratio for joint in servo.joints}
    folder = ROOT / "examples"
    mine = _constants(folder / "my_servo.py")
    assert {mine["COUNT"]} == counts, "my_servo.py: COUNT"
    assert mine["MOTION_TICKS"] * scene.servo_period == pytest.approx(motion.period)
    volts = float(re.findall(r"(\S+) V for each radian", (folder / "my_servo.py").read_text())[0])
    assert {mine["GAIN"]} == {volts / ratio for ratio in ratios}, "my_servo.py: GAIN"
    assert _constants(folder / "my_motion_controller.py")["PERIOD"] == round(1e9 * motion.period)
    unit = _constants(folder / "simulate_fmu.py")
    assert ({unit["COUNT"]}, unit["PERIOD"]) == (counts, scene.servo_period), "simulate_fmu.py"
    assert unit["TARGET"][1:].tolist() == list(scene.start[1:]), "simulate_fmu.py: TARGET"


@pytest.mark.parametrize("name", ["three_axis", "ur5", "panda", "so_arm100"])
def test_a_servo_has_the_data_sheet_of_its_scene(name: str) -> None:
    scene = yaml.safe_load((ROOT / "config" / f"{name}.yaml").read_text())
    (servo,) = yaml.safe_load((ROOT / "config" / "servo" / f"{name}.yaml").read_text()).values()
    servo = servo["ros__parameters"]
    assert servo["supply_voltage"] == scene["supply_voltage"], "supply"
    assert servo["period"] == scene["servo_period"], "period"
    assert servo["joint_names"] == list(scene["joints"]), "joints"
    for joint, section in scene["joints"].items():
        drive, motor = servo["joints"][joint], section["motor"]
        expected = {
            **{key: motor[key] for key in ("resistance", "torque_constant", "back_emf_constant",
                                           "rotor_inertia")},
            "inductance": motor.get("inductance", 0.0),
            "current_bandwidth": motor.get("current_loop", {}).get("bandwidth", 0.0),
            "gear_ratio": section["gear"]["ratio"],
            "counts_per_turn": section["encoder"]["counts_per_turn"],
        }  # fmt: skip
        for key, value in expected.items():
            assert drive.get(key, 0.0) == pytest.approx(value, rel=1e-9), f"{joint}: {key}"
        if "current_limit" in motor:
            assert drive["current_limit"] <= motor["current_limit"], f"{joint}: current_limit"


REPORTED = """#include <stdio.h>
#include "board.h"
#include "converters.h"
#define AT(name) (unsigned)(uintptr_t)&name
int main(void) {
  for (int j = 0; j < 6; ++j)
    printf("%u %u %u %u %u %g ", AT(ENCODER(j)), AT(ADC_JDR(j)), AT(COMPARE(j)), AT(TARGET(j)),
           j < 4 ? AT(TIM1_ARR) : AT(TIM8_ARR), (double)adc_scale(j));
  printf("%d %d %g", PWM_TOP, ADC_MIDDLE, (double)FULL_SCALE);
}
"""


def test_the_board_of_the_example_is_that_of_its_firmware(tmp_path: Path) -> None:
    """Addresses and numbers of its headers, as C has them, against board.yaml and ur5."""
    folder = ROOT / "packages/arm_emulator_firmware/arm_emulator_firmware/examples/stm32f4_like"
    board = yaml.safe_load((folder / "board.yaml").read_text())
    scene = yaml.safe_load((ROOT / "config" / "ur5.yaml").read_text())
    (tmp_path / "reported.c").write_text(REPORTED)
    include = [f"-I{folder}", f"-I{ROOT / 'arm_emulator/servo/c'}"]
    command = [
        *find_compiler(),
        "-x",
        "c",
        "-w",
        *include,
        str(tmp_path / "reported.c"),
        "-o",
        "reported",
    ]
    subprocess.run(command, check=True, cwd=tmp_path)
    words = subprocess.run(tmp_path / "reported", capture_output=True, text=True, check=True).stdout
    *rows, top, middle, supply = map(float, words.split())
    channels = {
        name: item for adc in board["adc"].values() for name, item in adc["channels"].items()
    }
    for joint, row in zip(scene["joints"], np.reshape(rows, (-1, 6)).tolist(), strict=True):
        pwm, channel = board["pwm"][joint], channels[joint]
        expected = [
            *(board["encoders"][joint]["at"], channel["at"], pwm["compare"]),
            *(board["targets"]["joints"][joint], pwm["reload"], channel["counts_per_ampere"]),
        ]
        assert row == expected, f"{joint}: addresses, and counts per ampere"
        assert (channel["offset"], 2 ** channel["bits"]) == (middle, 2 * middle), joint
    assert {supply} == {value["full_scale"] for value in board["pwm"].values()}, "full scale"
    assert float(board["clock"]) / top * scene["servo_period"] % 1.0 == 0.0, (
        "whole periods of the PWM"
    )
    first = (folder / "targets.csv").read_text().splitlines()[1].split(",")
    begins = [section["start"] for section in scene["joints"].values()]
    assert [float(item) for item in first[1:]] == begins, "targets.csv begins where ur5 does"


def test_a_command_draws_every_picture_and_measured_table() -> None:
    assert {file.name for file in pages.PICTURES.iterdir()} == set(pages.PAINTERS)
    for name, page in pages.find_tables().items():
        bench = import_bench(name)
        assert callable(bench.run_bench) and callable(bench.write_report)
        text = page.read_text()
        changed = pages.put_table(text, name, "| a table |")
        assert "| a table |\n<!-- end" in changed
        start, end = text.index(f"<!-- {name}: "), text.index(f"<!-- end {name} -->")
        assert changed.startswith(text[:start]) and changed.endswith(text[end:])
    with pytest.raises(Refusal, match="place of nothing must stand on one page once, got 0"):
        pages.put_table("no place", "nothing", "")
