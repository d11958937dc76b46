"""Polynomials in a normalized variable: Legendre series keep high orders well conditioned."""

from __future__ import annotations

import functools
import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import Legendre, Polynomial


def legendre_series(coefficients: Float[Array, " n"], x: Float[Array, "..."], first: int = 0) -> Float[Array, "..."]:
    """Sum of c_i P_(first + i)(x), by Clenshaw's recurrence (n is static)."""
    coefficients = jnp.concatenate([jnp.zeros(first, coefficients.dtype), coefficients])
    n = coefficients.shape[0]
    later, latest = jnp.zeros_like(x), jnp.zeros_like(x)
    for i in range(n - 1, 0, -1):
        latest, later = coefficients[i] + (2 * i + 1) / (i + 1) * x * latest - (i + 1) / (i + 2) * later, latest
    return coefficients[0] + x * latest - 0.5 * later if n > 1 else coefficients[0] + 0.0 * x


def rising_series(increments: Float[Array, " n"], x: Float[Array, "..."]) -> Float[Array, "..."]:
    """A polynomial of degree n with value 0 at x = 0 that never falls where the increments are >= 0.

    Its Bernstein coefficients are the cumulative sums of the increments; outside 0 <= x <= 1 it continues as its tangent.
    """
    n = increments.shape[0]
    if n == 0:
        return jnp.zeros_like(x)
    within = jnp.clip(x, 0.0, 1.0)
    level, y = jnp.zeros_like(increments[0]), jnp.zeros_like(x)
    for k in range(1, n + 1):
        level = level + increments[k - 1]
        y = y + math.comb(n, k) * level * within**k * (1.0 - within) ** (n - k)
    return y + n * (increments[-1] * jnp.maximum(x - 1.0, 0.0) + increments[0] * jnp.minimum(x, 0.0))


def rising_slope(increments: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Derivative of `rising_series`: the Bernstein polynomial of degree n - 1 with n times the increments as coefficients."""
    n, within = increments.size, np.clip(x, 0.0, 1.0)
    terms = (math.comb(n - 1, k) * within**k * (1.0 - within) ** (n - 1 - k) * increments[k] for k in range(n))
    return n * sum(terms, np.zeros_like(within))


def derivative_matrix(n: int) -> np.ndarray:
    """Matrix that maps the n Legendre coefficients of a series to those of its derivative, shape (n, n)."""
    columns = [np.zeros(n)]
    for i in range(1, n):
        d = Legendre.basis(i).deriv().coef
        columns.append(np.pad(d, (0, n - d.size)))
    return np.stack(columns, axis=1)


def legendre_to_powers(coefficients: np.ndarray, center: float, half: float) -> np.ndarray:
    """Coefficients of 1, v, v^2, ... of a Legendre series in (v - center) / half."""
    return legendre_powers(len(coefficients), center, half) @ np.asarray(coefficients, float)


@functools.lru_cache(maxsize=256)
def legendre_powers(n: int, center: float, half: float) -> np.ndarray:
    """Matrix that maps n coefficients of a Legendre series in (v - center) / half to those of 1, v, v^2, ..., shape (n, n)."""
    matrix = np.zeros((n, n))
    for i in range(n):
        series = Legendre.basis(i, domain=[center - half, center + half])
        matrix[: i + 1, i] = series.convert(kind=Polynomial, domain=[-1, 1], window=[-1, 1]).coef
    matrix.setflags(write=False)
    return matrix


def powers_to_legendre(powers: np.ndarray, center: float, half: float) -> np.ndarray:
    """Legendre coefficients in (v - center) / half of a polynomial given by its powers of v."""
    polynomial = Polynomial(np.asarray(powers, float), domain=[-1, 1], window=[-1, 1])
    series = polynomial.convert(kind=Legendre, domain=[center - half, center + half])
    return np.pad(series.coef, (0, len(powers) - series.coef.size))
