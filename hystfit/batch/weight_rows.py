"""Loops over one input whose model is linear in all free parameters: weights of plays, stops, relays or cells.

All loops share the columns of one design matrix and its normal equations. The weights, the strength of their penalty, and the errors
beside bounds are found side by side, by the functions that fit a single loop.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np
from jaxtyping import Float

from hystfit.batch.alike import Common, Group, Loops
from hystfit.batch.plain_judge import Judged
from hystfit.batch.row_accuracy import MARGIN, accuracy_of
from hystfit.data.batch import Batch
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.fitting.judgment.assessment import Unknown, notes_of_errors
from hystfit.fitting.judgment.covariance import determine, ridge_shares
from hystfit.fitting.judgment.near_bounds import Information, NearBounds, centered, shared
from hystfit.fitting.solvers.convex import Convex
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridges
from hystfit.fitting.solvers.smooth_weights import SmoothWeights
from hystfit.fitting.trial import largest_left_out
from hystfit.inference.noise.even_noise import BESIDE
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.slow_likelihood import Contrasts, Samples, fit_slow_noises, least_squares_root
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import FEW, ResidualAnalysis, curves, diagnose
from hystfit.inference.weights import Split, free_columns, weighted_columns
from hystfit.models.preisach.smooth import fit_smooth
from hystfit.outcome import Code, Note
from hystfit.params.relative_size import relative_size
from hystfit.quality.baselines import VISIBLE


class Weights(NamedTuple):
    """Solved weights of N loops over one input."""

    common: Common  # what the loops have in common
    # of the weights on the n samples that count, shape (n, p), times the roots of the samples' weights
    columns: np.ndarray
    targets: np.ndarray  # what they have to explain, shape (N, n)
    x: np.ndarray  # solutions, shape (N, p)
    penalty: np.ndarray  # what a penalty adds to the normal matrix of the weights, shape (N, p, p)
    left_out: np.ndarray  # rms errors of samples left out, by which the penalties were chosen, shape (N,)
    chosen: np.ndarray  # which loops begin in the state that `common` assumes, shape (N,), bool
    estimate: Callable[[int], Estimate]  # makes the estimate of a loop from its number

    def outputs(self, record: Record) -> Float[np.ndarray, "N T"]:
        """Outputs of all models over the input of a record."""
        problem = self.common.setup.problem
        design = problem.model.design_matrix(record.u, 0 * record.u if problem.model.rate_independent else record.dt)
        columns, rest = free_columns(problem.space, design, 0, 1)
        return (self.x @ columns.T + rest)[:, design.index]


def solve_weights(common: Common, loops: Loops) -> Weights:
    """Solve for the weights of loops over one input."""
    (group,) = loops.groups
    return _SOLVERS[cast(str, common.setup.method)](common, group)


def _ridges(common: Common, group: Group) -> Weights:
    setup, estimator, sizes = common.setup, Convex(), group.sizes[:, 1]
    candidates = setup.candidates or (setup.problem,)
    systems = [LinearSystem.of(problem, problem.space.vector(problem.model)) for problem in candidates]
    targets = [_targets(p, one.target, group.y) for p, one in zip(candidates, systems, strict=True)]
    fits = [fit_ridges(*pair, estimator.strengths) for pair in zip(systems, targets, strict=True)]
    own = candidates.index(setup.problem)
    chosen = np.argmin([fit.score for fit in fits], axis=0) == own
    system, fit = systems[own], fits[own]

    def estimate(k: int) -> Estimate:
        x, groups = fit.weights[k], int(system.fold.max()) + 1
        return estimator.of_ridge(fit.of(k), x, np.arange(x.size), float(sizes[k]), groups)

    penalty = fit.ridge[..., None] * np.eye(fit.ridge.shape[1])
    return Weights(common, system.columns, targets[own], fit.weights, penalty, fit.score, chosen, estimate)


def _smooth(common: Common, group: Group) -> Weights:
    problem, estimator = common.setup.problem, SmoothWeights()
    (record,), held, x = problem.data, problem.held_out, problem.space.vector(problem.model)
    split = Split.of(problem.space, [record], x, held=held)
    design = problem.model.design_matrix(record.u, record.dt)
    systems = split.system.of_outputs(design, record, group.y, held)
    fits = [fit_smooth(system, estimator.smoothness, fixed=split.fixed) for system in systems]
    sizes = group.sizes[:, 1]
    texts = split.system.notes()
    found = [
        estimator.of_fit(fit, split, x, size, held.count, texts) for fit, size in zip(fits, sizes.tolist(), strict=True)
    ]
    columns, target = weighted_columns(problem.space, [record], x, np.arange(x.size))
    return Weights(
        common,
        columns,
        _targets(problem, target, group.y),
        np.stack([one.x for one in found]),
        np.stack([cast(np.ndarray, one.penalty) * size**2 for one, size in zip(found, sizes, strict=True)]),
        np.array([one.left_out for one in found], float),
        np.ones(len(found), bool),
        lambda k: found[k],
    )


def _targets(problem: Problem, target: np.ndarray, y: Float[np.ndarray, "N T"]) -> Float[np.ndarray, "N n"]:
    """What the columns of a problem have to explain of other outputs over its input; `target` is that of its own."""
    (record,) = problem.data
    root = np.sqrt(record.weight[record.used])
    return y[:, record.used] * root - (record.y[record.used] * root - target)


_SOLVERS = {"convex": _ridges, "preisach": _smooth}


def judge_weights(
    weights: Weights, loops: Loops, noise: Float[np.ndarray, " N"]
) -> tuple[Judged, list[tuple[Note, ...]]]:
    """Results of solved loops with sound outputs, and the notes on their errors."""
    (group,), x = loops.groups, weights.x
    described, white, _, *sizes = accuracy_of(loops, weights.outputs(group.record), noise)
    rmse, percent, _ = sizes
    with np.errstate(all="ignore"):
        tested = weights.left_out <= MARGIN * largest_left_out(100 * rmse / percent, rmse)
    tested &= (rmse > 0) & (len(weights.columns) > x.shape[1])
    wanted = np.flatnonzero(described & (white | (percent < MARGIN * VISIBLE)) & tested & weights.chosen)
    plain, stderr, scale = np.zeros(len(loops), bool), np.full(x.shape, np.nan), weights.common.scale(loops)
    notes: list[tuple[Note, ...]] = [()] * len(loops)
    if wanted.size:
        plain[wanted], stderr[wanted], found = _errors(weights, group.record, wanted, white[wanted], scale[wanted])
        for k, lines in zip(wanted.tolist(), found, strict=True):
            notes[k] = lines
    return Judged(plain, plain & ~white, weights.chosen, x, stderr, *sizes), notes


def _errors(
    weights: Weights, record: Record, at: np.ndarray, white: np.ndarray, scale: Float[np.ndarray, "m p"]
) -> tuple[np.ndarray, Float[np.ndarray, "m p"], list[tuple[Note, ...]]]:
    """Of some loops: which are beyond doubt, their standard errors, and notes on these; `white` tells which have white residuals."""
    space, columns, x, penalty = weights.common.setup.problem.space, weights.columns, weights.x[at], weights.penalty[at]
    residual, rows = x @ columns.T - weights.targets[at], np.linalg.qr(columns, mode="r")
    relative, on_bound = relative_size(space, x, scale), np.logical_or(*space.reached(x, scale=scale))
    gain = np.linalg.norm(centered(rows, space.offsets)[0], axis=0) * np.minimum(relative, scale)
    acting = gain > 1e-9 * gain.max(axis=1, keepdims=True)
    acts = np.array(Counter(map(tuple, acting.tolist())).most_common(1)[0][0])
    live = acts & ~on_bound
    plain = (acting == acts).all(axis=1) & live.any(axis=1)
    counts = zip(at.tolist(), live.sum(axis=1).tolist(), strict=True)
    freedom = np.array([weights.estimate(k).freedom(len(columns), count) for k, count in counts])
    variance = np.einsum("nk,nk->n", residual, residual) / freedom
    roots, variances, penalties = np.broadcast_to(rows, (at.size, *rows.shape)).copy(), variance.copy(), penalty.copy()  # type: ignore[attr-defined]
    slow = np.flatnonzero(~white)
    for k, analysis in zip(slow, _analyses(record, residual[slow], columns, live[slow], relative[slow]), strict=True):
        plain[k] &= all(note.code is Code.CORRELATED_RESIDUALS for note in diagnose(analysis).findings)
        if analysis.of_errors is None:
            variances[k] *= analysis.correlation_time
            continue
        root = least_squares_root(analysis.of_errors, columns[:, acts])
        roots[k], variances[k], penalties[k] = 0.0, 1.0, penalty[k] / variance[k]
        roots[k, : len(root), acts] = root.T
    slope = lambda: np.where(on_bound, residual @ columns + (penalty @ x[..., None])[..., 0], 0.0)
    near = NearBounds.of(space, x, on_bound, rows, Information(roots, variances, penalties), slope, penalty, acts)
    share, inside = np.ones(x.shape), [None] * at.size
    if near is not None:
        share = ridge_shares(near, space.names, acts) if weights.estimate(0).toward_zero else share
        inside = near.moments(share, acts)
    stderr, notes = np.full(x.shape, np.nan), list[tuple[Note, ...]]()
    for k in range(at.size):
        own = Information(roots[k], float(variances[k]), shared(penalties[k], share[k]))
        found = determine(space, x[k], relative[k], own, live[k], inside[k])
        stderr[k] = np.sqrt(np.diag(found["covariance"]))
        unknown = Unknown(~acts & ~on_bound[k], found["directions"], found["reaching"], found["rank"])
        sides = ["lower" if reached else None for reached in on_bound[k]]
        notes.append(tuple(notes_of_errors(space, sides, unknown, penalty[k])))
    return plain, stderr, notes


def _analyses(
    record: Record,
    residual: Float[np.ndarray, "m n"],
    columns: Float[np.ndarray, "n p"],
    live: np.ndarray,
    relative: Float[np.ndarray, "m p"],
) -> list[ResidualAnalysis]:
    """Analyses of autocorrelated residuals, side by side for loops with as many `live` weights, which act and are off their bounds."""
    if not len(residual):
        return []
    samples, none = Samples.of(Setting.on_host(Batch.of(Dataset.of(record)))), np.zeros((len(columns), 0))
    shapes, found, counts = curves(samples), dict[int, ResidualAnalysis](), live.sum(axis=1)
    for count in np.unique(counts).tolist():
        alike = np.flatnonzero(counts == count)
        p = count if count <= FEW else 0
        for begin in range(0, alike.size, size := max(1, BESIDE // ((p + 1) * len(columns)))):
            at = alike[begin : begin + size]
            own = [columns[:, live[k]] * relative[k, live[k]] if p else none for k in at]
            noises = fit_slow_noises(Contrasts(samples, residual[at], np.linalg.qr(np.stack(own))[0], none))
            for k, noise, J in zip(at.tolist(), noises, own, strict=True):
                derivatives = (lambda J=J: J) if p else None
                found[k] = ResidualAnalysis(samples.on, residual[k], lambda: samples, derivatives, noise, shapes)
    return [found[k] for k in range(len(residual))]
