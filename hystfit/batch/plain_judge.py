"""Judgment of many solved loops at once: those whose fit is beyond doubt.

A loop is plain where its residuals are no larger than the noise of its output, and where its errors are those of a regular least-squares
problem: no bound, no undetermined direction, no outlier near. The verdict of `hystfit.fit` on such a loop is `Status.OK`. Its standard
errors are those of independent noise where its residuals are white, else those of slow noise. Every other loop is judged alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.batch.alike import Common, Group, Loops
from hystfit.batch.row_accuracy import MARGIN, accuracy
from hystfit.data.batch import Batch
from hystfit.data.dataset import Dataset
from hystfit.fitting.judgment.assessment import notes_of_model, notes_on_time
from hystfit.fitting.solvers.lanes import Ends, Stack, room
from hystfit.inference.noise.even_noise import BESIDE
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.slow_likelihood import Contrasts, Samples, fit_slow_noises, least_squares_root
from hystfit.inference.objective import flat
from hystfit.inference.residuals import ResidualAnalysis, curves
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note, Severity
from hystfit.params.coordinates import BOTH
from hystfit.params.host_arrays import NUMBERS, compiled
from hystfit.params.relative_size import OPEN, relative_size
from hystfit.quality.baselines import VISIBLE
from hystfit.quality.coverage import coverage_notes
from hystfit.quality.loops import largest_step


def slow_information(
    loops: Loops, stack: Stack, z: Float[np.ndarray, "N p"]
) -> tuple[Float[np.ndarray, "N p p"], np.ndarray]:
    """Information about the parameters at z, under slow and independent noise; and of which loops: not where error recurs every loop."""
    residual, jacobian = _linearized(stack, z)
    return loops.each(_of_group, residual, jacobian)


def _of_group(
    group: Group, residual: Float[np.ndarray, "N T"], jacobian: Float[np.ndarray, "N T p"]
) -> tuple[np.ndarray, np.ndarray]:
    """The matrices of loops over one input, and which are known."""
    samples, p = Samples.of(Setting.on_host(Batch.of(Dataset.of(group.record)))), jacobian.shape[2]
    on = np.flatnonzero(samples.on[0])
    information, known = np.full((len(residual), p, p), np.nan), np.zeros(len(residual), bool)
    size = max(1, BESIDE // ((p + 1) * on.size))
    shapes = curves(samples)
    for begin in range(0, len(residual), size):
        at = slice(begin, begin + size)
        information[at], known[at] = _informations(samples, shapes, residual[at][:, on], jacobian[at][:, on])
    return information, known


def _informations(
    samples: Samples,
    shapes: Float[np.ndarray, "n k"],
    residual: Float[np.ndarray, "N n"],
    jacobian: Float[np.ndarray, "N n p"],
) -> tuple[Float[np.ndarray, "N p p"], np.ndarray]:
    """The matrices of loops on the same samples, and which are known."""
    jacobian = flat(jacobian)
    size = np.linalg.norm(jacobian, axis=1, keepdims=True)
    sound = np.isfinite(size).all(axis=(1, 2)) & (size > 0).all(axis=(1, 2))
    columns = jacobian / np.where(sound[:, None, None], size, 1.0)
    information = np.full((len(residual), columns.shape[2], columns.shape[2]), np.nan)
    fits = np.flatnonzero(sound)
    if not fits.size:
        return information, sound
    basis = np.linalg.qr(columns[fits])[0]
    noises = fit_slow_noises(Contrasts(samples, residual[fits], basis, np.zeros((residual.shape[1], 0))))
    for k, noise in zip(fits, noises, strict=True):
        analysis = ResidualAnalysis(
            samples.on, residual[k], lambda: samples, lambda k=k: columns[k], fitted=noise, shapes=shapes
        )
        sound[k] = analysis.of_errors is not None and not (analysis.repeating is not None and analysis.repeating.shown)
        if sound[k]:
            root = least_squares_root(noise, jacobian[k])
            information[k] = root.T @ root
    return information, sound


def _linearized(
    stack: Stack, z: Float[np.ndarray, "N p"]
) -> tuple[Float[np.ndarray, "N T"], Float[np.ndarray, "N T p"]]:
    """Residuals and their derivatives with respect to the physical parameters."""
    width = stack.samples * (z.shape[1] + 1)
    size, pieces = min(room(len(z)), 1 << (max(NUMBERS // width, 1).bit_length() - 1)), []
    for begin in range(0, len(z), size):
        at = np.minimum(np.arange(begin, begin + size), len(z) - 1)
        part = stack.take(at)
        rows = _linearize_rows(part, z[at])
        pieces.append([np.asarray(values)[: len(z) - begin] for values in rows])
    residual, jacobian = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return residual, jacobian


@compiled
def _linearize_rows(stack: Stack, z: Array) -> tuple[Array, Array]:
    def one(k: Array) -> tuple[Array, Array]:
        single = stack.at(k)
        residual, jacobian = single.linearize(single.coordinates.physical(z[k]))
        return residual[0], jacobian[0]

    return jax.lax.map(one, jnp.arange(len(z)))


_REACH, _FAR = 2.05, 8.0  # standard errors to the next bound; of a linear parameter
_AT_BOUND = 2e-4  # relative distance to a bound
_SINGULAR = 1e-15  # least eigenvalue of information with a diagonal of ones, below which it is that of rounding errors


class Judged(NamedTuple):
    """Results of N loops; those of loops that are not plain mean nothing."""

    plain: np.ndarray  # which loops are beyond doubt
    slow: np.ndarray  # of these, those with autocorrelated residuals
    # which are described as well as a usable fit is, without a parameter at its bound: another start would not end lower
    close: np.ndarray
    x: Float[np.ndarray, "N p"]  # x, stderr: estimates and standard errors, shape (N, p)
    stderr: Float[np.ndarray, "N p"]
    # rmse, percent, largest_percent: rms error [y]; and in percent of the range, beside the largest error
    rmse: Float[np.ndarray, " N"]
    percent: Float[np.ndarray, " N"]
    largest_percent: Float[np.ndarray, " N"]


def judge_plain(common: Common, loops: Loops, ends: Ends, stack: Stack, noise: Float[np.ndarray, " N"]) -> Judged:
    """Results of solved loops with sound outputs."""
    z, coordinates = ends.normal.z, stack.objective.coordinates
    x = coordinates.physical(z, np)
    described, white, close, *sizes = accuracy(loops, stack, z, noise)
    samples = loops.each(lambda group: np.full(len(group.y), np.count_nonzero(group.record.used)))
    scale, slope = np.asarray(coordinates.scale), coordinates.slope(z, np)
    with np.errstate(all="ignore"):
        gram = ends.normal.matrix / slope[:, :, None] / slope[:, None, :]
        variance = 2 * ends.normal.cost / np.maximum(samples - x.shape[1], 1)
        stderr, inside, regular = _errors(common, x, scale, gram, variance)
        good = ends.converged & described & regular
        slow = good & ~white & (sizes[1] < MARGIN * VISIBLE)  # the device may change where the error is larger
        if (at := np.flatnonzero(slow)).size:
            information, slow[at] = slow_information(loops.take(at), stack.take(at), z[at])
            stderr[at], _, regular = _errors(common, x[at], scale[at], information, np.ones(at.size))
            slow[at] &= regular
    return Judged(good & white | slow, slow, ends.converged & inside & close, x, stderr, *sizes)


def _errors(
    common: Common,
    x: Float[np.ndarray, "N p"],
    scale: Float[np.ndarray, "N p"],
    gram: Float[np.ndarray, "N p p"],
    variance: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N p"], np.ndarray, np.ndarray]:
    """Standard errors; which loops are inside their bounds, and which problems are regular, shape (N,), bool.

    The information about x is `gram` over `variance`; `scale` is that of the parameters.
    """
    space = common.setup.problem.space
    size, eye = np.sqrt(np.einsum("npp->np", gram)), np.eye(x.shape[1])
    sound = np.isfinite(gram).all(axis=(1, 2)) & (size > 0).all(axis=1)
    size = np.where(sound[:, None], size, 1.0)
    scaled = np.where(sound[:, None, None], gram / size[:, :, None] / size[:, None, :], eye)
    sound &= np.linalg.eigvalsh(scaled)[:, 0] > _SINGULAR
    gram, scaled = (np.where(sound[:, None, None], matrices, eye) for matrices in (gram, scaled))
    inverse = np.linalg.inv(scaled) / size[:, :, None] / size[:, None, :]
    stderr = np.sqrt(variance[:, None] * np.einsum("npp->np", inverse))
    others = ~space.offsets
    centered = gram[:, others][:, :, others]
    if space.offsets.any():
        across = gram[:, space.offsets][:, :, others]
        centered = centered - across.swapaxes(1, 2) @ np.linalg.solve(
            gram[:, space.offsets][:, :, space.offsets], across
        )
    length = np.sqrt(np.maximum(np.einsum("npp->np", centered), 1e-300))
    unit = centered / length[:, :, None] / length[:, None, :]
    values = np.linalg.eigvalsh(np.where(np.isfinite(unit), unit, 0.0))
    regular = sound & (values[:, 0] > 1e-10 * values[:, -1])  # less is rounding
    relative = relative_size(space, x, scale)
    part = np.linalg.inv(np.where(regular[:, None, None], centered, np.eye(int(others.sum()))))
    part = variance[:, None, None] * part / relative[:, others][:, :, None] / relative[:, others][:, None, :]
    regular &= np.linalg.eigvalsh(np.where(np.isfinite(part), part, 1e9))[:, -1] < (MARGIN * OPEN) ** 2
    regular &= (stderr[:, space.offsets] < MARGIN * OPEN * relative[:, space.offsets]).all(axis=1)
    room = np.minimum(x - space.lower, space.upper - x)
    width = np.where(space.kinds == BOTH, space.upper - space.lower, scale)
    inside = np.all(room > _AT_BOUND * width, axis=1)
    regular &= inside
    regular &= (room > np.where(space.linear, _FAR, _REACH) * stderr).all(axis=1)
    return stderr, inside, regular


@dataclasses.dataclass(frozen=True)
class RowNotes:
    """Notes on N loops besides their accuracy: most loops share their codes, and a text is made when it is asked for."""

    sets: tuple[tuple[str, ...], ...]  # the different sets of codes, each with that of the accuracy
    of: np.ndarray  # which of them each loop has, shape (N,); -1 for loops that are not plain
    make: Callable[[int], Sequence[Note]]  # the notes on a plain loop, by its number

    def codes(self, k: int) -> tuple[str, ...]:
        """The codes of the notes on a plain loop."""
        return self.sets[self.of[k]]

    def reason(self, k: int) -> str:
        """The warnings and errors among them."""
        return "; ".join(note.text for note in self.make(k) if note.severity is not Severity.INFO)

    def examples(self) -> list[int]:
        """The first loop of each set."""
        plain = np.flatnonzero(self.of >= 0)
        return np.sort(plain[np.unique(self.of[plain], return_index=True)[1]]).tolist()

    def among(self, at: np.ndarray, count: int) -> RowNotes:
        """Those of the loops `at`, whose numbers rise, among `count`."""
        of = np.full(count, -1)
        of[at] = self.of
        return RowNotes(self.sets, of, lambda k: self.make(int(np.searchsorted(at, k))))


def row_notes(common: Common, loops: Loops, judged: Judged, on_errors: Sequence[Sequence[Note]]) -> RowNotes:
    """Notes on each plain loop, in the order of a fit that is judged alone."""
    model, space = common.setup.problem.model, common.setup.problem.space
    chosen = [Note(Code.CHOICE, "")] if common.of_weights else []  # as every estimate of weights has one
    datasets = [Dataset.of(group.record) for group in loops.groups]
    of_range = [() if model.from_saturation else coverage_notes(data) for data in datasets]
    first = [
        (*notes, *common.setup.notes, *chosen, *notes_on_time(data))
        for data, notes in zip(datasets, of_range, strict=True)
    ]
    last = [[note for note in group.record.notes if note.code is Code.UNITS] for group in loops.groups]
    group_of = np.repeat(np.arange(len(loops.groups)), [len(group.y) for group in loops.groups])
    advised = _advised(common, loops, judged)

    def make(k: int) -> tuple[Note, ...]:
        group = group_of[k]
        fitted = space.coordinates.assemble_rows(judged.x[k : k + 1]) if advised[k] else ()
        advice = [note for one in fitted for note in notes_of_model(datasets[group], one)]
        slow = [Note(Code.ERROR_RATIO, "residuals are autocorrelated")] if judged.slow[k] else []
        return (*first[group], *advice, *on_errors[k], *slow, *last[group])

    kinds: dict[tuple[Code, ...], int] = {}
    kind = np.array([kinds.setdefault(tuple(note.code for note in lines), len(kinds)) for lines in on_errors])
    plain, of, sets = np.flatnonzero(judged.plain), np.full(len(loops), -1), dict[tuple[str, ...], int]()
    traits = np.stack([group_of, advised, judged.slow, kind], axis=1)[plain]
    _, examples, which = np.unique(traits, axis=0, return_index=True, return_inverse=True)
    codes = lambda k: tuple(dict.fromkeys([str(Code.ACCURACY), *(str(note.code) for note in make(k))]))
    own = [sets.setdefault(codes(k), len(sets)) for k in plain[examples].tolist()]
    of[plain] = np.array(own, int)[which.reshape(-1)]
    return RowNotes(tuple(sets), of, make)


def _advised(common: Common, loops: Loops, judged: Judged) -> np.ndarray:
    """On which plain loops the fitted model has advice, shape (N,), bool."""
    model, coordinates = common.setup.problem.model, common.setup.problem.space.coordinates
    if type(model).advice is AbstractHysteresis.advice:
        return np.zeros(len(loops), bool)

    largest = loops.each(lambda group: np.full(len(group.y), largest_step(group.record.u)))
    ratio = coordinates.assemble_stacked(judged.x).step_ratio(largest)
    if ratio is not None:
        return judged.plain & (ratio > 1)

    def of_group(group: Group, x: np.ndarray, plain: np.ndarray) -> np.ndarray:
        advised, data = np.zeros(len(x), bool), Dataset.of(group.record)
        advised[plain] = [bool(notes_of_model(data, one)) for one in coordinates.assemble_rows(x[plain])]
        return advised

    return loops.each(of_group, judged.x, judged.plain)
