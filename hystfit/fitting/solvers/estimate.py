"""What every batch estimator takes and returns."""

from __future__ import annotations

import abc
import dataclasses
from typing import Any

import equinox as eqx
import numpy as np

from hystfit.inference.linearization import Linearization
from hystfit.inference.problem import Problem
from hystfit.outcome import Note


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A point in parameter space and how it was reached."""

    x: np.ndarray  # free parameters in physical units, shape (p,); a weight may lie exactly on its bound
    cost: float  # half the sum of squared residuals (in units of the output's half range)
    converged: bool  # the solver met its tolerances
    message: str  # of the solver, with what to try where it failed
    evaluations: int  # steps of the solver, over all starts
    costs: np.ndarray  # cost that each start reached, shape (starts,); not finite where one failed
    # what regularization adds to the normal matrix of x in units of the cost, shape (p, p); None without regularization
    penalty: np.ndarray | None = None
    notes: tuple[Note, ...] = ()  # choices that were made
    # rms error on blocks left out of the fit [y], by which a regularization was chosen; None where none was
    left_out: float | None = None
    toward_zero: bool = False  # the penalty is a ridge: nothing but its diagonal, toward zero
    # number of parameters that the data determine: the trace of the matrix that maps outputs to predictions; None where no penalty or bound
    # reduces it
    effective: float | None = None
    linearized: Linearization | None = None  # `Problem.linearization` at x, where the estimator ended with it

    @classmethod
    def solved(cls, x: np.ndarray, cost: float, **others: Any) -> Estimate:
        """That of a closed form, which takes one step from anywhere; `others` are further attributes."""
        return cls(x, cost, True, "solved", 1, np.array([cost]), **others)

    def freedom(self, samples: int, live: int) -> float:
        """Degrees of freedom of the residuals, at least 1: samples that count, less the parameters off their bounds that these determine.

        A penalty that holds hundreds of weights together leaves far more than their number would.
        """
        return max(samples - (live if self.effective is None else self.effective), 1.0)

    @property
    def in_best_basin(self) -> int:
        """How many starts came within 1 % of the best cost."""
        finite = self.costs[np.isfinite(self.costs)]
        return int(np.sum(finite <= finite.min() * 1.01 + 1e-300)) if finite.size else 0


class AbstractEstimator(eqx.Module):
    """A way to fit a problem; its settings are its fields, and `needs_starts` whether several starts can lead to different minima."""

    needs_starts: eqx.AbstractClassVar[bool]

    @abc.abstractmethod
    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """Fit from starts of shape (S, p) in unconstrained coordinates; the first is the data-driven one."""

    def quick(self) -> AbstractEstimator:
        """The same with tolerances for a quick first fit of a model; by default as it is."""
        return self

    def up_to(self, most: float) -> AbstractEstimator:
        """The same, which need not finish a fit whose error where samples are held out will be above `most` [y]; by default as it is."""
        return self
