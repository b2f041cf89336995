"""The one way in which every part of the emulator says no."""


class Refusal(ValueError):
    """An input that is not taken, told in one line.

    The line reads ``where: quantity must rule, got value; valid: ...``, for example
    ``three_axis.yaml: joints.elbow.gear.stiffness must be > 0 N m/rad, got -3``.

    Args:
        where: what was being read: a file, a topic, a function.
        quantity: the quantity that breaks the rule.
        rule: the rule with its unit, as it follows "must".
        got: the value found.
        valid: what would be valid, where the rule alone does not say so.
    """

    def __init__(
        self, where: str, quantity: str, rule: str, got: object, valid: str | None = None
    ) -> None:
        self.where = where
        self.quantity = quantity
        self.rule = rule
        self.got = got
        self.valid = valid
        line = f"{where}: {quantity} must {rule}, got {_short(got)}"
        super().__init__(line if valid is None else f"{line}; valid: {valid}")


def _short(value: object) -> str:
    """Return `value` on one line of at most 80 characters."""
    text = " ".join(str(value).split()) or repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
