"""Bouc-Wen hysteresis in its normalised piezo form, y = c v - h (Minase et al. 2010, eq. (1); Low and Guo's output)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.polynomial import legendre_series
from hystfit.models.starting import fit_linear, input_range, thinned
from hystfit.params import param

COARSE = 0.1  # largest (tau + |delta|) |dv| for which the semi-implicit step is trusted: its error is of the third order in it


class BoucWen(AbstractHysteresis):
    """Normalised Bouc-Wen:  dh/dv = mu c - (s tau sgn h + delta) |h|,  y = offset + c v - h,  s = sign(dv).

    delta = rho tau with |rho| < 1 keeps the loop dissipative, |h| <= mu c / (tau + delta). The form is normalised (h enters
    with gain one), so that no two parameters do the same thing; one amplitude alone still determines mu and rho poorly.

    `scheme`: "exact" is the closed form of papers' section 3.1 for any step; "semi-implicit" is second order, several times cheaper,
    bounded, dissipative and continuous in its parameters for any step, and warned about where the sampling is coarse.

    Raises:
        ModelError: an unknown scheme.
    """

    rate_independent: ClassVar[bool] = True

    c: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="y/u", doc="slope of the loop without hysteresis")
    mu: Float[Array, ""] = param(
        0.4, bounds=(0.0, 1.0), doc="part of the slope that the hysteresis takes at a reversal"
    )
    tau: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="1/u", doc="rate at which h saturates")
    rho: Float[Array, ""] = param(0.5, bounds=(-1.0, 1.0), doc="delta / tau, shape of the loop's tips")
    h0: Float[Array, ""] = param(0.0, unit="y", per_record=True, fixed=True, doc="hysteretic state at the first sample")
    offset: Float[Array, ""] = param(
        0.0, unit="y", per_record=True, doc="output at zero input without hysteresis", linear=True
    )
    scheme: Literal["semi-implicit", "exact"] = eqx.field(static=True, default="semi-implicit")

    def __check_init__(self) -> None:
        if self.scheme not in ("semi-implicit", "exact"):
            raise ModelError(f"scheme must be semi-implicit or exact, got {self.scheme!r}")

    @property
    def delta(self) -> Float[Array, ""]:
        """The literature's delta [1/u]."""
        return self.rho * self.tau

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """State: h, shape (1,)."""
        return self.h0[None] + 0.0 * u0

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """One sample; with q = s h and x = |dv| the law is dq/dx = mu c - kappa |q| sgn q on each side of zero."""
        dv = u1 - u0
        m, up, down = self.mu * self.c, self.tau * (1 + self.rho), self.tau * (1 - self.rho)
        if self.scheme == "exact":
            s = jnp.where(dv < 0, -1.0, 1.0)
            h = s * _exact_step(s * state[0], jnp.abs(dv), m, up, down)
        else:
            h = _trapezoid(state[0], dv, m, up, down)
        return h[None], self.offset + self.c * u1 - h

    def advice(self, u: np.ndarray) -> tuple[str, ...]:
        """Says where the sampling is too coarse for the cheap step."""
        return _coarse(self.scheme, float(self.tau) * (1 + abs(float(self.rho))), u)

    def start(self, records: Sequence[Record]) -> BoucWen:
        """A grid over (tau, rho), for each of which c, mu c and the offset follow by linear least squares."""
        tau, rho, theta = _grid_start(records, 0)
        c = max(theta[0], 1e-3 * abs(theta[1]), 1e-12)
        mu = float(np.clip(-theta[1] / c, 0.02, 0.98))
        values = (c, mu, tau, rho, theta[2])
        return eqx.tree_at(lambda m: (m.c, m.mu, m.tau, m.rho, m.offset), self, tuple(map(jnp.asarray, values)))


class AsymmetricBoucWen(AbstractHysteresis):
    """Generalised Bouc-Wen for asymmetric loops and any exponent n:

        dh/dv = mu c - (s tau sgn h + delta + a sgn h) |h| (|h| / H)^(n - 1),    H = mu c / (tau + delta),
        y = offset + c v + sum over k >= 2 of b_k P_k(x) - h,    x = (v - center) / half

    H is the bound of |h| for every n when a = 0, so that tau and delta keep their unit 1/u; n shapes the knee alone. a = skew
    (tau + delta) sets different saturation above and below zero, and the Legendre polynomials P_k bend the backbone (after
    the generalised forms of Song and Der Kiureghian 2006 and Zhu and Wang 2012). A skew moves the bounds of h to
    H (1 + skew)^(-1/n) above and -H (1 - skew)^(-1/n) below. "exact" integrates with eight Runge-Kutta substeps a sample.

    Raises:
        ModelError: an unknown scheme.
    """

    rate_independent: ClassVar[bool] = True

    c: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="y/u", doc="slope of the loop without hysteresis")
    mu: Float[Array, ""] = param(
        0.4, bounds=(0.0, 1.0), doc="part of the slope that the hysteresis takes at a reversal"
    )
    tau: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="1/u", doc="rate at which h saturates")
    rho: Float[Array, ""] = param(0.5, bounds=(-1.0, 1.0), doc="delta / tau, shape of the loop's tips")
    n: Float[Array, ""] = param(1.0, bounds=(0.5, 12.0), doc="sharpness of the knee")
    skew: Float[Array, ""] = param(0.0, bounds=(-0.95, 0.95), doc="asymmetry of the saturation")
    b: Float[Array, " k"] = param(
        (0.0, 0.0), unit="y", doc="Legendre coefficients 2, 3, ... of the backbone", linear=True
    )
    h0: Float[Array, ""] = param(0.0, unit="y", per_record=True, fixed=True, doc="hysteretic state at the first sample")
    offset: Float[Array, ""] = param(
        0.0, unit="y", per_record=True, doc="output at zero input without hysteresis", linear=True
    )
    center: Float[Array, ""] = param(0.0, unit="u", fixed=True, doc="middle of the input range")
    half: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="half of the input range")
    scheme: Literal["semi-implicit", "exact"] = eqx.field(static=True, default="semi-implicit")

    def __check_init__(self) -> None:
        if self.scheme not in ("semi-implicit", "exact"):
            raise ModelError(f"scheme must be semi-implicit or exact, got {self.scheme!r}")

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """State: h, shape (1,)."""
        return self.h0[None] + 0.0 * u0

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """One sample."""
        dv = u1 - u0
        s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)
        m = self.mu * self.c
        total = self.tau * (1 + self.rho)
        q = s * state[0]
        highest = _bound(m, total, (1 + s * self.skew) ** (-1 / self.n))

        up, down = (self.tau * (1 + sign * self.rho) + s * self.skew * total for sign in (1.0, -1.0))
        power = lambda q: _power(jnp.abs(q) * total / jnp.where(m > 0, m, 1.0), self.n - 1)
        slope = lambda q: m - jnp.where(q >= 0, up, down) * power(q) * q
        if self.scheme == "exact":
            q = _runge_kutta(slope, q, x, 8, jnp.maximum(q, highest))
        else:
            middle = jnp.minimum(q + 0.5 * x * slope(q), jnp.maximum(q, highest))
            passed = power(middle) * passed_rates(q, x, m, up, down)  # the power there keeps the second order
            q = _semi_implicit(q, x, m, passed, highest)
        h = s * q
        backbone = legendre_series(
            jnp.concatenate([jnp.zeros(2, self.b.dtype), self.b]), (u1 - self.center) / self.half
        )
        return h[None], self.offset + self.c * u1 + backbone - h

    def advice(self, u: np.ndarray) -> tuple[str, ...]:
        """Says where the sampling is too coarse for the cheap step."""
        return _coarse(self.scheme, float(self.tau) * (1 + abs(float(self.rho))) * max(1.0, float(self.n)), u)

    def start(self, records: Sequence[Record]) -> AsymmetricBoucWen:
        """As `BoucWen`, with the backbone's polynomials among the linear unknowns."""
        place, count = input_range(records), self.b.shape[0]
        tau, rho, theta = _grid_start(records, count)
        c = max(theta[0], 1e-3 * abs(theta[1]), 1e-12)
        mu = float(np.clip(-theta[1] / c, 0.02, 0.98))
        values = (c, mu, tau, rho, theta[3:], theta[2], place.center, place.half)
        fields = lambda m: (m.c, m.mu, m.tau, m.rho, m.b, m.offset, m.center, m.half)
        return eqx.tree_at(fields, self, tuple(map(jnp.asarray, values)))


def _bound(m: Array, up: Array, factor: Array | float = 1.0) -> Array:
    """Where q stops rising, m / up times a factor; no bound where nothing saturates."""
    return jnp.where(up > 0, m * factor / jnp.where(up > 0, up, 1.0), jnp.inf)


def passed_rates(q: Array, x: Array, m: Array, up: Array, down: Array) -> Array:
    """Integral of kappa over a step, with q rising by m: `down` until it reaches zero, `up` beyond.

    So the step is continuous in its arguments. With a kappa by the sign of q at its start it jumps where q passes zero, and
    sharp likelihoods are full of small steps.
    """
    return up * x + (down - up) / jnp.maximum(m, 1e-300) * _risen(q, x, m)


def _risen(q: Array, x: Array, m: Array) -> Array:
    """By how much q, rising by m on the way x, rises below zero."""
    return jnp.minimum(jnp.maximum(-q, 0.0), m * x)


def _semi_implicit(q: Array, x: Array, m: Array, passed: Array, highest: Array) -> Array:
    """Trapezoidal step; what a long one puts beyond the bound, or back, is held between q and the bound."""
    half = 0.5 * passed
    moved = ((1 - half) * q + m * x) / (1 + half)
    return jnp.clip(moved, jnp.minimum(q, highest), jnp.maximum(q, highest))


@jax.custom_jvp
def _trapezoid(h: Array, dv: Array, m: Array, up: Array, down: Array) -> Array:
    """h of `BoucWen` after a semi-implicit step.

    Its derivative is written out as one number for each argument: what JAX makes of it is some fifty times slower in a scan
    on a CPU, where a loop whose body touches more than about 1 kB is not compiled into one piece.
    """
    s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)
    q = s * h
    return s * _semi_implicit(q, x, m, passed_rates(q, x, m, up, down), _bound(m, up))


@_trapezoid.defjvp
def _trapezoid_slope(values: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    h, dv, m, up, down = values
    s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)
    q, new = s * h, _trapezoid(*values)
    below = _risen(q, x, m) / jnp.maximum(m, 1e-300)
    half = 0.5 * passed_rates(q, x, m, up, down)
    moved = ((1 - half) * q + m * x) / (1 + half)
    free = s * new == moved
    stays = ~free & (s * new == q)
    pinned = ~free & ~stays  # on the bound m / up
    safe, each = jnp.where(up > 0, up, 1.0), 1 / (1 + half)
    turn = jnp.where(free, -0.5 * s * (q + moved) * each, 0.0)  # by the integral of the rates
    cross = jnp.where((q < 0) & (-q < m * x), (up - down) / jnp.maximum(m, 1e-300), 0.0)
    rising = jnp.where(-q >= m * x, down, up)
    by_h = jnp.where(free, (1 - half) * each + s * turn * cross, jnp.where(stays, 1.0, 0.0))
    by_dv = jnp.where(free, m * each + s * turn * rising, 0.0)
    by_m = jnp.where(free, dv * each + turn * cross * below, jnp.where(pinned, s / safe, 0.0))
    by_up = turn * (x - below) + jnp.where(pinned, -new / safe, 0.0)
    by_down = turn * below
    h_dot, dv_dot, m_dot, up_dot, down_dot = tangents
    return new, by_h * h_dot + by_dv * dv_dot + by_m * m_dot + by_up * up_dot + by_down * down_dot


_SMALL = 1e-4  # argument below which four terms of a series are exact to rounding, in the derivatives too


def _phi(kappa: Array, x: Array) -> Array:
    """(1 - exp(-kappa x)) / kappa, and x where kappa vanishes."""
    k = kappa * x
    small = jnp.abs(k) < _SMALL
    safe = jnp.where(small, 1.0, kappa)
    return jnp.where(small, x * (1 - k / 2 * (1 - k / 3 * (1 - k / 4))), -jnp.expm1(-safe * x) / safe)


def _zero_crossing(kappa: Array, q: Array, m: Array) -> Array:
    """Way x from q < 0 to zero, log(1 + kappa |q| / m) / kappa, and |q| / m where kappa vanishes."""
    part = -q / jnp.where(m > 0, m, 1.0)
    k = kappa * part
    small = k < _SMALL
    safe = jnp.where(small, 1.0, kappa)
    series = part * (1 - k * (1 / 2 - k * (1 / 3 - k / 4)))
    return jnp.where(m > 0, jnp.where(small, series, jnp.log1p(safe * part) / safe), jnp.inf)


def _exact_step(q: Array, x: Array, m: Array, up: Array, down: Array) -> Array:
    """Closed form for n = 1: relax towards m / up above zero; below, rise with rate `down` until zero is crossed."""
    above = q + (m - up * q) * _phi(up, x)
    below = jnp.where(q < 0, q, -1.0)
    crossing = _zero_crossing(down, below, m)
    short = below + (m - down * below) * _phi(down, x)
    long = m * _phi(up, jnp.where(x > crossing, x - crossing, 0.0))
    return jnp.where(q >= 0, above, jnp.where(x > crossing, long, short))


def _power(base: Array, exponent: Array) -> Array:
    """base ** exponent with finite derivatives at base = 0 (a double where: craft of differentiable code, not physics)."""
    safe = jnp.where(base > 0, base, 1.0)
    return jnp.where(base > 0, jnp.exp(exponent * jnp.log(safe)), jnp.where(exponent > 0, 0.0, 1.0))


def _runge_kutta(slope: Callable[[Array], Array], q: Array, x: Array, substeps: int, highest: Array) -> Array:
    step = x / substeps
    hold = lambda q: jnp.minimum(q, highest)  # on a step too long for its order the stages stay within the bound

    def once(_: Array, q: Array) -> Array:
        k1 = slope(q)
        k2 = slope(hold(q + 0.5 * step * k1))
        k3 = slope(hold(q + 0.5 * step * k2))
        k4 = slope(hold(q + step * k3))
        return hold(q + step * (k1 + 2 * k2 + 2 * k3 + k4) / 6)

    return jax.lax.fori_loop(0, substeps, once, q)


def _coarse(scheme: str, rate: float, u: np.ndarray) -> tuple[str, ...]:
    largest = rate * float(np.max(np.abs(np.diff(u)), initial=0.0))
    if scheme == "exact" or largest <= COARSE:
        return ()
    return (
        f"the input moves by up to {largest:.2g} of the hysteresis' length in one sample: use scheme='exact' "
        f"(semi-implicit is trusted to {COARSE})",
    )


def _grid_start(records: Sequence[Record], degree: int) -> tuple[float, float, np.ndarray]:
    """Best (tau, rho) of a grid and the linear unknowns there: slope, factor of the unit hysteresis, offset, backbone 2, 3, ..."""
    place, records = input_range(records), thinned(records)
    tau, rho = (a.ravel() for a in np.meshgrid(np.geomspace(0.2, 30.0, 12) / place.half, [-0.6, 0.0, 0.6, 0.95]))
    states = [unit_hysteresis(record.u, tau, rho) for record in records]
    best: tuple[float, int, np.ndarray] | None = None
    for k in range(tau.size):
        rows, right = [], []
        for record, state in zip(records, states, strict=True):
            bend = np.polynomial.legendre.legvander((record.u - place.center) / place.half, degree + 1)[:, 2:]
            own = np.stack([record is other for other in records]).astype(float)  # an offset of its own for each record
            columns = np.column_stack([record.u, state[:, k], np.tile(own, (len(record), 1)), bend])
            rows.append(columns[record.used])
            right.append(record.y[record.used])
        theta, cost = fit_linear(np.concatenate(rows), np.concatenate(right))
        if best is None or cost < best[0]:
            best = (cost, k, theta)
    assert best is not None
    _, k, theta = best
    return float(tau[k]), float(rho[k]), np.concatenate([theta[:3], theta[2 + len(records) :]])


def unit_hysteresis(u: np.ndarray, tau: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """h / (mu c) of `BoucWen` for several (tau, rho > -1) at once, semi-implicit: shape (T, len(tau))."""
    state, out = np.zeros(tau.size), np.zeros((u.size, tau.size))
    highest = 1 / (tau * (1 + rho))
    for k, dv in enumerate(np.diff(u), start=1):
        below = np.clip(np.where(dv < 0, state, -state), 0.0, abs(dv))
        half = 0.5 * tau * ((1 + rho) * abs(dv) - 2 * rho * below)
        state = np.clip(((1 - half) * state + dv) / (1 + half), -highest, highest)
        out[k] = state
    return out
