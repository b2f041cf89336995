"""The pages that the tests compare with the code, of docs/ and of the packages."""

from pathlib import Path

from docs.hooks import list_page_files

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
DOCUMENTS = [*sorted(ROOT.glob("*.md")), *list_page_files().values()]


def page_of(name: str) -> Path:
    """Return the page of a name, `topics` or `parts/sensors`; names are unique."""
    pages = [path for path in DOCUMENTS if path.with_suffix("").as_posix().endswith(f"/{name}")]
    assert len(pages) == 1, f"pages called {name}: {pages}"
    return pages[0]
