"""Parameters and noise as a fit reports them, and where the standard errors of other verbs differ."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from hystfit.errors import ParameterError
from hystfit.outcome import Code, Note
from hystfit.outcome.table import or_none
from hystfit.params.space import MANY, ParameterSpace

T = TypeVar("T")

INTERVAL = (0.05, 0.5, 0.95)  # quantiles of tables of many fits: 90 % about the median


def edges_of(level: float) -> list[float]:
    """Lower edge, median and upper edge of an interval with this probability between 0 and 1, as quantiles."""
    if not 0 < level < 1:
        raise ParameterError(f"level must be between 0 and 1, such as 0.9; got {level}")
    return [0.5 - level / 2, 0.5, 0.5 + level / 2]


@dataclasses.dataclass(frozen=True)
class ParameterEstimate:
    """One parameter of a fit.

    Attributes:
        name, unit, doc: what it is.
        value: in `unit`.
        stderr: standard error; None where it is undefined (fixed, on a bound, not determined).
        lower, upper: bounds; None where there is none.
        fixed: whether it was not fitted.
        at_bound: "lower" or "upper" where it reached a bound.
        identifiable: whether the data determine it; None where it was fixed.
        tie: the expression that it follows from, such as "2*k1"; None where it is not tied.
    """

    name: str
    value: float
    stderr: float | None
    unit: str
    lower: float | None
    upper: float | None
    fixed: bool
    at_bound: str | None
    identifiable: bool | None
    doc: str = ""
    tie: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """For `result.json`."""
        return {k: v for k, v in dataclasses.asdict(self).items() if k not in ("name", "doc")}


def parameter_estimates(space: ParameterSpace, x: np.ndarray) -> tuple[ParameterEstimate, ...]:
    """Every parameter with its declaration, free ones first, at physical x, then tied and fixed ones, without standard errors."""
    free = ((*row, False, None) for row in zip(space.names, x, space.infos, strict=True))
    tied = ((tie.name, value, info, False, tie.expression) for tie, value, info, _ in space.tied(x))
    fixed_ones = ((*row, True, None) for row in space.fixed())
    rows = []
    for name, value, info, fixed, tie in (*free, *tied, *fixed_ones):
        lower, upper = map(or_none, info.bounds)
        unit = space.scales.label(info.unit)
        rows.append(ParameterEstimate(name, float(value), None, unit, lower, upper, fixed, None, None, info.doc, tie))
    return tuple(rows)


def grouped(
    items: Sequence[T],
    name: Callable[[T], str] = lambda one: one.name,  # type: ignore[attr-defined]
    many: int = MANY,
) -> list[tuple[str, list[T]]]:
    """Parameters, or what belongs to them, by their name in a report: arrays (or per-record sets) of more than `many` share one name."""
    base = lambda one: re.split(r"[\[@]", name(one))[0]
    families: dict[str, list[T]] = {}
    for one in items:
        families.setdefault(base(one), []).append(one)
    rows: list[tuple[str, list[T]]] = []
    for key, family, one in ((base(one), families[base(one)], one) for one in items):
        if len(family) <= many:
            rows.append((name(one), [one]))
        elif one is family[0]:
            rows.append((key, family))
    return rows


@dataclasses.dataclass(frozen=True)
class NoiseEstimate:
    """The noise behind the standard errors of a fit.

    Attributes:
        name: as it was chosen: "auto" (least squares, with errors for the noise seen in the residuals), "iid", or the noise model
            that refined the fit.
        parameters: of that noise, by name; empty where the residuals count as independent.
    """

    name: str
    parameters: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def refines(self) -> bool:
        """Whether the estimate is the optimum of a likelihood of its own, not of least squares."""
        return self.name not in ("auto", "iid")


SIMILAR = 1.25  # ratio up to which two standard errors count as equal


def differences(
    parameters: Sequence[ParameterEstimate], errors: Mapping[str, float | None], source: str, reason: str
) -> list[Note]:
    """A note where standard errors by parameter (None: unknown) differ from those of a fit; none where they agree within `SIMILAR`."""
    fitted = {one.name: one.stderr for one in parameters if one.tie is None and one.stderr}
    ratios = {name: error / fitted[name] for name, error in errors.items() if error and name in fitted}
    ratios = {name: ratio for name, ratio in ratios.items() if not 1 / SIMILAR < ratio < SIMILAR}
    if not ratios:
        return []
    name = max(ratios, key=lambda one: max(ratios[one], 1 / ratios[one]))
    others = f" ({len(ratios)} parameters differ)" if len(ratios) > 1 else ""
    text = f"standard error of {name} by {source} {errors[name]:.3g}, by the fit {fitted[name]:.3g}{others}: {reason}"
    return [Note(Code.ERRORS_DIFFER, text)]
