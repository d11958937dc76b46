"""The posterior of linear weights prepared for sampling: noise models, normal equations, notes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from hystfit.errors import ParameterError
from hystfit.inference.correlated_priors import CorrelatedPriors
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.priors import AbstractPrior
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import analyze, diagnose
from hystfit.outcome import Code, Note
from hystfit.outcome.note import has, warn
from hystfit.results.result import FitResult
from hystfit.sampling.weight_equations import NoiseGrid, WeightEquations, weight_equations, weight_priors

_KNOWN = ("iid", "ou")


@dataclasses.dataclass(frozen=True)
class WeightSetup:
    """See `hystfit.sampling.base.Prepared`.

    Attributes:
        problem: model and data, with a noise model for predictions.
        noise: its name.
        notes: what was chosen, and why.
        priors: of the weights without a penalty, and the user's own.
        equations: of the weights.
        grid: of the noises.
        size: of the output in the equations.
    """

    problem: Problem
    noise: str
    notes: tuple[Note, ...]
    priors: dict[str, AbstractPrior]
    equations: WeightEquations
    grid: NoiseGrid
    size: float

    @classmethod
    def of(
        cls, result: FitResult, noise: str | type[AbstractNoise], priors: Mapping[str, AbstractPrior] | None
    ) -> WeightSetup:
        """Prepare the weights of a fit.

        Raises:
            ParameterError: another noise model than iid and ou; see `weight_equations`.
        """
        if isinstance(priors, CorrelatedPriors):
            raise ParameterError("sampler='weights' takes independent priors: use sampler='nuts'")
        problem = result.problem.with_loss("linear")
        residuals = analyze(problem, result.x)
        diagnosis = diagnose(residuals)
        label = NOISES.label(noise) if noise != "auto" else "ou" if residuals.correlated else "iid"
        if label not in _KNOWN:
            raise ParameterError(f"sampler='weights' knows the noise models {' and '.join(_KNOWN)}, got {label}")
        notes = [Note(Code.NOISE_MODEL, f"noise model {label}: {'; '.join(note.text for note in diagnosis.findings)}")]
        if has(diagnosis.findings, Code.REPEATING_RESIDUALS):
            text = "part of the residuals recurs every loop: the model is incomplete, and its weights are biased by more than chance"
            notes.append(warn(Code.INCOMPLETE, text))
        grid = NoiseGrid.about(residuals.slow if label == "ou" else None)
        chosen, size = weight_priors(problem, result.x, priors), float(problem.scales.y)
        equations = weight_equations(problem, result.x, grid, chosen, size)
        return cls(problem.with_noise(NOISES.make(label)), label, tuple(notes), chosen, equations, grid, size)

    @property
    def dependence(self) -> None:
        """The priors of weights are independent."""
        return None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return self.problem.names

    def parameters(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Physical parameters of model and noise from draws of the chains, shape (chains, draws, d)."""
        noise = self.grid.parameters(draws["number"], draws["variance"] * self.size**2)
        return np.concatenate([draws["w"] * self.size, noise], axis=-1)

    def physical(self, z: np.ndarray) -> np.ndarray:
        """The draws are physical."""
        return z
