"""Convergence of chains: rank-normalized split R-hat, bulk and tail effective sample sizes (Vehtari et al. 2021, Bayesian Analysis 16)."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn

GOOD_RHAT = 1.01
GOOD_ESS = 400
_MARGIN = 1.1  # effective sizes of longer chains scatter about those that shorter ones let expect
_APART = 1.1  # R-hat above which chains are not merely short


def split(draws: np.ndarray) -> np.ndarray:
    """Chains cut in halves: (chains, draws) to (2 chains, draws // 2)."""
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, -half:]])


def normal_scores(draws: np.ndarray) -> np.ndarray:
    """Ranks over all chains as normal scores."""
    ranks = rankdata(draws, method="average").reshape(draws.shape)
    return ndtri((ranks - 0.375) / (draws.size + 0.25))


def _plain_rhat(draws: np.ndarray) -> float:
    n = draws.shape[1]
    within = float(np.mean(np.var(draws, axis=1, ddof=1)))
    between = float(np.var(draws.mean(axis=1), ddof=1))
    return float(np.sqrt((n - 1) / n + between / within)) if within > 0 else np.inf


def rhat(draws: np.ndarray) -> float:
    """R-hat of draws of shape (chains, draws): the worse of location and spread; infinite where a chain does not move."""
    if draws.shape[1] < 4 or not np.isfinite(draws).all():
        return float("inf")
    halves = split(draws)
    folded = np.abs(halves - np.median(halves))
    return max(_plain_rhat(normal_scores(halves)), _plain_rhat(normal_scores(folded)))


def effective_size(draws: np.ndarray) -> float:
    """Effective number of independent draws among (chains, draws), Geyer's initial monotone sequence."""
    m, n = draws.shape
    if n < 4 or np.ptp(draws) == 0:
        return float("nan")
    size = 1 << (2 * n - 1).bit_length()
    centered = draws - draws.mean(axis=1, keepdims=True)
    spectrum = np.fft.rfft(centered, size, axis=1)
    covariance = np.fft.irfft(spectrum * np.conj(spectrum), size, axis=1)[:, :n] / n
    within = covariance[:, 0].mean() * n / (n - 1)
    total = within * (n - 1) / n
    if m > 1:
        total += np.var(draws.mean(axis=1), ddof=1)
    rho = 1 - (within - covariance.mean(axis=0)) / total
    rho[0] = 1.0
    pairs = rho[: 2 * (n // 2)].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs < 0)
    last = min(int(negative[0]) if negative.size else len(pairs), (n - 3) // 2)
    tau = -1 + 2 * float(np.sum(np.minimum.accumulate(pairs[:last]))) + max(float(rho[2 * last]), 0.0)
    return float(m * n / max(tau, 1 / np.log10(m * n)))


def bulk_ess(draws: np.ndarray) -> float:
    """Effective size for the middle of the distribution."""
    return effective_size(normal_scores(split(draws)))


def tail_ess(draws: np.ndarray) -> float:
    """Effective size for the 5 and 95 % quantiles, the smaller of the two."""
    halves = split(draws)
    return min(effective_size((halves <= np.quantile(draws, q)).astype(float)) for q in (0.05, 0.95))


@dataclasses.dataclass(frozen=True)
class Convergence:
    """Diagnostics of a set of chains by parameter, each of shape (d,)."""

    rhat: np.ndarray
    bulk: np.ndarray
    tail: np.ndarray

    @classmethod
    def of(cls, draws: np.ndarray) -> Convergence:
        """Of draws of shape (chains, draws, d)."""
        columns = [draws[:, :, k] for k in range(draws.shape[2])]
        return cls(*(np.array([f(column) for column in columns]) for f in (rhat, bulk_ess, tail_ess)))

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
