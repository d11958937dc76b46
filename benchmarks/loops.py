"""Plain numba loops of the shipped models, one function a model: what a user without hystfit would write."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.polynomial import Polynomial

import hystfit as hf

Loop = Callable[[np.ndarray, np.ndarray], np.ndarray]


@numba.njit
def bouc_wen(u, dt, c, mu, tau, rho, h, offset):
    m, up, down = mu * c, tau * (1 + rho), tau * (1 - rho)
    highest = m / up
    y = np.empty(u.size)
    before = u[0]
    for k in range(u.size):
        dv = u[k] - before
        before = u[k]
        s, x = (-1.0, -dv) if dv < 0 else (1.0, dv)
        q = s * h
        half = 0.5 * (up * x + (down - up) / m * min(max(-q, 0.0), m * x))
        new = ((1 - half) * q + m * x) / (1 + half)
        h = s * min(max(new, min(q, highest)), max(q, highest))
        y[k] = offset + c * u[k] - h
    return y


@numba.njit
def bouc_wen_exact(u, dt, c, mu, tau, rho, h, offset):
    m, up, down = mu * c, tau * (1 + rho), tau * (1 - rho)
    y = np.empty(u.size)
    before = u[0]
    for k in range(u.size):
        dv = u[k] - before
        before = u[k]
        s, x = (-1.0, -dv) if dv < 0 else (1.0, dv)
        q = s * h
        if q < 0:
            crossing = np.log1p(-down * q / m) / down
            if x < crossing:
                q += (m / down - q) * -np.expm1(-down * x)
            else:
                q = m / up * -np.expm1(-up * (x - crossing))
        else:
            q += (m / up - q) * -np.expm1(-up * x)
        h = s * q
        y[k] = offset + c * u[k] - h
    return y


@numba.njit
def legendre(b, x):
    later, latest = 0.0, 0.0
    for i in range(b.size - 1, 0, -1):
        latest, later = b[i] + (2 * i + 1) / (i + 1) * x * latest - (i + 1) / (i + 2) * later, latest
    return b[0] + x * latest - 0.5 * later


@numba.njit
def asymmetric(u, dt, c, mu, tau, rho, n, skew, b, h, offset, center, half_width):
    m, total = mu * c, tau * (1 + rho)
    rising, falling = m / total * (1 + skew) ** (-1 / n), m / total * (1 - skew) ** (-1 / n)
    y = np.empty(u.size)
    before = u[0]
    for k in range(u.size):
        dv = u[k] - before
        before = u[k]
        s, x = (-1.0, -dv) if dv < 0 else (1.0, dv)
        q = s * h
        highest = rising if s > 0 else falling
        up, down = tau * (1 + rho) + s * skew * total, tau * (1 - rho) + s * skew * total
        rate = (up if q >= 0 else down) * (abs(q) * total / m) ** (n - 1)
        middle = min(q + 0.5 * x * (m - rate * q), max(q, highest))
        passed = up * x + (down - up) / m * min(max(-q, 0.0), m * x)
        half = 0.5 * passed * (abs(middle) * total / m) ** (n - 1)
        new = ((1 - half) * q + m * x) / (1 + half)
        h = s * min(max(new, min(q, highest)), max(q, highest))
        y[k] = offset + c * u[k] - h + legendre(b, (u[k] - center) / half_width)
    return y


@numba.njit
def force(u, dt, kappa_x, kappa_w, rho, sigma, n, w, offset, substeps):
    y = np.empty(u.size)
    before = u[0]
    for k in range(u.size):
        s = -1.0 if u[k] < before else 1.0
        x = abs(u[k] - before) / substeps
        before = u[k]
        q = s * w
        for _ in range(substeps):
            rate = 1.0 if q >= 0 else 2 * sigma - 1
            middle = min(q + 0.5 * rho * x * (1 - rate * abs(q) ** (n - 1) * q), 1.0)
            below = min(max(-q, 0.0), rho * x)
            half = 0.5 * abs(middle) ** (n - 1) * (rho * x + 2 * (sigma - 1) * below)
            q = max(min(((1 - half) * q + rho * x) / (1 + half), 1.0), q)
        w = s * q
        y[k] = offset + kappa_x * u[k] + kappa_w * w
    return y


@numba.njit
def duhem(u, dt, alpha, f, g, w, center, half):
    y = np.empty(u.size)
    before = u[0]
    for k in range(u.size):
        dv = u[k] - before
        x = (0.5 * (u[k] + before) - center) / half
        before = u[k]
        drive = alpha * abs(dv)
        w = ((1 - 0.5 * drive) * w + drive * legendre(f, x) + dv * legendre(g, x)) / (1 + 0.5 * drive)
        y[k] = w
    return y


@numba.njit
def slope(y, v, z, force, per_mass, c, k, kz, share, skew, n, per_force):
    size = abs(z) * per_force if n == 1.0 else (abs(z) * per_force) ** n
    along = share * abs(v) if z > 0 else -share * abs(v)
    return v, (force - c * v - k * y - z) * per_mass, kz * (v - (along + skew * v) * size)


@numba.njit
def oscillator(u, dt, m, c, K, a, r_load, r_unl, n, Z, offset, substeps):
    """Under a force that is linear between samples."""
    k, kz, share, skew = a * K, (1 - a) * K, 0.5 * (r_load + r_unl), 0.5 * (r_load - r_unl)
    m, Z = 1 / m, 1 / Z  # products, not quotients, in the loop
    out = np.empty(u.size)
    y = v = z = 0.0
    out[0] = offset
    for i in range(1, u.size):
        h = dt[i] / substeps
        for j in range(substeps):
            f0 = u[i - 1] + (u[i] - u[i - 1]) * j / substeps
            f1 = u[i - 1] + (u[i] - u[i - 1]) * (j + 1) / substeps
            middle = 0.5 * (f0 + f1)
            a1, b1, c1 = slope(y, v, z, f0, m, c, k, kz, share, skew, n, Z)
            g = 0.5 * h
            a2, b2, c2 = slope(y + g * a1, v + g * b1, z + g * c1, middle, m, c, k, kz, share, skew, n, Z)
            a3, b3, c3 = slope(y + g * a2, v + g * b2, z + g * c2, middle, m, c, k, kz, share, skew, n, Z)
            a4, b4, c4 = slope(y + h * a3, v + h * b3, z + h * c3, f1, m, c, k, kz, share, skew, n, Z)
            y += h * (a1 + 2 * a2 + 2 * a3 + a4) / 6
            v += h * (b1 + 2 * b2 + 2 * b3 + b4) / 6
            z += h * (c1 + 2 * c2 + 2 * c3 + c4) / 6
        out[i] = offset + y
    return out


@numba.njit
def oscillator_sinc(u, dt, weights, m, c, K, a, r_load, r_unl, n, Z, offset, substeps):
    """Under a band-limited force: `weights` has a row for each point between two samples."""
    k, kz, share, skew = a * K, (1 - a) * K, 0.5 * (r_load + r_unl), 0.5 * (r_load - r_unl)
    m, Z = 1 / m, 1 / Z  # products, not quotients, in the loop
    reach, parts = weights.shape[1] // 2, 2 * substeps
    padded = np.concatenate((np.full(reach - 1, u[0]), u, np.full(reach, u[-1])))
    out, f = np.empty(u.size), np.empty(parts + 1)
    y = v = z = 0.0
    out[0] = offset
    for i in range(1, u.size):
        f[0], f[parts] = u[i - 1], u[i]
        for p in range(parts - 1):
            total = 0.0
            for j in range(2 * reach):
                total += weights[p, j] * padded[i - 1 + j]
            f[p + 1] = total
        h = dt[i] / substeps
        for j in range(substeps):
            f0, middle, f1 = f[2 * j], f[2 * j + 1], f[2 * j + 2]
            a1, b1, c1 = slope(y, v, z, f0, m, c, k, kz, share, skew, n, Z)
            g = 0.5 * h
            a2, b2, c2 = slope(y + g * a1, v + g * b1, z + g * c1, middle, m, c, k, kz, share, skew, n, Z)
            a3, b3, c3 = slope(y + g * a2, v + g * b2, z + g * c2, middle, m, c, k, kz, share, skew, n, Z)
            a4, b4, c4 = slope(y + h * a3, v + h * b3, z + h * c3, f1, m, c, k, kz, share, skew, n, Z)
            y += h * (a1 + 2 * a2 + 2 * a3 + a4) / 6
            v += h * (b1 + 2 * b2 + 2 * b3 + b4) / 6
            z += h * (c1 + 2 * c2 + 2 * c3 + c4) / 6
        out[i] = offset + y
    return out


@numba.njit
def envelope(kind, x):
    if kind == 0:
        return x
    if kind == 1:
        return x * abs(x)
    return 1.0 - (1.0 - x) * abs(1.0 - x)


@numba.njit
def rising(powers, x):
    """A polynomial with coefficients of 1, x, x^2, ..., straight outside 0 <= x <= 1."""
    inside = min(max(x, 0.0), 1.0)
    y, slope = 0.0, 0.0
    for k in range(powers.size - 1, -1, -1):
        slope = slope * inside + y
        y = y * inside + powers[k]
    return y + slope * (x - inside)


@numba.njit
def plays(u, dt, w, r, b, powers, offset, hardening, s0, low, high, level, kinds, stops):
    count, many = w.shape
    p = np.empty((count, many))
    rest = (level - low) / (high - low)
    for e in range(count):
        p[e] = envelope(kinds[e], rest)
    before, path = rest, 0.0
    y = np.empty(u.size)
    for k in range(u.size):
        x = (u[k] - low) / (high - low)
        path += abs(x - before)
        before = x
        total, fading = 0.0, 0.0
        for e in range(count):
            target = envelope(kinds[e], x)
            for j in range(many):
                p[e, j] = max(target - r[j], min(target + r[j], p[e, j]))
                element = target - p[e, j] if stops else p[e, j]
                total += w[e, j] * element
                if e == 0 and hardening.size:
                    fading += hardening[j] * element
        y[k] = offset + total + legendre(b, 2 * x - 1) + rising(powers, x)
        if hardening.size:
            y[k] += np.exp(-path / s0) * fading
    return y


@numba.njit
def log_creep(u, dt, gamma, span, tau, weights, base):
    y = np.empty(u.size)
    z = np.empty(tau.size)
    for k in range(u.size):
        rate = 0.0
        for i in range(gamma.size - 1, -1, -1):
            rate = rate * (u[k] / span) + gamma[i]
        if k == 0 or dt[k] != dt[k - 1]:
            part = -np.expm1(-dt[k] / tau)
        if k == 0:
            z[:] = rate * weights * u[0]
        total = 0.0
        for i in range(tau.size):
            z[i] += part[i] * (rate * weights[i] * u[k] - z[i])
            total += z[i]
        y[k] = (1 - rate * base) * u[k] + total
    return y


@numba.njit
def linear_creep(u, dt, a, tau, low, high, level):
    y = np.empty(u.size)
    z = np.full(tau.size, (level - low) / (high - low))
    for k in range(u.size):
        x = (u[k] - low) / (high - low)
        if k == 0 or dt[k] != dt[k - 1]:
            part = -np.expm1(-dt[k] / tau)
        total = 0.0
        for i in range(tau.size):
            z[i] += part[i] * (x - z[i])
            total += a[i] * z[i]
        y[k] = total
    return y


@numba.njit
def relaxation(u, dt, a, tau):
    y = np.empty(u.size)
    z = np.full(tau.size, u[0])
    for k in range(u.size):
        if k == 0 or dt[k] != dt[k - 1]:
            part = -np.expm1(-dt[k] / tau)
        y[k] = u[k]
        for i in range(tau.size):
            z[i] += part[i] * (u[k] - z[i])
            y[k] -= a[i] * (u[k] - z[i])
    return y


@numba.njit
def delay(u, dt, lag, longest):
    y = np.empty(u.size)
    whole = int(np.floor(min(lag, longest)))
    part = min(lag, longest) - whole
    for k in range(u.size):
        y[k] = (1 - part) * u[max(k - whole, 0)] + (part * u[max(k - whole - 1, 0)] if part > 0 else 0.0)
    return y


@numba.njit
def lag(u, dt, tau, level):
    y = np.empty(u.size)
    first = second = level
    for k in range(u.size):
        if k == 0 or dt[k] != dt[k - 1]:
            passed = 2 * dt[k] / tau
            decay = np.exp(-passed)
        a, b = first - u[k], second - u[k]
        first, second = u[k] + decay * a, u[k] + decay * (b + passed * a)
        y[k] = second
    return y


@numba.njit
def second_order(u, dt, omega, zeta):
    """For zeta < 1."""
    y = np.empty(u.size)
    position, speed = u[0], 0.0
    damped = omega * np.sqrt(1 - zeta**2)
    before = u[0]
    y[0] = u[0]
    for k in range(1, u.size):
        h = dt[k]
        if k == 1 or h != dt[k - 1]:
            decay = np.exp(-zeta * omega * h)
            cos, sin = np.cos(damped * h), np.sin(damped * h) / damped
        rate = (u[k] - before) / h
        lagging = 2 * zeta / omega * rate
        p, v = position - (before - lagging), speed - rate
        position = u[k] - lagging + decay * (cos * p + sin * (v + zeta * omega * p))
        speed = rate + decay * (cos * v - sin * (omega**2 * p + zeta * omega * v))
        before = u[k]
        y[k] = position
    return y


@numba.njit
def rate(u, dt, force, v0, saturates):
    y = np.empty(u.size)
    last, before = 0.0, u[0]
    for k in range(u.size):
        if dt[k] > 0:
            last = (u[k] - before) / dt[k]
        before = u[k]
        y[k] = force * np.tanh(last / v0) if saturates else force * last
    return y


@numba.njit
def relays(u, dt, w, up, down, state, b, offset, center, half):
    """Every relay at every sample."""
    y = np.empty(u.size)
    for k in range(u.size):
        total = 0.0
        for i in range(w.size):
            if u[k] >= up[i]:
                state[i] = 1.0
            elif u[k] <= down[i]:
                state[i] = -1.0
            total += w[i] * state[i]
        y[k] = offset + total + legendre(b, (u[k] - center) / half)
    return y


def _values(model: Any, *names: str) -> tuple[Any, ...]:
    """Fields of a model as numbers and arrays."""
    values = (np.asarray(getattr(model, name)) for name in names)
    return tuple(float(v) if v.ndim == 0 else v for v in values)


def _bouc_wen(model: hf.BoucWen) -> Loop:
    loop = bouc_wen_exact if model.scheme == "exact" else bouc_wen
    values = _values(model, "c", "mu", "tau", "rho", "h0", "offset")
    return lambda u, dt: loop(u, dt, *values)


def _asymmetric(model: hf.AsymmetricBoucWen) -> Loop:
    values = _values(model, "c", "mu", "tau", "rho", "n", "skew", "b", "h0", "offset", "center", "half")
    values = (*values[:6], np.append([0.0, 0.0], values[6]), *values[7:])
    return lambda u, dt: asymmetric(u, dt, *values)


def _oscillator(model: hf.BoucWenOscillator) -> Loop:
    values = (*_values(model, "m", "c", "K", "a", "r_load", "r_unl", "n", "Z", "offset"), model.substeps)
    if model.between == "linear":
        return lambda u, dt: oscillator(u, dt, *values)
    weights = sinc_weights(2 * model.substeps)
    return lambda u, dt: oscillator_sinc(u, dt, weights, *values)


def sinc_weights(parts: int, reach: int = 24, shape: float = 8.0) -> np.ndarray:
    """Weights of the 2 reach samples around an interval at 1 / parts, 2 / parts, ... of it: sinc under a Kaiser window."""
    distance = np.arange(1, parts)[:, None] / parts - np.arange(1 - reach, reach + 1)
    weights = np.sinc(distance) * np.i0(shape * np.sqrt(1 - (distance / reach) ** 2))
    return weights / weights.sum(axis=1, keepdims=True)


def _plays(model: hf.PrandtlIshlinskii) -> Loop:
    w, r, b, rise, *rest = _values(model, "w", "r", "b", "rise", "offset", "hardening", "s0", "low", "high", "level")
    kinds = np.array([("identity", "square", "mirror").index(kind) for kind in model.envelopes])
    values = (w, r, np.append(0.0, b), bernstein_to_powers(np.append(0.0, np.cumsum(rise))), *rest)
    return lambda u, dt: plays(u, dt, *values, kinds, model.operator == "stop")


def bernstein_to_powers(coefficients: np.ndarray) -> np.ndarray:
    """Coefficients of 1, x, x^2, ... of a series of Bernstein polynomials."""
    n = coefficients.size - 1
    terms = (Polynomial([0, 1]) ** k * Polynomial([1, -1]) ** (n - k) * math.comb(n, k) for k in range(n + 1))
    return sum((c * term for c, term in zip(coefficients, terms, strict=True)), Polynomial([0])).coef


def _relays(model: hf.Preisach) -> Loop:
    n, levels = model.n, np.asarray(model.levels)
    i, j = np.tril_indices(n)
    w, b, *rest = _values(model, "w", "b", "offset", "center", "half")
    begun = np.where(levels[i] + levels[j] > 2 * float(model.center), -1.0, 1.0)
    return lambda u, dt: relays(u, dt, w, levels[i], levels[j], begun.copy(), np.append(0.0, b), *rest)


def _force(model: hf.BoucWenForce) -> Loop:
    values = _values(model, "kappa_x", "kappa_w", "rho", "sigma", "n", "w0", "offset")
    return lambda u, dt: force(u, dt, *values, model.substeps)


def _linear_creep(model: hf.LinearCreep) -> Loop:
    weights = np.broadcast_to(np.asarray(model.a), model.tau.shape).copy()
    values = _values(model, "tau", "low", "high", "level")
    return lambda u, dt: linear_creep(u, dt, weights, *values)


def _with(loop: Any, *names: str) -> Callable[[Any], Loop]:
    def made(model: Any) -> Loop:
        values = _values(model, *names)
        return lambda u, dt: loop(u, dt, *values)

    return made


OF: dict[type, Callable[[Any], Loop]] = {
    hf.BoucWen: _bouc_wen,
    hf.AsymmetricBoucWen: _asymmetric,
    hf.BoucWenForce: _force,
    hf.Duhem: _with(duhem, "alpha", "f", "g", "w0", "center", "half"),
    hf.BoucWenOscillator: _oscillator,
    hf.PrandtlIshlinskii: _plays,
    hf.Preisach: _relays,
    hf.LogCreep: _with(log_creep, "gamma", "span", "tau", "weights", "base"),
    hf.LinearCreep: _linear_creep,
    hf.Relaxation: _with(relaxation, "a", "tau"),
    hf.Delay: lambda model: lambda u, dt: delay(u, dt, float(model.lag), float(model.longest)),
    hf.Lag: _with(lag, "tau", "level"),
    hf.SecondOrder: _with(second_order, "omega", "zeta"),
    hf.Viscous: lambda model: lambda u, dt: rate(u, dt, float(model.c), 1.0, False),
    hf.SaturatingRate: lambda model: lambda u, dt: rate(u, dt, float(model.F), float(model.v0), True),
}


def loop_of(model: hf.AbstractHysteresis) -> Loop:
    """The plain loop of a model or composition: output from input and time steps, both of shape (T,)."""
    if isinstance(model, hf.Series):
        parts = [loop_of(part) for part in model.parts]

        def chained(u: np.ndarray, dt: np.ndarray) -> np.ndarray:
            for part in parts:
                u = part(u, dt)
            return u

        return chained
    return OF[type(model)](model)
