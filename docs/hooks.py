"""Additions of the site to the pages: generated text, and files that pages link.

A page may hold a line

    <!-- generated: KIND ARGUMENT -->

in whose place `GENERATORS[KIND]` puts text. A link to a file of the repository outside of docs/
leads to a page of the site that shows that file. mkdocs calls `on_...` (mkdocs.yml, `hooks`).
"""

from __future__ import annotations

import posixpath
import re
import runpy
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
GENERATED = re.compile(r"^<!-- generated: (\w+)(?: (\S+))? -->$", re.M)
DOOR = re.compile(r"^<!-- door: (.+?) \| (.+) -->$", re.M)
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")
# Pages of the site for the pages at the top of the repository.
TOP = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contribute/contributing.md",
    "CHANGELOG.md": "contribute/changelog.md",
}
LANGUAGES = {".h": "c", ".hpp": "cpp", ".py": "python", ".yaml": "yaml", ".c": "c", ".msg": "text"}


class Missing(Exception):
    """A page names what is not there."""


def _help(_: str) -> str:
    from arm_emulator.cli.arguments import page_of
    from arm_emulator.cli.command import command_names, load_command

    pages = ((name, page_of(one)) for name in command_names() if (one := load_command(name)))
    return "\n\n".join(f"## {name}\n\n```text\n{page.rstrip()}\n```" for name, page in pages)


def _command_keys(_: str) -> str:
    from arm_emulator.cli.command import command_names, load_command

    rows = (f"| `{name}` | {one.keys} |" for name in command_names() if (one := load_command(name)))
    return "\n".join(("| command | keys |", "|---|---|", *rows))


def _code(place: str) -> str:
    file = ROOT / place
    if not file.is_file():
        raise Missing(place)
    return f"```````{LANGUAGES.get(file.suffix, 'text')}\n{file.read_text().rstrip()}\n```````"


def _interfaces(place: str) -> str:
    files = sorted((ROOT / place).glob("*.msg")) or sorted((ROOT / place).glob("*.srv"))
    if not files:
        raise Missing(f"messages in {place}")
    return "\n\n".join(
        f"### {file.stem}\n\n```text\n{file.read_text().rstrip()}\n```" for file in files
    )


def _doors(which: str) -> str:
    """Return a row for each page that states what its door offers, in a comment `door: ...`.

    Args:
        which: what it `needs`, the last of the columns; or nothing, for the others.
    """
    heads = ["door", "control law", "time", "measurements", "true state", "record",
             "needs beside Python and a compiler"]  # fmt: skip
    rows = [heads, ["---"] * len(heads)]
    for page in sorted(DOCS.rglob("*.md"), key=lambda one: (one.parent.name, one), reverse=True):
        if stated := DOOR.search(page.read_text()):
            at = posixpath.relpath(page.relative_to(DOCS).as_posix(), "reference")
            rows.append([f"[{stated[1]}]({at})", *stated[2].split(" | ")])
    if len(rows) < 3:
        raise Missing("pages of doors")
    shown = ([row[0], row[-1]] if which == "needs" else row[:-1] for row in rows)
    return "\n".join(f"| {' | '.join(row)} |" for row in shown)


def _of_campaigns(what: str) -> str:
    """Return a table of what a campaign's file may have, from its declaration."""
    from arm_emulator.campaign.described import TABLES

    if what not in TABLES:
        raise Missing(f"{what} of campaigns; valid: {', '.join(TABLES)}")
    return TABLES[what]()


def _of_parts(table: str) -> Callable[[str], str]:
    """Return the generator of a table in tables.py beside this file."""

    def text(argument: str) -> str:
        made: str = runpy.run_path(str(DOCS / "tables.py"))[table](argument)
        return made

    return text


GENERATORS: dict[str, Callable[[str], str]] = {
    "campaign": _of_campaigns,
    "command_keys": _command_keys,
    "commands": _help,
    "doors": _doors,
    "faults": _of_parts("faults"),
    "file": _code,
    "inputs": _of_parts("inputs"),
    "interfaces": _interfaces,
    "joint_keys": _of_parts("joint_keys"),
    "keys": _of_parts("keys"),
    "outputs": _of_parts("outputs"),
    "parts": _of_parts("parts"),
    "scene_keys": _of_parts("scene_keys"),
    "schemes": _of_parts("schemes"),
    "sensors": _of_parts("sensors"),
}


def expand(text: str) -> str:
    """Return a page's text with what is generated in it.

    Raises:
        Missing: a generator or what it shows is not there.
    """

    def text_of(place: re.Match[str]) -> str:
        if place[1] not in GENERATORS:
            raise Missing(f"generator {place[1]}; valid: {', '.join(GENERATORS)}")
        return GENERATORS[place[1]](place[2] or "")

    return GENERATED.sub(text_of, text)


def shown_at(target: str) -> str:
    """Return the page of the site for a file or folder of the repository."""
    if target.startswith("docs/"):
        return target.removeprefix("docs/")
    return TOP.get(target) or f"source/{target}.md"


def relink(text: str, at: str, page: str) -> tuple[str, set[str]]:
    """Return a text whose links hold in the site, and what it links outside of docs/.

    Args:
        text: of a file of the repository.
        at: that file.
        page: its page in the site.
    """
    outside: set[str] = set()

    def link(found: re.Match[str]) -> str:
        if "://" in found[1] or found[1].startswith("mailto:"):
            return found[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(at), found[1]))
        if not target.startswith("docs/") and target not in TOP:
            outside.add(target)
        shown = posixpath.relpath(shown_at(target), posixpath.dirname(page) or ".")
        return f"{shown}{found[2] or ''}"

    parts = re.split(r"(^```.*?^```[^\n]*$)", text, flags=re.M | re.S)
    parts[::2] = [LINK.sub(link, part) for part in parts[::2]]
    return "".join(parts), outside


def source_page(target: str) -> str:
    """Return the page that shows a file of the repository, or lists a folder.

    Raises:
        Missing: no such file or folder.
    """
    path = ROOT / target
    if path.is_dir():
        listed = subprocess.run(
            ["git", "ls-files", target], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.split()
        return f"# {target}\n\n" + "\n".join(f"- `{file}`" for file in listed)
    return f"# {target}\n\n{_code(target)}"


def with_pages(nav: Any) -> Any:
    """Return a navigation in which a pattern is the list of its pages that no other entry names."""
    named = set(_entries(nav))

    def listed(one: Any) -> Any:
        if isinstance(one, dict):
            return {title: listed(below) for title, below in one.items()}
        if isinstance(one, list):
            return [page for below in one for page in _as_list(listed(below))]
        found = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.glob(one))
        return [page for page in found if page not in named] if "*" in one else one

    return listed(nav)


def _as_list(one: Any) -> list[Any]:
    return one if isinstance(one, list) else [one]


def _entries(nav: Any) -> Iterator[str]:
    """Yield the pages and patterns of a navigation."""
    below = nav.values() if isinstance(nav, dict) else _as_list(nav)
    for one in below:
        if isinstance(one, str):
            yield one
        else:
            yield from _entries(one)


def on_config(config: Any) -> Any:
    """List the pages that the navigation names by a pattern."""
    config.nav = with_pages(config.nav)
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages at the top of the repository, and those of linked files."""
    from mkdocs.structure.files import File, InclusionLevel

    linked: set[str] = set()
    for file in files.documentation_pages():
        at = f"docs/{file.src_uri}"
        linked |= relink((ROOT / at).read_text(), at, file.src_uri)[1]
    for top, page in TOP.items():
        if page != "index.md":
            text, outside = relink((ROOT / top).read_text(), top, page)
            files.append(File.generated(config, page, content=text))
            linked |= outside
    for target in sorted(linked):
        source = File.generated(config, shown_at(target), content=source_page(target))
        source.inclusion = InclusionLevel.NOT_IN_NAV
        files.append(source)
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Generate what a page asks for, and lead its links to pages of the site."""
    place = page.file.src_uri
    if place.startswith("source/") or (place in TOP.values() and place != "index.md"):
        return markdown
    return relink(expand(markdown), f"docs/{place}", place)[0]
