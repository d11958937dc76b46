"""Pictures of a fit. Every function takes axes or makes them, returns them, and neither shows nor changes anything else."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import HystfitError
from hystfit.results.labels import use_available_fonts
from hystfit.results.parameter_plots import draw_density, draw_parameters, draw_weights
from hystfit.results.record_plots import (
    draw_autocorrelation,
    draw_cycle_errors,
    draw_loop,
    draw_residuals,
    draw_residuals_over_input,
    draw_series,
    draw_worst,
    traces_of,
)
from hystfit.results.result import FitResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_OF_RECORDS: dict[str, Callable[..., Any]] = {
    "loop": draw_loop,
    "series": draw_series,
    "residuals": draw_residuals,
    "residuals-input": draw_residuals_over_input,
    "worst": draw_worst,
    "cycle-errors": draw_cycle_errors,
    "autocorrelation": draw_autocorrelation,
}
_OF_PARAMETERS: dict[str, Callable[..., Any]] = {
    "parameters": draw_parameters,
    "weights": draw_weights,
    "density": draw_density,
}
KINDS = (*_OF_RECORDS, *_OF_PARAMETERS)


@verb
def fit(
    result: FitResult,
    kind: str = "loop",
    ax: Axes | None = None,
    *,
    data: Record | Dataset | Sequence[Record] | None = None,
    refit_offset: bool = False,
) -> Axes:
    """Draw a picture of a fit.

    Args:
        result: the fit.
        kind: "loop" (output over input), "series" (output over time), "residuals" (over time), "residuals-input" (over
            the input), "worst" (output over time around the largest persistent error), "cycle-errors" (residuals of the first, last and
            worst cycle over the input), "autocorrelation" (of the residuals), "parameters" (their relative standard errors), "weights"
            (of plays or stops over their thresholds) or "density" (over the Preisach plane).
        ax: axes to draw on; new ones where None.
        data: other records than those fitted, such as test data.
        refit_offset: shift the prediction of each of those to its mean.

    Raises:
        HystfitError: no such kind.
        PrecisionError: double precision is off.
    """
    if kind not in KINDS:
        raise HystfitError(f"no picture {kind!r}; there are {', '.join(KINDS)}")
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    assert ax is not None
    if kind in _OF_PARAMETERS:
        return _OF_PARAMETERS[kind](result, ax)
    _OF_RECORDS[kind](traces_of(result, data, refit_offset), ax)
    ax.spines[["top", "right"]].set_visible(False)
    use_available_fonts(ax)
    return ax
