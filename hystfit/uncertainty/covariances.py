"""Other answers to "how large is the error": sandwich and block bootstrap beside the plain covariance."""

from __future__ import annotations

import dataclasses
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.config import require_x64
from hystfit.errors import ParameterError
from hystfit.fitting.covariance import near_bound
from hystfit.fitting.generalized import linearize
from hystfit.metrics import autocorrelation_time
from hystfit.problem import Objective
from hystfit.results import FitResult
from hystfit.sampling.posterior import problem_of


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


@eqx.filter_jit
def _linear(objective: Objective, x: Array) -> tuple[Array, Array]:
    return linearize(objective, x)


def covariance(
    result: FitResult,
    kind: Literal["iid", "sandwich", "bootstrap"] = "sandwich",
    *,
    block: int | None = None,
    draws: int = 1000,
    seed: int = 0,
) -> Covariance:
    """Covariance of a least-squares fit from its linearised scores J_t r_t.

    "sandwich" sums their autocovariances under a Bartlett window (Newey and West 1987); "bootstrap" redraws blocks of them (Kuensch
    1989). Both need many blocks to be right, and neither sees an error that repeats every loop.

    Args:
        result: a least-squares fit.
        kind: which.
        block: samples; by default one cycle of the input, or five correlation times where those are longer.
        draws: of the bootstrap.
        seed: of the bootstrap.

    Raises:
        ParameterError: an unknown kind, or a block that leaves fewer than four of them.
    """
    require_x64()
    if kind not in ("iid", "sandwich", "bootstrap"):
        raise ParameterError(f"kind must be iid, sandwich or bootstrap, got {kind!r}")
    problem, x = problem_of(result)
    used = np.asarray(problem.objective.batch.weight) > 0
    r, J = (np.asarray(v) for v in _linear(problem.objective, jnp.asarray(x)))
    live = np.array([side is None for side in near_bound(problem, x)])
    rows = [(row[on], slope[on][:, live]) for row, slope, on in zip(r, J, used, strict=True) if on.any()]
    total = sum(len(row) for row, _ in rows)
    span = block or _block(problem.data, rows)
    if kind != "iid" and total < 4 * span:
        raise ParameterError(
            f"{total} samples hold fewer than four blocks of {span}: measure longer, or choose a smaller block"
        )
    size = np.sqrt(sum(np.sum(slope**2, axis=0) for _, slope in rows))
    size[size == 0] = 1.0
    inverse = np.linalg.pinv(sum((slope / size).T @ (slope / size) for _, slope in rows), rcond=1e-12)
    squares = sum(float(np.sum(row**2)) for row, _ in rows) / max(total - int(live.sum()), 1)
    plain = inverse * squares
    scores = [(slope / size) * row[:, None] for row, slope in rows]
    if kind == "sandwich":
        own = inverse @ sum(_bartlett(score, span) for score in scores) @ inverse
    elif kind == "bootstrap":
        own = _bootstrap(scores, inverse, span, draws, seed)
    else:
        own = plain
    matrix = np.full((x.size, x.size), np.nan)
    matrix[np.ix_(live, live)] = own / size[:, None] / size
    ratio = np.full(x.size, np.nan)
    ratio[live] = np.sqrt(np.diag(own) / np.diag(plain))
    return Covariance(problem.space.names, matrix, kind, span, ratio)


def _block(data: object, rows: list[tuple[np.ndarray, np.ndarray]]) -> int:
    cycles = []
    for record in data:  # type: ignore[attr-defined]
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
