"""Energy-based vector hysteresis: cells with dry friction behind one anhysteretic curve, in two or three dimensions (Bergqvist 1997)."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.config import verb
from hystfit.errors import DataError, ModelError
from hystfit.models.jiles_atherton import langevin
from hystfit.params.host_arrays import compiled
from hystfit.params.units import MU0

_FIRST, _LAST = 0.3, 2.5  # of the mean pinning field that a loop shows: those of the cells from which a fit starts
FEWEST = 20  # samples of a record


@dataclasses.dataclass(frozen=True, eq=False)
class VectorRecord:
    """Field and flux density over one run, from the demagnetized state.

    Attributes:
        h: field [A/m], shape (T, 2) or (T, 3).
        b: flux density [T], the same shape.

    Raises:
        DataError: other shapes, fewer than 20 samples, or values that are not finite.
    """

    h: np.ndarray
    b: np.ndarray

    def __post_init__(self) -> None:
        if self.h.shape != self.b.shape or self.h.ndim != 2 or self.h.shape[1] not in (2, 3):
            raise DataError(f"H and B must have one shape (T, 2) or (T, 3), got {self.h.shape} and {self.b.shape}")
        if len(self.h) < FEWEST or not (np.isfinite(self.h).all() and np.isfinite(self.b).all()):
            raise DataError(f"a record needs at least {FEWEST} samples, all finite")


@dataclasses.dataclass(frozen=True, eq=False)
class VectorHysteresis:
    """B = mu0 H + sum over cells of w Js L(|h| / a) h / |h|, where each h is dragged by H with friction kappa.

    A cell rests while |H - h| <= kappa, else h moves along H - h until |H - h| = kappa: a play, in one dimension. As h moves along the
    friction that it overcomes and the anhysteretic polarization is the gradient of a convex energy, no step gives back more than it
    stores: the dissipation kappa e . dJ is never negative, whatever the parameters.

    Attributes:
        Js: saturation polarization [T].
        a: field that scales the anhysteretic curve [A/m].
        kappa: pinning fields of the cells, rising [A/m], shape (K,).
        w: weights of the cells, which sum to 1, shape (K,).
        stderr: standard errors of Js, a, kappa and w in this order, by the residuals of a fit; None without a fit.

    Raises:
        ModelError: parameters that are not positive, or weights that do not sum to 1.
    """

    Js: float
    a: float
    kappa: Any  # arrays once made
    w: Any
    stderr: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "kappa", np.atleast_1d(np.asarray(self.kappa, dtype=float)))
        object.__setattr__(self, "w", np.atleast_1d(np.asarray(self.w, dtype=float)))
        if self.kappa.shape != self.w.shape or not (self.Js > 0 and self.a > 0):
            raise ModelError("Js and a must be positive, and each cell has one pinning field and one weight")
        if (self.kappa < 0).any() or (self.w < 0).any() or abs(float(self.w.sum()) - 1) > 1e-6:
            raise ModelError("pinning fields and weights must not be negative, and the weights sum to 1")

    @verb
    def simulate(self, h: np.ndarray) -> np.ndarray:
        """Flux density [T] over a field from the demagnetized state, shape (T, d).

        Args:
            h: field [A/m], shape (T, d) with d = 1, 2 or 3.

        Raises:
            DataError: another shape.
        """
        h = np.asarray(h, dtype=float)
        if h.ndim != 2 or h.shape[1] not in (1, 2, 3) or not np.isfinite(h).all():
            raise DataError(f"the field must be finite, of shape (T, 1), (T, 2) or (T, 3), got {h.shape}")
        return np.asarray(_flux(*map(jnp.asarray, (self.Js, self.a, self.kappa, self.w)), jnp.asarray(h))[0])

    @verb
    def dissipation(self, h: np.ndarray) -> np.ndarray:
        """Energy that each step dissipates [J/m^3], shape (T,).

        Args:
            h: field [A/m], shape (T, d).
        """
        found = _flux(*map(jnp.asarray, (self.Js, self.a, self.kappa, self.w)), jnp.asarray(np.asarray(h, dtype=float)))
        return np.asarray(found[1])

    @classmethod
    @verb
    def fit(cls, records: Sequence[VectorRecord], cells: int = 3) -> VectorHysteresis:
        """The parameters by least squares on all records, with standard errors from the residuals.

        Rotating fields are needed beside alternating ones to tell the pinning fields of the cells apart.

        Args:
            records: alternating and rotating, each from the demagnetized state.
            cells: number of cells.

        Raises:
            DataError: no records, of different dimension, or none magnetized.
            ModelError: less than one cell.
        """
        from scipy.optimize import least_squares

        if cells < 1:
            raise ModelError(f"at least one cell, got {cells}")
        if not records or len({one.h.shape[1] for one in records}) != 1:
            raise DataError("give records, all of the same number of components")
        fields, flux = [jnp.asarray(one.h) for one in records], np.concatenate([one.b.ravel() for one in records])
        top = max(float(np.linalg.norm(one.b - MU0 * one.h, axis=1).max()) for one in records)
        if not top > 0:
            raise DataError("the records are not magnetized")
        predict = lambda z: np.concatenate([np.asarray(_of_vector(jnp.asarray(z), h, cells)).ravel() for h in fields])
        slopes = lambda z: np.concatenate(
            [np.asarray(_slopes(jnp.asarray(z), h, cells)).reshape(-1, z.size) for h in fields]
        )
        pinning = _mean_pinning(records)
        spread = np.geomspace(_FIRST, _LAST, cells) if cells > 1 else np.ones(1)
        begin = np.concatenate([np.log([1.15 * top, pinning]), np.log(pinning * spread), np.zeros(cells - 1)])
        found = least_squares(
            lambda z: (predict(z) - flux) / top, begin, lambda z: slopes(z) / top, x_scale="jac", method="lm"
        )
        stacked = lambda z: jnp.concatenate([jnp.atleast_1d(part) for part in _parameters(z, cells)])
        values, by_vector = _parameters(jnp.asarray(found.x), cells), jax.jacfwd(stacked)(jnp.asarray(found.x))
        variance = 2 * found.cost / max(flux.size - found.x.size, 1)
        covariance = variance * np.linalg.pinv(found.jac.T @ found.jac)
        errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", by_vector, covariance, by_vector), 0.0))
        js, a, kappa, w = (np.asarray(value) for value in values)
        order = np.argsort(kappa)
        placed = np.concatenate([[0, 1], 2 + order, 2 + cells + order])
        return cls(float(js), float(a), kappa[order], w[order], errors[placed])

    def save_csv(self, file: str | Path) -> Path:
        """Write the parameters with units and the update as a table that a field program can be given.

        Args:
            file: to write.
        """
        path = Path(file)
        with path.open("w", newline="", encoding="utf-8") as target:
            target.write(
                "# B = mu0 H + sum w Js (coth(|h|/a) - a/|h|) h/|h|; where |H - h| > kappa: h <- H - kappa (H - h)/|H - h|\n"
            )
            rows = csv.writer(target)
            rows.writerows(
                [["name", "cell", "value", "unit"], ["Js", "", repr(self.Js), "T"], ["a", "", repr(self.a), "A/m"]]
            )
            for k, (pinning, weight) in enumerate(zip(self.kappa, self.w, strict=True)):
                rows.writerows([["kappa", k, repr(float(pinning)), "A/m"], ["w", k, repr(float(weight)), "1"]])
        return path


def _mean_pinning(records: Sequence[VectorRecord]) -> float:
    """Lost energy over the way of the polarization: the mean friction that it overcame [A/m]."""
    lost = way = 0.0
    for one in records:
        j = one.b - MU0 * one.h
        lost += float(np.sum(0.5 * (one.h[1:] + one.h[:-1]) * np.diff(j, axis=0)))
        way += float(np.linalg.norm(np.diff(j, axis=0), axis=1).sum())
    largest = max(float(np.linalg.norm(one.h, axis=1).max()) for one in records)
    return min(max(lost / way, 1e-3 * largest), largest) if way > 0 else 0.1 * largest


def _length(x: Array) -> Array:
    """Norm of the last axis with a gradient of zero at zero, shape (..., 1)."""
    square = jnp.sum(x**2, axis=-1, keepdims=True)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def _run(js: Array, a: Array, kappa: Array, w: Array, h: Array) -> tuple[Array, Array]:
    """Flux density, shape (T, d), and dissipated energy, shape (T,)."""

    def polarization(dragged: Array) -> Array:
        size = _length(dragged)
        return js * langevin(size / a) * dragged / jnp.where(size > 0, size, 1.0)

    def step(dragged: Array, field: Array) -> tuple[Array, tuple[Array, Array]]:
        ahead = field - dragged
        size = _length(ahead)
        moved = dragged + ahead * jnp.maximum(1.0 - kappa[:, None] / jnp.where(size > 0, size, 1.0), 0.0) * (size > 0)
        after = polarization(moved)
        lost = jnp.sum(w[:, None] * (field - moved) * (after - polarization(dragged)))
        return moved, (MU0 * field + w @ after, lost)

    return jax.lax.scan(step, jnp.zeros((kappa.size, h.shape[1])), h)[1]


_flux = compiled(_run)


def _parameters(z: Array, cells: int) -> tuple[Array, Array, Array, Array]:
    """Js, a, kappa and w of a vector: logarithms, and of the weights those of their ratios to the last."""
    share = jax.nn.softmax(jnp.concatenate([z[2 + cells :], jnp.zeros(1)]))
    return jnp.exp(z[0]), jnp.exp(z[1]), jnp.exp(z[2 : 2 + cells]), share


_of_vector = jax.jit(lambda z, h, cells: _run(*_parameters(z, cells), h)[0], static_argnums=2)
_slopes = jax.jit(lambda z, h, cells: jax.jacfwd(lambda v: _run(*_parameters(v, cells), h)[0])(z), static_argnums=2)
