"""Whether records differ by a factor of their outputs, as soil at several depths and devices of several sizes do."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.fitting.judgment.fitted import Fitted
from hystfit.outcome.note import Code, Note, warn
from hystfit.quality.baselines import MOST_OF
from hystfit.quality.equal_inputs import option_of

_APART = 1.1  # largest factor over the smallest, from which records differ: gains of one device drift by a few percent


def scale_note(fitted: Fitted) -> Note | None:
    """A warning where a factor for each record explains most of the error, which loops of other ranges cannot show."""
    if len(fitted.rows) < 2:
        return None
    factors, left = [], []
    for record, row in zip(fitted.data, fitted.rows, strict=True):
        y = record.y[record.used]
        simulated = y + row  # rows are prediction less measurement
        simulated, y = simulated - simulated.mean(), y - y.mean()
        if not (power := float(simulated @ simulated)) > 0:
            return None
        factors.append(float(y @ simulated) / power)
        left.append(y - factors[-1] * simulated)
    rms = lambda rows: float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
    low, high = min(factors), max(factors)
    if not (0 < low and high > _APART * low and rms(left) < MOST_OF * rms(fitted.rows)):
        return None
    one, other = (fitted.data[factors.index(value)].name for value in (low, high))
    text = (
        f"the outputs of the records are {low:.3g} ({one!r}) to {high:.3g} times ({other!r}) those of the model: their inputs do "
        "not tell them apart. Fit each one separately (only=), or all of them with hystfit batch"
    )
    return dataclasses.replace(warn(Code.RECORDS_DIFFER, text), option=option_of(one, fitted.data))
