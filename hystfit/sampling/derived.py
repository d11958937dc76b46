"""Quantities that follow from a model, for every draw of a posterior: numbers of the loop, and creep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import ParameterError
from hystfit.sampling.posterior import Posterior

_CYCLES, _POINTS = 3, 400
_RESTED = 1e5  # seconds on the lower end of the range before the step of the creep
QUANTITIES = {
    "loop_area": "area of the steady loop over the fitted input range, in units of y times u",
    "coercive_input": "half the width of the loop, in input, at the middle of the output",
    "remanence": "half the height of the loop, in output, at the middle of the input",
    "hysteresis_percent": "largest height of the loop in percent of the stroke",
    "creep_percent_per_decade": "creep between 1 s and 10 s after a step over the range, in percent of the step",
}


def units(data: Dataset) -> dict[str, str]:
    """Units of the quantities, from those of the fitted records; empty where a record has none."""
    u, y = data.units["u"], data.units["y"]
    area = f"{y} {u}".strip()
    return {
        "loop_area": area,
        "coercive_input": u,
        "remanence": y,
        "hysteresis_percent": "%",
        "creep_percent_per_decade": "%",
    }


def derive(posterior: Posterior, quantities: Sequence[str] | None, count: int) -> dict[str, np.ndarray]:
    """Draws of derived quantities, each shape (count,); creep only for models that depend on time.

    The loop is the last of three triangular cycles over the input range of the fit, 400 samples each, at the records' typical interval.

    Args:
        posterior: the draws.
        quantities: names in `QUANTITIES`; all that the model has where None.
        count: number of draws simulated.

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
    values: dict[str, np.ndarray] = {}
    if any("creep" not in name for name in names):
        values |= _loop(posterior, low, high, count)
    if any("creep" in name for name in names):
        values["creep_percent_per_decade"] = _creep(posterior, low, high, count)
    return {name: values[name] for name in names}


def _record(u: np.ndarray, t: np.ndarray) -> Record:
    return Record(u=u, y=np.zeros(u.size), t=t, name="derived")


def _loop(posterior: Posterior, low: float, high: float, count: int) -> dict[str, np.ndarray]:
    u = steady_cycles(low, high)
    dt = posterior.result.data[0].sampling_interval or 1.0
    return loop_quantities(posterior.predict(_record(u, np.arange(u.size) * dt), count), low, high)


def steady_cycles(low: float, high: float) -> np.ndarray:
    """Input of three triangular cycles of 400 samples, of which the last shows the steady loop."""
    inputs = np.linspace(low, high, _POINTS // 2 + 1)
    return np.tile(np.concatenate([inputs[:-1], inputs[:0:-1]]), _CYCLES)


def loop_quantities(y: np.ndarray, low: float, high: float) -> dict[str, np.ndarray]:
    """Quantities of steady loops, each shape (count,).

    Args:
        y: outputs on `steady_cycles`, shape (count, samples).
        low, high: range of the input.
    """
    half, y = _POINTS // 2, y[:, -_POINTS:]
    inputs = np.linspace(low, high, half + 1)
    rising = y[:, : half + 1]
    falling = np.concatenate([y[:, half:], y[:, :1]], axis=1)[:, ::-1]  # at the same inputs
    gap = np.abs(falling - rising)
    middle = 0.5 * (y.max(axis=1) + y.min(axis=1))
    crossing = lambda branch: np.array([_crossing(row - m, inputs) for row, m in zip(branch, middle, strict=True)])
    return {
        "loop_area": np.abs(np.trapezoid(falling - rising, inputs, axis=1)),
        "coercive_input": 0.5 * np.abs(crossing(rising) - crossing(falling)),
        "remanence": 0.5 * gap[:, half // 2],
        "hysteresis_percent": 100 * gap.max(axis=1) / np.ptp(y, axis=1),
    }


def _crossing(branch: np.ndarray, inputs: np.ndarray) -> float:
    """The first input at which a branch, rising or falling with the input, passes zero; NaN where it does not (a butterfly)."""
    passed = np.flatnonzero(np.signbit(branch[:-1]) != np.signbit(branch[1:]))
    if not passed.size:
        return float("nan")
    k = int(passed[0])
    return float(inputs[k] - branch[k] * (inputs[k + 1] - inputs[k]) / (branch[k + 1] - branch[k]))


def _creep(posterior: Posterior, low: float, high: float, count: int) -> np.ndarray:
    u = np.concatenate([[low, low], np.full(200, high)])
    t = np.concatenate([[0.0], _RESTED + 0.05 * np.arange(201)])  # the device has rested on `low` when the step comes
    y = posterior.predict(_record(u, t), count)
    return 100 * (y[:, 201] - y[:, 21]) / (y[:, 2] - y[:, 1])
