"""Standard errors predicted for inputs still to be measured, from the fitted records, a new input and a wide prior."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.information import AbstractInformation, LeastSquaresInformation, LikelihoodInformation, Moments
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.white import White
from hystfit.inference.priors import LOG_WIDE
from hystfit.inference.problem import Problem
from hystfit.inference.residuals import analyze
from hystfit.models.shared.simulation import run
from hystfit.params.coordinates import REAL, Coordinates
from hystfit.results.result import FitResult


def _sizes(c: Coordinates, x: np.ndarray) -> np.ndarray:
    """Relative size of each parameter: its value, or its scale where it may be zero."""
    scale, kind = np.asarray(c.scale), np.asarray(c.kinds)
    return np.where(kind == REAL, np.maximum(np.abs(x), scale), np.maximum(np.abs(x), 1e-3 * scale))


class Plan(eqx.Module):
    """What candidates are judged by.

    The parameters of a further record that it does not share, such as its offset, follow those of the fit.
    """

    coordinates: Coordinates  # of the fit's parameters
    x: Float[Array, " p"]  # their values, shape (p,)
    size: Float[Array, " p"]  # relative sizes, shape (p,); 0 for weights on their bound, which do not count
    information: AbstractInformation  # the noise behind the standard errors of the fit
    dt: Float[Array, ""]  # sampling interval
    limits: tuple[Array, Array]  # of the fitted input, relative to which curves over the input are placed
    own: tuple[int, ...] = eqx.field(static=True)  # positions of the parameters that each record has for itself

    @classmethod
    def of(cls, result: FitResult) -> Plan:
        problem, x = result.problem, result.x
        c, infos = problem.space.coordinates, problem.space.infos
        held = problem.on_bound(x) & np.array([info.linear for info in infos])
        inputs = np.concatenate([record.u for record in problem.data])
        return cls(
            coordinates=c,
            x=jnp.asarray(x),
            size=jnp.asarray(np.where(held, 0.0, _sizes(c, x))),
            information=_information(result),
            dt=jnp.asarray(result.data.sampling_interval or 0.0),
            limits=(jnp.asarray(inputs.min()), jnp.asarray(inputs.max())),
            own=tuple(int(k) for k in np.flatnonzero([info.per_record for info in infos])),
        )

    def present(self, problem: Problem, x: np.ndarray) -> Moments:
        """Moments of the fitted records, with no information about parameters of a further one."""
        J = problem.linearize(x)[1] * np.asarray(self.size)
        J = np.concatenate([J, np.zeros((*J.shape[:2], len(self.own)))], axis=-1)
        return _moments(self.information, problem.setting, jnp.asarray(J))

    def further(self, u: Float[Array, " T"]) -> Moments:
        """Moments of a further record with this input."""
        run_at = lambda x: run(self.coordinates.assemble(x, 0), u, jnp.full_like(u, self.dt))[0]
        push = lambda t: jax.jvp(run_at, (self.x,), (t,))[1]
        J = jax.vmap(push)(jnp.eye(self.x.shape[0])).T * self.size
        own = np.asarray(self.own, dtype=int)
        J = jnp.concatenate([J.at[:, own].set(0.0), J[:, own]], axis=-1)
        low, high = self.limits
        rising = jnp.diff(u) > 0
        one = jnp.ones((1, u.shape[0]))
        setting = Setting(
            gap=jnp.ones(()),
            weight=one,
            place=((u - low) / (high - low))[None],
            rising=jnp.concatenate([rising[:1], rising])[None],
            count=jnp.sum(one),
            log_weight=jnp.zeros(()),
        )
        return self.information.moments(setting, J[None])

    def covariance(self, moments: Moments) -> Float[Array, "q q"]:
        """Covariance in relative size of the parameters of the fit, then of those of the further record."""
        return self.information.covariance(moments, jnp.eye(self.x.shape[0] + len(self.own)) / LOG_WIDE**2)


def _information(result: FitResult) -> AbstractInformation:
    """The noise behind the standard errors of a fit."""
    if result.noise.refines:
        return likelihood_information(NOISES.find(result.noise.name)(**result.noise.parameters))  # type: ignore[operator]
    slow = analyze(result.problem, result.x).of_errors if result.noise.name == "auto" else None
    return LeastSquaresInformation.of(result.sigma**2, slow, 1.0 if slow else result.error_ratio)


def likelihood_information(noise: AbstractNoise) -> LikelihoodInformation:
    """That of a noise model with values; of noise that is not Gaussian that of white noise of its scale."""
    return LikelihoodInformation(noise if noise.gaussian else White(noise_white=noise.gaussian_scale()))


@eqx.filter_jit
def _moments(information: AbstractInformation, setting: Setting, J: Float[Array, "R T p"]) -> Moments:
    return information.moments(setting, J)


@eqx.filter_jit
def covariance_with(plan: Plan, now: Moments, u: Float[Array, " T"]) -> Float[Array, "q q"]:
    """Covariance by the present data and a further record."""
    return plan.covariance(jax.tree.map(jnp.add, now, plan.further(u)))
