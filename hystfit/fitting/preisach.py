"""Weights of a Preisach model in closed form, smooth."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx
import numpy as np

from hystfit.errors import ModelError
from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.inference.problem import Problem
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.equations import LeftOut, PreisachSystem
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.smooth import SMOOTHNESS, fit_smooth
from hystfit.models.preisach.solve import _TERMS, reach_notes
from hystfit.outcome import Code, Note
from hystfit.quality.reversal_curves import reversal_curves


class PreisachWeights(AbstractEstimator):
    """Weights of a `Preisach` model, levels given: smooth, >= 0 as the parameters' bounds say, solved on distinct states.

    Attributes:
        smoothness: strengths of the penalty among which blocks left out choose.
        left_out: what chooses it, see `PreisachSystem.of`.
    """

    needs_starts: ClassVar[bool] = False
    smoothness: tuple[float, ...] = eqx.field(static=True, default=SMOOTHNESS)
    left_out: LeftOut = eqx.field(static=True, default="auto")

    def estimate(self, problem: Problem, starts: np.ndarray) -> Estimate:
        """See `AbstractEstimator.estimate`; starts do not matter.

        Raises:
            ModelError: the model is no `Preisach`, or something other than weights, slopes, b and offset is free.
        """
        model = problem.model
        if not isinstance(model, Preisach):
            raise ModelError(f"this method fits Preisach models, got {type(model).__name__}; use method='convex'")
        records = list(problem.data)
        # Reversal curves start from one state: an offset for each would blur what tells them apart.
        family = reversal_curves(records) if model.spacing == "reversal-curves" else None
        own = len(records) if family is None else 1
        system = PreisachSystem.of(model, records, left_out=self.left_out, offsets="shared" if family else "each")
        place = _positions(problem, len(records))
        fixed = [np.asarray(getattr(model, name), float).reshape(-1) for name in _TERMS]
        held = np.concatenate([*fixed, np.full(own, float(model.offset))])
        place = np.minimum(place, held.size - 1) if family is not None else place
        held[place[place >= 0]] = np.nan
        fit = fit_smooth(system, self.smoothness, held=held)
        size = problem.scales.y
        x, penalty = fit.weights[place], fit.penalty[place] / size**2
        cost = 0.5 * fit.rss / size**2
        notes = [] if family is None else [Note(Code.CHOICE, text) for text in (family.words(), *family.notes)]
        notes += [Note(Code.CHOICE, text) for text in reach_notes(model, system.reach)]
        if fit.left_out.size:
            notes.append(
                Note(
                    Code.CHOICE,
                    f"smoothness {fit.smoothness:.0e} chosen on {int(system.judged.sum())} blocks left out "
                    f"(error there {fit.left_out.min():.2%} of the range)",
                )
            )
        return Estimate(x, cost, True, "solved", 1, np.array([cost]), penalty, tuple(notes))


def _positions(problem: Problem, records: int) -> np.ndarray:
    """Where each free parameter of a problem stands among (w, slopes, b, offsets), shape (p,)."""
    model = problem.model
    start = dict(zip(_TERMS, np.cumsum([0, model.w.size, model.slopes.size]), strict=True))
    end = model.w.size + model.slopes.size + model.b.size
    leaves = {leaf.index: leaf.path[-1] for leaf in problem.space.leaves}
    out = []
    for index, positions, own in problem.space.coordinates.layout:
        name = leaves[index]
        if name == "offset" and own:
            out += [end + k for k in range(records)]
        elif name in start:
            out += [start[name] + k for k in positions]
        else:
            raise ModelError(
                f"the weights of a Preisach model are fitted with {name} fixed: fix it, or use method='trf'"
            )
    return np.array(out, dtype=int)


def responses(problem: Problem) -> np.ndarray:
    """Response of every sample to every free parameter of a Preisach problem, shape (R T, p): exact, from distinct states."""
    model, batch = problem.model, problem.objective.batch
    place = _positions(problem, len(problem.data))
    count = sum(getattr(model, name).size for name in _TERMS)
    rows = np.zeros((*batch.u.shape, place.size))
    for number, record in enumerate(problem.data):
        A, index = features(model, record.u)
        inner, own = place < count, place == count + number
        rows[number, : len(record), inner] = A[:, place[inner]][index].T
        rows[number, : len(record), own] = 1.0
    return rows.reshape(-1, place.size)
