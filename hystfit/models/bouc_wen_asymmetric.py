"""Generalized Bouc-Wen hysteresis for asymmetric loops: exponent, skew and a bent backbone."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.models.bouc_wen import AbstractBoucWen, grid_start
from hystfit.models.bouc_wen_steps import (
    bound,
    initial_hysteresis,
    middle_size,
    power_of,
    rate_integral,
    runge_kutta,
    semi_implicit,
)
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.polynomial import legendre_series
from hystfit.models.shared.sample_scan import scan_samples
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import equilibrium
from hystfit.models.shared.starting import input_range
from hystfit.params.param import param
from hystfit.quality.needs import Needs


class AsymmetricBoucWen(AbstractBoucWen):
    """Generalized Bouc-Wen for asymmetric loops and any exponent n:

        dh/dv = mu c - (s tau sgn h + delta + a sgn h) |h| (|h| / H)^(n - 1),    H = mu c / (tau + delta),
        y = offset + c v + sum over k >= 2 of b_k P_k(x) - h,    x = (v - center) / half

    H is the bound of |h| for every n when a = 0, so that tau and delta keep their unit 1/u; n shapes the knee alone. a = skew
    (tau + delta) sets different saturation above and below zero, and the Legendre polynomials P_k bend the backbone (after
    the generalized forms of Song and Der Kiureghian 2006 and Zhu and Wang 2012). A skew moves the bounds of h to
    H (1 + skew)^(-1/n) above and -H (1 - skew)^(-1/n) below. "exact" integrates with eight Runge-Kutta substeps a sample.

    Raises:
        ModelError: an unknown scheme.
    """

    needs: ClassVar[Needs] = Needs(
        amplitudes=2,
        symmetry="asymmetric",
        direction="counter-clockwise",
        too_few="the shape parameters are nearly redundant",
    )

    n: Scalar = param(1.0, bounds=(0.5, 12.0), doc="sharpness of the knee")
    skew: Scalar = param(0.0, bounds=(-0.95, 0.95), doc="asymmetry of the saturation")
    b: Float[Array, " k"] = param(
        (0.0, 0.0), unit="y", doc="Legendre coefficients 2, 3, ... of the backbone", linear=True
    )
    h0: Scalar = param(
        0.0,
        bounds=(-1.0, 1.0),
        per_record=True,
        fixed=True,
        doc="hysteretic state at the first sample, as a fraction of its bound",
    )
    offset: Scalar = param(0.0, unit="y", per_record=True, doc="output at zero input without hysteresis", linear=True)
    center: Scalar = param(0.0, unit="u", fixed=True, doc="middle of the input range")
    half: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="half of the input range")

    def init(self, u0: Scalar) -> State:
        """State: h, shape (1,)."""
        falling, rising = self._bounds()
        return initial_hysteresis(self.h0, -falling, rising)[None] + 0.0 * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        h = self._moved(state[0], u1 - u0, self._bounds())
        return h[None], self.offset + self.c * u1 + self._backbone(u1) - h

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """h alone is in the scan."""
        bounds = self._bounds()
        once = lambda h, dv: (new := self._moved(h, dv, bounds), new)
        last, h = scan_samples(once, state[0], jnp.diff(u, prepend=u0))
        return last[None], self.offset + self.c * u + self._backbone(u) - h

    def _bounds(self) -> tuple[Array, Array]:
        """Where h stops falling and rising, both counted upwards [y]."""
        m, total = self.mu * self.c, self.tau * (1 + self.rho)
        falling, rising = (bound(m, total, (1 + side * self.skew) ** (-1 / self.n)) for side in (-1.0, 1.0))
        return falling, rising

    def _backbone(self, u: Array) -> Array:
        return legendre_series(self.b, (u - self.center) / self.half, first=2)

    def _moved(self, h: Array, dv: Array, bounds: tuple[Array, Array]) -> Array:
        s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)
        m = self.mu * self.c
        total = self.tau * (1 + self.rho)
        q = s * h
        highest = jnp.where(dv < 0, *bounds)
        up, down = (self.tau * (1 + sign * self.rho) + s * self.skew * total for sign in (1.0, -1.0))
        power = lambda q: power_of(jnp.abs(q) * total / jnp.where(m > 0, m, 1.0), self.n - 1)
        slope = lambda q: m - jnp.where(q >= 0, up, down) * power(q) * q
        if self.scheme == "exact":
            return s * runge_kutta(slope, q, x, 8, jnp.maximum(q, highest))
        middle = jnp.minimum(q + 0.5 * x * slope(q), jnp.maximum(q, highest))
        passed = power(middle_size(middle, m * x)) * rate_integral(
            q, x, m, up, down
        )  # the power there keeps the second order
        return s * semi_implicit(q, x, m, passed, highest)

    def step_ratio(self, largest: Any) -> Any:
        """A sharper knee needs smaller steps."""
        return super().step_ratio(largest) * np.maximum(1.0, self.n)

    def start(self, records: Sequence[Record]) -> AsymmetricBoucWen:
        """As `BoucWen`, with the backbone's polynomials among the linear unknowns."""
        place = input_range(records)
        values, backbone = grid_start(records, self.b.shape[0])
        return dataclasses.replace(self, **values, b=backbone, center=place.center, half=place.half)

    def reach(self) -> tuple[float, float]:
        """A quarter of half the range beyond the range of the backbone."""
        center, half = float(self.center), float(self.half)
        return center - 1.25 * half, center + 1.25 * half

    def c_part(self) -> CPart:
        b, exact = np.append([0.0, 0.0], self.b), self.scheme == "exact"
        return CPart.of(self, "bouc_wen_asymmetric", h0=equilibrium(self, np.zeros(()))[0], b=b, exact=exact)
