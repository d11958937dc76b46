"""The order of the models of a comparison: by their errors on held-out samples, and where these do not differ the plainest first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hystfit.fitting.comparison.compared_models import MARGIN, STRONG, UNFIT, Purpose, Row
from hystfit.outcome import Status


def ranked(rows: Sequence[Row], purpose: Purpose, floor: float = 0.0, *, equal: float = 1.0) -> list[Row]:
    """Models from best to worst, by their errors on held-out samples.

    A few large errors decide such an error. Where errors do not differ by more than it is known, what else speaks for a model decides, see
    `_plainest_first`. A fit that has not converged is not first beside one that can be used.

    Args:
        rows: of the models.
        purpose: of the choice.
        floor: error up to which they do not differ [percent of range], that of rounding, which recurs where the cycles repeat.
        equal: ratio to the smallest error up to which they do not differ.
    """
    by_error = sorted(rows, key=lambda row: _rank(row, purpose))
    if not by_error or by_error[0].score_percent is None:
        return by_error
    ended = [row for row in by_error if row.status not in UNFIT]
    if by_error[0].status is Status.NOT_CONVERGED and ended and ended[0].status is Status.OK:
        first = ranked(ended, purpose, floor, equal=equal)[0]
        return [first, *(row for row in by_error if row is not first)]
    kind, most = _rank(by_error[0], purpose)[:-1], equal * _error(by_error[0])
    alike = [row for row in by_error if _rank(row, purpose)[:-1] == kind and _error(row) <= max(most, floor)]
    # Rounding errors are no evidence.
    return _plainest_first(alike, evidence=most > floor) + by_error[len(alike) :]


def _plainest_first(alike: Sequence[Row], *, evidence: bool) -> list[Row]:
    """Models whose errors do not differ: fits that converged and describe the loop first, at one pace those without time, those without
    strong evidence against them by BIC, without hysteresis, with fewer determined parameters, and with an inverse.

    Args:
        evidence: whether their BIC tells of the models, not of rounding.
    """
    least = min((row.bic for row in alike if row.bic is not None and evidence), default=math.inf)

    def plain(row: Row) -> tuple[Any, ...]:
        unlikely = row.bic is not None and row.bic > least + STRONG
        parameters = row.effective or row.parameters or 0
        return row.status in UNFIT, row.paced, unlikely, row.hysteretic, parameters, not row.family_inverts, row.score

    return sorted(alike, key=plain)


def _error(row: Row) -> float:
    """Error by which a model ranks [percent of range]: one that describes the loops only roughly must err clearly less."""
    return (row.ranked_percent or 0.0) * (MARGIN if row.status is Status.ROUGH else 1.0)


def _rank(row: Row, purpose: Purpose) -> tuple[Any, ...]:
    """Validated models first, then those that serve the purpose, then the smallest error on left-out data."""
    return (
        row.in_sample_percent is None,
        row.status is Status.UNTESTED,
        row.status is Status.NO_LOOP and row.hysteretic,
        purpose != "prediction" and not row.serves(purpose),
        row.score_percent is None,
        _error(row) or (row.in_sample_percent or 0.0) * row.handicap,
    )
