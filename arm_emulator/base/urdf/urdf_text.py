"""URDF texts from outside: read and parsed within bounds, joints without limits made unlimited."""

import codecs
import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from arm_emulator.base.io.text_file import read_bytes
from arm_emulator.base.refusal import Refusal

MAX_BYTES = 16 << 20
MAX_MARKS = 400_000  # of `<`: bounds the number of elements
MAX_LEVELS = 64
UNLIMITED = 1e9  # rad or m: position limit of a joint without limits
ENDLESS = 1e5  # rad or m: a limit from here on is a placeholder (999999)

_DECLARED = re.compile(rb"""^\s*<\?xml[^>]*?(\sencoding\s*=\s*["']([A-Za-z0-9._-]{1,40})["'])""")
_SINGLE_BYTE = (
    "ascii",
    "iso8859-1",
    "iso8859-15",
    "cp1252",
)  # encodings of URDFs, besides


def read_urdf(file: Path) -> str:
    """Return the text of a URDF file.

    It is read as UTF-8 if possible, else in the declared encoding.

    Raises:
        Refusal: the file is missing, too large, or not text.
    """
    content = read_bytes(file, MAX_BYTES)
    for mark in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        if content.startswith(mark):
            return _decode_text(content, "utf-16", file)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        declared = _DECLARED.match(content)
        if declared is None:
            return _decode_text(content, "utf-8", file)
        # The text is published in UTF-8, and must not declare another encoding.
        rest = content[: declared.start(1)] + content[declared.end(1) :]
        return _decode_text(rest, declared[2].decode("ascii"), file)


def _decode_text(content: bytes, encoding: str, file: Path) -> str:
    try:
        codec = codecs.lookup(encoding).name
        if codec in ("utf-8", "utf-16", *_SINGLE_BYTE):
            return content.decode(codec)
        reason = "another"
    except (LookupError, UnicodeDecodeError) as error:
        reason = getattr(error, "reason", "an unknown one")
    rule = f"be written in UTF-8, or in the encoding that it declares ({encoding})"
    raise Refusal(file.name, "file", rule, reason)


def parse_urdf(text: str, where: str) -> ET.Element:
    """Return the element <robot> of a URDF text.

    Names are used as written; `xmlns` is an ordinary attribute.

    Args:
        text: the URDF.
        where: its name in refusals.

    Raises:
        Refusal: not well-formed, too large or too deep, with a document type, or another root.
    """
    if text.count("<") > MAX_MARKS:
        raise Refusal(where, "file", f"have at most {MAX_MARKS} opening and closing tags", "more")
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data

    def refuse_doctype(*_: object) -> None:
        raise Refusal(where, "file", "have no document type", "<!DOCTYPE")

    parser.StartDoctypeDeclHandler = refuse_doctype
    try:
        parser.Parse(text, True)
        robot = builder.close()
    except Refusal:
        raise
    except (expat.ExpatError, ValueError) as error:  # ValueError: half of a surrogate pair
        raise Refusal(where, "file", "be well-formed XML", error) from None
    assert isinstance(robot, ET.Element)
    if robot.tag != "robot":
        raise Refusal(where, "root element", "be <robot>", f"<{robot.tag}>")
    _check_levels(robot, where)
    if "<xacro:" in text:
        for element in robot.iter():
            if element.tag.startswith("xacro:"):
                valid = "the output of `xacro FILE > robot.urdf`"
                raise Refusal(
                    where, "file", "be a URDF, not a xacro source", f"<{element.tag}>", valid
                )
    return robot


def _check_levels(robot: ET.Element, where: str) -> None:
    level = [robot]
    for _ in range(MAX_LEVELS):
        level = [child for element in level for child in element]
    if level:
        raise Refusal(where, "file", f"nest at most {MAX_LEVELS} levels", "more")


def complete_limits(robot: ET.Element, where: str) -> bool:
    """Make joints unlimited for which the URDF gives no limit, or those from `ENDLESS` on.

    Other readers of a URDF refuse such a joint, or take 0 for both. A revolute joint becomes a
    continuous one, a prismatic one gets limits of +-`UNLIMITED`. They also refuse a limit without
    effort or velocity, which becomes 0: unknown. Other attributes of a limit stay.

    Returns:
        Whether anything was changed.

    Raises:
        Refusal: a limit that is no number, or a lower limit above the upper one.
    """
    changed = False
    for joint in robot.findall("joint"):
        kind = joint.get("type")
        if kind not in ("revolute", "prismatic"):
            continue
        limit = joint.find("limit")
        values = {} if limit is None else limit.attrib
        bounds = [_check_bound(joint, key, values.get(key), where) for key in ("lower", "upper")]
        if bounds[0] > bounds[1]:
            label = f"joint {joint.get('name')}: limit"
            raise Refusal(where, label, "have lower <= upper", f"{bounds[0]:g} > {bounds[1]:g}")
        if "lower" not in values and "upper" not in values:
            bounds = [-math.inf, math.inf]
        elif not any(math.isinf(bound) for bound in bounds) and {"effort", "velocity"} <= {*values}:
            continue
        changed = True
        rest = {key: values[key] for key in values if key not in ("lower", "upper")}
        if limit is not None:
            joint.remove(limit)
        if kind == "revolute" and bounds == [-math.inf, math.inf]:
            joint.set("type", "continuous")
        else:
            lower, upper = (repr(max(-UNLIMITED, min(bound, UNLIMITED))) for bound in bounds)
            rest |= {"lower": lower, "upper": upper}
        if rest:
            ET.SubElement(joint, "limit", {"effort": "0", "velocity": "0"} | rest)
    return changed


def _check_bound(joint: ET.Element, key: str, text: str | None, where: str) -> float:
    try:
        value = float(text or "0")
    except ValueError:
        value = math.nan
    if math.isnan(value):
        label = f"joint {joint.get('name')}: limit {key}"
        raise Refusal(where, label, "be a number", repr(text))
    return value if abs(value) < ENDLESS else math.copysign(math.inf, value)


def read_limits(robot: ET.Element) -> dict[str, tuple[float, float]]:
    """Return lower and upper limits of the moving joints that have both, by name [rad or m].

    The URDF's limits are numbers, see `complete_limits`.
    """
    limits = {}
    for joint in robot.findall("joint"):
        limit = joint.find("limit")
        if limit is None or joint.get("type") not in ("revolute", "prismatic"):
            continue
        lower, upper = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
        if max(-lower, upper) < UNLIMITED:
            limits[joint.get("name") or ""] = lower, upper
    return limits
