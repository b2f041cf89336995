"""The rule for names of scenes and joints, which files, comments and commands are made of."""

import unicodedata

from arm_emulator.base.refusal import Refusal

LONGEST_NAME = 100  # bytes: what files and data sheets are called after it has room for more
SCENE_MARKS = "_-.+()"  # files are called after a scene
JOINT_MARKS = "_-.+():/#[]"  # that robot descriptions of makers and of macros have


def check_scene_name(where: str, name: str) -> str:
    """Return the name of a scene; it begins with a letter, a digit or an underscore.

    Raises:
        Refusal: it breaks the rule.
    """
    _check_name(where, "name", name, SCENE_MARKS)
    if name[0] in SCENE_MARKS.replace("_", ""):
        raise Refusal(where, "name", "begin with a letter, a digit or _", repr(name))
    return name


def check_joint_name(where: str, quantity: str, name: str) -> None:
    """Refuse the name of a joint or of a unit of sensors that breaks the rule."""
    _check_name(where, quantity, name, JOINT_MARKS)


def _check_name(where: str, quantity: str, name: str, marks: str) -> None:
    if not all(c == " " or c in marks or unicodedata.category(c)[0] in "LMN" for c in name):
        rule = f"have letters, digits, blanks and {marks} only"
        raise Refusal(where, quantity, rule, repr(name))
    if not name or name != name.strip() or len(name.encode()) > LONGEST_NAME:
        rule = f"have 1 to {LONGEST_NAME} bytes, no blank at its ends"
        raise Refusal(where, quantity, rule, repr(name))
