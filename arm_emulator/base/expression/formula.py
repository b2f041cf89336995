"""Formulas as text: signal temporal logic over signals by name.

From loose to tight: ``implies`` (``->``), ``or``, ``and``, ``until[a, b]``, then ``not``,
``always[a, b]`` and ``eventually[a, b]``, then comparisons of arithmetic. core/boundary/formula.c
evaluates them for conditions, breakpoints and campaigns alike.

Formulas nest at most `DEEPEST` levels, as a text has parentheses and prefixes. Arithmetic may be
deeper, since each term of a sum is a level: it is walked by `fold_expression`, without recursion.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from arm_emulator.base.refusal import Refusal

FUNCTIONS = {"abs": 1, "sqrt": 1, "min": 2, "max": 2}  # with how many arguments at least
OPERATORS = ("always", "eventually", "until", "not", "and", "or", "implies")
COMPARISONS = ("<=", ">=", "<", ">")
LONGEST, DEEPEST = 4000, 60  # characters, levels
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    r"|(?P<name>[A-Za-z_]\w*(?:\.(?:\w+|\*))*)"
    r"|(?P<sign>->|<=|>=|[-+*/()\[\],:<>]))"
)


@dataclass(frozen=True)
class Constant:
    """A number."""

    value: float


@dataclass(frozen=True)
class Signal:
    """A signal by its name, which may have a ``*`` in the place of a part."""

    name: str


@dataclass(frozen=True)
class Operation:
    """Arithmetic: ``+ - * /``, or a function of `FUNCTIONS`."""

    sign: str
    of: tuple[Expression, ...]


Expression = Constant | Signal | Operation


@dataclass(frozen=True)
class Margin:
    """A comparison that holds by so much: ``less <= more`` by more - less."""

    more: Expression
    less: Expression
    strict: bool = False
    """Whether it is ``<`` or ``>``, which do not hold by 0."""

    @property
    def sides(self) -> tuple[Expression, Expression]:
        """The side that shall be more, and the one that shall be less."""
        return self.more, self.less


@dataclass(frozen=True)
class Combined:
    """``not``, ``and`` or ``or`` of formulas."""

    sign: str
    of: tuple[Formula, ...]


@dataclass(frozen=True)
class Window:
    """``always``, ``eventually`` or ``until`` of formulas, from begin to end [s] later."""

    sign: str
    of: tuple[Formula, ...]
    begin: float = 0.0
    end: float = math.inf


Formula = Margin | Combined | Window
_Any = Expression | Formula
_T = TypeVar("_T")


def fold_expression(expression: Expression, visit: Callable[[Expression, Sequence[_T]], _T]) -> _T:
    """Return what a function makes of arithmetic, whatever its depth.

    Args:
        expression: the arithmetic.
        visit: gets each part with its own results for the operands, operands first.
    """
    results: list[_T] = []
    pending = [(expression, False)]
    while pending:
        part, visited = pending.pop()
        operands = part.of if isinstance(part, Operation) else ()
        if operands and not visited:
            pending.append((part, True))
            pending.extend((operand, False) for operand in reversed(operands))
            continue
        first = len(results) - len(operands)
        results[first:] = [visit(part, results[first:])]
    return results[0]


def parse_formula(text: str, where: str, quantity: str) -> Formula:
    """Return the formula that a text states.

    Raises:
        Refusal: it states something else; with the place in the text.
    """
    parser = _Parser(text, where, quantity)
    parsed = parser.parse_implication(0)
    parser.finish_text()
    return parser.require_formula(parsed)


def parse_expression(text: str, where: str, quantity: str) -> Expression:
    """Return the arithmetic that a text states.

    Raises:
        Refusal: it states something else; with the place in the text.
    """
    parser = _Parser(text, where, quantity)
    parsed = parser.parse_implication(0)
    parser.finish_text()
    return parser.require_expression(parsed)


class _Parser:
    def __init__(self, text: str, where: str, quantity: str) -> None:
        self._where, self._quantity = where, quantity
        if len(text) > LONGEST:
            raise self._make_refusal(f"have at most {LONGEST} characters", len(text))
        self._tokens = list(self._split_text(text))
        self._at = 0

    def _make_refusal(self, rule: str, actual: object, valid: str | None = None) -> Refusal:
        return Refusal(self._where, self._quantity, rule, actual, valid)

    def _split_text(self, text: str) -> Iterator[tuple[str, str, int]]:
        at, end = 0, len(text.rstrip())
        while at < end:
            match = _TOKEN.match(text, at)
            if match is None:
                left = text[at:].lstrip()
                actual = f"{left[:12]!r} at character {len(text) - len(left) + 1}"
                raise self._make_refusal("be a formula", actual, "names, numbers, operators")
            kind = match.lastgroup or ""
            yield kind, match[kind], match.start(kind) + 1
            at = match.end()

    @property
    def _next(self) -> str:
        return self._tokens[self._at][1] if self._at < len(self._tokens) else ""

    def _take_word(self, *words: str) -> str:
        word = self._next
        if word in words and word:
            self._at += 1
            return word
        return ""

    def _refuse_token(self, valid: str) -> Refusal:
        if self._at >= len(self._tokens):
            return self._make_refusal("be a whole formula", "its end", valid)
        _, word, place = self._tokens[self._at]
        return self._make_refusal("be a formula", f"{word!r} at character {place}", valid)

    def _expect_word(self, word: str) -> None:
        if not self._take_word(word):
            raise self._refuse_token(repr(word))

    def finish_text(self) -> None:
        if self._at < len(self._tokens):
            raise self._refuse_token("an operator such as and, until, <=")

    def require_formula(self, parsed: _Any) -> Formula:
        if isinstance(parsed, Constant | Signal | Operation):
            raise self._make_refusal("be a comparison", "a number", "such as abs(v.elbow) <= 2")
        return parsed

    def require_expression(self, parsed: _Any) -> Expression:
        if not isinstance(parsed, Constant | Signal | Operation):
            raise self._make_refusal("be a number where it is computed with", "a comparison")
        return parsed

    def parse_implication(self, depth: int) -> _Any:
        if depth > DEEPEST:
            raise self._make_refusal(f"nest at most {DEEPEST} levels", "more")
        left = self._parse_or(depth + 1)
        if not self._take_word("implies", "->"):
            return left
        right = self.require_formula(self.parse_implication(depth + 1))
        return Combined("or", (Combined("not", (self.require_formula(left),)), right))

    def _parse_or(self, depth: int) -> _Any:
        return self._parse_chain("or", self._parse_and, depth)

    def _parse_and(self, depth: int) -> _Any:
        return self._parse_chain("and", self._parse_until, depth)

    def _parse_chain(self, sign: str, tighter: Callable[[int], _Any], depth: int) -> _Any:
        """Return one operation for all parts that an operator joins, so that none is deep."""
        parts = [tighter(depth)]
        while self._take_word(sign):
            parts.append(tighter(depth))
        return (
            parts[0] if len(parts) == 1 else Combined(sign, tuple(map(self.require_formula, parts)))
        )

    def _parse_until(self, depth: int) -> _Any:
        left = self._parse_prefixed(depth)
        if not self._take_word("until"):
            return left
        begin, end = self._parse_interval()
        right = self.require_formula(self._parse_prefixed(depth))
        return Window("until", (self.require_formula(left), right), begin, end)

    def _parse_prefixed(self, depth: int) -> _Any:
        if depth > DEEPEST:
            raise self._make_refusal(f"nest at most {DEEPEST} levels", "more")
        if self._take_word("not"):
            return Combined("not", (self.require_formula(self._parse_prefixed(depth + 1)),))
        if sign := self._take_word("always", "eventually"):
            begin, end = self._parse_interval()
            return Window(
                sign, (self.require_formula(self._parse_prefixed(depth + 1)),), begin, end
            )
        return self._parse_comparison(depth)

    def _parse_interval(self) -> tuple[float, float]:
        if not self._take_word("["):
            return 0.0, math.inf
        begin = self._parse_number("0")
        if not self._take_word(",", ":"):
            raise self._refuse_token("',' and the end of the interval")
        end = self._parse_number("end")
        self._expect_word("]")
        if not begin <= end:
            raise self._make_refusal(
                "have intervals [a, b] with a <= b [s]", f"[{begin:g}, {end:g}]"
            )
        return begin, end

    def _parse_number(self, example: str) -> float:
        if self._take_word("end", "inf"):
            return math.inf
        kind, word, _ = self._tokens[self._at] if self._next else ("", "", 0)
        if kind != "number":
            raise self._refuse_token(f"a number of seconds, or {example}")
        self._at += 1
        return float(word)

    def _parse_comparison(self, depth: int) -> _Any:
        left = self._parse_sum(depth)
        margins: list[Formula] = []
        while sign := self._take_word(*COMPARISONS):
            right = self.require_expression(self._parse_sum(depth))
            less, more = (left, right) if sign[0] == "<" else (right, left)
            strict = sign in ("<", ">")
            margins.append(
                Margin(self.require_expression(more), self.require_expression(less), strict)
            )
            left = right
        if not margins:
            return left
        return margins[0] if len(margins) == 1 else Combined("and", tuple(margins))

    def _parse_sum(self, depth: int) -> _Any:
        left = self._parse_product(depth)
        while sign := self._take_word("+", "-"):
            left = self._build_operation(sign, left, self._parse_product(depth))
        return left

    def _parse_product(self, depth: int) -> _Any:
        left = self._parse_signed(depth)
        while sign := self._take_word("*", "/"):
            left = self._build_operation(sign, left, self._parse_signed(depth))
        return left

    def _build_operation(self, sign: str, *of: _Any) -> Operation:
        return Operation(sign, tuple(map(self.require_expression, of)))

    def _parse_signed(self, depth: int) -> _Any:
        if depth > DEEPEST:
            raise self._make_refusal(f"nest at most {DEEPEST} levels", "more")
        if self._take_word("-"):
            return self._build_operation("-", Constant(0.0), self._parse_signed(depth + 1))
        return self._parse_primary(depth)

    def _parse_primary(self, depth: int) -> _Any:
        if self._take_word("("):
            inner = self.parse_implication(depth + 1)
            self._expect_word(")")
            return inner
        kind, word, _ = self._tokens[self._at] if self._next else ("", "", 0)
        if kind == "number":
            self._at += 1
            return Constant(float(word))
        if kind != "name" or word in OPERATORS:
            raise self._refuse_token("a signal, a number, always, eventually, not or (")
        self._at += 1
        if self._next == "(":
            return self._parse_function(word, depth)
        return Signal(word)

    def _parse_function(self, name: str, depth: int) -> Operation:
        if name not in FUNCTIONS:
            raise self._make_refusal("use known functions", name, ", ".join(FUNCTIONS))
        self._expect_word("(")
        of = [self.require_expression(self.parse_implication(depth + 1))]
        while self._take_word(","):
            of.append(self.require_expression(self.parse_implication(depth + 1)))
        self._expect_word(")")
        fewest = FUNCTIONS[name]
        if len(of) < fewest or (fewest == 1 and len(of) > 1):
            expected = f"{fewest} argument" if fewest == 1 else f"{fewest} arguments or more"
            raise self._make_refusal(f"give {name} {expected}", len(of))
        return Operation(name, tuple(of))


# Formulas over known signals: names are checked, and a `*` stands for each that fits.


def list_signals(formula: Formula | Expression) -> set[str]:
    """Return the names of all signals."""
    if isinstance(formula, Margin):
        return set().union(*map(list_signals, formula.sides))
    if isinstance(formula, Combined | Window):
        return set().union(*map(list_signals, formula.of))
    names: set[str] = set()

    def add_signal(part: Expression, _: object) -> None:
        if isinstance(part, Signal):
            names.add(part.name)

    fold_expression(formula, add_signal)
    return names


def bind_signals(formula: Formula, signals: Iterable[str], where: str, quantity: str) -> Formula:
    """Return a formula over known signals: a comparison with a ``*`` holds for each that it means.

    Raises:
        Refusal: a signal that is not known.
    """
    signals = list(signals)
    if isinstance(formula, Margin):
        # A text for a star is the same on both sides.
        both = expand_stars(Operation("-", formula.sides), signals, where, quantity)
        sides = [difference.of for difference in both if isinstance(difference, Operation)]
        each = [Margin(more, less, formula.strict) for more, less in sides]
        return each[0] if len(each) == 1 else Combined("and", tuple(each))
    of = tuple(bind_signals(part, signals, where, quantity) for part in formula.of)
    if isinstance(formula, Combined):
        return Combined(formula.sign, of)
    return Window(formula.sign, of, formula.begin, formula.end)


def expand_stars(
    expression: Expression, signals: Sequence[str], where: str, quantity: str
) -> list[Expression]:
    """Return the arithmetic for each text that the ``*`` in names of signals stands for.

    Raises:
        Refusal: a signal that is not known, or no text that fits all.
    """
    names = sorted(list_signals(expression))
    stars = [name for name in names if "*" in name]
    for name in names:
        if name not in stars and name not in signals:
            raise _refuse_unknown(name, signals, where, quantity)
    if not stars:
        return [expression]
    fitting: list[list[str]] = []
    for name in stars:
        pattern = re.compile(re.escape(name).replace(r"\*", r"(.+)"))
        texts = [match[1] for signal in signals if (match := pattern.fullmatch(signal))]
        if not texts:
            raise _refuse_unknown(name, signals, where, quantity)
        fitting.append(texts)
    common = [text for text in fitting[0] if all(text in texts for texts in fitting[1:])]
    if not common:
        raise _refuse_unknown(", ".join(stars), signals, where, quantity)
    return [_replace_star(expression, text) for text in common]


def _replace_star(expression: Expression, text: str) -> Expression:
    def put_joint(part: Expression, operands: Sequence[Expression]) -> Expression:
        if isinstance(part, Signal):
            return Signal(part.name.replace("*", text))
        return Operation(part.sign, tuple(operands)) if isinstance(part, Operation) else part

    return fold_expression(expression, put_joint)


def _refuse_unknown(name: str, signals: Sequence[str], where: str, quantity: str) -> Refusal:
    first = sorted(
        {signal.rpartition(".")[0] + ".*" if "." in signal else signal for signal in signals}
    )
    near = difflib.get_close_matches(name, signals, n=3) or first
    return Refusal(where, quantity, "name signals of the run", name, ", ".join(near))
