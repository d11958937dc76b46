"""A model on a record as sliders: which parameters have one, over which range, and which values they may take."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.starting import scales_of
from hystfit.params.param import leaves_of, short_names
from hystfit.params.space import ParameterSpace

_MANY = 32  # weights that still have sliders
_REACH = 10.0  # factor to either side of a logarithmic slider


@dataclasses.dataclass(frozen=True)
class Slider:
    """A parameter that the user moves from `low` to `high`; other values within its bounds `lower` and `upper` can be typed.

    On a `logarithmic` one equal distances are equal factors; a fit changes those that are `fitted` unless the user says otherwise.
    """

    name: str
    unit: str
    doc: str
    value: float
    low: float
    high: float
    lower: float | None
    upper: float | None
    logarithmic: bool
    fitted: bool
    weight: bool


class View:
    """A model as the user chose it, on a record as it is fitted; free parameters without a slider, `hidden`, keep their values."""

    def __init__(self, choice: str, model: AbstractHysteresis, record: Record):
        """Choose sliders and their ranges."""
        self.choice, self.record = choice, record
        names = short_names([leaf.path for leaf in leaves_of(model)])
        self._space = ParameterSpace.of(model, free=names, scales=scales_of(Dataset.of(record)))
        self._x = self._space.vector(model)
        free = set(ParameterSpace.of(model).names)
        weights = self._space.weights if self._space.weights.sum() <= _MANY else None
        rows = range(len(self._space)) if weights is not None else np.flatnonzero(~self._space.weights).tolist()
        scalar = {name for name in self._space.names if "[" not in name}
        shown = [k for k in rows if self._space.names[k] in free | scalar]
        self._place = {self._space.names[k]: k for k in shown}
        self.sliders = tuple(self._slider(k, free) for k in shown)
        self.hidden = len(free - set(self._place))

    def _slider(self, k: int, free: set[str]) -> Slider:
        info, value, name = self._space.infos[k], float(self._x[k]), self._space.names[k]
        scale = float(np.asarray(self._space.coordinates.scale)[k])
        lower, upper = info.bounds
        logarithmic = bool(np.isfinite(lower) and np.isinf(upper) and value > lower == 0.0 and not info.linear)
        if logarithmic:
            low, high = value / _REACH, value * _REACH
        elif np.isfinite([lower, upper]).all():
            low, high = lower, upper
        else:
            reach = max(scale, abs(value))
            low, high = max(lower, value - reach), min(upper, value + reach)
        return Slider(
            name, self._space.units[k], info.doc, value, low, high,
            lower if np.isfinite(lower) else None, upper if np.isfinite(upper) else None,
            logarithmic, name in free, bool(self._space.weights[k]),
        )  # fmt: skip

    def model(self, values: Mapping[str, Any]) -> AbstractHysteresis:
        """The model at values of some sliders by name, the others as in the view; a ParameterError where it cannot have them."""
        x = self._x.copy()
        for name, value in self.checked(values).items():
            x[self._place[name]] = value
        return self._space.assembled(x)

    def checked(self, values: Mapping[str, Any]) -> dict[str, float]:
        """Values as numbers within their bounds."""
        for name, value in values.items():
            if name not in self._place:
                raise ParameterError(f"{self.choice} has no slider {name!r}")
            lower, upper = self._space.infos[self._place[name]].bounds
            number = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
            if not (number and lower <= value <= upper):
                raise ParameterError(f"{name} is a number in [{lower:g}, {upper:g}], got {value!r}")
        return {name: float(value) for name, value in values.items()}

    def to_dict(self) -> dict[str, Any]:
        """For the page."""
        sliders = [dataclasses.asdict(slider) for slider in self.sliders]
        return {"model": self.choice, "sliders": sliders, "hidden": self.hidden}
