"""A sample-by-sample identification in the form of a fit, for the same report, pictures and files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hystfit.errors import ModelError
from hystfit.results.result import FitResult, provenance

if TYPE_CHECKING:
    from hystfit.fitting.timing import Stopwatch
    from hystfit.identify import Identification


def as_fit(found: Identification, seed: int, watch: Stopwatch) -> FitResult:
    """The identification as a fit whose errors are unknown.

    Its own status goes into the notes: what is neither usable nor poor counts as not converged.

    Raises:
        ModelError: the parameters found make no model.
    """
    from hystfit.results.metrics import autocorrelation_time

    runs = found.predict()
    models = [model for model in found.models if model is not None]
    if found.free_run is None or runs is None:
        raise ModelError(f"{found.method} found no usable model: {'; '.join((found.advice, *found.notes))}")
    status = found.status if found.status in ("ok", "poor") else "not-converged"
    said = () if status == "ok" else (f"{found.method}: {found.status}; {found.advice}",)
    free = tuple(p.name for p in found.parameters if not p.fixed)
    residuals = [(run - record.y)[record.used] for run, record in zip(runs, found.data, strict=True)]
    correlation = max(autocorrelation_time(r) for r in residuals)
    compile_s, run_s = watch.read()
    return FitResult(
        model=models[0],
        models=tuple(models),
        data=found.data,
        status=status,
        notes=(
            *said,
            "errors and metrics are of the free run; a sequential method gives no standard errors",
            *found.notes,
        ),
        parameters=found.parameters,
        free_names=free,
        covariance=np.full((len(free), len(free)), np.nan),
        train=found.free_run,
        test=None,
        sigma=found.free_run.rmse,
        correlation_time=correlation,
        honest_ratio=float(np.sqrt(correlation)),
        rank=None,
        condition=None,
        method=found.method,
        starts=1,
        in_best_basin=1,
        compile_s=compile_s,
        run_s=run_s,
        provenance=provenance(found.data, seed, samples=found.counts),
    )
