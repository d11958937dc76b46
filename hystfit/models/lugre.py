"""LuGre friction: a bristle that bends and slips, with a force that falls from static to Coulomb friction as the velocity grows."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.reported import Derived
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.starting import (
    SAMPLES,
    TYPICAL,
    fit_linear,
    input_range,
    offset_columns,
    output_range,
    speed,
    used_samples,
)
from hystfit.params.param import param
from hystfit.quality.needs import Needs

_BEND = tuple(np.geomspace(3e-3, 0.5, 8))  # presliding displacements of the grid, over half the range of the input
_EXCESS = (0.0, 0.3, 1.0)  # of static over Coulomb friction
_BENDS_AT = (0.03, 0.2)  # Stribeck velocities, over the typical one


class LuGre(AbstractHysteresis):
    """Friction of a bristle of deflection z beside a spring:

        y = offset + k u + sigma0 z + sigma1 dz/dt + sigma2 v,    dz/dt = v - sigma0 |v| z / g(v),    v = du/dt
        g(v) = Fc + dFs exp(-(v / vs)^2)

    Fc is Coulomb friction, Fc + dFs static friction, vs the Stribeck velocity. dFs and vs need reversals at speeds below vs; without
    them fix dFs at 0. The velocity is constant over a sample, so that the step is exact and stable at any sampling interval: |z| never
    exceeds (Fc + dFs) / sigma0.

    Source: Canudas de Wit, Olsson, Astrom and Lischinsky (1995), IEEE Transactions on Automatic Control 40, 419-425.
    """

    no_inverse: ClassVar[str] = (
        "friction that depends on the velocity has no inverse: a slipping bristle has the same force at every place"
    )
    rate_independent: ClassVar[bool] = False
    takes_rate: ClassVar[bool] = True
    c_template: ClassVar[str] = "lugre"
    needs: ClassVar[Needs] = Needs(
        time=True,
        symmetry="symmetric",
        direction="clockwise",
        rate=True,
        speeds=2,
        too_few="static friction and the Stribeck velocity need reversals at several speeds",
    )

    sigma0: Scalar = param(10.0, bounds=(0.0, np.inf), unit="y/u", scale=10.0, doc="stiffness of the bristle")
    sigma1: Scalar = param(
        0.01, bounds=(0.0, np.inf), unit="y*s/u", scale=0.01, linear=True, doc="damping of the bristle"
    )
    sigma2: Scalar = param(0.01, bounds=(0.0, np.inf), unit="y*s/u", scale=0.01, linear=True, doc="viscous friction")
    Fc: Scalar = param(0.5, bounds=(0.0, np.inf), unit="y", scale=0.5, doc="Coulomb friction")
    dFs: Scalar = param(0.1, bounds=(0.0, np.inf), unit="y", scale=0.1, doc="static friction less Coulomb friction")
    vs: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u/s", scale=0.1, doc="Stribeck velocity")
    k: Scalar = param(0.0, unit="y/u", linear=True, doc="stiffness of the spring")
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the force")

    def init(self, u0: Scalar) -> State:
        """State: deflection of the bristle, and the last velocity, which a repeated time stamp keeps."""
        return jnp.zeros(2) * u0

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """The exact answer to a displacement at constant velocity."""
        passes, way = dt > 0, u1 - u0
        time = jnp.where(passes, dt, 1.0)
        v = jnp.where(passes, way / time, state[1])
        g = self.Fc + self.dFs * jnp.exp(-((v / self.vs) ** 2))
        end = jnp.sign(way) * g / self.sigma0
        z = end + (state[0] - end) * jnp.exp(-self.sigma0 * jnp.abs(way) / g)
        bending = jnp.where(passes, (z - state[0]) / time, 0.0)
        y = self.offset + self.k * u1 + self.sigma0 * z + self.sigma1 * bending + self.sigma2 * v
        return jnp.stack([z, v]), y

    def derived(self) -> tuple[Derived, ...]:
        """Static friction and the presliding displacement."""
        return (
            Derived("Fs", "y", "static friction", lambda m: m.Fc + m.dFs),
            Derived("z_c", "u", "deflection at which the bristle slips, Fc / sigma0", lambda m: m.Fc / m.sigma0),
        )

    def start(self, records: Sequence[Record]) -> LuGre:
        """A grid over the presliding displacement, the excess of static friction and vs; forces by linear least squares."""
        half, out = input_range(records).half, output_range(records)
        short = [record.segment(0, min(len(record), SAMPLES)) for record in records]
        short = [one for one, record in zip(short, records, strict=True) if one.used.any()] or list(records)
        steps = [(np.diff(one.u, prepend=one.u[0]), one.dt) for one in short]
        rates = [du / np.where(dt > 0, dt, 1.0) * (dt > 0) for du, dt in steps]
        typical = speed(short, TYPICAL)
        shapes = [(e, v) for e, v in itertools.product(_EXCESS, _BENDS_AT) if e or v == _BENDS_AT[-1]]
        grid = np.array([(half * bend, e, v * typical) for bend, (e, v) in itertools.product(_BEND, shapes)])
        runs = [_normalized(record, rate, grid) for record, rate in zip(short, rates, strict=True)]
        q, slope = (np.concatenate([run[k][r.used] for run, r in zip(runs, short, strict=True)]) for k in (0, 1))
        u, y = used_samples(short)
        v = np.concatenate([rate[record.used] for record, rate in zip(short, rates, strict=True)])
        beside = np.column_stack([v, u, offset_columns(short)])
        fits = [fit_linear(np.column_stack([q[:, j], slope[:, j], beside]), y) for j in range(len(grid))]
        costs = [cost if theta[0] > 0 else np.inf for theta, cost in fits]
        if not np.isfinite(min(costs)):
            rough = {"Fc": 0.2 * out.half, "dFs": 0.02 * out.half, "sigma0": 2.0 * out.half / half}
            return dataclasses.replace(self, **rough, vs=typical, offset=out.center)
        best = int(np.argmin(costs))
        (d, excess, vs), theta = grid[best], fits[best][0]
        return dataclasses.replace(
            self,
            sigma0=theta[0] / d,
            sigma1=max(theta[1] / d, 1e-3 * out.half / typical),
            sigma2=max(theta[2], 1e-3 * out.half / typical),
            Fc=theta[0],
            dFs=max(excess, 0.05) * theta[0],
            vs=vs,
            k=theta[3],
            offset=theta[4],
        )


def _normalized(record: Record, rate: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces sigma0 z / Fc and their rates of change for rows (presliding displacement, excess of static friction, vs), each (T, G)."""
    d, excess, vs = grid.T
    g = 1.0 + excess * np.exp(-((rate[:, None] / vs) ** 2))
    way = np.diff(record.u, prepend=record.u[0])
    end, left = np.sign(way)[:, None] * g, np.exp(-np.abs(way)[:, None] / (d * g))
    q, now = np.empty(g.shape), np.zeros(len(grid))
    for k in range(len(q)):
        q[k] = now = end[k] + (now - end[k]) * left[k]
    dt = record.dt[:, None]
    return q, np.diff(q, axis=0, prepend=0.0) / np.where(dt > 0, dt, 1.0) * (dt > 0)
