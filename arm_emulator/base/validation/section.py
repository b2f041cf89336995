"""A section of a YAML file, read key by key, with refusals that name the place and the rule."""

from __future__ import annotations

from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import REQUIRED, Number, list_numbers

LARGEST_COUNT = 1_000_000_000  # steps per servo period, counts per turn: larger ones are mistakes


class Section:
    """One mapping of the file, read key by key; `refuse_unread_keys` refuses the others.

    A key that is present must have a value of the requested type; an absent one gives the
    default, if the reading method has one, or is refused.

    Args:
        data: the mapping.
        where: the file, for refusals.
        path: the dotted path of the section in it; empty at the top.
    """

    def __init__(self, data: dict[str, Any], where: str, path: str = "") -> None:
        self.where = where
        self._data = data
        self._path = path
        self._read_keys: set[str] = set()
        self._sections: dict[str, Section] = {}

    def list_keys(self) -> list[str]:
        """Return the keys of the mapping."""
        return [str(key) for key in self._data]

    def has_key(self, key: str) -> bool:
        """Return whether a key is present, and mark it as known."""
        self._read_keys.add(key)
        return key in self._data

    def set_value(self, key: str, value: object) -> None:
        """Set the value of a key as if the file contained it."""
        self._data = {**self._data, key: value}

    def make_refusal(
        self, key: str, rule: str, actual: object, valid: str | None = None
    ) -> Refusal:
        """Return the refusal of a key's value."""
        return Refusal(self.where, self._write_name(key), rule, actual, valid)

    def get_section(self, key: str) -> Section | None:
        """Return the section below a key, None if the key is absent."""
        if not self.has_key(key):
            return None
        if self._data[key] is None:
            return self._make_section(key, {})
        return self.require_section(key)

    def find_section(self, dotted: str) -> Section | None:
        """Return the section at a dotted path below this one, None if one on the way is absent."""
        section: Section | None = self
        for key in dotted.split("."):
            section = section and section.get_section(key)
        return section

    def require_section(self, key: str) -> Section:
        """Return the section below a required key."""
        value = self._take_value(key)
        if not isinstance(value, dict):
            rule = "be a section of keys and values"
            raise self.make_refusal(key, rule, "nothing" if value is None else repr(value))
        return self._make_section(key, value)

    def read_text(self, key: str, max_bytes: int = 4096) -> str:
        """Return a text of printable letters."""
        value = self._take_value(key)
        if not isinstance(value, str) or not value:
            raise self.make_refusal(key, "be a text", "nothing" if value is None else repr(value))
        if not value.isprintable():
            raise self.make_refusal(key, "have printable letters only", repr(value))
        if len(value.encode()) > max_bytes:
            raise self.make_refusal(key, f"be at most {max_bytes} bytes long", repr(value))
        return value

    def read_choice(self, key: str, choices: tuple[str, ...], default: str) -> str:
        """Return one of the choices."""
        value = self._take_value(key)
        if key not in self._data:
            return default
        if value not in choices:
            actual = "nothing" if value is None else repr(value)
            raise self.make_refusal(key, "be one of the known", actual, ", ".join(choices))
        return str(value)

    def is_true(self, key: str) -> bool:
        """Return whether the value is true; an absent key is false."""
        value = self._take_value(key)
        if key in self._data and not isinstance(value, bool):
            actual = "nothing" if value is None else repr(value)
            raise self.make_refusal(key, "be true or false", actual)
        return bool(value)

    def read_number(self, number: Number) -> float:
        """Return a number by its name, or its default."""
        value = self._take_value(number.name)
        if number.name not in self._data and number.default is not REQUIRED:
            return number.default  # type: ignore[no-any-return]
        return number.check_value(self.where, value, self._write_name(number.name))

    def read_integer(self, number: Number) -> int:
        """Return a whole number by its name, or its default."""
        return int(self.read_number(number))

    def read_numbers(self, kind: type[Any]) -> dict[str, Any]:
        """Return the numbers that a dataclass declares, by name."""
        return {name: self.read_number(number) for name, number in list_numbers(kind).items()}

    def read_vector(self, number: Number, size: int = 3) -> tuple[float, ...] | None:
        """Return a row of numbers by its name, None if it is absent."""
        value = self._take_value(number.name)
        if value is None and number.name not in self._data:
            return None
        rule = f"be {size} {number.range.replace('number', 'numbers', 1)}"
        if (
            not isinstance(value, list)
            or len(value) != size
            or not all(map(number.is_in_range, value))
        ):
            raise self.make_refusal(number.name, rule, repr(value))
        return tuple(float(entry) for entry in value)

    def read_value(self, key: str) -> object:
        """Return the value of a key unchecked, None if it is absent."""
        return self._take_value(key)

    def read_entries(self, key: str) -> list[object]:
        """Return a list, empty if the key is absent."""
        value = self._take_value(key)
        if key not in self._data:
            return []
        if not isinstance(value, list):
            raise self.make_refusal(key, "be a list", repr(value))
        return value

    def refuse_unread_keys(self) -> None:
        """Refuse keys that were not read, here and in the sections below.

        Raises:
            Refusal: a key is unknown.
        """
        for below in self._sections.values():
            below.refuse_unread_keys()
        for key in self._data:
            if key not in self._read_keys:
                raise Refusal(
                    self.where,
                    f"key {self._write_name(str(key))}",
                    "be known",
                    repr(key),
                    ", ".join(sorted(self._read_keys)),
                )

    def _make_section(self, key: str, data: dict[str, Any]) -> Section:
        if key not in self._sections:
            self._sections[key] = Section(data, self.where, self._write_name(key))
        return self._sections[key]

    def _take_value(self, key: str) -> Any:
        self._read_keys.add(key)
        return self._data.get(key)

    def _write_name(self, key: str) -> str:
        return f"{self._path}.{key}" if self._path else key
