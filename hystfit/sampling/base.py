"""What every sampler takes and returns."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hystfit.errors import ParameterError
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.priors import AbstractPrior
from hystfit.outcome import Note
from hystfit.results.result import FitResult
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.setup import Prepared, prepare

Progress = Callable[[str, float], None]


class Evidence(NamedTuple):
    """Log evidence of model, noise and priors together (natural logarithm), its standard error, and the information gained [nats]."""

    log_z: float
    error: float
    information: float


@dataclasses.dataclass(frozen=True)
class Raw:
    """What a sampler returns."""

    z: np.ndarray  # draws in unconstrained coordinates, shape (chains, draws, d)
    log_density: np.ndarray  # log posterior there, shape (chains, draws)
    stats: dict[str, np.ndarray]  # per draw, such as "diverging" and "acceptance", shape (chains, draws)
    notes: tuple[Note, ...] = ()  # on the run
    complete: bool = True  # whether the run met the sampler's own criterion for its length
    evidence: Evidence | None = None  # where the sampler estimates it
    sampler: str = ""  # the name of the sampler that drew, where another one took its place; "" for itself


@dataclasses.dataclass(frozen=True)
class AbstractSampler(abc.ABC):
    """A sampler; its settings are its fields.

    Class attributes:
        name: by which users choose it.
        many_short_chains: whether chains are pooled for R-hat, because each alone is too short.
        compares: whether it estimates the evidence, which priors drawn from the residuals would inflate.
    """

    name: ClassVar[str]
    many_short_chains: ClassVar[bool] = False
    compares: ClassVar[bool] = False

    def prepare(
        self, result: FitResult, noise: str | type[AbstractNoise], priors: Mapping[str, AbstractPrior] | None
    ) -> Prepared:
        """The posterior in the form that `run` needs: by default the `Setup` of `hystfit.sampling.setup.prepare`."""
        return prepare(result, noise=noise, priors=priors, by_residuals=not self.compares)

    @abc.abstractmethod
    def run(self, setup: Any, seed: int, folder: Path | None, report: Progress) -> Raw:
        """Draw from the posterior.

        Args:
            setup: what `prepare` returned: `Setup.target` is a log density in whitened coordinates q, with its mode near 0.
            seed: of the draws.
            folder: stores the run in progress, so that the same call resumes after an interruption; None keeps nothing.
            report: called repeatedly with a line of text and the fraction that is done.
        """

    def check_counts(self, least: Mapping[str, int]) -> None:
        """Refuse settings that are not whole numbers, or below the least sensible value."""
        for name, lowest in least.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < lowest:
                raise ParameterError(f"{name} must be a whole number of at least {lowest}, got {value!r}")


@dataclasses.dataclass(frozen=True)
class AbstractChains(AbstractSampler):
    """A sampler whose chains are continued until they have converged.

    Attributes:
        chains, draws: number of chains, and least number of draws in each.
        extend: chains that have not converged are continued to at most so many times `draws`.
    """

    chains: int = 4
    draws: int = 500
    extend: int = 16

    def __post_init__(self) -> None:
        self.check_counts({"chains": 1, "draws": 4, "extend": 1})

    def until_converged(self, draw: Callable[[int], Any], judged: Callable[[Any], np.ndarray]) -> tuple[Any, bool]:
        """What `draw` gives for a number of draws that suffices, and whether the chains have converged; None where it gives None.

        `judged` are the numbers that have to converge, shape (chains, draws, d).
        """
        draws, most = self.draws, self.extend * self.draws
        while (joined := draw(draws)) is not None:
            convergence = Convergence.of(judged(joined))
            if convergence.good or convergence.apart or draws >= most:
                return joined, convergence.good
            draws = min(math.ceil(convergence.more * draws), most)
        return None, False
