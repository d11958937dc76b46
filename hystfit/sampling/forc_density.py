"""The FORC density of a posterior: its mean, its standard deviation and its draws as a diagram."""

from __future__ import annotations

import numpy as np

from hystfit.errors import ParameterError
from hystfit.models.preisach.forc import density_of
from hystfit.models.preisach.forc_diagram import ForcDiagram
from hystfit.models.preisach.model import Preisach
from hystfit.sampling.posterior import Posterior


def sampled_density(posterior: Posterior, count: int = 200, seed: int = 0, *, rising: bool = True) -> ForcDiagram:
    """Posterior mean of the density of each cell, with its standard deviation and draws.

    The draws are the repeats of the diagram, so that `forc_numbers` gives every number and profile its credible error. Smoothness is a
    prior of the sampled weights, and its strength is drawn with them.

    Args:
        posterior: of a Preisach model with cells, such as that of a fit of "preisach-forc".
        count: number of draws, chosen at random.
        seed: of the choice.
        rising: see `density_of`.

    Raises:
        ParameterError: a posterior of another model.
    """
    model = posterior.result.model
    if not isinstance(model, Preisach) or model.elements != "cells":
        raise ParameterError(f"{posterior.result.name} has no density: sample a fit of preisach-forc")
    diagrams = [density_of(one, rising=rising) for one in posterior.models(count, seed)]  # type: ignore[arg-type]
    draws = np.stack([one.density for one in diagrams])
    first = diagrams[0]
    return ForcDiagram(
        first.reversal,
        first.field,
        draws.mean(axis=0),
        first.area,
        stderr=draws.std(axis=0, ddof=1),
        repeats=draws,
    )
