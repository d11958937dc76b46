"""Bouc-Wen as a force against a displacement, in the normalized form of Ikhouane and Rodellar (2007)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen_steps import (
    SUBSTEPS,
    check_substeps,
    power_of,
    rate_integral,
    semi_implicit,
    substep_advice,
)
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.starting import (
    best_of_grid,
    grid_columns,
    input_range,
    offset_columns,
    thinned,
    used_samples,
)
from hystfit.models.shared.uniaxial_material import UniaxialMaterial, bouc_wen_notes, lost_constants
from hystfit.params.param import param
from hystfit.quality.loops import largest_step
from hystfit.quality.needs import Needs


class BoucWenForce(AbstractHysteresis):
    """Force of a yielding element:  y = offset + kappa_x u + kappa_w w.

        dw/du = rho (1 - (sigma sgn(w du) + 1 - sigma) |w|^n),    |w| <= 1

    1 / rho is the yield displacement, kappa_w the yield force, kappa_x the slope after yielding, n the sharpness of the knee and sigma the
    shape of the unloading branch (>= 1/2 dissipates). Normalized, so that no two parameters do the same thing; linear in
    kappa_x, kappa_w and offset. kappa_w < 0 makes a loop that lags. Semi-implicit substeps of second order, within |w| <= 1.

    Raises:
        ModelError: fewer than one substep.
    """

    rate_independent: ClassVar[bool] = True
    c_template: ClassVar[str] = "bouc_wen_force"
    needs: ClassVar[Needs] = Needs(
        amplitudes=2,
        symmetry="symmetric",
        too_few="the shape of the unloading branch and the sharpness of the knee trade off",
    )

    kappa_x: Scalar = param(1.0, unit="y/u", linear=True, doc="slope after yielding")
    kappa_w: Scalar = param(1.0, unit="y", linear=True, doc="force at yielding")
    rho: Scalar = param(5.0, bounds=(0.0, np.inf), unit="1/u", scale=5.0, doc="1 / yield displacement")
    sigma: Scalar = param(0.8, bounds=(0.5, 5.0), doc="shape of the unloading branch")
    n: Scalar = param(1.5, bounds=(1.0, 20.0), doc="sharpness of the knee")
    w0: Scalar = param(0.0, bounds=(-1.0, 1.0), per_record=True, fixed=True, doc="w at the first sample")
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="force at zero input without hysteresis")
    substeps: int = eqx.field(static=True, default=SUBSTEPS)

    def __check_init__(self) -> None:
        check_substeps(self.substeps)

    def init(self, u0: Scalar) -> State:
        """State: w, shape (1,)."""
        return self.w0[None] + 0.0 * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample of the branch that the input is on."""
        s = jnp.where(u1 < u0, -1.0, 1.0)
        x, one = jnp.abs(u1 - u0) / self.substeps, jnp.ones_like(u1)
        up, down = self.rho, self.rho * (2.0 * self.sigma - 1.0)

        def once(_: Any, q: Array) -> Array:
            power = lambda q: power_of(jnp.abs(q), self.n - 1.0)
            slope = self.rho - jnp.where(q >= 0, up, down) * power(q) * q
            middle = jnp.minimum(q + 0.5 * x * slope, one)  # the power there keeps the second order
            return semi_implicit(q, x, self.rho, power(middle) * rate_integral(q, x, self.rho, up, down), one)

        w = s * jax.lax.fori_loop(0, self.substeps, once, s * state[0])
        return w[None], self.offset + self.kappa_x * u1 + self.kappa_w * w

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Where the sampling is too coarse for the substeps."""
        return substep_advice(float(self.rho) * largest_step(u), self.substeps)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes:
        """Flattest and steepest where |w| is largest: after the whole range from rest, which no other path within it exceeds."""
        rho, down, n = float(self.rho), 2.0 * float(self.sigma) - 1.0, float(self.n)
        w = -np.expm1(-np.linspace(0.0, 20.0, 1000))
        slowness = 1 / (1 - w**n)
        travel = np.append(0.0, np.cumsum(0.5 * (slowness[1:] + slowness[:-1]) * np.diff(w))) / rho
        reached = float(np.interp(high - low, travel, w)) ** n
        ends = np.array([1.0, 1 - reached, 1 + down * reached])
        return Slopes.of(float(self.kappa_x) + float(self.kappa_w) * rho * ends)

    def uniaxial_material(self) -> UniaxialMaterial:
        """`BoucWen` of OpenSees: initial stiffness k, ratio alpha, beta and gamma of the displacement z = w / rho.

        Raises:
            ModelError: a stiffness that is not positive.
        """
        zy, n, sigma = 1.0 / float(self.rho), float(self.n), float(self.sigma)
        hysteretic = float(self.kappa_w) / zy
        k = float(self.kappa_x) + hysteretic
        if not (hysteretic > 0 and k > 0):
            raise ModelError("BoucWen of OpenSees needs a positive stiffness, and kappa_w is not positive")
        tolerance, steps, notes = bouc_wen_notes(n, zy)
        shape = (n, (1.0 - sigma) * zy**-n, sigma * zy**-n, 1.0)
        lost = lost_constants(offset=float(self.offset), w0=float(self.w0))
        return UniaxialMaterial(
            "BoucWen", (float(self.kappa_x) / k, k, *shape, 0.0, 0.0, 0.0, tolerance, steps), lost, notes
        )

    def start(self, records: Sequence[Record]) -> BoucWenForce:
        """A grid over (rho, n), for each of which slope, force and offsets follow by linear least squares."""
        half, records = input_range(records).half, thinned(records)
        rho, n = (a.ravel() for a in np.meshgrid(np.geomspace(0.5, 200.0, 14) / half, [1.0, 2.0, 6.0]))
        plain = BoucWenForce(kappa_x=0.0, sigma=self.sigma)
        states = grid_columns(plain, {"rho": rho, "n": n}, records)
        u, y = used_samples(records)
        k, theta, _ = best_of_grid(states, np.column_stack([u, offset_columns(records)]), y)
        linear = dict(zip(("kappa_w", "kappa_x", "offset"), theta[:3], strict=True))
        return dataclasses.replace(self, **linear, rho=rho[k], n=max(n[k], 1.05))
