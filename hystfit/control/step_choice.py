"""Which one-sample inverse a model gets, and between which inputs it may be searched."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from hystfit.control.preisach_inverse import PreisachStep
from hystfit.control.step_inverse import (
    AbstractStepInverse,
    BoucWenStep,
    CreepStep,
    LinearStep,
    PlayStep,
    SearchStep,
    SeriesStep,
    SumStep,
)
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen import BoucWen
from hystfit.models.bouc_wen_asymmetric import AsymmetricBoucWen
from hystfit.models.compose import Offset, Series, Sum
from hystfit.models.creep import LogCreep
from hystfit.models.duhem import Duhem
from hystfit.models.dynamics import Delay, Lag, SecondOrder
from hystfit.models.prandtl_ishlinskii import PrandtlIshlinskii
from hystfit.models.preisach.model import Preisach
from hystfit.models.relaxation import Relaxation


def step_inverse(model: AbstractHysteresis, sign: float = 1.0) -> AbstractStepInverse:
    """The best one-sample inverse of a model: its closed form where it has one, else a search.

    Args:
        model: any model but a delay or a resonance.
        sign: of a search; -1 for outputs that fall with the input.

    Raises:
        ModelError: a delay or a resonance, which no inverse undoes sample by sample.
    """
    if isinstance(model, (Delay, SecondOrder)):
        raise ModelError(
            f"{type(model).__name__} cannot be inverted sample by sample (its answer comes later): leave it out and shift or lead "
            "the reference (hystfit.control.lead)"
        )
    if isinstance(model, Preisach) and model.elements == "cells":
        return PreisachStep.of(model)
    if isinstance(model, BoucWen):
        return BoucWenStep(model)
    if isinstance(model, PrandtlIshlinskii):
        plain = model.envelopes == ("identity",) and model.b.shape[0] == 1 and not model.hardening.size
        return PlayStep(model) if plain else SearchStep(model, sign)
    if isinstance(model, LogCreep):
        return CreepStep(model)
    if isinstance(model, (Lag, Relaxation)):
        return LinearStep(model)
    if isinstance(model, Sum):
        return _sum_inverse(model, sign)
    if isinstance(model, Series):
        inner = tuple(step_inverse(part) for part in model.parts)
        found = [
            reach(part) if own.needs_limits else (-np.inf, np.inf) for own, part in zip(inner, model.parts, strict=True)
        ]
        if all(edge is not None for edge in found[1:]):
            return SeriesStep(model, inner, jnp.asarray([edge or (-np.inf, np.inf) for edge in found]))
    return SearchStep(model, sign)


def _sum_inverse(model: Sum, sign: float) -> AbstractStepInverse:
    moving = [k for k, part in enumerate(model.parts) if not isinstance(part, Offset)]
    for k in moving:
        step_inverse(model.parts[k])  # refuses what cannot be inverted
    if len(moving) == 1:
        return SumStep(model, step_inverse(model.parts[moving[0]], sign), moving[0])
    return SearchStep(model, sign)


def reach(model: AbstractHysteresis) -> tuple[float, float] | None:
    """Inputs for which a model was made, as far as it says; None where it does not."""
    if isinstance(model, Preisach):
        return float(model.levels[0]), float(model.levels[-1])
    if isinstance(model, PrandtlIshlinskii):
        low, high = float(model.low), float(model.high)
        return low - 0.25 * (high - low), high + 0.25 * (high - low)
    if isinstance(model, (Duhem, AsymmetricBoucWen)):
        center, half = float(model.center), float(model.half)
        return center - 1.25 * half, center + 1.25 * half
    if isinstance(model, Series):
        return next((found for part in model.parts if (found := reach(part)) is not None), None)
    if isinstance(model, Sum):
        found = [edge for part in model.parts if (edge := reach(part)) is not None]
        return (max(low for low, _ in found), min(high for _, high in found)) if found else None
    return None
