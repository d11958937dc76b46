"""Bouc-Wen hysteresis in its normalized piezo form, y = c v - h (Minase et al. 2010, eq. (1); Low and Guo's output)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen_steps import (
    Scheme,
    bound,
    exact_step,
    initial_hysteresis,
    phi,
    rate_integral,
    trapezoid,
)
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.sample_scan import scan_samples
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import equilibrium
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.starting import (
    best_of_grid,
    grid_columns,
    input_range,
    offset_columns,
    thinned,
    used_samples,
)
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.param import param
from hystfit.quality.loops import largest_step
from hystfit.quality.needs import Needs

COARSE = 0.1  # largest (tau + |delta|) |dv| for which the semi-implicit step is trusted: its error is of the third order in it


_STRAIGHT = 1e-3  # tau swing below which tanh(x) / x is 1 - x^2 / 3 to 1e-12


class AbstractBoucWen(AbstractHysteresis):
    """y = c v - h, where h takes the part mu of the slope at a reversal and saturates at the rate tau."""

    rate_independent: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"scheme": get_args(Scheme)}

    c: Scalar = param(1.0, bounds=(0.0, np.inf), unit="y/u", doc="slope of the loop without hysteresis")
    mu: Scalar = param(0.4, bounds=(0.0, 1.0), doc="fraction of the slope c that is lost at a reversal")
    tau: Scalar = param(1.0, bounds=(0.0, np.inf), unit="1/u", doc="rate at which h saturates")
    rho: Scalar = param(0.5, bounds=(-1.0, 1.0), doc="delta / tau, shape of the loop's tips")
    scheme: Scheme = eqx.field(static=True, default="semi-implicit", kw_only=True)

    def log_secant(self, swing: Scalar) -> Scalar:
        """log of the slope between the tips of a symmetric loop of half range `swing` [u], over c: 1 - mu tanh(tau swing) / (tau swing)."""
        x = self.tau * swing
        small = x < _STRAIGHT
        safe = jnp.where(small, 1.0, x)
        return jnp.log1p(-self.mu * jnp.where(small, 1 - x**2 / 3, jnp.tanh(safe) / safe))

    def step_ratio(self, largest: Any) -> Any:
        """See the base class: 0 for the exact scheme."""
        return np.asarray(self.tau) * (1 + np.abs(self.rho)) * (self.scheme != "exact") * largest / COARSE

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Where the sampling is too coarse for the default scheme."""
        largest = COARSE * float(self.step_ratio(largest_step(u)))
        if largest <= COARSE:
            return ()
        return (
            f"in one sample the input moves by up to {largest:.2g} times the memory length of the hysteresis (1 / its rate), and the "
            f"default scheme is accurate up to {COARSE} times: sample faster, or use scheme='exact' (at the shell :scheme=exact after the "
            "model's name)",
        )


class BoucWen(AbstractBoucWen):
    """Normalized Bouc-Wen:  dh/dv = mu c - (s tau sgn h + delta) |h|,  y = offset + c v - h,  s = sign(dv).

    Here delta = rho tau. With |rho| < 1 the loop is dissipative, and |h| <= mu c / (tau + delta). The classic form with A, beta, gamma
    and n has a redundant parameter, because the scale of its hysteretic state is arbitrary. This form removes it (h enters with gain
    one) and sets n = 1. A record with one amplitude still determines mu and rho poorly: fix one of them, for example by `--fix rho=1`
    at the shell or `fix={"rho": 1}` in Python.

    `scheme`: "exact" is the closed-form solution for any step. "semi-implicit" has second order and is several times cheaper; it is
    bounded, dissipative and continuous in its parameters for any step. A note warns if the sampling is too coarse for it.

    Raises:
        ModelError: an unknown scheme.
    """

    needs: ClassVar[Needs] = Needs(
        amplitudes=2,
        symmetry="symmetric",
        direction="counter-clockwise",
        too_few="mu, tau and rho are nearly redundant",
    )

    h0: Scalar = param(
        0.0,
        bounds=(-1.0, 1.0),
        per_record=True,
        fixed=True,
        doc="hysteretic state at the first sample, as a fraction of its bound",
    )
    offset: Scalar = param(0.0, unit="y", per_record=True, doc="output at zero input without hysteresis", linear=True)

    @property
    def delta(self) -> Scalar:
        """The literature's delta [1/u]."""
        return self.rho * self.tau

    def init(self, u0: Scalar) -> State:
        """State: h, shape (1,)."""
        highest = bound(self.mu * self.c, self.tau * (1 + self.rho))
        return initial_hysteresis(self.h0, -highest, highest)[None] + 0.0 * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample; with q = s h and x = |dv| the law is dq/dx = mu c - kappa |q| sgn q on each side of zero."""
        dv = u1 - u0
        m, up, down = self.mu * self.c, self.tau * (1 + self.rho), self.tau * (1 - self.rho)
        if self.scheme == "exact":
            s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)
            h = s * exact_step(s * state[0], x, m, up, down, (phi(up, x), phi(down, x)))
        else:
            h = trapezoid(state[0], dv, m, up, down)
        return h[None], self.offset + self.c * u1 - h

    @property
    def one_scan(self) -> bool:
        """The exact step has exponentials that need no state."""
        return self.scheme != "exact"

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """For the exact scheme, the exponentials of all steps first, then one scan."""
        if self.scheme != "exact":
            return super().sweep(state, u0, u, dt)
        dv = jnp.diff(u, prepend=u0)
        m, up, down = self.mu * self.c, self.tau * (1 + self.rho), self.tau * (1 - self.rho)
        s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)

        def once(h: Array, row: tuple[Array, ...]) -> tuple[Array, Array]:
            s, x, *phis = row
            h = s * exact_step(s * h, x, m, up, down, (phis[0], phis[1]))
            return h, h

        last, h = scan_samples(once, state[0], (s, x, phi(up, x), phi(down, x)))
        return last[None], self.offset + self.c * u - h

    def start(self, records: Sequence[Record]) -> BoucWen:
        """A grid over (tau, rho), for each of which c, mu c and the offset follow by linear least squares."""
        values, _ = grid_start(records, 0)
        return dataclasses.replace(self, **values)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes:
        """Extremes at the largest |h|, which is reached by crossing the whole range from rest."""
        c, m, tau, rho = (float(value) for value in (self.c, self.mu * self.c, self.tau, self.rho))
        up, down = tau * (1 + rho), tau * (1 - rho)
        if m == 0:
            return Slopes.of(c)
        h = m / up * -np.expm1(-np.linspace(0.0, 30.0, 1000))  # up to its bound
        reached = float(np.interp(high - low, -np.log1p(-up * h / m) / up, h))
        return Slopes.of(c - m + up * reached, c - m, c - m - down * reached)

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        return BoucWenStep(self)

    def c_part(self) -> CPart:
        return CPart.of(self, "bouc_wen", h0=equilibrium(self, np.zeros(()))[0], exact=self.scheme == "exact")


class BoucWenStep(AbstractStepInverse):
    """Explicit inverse of `BoucWen` (after Minase et al. 2010): a quadratic for the semi-implicit step, Newton for the exact one.

    With q = s h and x = |dv| the output moves by s dy = c x - (q' - q), which is convex in x: Newton's method converges from above.
    """

    model: BoucWen
    needs_limits: ClassVar[bool] = False

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        bw = self.model
        gap = target - (bw.offset + bw.c * u0 - state[0])
        s, way = jnp.where(gap < 0, -1.0, 1.0), jnp.abs(gap)
        q, m = s * state[0], bw.mu * bw.c
        up, down = bw.tau * (1 + bw.rho), bw.tau * (1 - bw.rho)
        slope = bw.c - m + jnp.where(q >= 0, up, down) * q

        def root(alpha: Array, beta: Array) -> Array:
            """x where half the integral of the rates is alpha x + beta."""
            a, b, d = alpha * bw.c, bw.c * (1 + beta) - m + alpha * (2 * q - way), way * (1 + beta) - 2 * q * beta
            part = jnp.sqrt(jnp.maximum(b * b + 4 * a * d, 0.0))
            return jnp.where(b > 0, 2 * d / jnp.where(b > 0, b + part, 1.0), (part - b) / jnp.where(a > 0, 2 * a, 1.0))

        x = root(0.5 * jnp.where(q >= 0, up, down), jnp.zeros_like(q))
        crosses = (q < 0) & (m * x > -q)
        x = jnp.where(crosses, root(0.5 * up, 0.5 * (up - down) * q / jnp.where(m > 0, m, 1.0)), x)
        moved = lambda x: s * bw.step(state, u0, u0 + s * x, dt)[0][0]
        bound = jnp.where(up > 0, m / jnp.where(up > 0, up, 1.0), jnp.inf)
        if bw.scheme == "semi-implicit":
            # If a long step is clipped at the bound of h, h is known.
            half = 0.5 * rate_integral(q, x, m, up, down)
            stuck = ((1 - half) * q + m * x) / (1 + half)
            held = jnp.clip(stuck, jnp.minimum(q, bound), jnp.maximum(q, bound))
            x = jnp.where(held == stuck, x, (way + held - q) / bw.c)
        else:
            far = (way + jnp.maximum(bound, q) - q) / bw.c
            x = jnp.where(slope > 0, jnp.minimum(far, way / jnp.where(slope > 0, slope, 1.0)), far)

            def newton(_: Array, x: Array) -> Array:
                h = moved(x)
                rate = bw.c - m + jnp.where(h >= 0, up, down) * h
                return jnp.maximum(x - (bw.c * x - (h - q) - way) / jnp.where(rate > 0, rate, bw.c), 0.0)

            x = jax.lax.fori_loop(0, 12, newton, x)
        return Root(u0 + s * x, slope > 0)


def grid_start(records: Sequence[Record], degree: int) -> tuple[dict[str, float], np.ndarray]:
    """c, mu, tau, rho and offset at the best (tau, rho) of a grid, and `degree` Legendre coefficients, from 2 on, of the backbone there.

    The output is linear in all but tau and rho.
    """
    place, records = input_range(records), thinned(records)
    tau, rho = (a.ravel() for a in np.meshgrid(np.geomspace(0.2, 30.0, 12) / place.half, [-0.6, 0.0, 0.6, 0.95]))
    u, y = used_samples(records)
    states = u[:, None] - grid_columns(BoucWen(c=1.0, mu=1.0), {"tau": tau, "rho": rho}, records)  # h for mu c = 1
    offsets = offset_columns(records)
    bend = np.polynomial.legendre.legvander((u - place.center) / place.half, degree + 1)[:, 2:]
    k, theta, _ = best_of_grid(states, np.column_stack([u, offsets, bend]), y)
    unit_factor, slope, offset = theta[:3]
    c = max(slope, 1e-3 * abs(unit_factor), 1e-12)
    mu = float(np.clip(-unit_factor / c, 0.02, 0.98))
    values = {"c": c, "mu": mu, "tau": float(tau[k]), "rho": float(rho[k]), "offset": offset}
    return values, theta[2 + len(records) :]
