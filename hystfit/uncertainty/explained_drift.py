"""How much of the drift of a loop's mean the creep of a fitted model explains."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from hystfit.config import verb
from hystfit.errors import DataError, ModelError
from hystfit.quality.drift import cycle_means, drift
from hystfit.quality.loops import SAME_LEVEL, cycles
from hystfit.results.result import FitResult

_STEP = 1e-3  # finite difference, in standard errors: the output is nearly linear over that far


@dataclasses.dataclass(frozen=True)
class DriftExplained:
    """Drift of the mean of similar cycles, measured and as explained by a fit, all per decade of time since the record began.

    Attributes:
        measured: slope of the measured means against log10 of time [unit of y per decade], and `r2`, the variance that it explains.
        modeled: the same slope in the simulation of the fit.
        stderr: of `modeled`, from the fit's covariance; None where that is not known.
        without_creep: the slope in the fitted model without its creep: the settling of its hysteresis.
        left: slope of the residual means.
        cycles: number of cycles compared.
        unit: of y.
    """

    measured: float
    r2: float
    modeled: float
    stderr: float | None
    without_creep: float
    left: float
    cycles: int
    unit: str

    def __str__(self) -> str:
        error = "" if self.stderr is None else f" +- {self.stderr:.2g}"
        per = f"{self.unit}/decade".lstrip("/")
        return (
            f"the mean of {self.cycles} similar cycles drifts by {self.measured:.3g} {per} (R2 {self.r2:.3f}); the fit's creep explains "
            f"{self.modeled:.3g}{error}, its hysteresis alone {self.without_creep:.2g}, and {self.left:.2g} remains in the residuals"
        )


@verb
def explain_drift(result: FitResult, name: str | None = None) -> DriftExplained:
    """Compare the drift of a fitted record with that of the simulation of the fit.

    Creep moves the mean of a loop because the mean input stepped when the record began: state where the device rested before
    (`Record.resting_on`), else the model assumes that it rested at the first input.

    Args:
        result: of a model with creep (`LogCreep` or `LinearCreep`).
        name: of the record, the first one if None.

    Raises:
        ModelError: the model has no creep.
        DataError: fewer than four similar cycles, or no time.
    """
    number = 0 if name is None else [record.name for record in result.data].index(result.data[name].name)
    record, model = result.data[number], result.models[number]
    still = model.without_creep()
    if still is None:
        raise ModelError(f"{result.name} has no creep: fit a model with creep or log-creep in it")
    y = np.where(record.used, record.y, np.nan)
    loops = cycles(record.u, SAME_LEVEL * float(np.ptp(record.u)))
    found = drift(record.u, y, record.t, loops)
    if found is None or found.per_decade is None or found.r2_log is None:
        raise DataError(
            f"record {record.name!r}: drift is measured over four or more similar cycles with time stamps, which this record does not have"
        )
    kept = np.isfinite(y)

    def slope(values: np.ndarray) -> float:
        means, moment = cycle_means(record.u, np.where(kept, values, np.nan), record.t, loops)
        assert moment is not None
        return float(np.polyfit(np.log10(moment[found.skipped :]), means[found.skipped :], 1)[0])

    run = result.predict(record)
    problem, x = result.problem, result.x
    return DriftExplained(
        measured=found.per_decade,
        r2=found.r2_log,
        modeled=slope(run),
        stderr=_error(lambda at: slope(problem.predict(at)[number]), x, result.covariance),
        without_creep=slope(still.free_run(record.u, record.dt)),
        left=slope(y - run),
        cycles=found.cycles,
        unit=record.y_unit,
    )


def _error(function: Any, x: np.ndarray, covariance: np.ndarray) -> float | None:
    """Standard error of a number that follows from the parameters, to first order; parameters without an error are held."""
    known = np.flatnonzero(np.isfinite(np.diag(covariance)) & (np.diag(covariance) > 0))
    if not known.size:
        return None
    steps = _STEP * np.sqrt(np.diag(covariance)[known])
    slopes = []
    for k, step in zip(known, steps, strict=True):
        shift = step * np.eye(x.size)[k]
        slopes.append((function(x + shift) - function(x - shift)) / (2 * step))
    variance = np.array(slopes) @ covariance[np.ix_(known, known)] @ np.array(slopes)
    return float(np.sqrt(variance)) if np.isfinite(variance) and variance >= 0 else None
