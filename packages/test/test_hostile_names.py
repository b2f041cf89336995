"""Names from files are data in HTML, XML, Markdown, C, EDS: nothing of them becomes code or markup.

Every writer gets names that scenes would refuse, too: it must not rely on that rule.
"""

import ast
import configparser
import io
import re
import subprocess
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from draws import some
from hostile_names import hostile_names
from machines import CONFIG, own_three_axis
from markdown_it import MarkdownIt

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.base import escape
from arm_emulator.cli.commands.servo_header import write_header
from arm_emulator.doors.udp import Datagrams
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.runs.gains import load_gains
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fieldbus.eds import make_eds
from arm_emulator_fmu.model_description import describe_model
from arm_emulator_fmu.page import write_page
from arm_emulator_fmu.variables import list_variables
from arm_emulator_page.number_table import format_numbers

NAMES = hostile_names(200)
SCENE = load_scene("three_axis")
PLAIN = ("waist", "shoulder", "elbow")


def renamed(name: str, joints: tuple[str, ...] = PLAIN) -> Scene:
    """Return the scene with names that its file could not have."""
    of = zip(SCENE.joints, joints, strict=True)
    return replace(SCENE, name=name, joints=tuple(replace(joint, name=own) for joint, own in of))


class Tags(HTMLParser):
    """Counts the elements, attributes, comments and declarations of a page, and keeps its text."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.marks: Counter[str] = Counter()
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.marks.update([tag, *(f"{tag} {key}" for key, _ in attrs)])

    def handle_comment(self, data: str) -> None:
        self.marks["comment"] += 1

    def handle_decl(self, decl: str) -> None:
        self.marks["declaration"] += 1

    def handle_data(self, data: str) -> None:
        self.text += data


def visible(name: str) -> str:
    """Return what is to be seen of a name on one line."""
    return "".join(c if c.isprintable() else "?" for c in name)


def test_html_shows_a_name_as_it_is() -> None:
    for name in NAMES:
        tags = Tags(f'<p title="{escape.escape_html(name)}">{escape.escape_html(name)}</p>')
        assert tags.marks == {"p": 1, "p title": 1} and tags.text == visible(name), name


def test_markdown_shows_a_name_as_it_is() -> None:
    """The parser of CommonMark and tables that `rich` brings along is the judge."""
    parser = MarkdownIt("commonmark").enable(["table", "strikethrough"])
    for name in NAMES:
        text = escape.escape_markdown(name)
        visible_name = visible(" ".join(name.split()))
        inline = [token for token in parser.parse(f"Of {text} now") if token.type == "inline"]
        assert [child.content for child in inline[0].children or ()] == [
            f"Of {visible_name} now"
        ], name
        assert re.fullmatch(r"(&#\d+;)?([^!-/:-@\[-`{-~]|\\[!-~])*", text), "each mark is escaped"
        if visible_name:
            first, *more = parser.parse(text)
            assert first.type == "paragraph_open" and len(more) == 2, name
        table = parser.parse(format_numbers([name], {"q": [1.0], "v": [2.0]}))
        cells = [cell for cell in table if cell.type == "inline"]
        assert (
            len(cells) == 6 and "".join(x.content for x in cells[3].children or ()) == visible_name
        )


def test_mdx_takes_no_line_for_a_statement() -> None:
    for name in ("export const x = 1", "import x from 'y'", "export", "important"):
        assert not escape.escape_markdown(name).startswith(("import", "export"))
        (paragraph,) = [x for x in MarkdownIt().parse(escape.escape_markdown(name)) if x.children]
        assert "".join(child.content for child in paragraph.children or ()) == name


def compiled(source: str, folder: Path, *words: str) -> bytes:
    """Compile C99 without any warning, and return what it prints."""
    (folder / "names.c").write_text(source, encoding="utf-8")
    strict = "-std=c99 -pedantic -Wall -Wextra -Werror -Wno-unused-const-variable -Wno-trigraphs"
    command = [*find_compiler(), "-x", "c", *strict.split(), *words, "names.c", "-o", "names"]
    subprocess.run(command, cwd=folder, check=True)
    return subprocess.run([str(folder / "names")], capture_output=True, check=True).stdout


def test_c_prints_a_name_as_it_is(tmp_path: Path) -> None:
    names = [name.replace("\0", "") for name in NAMES]  # a string of C ends there
    lines = "".join(
        f"  /* {escape.escape_c_comment(n)} */ {escape.escape_c_string(n)},\n" for n in names
    )
    source = f"#include <stdio.h>\nstatic const char* const names[] = {{\n{lines}}};\n"
    source += (
        f"int main(void) {{ for (int k = 0; k < {len(names)}; ++k) puts(names[k]); return 0; }}\n"
    )
    printed = compiled(source, tmp_path)
    assert printed == "".join(f"{name}\n" for name in names).encode()


@pytest.mark.parametrize("name", some(NAMES, 4))
def test_headers_of_c_compile_with_any_name(name: str, tmp_path: Path) -> None:
    joints = (name, "b" + name, "c")
    header = Datagrams(renamed(name, joints)).write_header()
    source = f"{header}#include <stdio.h>\n"
    source += "int main(void) { fputs(arm_udp_joint_names[1], stdout); return 0; }\n"
    assert compiled(source, tmp_path) == ("b" + name).partition("\0")[0].encode()
    servo = load_gains(CONFIG / "three_axis.yaml").servo
    joint_names = dict(zip(PLAIN, joints, strict=True))
    servo = replace(servo, joints=tuple(replace(j, name=joint_names[j.name]) for j in servo.joints))
    source = f"{write_header(name, joints, servo)}#include <stdio.h>\n"
    source += "int main(void) { fputs(servo_names[1], stdout); return !sizeof servo_joints; }\n"
    folder = Path(escape.__file__).parents[1]
    words = (f"-I{folder / 'servo/c'}", f"-I{folder / 'core/boundary'}")
    assert compiled(source, tmp_path, *words) == ("b" + name).partition("\0")[0].encode()


def test_pages_and_descriptions_of_units_keep_their_marks() -> None:
    plain = Tags(write_page(renamed("x"), list_variables(renamed("x")), "c++").decode())
    for name in some(NAMES, 40):
        scene = renamed(name, (name + "1", name + "2", name + "3"))
        listed = list_variables(scene)
        assert Tags(write_page(scene, listed, "c++").decode()).marks == plain.marks, name
        root = ET.fromstring(describe_model(scene, listed, "{t}"))
        assert root.get("modelName") == (visible(name) or "arm")


def test_data_sheets_keep_their_sections() -> None:
    drives = Drives(Plant(SCENE), load_gains(CONFIG / "three_axis.yaml").servo, CANOPEN)
    node = CanSegment(drives, 1, lockstep=True).nodes[0]
    plain = sections(make_eds(node, "a.eds", "x"))
    for name in some(NAMES, 40):
        eds = sections(make_eds(node, name, name))
        assert eds.keys() == plain.keys(), name
        assert all(eds[key].keys() == plain[key].keys() for key in plain), name
        assert eds["DeviceInfo"]["ProductName"] == visible(name).strip(), name


def sections(text: str) -> dict[str, dict[str, str]]:
    """Return a data sheet as the tools of masters read it."""
    reader = configparser.RawConfigParser(strict=True)
    reader.optionxform = str  # type: ignore[assignment, method-assign]
    reader.read_file(io.StringIO(text))
    return {name: dict(reader[name]) for name in reader.sections()}


@pytest.mark.parametrize("seed", range(2))
def test_a_scene_takes_a_name_by_its_rule_or_refuses_it(seed: int, tmp_path: Path) -> None:
    """The rule is repeated here as a pattern."""
    allowed = re.compile(r"[\w][\w .+()-]{0,99}(?<! )")
    file = own_three_axis(tmp_path, "")
    names = [
        *hostile_names(200, seed),
        "arm 1",
        "KR-6(2)",
        "a.b",
        "é",
        "関節",
        "-a",
        "_",
        "a" * 101,
    ]
    taken = 0
    for name in names:
        try:
            taken += load_scene(file, {"name": name}).name == name
            assert allowed.fullmatch(name), name
        except Refusal as refusal:
            assert not allowed.fullmatch(name), name
            assert str(refusal).isprintable() and "name must" in str(refusal)
    assert taken >= 6


def test_the_launch_file_of_moveit_has_the_path_as_a_string() -> None:
    from arm_emulator_export.moveit_package import _NETWORK

    for name in NAMES:
        words = {"name": "arm", "package": "arm_moveit_config", "scene": name, "machine": "m"}
        tree = ast.parse(_NETWORK.format(**words))
        strings = [
            constant.value for constant in ast.walk(tree) if isinstance(constant, ast.Constant)
        ]
        assert name in strings
