"""Distributions as text, each as its quantile function: a number of (0, 1) gives the value.

So one point of the unit cube, random, of Sobol or of a Latin hypercube, gives all values of a run.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from arm_emulator.extension.base import LARGEST_NUMBER, Array, Refusal

Quantile = Callable[[Array], Array]


@dataclass(frozen=True)
class Distribution:
    """A quantile function.

    Attributes:
        text: as it was written.
        quantile: values of numbers within (0, 1), of each one (K,).
        share: what part of the values lies below one; None: they are single values.
        levels: how many values a grid has; 0: it is not a grid.
        factor, offset: of the nominal value of the scene, with which it goes on:
            nominal * value, or nominal + value.
    """

    text: str
    quantile: Quantile
    share: Callable[[float], float] | None = None
    levels: int = 0
    relative: str = ""

    def evaluate_at(self, u: ArrayLike, nominal: float) -> Array:
        """Return the value of each number within (0, 1)."""
        shares = np.asarray(u, np.float64)
        with np.errstate(over="ignore"):  # what varies refuses a value that is not finite
            value = self.quantile(shares.reshape(-1)).reshape(shares.shape)
        if not self.relative:
            return value
        return nominal * value if self.relative == "*" else nominal + value


class _Bad(Exception):
    """A rule that is broken, and by what."""

    def __init__(self, rule: str, value: object, valid: str | None = None) -> None:
        super().__init__(rule)
        self.rule, self.got, self.valid = rule, value, valid


def _compute_each(function: Callable[[float], float], x: Array) -> Array:
    """Return a function of the C library of each number: NumPy's own ones have other last bits."""
    return np.fromiter(map(function, x.tolist()), np.float64, len(x))


def _integrate_normal(x: float) -> float:
    return float(special.ndtr(x))


def _clip_share(share: float) -> float:
    """Return a share of the values, which is from 0 to 1 beyond their ends, too."""
    return min(1.0, max(0.0, share))


def _check_above(name: str, value: float, minimum: float = 0.0) -> float:
    if not value > minimum:
        raise _Bad(f"have {name} > {minimum:g}", value)
    return value


def _check_order(low: float, high: float) -> None:
    if not low < high:
        raise _Bad("have its low end below its high end", f"{low:g}, {high:g}")


def make_uniform(low: float, high: float) -> Distribution:
    """Evenly between two ends."""
    _check_order(low, high)
    width = high - low
    return Distribution("", lambda u: low + width * u, lambda x: _clip_share((x - low) / width))


def make_loguniform(low: float, high: float) -> Distribution:
    """The logarithm evenly between those of two ends."""
    _check_above("low", low)
    _check_order(low, high)
    a, width = math.log(low), math.log(high / low)
    return Distribution(
        "",
        lambda u: _compute_each(math.exp, a + width * u),
        lambda x: _clip_share((math.log(x) - a) / width) if x > 0.0 else 0.0,
    )


def make_normal(mean: float, sigma: float) -> Distribution:
    """Mean and standard deviation."""
    _check_above("sigma", sigma)
    return Distribution(
        "",
        lambda u: mean + sigma * special.ndtri(u),
        lambda x: _integrate_normal((x - mean) / sigma),
    )


def make_lognormal(mean: float, sigma: float) -> Distribution:
    """Mean of the values, and standard deviation of their logarithms."""
    _check_above("mean", mean)
    _check_above("sigma", sigma)
    mu = math.log(mean) - 0.5 * sigma * sigma
    return Distribution(
        "",
        lambda u: _compute_each(math.exp, mu + sigma * special.ndtri(u)),
        lambda x: _integrate_normal((math.log(x) - mu) / sigma) if x > 0.0 else 0.0,
    )


def make_triangular(low: float, mode: float, high: float) -> Distribution:
    """Density of a triangle."""
    _check_order(low, high)
    if not low <= mode <= high:
        raise _Bad("have its mode between its ends", mode)
    width, left, right = high - low, mode - low, high - mode

    def compute_quantile(u: Array) -> Array:
        is_left = u * width < left
        first, last = u * width * left, (1.0 - u) * width * right
        return np.where(is_left, low + np.sqrt(first), high - np.sqrt(last))

    def compute_share(x: float) -> float:
        if x <= mode:
            return max(0.0, x - low) ** 2 / (width * left) if left else 0.0
        return 1.0 - (high - x) ** 2 / (width * right) if x < high else 1.0

    return Distribution("", compute_quantile, compute_share)


def make_exponential(mean: float) -> Distribution:
    """Mean of the values, which begin at 0."""
    _check_above("mean", mean)
    return Distribution(
        "",
        lambda u: -mean * _compute_each(math.log1p, -u),
        lambda x: -math.expm1(-max(0.0, x) / mean),
    )


def make_weibull(shape: float, scale: float) -> Distribution:
    """Shape and scale."""
    _check_above("shape", shape)
    _check_above("scale", scale)
    power = 1.0 / shape
    return Distribution(
        "",
        lambda u: scale * _compute_each(lambda share: (-math.log1p(-share)) ** power, u),
        lambda x: -math.expm1(-((max(0.0, x) / scale) ** shape)),
    )


def make_beta(a: float, b: float, low: float = 0.0, high: float = 1.0) -> Distribution:
    """Beta distribution between two ends."""
    _check_above("a", a)
    _check_above("b", b)
    _check_order(low, high)
    width = high - low
    return Distribution(
        "",
        lambda u: low + width * special.betaincinv(a, b, u),
        lambda x: float(special.betainc(a, b, _clip_share((x - low) / width))),
    )


def make_truncated(of: Distribution, low: float, high: float) -> Distribution:
    """Part of a distribution between two ends."""
    _check_order(low, high)
    if of.share is None:
        raise _Bad("truncate a distribution with a density", of.text)
    first, last = of.share(low), of.share(high)
    if not last - first > 1e-12:
        rule = "have probability between its bounds"
        raise _Bad(rule, f"{of.text} within {low:g} and {high:g}")
    width, share = last - first, of.share

    def compute_quantile(u: Array) -> Array:
        values = of.quantile(first + width * u)
        values = np.where(values > low, values, low)
        return np.where(values < high, values, high)

    return Distribution("", compute_quantile, lambda x: _clip_share((share(x) - first) / width))


def make_choice(*values: float) -> Distribution:
    """One of some values, each as often."""
    if not values:
        raise _Bad("have a value", "none")
    table = np.array(values, np.float64)
    return Distribution("", lambda u: table[_find_level(u, len(values))])


def _find_level(u: Array, levels: int) -> NDArray[np.int64]:
    """Return in which of so many equal parts of (0, 1) each number is."""
    return np.minimum((u * levels).astype(np.int64), levels - 1)


def make_mixture(*pairs: float | Distribution) -> Distribution:
    """Weights, each followed by its distribution."""
    weights, parts = pairs[::2], pairs[1::2]
    if not len(weights) == len(parts) > 0:
        raise _Bad("be weights, each followed by a distribution", f"{len(pairs)} arguments")
    sizes = [_check_above("weights", weight) for weight in weights if isinstance(weight, float)]
    shares = [size / math.fsum(sizes) for size in sizes]

    def compute_quantile(u: Array) -> Array:
        values, left, open_places = np.empty_like(u), u, np.arange(len(u))
        for weight, part in zip(shares[:-1], parts[:-1], strict=True):
            here = left < weight
            inside = left[here] / weight
            values[open_places[here]] = part.quantile(inside)  # type: ignore[union-attr]
            left, open_places = left[~here] - weight, open_places[~here]
        inside = np.clip(left / shares[-1], 2.0**-53, 1.0 - 2.0**-53)
        values[open_places] = parts[-1].quantile(inside)  # type: ignore[union-attr]
        return values

    return Distribution("", compute_quantile)


def make_grid(low: float, high: float, count: float) -> Distribution:
    """Evenly spaced values from end to end, each combined with those of all other grids."""
    if not (count >= 2 and count == int(count) and count <= 10**6):
        raise _Bad("have a whole number of values from 2 to 1e6", count)
    _check_order(low, high)
    levels = int(count)
    width = high - low
    return Distribution(
        "",
        lambda u: low + width * (_find_level(u, levels) / (levels - 1)),
        levels=levels,
    )


KINDS: dict[str, Callable[..., Distribution]] = {
    "uniform": make_uniform,
    "loguniform": make_loguniform,
    "normal": make_normal,
    "lognormal": make_lognormal,
    "triangular": make_triangular,
    "exponential": make_exponential,
    "weibull": make_weibull,
    "beta": make_beta,
    "truncated": make_truncated,
    "choice": make_choice,
    "mixture": make_mixture,
    "grid": make_grid,
}


def parse_distribution(value: object, where: str, quantity: str) -> Distribution:
    """Return the distribution that a text such as ``lognormal(0.5, 0.2)`` states.

    ``nominal * ...`` and ``nominal + ...`` begin at the value of the scene.

    Raises:
        Refusal: it is not a distribution.
    """
    text = f"choice({value!r})" if isinstance(value, int | float) else value
    valid = ", ".join(KINDS)
    if isinstance(value, bool) or not isinstance(text, str) or len(text) > 1000:
        raise Refusal(where, quantity, "be a distribution", repr(value), valid)
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        relative = ""
        if isinstance(tree, ast.BinOp) and isinstance(tree.left, ast.Name):
            if tree.left.id != "nominal" or not isinstance(tree.op, ast.Mult | ast.Add):
                raise _Bad("begin with nominal * or nominal +", text)
            relative = "*" if isinstance(tree.op, ast.Mult) else "+"
            tree = tree.right
        expression = _read_expression(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise Refusal(where, quantity, "be a distribution", text, valid) from None
    except _Bad as no:
        raise Refusal(where, quantity, no.rule, no.got, no.valid) from None
    if not isinstance(expression, Distribution):
        raise Refusal(where, quantity, "be a distribution", text, valid)
    return replace(expression, text=text, relative=relative)


def _read_expression(tree: ast.expr) -> float | Distribution:
    if isinstance(tree, ast.Constant) and type(tree.value) in (int, float):
        if not abs(tree.value) <= LARGEST_NUMBER:  # type: ignore[arg-type]
            raise _Bad(f"have numbers within +-{LARGEST_NUMBER:g}", tree.value)
        return float(tree.value)  # type: ignore[arg-type]
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
        inner = _read_expression(tree.operand)
        if isinstance(inner, float):
            return -inner
    if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name):
        return _read_call(tree.func.id, tree)
    raise _Bad("be a distribution", ast.unparse(tree), ", ".join(KINDS))


def _read_call(name: str, tree: ast.Call) -> Distribution:
    if name not in KINDS:
        raise _Bad("be a known distribution", name, ", ".join(KINDS))
    if any(keyword.arg is None for keyword in tree.keywords):
        raise _Bad("have the arguments of its kind", ast.unparse(tree))
    of: Sequence[Any] = [_read_expression(arg) for arg in tree.args]
    named = {str(keyword.arg): _read_expression(keyword.value) for keyword in tree.keywords}
    expects = {"truncated": (0,), "mixture": tuple(range(1, len(of), 2))}.get(name, ())
    for place, argument in enumerate(of):
        if isinstance(argument, Distribution) != (place in expects):
            kind = "a distribution" if place in expects else "a number"
            raise _Bad(f"have {kind} as argument {place + 1} of {name}", ast.unparse(tree))
    try:
        return replace(KINDS[name](*of, **named), text=ast.unparse(tree))
    except TypeError:
        import inspect

        takes = f"{name}{inspect.signature(KINDS[name])}".partition(" ->")[0]
        takes = takes.replace(": float", "").replace(": 'float'", "")
        raise _Bad("have the arguments of its kind", ast.unparse(tree), takes) from None
