"""A Preisach table read off measured curves: values between samples, and no least squares."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hystfit.errors import ModelError
from hystfit.fitting.solvers.estimate import AbstractEstimator, Estimate
from hystfit.fitting.solvers.multistart import with_record_parameters
from hystfit.inference.problem import Problem
from hystfit.models.preisach.everett_table import EverettTable
from hystfit.models.preisach.tabulated import TabulatedPreisach
from hystfit.outcome import Code, Note


class TableReading(AbstractEstimator):
    """The table of a `TabulatedPreisach` from curves that rise to peaks and fall back, made monotone where noise left it otherwise."""

    needs_starts: ClassVar[bool] = False

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; the starts give the levels alone."""
        model, records = problem.model, list(problem.data)
        if not isinstance(model, TabulatedPreisach):
            raise ModelError(
                f"only everett-table can be read off the curves, got {type(model).__name__}: use preisach in compositions, and "
                "method='auto' for other models"
            )
        if held := [name for name, *_ in problem.space.fixed() if name.partition("[")[0] in ("w", "slopes")]:
            raise ModelError(f"the table is read as a whole, but {held[0]} is fixed: leave all of w and slopes free")
        table = EverettTable.from_descending(records, np.asarray(model.levels))
        notes = [
            f"the values of the table on {table.levels.size} levels are read off the curves, not fitted by least squares"
        ]
        if (table.turned() > 1e-9).any():
            table, moved = table.monotone()
            notes.append(
                f"{moved.nodes} values moved by up to {moved.largest:.2g} % of the largest, so that the table is monotone"
            )
        x = with_record_parameters(problem, problem.space.vector(TabulatedPreisach.from_table(table)))
        cost = 0.5 * float(np.sum(problem.misfit(x) ** 2))
        return Estimate.solved(x, cost, notes=tuple(Note(Code.CHOICE, text) for text in notes))
