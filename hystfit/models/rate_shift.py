"""A field that lags by an amount that grows with the rate: coercivity that depends on frequency, before any static hysteresis."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.starting import input_range, speeds
from hystfit.params.param import param
from hystfit.quality.needs import Needs


class RateShift(AbstractHysteresis):
    """Input less a dynamic field:  v = u - c sgn(q) log(1 + |q| / q0), with the rate q = du/dt of the sample before.

    Placed before a static model it widens the loop with the logarithm of the rate, as domain walls that are thermally activated do:
    coercive fields of ferroelectrics and of magnetic films over decades of frequency. Below q0 the shift is proportional to the rate.
    Records at three rates, each ten times the last, separate c and q0 from the coercivity of the static model. There is no inverse: an
    input with v given would follow u' = q(u - v), whose errors grow.
    """

    no_inverse: ClassVar[str] = (
        "a shift by the rate has no stable inverse: an error of the input changes its rate, and so grows from sample to sample; invert "
        "the static model fitted at the rate of use"
    )
    rate_independent: ClassVar[bool] = False
    c_template: ClassVar[str] = "rate_shift"
    needs: ClassVar[Needs] = Needs(
        loop=False,
        time=True,
        rate=True,
        speeds=3,
        too_few="the dynamic field and the coercivity of the static model trade off",
    )

    c: Scalar = param(
        0.01, bounds=(0.0, np.inf), unit="u", scale=0.01, doc="growth of the dynamic field for a rate e times as fast"
    )
    q0: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="u/s", scale=1.0, doc="rate from which the field grows with the logarithm"
    )

    def init(self, u0: Scalar) -> State:
        """State: the rates of the sample before the last and of the last, zero at rest."""
        return jnp.zeros(2) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """The shift by the last rate; the new rate acts at the next sample."""
        passes = dt > 0
        rate = (u1 - u0) / jnp.where(passes, dt, 1.0)
        new = jnp.where(passes, jnp.stack([state[1], rate]), state)
        return new, u1 - self.c * jnp.sign(new[0]) * jnp.log1p(jnp.abs(new[0]) / self.q0)

    def start(self, records: Sequence[Record]) -> RateShift:
        """A shift of 1 % of half the range for each factor e, from the slowest typical rate on."""
        typical = [float(np.median(rates)) for record in records if (rates := speeds(record)).size]
        slow = min((rate for rate in typical if rate > 0), default=1.0)
        return dataclasses.replace(self, c=0.02 * input_range(records).half, q0=0.1 * slow)
