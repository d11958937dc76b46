"""Plays whose thresholds grow with the rate of the input: loops that widen with frequency, with an exact explicit inverse."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis, check_same_length
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.play_columns import play_thresholds
from hystfit.models.shared.reported import PlayWeights
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import states_over
from hystfit.models.shared.starting import LARGE, fitted_input_range, output_range, sampling_interval, speed
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.param import element_places, element_weights, param
from hystfit.quality.needs import Needs


class RateDependentPlays(AbstractHysteresis):
    """Weighted plays with thresholds r_j + kappa q, where q is the speed of the input behind a first-order lag:

        y = offset + gain x + sum w_j p_j,   p_j <- clip(p_j, x - r_j - kappa q, x + r_j + kappa q),   x = (u - low) / (high - low)
        q = |du/dt| / speed of the sample before, averaged over `tau`

    The weights are >= 0 and follow from a linear solve for each kappa >= 0. As q does not depend on the new input, a step is that of
    static plays, and its inverse is exact and explicit. Records at several rates are needed: at one rate kappa and the thresholds are
    one number. Thresholds that fall with the rate have no such inverse and are outside the bounds. The input rests at the first sample.

    Source: Al Janaideh and Krejci (2013), IEEE/ASME Transactions on Mechatronics 18, 1498-1507.
    """

    rate_independent: ClassVar[bool] = False
    c_template: ClassVar[str] = "rate_plays"
    counts: ClassVar[dict[str, str]] = {"plays": "r"}
    estimator: ClassVar[str] = "convex"
    needs: ClassVar[Needs] = Needs(
        time=True,
        direction="counter-clockwise",
        rate=True,
        speeds=2,
        regularized=True,
        too_few="the growth of the thresholds with the rate and their widths at rest trade off",
    )

    w: Float[Array, " plays"] = element_weights(doc="weights of the plays")
    r: Float[Array, " plays"] = element_places(scale=0.1, doc="half widths at rest, as fractions of the input range")
    gain: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="y", linear=True, doc="rise of the part without hysteresis over the range"
    )
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the output")
    kappa: Scalar = param(
        0.02, bounds=(0.0, np.inf), scale=0.1, doc="growth of the half widths, as a fraction of the range, at `speed`"
    )
    tau: Scalar = param(
        0.01, bounds=(0.0, np.inf), unit="s", scale=0.01, fixed=True, doc="time over which the rate is averaged"
    )
    low: Scalar = param(0.0, unit="u", fixed=True, doc="input where x = 0")
    high: Scalar = param(1.0, unit="u", fixed=True, doc="input where x = 1")
    speed: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u/s", fixed=True, doc="rate where q = 1")

    def __check_init__(self) -> None:
        check_same_length(self, "w", "r", "play")

    @classmethod
    def of(cls, plays: int = 20) -> RateDependentPlays:
        """A model with this many plays, see `play_thresholds`.

        Raises:
            ModelError: fewer than one play.
        """
        return cls(w=np.full(plays, 0.01), r=play_thresholds(plays))

    def plays(self) -> tuple[PlayWeights, ...]:
        """The weights over the thresholds at rest."""
        names = tuple(f"w[{j}]" for j in range(self.r.size))
        return (
            PlayWeights("plays", np.asarray(self.r) * (float(self.high) - float(self.low)), np.asarray(self.w), names),
        )

    def init(self, u0: Scalar) -> State:
        """State at rest on u0: the plays, the averaged rate and the last one, shape (plays + 2,)."""
        x = (u0 - self.low) / (self.high - self.low)
        return jnp.concatenate([jnp.full(self.r.size, 1.0) * x, jnp.zeros(2) * u0])

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample of static plays with the thresholds at the rate so far."""
        q, last = self.rate(state, dt)
        passes = dt > 0
        now = jnp.where(passes, jnp.abs(u1 - u0) / (jnp.where(passes, dt, 1.0) * self.speed), last)
        x, widths = (u1 - self.low) / (self.high - self.low), self.r + self.kappa * q
        plays = jnp.maximum(x - widths, jnp.minimum(x + widths, state[:-2]))
        y = self.offset + self.gain * x + jnp.dot(self.w, plays)
        return jnp.concatenate([plays, jnp.stack([q, now])]), y

    def rate(self, state: State, dt: Scalar) -> tuple[Scalar, Scalar]:
        """The averaged rate at the next sample, which follows from samples before it, and the last rate.

        Args:
            state: after the last sample.
            dt: time to the next one [s]; 0 leaves the average as it is.
        """
        left = jnp.exp(-dt / self.tau)
        return jnp.where(dt > 0, left * state[-2] + (1.0 - left) * state[-1], state[-2]), state[-1]

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """The plays, which are in the state; the straight part and the offset."""
        x = (np.asarray(u, dtype=float) - float(self.low)) / (float(self.high) - float(self.low))
        columns = {"w": states_over(self, u, dt)[:, :-2], "gain": x[:, None], "offset": np.ones((x.size, 1))}
        return DesignMatrix.of(self, columns)

    def start(self, records: Sequence[Record]) -> RateDependentPlays:
        """Ranges and rates from the records; the weights follow from a linear solve."""
        place, out = fitted_input_range(records), output_range(records)
        largest = speed(records, LARGE)
        ranges = {
            "low": place.low,
            "high": place.high,
            "speed": largest,
            "tau": 3.0 * sampling_interval(records),  # the rate is averaged over three intervals
        }
        w = np.full(self.w.shape, 0.2 * out.half / self.w.size)
        return dataclasses.replace(
            self, **ranges, w=w, gain=1.6 * out.half, kappa=0.02, offset=out.center - 0.8 * out.half
        )

    def reach(self) -> tuple[float, float]:
        """A quarter of the range beyond it on either side."""
        low, high = float(self.low), float(self.high)
        return low - 0.25 * (high - low), high + 0.25 * (high - low)

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        return RatePlayStep(self)


class RatePlayStep(AbstractStepInverse):
    """Exact inverse of `RateDependentPlays`: the thresholds of the sample are known before it, so that the step is that of static plays."""

    model: RateDependentPlays
    needs_limits: ClassVar[bool] = False

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        model = self.model
        q, _ = model.rate(state, dt)
        plays, widths, w = state[:-2], model.r + model.kappa * q, model.w
        # A play rests between play - width and play + width, and runs beside x beyond: the output is piecewise linear in x.
        output = lambda x: model.offset + model.gain * x + jnp.dot(w, jnp.clip(plays, x - widths, x + widths))
        above = jax.vmap(output)(plays + widths) < target
        below = jax.vmap(output)(plays - widths) > target
        slope = model.gain + jnp.sum(jnp.where(above | below, w, 0.0))
        shift = jnp.sum(w * jnp.where(above, -widths, jnp.where(below, widths, plays)))
        x = jnp.where(slope > 0, (target - model.offset - shift) / jnp.where(slope > 0, slope, 1.0), 0.0)
        rest = (u0 - model.low) / (model.high - model.low)
        return Root(model.low + jnp.where(slope > 0, x, rest) * (model.high - model.low), slope > 0)
