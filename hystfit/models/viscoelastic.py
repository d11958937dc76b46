"""A chain of Maxwell elements with log-spaced relaxation times: elastomers, bearings, adhesives, added to a spring or a hysteresis."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis, check_same_length
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.starting import input_range, output_range, sampling_interval
from hystfit.params.param import element_places, element_weights
from hystfit.quality.host_operators import recursion
from hystfit.quality.needs import Needs

_BEYOND = 10.0  # factor by which relaxation times reach beyond the sampling interval and the duration of the records
MODES = 16  # two a decade over eight decades


class Viscoelastic(AbstractHysteresis):
    """Sum of Maxwell elements, springs in series with dashpots:  y = sum g_i q_i,   dq_i/dt = du/dt - q_i / tau_i.

    The relaxation times are fixed and evenly spaced on a logarithmic scale, the stiffnesses g_i >= 0 follow from a linear solve: the
    element is passive. It describes any relaxation that is slower than exponential, such as a power of time. A single g_i is not
    determined by data, its neighbors take over from it: read `modulus`. The step is exact for an input that is straight between samples.
    Add a spring (`linear`), and stops for filled elastomers.
    """

    rate_independent: ClassVar[bool] = False
    c_template: ClassVar[str] = "viscoelastic"
    counts: ClassVar[dict[str, str]] = {"modes": "tau"}
    estimator: ClassVar[str] = "convex"
    needs: ClassVar[Needs] = Needs(loop=False, time=True, rate=True, regularized=True)

    g: Float[Array, " modes"] = element_weights((0.1,) * MODES, unit="y/u", doc="stiffness of each element")
    tau: Float[Array, " modes"] = element_places(
        tuple(np.geomspace(1e-3, 1e3, MODES)), unit="s", doc="relaxation times"
    )

    def __check_init__(self) -> None:
        check_same_length(self, "g", "tau", "element")

    @classmethod
    def of(cls, modes: int = MODES) -> Viscoelastic:
        """A chain of this many elements; take two for each decade of time.

        Raises:
            ModelError: fewer than one.
        """
        if modes < 1:
            raise ModelError(f"at least one element is needed, got {modes}")
        return cls(g=np.full(modes, 0.1), tau=np.geomspace(1e-3, 1e3, modes))

    def init(self, u0: Scalar) -> State:
        """State: extensions of the springs, relaxed at u0, shape (modes,)."""
        return jnp.zeros(self.tau.size) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """The exact answer to a ramp from u0 to u1."""
        passed = dt / self.tau
        left = jnp.exp(-passed)
        share = jnp.where(passed > 0, -jnp.expm1(-passed) / jnp.where(passed > 0, passed, 1.0), 1.0)
        new = left * state + share * (u1 - u0)
        return new, jnp.dot(self.g, new)

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Extensions of all springs, which are the state."""
        return DesignMatrix.of(self, {"g": extensions(np.asarray(self.tau), *checked_drive(self, u, dt))})

    def modulus(self, frequency: Any) -> Complex[np.ndarray, " F"]:
        """Complex stiffness G' + i G'' of the chain at frequencies.

        Args:
            frequency: shape (F,) [Hz].
        """
        turn = 2j * np.pi * np.atleast_1d(np.asarray(frequency, dtype=float))[:, None] * np.asarray(self.tau)
        return (turn / (1.0 + turn)) @ np.asarray(self.g)

    def start(self, records: Sequence[Record]) -> Viscoelastic:
        """Relaxation times of the records, and equal stiffnesses."""
        tau = relaxation_times(records, self.tau.shape[-1])
        g = np.full(tau.shape, 0.2 * output_range(records).half / input_range(records).half / tau.size)
        return dataclasses.replace(self, g=g, tau=tau)


def extensions(tau: np.ndarray, u: Any, dt: Any) -> Float[np.ndarray, "T modes"]:
    """Extensions of the springs of elements with these relaxation times, after each sample of a run, on the host."""
    u, passed = np.asarray(u), np.asarray(dt)[:, None] / tau
    left, share = np.exp(-passed), -np.expm1(-passed) / np.where(passed > 0, passed, 1.0)
    driven = np.where(passed > 0, share, 1.0) * np.diff(u, prepend=u[0])[:, None]
    taps = -np.append(left[1:], np.zeros((1, tau.size)), axis=0)
    columns = (recursion((1.0, taps[:, k]), driven[:, k : k + 1]) for k in range(tau.size))
    return np.concatenate(list(columns), axis=1)


def relaxation_times(records: Sequence[Record], modes: int) -> Float[np.ndarray, " modes"]:
    """Times on a logarithmic scale, from a tenth of the shortest sampling interval to ten times the longest record [s]."""
    shortest = min(sampling_interval([record]) for record in records)
    longest = max([float(np.sum(record.dt)) for record in records] + [shortest])
    return np.geomspace(shortest / _BEYOND, longest * _BEYOND, modes)
