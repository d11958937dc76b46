"""Standard errors by other rules: sandwich and block bootstrap beside the plain covariance."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from hystfit.config import require_seed, require_x64
from hystfit.data.record import Dataset
from hystfit.errors import ParameterError
from hystfit.inference.autocorrelation import autocorrelation_time
from hystfit.outcome import Code, Column, Note, Table
from hystfit.outcome.note import warn
from hystfit.results.agreement import differences
from hystfit.results.result import FitResult

SCHEMA = "hystfit.errors/1"


@dataclasses.dataclass(frozen=True)
class Covariance:
    """A covariance of a fit's free parameters.

    Attributes:
        names: of the parameters.
        matrix: physical units, shape (p, p); NaN for parameters on a bound.
        kind: "iid", "sandwich" or "bootstrap".
        block: samples a lag window or a block spans.
        ratio: standard errors over those for independent noise, shape (p,).
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    kind: str
    block: int
    ratio: np.ndarray

    def __repr__(self) -> str:
        rows = zip(self.names, self.stderr, self.ratio, strict=True)
        errors = ", ".join(f"{name} {error:.3g} ({ratio:.2g} times)" for name, error, ratio in rows)
        return f"Covariance({self.kind}, blocks of {self.block}; standard errors, and over independent ones: {errors})"

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diag(self.matrix))


@dataclasses.dataclass(frozen=True)
class StandardErrors:
    """Standard errors of a fit by every rule, side by side.

    Attributes:
        result: the fit.
        errors: of each free parameter by rule, shape (p,): "fit", as the report prints them, "iid", "sandwich", "bootstrap"; NaN
            where the data do not determine the parameter, whatever the rule.
        block: samples a lag window or a block spans; None where the records are too short for either.
        notes: what is missing and why.
    """

    result: FitResult
    errors: dict[str, np.ndarray]
    block: int | None
    notes: tuple[Note, ...]

    @property
    def ratios(self) -> dict[str, np.ndarray]:
        """Errors by rule over those for independent residuals."""
        return {rule: error / self.errors["iid"] for rule, error in self.errors.items() if rule != "iid"}

    def table(self) -> Table:
        """Errors by rule, and at the end their typical ratio to those for independent residuals."""
        heads = {"fit": "fit", "iid": "independent"}
        rules = [Column(heads.get(rule, rule), key=rule, form=".3g") for rule in self.errors]
        rows: list[list[Any]] = []
        for k, name in enumerate(self.result.free_names):
            parameter = self.result[name]
            value = f"{parameter.value:.5g} {parameter.unit}".strip()
            rows.append([name, value, *(float(error[k]) for error in self.errors.values())])
        typical = [1.0 if rule == "iid" else _typical(self.ratios[rule]) for rule in self.errors]
        rows.append(["times independent", "", *typical])
        return Table(["parameter", "value", *rules], rows)

    def __str__(self) -> str:
        lines = [f"Standard errors of {self.result.name}, by rule", *self.table().lines()]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`; unknown is null."""
        number = lambda value: float(value) if np.isfinite(value) else None
        rows = {}
        for k, name in enumerate(self.result.free_names):
            errors_of = {rule: number(error[k]) for rule, error in self.errors.items()}
            over = {rule: number(ratio[k]) for rule, ratio in self.ratios.items()}
            rows[name] = {
                "value": self.result[name].value,
                "unit": self.result[name].unit,
                "stderr": errors_of,
                "ratio": over,
            }
        return {
            "schema": SCHEMA,
            "model": self.result.name,
            "status": str(self.result.status),
            "notes": [note.to_dict() for note in self.notes],
            "block": self.block,
            "parameters": rows,
            "provenance": self.result.provenance,
        }


def _typical(ratio: np.ndarray) -> float:
    """Geometric mean of those that are known."""
    known = ratio[np.isfinite(ratio) & (ratio > 0)]
    return float(np.exp(np.mean(np.log(known)))) if known.size else float("nan")


def standard_errors(result: FitResult, *, block: int | None = None, seed: int = 0) -> StandardErrors:
    """Errors of a least-squares fit by every rule: the report's own, independent residuals, sandwich, block bootstrap.

    Args:
        result: a least-squares fit.
        block: samples, see `covariance`.
        seed: of the bootstrap.

    Raises:
        ParameterError: a fit under a noise model; its own likelihood gives its errors.
    """
    reported = [np.nan if (e := result[name].stderr) is None else e for name in result.free_names]
    fit = np.array(reported, dtype=float)
    errors, notes, span = {"fit": fit}, [], None
    errors["iid"] = np.where(np.isfinite(fit), covariance(result, "iid", block=block).stderr, np.nan)
    for kind in ("sandwich", "bootstrap"):
        try:
            other = covariance(result, kind, block=block, seed=seed)
        except ParameterError as error:
            notes.append(warn(Code.BLOCKS, f"no {kind}: {error}"))
            continue
        span = other.block
        errors[kind] = np.where(np.isfinite(fit), other.stderr, np.nan)
        text = f"the {kind} uses blocks of {span} samples; it does not include errors that repeat every loop"
        notes.append(Note(Code.BLOCKS, text))
        blocks = sum(int(record.used.sum()) for record in result.data) / span
        known = 100 / np.sqrt(2 * blocks)
        reason = f"with {blocks:.0f} blocks such an error is known to {known:.0f} % at best, and tends to be too small"
        by_name = dict(zip(result.free_names, map(float, np.nan_to_num(errors[kind])), strict=True))
        notes += differences(result, by_name, f"the {kind}", reason)
    unknown = [name for name, error in zip(result.free_names, fit, strict=True) if not np.isfinite(error)]
    if unknown:
        text = f"no rule has a standard error for parameters that the data do not determine: {', '.join(unknown)}"
        notes.append(warn(Code.NOT_DETERMINED, text))
    return StandardErrors(result, errors, span, tuple(notes))


def covariance(
    result: FitResult,
    kind: Literal["iid", "sandwich", "bootstrap"] = "sandwich",
    *,
    block: int | None = None,
    draws: int = 1000,
    seed: int = 0,
) -> Covariance:
    """Covariance of a least-squares fit from its linearized scores J_t r_t.

    "sandwich" sums their autocovariances under a Bartlett window (Newey and West 1987); "bootstrap" redraws blocks of them (Kuensch
    1989). Both are right for many blocks only, and neither includes an error that repeats every loop.

    Args:
        result: a least-squares fit.
        kind: which.
        block: samples; by default one cycle of the input, or five correlation times where those are longer.
        draws: of the bootstrap.
        seed: of the bootstrap.

    Raises:
        ParameterError: an unknown kind, a block that leaves fewer than four of them (or two of a record, to redraw), or a fit under a
            noise model.
    """
    require_x64()
    require_seed(seed)
    if result.noise.refines:
        raise ParameterError(
            f"this fit is under noise {result.noise.name!r}, whose likelihood gives its errors: fit with noise='auto'"
        )
    if kind not in ("iid", "sandwich", "bootstrap"):
        raise ParameterError(f"kind must be iid, sandwich or bootstrap, got {kind!r}")
    if block is not None and block < 1:
        raise ParameterError(f"a block holds at least one sample, got {block}")
    problem, x = result.problem.with_loss("linear"), result.x
    used, root = problem.used, np.sqrt(np.asarray(problem.objective.batch.weight))
    r, J = problem.linearize(x)
    r, J = r * root, J * root[..., None]
    live = np.array([side is None for side in problem.at_bound(x)])
    rows = [(row[on], slope[on][:, live]) for row, slope, on in zip(r, J, used, strict=True) if on.any()]
    total = sum(len(row) for row, _ in rows)
    span = _block(problem.data, rows) if block is None else block
    if kind != "iid" and total < 4 * span:
        raise ParameterError(
            f"{total} samples hold fewer than four blocks of {span}: measure longer, or choose a smaller block"
        )
    if kind == "bootstrap" and any(len(row) < 2 * span for row, _ in rows):
        raise ParameterError(
            f"a record holds fewer than two blocks of {span} samples, so there is nothing to redraw: choose a smaller block"
        )
    size = np.sqrt(sum(np.sum(slope**2, axis=0) for _, slope in rows))
    size[size == 0] = 1.0
    inverse = np.linalg.pinv(sum((slope / size).T @ (slope / size) for _, slope in rows), rcond=1e-12)
    squares = sum(float(np.sum(row**2)) for row, _ in rows) / max(total - int(live.sum()), 1)
    plain = inverse * squares
    scores = [(slope / size) * row[:, None] for row, slope in rows]
    if kind == "sandwich":
        robust = inverse @ sum(_bartlett(score, span) for score in scores) @ inverse
    elif kind == "bootstrap":
        robust = _bootstrap(scores, inverse, span, draws, seed)
    else:
        robust = plain
    matrix = np.full((x.size, x.size), np.nan)
    matrix[np.ix_(live, live)] = robust / size[:, None] / size
    ratio = np.full(x.size, np.nan)
    ratio[live] = np.sqrt(np.diag(robust) / np.diag(plain))
    return Covariance(problem.space.names, matrix, kind, span, ratio)


def _block(data: Dataset, rows: list[tuple[np.ndarray, np.ndarray]]) -> int:
    cycles = []
    for record in data:
        u = record.u[record.used]
        crossings = np.count_nonzero(np.diff(u > 0.5 * (u.max() + u.min())))
        cycles.append(2 * u.size / max(crossings, 1))
    return int(np.ceil(max(max(cycles), 5 * max(autocorrelation_time(row) for row, _ in rows))))


def _bartlett(score: np.ndarray, span: int) -> np.ndarray:
    total = score.T @ score
    for lag in range(1, min(span, len(score) - 1) + 1):
        cross = score[lag:].T @ score[:-lag]
        total = total + (1 - lag / (span + 1)) * (cross + cross.T)
    return total


def _bootstrap(scores: list[np.ndarray], inverse: np.ndarray, span: int, draws: int, seed: int) -> np.ndarray:
    """Covariance of one-step estimates over redrawn overlapping blocks of scores."""
    rng = np.random.default_rng(seed)
    shifts = np.zeros((draws, inverse.shape[0]))
    for score in scores:
        sums = np.vstack([np.zeros(score.shape[1]), np.cumsum(score, axis=0)])
        whole = sums[min(span, len(score)) :] - sums[: len(sums) - min(span, len(score))]
        count = max(round(len(score) / span), 1)
        picked = whole[rng.integers(0, len(whole), (draws, count))]
        shifts += (picked - whole.mean(axis=0)).sum(axis=1) * np.sqrt(len(score) / (count * min(span, len(score))))
    return np.cov((shifts @ inverse).T).reshape(inverse.shape)
