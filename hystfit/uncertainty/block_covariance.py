"""Covariance of a least-squares fit from blocks of consecutive samples: sandwich and wild bootstrap beside the plain one."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from typing import Literal

import numpy as np
import scipy

from hystfit.config import require_seed, verb
from hystfit.data.dataset import Dataset
from hystfit.errors import ParameterError
from hystfit.inference.autocorrelation import autocorrelation_time
from hystfit.quality.determination import count
from hystfit.results.result import FitResult

FEWEST = {"iid": 1, "sandwich": 6, "bootstrap": 8}  # blocks from which intervals have their nominal coverage
_RANK = 1e-12  # square of the smallest singular value, over that of the largest, of a direction that counts
_DRAWS = 1000  # of the bootstrap
_WEBB = np.sqrt([0.5, 1.0, 1.5]) * np.array([[-1.0], [1.0]])  # weights of the wild bootstrap


@dataclasses.dataclass(frozen=True)
class Covariance:
    """A covariance of a fit's free parameters.

    Attributes:
        names: of the parameters.
        matrix: physical units, shape (p, p); NaN for parameters on a bound, and of the sandwich and the bootstrap for those that one
            block determines alone, such as the offset of a record that is a block.
        kind: "iid", "sandwich" or "bootstrap".
        block, blocks: samples of a block, and how many there are.
        ratio: standard errors over those for independent noise, shape (p,).
        factor: half a 95 % interval over the standard error, shape (p,): more than 1.96 where blocks are few.
    """

    names: tuple[str, ...]
    matrix: np.ndarray
    kind: str
    block: int
    blocks: int
    ratio: np.ndarray
    factor: np.ndarray

    def __repr__(self) -> str:
        rows = zip(self.names, self.stderr, self.ratio, strict=True)
        errors = ", ".join(f"{name} {error:.3g} ({ratio:.2g} times)" for name, error, ratio in rows)
        return f"Covariance({self.kind}, blocks of {self.block}; standard errors, and over independent ones: {errors})"

    @property
    def stderr(self) -> np.ndarray:
        """Standard errors, shape (p,)."""
        return np.sqrt(np.diag(self.matrix))

    @property
    def half_width(self) -> np.ndarray:
        """Half a 95 % interval, shape (p,)."""
        return self.factor * self.stderr


@verb
def covariance(
    result: FitResult,
    kind: Literal["iid", "sandwich", "bootstrap"] = "sandwich",
    *,
    block: int | None = None,
    seed: int = 0,
) -> Covariance:
    """Covariance of a least-squares fit from its linearized scores J_t r_t, summed over blocks of consecutive samples.

    "sandwich" corrects the residuals of each block for its leverage and counts degrees of freedom (CR2: Bell and McCaffrey 2002);
    "bootstrap" gives the corrected scores of each block random signs and sizes and studentizes every draw (wild bootstrap: Webb 2023;
    MacKinnon, Nielsen and Webb 2023). Neither includes an error that recurs every loop. Where the parameters, with the penalty of the fit
    left aside, take up all samples, "iid" is unknown: its errors are NaN.

    Args:
        result: a least-squares fit.
        kind: which.
        block: samples; by default one cycle of the input, or five correlation times where those are longer, but at most the longest
            record.
        seed: of the bootstrap.

    Raises:
        ParameterError: an unknown kind, records with fewer blocks than `FEWEST`, or a fit under a noise model.
    """
    require_seed(seed)
    if result.noise.refines:
        raise ParameterError(
            f"this fit is under noise {result.noise.name!r}, whose likelihood gives its errors: fit with noise='auto'"
        )
    if kind not in FEWEST:
        raise ParameterError(f"kind must be {', '.join(FEWEST)}, got {kind!r}")
    if block is not None and block < 1:
        raise ParameterError(f"a block holds at least one sample, got {block}")
    problem, x = result.problem.with_loss("linear"), result.x
    r, J = problem.linearize(x)
    root = np.sqrt(np.asarray(problem.objective.batch.weight))
    r, J = r * root, J * root[..., None]
    live = ~problem.on_bound(x)
    rows = [(row[on], slope[on][:, live]) for row, slope, on in zip(r, J, problem.used, strict=True) if on.any()]
    span = _block(problem.data, rows) if block is None else block
    back = _orthonormal([slope for _, slope in rows])
    freedom = sum(len(row) for row, _ in rows) - back.shape[1]
    variance = sum(float(np.sum(row**2)) for row, _ in rows) / freedom if freedom > 0 else np.nan
    plain = back @ back.T * variance
    single = np.zeros(back.shape[0], dtype=bool)
    if kind != "iid":
        owner = np.array([-1 if record is None else record for *_, record in problem.space.sources])[live]
        of_record = [np.flatnonzero(owner == k) for k, on in enumerate(problem.used) if on.any()]
        rows, single = _partialled(rows, of_record, span, FEWEST[kind])
        back = _orthonormal([slope for _, slope in rows])
    blocks = _Blocks.of([(row, slope @ back) for row, slope in rows], span)
    if len(blocks.scores) < FEWEST[kind]:
        raise ParameterError(
            f"the records hold {count(len(blocks.scores), 'block')} of {span} samples, and the {kind} needs at least {FEWEST[kind]}: "
            "measure more cycles, or choose a smaller block"
        )
    if kind == "sandwich":
        robust, factor = blocks.sandwich(back)
    elif kind == "bootstrap":
        robust, factor = blocks.bootstrap(back, _DRAWS, seed)
    else:
        robust, factor = plain, np.full(len(plain), scipy.stats.t.ppf(0.975, max(freedom, 1)))
    if kind != "iid":
        single |= ~(blocks.degrees(back) >= 1)
    robust[single], robust[:, single], factor[single] = np.nan, np.nan, np.nan
    matrix, ratio, factors = np.full((x.size, x.size), np.nan), np.full(x.size, np.nan), np.full(x.size, np.nan)
    matrix[np.ix_(live, live)], factors[live] = robust, factor
    ratio[live] = np.sqrt(np.diag(robust) / np.diag(plain))
    return Covariance(problem.space.names, matrix, kind, span, len(blocks.scores), ratio, factors)


def _block(data: Dataset, rows: list[tuple[np.ndarray, np.ndarray]]) -> int:
    cycles = []
    for record in data:
        u = record.u[record.used]
        crossings = np.count_nonzero(np.diff(u > 0.5 * (u.max() + u.min())))
        cycles.append(2 * u.size / max(crossings, 1))
    longest = max(len(row) for row, _ in rows)
    return min(int(np.ceil(max(*cycles, 5 * max(autocorrelation_time(row) for row, _ in rows)))), longest)


def _partialled(
    rows: list[tuple[np.ndarray, np.ndarray]], of_record: list[np.ndarray], span: int, fewest: int
) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Rows without the parameters of single records that have fewer than `fewest` blocks, and which parameters these are, shape (p,).

    A block that alone determines a parameter has no residuals from which to judge its error. Without the derivatives by it, and their
    projection in those by the others, the estimates of the others and all residuals stay as they are (Frisch and Waugh 1933). Rows are
    residuals (T,) and derivatives (T, p) of each record; `of_record` are positions of the parameters of each record alone.
    """
    kept, gone = [], np.zeros(rows[0][1].shape[1], dtype=bool)
    for (residual, slope), own in zip(rows, of_record, strict=True):
        if own.size and _blocks_in(len(residual), span) < fewest:
            basis = np.linalg.qr(slope[:, own[slope[:, own].any(axis=0)]])[0]
            slope = slope - basis @ (basis.T @ slope)
            slope[:, own], gone[own] = 0.0, True
        kept.append((residual, slope))
    return kept, gone


def _blocks_in(samples: int, span: int) -> int:
    """Number of blocks of about `span` samples, at least one."""
    return max(round(samples / span), 1)


def _orthonormal(slopes: list[np.ndarray]) -> np.ndarray:
    """The matrix B for which the derivatives times B have orthonormal columns, shape (p, k); k is their rank."""
    size = np.sqrt(sum(np.sum(slope**2, axis=0) for slope in slopes))
    size[size == 0] = 1.0
    value, axes = np.linalg.eigh(sum((slope / size).T @ (slope / size) for slope in slopes))
    kept = value > _RANK * value[-1]
    return axes[:, kept] / np.sqrt(value[kept]) / size[:, None]


@dataclasses.dataclass(frozen=True)
class _Blocks:
    """Blocks g of samples of y = Q q + e with orthonormal Q: scores Q_g' e_g, (G, k), and grams Q_g' Q_g, (G, k, k)."""

    scores: np.ndarray
    grams: np.ndarray

    @classmethod
    def of(cls, rows: list[tuple[np.ndarray, np.ndarray]], span: int) -> _Blocks:
        """Blocks of about `span` samples of (residuals, Q) of each record, at least one per record."""
        scores, grams = [], []
        for residual, Q in rows:
            edges = np.linspace(0, len(Q), _blocks_in(len(Q), span) + 1).astype(int)
            for low, high in itertools.pairwise(edges):
                scores.append(Q[low:high].T @ residual[low:high])
                grams.append(Q[low:high].T @ Q[low:high])
        return cls(np.array(scores), np.array(grams))

    @functools.cached_property
    def correction(self) -> np.ndarray:
        """(1 - Q_g'Q_g)^-1/2 of each block, by which residuals are larger than a fit leaves them, shape (G, k, k)."""
        value, axes = np.linalg.eigh(np.eye(self.grams.shape[1]) - self.grams)
        scale = np.where(value > _RANK, 1 / np.sqrt(np.maximum(value, _RANK)), 0.0)
        return axes * scale[:, None] @ axes.swapaxes(1, 2)

    @functools.cached_property
    def corrected(self) -> np.ndarray:
        """Scores of the corrected residuals, shape (G, k)."""
        return np.einsum("gij,gj->gi", self.correction, self.scores)

    def degrees(self, back: np.ndarray) -> np.ndarray:
        """Degrees of freedom of the variance of each parameter `back` q, as under independent noise, shape (p,); 0 without any."""
        lifted = self.correction @ back.T
        across = self.grams @ lifted
        own, inner = np.sum(lifted * across, axis=1), np.einsum("gkp,glp->pkl", across, across)
        left = np.sum(across**2, axis=1)
        trace = np.sum(own - left, axis=0)
        square = np.sum(own**2 - 2 * own * left, axis=0) + np.sum(inner**2, axis=(1, 2))
        return np.where(square > 0, trace**2 / np.where(square > 0, square, 1.0), 0.0)

    def sandwich(self, back: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Covariance of the parameters `back` q, and the t quantile for the degrees of freedom of each."""
        moved = self.corrected @ back.T
        return moved.T @ moved, scipy.stats.t.ppf(0.975, np.maximum(self.degrees(back), 1.0))

    def bootstrap(self, back: np.ndarray, draws: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Covariance of the parameters `back` q over draws, and half a 95 % interval of the studentized draws over its root."""
        weights = np.random.default_rng(seed).choice(_WEBB.ravel(), (draws, len(self.scores)))
        shifts, factor = weights @ self.corrected, np.empty(len(back))
        robust = np.cov((shifts @ back.T).T).reshape(len(back), len(back))
        for k, row in enumerate(back):
            lifted = self.correction @ row
            across = np.einsum("gkl,gl->gk", self.grams, lifted)
            # Each draw is fitted, and the residuals of that fit corrected, as those of the data are.
            spread = np.linalg.norm(weights * np.sum(self.corrected * lifted, axis=1) - shifts @ across.T, axis=1)
            error = np.linalg.norm(self.corrected @ row)
            factor[k] = np.quantile(np.abs(shifts @ row) / np.maximum(spread, 1e-300), 0.95) * error
        size = np.sqrt(np.diag(robust))
        return robust, factor / np.where(size > 0, size, 1.0)
