"""Refusals: the one way in which all parts of the emulator reject an input."""

import copyreg
from typing import Any


class Refusal(ValueError):
    """A rejected input, with the reason in one line.

    The line reads ``where: quantity must rule, got value; valid: ...``, for example
    ``three_axis.yaml: joints.elbow.gear.stiffness must be a number > 0 N m/rad, got -3``.

    Args:
        where: the source of the input: a file, a topic, a function.
        quantity: the quantity that breaks the rule.
        rule: the rule with its unit, as it follows "must".
        got: the value found.
        valid: valid values, if they do not follow from the rule.
    """

    def __init__(
        self, where: str, quantity: str, rule: str, got: object, valid: str | None = None
    ) -> None:
        self.where = where
        self.quantity = quantity
        self.rule = rule
        self.got = got
        self.valid = valid
        line = (
            f"{_shorten_to_line(where, 120, of_end=True)}: {_shorten_to_line(quantity, 200)} must "
        )
        line += f"{_shorten_to_line(rule, 300)}, got {_shorten_to_line(got, 200)}"
        super().__init__(
            line if valid is None else f"{line}; valid: {_shorten_to_line(valid, 500)}"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # Unpickled without `__init__`, whose arguments are not `args`: a worker process sends it.
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


def _shorten_to_line(value: object, longest: int, *, of_end: bool = False) -> str:
    """Return `value` on one line of at most `longest` printable characters, the first or last."""
    try:
        text = str(value)
    except Exception:  # the refusal must be raised for any value
        text = f"a value of type {type(value).__name__} that cannot be shown"
    text = text[-8 * longest :] if of_end else text[: 8 * longest]
    text = " ".join(text.split()) or repr(text[:longest])
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
    if len(text) <= longest:
        return text
    return f"...{text[3 - longest :]}" if of_end else f"{text[: longest - 3]}..."
