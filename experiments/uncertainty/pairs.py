"""Setups whose calibration is tested: five models, each with the default noise model and with independent noise."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import hystfit as hf
from hystfit.models.base import AbstractHysteresis
from hystfit.models.preisach.parametric import ParametricPreisach

SAMPLES = 240
RATE = 60.0  # samples a second, for creep


@dataclasses.dataclass(frozen=True)
class Pair:
    """A model whose values center the drawn parameters, and the input for simulated data.

    Attributes:
        name: as printed.
        model: its values center the priors.
        record: input and time; its output only sets the noise level.
    """

    name: str
    model: AbstractHysteresis
    record: hf.Record


def growing(samples: int = SAMPLES, cycles: float = 6.0) -> np.ndarray:
    """A sine of growing amplitude, -1 to 1: inner loops, and a major one at the end."""
    phase = np.arange(samples) / samples
    return np.sin(2 * np.pi * cycles * phase) * (0.3 + 0.7 * phase)


def models() -> dict[str, AbstractHysteresis]:
    """The five models, with values typical of piezo or magnetic loops."""
    bouc_wen = hf.BoucWen(
        c=1.0, mu=0.5, tau=2.0, rho=0.5, scheme="exact"
    )  # forty samples a cycle are too few for the other
    plays = hf.PrandtlIshlinskii.of(plays=4)
    plays = eqx.tree_at(
        lambda m: (m.w, m.rise, m.low, m.high),
        plays,
        (jnp.asarray([[0.3, 0.25, 0.2, 0.25]]), jnp.asarray([1.6]), jnp.asarray(-1.0), jnp.asarray(1.0)),
    )
    density = ParametricPreisach(
        saturation=0.8, coercivity=0.35, width=0.25, spread=0.25, slope=0.2, levels=np.linspace(-1, 1, 13), depth=6
    )
    return {
        "Duhem": hf.Duhem(alpha=2.0, f=[0.1, 1.0, 0.1, -0.15], g=[0.5, 0.1, 0.2]),
        "Bouc-Wen": bouc_wen,
        "Bouc-Wen + creep": hf.Series(bouc_wen, hf.LogCreep(gamma=0.05)),
        "Prandtl-Ishlinskii, 4 plays": plays,
        "Preisach, Gaussian density": density,
    }


def pairs() -> list[Pair]:
    """Each model on the same input."""
    t, u = np.arange(SAMPLES) / RATE, growing()
    found = []
    for name, model in models().items():
        y = np.asarray(hf.simulate(model, u, 1 / RATE)[0])
        found.append(Pair(name, model, hf.Record(t=t, u=u, y=y, name="growing sine")))
    return found
