"""Judgment of a run of the unscented filter: innovations, settled parameters, simulation error, number of amplitudes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.outcome import Code, Note, Severity
from hystfit.outcome.note import warn
from hystfit.quality.loops import APART, SAME_LEVEL, reversals

NIS_BAND = 0.2  # how far the mean normalized innovation squared of a consistent filter may lie from 1
FOLLOWS = 0.01  # simulation error beyond the noise, RMS as a fraction of the output's range
_NIS_SIGMAS = 3.0  # standard deviations of that mean which are allowed where its samples are few
_SETTLED = 1e-3  # largest relative change of a parameter over the last tenth of the record


def relative_change(before: np.ndarray, after: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Changes of physical parameters in parts of their values, or of their scales where those are larger."""
    return np.abs(after - before) / np.maximum(np.abs(after), scale)


def unsettled(names: Sequence[str], change: np.ndarray) -> Note | None:
    """A note on parameters that change over the last tenth of the record; `change` as `relative_change` has it."""
    rows = [(name, part) for name, part in zip(names, change, strict=True) if part > _SETTLED]
    if not rows:
        return None
    listed = ", ".join(f"{name} by {100 * part:.2g} %" for name, part in rows)
    return warn(Code.NOT_SETTLED, f"parameters still change over the last tenth of the record: {listed}")


def excess(rmse: float, noise: float, span: float) -> float:
    """Simulation error beyond the noise, as a fraction of the output's range; all rms, in the same unit."""
    return math.sqrt(max(0.0, rmse**2 - noise**2)) / span


def undetermined(shape: Sequence[str], data: Dataset, *, follows: bool) -> Note | None:
    """A note where the input has too few amplitudes to separate the parameters `shape`; `follows` if the simulation does the records."""
    count = loop_count(data)
    if len(shape) < 2 or count > 2:
        return None
    described = f"{count} loop{'s' if count > 1 else ''} of one amplitude" if count else "no loop"
    return warn(
        Code.NOT_DETERMINED,
        f"the data cannot separate {', '.join(shape)}: the input has {described}. The model "
        f"{'predicts' if follows else 'does not even predict'} this input; for other inputs, excite several amplitudes "
        "(signal amplitude-sweep)",
    )


def loop_count(data: Dataset) -> int:
    """Number of different loops of the inputs: pairs of neighboring turning points that differ by 5 % of the range."""
    low, high = min(r.u.min() for r in data), max(r.u.max() for r in data)
    span = max(high - low, 1e-300)
    pairs: list[np.ndarray] = []
    for record in data:
        turns = (record.u[reversals(record.u, SAME_LEVEL * span)] - low) / span
        for pair in np.sort(np.stack([turns[:-1], turns[1:]], axis=1), axis=1):
            if all(np.max(np.abs(pair - other)) > APART for other in pairs):
                pairs.append(pair)
    return len(pairs)


def skipped(missing: int, rejected: int) -> list[Note]:
    """Notes on samples without a measurement and on those that the filter rejected."""
    notes = []
    if missing:
        text = f"samples without a measurement: {missing}; the model was driven through them by its input"
        notes.append(Note(Code.SKIPPED_SAMPLES, text))
    if rejected:
        text = f"samples rejected because the prediction of the sigma points was not finite: {rejected}"
        notes.append(warn(Code.SKIPPED_SAMPLES, text))
    return notes


def innovations(average: float, memory: float) -> Note:
    """A note on the mean normalized innovation squared over the last samples, a warning where it is outside its band.

    `memory` is the time constant of the exponentially weighted mean in samples; for white Gaussian innovations its standard
    deviation is memory^-1/2.
    """
    width = max(NIS_BAND, _NIS_SIGMAS / math.sqrt(max(memory, 1.0)))
    text = f"mean normalized innovation squared over the last tenth: {average:.3g} (1 +- {width:.2g} for a consistent filter)"
    if average > 1 + width:
        text += "; the filter is overconfident: increase noise or walk, or use a more flexible model"
    elif average < 1 - width:
        text += "; the filter is underconfident: decrease noise or walk"
    consistent = abs(average - 1) <= width
    text += ". The covariance of the filter is not an error bar: fit by least squares from here for standard errors"
    return Note(Code.INNOVATIONS, text, Severity.INFO if consistent else Severity.WARNING)
