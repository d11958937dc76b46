"""Convergence of chains: rank-normalized split R-hat, bulk and tail effective sample sizes (Vehtari et al. 2021, Bayesian Analysis 16)."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri
from scipy.stats import rankdata

from hystfit.inference.blocks import parts
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn

GOOD_RHAT = 1.01
GOOD_ESS = 400
_MARGIN = 1.1  # effective sizes of longer chains scatter about those that shorter ones let expect
_APART = 1.1  # R-hat above which chains are not merely short


def split(draws: Float[np.ndarray, "*N m n"]) -> Float[np.ndarray, "*N m2 n2"]:
    """Chains cut in halves: (..., chains, draws) to (..., 2 chains, draws // 2)."""
    half = draws.shape[-1] // 2
    return np.concatenate([draws[..., :half], draws[..., -half:]], axis=-2)


def normal_scores(draws: Float[np.ndarray, "*N m n"]) -> Float[np.ndarray, "*N m n"]:
    """Ranks over all chains as normal scores."""
    flat = draws.reshape(*draws.shape[:-2], -1)
    ranks = rankdata(flat, method="average", axis=-1).reshape(draws.shape)
    return ndtri((ranks - 0.375) / (flat.shape[-1] + 0.25))


def _plain_rhat(draws: Float[np.ndarray, "*N m n"]) -> Float[np.ndarray, "*N"]:
    n = draws.shape[-1]
    within = np.mean(np.var(draws, axis=-1, ddof=1), axis=-1)
    between = np.var(draws.mean(axis=-1), axis=-1, ddof=1)
    ratio = np.divide(between, within, out=np.full(within.shape, np.inf), where=within > 0)
    return np.sqrt((n - 1) / n + ratio)


def rhat(draws: Float[np.ndarray, "*N m n"]) -> Float[np.ndarray, "*N"]:
    """R-hat of draws of shape (..., chains, draws): the worse of location and spread; infinite where a chain does not move."""
    finite = np.isfinite(draws).all(axis=(-2, -1))
    if draws.shape[-1] < 4 or not finite.any():
        return np.full(finite.shape, np.inf)
    halves = split(np.where(finite[..., None, None], draws, 0.0))
    folded = np.abs(halves - np.median(halves, axis=(-2, -1), keepdims=True))
    return np.where(finite, np.maximum(_plain_rhat(normal_scores(halves)), _plain_rhat(normal_scores(folded))), np.inf)


def effective_size(draws: Float[np.ndarray, "*N m n"]) -> Float[np.ndarray, "*N"]:
    """Effective number of independent draws among (..., chains, draws), Geyer's initial monotone sequence; NaN where none moves."""
    m, n = draws.shape[-2:]
    moves = np.ptp(draws, axis=(-2, -1)) > 0
    if n < 4 or not moves.any():
        return np.full(moves.shape, np.nan)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(draws - draws.mean(axis=-1, keepdims=True), size)
    covariance = np.fft.irfft(spectrum * np.conj(spectrum), size)[..., :n] / n
    within = covariance[..., 0].mean(axis=-1) * n / (n - 1)
    total = within * (n - 1) / n + (np.var(draws.mean(axis=-1), axis=-1, ddof=1) if m > 1 else 0.0)
    total = np.where(moves, total, 1.0)
    rho = 1 - (within[..., None] - covariance.mean(axis=-2)) / total[..., None]
    rho[..., 0] = 1.0
    pairs = rho[..., : 2 * (n // 2)].reshape(*moves.shape, -1, 2).sum(axis=-1)
    falling = np.minimum.accumulate(pairs, axis=-1)
    last = np.minimum(np.sum(falling >= 0, axis=-1), (n - 3) // 2)  # pairs before the first negative one
    summed = np.sum(np.where(np.arange(pairs.shape[-1]) < last[..., None], falling, 0.0), axis=-1)
    after = np.take_along_axis(rho, 2 * last[..., None], axis=-1)[..., 0]
    tau = -1 + 2 * summed + np.maximum(after, 0.0)
    return np.where(moves, m * n / np.maximum(tau, 1 / np.log10(m * n)), np.nan)


def bulk_ess(draws: Float[np.ndarray, "*N m n"]) -> Float[np.ndarray, "*N"]:
    """Effective size for the middle of the distribution."""
    return effective_size(normal_scores(split(draws)))


def tail_ess(draws: Float[np.ndarray, "*N m n"]) -> Float[np.ndarray, "*N"]:
    """Effective size for the 5 and 95 % quantiles, the smaller of the two."""
    halves = split(draws)
    edges = np.quantile(halves, [0.05, 0.95], axis=(-2, -1), keepdims=True)
    return np.minimum(*(effective_size((halves <= edge).astype(float)) for edge in edges))


@dataclasses.dataclass(frozen=True)
class Convergence:
    """Diagnostics of a set of chains by parameter, each of shape (d,)."""

    rhat: np.ndarray
    bulk: np.ndarray
    tail: np.ndarray

    @classmethod
    def of(cls, draws: np.ndarray) -> Convergence:
        """Of draws of shape (chains, draws, d)."""
        columns = np.ascontiguousarray(np.moveaxis(draws, -1, 0))
        blocks = [columns[part] for part in parts(len(columns), columns[0].size)] if len(columns) else [columns]
        return cls(*(np.concatenate([f(block) for block in blocks]) for f in (rhat, bulk_ess, tail_ess)))

    @property
    def apart(self) -> bool:
        """Whether chains are so far apart that more draws are no remedy."""
        return not bool(np.all(self.rhat <= _APART))

    @property
    def good(self) -> bool:
        """Whether the draws of all parameters may be used."""
        sizes = np.minimum(np.nan_to_num(self.bulk), np.nan_to_num(self.tail))
        return bool(np.all(self.rhat <= GOOD_RHAT) and np.all(sizes >= GOOD_ESS))

    @property
    def more(self) -> float:
        """By how much longer chains like these have enough effective draws, with a margin: 1.25 to 2."""
        return float(np.clip(_MARGIN * GOOD_ESS / np.nanmin([self.bulk, self.tail]), 1.25, 2.0))

    def problems(self, names: tuple[str, ...]) -> list[Note]:
        """What is wrong with the chains; nothing where they may be used."""
        notes = []
        worst = int(np.argmax(np.where(np.isfinite(self.rhat), self.rhat, np.inf)))
        if not self.rhat[worst] <= GOOD_RHAT:
            advice = "draw more"
            if self.rhat[worst] > _APART:
                advice = (
                    "more draws alone will not help; use a model that describes the data, fix the parameters that the data do not "
                    "determine or give them a prior, or look for several modes with sampler='nested'"
                )
            text = f"the chains have not mixed: R-hat of {names[worst]} is {self.rhat[worst]:.3f} (should be below {GOOD_RHAT}): {advice}"
            notes.append(warn(Code.CHAINS, text))
        both = np.fmin(np.nan_to_num(self.bulk), np.nan_to_num(self.tail))
        least = int(np.argmin(both))
        if both[least] < GOOD_ESS:
            times = GOOD_ESS / max(both[least], 1)
            more = f": draw about {times:.1f} times as many" if times < 20 else ""  # beyond, more draws are no remedy
            text = f"too few effective draws: {both[least]:.0f} for {names[least]} ({GOOD_ESS} are needed){more}"
            notes.append(warn(Code.CHAINS, text))
        return notes
