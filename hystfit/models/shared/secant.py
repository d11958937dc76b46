"""The slope that the output of a Bouc-Wen model shows: data determine it whether or not they determine its parameters."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp

from hystfit.models.shared.shapes import Scalar

_STRAIGHT = 1e-3  # tau swing below which tanh(x) / x is 1 - x^2 / 3 to 1e-12


class AbstractSecant(eqx.Module):
    """y = c v - h, where h takes the part mu of the slope at a reversal and saturates at the rate tau."""

    c: eqx.AbstractVar[Scalar]  # slope of the loop without hysteresis [y/u]
    mu: eqx.AbstractVar[Scalar]  # part of it that the hysteresis takes
    tau: eqx.AbstractVar[Scalar]  # rate at which h saturates [1/u]

    def log_secant(self, swing: Scalar) -> Scalar:
        """log of the slope between the tips of a symmetric loop of half range `swing` [u], over c: 1 - mu tanh(tau swing) / (tau swing)."""
        x = self.tau * swing
        small = x < _STRAIGHT
        safe = jnp.where(small, 1.0, x)
        return jnp.log1p(-self.mu * jnp.where(small, 1 - x**2 / 3, jnp.tanh(safe) / safe))
