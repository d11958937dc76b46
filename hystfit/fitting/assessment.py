"""The verdict on a fit, in words: usable or not, what is not determined, which bounds were reached."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystfit.data.record import Dataset
from hystfit.fitting.covariance import Uncertainty
from hystfit.fitting.estimate import Estimate
from hystfit.models.base import AbstractHysteresis
from hystfit.models.preisach.model import Preisach
from hystfit.quality.reversal_curves import recognize_family
from hystfit.quality.summary import summarize
from hystfit.results.metrics import Metrics, is_correlated

_POOR = 10.0  # percent of range above which no fit is called usable
_ROUGH = 3.0  # percent of range above which a reason is looked for why the model may be the wrong one
_SHARE = 0.7  # of the error of a single-valued curve: above it the loop itself is not described
_ENOUGH = 30  # residuals of a record that can be called white
_NOISY = (
    "the error is {:.3g} % of the range and all noise, for the residuals are white: average cycles, or drive further"
)
_MANY = 12  # weights above this number are counted in a note, not named


def turns_back(data: Dataset) -> bool:
    """Whether any record's input reverses by more than 1 % of its range while samples count."""
    for record in data:
        u = record.u[: int(np.flatnonzero(record.used)[-1]) + 1]
        span = float(np.ptp(u))
        risen = float(np.max(u - np.minimum.accumulate(u)))
        fallen = float(np.max(np.maximum.accumulate(u) - u))
        if min(risen, fallen) > 0.01 * span > 0:
            return True
    return False


def curve_error(data: Dataset) -> float:
    """RMSE of the best single-valued curve (Legendre degree 7, an offset for each record): what ignoring hysteresis costs."""
    rows, right = [], []
    low = min(float(r.u.min()) for r in data)
    high = max(float(r.u.max()) for r in data)
    for k, record in enumerate(data):
        x = 2 * (record.u[record.used] - low) / (high - low) - 1
        own = np.zeros((x.size, len(data)))
        own[:, k] = 1.0
        rows.append(np.hstack([np.polynomial.legendre.legvander(x, 7)[:, 1:], own]))
        right.append(record.y[record.used])
    A, y = np.concatenate(rows), np.concatenate(right)
    return float(np.sqrt(np.mean((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2)))


def only_noise_is_left(rows: Sequence[np.ndarray], plain: float, parameters: int) -> bool:
    """Whether residuals are white beside a loop that stands out of them: however large they are, no model leaves less.

    Args:
        rows: residuals of each record.
        plain: RMSE of the best single-valued curve.
        parameters: of the model; the loop is believed where it is worth them by the Bayesian information criterion.
    """
    count = sum(row.size for row in rows)
    rmse = float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
    if min(row.size for row in rows) < _ENOUGH or any(is_correlated(row) for row in rows) or not 0 < rmse < plain:
        return False
    return bool(2 * count * np.log(plain / rmse) > parameters * np.log(count))


def status_of(
    data: Dataset, model: AbstractHysteresis, estimate: Estimate, train: Metrics, rows: Sequence[np.ndarray]
) -> tuple[str, list[str]]:
    """Status of a fit that leaves the residuals `rows` (of each record), and why."""
    from_saturation = isinstance(model, Preisach) and model.spacing == "reversal-curves"
    if not (from_saturation or turns_back(data)):
        family = recognize_family(data)
        if family is None:
            return "no-loop", [
                "the input never turns back by more than 1 % of its range: there is no loop in these data"
            ]
        return "no-loop", [
            f"{family.words()}; this model takes each to start at rest on its reversal point: use preisach-forc, which "
            "starts from saturation"
        ]
    percent = train.nrmse_percent if train.nrmse_percent is not None else np.inf
    plain = curve_error(data)
    noise = percent > _ROUGH and only_noise_is_left(rows, plain, estimate.x.size)
    if percent > _POOR and not noise:
        return "poor", [f"the error is {percent:.3g} % of the range: the model does not describe this loop"]
    if percent > _ROUGH and train.rmse > _SHARE * plain and not noise:
        return "poor", [
            f"the error is {train.rmse / plain:.0%} of what a single-valued curve without hysteresis leaves: "
            "the loop itself is not described"
        ]
    if percent > _ROUGH and not noise and any(summarize(record).degrading for record in data):
        return "poor", [
            f"the loop loses stiffness from cycle to cycle (damage), and the error is {percent:.3g} % of the range: the model has no "
            "term for it (see hystfit check)"
        ]
    if not estimate.converged:
        return "not-converged", [estimate.message]
    large = percent > _POOR or train.rmse > _SHARE * plain
    return "ok", [_NOISY.format(percent)] if noise and large else []


def notes_of(
    data: Dataset,
    model: AbstractHysteresis,
    names: Sequence[str],
    linear: Sequence[bool],
    estimate: Estimate,
    errors: Uncertainty,
    bounds: Sequence[str | None],
) -> list[str]:
    """What a reader must know beside the numbers."""
    notes = list(estimate.notes)
    for record in data:
        notes += [line for line in model.advice(record.u) if line not in notes]
    reached = [
        (name, side) for name, side, is_linear in zip(names, bounds, linear, strict=True) if side and not is_linear
    ]
    notes += [
        f"{name} ran into its {side} bound: it has no standard error, and the others assume that it stays there"
        for name, side in reached
    ]
    zero = sum(1 for side, is_linear in zip(bounds, linear, strict=True) if side and is_linear)
    if zero:
        notes.append(f"{zero} of {sum(linear)} linear weights are zero (on their bound)")
    idle = [name for name, none in zip(names, errors.inactive, strict=True) if none]
    if idle:
        shown = ", ".join(idle[:_MANY]) + (f" and {len(idle) - _MANY} more" if len(idle) > _MANY else "")
        notes.append(f"no influence on these data: {shown}")
    if len(errors.directions) > 3 and sum(linear) > _MANY:
        notes.append(
            f"{len(errors.directions)} combinations of the weights are not determined by the data (rank {errors.rank} of "
            f"{len(names)}); predictions within the fitted range do not need them"
        )
    else:
        notes += [f"not determined by these data: {words}" for words in errors.directions]
    if estimate.penalty is not None and np.any(estimate.penalty > 0):
        notes.append(
            "standard errors take the regularization of the weights for knowledge about them: the data alone give larger ones"
        )
    if errors.correlation_time > 1.0 or errors.ratio != 1.0:
        notes.append(
            f"residuals are correlated over {errors.correlation_time:.3g} samples; standard errors are "
            f"{errors.ratio:.2g} times those for independent residuals{_slow(errors)}"
        )
    return notes


def _slow(errors: Uncertainty) -> str:
    """The slow noise behind errors that a short correlation time alone would not explain."""
    noise = errors.left.noise
    if not errors.left.correlated or noise is None:
        return ""
    time = noise.noise.parameters["noise_time"]
    return f" (slow noise among them lasts {time:.3g} samples)" if time > 2 * errors.correlation_time else ""
