"""Quantities that follow from a model, for every draw of a posterior: numbers of the loop, creep, and the inverse's bands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hystfit.data.record import Record
from hystfit.errors import ParameterError

if TYPE_CHECKING:
    from hystfit.sampling.draws import Posterior

_CYCLES, _POINTS = 3, 400
QUANTITIES = {
    "loop_area": "area of the steady loop over the fitted input range, in units of y times u",
    "coercive_input": "half the width of the loop, in input, at the middle of the output",
    "remanence": "half the height of the loop, in output, at the middle of the input",
    "hysteresis_percent": "largest height of the loop in percent of the stroke",
    "creep_percent_per_decade": "creep between 1 s and 10 s after a step over the range, in percent of the step",
}


def derive(posterior: Posterior, quantities: Sequence[str] | None, count: int) -> dict[str, np.ndarray]:
    """Draws of derived quantities, each shape (count,); creep only for models that depend on time.

    The loop is the last of three triangular cycles over the input range of the fit, 400 samples each, at the records' typical interval.

    Raises:
        ParameterError: an unknown quantity, or creep of a model without time.
    """
    timed = not posterior.result.model.rate_independent
    names = list(quantities) if quantities else [name for name in QUANTITIES if timed or "creep" not in name]
    unknown = [name for name in names if name not in QUANTITIES]
    if unknown:
        raise ParameterError(f"no quantity {unknown}; there are {', '.join(QUANTITIES)}")
    if not timed and any("creep" in name for name in names):
        raise ParameterError(f"{posterior.result.name} does not depend on time: it has no creep")
    low = min(float(r.u[r.used].min()) for r in posterior.result.data)
    high = max(float(r.u[r.used].max()) for r in posterior.result.data)
    found: dict[str, np.ndarray] = {}
    if any("creep" not in name for name in names):
        found |= _loop(posterior, low, high, count)
    if any("creep" in name for name in names):
        found["creep_percent_per_decade"] = _creep(posterior, low, high, count)
    return {name: found[name] for name in names}


def _record(posterior: Posterior, u: np.ndarray, dt: float) -> Record:
    return Record(u=u, y=np.zeros(u.size), t=np.arange(u.size) * dt, name="derived")


def _loop(posterior: Posterior, low: float, high: float, count: int) -> dict[str, np.ndarray]:
    up = np.linspace(low, high, _POINTS // 2, endpoint=False)
    cycle = np.concatenate([up, high + low - up])
    steps = posterior.result.data[0].dt[1:]
    dt = float(np.median(steps)) if steps.size and np.median(steps) > 0 else 1.0
    y = posterior.predict(_record(posterior, np.tile(cycle, _CYCLES), dt), count)[:, -_POINTS:]
    rising, falling = y[:, : _POINTS // 2], y[:, _POINTS // 2 :][:, ::-1]
    falling = np.concatenate([falling[:, -1:] * 0 + y[:, :1], falling[:, :-1]], axis=1)  # the same inputs as `rising`
    height = np.abs(falling - rising)
    stroke = np.ptp(y, axis=1)
    area = np.trapezoid(falling - rising, up, axis=1)
    middle = up.size // 2
    half = 0.5 * (y.max(axis=1) + y.min(axis=1))
    at = lambda branch: np.array([np.interp(0.0, row - h, up) for row, h in zip(branch, half, strict=True)])
    return {
        "loop_area": np.abs(area),
        "coercive_input": 0.5 * np.abs(at(rising) - at(falling)),
        "remanence": 0.5 * height[:, middle],
        "hysteresis_percent": 100 * height.max(axis=1) / stroke,
    }


def _creep(posterior: Posterior, low: float, high: float, count: int) -> np.ndarray:
    u = np.full(201, high)
    u[0] = low
    y = posterior.predict(_record(posterior, u, 0.05), count)
    return 100 * (y[:, 200] - y[:, 20]) / (y[:, 1] - y[:, 0])
