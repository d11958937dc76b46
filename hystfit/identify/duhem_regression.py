"""The polynomial Duhem model as a linear regression: scaled regressors, and what the identifiers of it share.

With x = (v - center) / half, W = (w - shift) / size, a = |dv| / step and d = dv / step, one step reads

    (half / step) dW = phi . theta,     phi = [a P_0(x), ..., a P_m(x), -a W, d P_0(x), ..., d P_n(x)],

theta = [alpha f_i, alpha, g_j] in these units, P_i the Legendre polynomials and x taken at the middle of the step
(Zhou and Wang 2013, eqs. (4) and (5), with the sign of the regressor of alpha put right). All columns are of order one, so that
single precision and orders well above the paper's can be used. `basis="powers"` takes the paper's own columns instead, powers of
v with w and dv in the data's units: theta is then the paper's, and the columns differ by orders of magnitude.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_x64
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.identify.base import AbstractIdentifier, Info, Judgment, Run, Sample
from hystfit.models.base import AbstractHysteresis
from hystfit.models.duhem import Duhem
from hystfit.models.shared.polynomial import legendre_powers, powers_to_legendre
from hystfit.models.shared.shapes import Scalar
from hystfit.models.shared.simulation import simulate
from hystfit.models.shared.starting import first_output, input_range, output_range
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import warn
from hystfit.params.relative_size import ROUNDED

STARTS = ("zero", "model", "data")
BASES = ("legendre", "powers")
_LEAST_RATE = 1e-6  # scaled alpha (per half range of the input) below which f = (alpha f) / alpha is meaningless


class Rows(NamedTuple):
    """Regressors and responses of K steps, in units of the regressor; `travel` is |dv| of each row, `at` the sample where it ends."""

    phi: np.ndarray
    target: np.ndarray
    travel: np.ndarray
    at: np.ndarray


class DuhemRegressor(eqx.Module):
    """The scaled linear form of a `Duhem` model, and the conversion between theta and the model.

    Attributes:
        center, half: of the input range on which f and g are expanded [u].
        shift, size: center and half range of the output [y].
        step: typical size of an input increment [u]; a unit that makes rows of order one.
        m, n: numbers of coefficients of f and g.
        scheme: "midpoint" evaluates the output in the regressor at the middle of the step, as the midpoint scheme of the model
            does; "explicit" at its beginning. The noise of midpoint regressors is uncorrelated with that of the response.
        basis: "legendre", scaled; or "powers" of the input, with all columns and theta in the data's units, as in the paper.
    """

    center: Scalar
    half: Scalar
    shift: Scalar
    size: Scalar
    step: Scalar
    m: int = eqx.field(static=True)
    n: int = eqx.field(static=True)
    scheme: str = eqx.field(static=True, default="midpoint")
    basis: str = eqx.field(static=True, default="legendre")

    def __check_init__(self) -> None:
        if self.basis not in BASES:
            raise ParameterError(f"basis must be one of {', '.join(BASES)}, got {self.basis!r}")
        if self.scheme not in ("midpoint", "explicit"):
            raise ModelError(
                f"the {self.scheme!r} scheme is not linear in the parameters: identify with Duhem(scheme='midpoint') or "
                "'explicit', or fit with method='lm'"
            )

    @classmethod
    def of(cls, model: AbstractHysteresis, records: Sequence[Record], *, basis: str = "legendre") -> DuhemRegressor:
        """Scaled to the ranges of records, with the orders and the scheme of a model.

        Args:
            model: a `Duhem`.
            records: with an input that moves.
            basis: see the attributes.

        Raises:
            ParameterError: an unknown basis.
            ModelError: not a Duhem model, or its scheme is "exact".
            DataError: the input never moves.
        """
        require_x64()
        if not isinstance(model, Duhem):
            raise ModelError(
                f"this identifier needs a Duhem model, got {type(model).__name__}; use method='lm' or 'ukf'"
            )
        steps = np.concatenate([np.diff(record.u) for record in records])
        steps = steps[steps != 0]
        if steps.size == 0:
            raise DataError("the input never moves: there is nothing to identify")
        values = (*input_range(records), *output_range(records), np.sqrt(np.mean(steps**2)))
        arrays = (jnp.asarray(value, dtype=jnp.result_type(float)) for value in values)
        return cls(*arrays, m=model.f.shape[0], n=model.g.shape[0], scheme=model.scheme, basis=basis)

    @property
    def p(self) -> int:
        """Number of parameters."""
        return self.m + self.n + 1

    def row(self, u0: Array, u1: Array, y0: Array, y1: Array) -> tuple[Float[Array, "... p"], Float[Array, "..."]]:
        """Regressors (..., p) and responses (...,) of steps from inputs u0 [u] and outputs y0 [y], of any one shape, to u1 and y1."""
        v, w = 0.5 * (u0 + u1), 0.5 * (y0 + y1) if self.scheme == "midpoint" else y0
        if self.basis == "powers":
            d, terms = u1 - u0, [v**i for i in range(max(self.m, self.n))]
        else:
            d, w, x = (u1 - u0) / self.step, (w - self.shift) / self.size, (v - self.center) / self.half
            terms = [jnp.ones_like(x), x]
            for i in range(1, max(self.m, self.n) - 1):
                terms.append(((2 * i + 1) * x * terms[i] - i * terms[i - 1]) / (i + 1))
        a = jnp.abs(d)
        columns = [a * b for b in terms[: self.m]] + [-a * w] + [d * b for b in terms[: self.n]]
        return jnp.stack(columns, axis=-1), (y1 - y0) / self.target_unit

    @property
    def target_unit(self) -> Scalar:
        """Output of one unit of the target [y]."""
        return jnp.ones_like(self.size) if self.basis == "powers" else self.size * self.step / self.half

    def scaled(self, rows: Rows, theta: np.ndarray) -> tuple[DuhemRegressor, Rows, np.ndarray]:
        """The scaled regressor, rows and theta of the same regression."""
        if self.basis == "legendre":
            return self, rows, theta
        regressor = dataclasses.replace(self, basis="legendre")
        unit = float(regressor.target_unit)
        rows = rows._replace(phi=rows.phi @ self._to_powers() / unit, target=rows.target / unit)
        return regressor, rows, regressor.from_powers(theta)

    def rows(self, data: Record | Dataset) -> Rows:
        """All steps, one record after another, whose ends count and whose input moved."""
        parts, offset = [], 0
        for record in Dataset.of(data):
            u, y = record.u, record.y
            ends = np.flatnonzero(record.used[1:] & record.used[:-1] & (np.diff(u) != 0)) + 1
            phi, target = self.row(*(jnp.asarray(v) for v in (u[ends - 1], u[ends], y[ends - 1], y[ends])))
            travel = np.abs(u[ends] - u[ends - 1]) / float(self.step)
            parts.append(Rows(np.asarray(phi), np.asarray(target), travel, ends + offset))
            offset += len(record)
        return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def enough_rows(self, data: Record | Dataset) -> Rows:
        """`rows`; a DataError where they are fewer than the parameters."""
        rows = self.rows(data)
        if rows.target.size < self.p:
            raise DataError(
                f"{rows.target.size} usable steps cannot determine {self.p} parameters: give more samples (those at which "
                "the input is constant or the output is missing are not usable), or lower the orders of f and g"
            )
        return rows

    def theta(self, model: Duhem) -> np.ndarray:
        """theta of a model, shape (p,); its polynomials may be expanded on another input range."""
        f, g = (_padded(c, k) for c, k in zip(model.powers(), (self.m, self.n), strict=True))
        center, half, shift, size = (float(v) for v in (self.center, self.half, self.shift, self.size))
        f, g = powers_to_legendre(f, center, half) / size, powers_to_legendre(g, center, half) * half / size
        f[0] -= shift / size
        rate = float(model.alpha) * half
        theta = np.concatenate([rate * f, [rate], g])
        return self._to_powers() @ theta if self.basis == "powers" else theta

    def physical(self, theta: np.ndarray) -> np.ndarray:
        """[alpha, f, g] of the model, shape (..., p), from theta of that shape; f is NaN where alpha is not positive."""
        theta = np.asarray(theta, dtype=float)
        if self.basis == "powers":
            theta = np.linalg.solve(self._to_powers(), theta.T).T
        half, shift, size = (float(v) for v in (self.half, self.shift, self.size))
        rate = theta[..., self.m : self.m + 1]
        f = size * theta[..., : self.m] / np.where(rate > _LEAST_RATE, rate, np.nan)
        f[..., 0] += shift
        return np.concatenate([rate / half, f, theta[..., self.m + 1 :] * size / half], axis=-1)

    def model(self, theta: np.ndarray, w0: float) -> Duhem | None:
        """The model of theta with first output w0; None where the rate is not positive, which is not hysteresis."""
        values = self.physical(theta)
        if not np.isfinite(values).all():
            return None
        f, g = values[1 : 1 + self.m], values[1 + self.m :]
        center, half = float(self.center), float(self.half)
        return Duhem(alpha=values[0], f=f, g=g, w0=w0, center=center, half=half, scheme=self.scheme)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the physical parameters, as `ParameterSpace` has them."""
        return ("alpha", *(f"f[{i}]" for i in range(self.m)), *(f"g[{j}]" for j in range(self.n)))

    def powers(self, theta: np.ndarray) -> np.ndarray:
        """The paper's parameters [alpha f_0.., alpha, g_0..] of 1, v, v^2, ..., shape (..., p), from theta."""
        if self.basis == "powers":
            return np.asarray(theta, dtype=float)
        return np.asarray(theta, dtype=float) @ self._to_powers().T

    def from_powers(self, values: np.ndarray) -> np.ndarray:
        """theta from the paper's parameters."""
        if self.basis == "powers":
            return np.asarray(values, dtype=float)
        return np.linalg.solve(self._to_powers(), np.asarray(values, dtype=float).T).T

    def _to_powers(self) -> np.ndarray:
        center, half, shift, size = (float(v) for v in (self.center, self.half, self.shift, self.size))
        matrix = np.zeros((self.p, self.p))
        for start, count in ((0, self.m), (self.m + 1, self.n)):
            end = start + count
            matrix[start:end, start:end] = size / half * legendre_powers(count, center, half)
        matrix[0, self.m] = shift / half  # f is relative to the center of the output range
        matrix[self.m, self.m] = 1 / half
        return matrix


def _padded(powers: np.ndarray, length: int) -> np.ndarray:
    if powers.size > length:
        raise ModelError(f"a start of order {powers.size - 1} does not fit regressors of order {length - 1}")
    return np.pad(powers, (0, length - powers.size))


class LinearIdentifier(AbstractIdentifier):
    """An identifier of the Duhem model by its one-step equation: target = phi . theta + error.

    Its state is a NamedTuple with `theta` (p,) and `last`, (u, y) of the previous sample.
    """

    solved: ClassVar[tuple[str, ...]] = ("w0",)

    regressor: eqx.AbstractVar[DuhemRegressor]
    theta0: eqx.AbstractVar[Float[Array, " p"]]

    @abc.abstractmethod
    def correct(self, state: Any, phi: Float[Array, " p"], error: Scalar) -> Any:
        """The state after a row of the regression: its regressors, and its response minus the one predicted by the parameters so far."""

    @abc.abstractmethod
    def check(self, run: Run, rows: Rows) -> tuple[Status, list[Note]]:
        """Status and notes of a finished run, from the rows of its records."""

    @property
    def names(self) -> tuple[str, ...]:
        """alpha, f and g of the model, element by element."""
        return self.regressor.names

    def update(self, state: Any, sample: Sample) -> tuple[Any, Info]:
        """One sample; the state stays where the input rests or the output is missing at either end of the step."""
        u0, y0 = state.last
        usable = ~sample.first & jnp.isfinite(y0) & jnp.isfinite(sample.y) & (sample.u != u0)
        clean = lambda value: jnp.where(usable, value, 0.0)  # a NaN must not enter the product with zero
        phi, target = self.regressor.row(clean(u0), clean(sample.u), clean(y0), clean(sample.y))
        phi, error = clean(phi), clean(target) - clean(phi) @ state.theta
        corrected = self.correct(state, phi, error)
        state = jax.tree.map(lambda new, old: jnp.where(usable, new, old), corrected, state)
        state = state._replace(last=jnp.stack([sample.u, sample.y]))
        return state, Info(state.theta, jnp.where(usable, error * self.regressor.target_unit, jnp.nan), usable)

    def physical(self, theta: np.ndarray) -> np.ndarray:
        """alpha, f and g of the model, shape (..., p)."""
        return self.regressor.physical(theta)

    def model(self, theta: np.ndarray, record: Record) -> Duhem | None:
        """The model with the first output that fits the record best; None where the rate is not positive."""
        model = self.regressor.model(theta, first_output(record))
        return None if model is None else with_first_output(model, record)

    def judge(self, run: Run) -> Judgment:
        """`check`, and the RMS one-step error of the final parameters."""
        rows = self.regressor.rows(run.data)
        status, notes = self.check(run, rows)
        errors = (rows.target - rows.phi @ run.history[-1]) * float(self.regressor.target_unit)
        return Judgment(status, notes, float(np.sqrt(np.mean(errors**2))))

    def excitation(self, rows: Rows) -> Note | None:
        """A note where the rows do not determine all parameters."""
        rank, size = rank_of(rows.phi), self.regressor.p
        if rank == size:
            return None
        return warn(
            Code.NOT_DETERMINED,
            f"the regressors have rank {rank} of {size}: this input does not determine all parameters (without reversals, f and g "
            "cannot be separated); add reversals at several amplitudes, or lower the orders of f and g",
        )

    def validity(self, history: np.ndarray) -> tuple[Status, list[Note]]:
        """Whether the final theta is finite and its rate positive."""
        theta = history[-1]
        if not np.isfinite(theta).all():
            at = int(np.argmax(~np.isfinite(history).all(axis=1)))
            text = f"the parameters are not finite from sample {at} on"
            return Status.DIVERGED, [Note(Code.DIVERGED, text, Severity.ERROR)]
        if np.isfinite(self.regressor.physical(theta)).all():
            return Status.OK, []
        rate = self.regressor.physical(theta)[0]
        text = (
            f"the identified rate alpha = {rate:.4g} is not positive, which means no hysteresis; possible causes are a delay between "
            "input and output, noise larger than the increments, and too short a record"
        )
        return Status.FAILED, [Note(Code.INVALID_MODEL, text, Severity.ERROR)]


def regression_of(
    model: AbstractHysteresis, data: Dataset, basis: str, start: str
) -> tuple[DuhemRegressor, Rows, Array]:
    """The regressor scaled to records, their rows, and starting values of shape (p,): "zero", of the "model", or of the "data"."""
    if start not in STARTS:
        raise ParameterError(f"start must be one of {', '.join(STARTS)}, got {start!r}")
    regressor = DuhemRegressor.of(model, list(data), basis=basis)
    rows = regressor.enough_rows(data)
    if start == "zero":
        return regressor, rows, jnp.zeros(regressor.p)
    return regressor, rows, jnp.asarray(regressor.theta(model if start == "model" else model.start(list(data))))


def rank_of(phi: np.ndarray) -> int:
    """Numerical rank of columns of any scale, shape (K, p)."""
    size = np.linalg.norm(phi, axis=0)
    values = np.linalg.svd(phi / np.where(size > 0, size, 1.0), compute_uv=False)
    return int(np.sum(values > ROUNDED * values[0]))


def with_first_output(model: Duhem, record: Record) -> Duhem:
    """The model with the first output that fits a record best; the simulated output is linear in it."""
    put = lambda value: dataclasses.replace(model, w0=value)
    base = float(model.w0)
    low, high = (np.asarray(simulate(put(base + shift), record.u)[0])[record.used] for shift in (0.0, 1.0))
    decay, residual = high - low, record.y[record.used] - low
    if not (np.isfinite(decay).all() and np.isfinite(residual).all()):
        return model
    weight = np.asarray(record.weight)[record.used]
    norm = float(np.sum(weight * decay**2))
    return put(base + float(np.sum(weight * decay * residual)) / norm) if norm > 0 else model
