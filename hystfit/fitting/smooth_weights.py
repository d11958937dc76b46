"""Smooth weights by one convex solve, inside a search over the few other free parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from hystfit.errors import ModelError
from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.inference.problem import Problem
from hystfit.models.design import DesignMatrix
from hystfit.models.preisach.smooth import SMOOTHNESS, LeftOut, Offsets, SmoothSystem, fit_smooth
from hystfit.quality.reversal_curves import reversal_curves

_FEW = 6  # free parameters besides the weights that the search serves
_STEP = 1e-6  # of a central difference, in parts of a parameter's size


@dataclasses.dataclass(frozen=True)
class Split:
    """The free parameters of a problem, split into the weights of its design matrices and the others.

    Attributes:
        designs: one for each record.
        system: equations of all weights, the held ones included.
        place: position of each free parameter among the weights, shape (p,); -1 for parameters that are no weights.
        held: values of the weights that are not free, NaN for the free ones.
    """

    designs: list[DesignMatrix]
    system: SmoothSystem
    place: np.ndarray
    held: np.ndarray

    @classmethod
    def of(cls, problem: Problem, x: np.ndarray, *, left_out: LeftOut = "auto", offsets: Offsets = "each") -> Split:
        """Split at given values of the other parameters.

        Args:
            problem: what is fitted.
            x: physical parameters, shape (p,); those that are weights do not matter.
            left_out: see `SmoothSystem.of`.
            offsets: see `SmoothSystem.of`.
        """
        records, c = list(problem.data), problem.space.coordinates
        models = [c.assemble(jnp.asarray(x), k) for k in range(len(records))]
        designs = [model.design_matrix(r.u, r.dt) for model, r in zip(models, records, strict=True)]
        system = SmoothSystem.of(designs, records, left_out=left_out, offsets=offsets)
        first = {block.leaf: start for block, start in zip(system.blocks, system.starts, strict=False)}
        width = {block.leaf: block.columns.shape[1] for block in system.blocks}
        ends = dict(zip(first, system.starts[1:], strict=True))
        place: list[int] = []
        for leaf, positions, several in c.layout:
            for number in range(len(records) if several else 1):
                shift = number * width[leaf] if leaf in first and ends[leaf] - first[leaf] > width[leaf] else 0
                place += [first[leaf] + shift + k if leaf in first else -1 for k in positions]
        values = jax.tree_util.tree_leaves(problem.model)
        held = np.zeros(system.starts[-1])
        for leaf, start in first.items():
            held[start : ends[leaf]] = np.resize(np.asarray(values[leaf], dtype=float), ends[leaf] - start)
        where = np.array(place, dtype=int)
        held[where[where >= 0]] = np.nan
        return cls(designs, system, where, held)


class SmoothWeights(AbstractEstimator):
    """Weights that are smooth, and >= 0 as their bounds say, given the other free parameters; those by a simplex outside.

    For models with the method `design_matrix`: `Preisach`, solved on distinct states, and its compositions with a lag, creep or a
    resonance, whose parameters move to lower the cost at the smoothness found at the start; it is chosen again at the end.

    Attributes:
        smoothness: strengths of the penalty among which blocks left out choose.
        left_out: what chooses it, see `SmoothSystem.of`.
        max_evaluations: of the search.
    """

    smoothness: tuple[float, ...] = eqx.field(static=True, default=SMOOTHNESS)
    left_out: LeftOut = eqx.field(static=True, default="auto")
    max_evaluations: int = eqx.field(static=True, default=120)

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; the first start alone matters, because the weights need none.

        Raises:
            ModelError: the model has no smooth weights, or too many other parameters are free.
        """
        if problem.model.estimator != "preisach":
            raise ModelError(
                f"{type(problem.model).__name__} has no smooth weights: use method='convex', or 'lm' without linear weights"
            )
        # Reversal curves start from saturation, and are checked to be such.
        family = reversal_curves(list(problem.data)) if problem.model.from_saturation else None
        split = lambda x: Split.of(problem, x, left_out=self.left_out)
        x = np.array(problem.space.physical(starts[0]))
        now = split(x)
        others = np.flatnonzero(now.place < 0)
        evaluations, converged, message = 1, True, "solved"
        if others.size:
            x, evaluations, converged, message = self._search(problem, split, now, starts[0], others)
            now = split(x)
        fit = fit_smooth(now.system, self.smoothness, held=now.held)
        weights = now.place >= 0
        size = problem.scales.y
        penalty = np.zeros(x.size)
        x[weights], penalty[weights] = fit.weights[now.place[weights]], fit.penalty[now.place[weights]] / size**2
        notes = [] if family is None else [family.words(), *family.notes]
        notes += now.system.notes()
        if fit.left_out.size:
            notes.append(
                f"smoothness {fit.smoothness:.0e} chosen on {int(now.system.judged.sum())} blocks left out "
                f"(error there {fit.left_out.min():.2%} of the range)",
            )
        cost = 0.5 * fit.rss / size**2
        return Estimate(x, cost, converged, message, evaluations, np.array([cost]), penalty, tuple(notes))

    def _search(
        self, problem: Problem, split: Callable[[np.ndarray], Split], first: Split, z: np.ndarray, others: np.ndarray
    ) -> tuple[np.ndarray, int, bool, str]:
        """Physical parameters at the lowest penalized cost, number of evaluations, whether it converged, and a message."""
        if others.size > _FEW:
            names = ", ".join(problem.space.names[k] for k in others[:_FEW])
            raise ModelError(
                f"smooth weights are fitted beside at most {_FEW} other parameters, and {others.size} are free ({names}, ...): "
                "fix some, or use method='trf'"
            )
        strength = fit_smooth(first.system, self.smoothness, held=first.held).smoothness

        def cost(inner: np.ndarray) -> float:
            trial = z.copy()
            trial[others] = inner
            now = split(problem.space.physical(trial))
            return float(np.log(fit_smooth(now.system, (strength,), held=now.held).cost + 1e-300))

        # Tolerances a small part of the standard errors: the cost of n samples rises by 1 / n over one of them.
        options = {"maxfev": self.max_evaluations, "xatol": 1e-5, "fatol": 1e-7}
        found = scipy.optimize.minimize(cost, z[others], method="Nelder-Mead", options=options)
        z = z.copy()
        z[others] = found.x
        message = (
            "converged" if found.success else f"the search over other parameters stopped after {found.nfev} evaluations"
        )
        return np.array(problem.space.physical(z)), int(found.nfev), bool(found.success), message


def left_out_score(problem: Problem, x: np.ndarray) -> float:
    """Root mean square error on the blocks left out that choose the smoothness, output units, at physical x, shape (p,)."""
    now = Split.of(problem, x)
    return float(fit_smooth(now.system).left_out.min()) * now.system.size


def responses(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Derivative of every sample in every free parameter of a model with design matrices, shape (R T, p).

    Exact columns for the weights, central differences of look-ups for the few others: no scan needs to be compiled.

    Args:
        problem: with a model whose estimator is "preisach".
        x: physical parameters, shape (p,).
    """
    now = Split.of(problem, x)
    rows = np.zeros((*problem.objective.batch.u.shape, x.size))
    for number, (record, design) in enumerate(zip(problem.data, now.designs, strict=True)):
        for block, start, end in zip(now.system.blocks, now.system.starts, now.system.starts[1:], strict=False):
            width = block.columns.shape[1]
            first = start + number * width if end - start > width else start
            mine = np.flatnonzero((now.place >= first) & (now.place < first + width))
            source = next(b for b in design.blocks if b.leaf == block.leaf).columns
            rows[number, : len(record), mine] = source[:, now.place[mine] - first][design.index].T
    c = problem.space.coordinates
    lower, upper, scale = (np.asarray(v) for v in (c.lower, c.upper, c.scale))
    for k in np.flatnonzero(now.place < 0):
        step = _STEP * max(abs(x[k]), scale[k]) * np.eye(x.size)[k]
        above, below = np.minimum(x + step, upper), np.maximum(x - step, lower)
        for row, high, low in zip(rows, problem.predict_at(above), problem.predict_at(below), strict=True):
            row[: high.size, k] = (high - low) / (above[k] - below[k])
    return rows.reshape(-1, x.size)
