"""What every sampler takes and returns."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hystfit.errors import ParameterError
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.priors import AbstractPrior
from hystfit.outcome import Note
from hystfit.results.result import FitResult
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
