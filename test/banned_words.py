"""Words that the prose of this project does without: those of the glossary's last table.

Docstrings and comments of code must begin with a noun or a verb, not with a word such as "What".

`make lint` runs this file.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GLOSSARY = ROOT / "docs" / "contribute" / "glossary.md"
ROOMS = (
    *("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs", "examples", "arm_emulator", "config"),
    *("emulator_node", "servo_node", "motion_controller_node", "launch", "msg", "oracles", "bench"),
    *("test", "tools", "packages"),
)
# Between the words of a phrase: names have underscores, comments begin their lines anew.
GAP = r"(?:[\s_#*]|//)+"
SPARED = (GLOSSARY, Path(__file__).resolve(), ROOT / "test/project/test_banned_words.py")
ENDINGS = {".md", ".py", ".c", ".h", ".cpp", ".hpp", ".yaml", ".msg", ".srv"}
CODE = {".py", ".c", ".h", ".cpp", ".hpp"}
# "Where ..." may begin a comment: it is often a condition.
OPENING = re.compile(
    r'^[ \t]*(?:r?"""(?=Where\b)|(?:r?"""|# |/{2,3} |/\* )(?=(?:What|Who|Which|How|Nobody)))'
    r"(Where|What(?:ever)?|Who(?:ever)?|Which(?:ever)?|How|Nobody)\b",
    re.M,
)


# A test is named after its claim.
RIDDLE = re.compile(
    r"^[ \t]*def (test_(?:what|whatever|who|whoever|which|how|where|nobody))_", re.M
)


def banned() -> dict[str, str]:
    """Return what to write instead of each banned word or phrase."""
    table = GLOSSARY.read_text(encoding="utf-8").split("## Banned\n")[1]
    rows = re.findall(r"^\| (.+?) \| (.+?) \|$", table, re.M)[1:]
    instead_of = {word: instead for words, instead in rows for word in words.split(", ")}
    if not instead_of:
        raise SystemExit(f"{GLOSSARY}: no banned words found")
    return instead_of


def files(rooms: tuple[str, ...]) -> Iterator[Path]:
    """Yield the files that are checked."""
    for name in rooms:
        path = ROOT / name
        if not path.exists():
            raise SystemExit(f"banned_words: {name} does not exist")
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in ENDINGS and file not in SPARED:
                yield file


def text_of(file: Path) -> str:
    """Return what is checked of a file: of a change log what is not released."""
    text = file.read_text(encoding="utf-8")
    if file.name == "CHANGELOG.md":
        begin = text.index("## [Unreleased]")
        text = "\n" * text.count("\n", 0, begin) + text[begin : text.index("\n## ", begin + 1)]
    return text


def find_banned(text: str, words: dict[str, str]) -> Iterator[tuple[int, str, str]]:
    """Yield line, word and what to write instead, of each banned word in a text."""
    for word, instead in words.items():
        # Neither a method of a library nor the position of a stream is a word.
        pattern = rf"\b(?!(?<=\w\.)\w+\()(?i:{word})\b(?!\(\)|\(self\))"
        if " " in word:  # `is None` is code
            pattern = rf"(?<![^\W_])(?i:{word[0]}){word[1:].replace(' ', GAP)}(?![^\W_])"
        for match in re.finditer(pattern, text):
            yield text.count("\n", 0, match.start()) + 1, word, instead


def openings_in(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, word and replacement of each docstring, comment or test with such a beginning."""
    for match in OPENING.finditer(text):
        yield text.count("\n", 0, match.start(1)) + 1, match[1], "a noun or a verb at the beginning"
    for match in RIDDLE.finditer(text):
        yield (
            text.count("\n", 0, match.start(1)) + 1,
            match[1],
            "the test's claim: subject, verb, object",
        )


def main() -> int:
    """Print a line per banned word; exit code 1 if there is one."""
    words, count = banned(), 0
    for file in files(ROOMS):
        text = text_of(file)
        findings = [*find_banned(text, words), *(openings_in(text) if file.suffix in CODE else ())]
        for line, word, instead in sorted(findings):
            print(f"{file.relative_to(ROOT)}:{line}: '{word}' is banned; write {instead}")
            count += 1
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
