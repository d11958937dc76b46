"""Bouc-Wen with degradation and pinching (Baber and Noori 1985), in dimensionless form without redundant parameters."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen_steps import (
    SUBSTEPS,
    any_power,
    check_substeps,
    middle_size,
    rate_integral,
    semi_implicit,
    substep_advice,
)
from hystfit.models.shared.reported import Derived
from hystfit.models.shared.shapes import Scalar, State
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

# Of the starting values: yield displacement over the half range, n, strength and stiffness lost over the record, pinching.
_GRID = ((0.01, 0.02, 0.05, 0.1, 0.2, 0.5), (1.0, 2.0), (0.05, 1.0), (0.05, 2.0), (0.0, 0.9))
_PINCHED = 10.0  # pinching is complete after this fraction 1 / 10 of the energy of the record


class BoucWenBaberNoori(AbstractHysteresis):
    """Force of an element that loses strength and stiffness and slips near zero force (pinching), against its displacement.

        y = offset + kappa_x u + kappa_w w,   e = integral of w du / zy >= 0,   s = sgn(du)
        zy dw/du = (h / eta) (1 - nu (beta sgn(w du) + 1 - beta) |w|^n),   nu = 1 + dnu e,   eta = 1 + deta e
        h = 1 - z1 exp(-((w s - q nu^(-1/n)) / z2)^2),   z1 = zs (1 - exp(-p e)),   z2 = (psi + dpsi e) (lam + z1)

    w is the hysteretic force over that at yielding, zy the yield displacement, and e the energy that the hysteretic part has absorbed,
    in units of kappa_w zy. kappa_x = alpha k and kappa_w = (1 - alpha) k zy with the initial stiffness k and the ratio alpha of the
    literature, which a fit reports. Of the literature's parameters A, beta, gamma, two are exactly redundant: A = 1 and
    beta + gamma = 1 here (Ma et al. 2004). lam = 0.2 and dpsi = 0 are fixed, because loops do not determine them beside psi and zs. Where
    the loops are not pinched, zs is near zero and p, q and psi have no effect. Semi-implicit substeps of second order.

    The device rests without force before the record. Parameters of damaged loops often end on their bounds, where the bounded solver
    (method="trf") can find a lower minimum.

    Raises:
        ModelError: fewer than one substep.

    Source: Baber and Noori (1985), Journal of Engineering Mechanics 111, 1010-1026; Foliente (1995), Journal of Structural Engineering
        121, 1013-1022.
    """

    rate_independent: ClassVar[bool] = True
    c_template: ClassVar[str] = "bouc_wen_degrading"
    needs: ClassVar[Needs] = Needs(
        amplitudes=2,
        symmetry="symmetric",
        direction="clockwise",
        damage=True,
        too_few="loss of strength (dnu), loss of stiffness (deta) and pinching trade off",
    )

    kappa_x: Scalar = param(0.2, unit="y/u", linear=True, doc="slope after yielding, alpha k")
    kappa_w: Scalar = param(1.0, unit="y", linear=True, doc="force at yielding, (1 - alpha) k zy")
    zy: Scalar = param(0.2, bounds=(0.0, np.inf), unit="u", scale=0.1, doc="yield displacement")
    beta: Scalar = param(0.6, bounds=(0.0, 4.0), doc="shape of the unloading branch")
    n: Scalar = param(1.5, bounds=(0.35, 6.0), doc="sharpness of the knee")
    dnu: Scalar = param(0.01, bounds=(0.0, 0.3), scale=0.01, doc="loss of strength per unit of energy")
    deta: Scalar = param(0.02, bounds=(0.0, 1.0), scale=0.01, doc="loss of stiffness per unit of energy")
    zs: Scalar = param(0.5, bounds=(0.0, 0.995), doc="slip, as a fraction of the slope that it takes")
    p: Scalar = param(0.1, bounds=(0.001, 5.0), scale=0.1, doc="rate at which pinching sets in")
    q: Scalar = param(0.1, bounds=(-0.3, 0.8), doc="force in the middle of the slip, over that at yielding")
    psi: Scalar = param(0.3, bounds=(0.02, 3.0), doc="width of the slip")
    lam: Scalar = param(0.2, bounds=(0.01, 1.0), fixed=True, doc="growth of the slip's width with its depth")
    dpsi: Scalar = param(0.0, bounds=(0.0, 1.0), fixed=True, doc="growth of the slip's width per unit of energy")
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="force at zero input without hysteresis")
    substeps: int = eqx.field(static=True, default=SUBSTEPS)

    def __check_init__(self) -> None:
        check_substeps(self.substeps)

    def init(self, u0: Scalar) -> State:
        """State: w and the energy e, shape (2,), zero at rest."""
        return jnp.zeros(2, u0.dtype) + 0.0 * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        s = jnp.where(u1 < u0, -1.0, 1.0)
        x = jnp.abs(u1 - u0) / (self.zy * self.substeps)
        once = lambda _, now: self._moved(*now, x)
        w, energy = jax.lax.fori_loop(0, self.substeps, once, (s * state[0], state[1]))
        return jnp.stack([s * w, energy]), self.offset + self.kappa_x * u1 + self.kappa_w * s * w

    def _moved(self, w: Scalar, energy: Scalar, x: Scalar) -> tuple[Scalar, Scalar]:
        """w in the direction of motion, and the energy, after a way x of at most a few yield displacements."""
        gain, nu = self._slope(w, energy)
        rise = gain * (1.0 - nu * jnp.where(w >= 0, 1.0, 1.0 - 2.0 * self.beta) * any_power(jnp.abs(w), self.n))
        middle = jnp.minimum(w + 0.5 * x * rise, jnp.maximum(w, self._largest(nu)))
        gain, nu = self._slope(middle, jnp.maximum(energy + 0.5 * x * w, 0.0))
        rates = nu * gain, nu * gain * (2.0 * self.beta - 1.0)
        passed = any_power(middle_size(middle, gain * x), self.n - 1.0) * rate_integral(w, x, gain, *rates)
        moved = semi_implicit(w, x, gain, passed, self._largest(nu))
        return moved, jnp.maximum(energy + 0.5 * x * (w + moved), 0.0)

    def _largest(self, nu: Scalar) -> Scalar:
        """w at which the slope vanishes."""
        return jnp.exp(-jnp.log(nu) / self.n)

    def _slope(self, w: Scalar, energy: Scalar) -> tuple[Scalar, Scalar]:
        """h / eta and nu."""
        nu = 1.0 + self.dnu * energy
        depth = -self.zs * jnp.expm1(-self.p * energy)
        width = (self.psi + self.dpsi * energy) * (self.lam + depth)
        place = (w - self.q * self._largest(nu)) / width
        return (1.0 - depth * jnp.exp(-(place**2))) / (1.0 + self.deta * energy), nu

    def derived(self) -> tuple[Derived, ...]:
        """Initial stiffness and ratio of the slopes, as the literature has them."""
        stiffness = lambda m: m.kappa_x + m.kappa_w / m.zy
        return (
            Derived("k", "y/u", "initial stiffness", stiffness),
            Derived(
                "alpha", "1", "slope after yielding over the initial stiffness", lambda m: m.kappa_x / stiffness(m)
            ),
        )

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Where the sampling is too coarse for the substeps."""
        return substep_advice(largest_step(u) / float(self.zy), self.substeps)

    def uniaxial_material(self) -> UniaxialMaterial:
        """`BoucWen` of OpenSees, which degrades, or `BWBN`, which pinches; the energy there is that here times kappa_w zy.

        Raises:
            ModelError: a model that degrades and pinches, for which there is no material, or a stiffness that is not positive.
        """
        v = {
            name: float(getattr(self, name))
            for name in ("zy", "n", "beta", "dnu", "deta", "zs", "p", "q", "psi", "dpsi", "lam")
        }
        hysteretic = float(self.kappa_w) / v["zy"]
        k, unit = float(self.kappa_x) + hysteretic, float(self.kappa_w) * v["zy"]
        if not (hysteretic > 0 and k > 0):
            raise ModelError("the materials of OpenSees need a positive stiffness, and kappa_w is not positive")
        if v["zs"] > 0 and (v["dnu"] > 0 or v["deta"] > 0):
            raise ModelError(
                "OpenSees has no Bouc-Wen material that degrades and pinches: BoucWen has no pinching, BWBN no degradation; fit with "
                "zs fixed at 0, or with dnu and deta fixed at 0"
            )
        tolerance, steps, notes = bouc_wen_notes(v["n"], v["zy"])
        scale = v["zy"] ** -v["n"]
        first = (float(self.kappa_x) / k, k, v["n"], (1.0 - v["beta"]) * scale, v["beta"] * scale, 1.0)
        lost = lost_constants(offset=float(self.offset))
        if v["zs"] == 0:
            loss = (0.0, v["dnu"] / unit, v["deta"] / unit)
            return UniaxialMaterial("BoucWen", (*first, *loss, tolerance, steps), lost, notes)
        slip = (v["q"], v["zs"], v["p"] / unit, v["zy"] * v["psi"], v["zy"] * v["dpsi"] / unit, v["lam"])
        return UniaxialMaterial("BWBN", (*first, *slip, tolerance, steps), lost, notes)

    def start(self, records: Sequence[Record]) -> BoucWenBaberNoori:
        return self.starting_points(records)[0]

    def starting_points(self, records: Sequence[Record]) -> tuple[BoucWenBaberNoori, ...]:
        """The best with and without pinching, of a grid for which slope, force and offsets follow by linear least squares."""
        half, short = input_range(records).half, thinned(records)
        path = max(float(np.sum(np.abs(np.diff(record.u)))) for record in records)
        zy, n, dnu, deta, zs = np.array(list(itertools.product(*_GRID))).T
        zy = zy * half
        energy = path / zy  # of a plastic path with w = 1
        grid = {"zy": zy, "n": n, "zs": zs, "p": np.clip(_PINCHED / energy, 0.002, 4.0)}
        grid |= {"dnu": np.minimum(dnu / energy, 0.2), "deta": np.minimum(deta / energy, 0.7)}
        states = grid_columns(BoucWenBaberNoori(kappa_x=0.0), grid, short)
        u, y = used_samples(short)
        fixed = np.column_stack([u, offset_columns(short)])
        found = []
        for kept in (np.flatnonzero(zs > 0), np.flatnonzero(zs == 0)):
            which, theta, error = best_of_grid(states[:, kept], fixed, y)
            linear = dict(zip(("kappa_w", "kappa_x", "offset"), theta[:3], strict=True))
            shape = {name: values[kept[which]] for name, values in grid.items()}
            shape["zs"] = max(shape["zs"], 0.05)
            found.append((error, dataclasses.replace(self, **linear, **shape)))
        return tuple(model for _, model in sorted(found, key=lambda pair: pair[0]))
