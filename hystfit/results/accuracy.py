"""The error of a prediction, and whether it is small enough: limits that depend on the data, and errors of simple descriptions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.outcome.table import ROUNDING, number
from hystfit.quality.baselines import DEGREE, MOST_OF, USABLE, VISIBLE, Baselines


@dataclasses.dataclass(frozen=True)
class Metrics:
    """Errors over the samples that count; the range is max - min of the measured output over the same samples.

    Attributes:
        rmse, max_error: in output units.
        nrmse_percent, max_error_percent: of the range; None where the range is zero.
        r2: explained part of the variance; None where there is none.
        n: number of samples.
    """

    rmse: float
    nrmse_percent: float | None
    max_error: float
    max_error_percent: float | None
    r2: float | None
    n: int

    @classmethod
    def of(cls, measured: Sequence[np.ndarray], predicted: Sequence[np.ndarray]) -> Metrics:
        """Metrics over records: arrays (T_r,) of the samples that count."""
        y = _joined(measured)
        span, variance = float(np.ptp(y)), _sum_of_squares(y - y.mean())
        error = _joined(predicted) - y
        largest = max(float(error.max()), -float(error.min()))
        squares = _sum_of_squares(error)
        rmse = float(np.sqrt(squares / y.size))
        percent = lambda value: 100 * value / span if span > 0 else None
        r2 = 1 - squares / variance if variance > 0 else None
        return cls(rmse, percent(rmse), largest, percent(largest), r2, y.size)

    def to_dict(self) -> dict[str, float | int | None]:
        """For `result.json`."""
        return {k: (v if v is None or np.isfinite(v) else None) for k, v in dataclasses.asdict(self).items()}


def _joined(rows: Sequence[np.ndarray]) -> np.ndarray:
    """One array of several; a single one as it is."""
    return np.asarray(rows[0]) if len(rows) == 1 else np.concatenate(rows)


def _sum_of_squares(values: np.ndarray) -> float:
    """The values are overwritten: long records have no room for copies."""
    return float(np.sum(np.multiply(values, values, out=values)))


_TIMES_PLAYS = 5.0  # the limit of the rms error, from `VISIBLE` to `USABLE`, is this many times the error of ten plays
# Percent of range above which no fit is called usable, unless the residuals are noise: of the rms error, and of one that persists over
# three samples (a shorter one is an outlier of the measurement).
POOR = 10.0
_BETTER = 2.0  # times the error of ten plays, above which another family of models is worth a try
NEGLIGIBLE = 0.1  # percent of range, below which no other model is worth a try
NOISY, _PEAKS = 2.0, 6.0  # times the noise: rms error and largest error that noise alone explains


class Limits(NamedTuple):
    """Largest rms error and largest persistent error of a usable description, percent of the output's range."""

    error: float
    largest: float

    @classmethod
    def of(cls, baselines: Baselines) -> Limits:
        """1 to 3 %: five times the error of ten plays; at least twice the noise."""
        percent = lambda value: 100 * value / baselines.span if baselines.span > 0 else 0.0
        noise = percent(baselines.noise or 0.0)
        usable = USABLE
        if baselines.plays is not None:
            usable = float(np.clip(_TIMES_PLAYS * percent(baselines.plays), VISIBLE, USABLE))
        return cls(max(usable, NOISY * noise), max(POOR, _PEAKS * noise))


def two_digits(percent: float) -> str:
    """A number with two significant digits, and no exponent."""
    return f"{float(f'{percent:.2g}'):g}"


def is_noise(rmse: float, baselines: Baselines) -> bool:
    """Whether the noise of the output explains an rms error [y]."""
    return baselines.noise is not None and rmse <= NOISY * baselines.noise


def is_single_valued_error(rmse: float, baselines: Baselines) -> bool:
    """Whether an rms error [y] is most of that of a single-valued curve: the loop itself is not described."""
    return rmse > MOST_OF * baselines.curve


def persistent_error(errors: Any, xp: Any = np) -> Any:
    """Size of the error that three successive samples, shape (..., T), have in common: the smallest of each and its neighbors."""
    size = xp.abs(errors)
    if size.shape[-1] < 3:
        return size
    inner = xp.minimum(xp.minimum(size[..., :-2], size[..., 1:-1]), size[..., 2:])
    return xp.concatenate([inner[..., :1], inner, inner[..., -1:]], axis=-1)


def _lasting_percent(rows: Sequence[np.ndarray], baselines: Baselines) -> float:
    """Largest error that persists over three samples, percent of the output's range."""
    largest = max((float(persistent_error(row).max()) for row in rows if row.size), default=0.0)
    return 100 * largest / baselines.span


def exceeded_limits(metrics: Metrics, rows: Sequence[np.ndarray], baselines: Baselines) -> list[str]:
    """Limits of a usable description that errors, the `rows` of each record [y], exceed, each in words; empty for a usable one."""
    if metrics.nrmse_percent is None or baselines.span <= 0:
        return []
    limits, found, largest = Limits.of(baselines), [], _lasting_percent(rows, baselines)
    if metrics.nrmse_percent > limits.error:
        found.append(
            f"the error is {metrics.nrmse_percent:.3g} % of the range, above the limit of {two_digits(limits.error)} %"
        )
    if largest > limits.largest:
        found.append(
            f"an error of {largest:.3g} % of the range persists over three samples, above the limit of {two_digits(limits.largest)} %"
        )
    if is_single_valued_error(metrics.rmse, baselines) and not is_noise(metrics.rmse, baselines):
        found.append(
            f"the error is {100 * metrics.rmse / baselines.curve:.0f} % of that of a single-valued curve: the model "
            "does not describe the loop"
        )
    return found


def ratios(metrics: Metrics, baselines: Baselines) -> dict[str, float | None]:
    """The rms error over noise, straight line, single-valued curve and ten plays; None where one is unknown or a rounding error."""
    over = lambda value: metrics.rmse / value if value and value > ROUNDING * baselines.span else None
    return {name: over(getattr(baselines, name)) for name in ("noise", "line", "curve", "plays")}


def better_family_warning(metrics: Metrics, baselines: Baselines) -> Note | None:
    """A warning where the error of ten plays is far smaller; None where it is not, or the noise explains that of the model."""
    if baselines.plays is None or is_noise(metrics.rmse, baselines) or metrics.rmse <= _BETTER * baselines.plays:
        return None
    if metrics.nrmse_percent is None or metrics.nrmse_percent < NEGLIGIBLE:
        return None
    text = (
        f"the error of ten plays is {100 * baselines.plays / baselines.span:.2g} % of the range, and that of this model "
        f"{metrics.rmse / baselines.plays:.2g} times as large: another family fits these data better (see hystfit compare)"
    )
    return warn(Code.OTHER_FAMILY, text)


def accuracy_note(metrics: Metrics, rows: Sequence[np.ndarray], baselines: Baselines, what: str) -> Note:
    """The error with its limits, and relative to the noise and simpler descriptions; `rows` as in `exceeded_limits`."""
    if metrics.nrmse_percent is None or metrics.max_error_percent is None or baselines.span <= 0:
        return Note(Code.ACCURACY, f"{what}: the range of the output is zero")
    limits, over = Limits.of(baselines), ratios(metrics, baselines)
    names = {
        "noise": "the noise",
        "line": "the error of a straight line",
        "curve": f"that of a polynomial of degree {DEGREE}",
        "plays": "that of ten plays",
    }
    beside = [f"{number(value, '.2g')} times {names[name]}" for name, value in over.items() if value is not None]
    text = (
        f"rms {what} {metrics.nrmse_percent:.3g} % of the range (limit {two_digits(limits.error)} %), largest "
        f"{metrics.max_error_percent:.3g} % at one sample and {_lasting_percent(rows, baselines):.3g} % over three "
        f"(limit {two_digits(limits.largest)} %)"
    )
    return Note(Code.ACCURACY, text + (f"; the rms {what} is " + ", ".join(beside) if beside else ""))


def verdict_dict(metrics: Metrics | None, baselines: Baselines | None) -> dict[str, Any] | None:
    """Baselines, limits and ratios for `result.json`."""
    if metrics is None or baselines is None:
        return None
    limits = Limits.of(baselines)
    return {
        "baselines": {"span": baselines.span, "noise": baselines.noise, "line": baselines.line, "curve": baselines.curve,
                      "plays": baselines.plays},
        "limits_percent": {"error": limits.error, "largest": limits.largest},
        "error_over": ratios(metrics, baselines),
    }  # fmt: skip
