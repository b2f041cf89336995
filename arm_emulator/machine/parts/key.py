"""Keys of a part's section that are no numbers of the part, for the pages."""

from dataclasses import KW_ONLY, dataclass


@dataclass(frozen=True)
class Key:
    """A key that the reader of a section knows, as its page shows it.

    Attributes:
        name: below the section of the part; of a part that shares a section with others, in it.
        unit: empty where it has none.
        range: valid values.
        absent: what holds without it.
        text: what it is, in a line.
    """

    name: str
    _: KW_ONLY
    unit: str = ""
    range: str
    absent: str = "none"
    text: str
