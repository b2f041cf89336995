"""Robot descriptions as people have them: a URDF, or a xacro source that is expanded first."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path

from words.config_files import ROBOTS
from words.refusal import Refusal
from words.text_file import why_no_file
from words.urdf_text import read_urdf


def robot_text(file: Path, arguments: Mapping[str, str]) -> str:
    """Return the URDF that a file holds, or that its xacro source expands to.

    Args:
        file: ends in ``.urdf`` or ``.xacro``.
        arguments: of the xacro source, its ``<xacro:arg>``.

    Raises:
        Refusal: no such file, another kind of file, or a source that xacro does not expand.
    """
    reason = why_no_file(file)
    if reason is not None:
        raise Refusal("new", f"file {file}", "exist", reason)
    if file.suffix not in ROBOTS:
        raise Refusal("new", f"file {file.name}", "be a robot", "another", "*.urdf, *.xacro")
    if file.suffix == ".urdf":
        if arguments:
            raise Refusal(file.name, "arguments", "come with a xacro source", list(arguments))
        return read_urdf(file)
    return _expanded(file, arguments)


def _expanded(file: Path, arguments: Mapping[str, str]) -> str:
    try:
        import xacro
    except ImportError:
        valid = "pip install xacro, or give the output of `xacro FILE > robot.urdf`"
        raise Refusal(file.name, "file", "be a URDF", "a xacro source", valid) from None
    told = io.StringIO()
    try:
        with contextlib.redirect_stderr(told):
            return str(xacro.process_file(str(file), mappings=dict(arguments)).toxml())
    # A xacro source is a program, in part of Python expressions: it may fail in any way.
    except (Exception, SystemExit) as error:
        words = " ".join(f"{error} {told.getvalue()}".split())[:300]
        raise Refusal(file.name, "file", "be what xacro expands", words) from None
