"""Additions of the site to docs/: the pages of the packages, and a page for each linked file.

A package's page stands in the site where one of docs/ with the same path would. A link to a file
outside of docs/ leads to a page of the site that shows that file. mkdocs calls `on_...`
(mkdocs.yml, `hooks`).
"""

import fnmatch
import posixpath
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGE = re.compile(r"(?:packages/\w+/)?docs/(.+)")
LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")
# Pages of the site for the pages at the top of the repository.
TOP = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contribute/contributing.md",
    "CHANGELOG.md": "contribute/changelog.md",
    "SECURITY.md": "contribute/security.md",
}
PACKAGES = sorted(ROOT.glob("packages/*/docs"))
LANGUAGES = {".h": "c", ".hpp": "cpp", ".py": "python", ".yaml": "yaml", ".c": "c", ".msg": "text"}


class Missing(Exception):
    """A page names what is not there."""


def list_page_files() -> dict[str, Path]:
    """Return the file of each page of docs/ and of the packages, by its page in the site."""
    return {
        path.relative_to(folder).as_posix(): path
        for folder in (DOCS, *PACKAGES)
        for path in sorted(folder.rglob("*.md"))
    }


def read_code_block(place: str) -> str:
    """Return a file of the repository as a block of code.

    Raises:
        Missing: no such file.
    """
    file = ROOT / place
    if not file.is_file():
        raise Missing(place)
    return f"```````{LANGUAGES.get(file.suffix, 'text')}\n{file.read_text().rstrip()}\n```````"


def find_published_path(target: str) -> str:
    """Return the page of the site for a file or folder of the repository."""
    if match := PAGE.match(target):
        return match[1]
    return TOP.get(target) or f"source/{target}.md"


def relink_text(text: str, at: str, page: str) -> tuple[str, set[str]]:
    """Return a text whose links hold in the site, and what it links outside of docs/.

    Args:
        text: of a file of the repository.
        at: that file.
        page: its page in the site.
    """
    outside: set[str] = set()

    def replace_link(match: re.Match[str]) -> str:
        if "://" in match[1] or match[1].startswith("mailto:"):
            return match[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(at), match[1]))
        if not PAGE.match(target) and target not in TOP:
            outside.add(target)
        path = posixpath.relpath(find_published_path(target), posixpath.dirname(page) or ".")
        return f"{path}{match[2] or ''}"

    parts = re.split(r"(^```.*?^```[^\n]*$)", text, flags=re.M | re.S)
    parts[::2] = [LINK.sub(replace_link, part) for part in parts[::2]]
    return "".join(parts), outside


def find_source_page(target: str) -> str:
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
    return f"# {target}\n\n{read_code_block(target)}"


def expand_pages(nav: Any) -> Any:
    """Return a navigation in which a pattern is the list of its pages that no other entry names."""
    named, pages = set(_list_entries(nav)), sorted(list_page_files())

    def expand_entry(entry: Any) -> Any:
        if isinstance(entry, dict):
            return {title: expand_entry(below) for title, below in entry.items()}
        if isinstance(entry, list):
            return [page for below in entry for page in _convert_to_list(expand_entry(below))]
        if "*" in entry:
            return [page for page in fnmatch.filter(pages, entry) if page not in named]
        return entry

    return expand_entry(nav)


def _convert_to_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _list_entries(nav: Any) -> Iterator[str]:
    """Yield the pages and patterns of a navigation."""
    below = nav.values() if isinstance(nav, dict) else _convert_to_list(nav)
    for entry in below:
        if isinstance(entry, str):
            yield entry
        else:
            yield from _list_entries(entry)


def on_config(config: Any) -> Any:
    """List the pages that the navigation names by a pattern."""
    config.nav = expand_pages(config.nav)
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages of packages, those at the top of the repository, and those of linked files."""
    from mkdocs.structure.files import File, InclusionLevel

    linked: set[str] = set()
    for page, path in list_page_files().items():
        if DOCS not in path.parents:
            files.append(File.generated(config, page, content=path.read_text()))
        linked |= relink_text(path.read_text(), path.relative_to(ROOT).as_posix(), page)[1]
    for top, page in TOP.items():
        if page != "index.md":
            text, outside = relink_text((ROOT / top).read_text(), top, page)
            files.append(File.generated(config, page, content=text))
            linked |= outside
    for target in sorted(linked):
        source = File.generated(
            config, find_published_path(target), content=find_source_page(target)
        )
        source.inclusion = InclusionLevel.NOT_IN_NAV
        files.append(source)
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead the links of a page to pages of the site."""
    place = page.file.src_uri
    if place.startswith("source/") or (place in TOP.values() and place != "index.md"):
        return markdown
    return relink_text(markdown, list_page_files()[place].relative_to(ROOT).as_posix(), place)[0]
