"""Pictures of a posterior: corner, trace, rank, and bands over the loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import rankdata

from hystfit.errors import MissingExtraError, ParameterError

if TYPE_CHECKING:
    from hystfit.sampling.draws import Posterior

_KINDS = ("corner", "trace", "rank", "bands")


def draw(posterior: Posterior, kind: str, **options: Any) -> Any:
    """The matplotlib figure of one kind.

    Raises:
        ParameterError: an unknown kind.
        MissingExtraError: corner is not installed.
    """
    if kind not in _KINDS:
        raise ParameterError(f"no picture {kind!r} of a posterior; there are {', '.join(_KINDS)}")
    return {"corner": _corner, "trace": _trace, "rank": _rank, "bands": _bands}[kind](posterior, **options)


def _labels(posterior: Posterior) -> list[str]:
    return [f"{n} [{u}]" if u else n for n, u in zip(posterior.names, posterior.units, strict=True)]


def _corner(posterior: Posterior) -> Any:
    try:
        import corner
    except ImportError as error:
        raise MissingExtraError("corner", "bayes", "a corner plot") from error
    flat = posterior.draws.reshape(-1, len(posterior.names))
    moving = np.ptp(flat, axis=0) > 0
    labels = [label for label, on in zip(_labels(posterior), moving, strict=True) if on]
    return corner.corner(
        flat[:, moving],
        labels=labels,
        quantiles=[0.025, 0.5, 0.975],
        levels=(0.5, 0.9),
        range=[0.998] * len(labels),
        bins=25,
        smooth=1.0,
        show_titles=True,
        title_fmt=".4g",
        title_kwargs={"fontsize": 8},
    )


def _panels(posterior: Posterior) -> Any:
    import matplotlib.pyplot as plt

    count = len(posterior.names)
    return plt.subplots(count, 1, figsize=(7, 1.4 * count), layout="constrained", squeeze=False)


def _trace(posterior: Posterior) -> Any:
    figure, axes = _panels(posterior)
    for k, (ax, label) in enumerate(zip(axes[:, 0], _labels(posterior), strict=True)):
        for chain in posterior.draws[:8, :, k]:
            ax.plot(chain, lw=0.4)
        ax.set_ylabel(label)
    axes[-1, 0].set_xlabel("draw")
    return figure


def _rank(posterior: Posterior) -> Any:
    figure, axes = _panels(posterior)
    for k, (ax, label) in enumerate(zip(axes[:, 0], _labels(posterior), strict=True)):
        draws = posterior.draws[:, :, k]
        ranks = rankdata(draws).reshape(draws.shape)
        for chain in ranks[:8]:
            ax.hist(chain, bins=20, range=(0, draws.size), histtype="step")
        ax.set_ylabel(label)
    axes[-1, 0].set_xlabel("rank over all chains")
    return figure


def _bands(posterior: Posterior, level: float = 0.9, count: int = 200) -> Any:
    """The loop, and below it all that is too small to be seen there: deviations from the median of the draws."""
    import matplotlib.pyplot as plt

    record = posterior.result.data[0]
    on = record.used
    low, _, high = posterior.bands(record, level, count)
    inner = posterior.bands(record, level, count, kind="credible")
    middle = inner[1]
    figure, (loop, rest) = plt.subplots(2, 1, figsize=(7, 7), sharex=True, layout="constrained")
    loop.plot(record.u[on], record.y[on], ".", ms=2, color="#a6a6a6", label="measured")
    loop.plot(record.u[on], middle[on], color="#0072b2", lw=0.8, label="median of the draws")
    rest.plot(record.u[on], (record.y - middle)[on], ".", ms=2, color="#a6a6a6")
    for edges, color in (((low, high), "#d55e00"), ((inner[0], inner[2]), "#0072b2")):
        for edge in edges:
            rest.plot(record.u[on], (edge - middle)[on], color=color, lw=0.6)
    label = lambda name, unit: f"{name} [{unit}]" if unit else name
    loop.set_ylabel(label(record.y_name, record.y_unit))
    rest.set(xlabel=label(record.u_name, record.u_unit), ylabel=label("less the median", record.y_unit))
    rest.set_title(f"{level:.0%} bands: of the model's curve (blue), of a measurement (orange)", fontsize=9)
    loop.legend(frameon=False)
    return figure
