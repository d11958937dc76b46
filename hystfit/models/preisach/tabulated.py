"""The Preisach model of a measured Everett table (Song et al. 2005, eqs. (2) to (5)), with its inverse (6) to (11)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.models.preisach.everett import cells
from hystfit.models.preisach.everett_table import EverettTable
from hystfit.models.preisach.model import Preisach
from hystfit.params.param import param


class TabulatedPreisach(Preisach):
    """A table X(alpha, beta) = f_alpha - f_alpha_beta read off curves that rise from the lowest input to a peak and fall back.

    The table is interpolated as in the paper: bilinear in rectangles, which is a uniform density in each cell off the diagonal,
    and linear in the triangles on the diagonal, which is a piecewise linear single-valued part (`slopes`) and no mass. `fit` reads
    the values off the curves without a least-squares solve. Masses may have either sign; the inverse needs a table that rises with
    alpha and falls with beta: `fit` replaces a table that noise made non-monotone by the nearest monotone one.
    """

    estimator: ClassVar[str] = "everett-table"
    needs: ClassVar[None] = None  # as `Preisach`, which `check` judges

    w: Float[Array, " cells"] = param(
        unit="y", scale=0.01, linear=True, doc="weights of the cells, (i, j) row by row, j <= i; 0 on the diagonal"
    )
    slopes: Float[Array, " intervals"] = param(
        (), unit="y", scale=0.1, linear=True, doc="differences X(L_k+1, L_k) next to the diagonal"
    )

    @classmethod
    def of(cls, n: int = 12) -> TabulatedPreisach:  # type: ignore[override]
        """A model with n + 1 equally spaced levels from the lowest input to the highest peak.

        Args:
            n: intervals of the table along each axis; the paper has one for each peak.
        """
        levels = np.linspace(-1, 1, n + 1)
        width = np.maximum(np.subtract.outer(levels, levels), 0.0)
        table = EverettTable(levels, 0.25 * width + 0.125 * width**2)
        return dataclasses.replace(cls.from_table(table), spacing="uniform")

    @classmethod
    def from_table(cls, table: EverettTable) -> TabulatedPreisach:
        """The model of a table, with an empty memory at its lowest level."""
        n, levels = table.levels.size - 1, table.levels
        masses, next_to = table.masses(), np.diagonal(table.X, -1)
        i, j = cells(n)
        w = np.where(i == j, 0.0, masses)
        return cls(
            w=w,
            levels=levels,
            slopes=next_to,
            offset=table.base + w.sum(),
            center=0.5 * (levels[0] + levels[-1]),
            half=0.5 * (levels[-1] - levels[0]),
            initial="negative",
        )

    def table(self) -> EverettTable:
        """The table of the model."""
        i, j = cells(self.n)
        w = np.asarray(self.w)
        masses = w.copy()
        masses[i == j] += 0.5 * np.asarray(self.slopes)
        return EverettTable.from_masses(np.asarray(self.levels), masses, float(self.offset) - float(w.sum()))

    def settings(self) -> dict[str, int | bool | str]:
        return {"n": self.n}

    def choices(self, records: Sequence[Record]) -> tuple[Any, ...]:
        """None: the table is not compared by left-out data."""
        return ()
