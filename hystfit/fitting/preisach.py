"""Weights of a Preisach model from any records: convex, non-negative, smooth, the smoothness chosen on data left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import numpy as np
import scipy.sparse

from hystfit.data.record import Dataset, Record
from hystfit.errors import ModelError
from hystfit.fitting.estimate import AbstractEstimator, Estimate
from hystfit.fitting.nonnegative import solve_nonnegative
from hystfit.metrics import Metrics
from hystfit.models.compiled import compile_for, features, respond
from hystfit.models.everett import mirror
from hystfit.models.preisach import Preisach
from hystfit.problem import Problem

SMOOTHNESS = tuple(10.0**k for k in range(-9, 0))
_MANY = 1200  # parameters from which the choice of smoothness ignores bounds and leaves out two folds only: seconds, not minutes
_RIDGE = 1e-3  # of the weights themselves, relative to that of their second differences
_BLOCKS = 5
LeftOut = Literal["auto", "blocks", "records"]
Offsets = Literal["each", "shared", "none"]
_TERMS = ("w", "slopes", "b")


@dataclasses.dataclass(frozen=True)
class PreisachSystem:
    """Normal equations of all linear parameters of a model: (w, slopes, b, offsets), the outputs in units of `size`.

    Attributes:
        model: gives levels, center and initial state.
        grams: one matrix a block of samples, shape (blocks, p + 1, p + 1); the output comes last.
        counts: sum of weights of each block, shape (blocks,).
        judged: blocks that are left out in turn to choose the smoothness, shape (blocks,), bool.
        roughness: matrix of the smoothness penalty, shape (p, p).
        bounded: which parameters are >= 0, shape (p,).
        reach: part of each cell that the samples that count switched both ways, shape (weights,), 0 for cells never touched.
        size: of the output, by which it was divided.
    """

    model: Preisach
    grams: np.ndarray
    counts: np.ndarray
    judged: np.ndarray
    roughness: np.ndarray
    bounded: np.ndarray
    reach: np.ndarray
    size: float

    @classmethod
    def of(
        cls,
        model: Preisach,
        data: Record | Dataset | Sequence[Record],
        *,
        left_out: LeftOut = "auto",
        nonnegative: bool = True,
        offsets: Offsets = "each",
    ) -> PreisachSystem:
        """Collect the equations of records.

        Args:
            model: levels and terms; its weights do not matter.
            data: records; a sample counts with its weight.
            left_out: what is left out in turn: "blocks", a contiguous fifth of each record; "records", in up to five
                groups, the records that lie inside the range of the others, which asks how well loops between those measured
                are predicted; "auto" takes records where there are such.
            nonnegative: bound weights and slopes from below.
            offsets: each record its own constant, one for all, or none.

        Raises:
            ModelError: no record lies inside the range of the others, and records were asked for.
        """
        records = list(Dataset.of(data))
        inner = _inner(records)
        left_out = ("records" if inner.any() else "blocks") if left_out == "auto" else left_out
        if left_out == "records" and not inner.any():
            raise ModelError('left_out="records" needs a record inside the range of the others; use "blocks"')
        size = float(np.ptp(np.concatenate([r.y[r.used] for r in records]))) or 1.0
        count = model.w.size + model.slopes.size + model.b.size
        own = {"each": len(records), "shared": 1, "none": 0}[offsets]
        folds = _folds(records, inner) if left_out == "records" else [r.blocks(_BLOCKS) for r in records]
        blocks = len(folds[0])
        rows: list[list[np.ndarray]] = [[] for _ in range(blocks)]
        counts = np.zeros(blocks)
        low, high = np.full(model.w.size, np.inf), np.full(model.w.size, -np.inf)
        for number, (record, masks) in enumerate(zip(records, folds, strict=True)):
            A, index = features(model, record.u)
            constant = np.zeros((A.shape[0], own))
            constant[:, number if offsets == "each" else slice(None)] = 1.0
            A = np.column_stack([A, constant])
            for block, mask in enumerate(masks):
                if mask.any():
                    rows[block].append(_rows(A, index[mask], record.y[mask] / size, record.weight[mask]))
                    counts[block] += record.weight[mask].sum()
            seen = A[np.unique(index[record.used]), : model.w.size]
            low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
        joint = (np.concatenate(part) if part else np.zeros((0, count + own + 1)) for part in rows)
        grams = np.stack([part.T @ part for part in joint])
        bounded = np.zeros(count + own, dtype=bool)
        bounded[: model.w.size + model.slopes.size] = nonnegative
        share = np.clip((high - low) / (2 * _multiplicity(model)), 0.0, 1.0)
        judged = np.arange(blocks) < (blocks if left_out == "blocks" else blocks - 1)
        return cls(model, grams, counts, judged, _roughness(model, own), bounded, share, size)

    @property
    def untouched(self) -> np.ndarray:
        """Weights whose cell the data never switched, shape (weights,), bool."""
        return self.reach < 1e-9


def _inner(records: Sequence[Record]) -> np.ndarray:
    """Records whose input lies inside the range of all the others together, shape (R,), bool."""
    low = np.array([r.u[r.used].min() for r in records])
    high = np.array([r.u[r.used].max() for r in records])
    slack = 1e-9 * (high.max() - low.min())
    others = [np.arange(low.size) != k for k in range(low.size)] if low.size > 1 else []
    inside = [low[k] >= low[o].min() - slack and high[k] <= high[o].max() + slack for k, o in enumerate(others)]
    return np.array(inside or [False])


def _folds(records: Sequence[Record], inner: np.ndarray) -> list[list[np.ndarray]]:
    """Inner records dealt out to at most five folds, the others in one more: for every record one mask a fold."""
    count = min(int(inner.sum()), _BLOCKS)
    fold = np.where(inner, (np.cumsum(inner) - 1) % count, count)
    return [[r.used & (own == k) for k in range(count + 1)] for r, own in zip(records, fold, strict=True)]


def _rows(A: np.ndarray, index: np.ndarray, y: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Rows (A, y), one a state that the samples visit, and a last one: their sums of squares are those of the samples."""
    states, place = np.unique(index, return_inverse=True)
    mass = np.bincount(place, weight)
    mean = np.bincount(place, weight * y) / mass
    spread = np.zeros((1, A.shape[1] + 1))
    spread[0, -1] = np.sqrt(max(float(weight @ (y - mean[place]) ** 2), 0.0))
    return np.concatenate([np.column_stack([A[states], mean]) * np.sqrt(mass)[:, None], spread])


def _multiplicity(model: Preisach) -> np.ndarray:
    return np.bincount(_tied_to(model), minlength=model.w.size).astype(float)


def _tied_to(model: Preisach) -> np.ndarray:
    return mirror(model.n)[0] if model.symmetric else np.arange(model.w.size)


def _roughness(model: Preisach, offsets: int) -> np.ndarray:
    sizes = [model.w.size, model.slopes.size, model.b.size + offsets]
    out = np.zeros((sum(sizes), sum(sizes)))
    rough = model.roughness()
    for at, name in ((0, "w"), (sizes[0], "slopes")):
        count = sizes[0] if name == "w" else sizes[1]
        D = scipy.sparse.csr_array(rough.get(name, np.zeros((0, count))))
        out[at : at + count, at : at + count] = (D.T @ D).toarray() + _RIDGE * np.eye(count)
    return out


@dataclasses.dataclass(frozen=True)
class SmoothFit:
    """Solution of a `PreisachSystem`.

    Attributes:
        weights: all p parameters, in output units; held ones as given.
        smoothness: strength of the penalty, relative to the number of samples.
        left_out: root mean square error on blocks left out, in parts of the output's range, for each strength tried.
        rss: sum of squared residuals, output units.
        penalty: what the penalty adds to the normal matrix, diagonal, in units of outputs / parameters, shape (p,).
    """

    weights: np.ndarray
    smoothness: float
    left_out: np.ndarray
    rss: float
    penalty: np.ndarray


def fit_smooth(
    system: PreisachSystem,
    strengths: Sequence[float] = SMOOTHNESS,
    *,
    held: np.ndarray | None = None,
) -> SmoothFit:
    """Solve for the weights, with the smoothness whose error on blocks left out in turn is smallest.

    Args:
        system: the equations.
        strengths: of the penalty to choose among; one value is taken as it is.
        held: values of parameters that are not fitted, NaN for the others, output units, shape (p,).
    """
    p = system.roughness.shape[0]
    held = np.full(p, np.nan) if held is None else held
    grams, free = _reduced(system, held)
    total, n = grams.sum(axis=0), system.counts.sum()
    rough, bounded = system.roughness[np.ix_(free, free)], system.bounded[free]
    trial = bounded if free.size <= _MANY else np.zeros_like(bounded)
    left_out = []
    starts: list[np.ndarray | None] = [None] * len(grams)
    judged = np.flatnonzero(system.judged)[: 2 if free.size > _MANY else None]
    for strength in strengths if len(strengths) > 1 else ():
        error = 0.0
        for k in judged:
            gram, count = grams[k], system.counts[k]
            near = starts[k] if starts[k] is not None else starts[judged[0]]
            v, starts[k] = _solve(total - gram, strength * (n - count) * rough, trial, near)
            r = np.append(-v, 1.0)
            error += max(float(r @ gram @ r), 0.0)
        left_out.append(np.sqrt(error / system.counts[judged].sum()))
        # Stiffer still only bends more: once the error has tripled, the choice is made.
        if left_out[-1] > 3 * min(left_out):
            break
    best = strengths[int(np.argmin(left_out))] if left_out else strengths[0]
    v, _ = _solve(total, best * n * rough, bounded, starts[judged[0]] if free.size <= _MANY else None)
    r = np.append(-v, 1.0)
    rss = max(float(r @ total @ r), 0.0) * system.size**2
    weights = held.copy()
    weights[free] = v * system.size
    return SmoothFit(weights, best, np.array(left_out), rss, best * n * np.diag(system.roughness))


def _reduced(system: PreisachSystem, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices without the held parameters, whose part moves to the side of the output, and the free ones' positions."""
    free, fixed = np.flatnonzero(np.isnan(held)), np.flatnonzero(~np.isnan(held))
    if not fixed.size:
        return system.grams, free
    T = np.zeros((held.size + 1, free.size + 1))
    T[free, np.arange(free.size)] = 1.0
    T[fixed, -1] = -held[fixed] / system.size
    T[-1, -1] = 1.0
    return np.stack([T.T @ gram @ T for gram in system.grams]), free


def _solve(
    gram: np.ndarray, penalty: np.ndarray, bounded: np.ndarray, start: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    A = gram[:-1, :-1] + penalty
    A[np.diag_indices(len(A))] += 1e-12 * np.trace(A) / len(A)
    return solve_nonnegative(A, gram[:-1, -1], bounded, start)


# -- two ways in -----------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class PreisachFit:
    """A fitted Preisach model and what the data say about it.

    Attributes:
        model: as seen by the first record.
        offsets: of every record, shape (R,).
        train: error on the samples that counted.
        smoothness: strength that blocks left out chose.
        left_out_percent: error on those blocks, percent of the output's range; None where one strength was given.
        reach: part of each weight's cells that the data switched, shape (weights,).
        notes: one sentence each.
    """

    model: Preisach
    offsets: np.ndarray
    train: Metrics
    smoothness: float
    left_out_percent: float | None
    reach: np.ndarray
    notes: tuple[str, ...]

    @property
    def untouched(self) -> np.ndarray:
        """Weights whose cell the data never switched: they follow from smoothness alone, shape (weights,), bool."""
        return self.reach < 1e-9

    def predict(self, u: np.ndarray) -> np.ndarray:
        """Output of the fitted model on an input, shape (T,)."""
        return np.asarray(respond(self.model, compile_for(self.model, u)))


def fit_preisach(
    data: Record | Dataset | Sequence[Record],
    model: Preisach | int = 24,
    *,
    smoothness: Sequence[float] = SMOOTHNESS,
    left_out: LeftOut = "auto",
    nonnegative: bool = True,
    offsets: Offsets = "shared",
    **structure: Any,
) -> PreisachFit:
    """Fit the weights of a Preisach model to arbitrary loops.

    Args:
        data: records.
        model: a model (its levels are chosen anew unless its spacing is "given"), or the number of cells along an axis of a new one.
        smoothness: strengths of the penalty on second differences, to choose among.
        left_out: what chooses the smoothness, see `PreisachSystem.of`.
        nonnegative: bound the masses from below.
        offsets: each record its own constant, one for all, or none.
        **structure: of a new model, as in `Preisach.of` (symmetric, reversible, initial, ...).

    Returns:
        The model and what the data touched.

    Raises:
        HystfitError: data or settings that cannot be used.
    """
    records = list(Dataset.of(data))
    model = Preisach.of(model, **structure) if isinstance(model, int) else model
    model = model.start(records)
    system = PreisachSystem.of(model, records, left_out=left_out, nonnegative=nonnegative, offsets=offsets)
    fit = fit_smooth(system, smoothness)
    return _conclude(model, records, system, fit)


def _conclude(model: Preisach, records: list[Record], system: PreisachSystem, fit: SmoothFit) -> PreisachFit:
    split = np.cumsum([model.w.size, model.slopes.size, model.b.size])
    w, slopes, b, own = np.split(fit.weights, split)
    own = np.resize(own, len(records)) if own.size else np.zeros(len(records))
    models = [with_weights(model, w, slopes, b, offset) for offset in own]
    fitted = [np.asarray(respond(m, compile_for(m, r.u))) for m, r in zip(models, records, strict=True)]
    train = Metrics.of([r.y[r.used] for r in records], [y[r.used] for y, r in zip(fitted, records, strict=True)])
    error = float(100 * fit.left_out.min()) if fit.left_out.size else None
    notes = reach_notes(model, system.reach)
    return PreisachFit(models[0], own, train, fit.smoothness, error, system.reach, notes)


def with_weights(model: Preisach, w: np.ndarray, slopes: np.ndarray, b: np.ndarray, offset: float) -> Preisach:
    """The model with other weights."""
    import jax.numpy as jnp

    arrays = tuple(jnp.asarray(value, dtype=model.levels.dtype) for value in (w, slopes, b, offset))
    return eqx.tree_at(lambda m: (m.w, m.slopes, m.b, m.offset), model, arrays)


def reach_notes(model: Preisach, reach: np.ndarray) -> tuple[str, ...]:
    """What to say of cells that the data never switched."""
    tied = _tied_to(model)
    missing = int((reach[tied] < 1e-9).sum())
    if not missing:
        return ()
    return (
        f"{missing} of {tied.size} {model.elements} were never switched by the data ({missing / tied.size:.0%}): their weights "
        "follow from smoothness alone, and a prediction that reaches them is extrapolation",
    )


class PreisachWeights(AbstractEstimator):
    """Weights of a `Preisach` model, levels given: smooth, >= 0 as the parameters' bounds say, solved on distinct states.

    Attributes:
        smoothness: strengths of the penalty among which blocks left out choose.
        left_out: what chooses it, see `PreisachSystem.of`.
    """

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
        system = PreisachSystem.of(model, records, left_out=self.left_out)
        place = _positions(problem, len(records))
        fixed = [np.asarray(getattr(model, name), float).reshape(-1) for name in _TERMS]
        held = np.concatenate([*fixed, np.full(len(records), float(model.offset))])
        held[place[place >= 0]] = np.nan
        fit = fit_smooth(system, self.smoothness, held=held)
        size = problem.scales.y
        x, penalty = fit.weights[place], fit.penalty[place] / size**2
        cost = 0.5 * fit.rss / size**2
        notes = list(reach_notes(model, system.reach))
        if fit.left_out.size:
            notes.insert(
                0,
                f"smoothness {fit.smoothness:.0e} chosen on {int(system.judged.sum())} blocks left out "
                f"(error there {fit.left_out.min():.2%} of the range)",
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
