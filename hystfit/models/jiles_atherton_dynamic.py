"""Jiles-Atherton with eddy currents and excess loss, driven by the field: loops that widen with the frequency."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import in_room
from hystfit.data.record import Record
from hystfit.models.jiles_atherton import STEEPEST, JilesAtherton, JilesAthertonStep, search_in_c
from hystfit.models.shared.bracketed import Root, implicit_root
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.simulation import run
from hystfit.models.shared.starting import best_of_grid, input_range, offset_columns, speeds, thinned, used_samples
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.host_arrays import compiled
from hystfit.params.param import param
from hystfit.quality.needs import Needs

_SLOW = 1.5  # typical rate over the slowest one, up to which a record counts for the static law
# Largest fields of eddy currents and of excess loss over the input's, from which a fit starts.
_SHARES = (3e-3, 0.03, 0.1, 0.3)
_ROUNDED = 1e-3  # rate over the largest one, below which the root of the excess field is rounded


class JilesAthertonDynamic(JilesAtherton):
    """`JilesAtherton` behind the fields of eddy currents and excess loss (Bertotti 1988; Jiles 1994):

        H = Hin + eddy dB/dt + excess dB/dt / ((dB/dt)^2 + e^2)^(1/4),  B = slope Hin + M(Hin),

    where the field H at the surface is the input, the field Hin inside drives the static law, and the output is offset + B: the
    polarization and its rate where slope = 0. Of a sheet of thickness d and conductivity sigma, eddy = sigma d^2 / 12, as long as d
    is below the skin depth; excess is the root of sigma G V0 S (see `Excess`).

    A step solves for the effective field, with the rate of B over the sample (implicit Euler: stable at any step, first order in the
    time step). It is the exact inverse of `jiles-atherton-b+viscous+excess`. Hin moves towards H, so that B still rises for a while
    after H has turned. With the field at one frequency only, eddy, excess and k are nearly redundant.
    """

    rate_independent: ClassVar[bool] = False
    needs: ClassVar[Needs] = Needs(
        time=True,
        rate=True,
        speeds=2,
        symmetry="symmetric",
        direction="counter-clockwise",
        magnetic=True,
        too_few="eddy, excess and k are nearly redundant at one frequency",
    )

    Ms: Scalar = param(1.0, bounds=(0.0, np.inf), unit="y", scale=2.0, doc="saturation magnetization")
    eddy: Scalar = param(
        0.01, bounds=(0.0, np.inf), unit="u*s/y", scale=0.05, doc="field of eddy currents over the rate, sigma d^2 / 12"
    )
    excess: Scalar = param(
        0.01,
        bounds=(0.0, np.inf),
        unit="u*s^0.5/y^0.5",
        scale=0.1,
        doc="field of excess loss over the root of the rate",
    )
    e: Scalar = param(1e-6, bounds=(0.0, np.inf), unit="y/s", fixed=True, doc="rate below which the root is rounded")

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample: the effective field at which the field inside and the dynamic fields add up to u1; none where no time passes."""
        new = jnp.where(dt > 0, self._driven(state, u1, jnp.where(dt > 0, dt, 1.0)), state)
        return new, self.offset + self.flux(new)

    def inner(self, state: State) -> Scalar:
        """The field inside the material [u]."""
        return state[0] - self.mean_field * self.total(state)

    def flux(self, state: State) -> Scalar:
        """Output without its offset [y]."""
        return self.slope * self.inner(state) + self.Ms * self.total(state)

    def dynamic(self, rate: Array) -> Array:
        """Field of eddy currents and excess loss [u] at rates of the output [y/s], of any shape."""
        return self.eddy * rate + self.excess * rate / (rate**2 + self.e**2) ** 0.25

    def _driven(self, state: State, u1: Scalar, dt: Scalar) -> State:
        """The state a time dt later under the field u1."""
        inside, before = self.inner(state), self.flux(state)
        s = jnp.sign(u1 - inside)  # the input rises with the field inside, which moves towards it

        def miss(field: Scalar) -> Scalar:
            new = self.at_field(state, s, field)
            return self.inner(new) + self.dynamic((self.flux(new) - before) / dt) - u1

        span = self.span(state, jnp.minimum(u1, inside), jnp.maximum(u1, inside))
        moved = self.at_field(state, s, implicit_root(miss, state[0], *span, least=STEEPEST))
        return jnp.where(s == 0, state, moved)  # without a direction no side of the last field is that of the root

    def start(self, records: Sequence[Record]) -> JilesAthertonDynamic:
        """The static law of the slowest records; then the best of a grid over the dynamic fields, with the measured rate of the output."""
        typical = [float(np.median(of_record)) if (of_record := speeds(r)).size else np.inf for r in records]
        slow = [r for r, rate in zip(records, typical, strict=True) if rate <= _SLOW * min(typical)]
        law, short = super().start(slow), thinned(records, 300)
        assert isinstance(law, JilesAthertonDynamic)  # of its own kind, with other values
        rates = [_output_rate(r) for r in short]
        fastest = max(float(np.max(np.abs(rate))) for rate in rates) or 1.0
        half = input_range(records).half
        grid = half * np.array(list(itertools.product(_SHARES, _SHARES))) / [fastest, fastest**0.5]
        plain = dataclasses.replace(law, Ms=1.0, slope=0.0, offset=0.0, e=_ROUNDED * fastest)
        # Records of any length share one program.
        inputs = [
            (in_room(r.u, hold=True), in_room(rate), np.int64(len(r))) for r, rate in zip(short, rates, strict=True)
        ]
        runs = [
            np.asarray(_shifted(plain, grid, *one))[:, : len(r)][:, r.used]
            for one, r in zip(inputs, short, strict=True)
        ]
        u, y = used_samples(short)
        best = best_of_grid(np.concatenate(runs, axis=1).T, offset_columns(short), y - float(law.slope) * u)
        eddy, excess = grid[best.which].tolist()
        dynamic = {"eddy": eddy, "excess": excess, "e": _ROUNDED * fastest}
        return dataclasses.replace(law, Ms=best.scale(y), offset=float(best.coefficients[1]), **dynamic)

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        return JilesAthertonDynamicStep(self)

    def c_part(self) -> CPart:
        to_output = (0.0, self.slope, self.Ms - self.slope * self.mean_field)
        dynamic = {"eddy": self.eddy, "excess": self.excess, "e": self.e}
        return search_in_c(self, self, (1.0, -self.mean_field), to_output, dynamic)


class JilesAthertonDynamicStep(AbstractStepInverse):
    """Inverse of `JilesAthertonDynamic`: the field inside as of the static law, to which the dynamic fields are added."""

    model: JilesAthertonDynamic
    needs_limits: ClassVar[bool] = True

    def solve(self, state: State, u0: Scalar, target: Scalar, dt: Scalar, low: Scalar, high: Scalar) -> Root:
        model, inside = self.model, self.model.inner(state)
        span = jnp.minimum(low, inside), jnp.maximum(high, inside)
        root = JilesAthertonStep(model).solve(state, inside, target, dt, *span)
        rate = (target - model.offset - model.flux(state)) / jnp.where(dt > 0, dt, 1.0)
        return Root(jnp.where(dt > 0, root.x + model.dynamic(rate), u0), root.rising & (dt > 0))


@compiled
def _shifted(
    plain: JilesAthertonDynamic,
    grid: Float[Array, "n 2"],
    u: Float[Array, " T"],
    rate: Float[Array, " T"],
    count: Array,
) -> Float[Array, "n T"]:
    """M / Ms of the static law under an input less the dynamic fields of a measured rate, for rows (eddy, excess) of a grid.

    Of the first `count` samples; what is behind them is padding.
    """

    def one(row: Array) -> Array:
        inside = u - dataclasses.replace(plain, eddy=row[0], excess=row[1]).dynamic(rate)
        law = JilesAtherton(**{name: getattr(plain, name) for name in _LAW}, curve=plain.curve)  # type: ignore[arg-type]
        return run(law, inside, jnp.zeros_like(u), count=count)[0]

    return jax.vmap(one)(grid)


_LAW = tuple(field.name for field in dataclasses.fields(JilesAtherton) if field.name != "curve")


def _output_rate(record: Record) -> Float[np.ndarray, " T"]:
    """Rate of the measured output [y/s], by central differences between the samples that count; 0 where no time passes."""
    used = record.used & np.isfinite(record.y)
    t = np.cumsum(record.dt)
    at, first = np.unique(t[used], return_index=True)
    if at.size < 3:
        return np.zeros(len(record))
    return np.interp(t, at, np.gradient(record.y[used][first], at))
