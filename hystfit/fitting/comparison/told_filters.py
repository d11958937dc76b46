"""Values of filters that fits of other models tell: where plays need a lag or a relaxation, relays need about the same."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hystfit.models.base import AbstractHysteresis
from hystfit.models.series import Series
from hystfit.params.param import leaves_of
from hystfit.params.space import ParameterSpace


def with_filters_of(fitted: Sequence[AbstractHysteresis], model: AbstractHysteresis) -> AbstractHysteresis:
    """The model with the values of the first filter of each kind in fitted models, the best first; itself without one."""
    if not isinstance(model, Series):
        return model
    known: dict[type, AbstractHysteresis] = {}
    for part in (part for other in fitted for part in _filters(other)):
        known.setdefault(type(part), part)
    parts = tuple(_like(part, known.get(type(part))) for part in model.parts)
    return model if all(new is old for new, old in zip(parts, model.parts, strict=True)) else Series(*parts)


def _filters(model: AbstractHysteresis) -> Iterator[AbstractHysteresis]:
    parts = (part for part in getattr(model, "parts", ()) if part.linear_in_input and leaves_of(part))
    return (part for part in parts if len(ParameterSpace.of(part)))


def _like(part: AbstractHysteresis, fitted: AbstractHysteresis | None) -> AbstractHysteresis:
    """A part with the free values of a fitted one, if it has the same parameters."""
    if fitted is None:
        return part
    own, other = ParameterSpace.of(part), ParameterSpace.of(fitted)
    if own.names != other.names:
        return part
    return part.replace(**dict(zip(own.names, map(float, other.vector(fitted)), strict=True)))
