"""Quantities that follow from a model, for every draw of a posterior: numbers of the loop, creep, and the FORC density."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hystfit.errors import ParameterError
from hystfit.models.preisach.forc_diagram import ForcDiagram
from hystfit.models.preisach.model import Preisach
from hystfit.results.measured.quantities import CREEP, QUANTITIES, applicable
from hystfit.results.measured.steady_loops import Excitation, creeps
from hystfit.sampling.posterior import Posterior


def derive(posterior: Posterior, quantities: Sequence[str] | None, count: int) -> dict[str, np.ndarray]:
    """Draws of derived quantities, each (count,), see `hystfit.results.measured.quantities`; by default all that records and model have."""
    posterior = dataclasses.replace(posterior, result=posterior.result.settled)
    timed = posterior.result.model.creeps
    have = applicable(posterior.result.data, timed=timed)
    names = list(quantities) if quantities else list(have)
    if unknown := [name for name in names if name not in QUANTITIES]:
        raise ParameterError(f"no quantity {unknown}; there are {', '.join(QUANTITIES)}")
    if CREEP in names and not timed:
        raise ParameterError(f"{posterior.result.name} has no creep")
    if other := [name for name in names if name not in have]:
        raise ParameterError(f"{', '.join(other)}: for records of force and displacement, known by their units")
    excitation = Excitation.of(posterior.result.data, posterior.result.model)
    values = dict[str, np.ndarray]()
    loops = excitation.loops(posterior.predict(excitation.loop, count)) if set(names) != {CREEP} else None
    for name in names:
        of_loops = QUANTITIES[name].of_loops
        if of_loops is None:
            creep = Excitation.creep(posterior.predict(excitation.step, count))
            if quantities or creeps(creep):
                values[name] = creep
        elif loops is not None:
            values[name] = of_loops(loops)
    return values


def sampled_density(posterior: Posterior, count: int = 200, seed: int = 0, *, rising: bool = True) -> ForcDiagram:
    """Posterior mean of the density of each cell of a Preisach model, with its standard deviation and draws.

    The draws are the repeats of the diagram, so that `forc_numbers` gives every number and profile its credible error. Smoothness is a
    prior of the sampled weights, and its strength is drawn with them.
    """
    model = posterior.result.model
    if not isinstance(model, Preisach) or model.elements != "cells":
        raise ParameterError(f"{posterior.result.name} has no density: sample a fit of preisach-forc")
    diagrams = [ForcDiagram.of_model(one, rising=rising) for one in posterior.models(count, seed)]  # type: ignore[arg-type]
    draws = np.stack([one.density for one in diagrams])
    first = diagrams[0]
    return ForcDiagram(
        first.reversal, first.field, draws.mean(axis=0), first.area, stderr=draws.std(axis=0, ddof=1), repeats=draws
    )
