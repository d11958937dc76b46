"""How much of the drift of a loop's mean the creep of a fitted model explains."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

import hystfit as hf
from hystfit.quality.drift import cycle_means, drift
from hystfit.quality.loops import SAME_LEVEL, cycles

STEP = 1e-3  # finite difference, in standard errors: the output is nearly linear over that far


@dataclasses.dataclass(frozen=True)
class DriftExplained:
    """Slopes of the mean of similar cycles against log10 of the time since the record began [unit of y per decade].

    Attributes:
        measured: of the measured means.
        modeled: of those in the simulation of the fit.
        stderr: of `modeled`, from the fit's covariance; None where that is not known.
        without_creep: of those in the fitted model without its creep: the settling of its hysteresis.
        left: of the residual means.
    """

    measured: float
    modeled: float
    stderr: float | None
    without_creep: float
    left: float


def explain_drift(result: hf.FitResult) -> DriftExplained:
    """Compare the drift of a record with that of the simulation of its fit, by a model with logarithmic creep.

    Creep moves the mean of a loop because the mean input stepped when the record began: state where the device rested before
    (`Record.resting_on`), else the model assumes that it rested at the first input.
    """
    record = result.data[0]
    y = np.where(record.used, record.y, np.nan)
    loops = cycles(record.u, SAME_LEVEL * float(np.ptp(record.u)))
    found = drift(record.u, y, record.t, loops)
    kept = np.isfinite(y)

    def slope(values: np.ndarray) -> float:
        means, moment = cycle_means(record.u, np.where(kept, values, np.nan), record.t, loops)
        assert moment is not None  # the record has time
        return float(np.polyfit(np.log10(moment[found.skipped :]), means[found.skipped :], 1)[0])

    run = result.predict(record)
    still = result.model.replace(**{name: 0.0 for name in result.values if name.startswith("gamma[")})
    return DriftExplained(
        measured=found.per_decade,
        modeled=slope(run),
        stderr=_error(lambda at: slope(result.problem.predict(at)[0]), result.x, result.covariance),
        without_creep=slope(still.free_run(record.u, record.dt)),
        left=slope(y - run),
    )


def _error(function: Callable[[np.ndarray], float], x: np.ndarray, covariance: np.ndarray) -> float | None:
    """Standard error of a number that follows from the parameters, to first order; parameters without an error are held."""
    known = np.flatnonzero(np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0))
    if not known.size:
        return None
    steps = STEP * np.sqrt(np.diag(covariance)[known])
    shifts = steps[:, None] * np.eye(x.size)[known]
    slopes = np.array(
        [(function(x + shift) - function(x - shift)) / (2 * step) for shift, step in zip(shifts, steps, strict=True)]
    )
    return float(np.sqrt(slopes @ covariance[np.ix_(known, known)] @ slopes))
