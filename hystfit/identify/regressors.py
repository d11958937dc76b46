"""Scaled regressors of the polynomial Duhem model: one step of it as a linear equation in its parameters.

With x = (v - center) / half, W = (w - shift) / size, a = |dv| / step and d = dv / step, one step reads

    (half / step) dW = phi . theta,     phi = [a P_0(x), ..., a P_m(x), -a W, d P_0(x), ..., d P_n(x)],

theta = [alpha f_i, alpha, g_j] in these units, P_i the Legendre polynomials and x taken at the middle of the step
(Zhou and Wang 2013, eqs. (4) and (5), with the sign of the regressor of alpha put right). All columns are of order one, so that
single precision serves, and orders well above the paper's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.duhem import Duhem
from hystfit.models.polynomial import legendre_to_powers, powers_to_legendre
from hystfit.models.starting import input_range, output_range

_LEAST_RATE = 1e-6  # scaled alpha (per half range of the input) below which f = (alpha f) / alpha means nothing


class Rows(NamedTuple):
    """Regressors and responses of a record.

    Attributes:
        phi: shape (K, p), scaled.
        target: shape (K,), scaled.
        travel: |dv| of each row in units of `step`, shape (K,).
        at: number of the sample at which each row ends, shape (K,).
    """

    phi: np.ndarray
    target: np.ndarray
    travel: np.ndarray
    at: np.ndarray


class DuhemRegressor(eqx.Module):
    """The scaled linear form of a `Duhem` model, and the way between theta and the model.

    Attributes:
        center, half: of the input range on which f and g are expanded [u].
        shift, size: middle and half range of the output [y].
        step: typical size of an input increment [u]; only a unit, by which rows become of order one.
        m, n: numbers of coefficients of f and g.
        scheme: "midpoint" takes the output of a regressor at the middle of the step, as the model's midpoint scheme does;
            "explicit" at its beginning. The noise of midpoint regressors is uncorrelated with that of the response.
    """

    center: Float[Array, ""]
    half: Float[Array, ""]
    shift: Float[Array, ""]
    size: Float[Array, ""]
    step: Float[Array, ""]
    m: int = eqx.field(static=True)
    n: int = eqx.field(static=True)
    scheme: str = eqx.field(static=True, default="midpoint")

    def __check_init__(self) -> None:
        if self.scheme not in ("midpoint", "explicit"):
            raise ModelError(
                f"the {self.scheme!r} scheme is not linear in the parameters: identify with Duhem(scheme='midpoint') or "
                "'explicit', or fit with method='lm'"
            )

    @classmethod
    def of(cls, model: AbstractHysteresis, records: Sequence[Record]) -> DuhemRegressor:
        """Scaled to the ranges of records, with the orders and the scheme of a model.

        Raises:
            ModelError: not a Duhem model, or its scheme is "exact".
            DataError: the input never moves.
        """
        if not isinstance(model, Duhem):
            raise ModelError(f"these regressors are those of Duhem, got {type(model).__name__}; use method='lm'")
        steps = np.concatenate([np.diff(record.u) for record in records])
        steps = steps[steps != 0]
        if steps.size == 0:
            raise DataError("the input never moves: there is nothing to identify")
        place, output = input_range(records), output_range(records)
        values = (*place, *output, np.sqrt(np.mean(steps**2)))
        arrays = (jnp.asarray(value, dtype=jnp.result_type(float)) for value in values)
        return cls(*arrays, m=model.f.shape[0], n=model.g.shape[0], scheme=model.scheme)

    @property
    def p(self) -> int:
        """Number of parameters."""
        return self.m + self.n + 1

    def row(self, u0: Array, u1: Array, y0: Array, y1: Array) -> tuple[Float[Array, "... p"], Float[Array, "..."]]:
        """phi and target of steps from (u0, y0) to (u1, y1); any common shape."""
        d = (u1 - u0) / self.step
        x = (0.5 * (u0 + u1) - self.center) / self.half
        w = (0.5 * (y0 + y1) if self.scheme == "midpoint" else y0) - self.shift
        basis = [jnp.ones_like(x), x]
        for i in range(1, max(self.m, self.n) - 1):
            basis.append(((2 * i + 1) * x * basis[i] - i * basis[i - 1]) / (i + 1))
        a = jnp.abs(d)
        columns = [a * b for b in basis[: self.m]] + [-a * w / self.size] + [d * b for b in basis[: self.n]]
        return jnp.stack(columns, axis=-1), (y1 - y0) * (self.half / (self.size * self.step))

    @property
    def target_unit(self) -> Float[Array, ""]:
        """Output of one unit of the target [y]."""
        return self.size * self.step / self.half

    def rows(self, record: Record) -> Rows:
        """All steps of a record whose ends count and whose input moved."""
        u, y = record.u, record.y
        keep = np.flatnonzero(record.used[1:] & record.used[:-1] & (np.diff(u) != 0)) + 1
        phi, target = self.row(*(jnp.asarray(v) for v in (u[keep - 1], u[keep], y[keep - 1], y[keep])))
        travel = np.abs(u[keep] - u[keep - 1]) / float(self.step)
        return Rows(np.asarray(phi), np.asarray(target), travel, keep)

    # -- theta and the model -----------------------------------------------------------------------------------------

    def theta(self, model: Duhem) -> np.ndarray:
        """Scaled parameters of a model, shape (p,); its polynomials may be expanded on another range."""
        f, g = (self._pad(c, k) for c, k in zip(model.powers(), (self.m, self.n), strict=True))
        center, half, shift, size = (float(v) for v in (self.center, self.half, self.shift, self.size))
        f, g = powers_to_legendre(f, center, half) / size, powers_to_legendre(g, center, half) * half / size
        f[0] -= shift / size
        rate = float(model.alpha) * half
        return np.concatenate([rate * f, [rate], g])

    @staticmethod
    def _pad(powers: np.ndarray, length: int) -> np.ndarray:
        if powers.size > length:
            raise ModelError(f"a start of order {powers.size - 1} does not fit regressors of order {length - 1}")
        return np.pad(powers, (0, length - powers.size))

    def physical(self, theta: np.ndarray) -> np.ndarray:
        """[alpha, f, g] of the model, shape (..., p), from theta of that shape; f is NaN where alpha is not positive."""
        theta = np.asarray(theta, dtype=float)
        half, shift, size = (float(v) for v in (self.half, self.shift, self.size))
        rate = theta[..., self.m : self.m + 1]
        f = size * theta[..., : self.m] / np.where(rate > _LEAST_RATE, rate, np.nan)
        f[..., 0] += shift
        return np.concatenate([rate / half, f, theta[..., self.m + 1 :] * size / half], axis=-1)

    def model(self, theta: np.ndarray, w0: float) -> Duhem | None:
        """The model that theta stands for; None where its rate is not positive, so that it is no hysteresis."""
        values = self.physical(theta)
        if not np.isfinite(values).all():
            return None
        f, g = values[1 : 1 + self.m], values[1 + self.m :]
        place = float(self.center), float(self.half)
        return Duhem(alpha=values[0], f=f, g=g, w0=w0, center=place[0], half=place[1], scheme=self.scheme)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the physical parameters, as `ParameterSpace` has them."""
        return ("alpha", *(f"f[{i}]" for i in range(self.m)), *(f"g[{j}]" for j in range(self.n)))

    def powers(self, theta: np.ndarray) -> np.ndarray:
        """The paper's parameters [alpha f_0.., alpha, g_0..] of 1, v, v^2, ..., shape (..., p), from theta."""
        return np.asarray(theta, dtype=float) @ self._to_powers().T

    def from_powers(self, values: np.ndarray) -> np.ndarray:
        """theta from the paper's parameters."""
        return np.linalg.solve(self._to_powers(), np.asarray(values, dtype=float).T).T

    def _to_powers(self) -> np.ndarray:
        center, half, shift, size = (float(v) for v in (self.center, self.half, self.shift, self.size))
        matrix = np.zeros((self.p, self.p))
        for start, count, unit in ((0, self.m, size / half), (self.m + 1, self.n, size / half)):
            for i in range(count):
                matrix[start : start + count, start + i] = unit * legendre_to_powers(np.eye(count)[i], center, half)
        matrix[0, self.m] = shift / half  # f is counted from the middle of the output
        matrix[self.m, self.m] = 1 / half
        return matrix
