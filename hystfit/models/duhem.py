"""The polynomial Duhem model (Coleman-Hodgdon form; Zhou and Wang 2013, eqs. (1) to (3))."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import block_diag

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.polynomial import derivative_matrix, legendre_series, legendre_to_powers, powers_to_legendre
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.slopes import CYCLES, POINTS, Slopes
from hystfit.models.shared.starting import first_output, fit_linear, input_range, thinned
from hystfit.params.param import param
from hystfit.quality.host_operators import recursion
from hystfit.quality.loops import largest_step
from hystfit.quality.needs import Needs

Scheme = Literal["midpoint", "explicit", "exact"]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_LONG = 8.0  # alpha |dv| up to which the quadrature is exact to rounding
_UNSTABLE = 2.0  # alpha |dv| from which an explicit step enlarges a deviation
_ALTERNATES = {"explicit": 1.0, "midpoint": 2.0}  # alpha |dv| above which a step reverses a deviation


class Duhem(AbstractHysteresis):
    """Duhem hysteresis with polynomial f and g:  dw/dv = s alpha [f(v) - w] + g(v),  s = sign(dv).

    f and g are Legendre series in (v - center) / half, so that high orders stay well conditioned; their orders are the
    lengths of the coefficient arrays less one (3 and 2 in the paper). `from_powers` and `powers` go to and from the
    paper's powers of v. The output is linear in f, g and w0. The state is the output w alone (local memory).

    `scheme` is used for fitting and simulation alike: "midpoint" (closed form, second order, unconditionally stable),
    "explicit" (first order, stable for alpha |dv| < 2), or "exact" (integrates each sample exactly, for coarse sampling).

    Raises:
        ModelError: an unknown scheme.
    """

    rate_independent: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"scheme": get_args(Scheme)}
    needs: ClassVar[Needs] = Needs(
        amplitudes=2, too_few="f and g are observed on one pair of branches, where they trade off"
    )

    alpha: Scalar = param(
        1.0, bounds=(0.0, np.inf), unit="1/u", scale=2.0, doc="rate of approach to f; 1/alpha is the range of memory"
    )
    f: Float[Array, " m"] = param(
        (0.0, 1.0, 0.0, 0.0), unit="y", doc="anhysteretic curve, Legendre coefficients", linear=True
    )
    g: Float[Array, " n"] = param(
        (0.5, 0.0, 0.0), unit="y/u", doc="slope at reversal, Legendre coefficients", linear=True
    )
    w0: Scalar = param(0.0, unit="y", per_record=True, doc="output at the first sample", linear=True)
    center: Scalar = param(0.0, unit="u", fixed=True, doc="middle of the input range of f and g")
    half: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="half of the input range of f and g")
    scheme: Scheme = eqx.field(static=True, default="midpoint")

    @classmethod
    def of_order(cls, f: int = 3, g: int = 2, scheme: Scheme = "midpoint") -> Duhem:
        """A model with polynomials of given orders.

        Args:
            f: order of the anhysteretic curve.
            g: order of the slope at reversal.
            scheme: of integration.

        Raises:
            ModelError: a negative order, or an unknown scheme.
        """
        if f < 0 or g < 0:
            raise ModelError(f"orders of polynomials are 0 or more, got {f} and {g}")
        return cls(f=np.eye(f + 1)[min(f, 1)], g=0.5 * np.eye(g + 1)[0], scheme=scheme)

    def settings(self) -> dict[str, int | bool | str]:
        return {"f": self.f.shape[0] - 1, "g": self.g.shape[0] - 1, "scheme": self.scheme}

    @classmethod
    def from_powers(
        cls,
        alpha: float,
        f: Sequence[float] | np.ndarray,
        g: Sequence[float] | np.ndarray,
        low: float,
        high: float,
        **fields: object,
    ) -> Duhem:
        """A model from the paper's coefficients of 1, v, v^2, ...

        Args:
            alpha: rate of approach to f [1/u].
            f: coefficients of f, shape (m,) [y].
            g: coefficients of g, shape (n,) [y/u].
            low: lowest input [u].
            high: highest input [u].
            **fields: values of other fields.
        """
        center, half = 0.5 * (low + high), 0.5 * (high - low)
        series = [powers_to_legendre(np.asarray(c), center, half) for c in (f, g)]
        return cls(alpha=alpha, f=series[0], g=series[1], center=center, half=half, **fields)

    def powers(self) -> tuple[np.ndarray, np.ndarray]:
        """The paper's coefficients (f_i, g_j) of 1, v, v^2, ..."""
        place = float(self.center), float(self.half)
        return legendre_to_powers(np.asarray(self.f), *place), legendre_to_powers(np.asarray(self.g), *place)

    def init(self, u0: Scalar) -> State:
        """State: the output w, shape (1,)."""
        return self.w0[None] + 0.0 * u0

    def curves(self, v: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """f(v) and g(v)."""
        x = (v - self.center) / self.half
        return legendre_series(self.f, x), legendre_series(self.g, x)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample of the branch that the input is on."""
        w = state[0]
        if self.scheme == "exact":
            w = self._exact(w, u0, u1)
        else:
            dv = u1 - u0
            drive = self.alpha * jnp.abs(dv)
            f, g = self.curves(0.5 * (u0 + u1))
            if self.scheme == "midpoint":
                w = ((1 - 0.5 * drive) * w + drive * f + dv * g) / (1 + 0.5 * drive)
            else:
                w = w + drive * (f - w) + dv * g
        return w[None], w

    def _exact(self, w: Array, u0: Array, u1: Array) -> Array:
        dv = u1 - u0
        drive = self.alpha * jnp.abs(dv)
        # Gauss quadrature of the variation of constants is exact to rounding while the exponential is tame ...
        nodes, weights = jnp.asarray(_NODES, dv.dtype), jnp.asarray(_WEIGHTS, dv.dtype)
        f, g = self.curves(u0 + 0.5 * (1 + nodes) * dv)
        fading = jnp.exp(-0.5 * (1 - nodes) * jnp.minimum(drive, _LONG))
        short = jnp.exp(-drive) * w + 0.5 * jnp.sum(weights * fading * (drive * f + dv * g))
        # ... and on a long step the polynomial particular solution is: its terms, derivatives over powers of alpha, no
        # longer cancel.
        kappa = jnp.where(drive > _LONG, jnp.sign(dv) * self.alpha, 1.0)
        long = self._particular(u1, kappa) + jnp.exp(-drive) * (w - self._particular(u0, kappa))
        return jnp.where(drive > _LONG, long, short)

    def _particular(self, v: Array, kappa: Array) -> Array:
        """Polynomial solution of dw/dv = kappa (f - w) + g: the sum over k of (-1/kappa)^k q^(k) with q = f + g / kappa."""
        size = max(self.f.shape[0], self.g.shape[0])
        pad = lambda c: jnp.concatenate([c, jnp.zeros(size - c.shape[0], c.dtype)])
        q = pad(self.f) + pad(self.g) / kappa
        slope = jnp.asarray(derivative_matrix(size)) / self.half
        x, total = (v - self.center) / self.half, jnp.zeros_like(v)
        for _ in range(size):
            total = total + legendre_series(q, x)
            q = -(slope @ q) / kappa
        return total

    def prepared(self, record: Record) -> Record:
        """As it is: the first output is a parameter of the model."""
        return record

    def start(self, records: Sequence[Record]) -> Duhem:
        """Integrated regression: at a given rate the simulated output is linear in f, g and w0; the best of several rates wins.

        Regressing increments on the measured output instead would let its noise, larger than most increments, bias the rate.
        """
        place, records = input_range(records), thinned(records)
        fits: list[tuple[float, float, np.ndarray]] = []  # cost, rate, coefficients
        m, n = self.f.shape[0], self.g.shape[0]
        for rate in np.geomspace(0.3, 100.0, 15) / place.half:
            parts = [_responses(record, place, m, n, rate) for record in records]
            rows = np.concatenate([columns[:, : m + n] for columns, _ in parts])
            # Of each record's first output.
            own = np.asarray(block_diag(*(columns[:, m + n :] for columns, _ in parts)))
            theta, cost = fit_linear(np.concatenate([rows, own], axis=1), np.concatenate([y for _, y in parts]))
            fits.append((cost, rate, theta))
        _, rate, theta = min(fits, key=lambda fit: fit[0])
        curves = {"f": theta[:m], "g": theta[m : m + n], "center": place.center, "half": place.half}
        return dataclasses.replace(self, alpha=rate, w0=first_output(records[0]), **curves)

    def reach(self) -> tuple[float, float]:
        """A quarter of half the range beyond the range of f and g."""
        center, half = float(self.center), float(self.half)
        return center - 1.25 * half, center + 1.25 * half

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Where a step is too long for the scheme: beyond its stable range, or so that the error alternates in sign."""
        largest = largest_step(u)
        drive = float(self.alpha) * largest
        remedy = (
            "sample faster, or take the exact step (scheme='exact'; at the shell :scheme=exact after the model's name)"
        )
        if self.step_ratio(largest) <= 1:
            return ()
        if self.scheme == "explicit" and drive >= _UNSTABLE:
            return (
                f"alpha |dv| reaches {drive:.2g} in one sample, and the explicit step is stable below {_UNSTABLE:g}: {remedy}",
            )
        return (f"alpha |dv| reaches {drive:.2g} in one sample, where the error of each step changes sign: {remedy}",)

    def step_ratio(self, largest: Any) -> Any:
        return np.asarray(self.alpha) * largest / _ALTERNATES.get(self.scheme, np.inf)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes:
        """Those on both sides of each branch of the loop over the whole range, between which all others run."""
        v = np.linspace(low, high, POINTS)
        f, g = (np.asarray(curve) for curve in self.curves(jnp.asarray(v)))
        alpha, w, found = float(self.alpha), float(f[0]), []
        drive = alpha * (v[1] - v[0])
        for cycle in range(CYCLES):
            for order in (1, -1):
                rates, curve = order * g[::order] * (v[1] - v[0]), f[::order]
                branch = np.empty(v.size)
                branch[0] = w
                for k in range(v.size - 1):
                    # At the middle of a step, as the midpoint scheme.
                    pull, push = 0.5 * (curve[k] + curve[k + 1]), 0.5 * (rates[k] + rates[k + 1])
                    w = ((1 - 0.5 * drive) * w + drive * pull + push) / (1 + 0.5 * drive)
                    branch[k + 1] = w
                if cycle == CYCLES - 1:
                    found += [side * alpha * (curve - branch) + g[::order] for side in (1, -1)]
        return Slopes.of(*found)

    def c_part(self) -> CPart:
        """All schemes are in one template; tables of the exact one are written where it is used."""
        values: dict[str, Any] = {"exact": self.scheme == "exact", "explicit": self.scheme == "explicit"}
        if self.scheme == "exact":
            size = max(self.f.shape[0], self.g.shape[0])
            padded = [np.pad(np.asarray(c), (0, size - c.shape[0])) for c in (self.f, self.g)]
            values |= {"f_padded": padded[0], "g_padded": padded[1], "nodes": _NODES, "weights": _WEIGHTS}
            values |= {"long": _LONG, "derivative": derivative_matrix(size) / float(self.half)}
        return CPart.of(self, "duhem", **values)


def _responses(
    record: Record, place: tuple[float, float], m: int, n: int, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Midpoint responses to each coefficient of f and g and to the first output, at a given rate; and the measured output."""
    center, half = place
    v, used = record.u, record.used
    dv = np.diff(v)
    x = (0.5 * (v[1:] + v[:-1]) - center) / half
    drive = rate * np.abs(dv)
    f = np.polynomial.legendre.legvander(x, m - 1) * drive[:, None]
    g = np.polynomial.legendre.legvander(x, n - 1) * dv[:, None]
    forcing = np.concatenate([f, g], axis=1) / (1 + 0.5 * drive)[:, None]
    decay = (1 - 0.5 * drive) / (1 + 0.5 * drive)
    sides = np.zeros((v.size, m + n + 1))
    sides[0, -1], sides[1:, :-1] = 1.0, forcing
    columns = recursion((1.0, -np.append(decay, 0.0)), sides)
    return columns[used], record.y[used]
