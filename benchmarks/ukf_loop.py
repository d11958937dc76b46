"""A plain numba loop of the unscented filter of `ukf.py`, in covariance form: what a user without hystfit would write."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numba
import numpy as np


@numba.njit
def _physical(z, low, high, scale, kind):
    if kind == 0:
        return scale * z
    if kind == 1:
        return low + scale * math.exp(z)
    if kind == 2:
        return high - scale * math.exp(z)
    part = (high - low) * math.exp(-abs(z)) / (1 + math.exp(-abs(z)))
    return low + part if z < 0 else high - part


@numba.njit
def _step(point, x, u0, u1, decay):
    slope, mu, tau, rho, offset, weight = x
    s = -1.0 if u1 < u0 else 1.0
    q, way, limit = s * point[0], abs(u1 - u0), mu * slope
    below = min(-q / limit, way) if q < 0 else 0.0
    half = 0.5 * tau * ((1 + rho) * way - 2 * rho * below)
    h = s * ((1 - half) * q + limit * way) / (1 + half)
    creep = point[1] + decay * (u1 / 100.0 - point[1])
    return h, creep, offset + slope * u1 - h + weight * creep


@numba.njit
def _filter(u, y, mean, root, walk, noise, maps, kinds, decay, spread, center):
    n = mean.size
    m = 2 * n + 1
    points, out, x, gain, covariance = np.empty((m, n)), np.empty(m), np.empty(n - 2), np.empty(n), np.empty((n, n))
    w, w0, wide = 0.5 / spread, 1 - n / spread, math.sqrt(spread)
    mean, root, before = mean.copy(), root.copy(), u[0]
    for t in range(u.size):
        for j in range(n):
            points[0, j] = mean[j]
            for i in range(n):
                points[1 + i, j] = mean[j] + wide * root[j, i]
                points[1 + n + i, j] = mean[j] - wide * root[j, i]
        for k in range(m):
            for j in range(n - 2):
                x[j] = _physical(points[k, 2 + j], maps[0, j], maps[1, j], maps[2, j], kinds[j])
            points[k, 0], points[k, 1], out[k] = _step(points[k], x, before, u[t], decay)
        predicted = w0 * out[0] + w * out[1:].sum()
        variance = noise**2
        for j in range(n):
            total = w0 * points[0, j]
            for k in range(1, m):
                total += w * points[k, j]
            mean[j] = total
        for k in range(m):
            out[k] -= predicted
            variance += (center if k == 0 else w) * out[k] ** 2
            for j in range(n):
                points[k, j] -= mean[j]
        for j in range(n):
            total = center * points[0, j] * out[0]
            for k in range(1, m):
                total += w * points[k, j] * out[k]
            gain[j] = total / variance
        for i in range(n):
            for j in range(i + 1):
                covariance[i, j] = center * points[0, j] * points[0, i] - gain[i] * gain[j] * variance
        for k in range(1, m):
            for i in range(n):
                weighted = w * points[k, i]
                for j in range(i + 1):
                    covariance[i, j] += weighted * points[k, j]
        for j in range(n):  # Cholesky, with the process noise of the coming step
            mean[j] += gain[j] * (y[t] - predicted)
            total = covariance[j, j] + walk[j] ** 2
            for k in range(j):
                total -= root[j, k] ** 2
            root[j, j] = math.sqrt(total)
            for i in range(j + 1, n):
                total = covariance[i, j]
                for k in range(j):
                    total -= root[i, k] * root[j, k]
                root[i, j] = total / root[j, j]
                root[j, i] = 0.0
        before = u[t]
    return mean


def loop(ukf: Any, record: Any) -> Callable[[], np.ndarray]:
    """A call that runs the filter over a record of evenly spaced samples and returns the final mean."""
    state, c = ukf.restart(ukf.init(), jnp.asarray(record.u[0])), ukf.coordinates
    maps = np.nan_to_num(np.stack([np.asarray(v) for v in (c.lower, c.upper, c.scale)]))
    decay = -math.expm1(-float(np.median(record.dt)) / 1.0)
    settings = (np.asarray(ukf.walk), float(ukf.noise), maps, np.array(c.kinds), decay)
    scheme = (ukf.scheme.spread, ukf.scheme.central_weight)
    return lambda: _filter(record.u, record.y, np.asarray(state.mean), np.asarray(state.root), *settings, *scheme)
