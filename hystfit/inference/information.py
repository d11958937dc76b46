"""Information about parameters under the noise of a fit, traced: from present data, and from inputs still to be measured.

Moments of records add up, and the covariance of all parameters follows from their sum. For one set of records the covariance is that of
`fitting.covariance`.
"""

from __future__ import annotations

import abc
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.discrepancy import inducing_shapes, on_branches
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.slow_likelihood import POINTS, SlowNoiseFit
from hystfit.models.shared.shapes import Scalar

_SHARE = 1e-3  # posterior weight of a noise below which it is left out of the average
Moments = tuple[Array, ...]


class AbstractInformation(eqx.Module):
    """Fisher information of records about the parameters under a noise model."""

    @abc.abstractmethod
    def moments(self, setting: Setting, J: Float[Array, "R T p"]) -> Moments:
        """Sums over records from which `covariance` follows."""

    @abc.abstractmethod
    def covariance(self, moments: Moments, prior: Float[Array, "p p"]) -> Float[Array, "p p"]:
        """Covariance of the estimate from the sum of moments, and from `prior` information."""


class LeastSquaresInformation(AbstractInformation):
    """A least-squares estimate under independent and slow noise, perhaps with curves over the input that recur in every loop."""

    plain: Scalar  # variance of the residuals [y^2], by which the prior is weighed against the data
    white: Scalar  # variance of the independent part at weight one [y^2]
    # slow, time: variances [y^2] and correlation times [samples] of exponential covariances that add up, shapes (m,)
    slow: Float[Array, " m"]
    time: Float[Array, " m"]
    loop: Scalar  # loop, length: variance of the curves and their length scale in the input; variance 0 without them
    length: Scalar
    curved: bool = eqx.field(static=True)

    @classmethod
    def of(cls, plain: float, fit: SlowNoiseFit | None, ratio: float = 1.0) -> LeastSquaresInformation:
        """From the noise of residuals of variance `plain` [y^2]; without slow noise, standard errors grow by `ratio`."""
        if fit is None:
            none = jnp.zeros(0)
            zero, one = jnp.zeros(()), jnp.ones(())
            return cls(jnp.asarray(plain), jnp.asarray(plain * ratio**2), none, none, zero, one, False)
        kept = fit.shares > _SHARE
        shares = fit.shares[kept] / fit.shares[kept].sum()
        noises = [noise for noise, on in zip(fit.others, kept, strict=True) if on]
        mean = lambda name: jnp.asarray(float(shares @ np.array([getattr(noise, name) ** 2 for noise in noises])))
        slow = shares * np.array([noise.slow**2 for noise in noises])
        times = np.array([noise.time for noise in noises])
        return cls(
            plain=jnp.asarray(plain),
            white=mean("white"),
            slow=jnp.asarray(slow),
            time=jnp.asarray(times),
            loop=mean("loop"),
            length=jnp.asarray(fit.noise.length),
            curved=fit.noise.shapes.shape[1] > 0,
        )

    def moments(self, setting: Setting, J: Float[Array, "R T p"]) -> Moments:
        """(J'J, J' Sigma J without the curves, J' S with the curves S), of derivatives times the root of the weights."""
        root = jnp.sqrt(setting.weight)[..., None]
        rows = J * root
        square = jnp.einsum("rtp,rtq->pq", rows, rows)
        gap = jnp.broadcast_to(setting.gap, setting.weight.shape)
        weighted = rows * root

        def along(decay: Array, signals: Array) -> Array:
            move = lambda f, at: (at[0] * f + at[1],) * 2
            return jax.lax.scan(move, jnp.zeros(signals.shape[1]), (decay, signals))[1]

        def slow(variance: Array, time: Array) -> Array:
            kept = jax.vmap(along)(jnp.exp(-gap / time), weighted)
            cross = jnp.einsum("rtp,rtq->pq", kept, weighted)
            return variance * (cross + cross.T - jnp.einsum("rtp,rtq->pq", weighted, weighted))

        total = self.white * square + jnp.sum(jax.vmap(slow)(self.slow, self.time), axis=0)
        if not self.curved:
            return square, total, jnp.zeros((J.shape[-1], 0))
        # Beyond the fitted range the curves stay as at its end.
        curves = on_branches(inducing_shapes(jnp.clip(setting.place, 0.0, 1.0), self.length, POINTS), setting)
        return square, total, jnp.einsum("rtp,rtk->pk", rows, curves * root)

    def covariance(self, moments: Moments, prior: Float[Array, "p p"]) -> Float[Array, "p p"]:
        """(A + P)^-1 (B + P) (A + P)^-1 with A = J'J / v and B = J' Sigma J / v^2, for residuals of variance v and prior P."""
        square, total, cross = moments
        inner = (total + self.loop * cross @ cross.T) / self.plain**2 + prior
        outer = jnp.linalg.inv(square / self.plain + prior)
        return outer @ inner @ outer


class LikelihoodInformation(AbstractInformation):
    """The maximum of a Gaussian likelihood under a noise model, whose shapes (the same in every record) are integrated out."""

    noise: AbstractNoise

    def moments(self, setting: Setting, J: Float[Array, "R T p"]) -> Moments:
        """Products of the whitened columns [J, shapes]."""
        inside = dataclasses.replace(setting, place=jnp.clip(setting.place, 0.0, 1.0))
        e, _ = self.noise.whiten(setting, jnp.concatenate([J, self.noise.columns(inside)], axis=-1))
        e = e.reshape(-1, e.shape[-1])
        p = J.shape[-1]
        return e[:, :p].T @ e[:, :p], e[:, :p].T @ e[:, p:], e[:, p:].T @ e[:, p:]

    def matrix(self, moments: Moments) -> Float[Array, "p p"]:
        """The information after elimination of the shapes."""
        square, cross, shapes = moments
        if cross.shape[1]:
            square = square - cross @ jnp.linalg.solve(jnp.eye(cross.shape[1]) + shapes, cross.T)
        return square

    def covariance(self, moments: Moments, prior: Float[Array, "p p"]) -> Float[Array, "p p"]:
        """Inverse of the information after elimination of the shapes."""
        return jnp.linalg.inv(self.matrix(moments) + prior)
