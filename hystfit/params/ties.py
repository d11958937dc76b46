"""Ties: a parameter that is a multiple of another one plus a constant, such as `2*k1`, `-gamma[0]` or `k1/3 - 0.1`."""

from __future__ import annotations

import ast
import dataclasses
import math
from collections.abc import Mapping

from hystfit.errors import ParameterError
from hystfit.params.named_leaves import NamedLeaves


@dataclasses.dataclass(frozen=True)
class Tie:
    """target = factor * source + constant, both a leaf of the tree and a flat position in it; `expression` is that of the user."""

    name: str
    expression: str
    target: tuple[int, int]
    source: tuple[int, int]
    factor: float
    constant: float


def parse_tie(expression: str) -> tuple[float, str, float]:
    """(factor, name of the source, constant) of an expression of numbers, one name, + - * / and parentheses, which is not run as code."""
    try:
        factor, name, constant = _linear(ast.parse(expression.strip(), mode="eval").body)
    except (SyntaxError, ValueError, ZeroDivisionError, RecursionError, AttributeError):
        name = None
    if not name or not (math.isfinite(factor) and math.isfinite(constant) and factor):
        raise ParameterError(
            f"tie {expression!r}: expected a multiple of one parameter plus a constant, such as '2*k1', 'gamma[0]' or 'k1/3 - 0.1'"
        )
    return factor, name, constant


def _linear(node: ast.expr) -> tuple[float, str | None, float]:
    """(factor, name, constant) of a node; the name is None for a number."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return 0.0, None, float(node.value)
    if isinstance(node, ast.Name | ast.Attribute | ast.Subscript):
        return 1.0, ast.unparse(node), 0.0
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        sign = -1.0 if isinstance(node.op, ast.USub) else 1.0
        factor, name, constant = _linear(node.operand)
        return sign * factor, name, sign * constant
    if not isinstance(node, ast.BinOp):
        raise ValueError(node)
    (a, name_a, c), (b, name_b, d) = _linear(node.left), _linear(node.right)
    if isinstance(node.op, ast.Add | ast.Sub) and not (name_a and name_b):
        sign = -1.0 if isinstance(node.op, ast.Sub) else 1.0
        return a + sign * b, name_a or name_b, c + sign * d
    if isinstance(node.op, ast.Mult) and not (name_a and name_b):
        number, factor, constant = (c, b, d) if name_a is None else (d, a, c)
        return number * factor, name_a or name_b, number * constant
    if isinstance(node.op, ast.Div) and name_b is None:
        return a / d, name_a, c / d
    raise ValueError(node)


def ties_of(expressions: Mapping[str, str], named: NamedLeaves) -> tuple[Tie, ...]:
    """The ties of expressions by target, such as {"gamma[1]": "gamma[0]"}; an array is tied to an array of its size or to one element."""
    ties: list[Tie] = []
    for name, expression in expressions.items():
        factor, source, constant = parse_tie(expression)
        (leaf, positions), (other, others) = named.find(name), named.find(source)
        if len(others) not in (1, len(positions)):
            raise ParameterError(
                f"tie {name}={expression}: {source!r} has {len(others)} elements, {name!r} {len(positions)}"
            )
        for k, j in zip(positions, others if len(others) == len(positions) else others * len(positions), strict=True):
            text = expression if len(positions) == 1 else _words(factor, named.element(other, j), constant)
            ties.append(Tie(named.element(leaf, k), text, (leaf, k), (other, j), factor, constant))
    targets = [tie.target for tie in ties]
    for tie in ties:
        if tie.source in targets:
            what = "itself" if tie.source == tie.target else "a parameter that is tied; tie both to the same one"
            raise ParameterError(f"tie {tie.name}={tie.expression} refers to {what}")
        if targets.count(tie.target) > 1:
            raise ParameterError(f"parameter {tie.name!r} is tied twice: choose one")
    return tuple(ties)


def _words(factor: float, name: str, constant: float) -> str:
    """An expression that `parse_tie` reads."""
    product = name if factor == 1 else f"{factor!r}*{name}"
    return product if not constant else f"{product} + {constant!r}"


def narrowed(bounds: tuple[float, float], tie: Tie, of_target: tuple[float, float]) -> tuple[float, float]:
    """Bounds of a source within which the target of a tie is within its own, too."""
    ends = [(bound - tie.constant) / tie.factor for bound in of_target]
    low, high = max(bounds[0], min(ends)), min(bounds[1], max(ends))
    if not low < high:
        raise ParameterError(
            f"tie {tie.name}={tie.expression}: no value within the bounds of both ({tie.name} lies between {of_target[0]:g} and "
            f"{of_target[1]:g})"
        )
    return float(low), float(high)
