"""Quantities that follow from the parameters of a fit, with standard errors to first order."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.results.estimates import ParameterEstimate
from hystfit.results.result import FitResult


def derived_estimates(result: FitResult) -> tuple[ParameterEstimate, ...]:
    """The derived quantities of the fitted model, of the first record; no standard error where a parameter has none."""
    coordinates, units = result.problem.space.coordinates, result.problem.scales.label
    rows = []
    for name, unit, doc, value in result.model.derived():
        of_parameters = lambda x, value=value: value(coordinates.assemble(x, 0))
        number, slope = (np.asarray(v) for v in jax.value_and_grad(of_parameters)(jnp.asarray(result.x)))
        behind = slope != 0
        variance = float(slope[behind] @ result.covariance[np.ix_(behind, behind)] @ slope[behind])
        known = bool(behind.any() and np.isfinite(variance))
        error = float(np.sqrt(max(variance, 0.0))) if known else None
        rows.append(ParameterEstimate(name, float(number), error, units(unit), None, None, False, None, known, doc))
    return tuple(rows)
