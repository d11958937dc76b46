"""Data to which no model, or one model, can be fitted: a constant input or output, no samples, no time; fits without derivatives."""

from __future__ import annotations

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import DataError, ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.simulation import check_one_device
from hystfit.params.space import ParameterSpace


def check_fittable(model: AbstractHysteresis, data: Dataset) -> None:
    """Refuse data to which no fit is possible: nothing counts or moves, a record lacks its time, or the model holds several devices."""
    check_one_device(model)
    for record in data:
        if not record.used.any():
            raise DataError(f"record {record.name!r}: no usable sample in the window")
        if np.ptp(record.u) == 0:
            raise DataError(f"record {record.name!r}: the input is constant ({record.u[0]:g}); there is no loop to fit")
        if record.t is None and not model.rate_independent:
            raise ModelError(
                f"{type(model).__name__} depends on time and record {record.name!r} has no time column: name it with time=, "
                "or choose a rate-independent model"
            )
    if all(np.ptp(record.y[record.used]) == 0 for record in data):
        raise DataError("the output is constant: there is nothing to fit")


def check_smooth(space: ParameterSpace, method: str) -> None:
    """Refuse a method (in words, for the message) that needs derivatives, where the output is piecewise constant in a free parameter."""
    if names := space.stepwise_names:
        listed = ", ".join(names)
        raise ModelError(
            f"{method} needs derivatives by all free parameters, and the output is piecewise constant in {listed}: their standard errors "
            f"are those of the fit; for the others, fit with these fixed (fix={list(names)}, --fix {' --fix '.join(names)})"
        )
