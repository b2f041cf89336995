"""The layout of Foxglove names topics, fields and joints that a network has, each panel once."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from draws import some

from arm_emulator import Refusal, load_scene
from arm_emulator.ros.messages.message_types import list_fields, read_definition
from arm_emulator_export.commands.foxglove import write_foxglove_layout

TABLE = Path(__file__).resolve().parents[3] / "docs/reference/topics.md"
PATH = re.compile(r"(/[a-z_/0-9]+)\.([a-z_]+)(?:\[(\d+)\])?$")
SCENES = ["three_axis", "ur5", "panda"]


def types() -> dict[str, str]:
    rows = re.findall(r"^\| (`[^|]+`) \| ([a-z_]+)/([A-Z]\w+) \|", TABLE.read_text(), re.M)
    return {
        topic: f"{package}/msg/{kind}"
        for topics, package, kind in rows
        for topic in re.findall("`([a-z_/]+)`", topics)
    }


def panels_of(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    else:
        assert tree["direction"] in ("row", "column") and 0 < tree["splitPercentage"] < 100
        yield from panels_of(tree["first"])
        yield from panels_of(tree["second"])


def named(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for name, child in value.items():
            yield from named(child, name)
    elif isinstance(value, list):
        for child in value:
            yield from named(child, key)
    elif isinstance(value, str):
        yield key, value


@pytest.mark.parametrize("scene", some(SCENES, 2))
@pytest.mark.parametrize("namespace", ["", "/cell1"])
def test_topics_and_fields_of_a_layout_exist(scene: str, namespace: str, tmp_path: Path) -> None:
    file = tmp_path / "layout.json"
    assert write_foxglove_layout(scene, file, namespace=namespace) == 0
    layout = json.loads(file.read_text())
    panels, joints, topic_types = layout["configById"], load_scene(scene).joint_names, types()
    printed = list(panels_of(layout["layout"]))
    printed += [item["layout"] for item in panels["Tab!signals"]["tabs"]]
    assert sorted(printed) == sorted(panels), "each panel once"
    topics = 0
    for key, text in named(panels):
        if key == "value":
            result = PATH.match(text)
            assert result is not None, text
            topic, field, index = result.groups()
            kind = topic_types[topic.removeprefix(f"{namespace}/")]
            have = {
                field.split()[1]: field.split()[0] for field in list_fields(read_definition(kind))
            }
            assert field in have, (text, have)
            assert ("[" in have[field]) == (index is not None), text
        elif text.startswith("/") and "/" in text:
            assert text.removeprefix(f"{namespace}/") in topic_types, text
            topics += 1
    assert topics >= 4
    plots = [
        item for name, item in panels.items() if name[:5] == "Plot!" and len(item["paths"]) > 1
    ]
    assert len(plots) >= 6
    for plot in plots:
        assert [path["label"] for path in plot["paths"]] == list(joints)
        places = [re.findall(r"\[(\d+)\]$", path["value"]) for path in plot["paths"]]
        assert places == [[str(k)] for k in range(len(joints))]
    with pytest.raises(Refusal, match="be new"):
        write_foxglove_layout(scene, file)
