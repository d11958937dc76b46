"""One step of Bouc-Wen's law dq/dx = m - kappa q, with kappa = `up` above zero and `down` below.

Arguments throughout: q = s h the state in the direction s of motion [y], x = |dv| the way [u], m = mu c the slope at q = 0 [y/u], `up`
and `down` rates [1/u], `highest` the bound of q [y].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array

from hystfit.errors import ModelError

Scheme = Literal["semi-implicit", "exact"]
SUBSTEPS = 2  # of a sample, by default
_TRUSTED = 0.25  # yield displacements in one substep up to which the error stays near 0.1 % of the range


def check_substeps(substeps: int) -> None:
    """Refuse a model without substeps."""
    if substeps < 1:
        raise ModelError(f"at least one substep per sample is needed, got {substeps}")


def substep_advice(largest: float, substeps: int) -> tuple[str, ...]:
    """Advice where the largest step of the input, in yield displacements, is too long for the substeps."""
    needed = math.ceil(largest / _TRUSTED)
    if needed <= substeps:
        return ()
    return (
        f"the input moves by up to {largest:.2g} yield displacements in one sample, and {substeps} substeps are accurate up to "
        f"{_TRUSTED * substeps:.2g}: sample faster, or take more (substeps={needed}; at the shell :substeps={needed} after "
        "the model's name)",
    )


def bound(m: Array, up: Array, factor: Array | float = 1.0) -> Array:
    """Saturation level of q, m / up times a factor; infinite where nothing saturates."""
    return jnp.where(up > 0, m * factor / jnp.where(up > 0, up, 1.0), jnp.inf)


def initial_hysteresis(part: Array, lowest: Array, highest: Array) -> Array:
    """State at the first sample, given as a fraction of its bound; 0 where nothing saturates.

    As a part of the bound it stays inside the loop whatever the other parameters are, so that it can be fitted.
    """
    side = jnp.where(part < 0, -lowest, highest)
    return part * jnp.where(jnp.isfinite(side), side, 0.0)


def rate_integral(q: Array, x: Array, m: Array, up: Array, down: Array) -> Array:
    """Integral of kappa over a step, with q rising by m: `down` until it reaches zero, `up` beyond.

    This makes the step continuous in its arguments. A kappa chosen by the sign of q at the start of the step would jump where q
    passes zero, and a sharp likelihood would have many small steps.
    """
    return up * x + over(down - up, m) * rise_below_zero(q, x, m)


def rise_below_zero(q: Array, x: Array, m: Array) -> Array:
    """The part of the rise m x of q that lies below zero."""
    return jnp.minimum(jnp.maximum(-q, 0.0), m * x)


def middle_size(middle: Array, rise: Array) -> Array:
    """|q| in the middle of a step, of which a power is taken: at least its mean over a step through zero, where q rises by `rise`.

    A power below zero is infinite at q = 0, and fits ended where the middle of a step was within 1e-9 of it.
    """
    return jnp.maximum(jnp.abs(middle), 0.25 * rise)


def over(value: Array, m: Array) -> Array:
    """value / m, or 0 where m vanishes, with finite derivatives."""
    return jnp.where(m > 0, value / jnp.where(m > 0, m, 1.0), 0.0)


def semi_implicit(q: Array, x: Array, m: Array, passed: Array, highest: Array) -> Array:
    """Trapezoidal step, clipped between q and its bound where the step is too long."""
    half = 0.5 * passed
    return _held(((1 - half) * q + m * x) / (1 + half), q, highest)


def _held(moved: Array, q: Array, highest: Array) -> Array:
    """The step from q to `moved`, clipped between q and its bound.

    On the bound q, the bound and the step agree. A selection takes the derivative of one of them there; those of `clip` are mixed, and
    for long steps they grow from sample to sample without limit.
    """
    low, high = _range(q, highest)
    return jnp.where(moved >= high, high, jnp.where(moved <= low, low, moved))


def _range(q: Array, highest: Array) -> tuple[Array, Array]:
    """q and its bound, the lower one first."""
    below = q <= highest
    return jnp.where(below, q, highest), jnp.where(below, highest, q)


@jax.custom_jvp
def trapezoid(h: Array, dv: Array, m: Array, up: Array, down: Array) -> Array:
    """h of `BoucWen` after a semi-implicit step.

    Its derivative is written out as one number for each argument: what JAX makes of it is some fifty times slower in a scan
    on a CPU, where a loop whose body touches more than about 1 kB is not compiled into one piece.
    """
    s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)
    q = s * h
    return s * _held(_unheld(q, x, m, up, down), q, bound(m, up))


def _unheld(q: Array, x: Array, m: Array, up: Array, down: Array) -> Array:
    """q after a trapezoidal step: of the rate above zero, of that below, and of both where it crosses zero.

    What the first two need of the way is known before q is, so that the next sample does not wait for their divisions.
    """
    above, below = 0.5 * up * x, 0.5 * down * x
    each_above, each_below = 1 / (1 + above), 1 / (1 + below)
    rise = m * x
    crossing = above - 0.5 * over(down - up, m) * q
    crossed = ((1 - crossing) * q + rise) / (1 + crossing)
    risen = (1 - above) * each_above * q + rise * each_above
    rising = (1 - below) * each_below * q + rise * each_below
    return jnp.where(q >= 0, risen, jnp.where(-q < rise, crossed, rising))


@trapezoid.defjvp
def _trapezoid_slope(values: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    h, dv, m, up, down = values
    s, x = jnp.where(dv < 0, -1.0, 1.0), jnp.abs(dv)
    # Three divisions in all: with one for each use lanes took 35 ns a sample, and with these 28.
    each_m, each_up = over(jnp.ones_like(m), m), 1 / jnp.where(up > 0, up, 1.0)
    q, rise, slope = s * h, m * x, (down - up) * each_m
    risen = rise_below_zero(q, x, m)
    half, below = 0.5 * (up * x + slope * risen), risen * each_m
    each = 1 / (1 + half)
    moved = ((1 - half) * q + rise) * each
    low, high = _range(q, jnp.where(up > 0, m * each_up, jnp.inf))
    above, short = moved > high, moved < low
    new = s * jnp.where(above, high, jnp.where(short, low, moved))
    free, stays = ~(above | short), (above & (high == q)) | (short & (low == q))
    pinned = jnp.where(free | stays, 0.0, each_up)  # on the bound m / up
    each = jnp.where(free, each, 0.0)
    turn = -0.5 * s * (q + moved) * each  # by the integral of the rates
    cross = jnp.where((q < 0) & (-q < rise), -slope, 0.0)
    rising = jnp.where(-q >= rise, down, up)
    by_h = (1 - half) * each + s * turn * cross + jnp.where(stays, 1.0, 0.0)
    by_dv = m * each + s * turn * rising
    by_m = dv * each + turn * cross * below + s * pinned
    by_up, by_down = turn * (x - below) - new * pinned, turn * below
    h_dot, dv_dot, m_dot, up_dot, down_dot = tangents
    return new, by_h * h_dot + by_dv * dv_dot + by_m * m_dot + by_up * up_dot + by_down * down_dot


_SMALL = 1e-4  # argument below which four terms of a series are exact to rounding, in the derivatives too


def phi(kappa: Array, x: Array) -> Array:
    """(1 - exp(-kappa x)) / kappa, and x where kappa vanishes."""
    k = kappa * x
    small = jnp.abs(k) < _SMALL
    safe = jnp.where(small, 1.0, kappa)
    return jnp.where(small, x * (1 - k / 2 * (1 - k / 3 * (1 - k / 4))), -jnp.expm1(-safe * x) / safe)


def zero_crossing(kappa: Array, q: Array, m: Array) -> Array:
    """Way x from q < 0 to zero, log(1 + kappa |q| / m) / kappa, and |q| / m where kappa vanishes."""
    part = -q / jnp.where(m > 0, m, 1.0)
    k = kappa * part
    small = k < _SMALL
    safe = jnp.where(small, 1.0, kappa)
    series = part * (1 - k * (1 / 2 - k * (1 / 3 - k / 4)))
    return jnp.where(m > 0, jnp.where(small, series, jnp.log1p(safe * part) / safe), jnp.inf)


def exact_step(q: Array, x: Array, m: Array, up: Array, down: Array, phis: tuple[Array, Array]) -> Array:
    """Closed form for n = 1: relax towards m / up above zero; below, rise with rate `down` until zero is crossed.

    `phis` are `phi(up, x)` and `phi(down, x)`, which depend on no state: a simulation computes them for all steps at once.
    """
    below = q < 0
    moved = q + (m - jnp.where(below, down, up) * q) * jnp.where(below, phis[1], phis[0])

    def crossed() -> Array:
        crossing = zero_crossing(down, jnp.where(below, q, -1.0), m)
        return m * phi(up, jnp.where(x > crossing, x - crossing, 0.0))

    # Few steps cross zero: a branch, not a selection, spares the others the logarithm and the exponential.
    return jax.lax.cond(below & (moved > 0), crossed, lambda: moved)


def power_of(base: Array, exponent: Array) -> Array:
    """base ** exponent with finite derivatives at base = 0, and without exponential and logarithm where the exponent is 0."""
    return jax.lax.cond(exponent == 0.0, zeroth_power, any_power, base, exponent)


def any_power(base: Array, exponent: Array) -> Array:
    """base ** exponent for base >= 0, with finite derivatives at zero."""
    safe = jnp.where(base > 0, base, 1.0)
    return jnp.where(base > 0, jnp.exp(exponent * jnp.log(safe)), jnp.where(exponent > 0, 0.0, 1.0))


@jax.custom_jvp
def zeroth_power(base: Array, exponent: Array) -> Array:
    """base ** 0; the logarithm is in the derivative by the exponent alone."""
    return jnp.ones_like(base)


def _zeroth_power_slope(values: tuple[Array, Array], tangents: tuple[Any, Any]) -> tuple[Array, Array]:
    base, _ = values
    by_exponent = tangents[1]
    if isinstance(by_exponent, jax.custom_derivatives.SymbolicZero):
        return jnp.ones_like(base), jnp.zeros_like(base)
    return jnp.ones_like(base), jnp.where(base > 0, jnp.log(jnp.where(base > 0, base, 1.0)), 0.0) * by_exponent


zeroth_power.defjvp(_zeroth_power_slope, symbolic_zeros=True)


def runge_kutta(slope: Callable[[Array], Array], q: Array, x: Array, substeps: int, highest: Array) -> Array:
    """The classical method of fourth order, each stage held at the bound."""
    step = x / substeps
    hold = lambda q: jnp.minimum(q, highest)  # on a step too long for its order the stages stay within the bound

    def once(_: Array, q: Array) -> Array:
        k1 = slope(q)
        k2 = slope(hold(q + 0.5 * step * k1))
        k3 = slope(hold(q + 0.5 * step * k2))
        k4 = slope(hold(q + step * k3))
        return hold(q + step * (k1 + 2 * k2 + 2 * k3 + k4) / 6)

    return jax.lax.fori_loop(0, substeps, once, q)
