"""Jiles-Atherton hysteresis of magnetic materials (Jiles and Atherton 1986), integrated along its effective field.

Variants differ in the anhysteretic curve and in the pinning, which may fall with the magnetization.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.bracketed import Root, implicit_root, solve_rising
from hystfit.models.shared.c_code import CPart
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
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.param import param
from hystfit.params.units import MU0
from hystfit.quality.needs import Needs

FIRST_CURVE = 64  # steps from the demagnetized state to the first input
STEEPEST = 1e-6  # slope dH/dHe from which the field's derivative counts as that of a jump
CURVES = {"langevin": 1.0 / 3.0, "tanh": 1.0}  # anhysteretic curves, and their slope at zero
# Shapes of the anhysteretic curve, coupling, pinning and reversible part over the scales of a record, from which a fit starts.
_GRID = ((0.05, 0.15, 0.4, 1.0), (0.3, 0.7, 0.9), (0.03, 0.1, 0.3), (0.1, 0.5))
_FALLING = (0.0, 2.0)  # falls of the pinning, from which a fit starts; those of three soft materials are 1.8 to 2.5
# Weight of the first of two anhysteretic curves and ratio of their shapes, from which a fit starts.
_DOUBLE = (0.7, 4.0)


class JilesAtherton(AbstractHysteresis):
    """Jiles-Atherton magnetization:  M = c Man + (1 - c) Mirr,  dMirr/dHe = max(s (Man - Mirr), 0) / k,  s = sign(dH).

    The anhysteretic curve is Man = Ms L(He / a) with the Langevin function L, the effective field He = H + alpha M. The output is
    offset + slope H + M: the polarization, or B where slope = mu0, which a fit sets where H is in A/m and B in T. Mirr stays where it
    would move against the field, so that no susceptibility is negative (Deane 1994). A record begins on the first curve, from the
    demagnetized state.

    `coupling` = alpha Ms f'(0) / a, with f the anhysteretic curve over Ms (f'(0) = 1/3 of the Langevin function), is the part of the
    anhysteretic slope that feeds back: below 1 that curve has no jump. A fit reports `alpha` in units of H per unit of the output; with
    both H and M in A/m it is the dimensionless alpha of finite-element programs, with the output in T it is that divided by mu0.

    Variants: the curve tanh(He / a); two curves, p f(He / a) + (1 - p) f(He / (r a)); pinning k exp(-q (M / Ms)^2), which takes
    the loops of soft ferrites from 0.7 to 0.2 % of their range.

    The law in He does not contain alpha. A step solves for the new He and is exact for an anhysteretic curve that is straight between
    two samples: second order in the step of He.
    """

    rate_independent: ClassVar[bool] = True
    searches: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"curve": tuple(CURVES)}
    needs: ClassVar[Needs] = Needs(
        amplitudes=2,
        symmetry="symmetric",
        direction="counter-clockwise",
        magnetic=True,
        too_few="a, coupling and k are nearly redundant below saturation",
    )

    Ms: Scalar = param(1.0, bounds=(0.0, np.inf), unit="y", scale=2.0, doc="saturation magnetization", linear=True)
    a: Scalar = param(0.3, bounds=(0.0, np.inf), unit="u", scale=0.3, doc="shape of the anhysteretic curve")
    coupling: Scalar = param(0.5, bounds=(0.0, 1.0), doc="mean field, alpha Ms / (3 a)")
    k: Scalar = param(0.3, bounds=(0.0, np.inf), unit="u", scale=0.3, doc="pinning, nearly the coercive field")
    c: Scalar = param(0.2, bounds=(0.0, 1.0), doc="reversible part of the magnetization")
    q: Float[Array, " falling"] = param(
        (), bounds=(-5.0, 5.0), vector=True, doc="fall of the pinning with the magnetization, k exp(-q (M / Ms)^2)"
    )
    p: Float[Array, " double"] = param(
        (), bounds=(0.0, 1.0), vector=True, doc="weight of the first of two anhysteretic curves"
    )
    r: Float[Array, " double"] = param(
        (),
        bounds=(1.0, 100.0),
        scale=3.0,
        vector=True,
        doc="shape of the second anhysteretic curve over that of the first",
    )
    slope: Scalar = param(0.0, bounds=(0.0, np.inf), unit="y/u", fixed=True, doc="output without material, mu0 in B(H)")
    offset: Scalar = param(0.0, unit="y", per_record=True, doc="output of the demagnetized state", linear=True)

    curve: str = eqx.field(default="langevin", static=True)

    @classmethod
    def of(cls, curve: str = "langevin", pinning: bool = False, double: bool = False) -> JilesAtherton:
        """The model with one of its variants.

        Args:
            curve: "langevin" or "tanh", the anhysteretic curve.
            pinning: pinning that falls with the magnetization.
            double: two anhysteretic curves.

        Raises:
            ModelError: a curve of another name.
        """
        second = ([_DOUBLE[0]], [_DOUBLE[1]]) if double else ((), ())
        return cls(curve=curve, q=[0.0] if pinning else (), p=second[0], r=second[1])

    def settings(self) -> dict[str, int | bool | str]:
        return {"curve": self.curve, "pinning": self.q.size > 0, "double": self.p.size > 0}

    def anhysteretic(self, x: Scalar) -> Scalar:
        """Man / Ms at an effective field over a."""
        one = langevin if self.curve == "langevin" else jnp.tanh
        return self.p[0] * one(x) + (1.0 - self.p[0]) * one(x / self.r[0]) if self.p.size else one(x)

    @property
    def initial_slope(self) -> Scalar:
        """Of the anhysteretic curve over Ms, per effective field over a."""
        slope = CURVES[self.curve]
        return slope * (self.p[0] + (1.0 - self.p[0]) / self.r[0]) if self.p.size else jnp.asarray(slope)

    @property
    def mean_field(self) -> Scalar:
        """alpha Ms, the effective field of the saturated material without a field [u]."""
        return self.a * self.coupling / self.initial_slope

    def init(self, u0: Scalar) -> State:
        """State: effective field and irreversible part of the magnetization over Ms, shape (2,), on the first curve."""
        return on_first_curve(self._moved, u0)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample: the effective field at u1, and what it magnetizes."""
        new = self._moved(state, u0, u1)
        return new, self.offset + self.slope * u1 + self.Ms * self.total(new)

    @jax.jit  # traced once for the first curve and the samples, and once for each derivative
    def _moved(self, state: State, u0: Scalar, u1: Scalar) -> State:
        """The state at u1, where He - alpha M = u1."""
        s = jnp.sign(u1 - u0)
        miss = lambda field: field - self.mean_field * self.total(self.at_field(state, s, field)) - u1
        return self.at_field(state, s, implicit_root(miss, state[0], *self.span(state, u1, u1), least=STEEPEST))

    def span(self, state: State, low: Scalar, high: Scalar) -> tuple[Scalar, Scalar]:
        """Lowest and highest effective field on the way from a state to inputs between two limits [u].

        Args:
            state: before, shape (2,).
            low, high: limits of the input [u].
        """
        return jnp.minimum(low - self.mean_field, state[0]), jnp.maximum(high + self.mean_field, state[0])

    @jax.jit
    def at_field(self, state: State, s: Scalar, field: Scalar) -> State:
        """The state at an effective field, with the anhysteretic curve straight on the way there.

        Args:
            state: before, shape (2,).
            s: direction of the input, -1, 0 or 1.
            field: new effective field [u].
        """
        before, irreversible = state
        g0, g1 = self.anhysteretic(before / self.a), self.anhysteretic(field / self.a)
        k = jnp.maximum(self._pinning_between(state, s, field, g0, g1), jnp.finfo(field.dtype).tiny)
        rise, ahead = g1 - g0, irreversible - g0  # Mirr rests until the curve has passed it
        resting = jnp.clip(jnp.where(s * ahead > 0, ahead / jnp.where(rise == 0, 1.0, rise), 0.0), 0.0, 1.0)
        begin = jnp.where(s * ahead > 0, irreversible, g0)
        z = (1.0 - resting) * jnp.abs(field - before) / k
        mean = jnp.where(z > 0, -jnp.expm1(-z) / jnp.where(z > 0, z, 1.0), 1.0)
        moved = g1 - (g1 - begin) * mean - (begin - irreversible) * jnp.exp(-z)
        return jnp.stack([field, jnp.where(resting < 1.0, moved, irreversible)])

    def pinning(self, m: Scalar) -> Scalar:
        """k at a magnetization over Ms [u]."""
        return self.k * jnp.exp(-self.q[0] * m**2) if self.q.size else self.k

    def _pinning_between(self, state: State, s: Scalar, field: Scalar, g0: Scalar, g1: Scalar) -> Scalar:
        """k half way to an effective field [u], by a rough step there: second order, as the rest of the step."""
        if not self.q.size:
            return self.k
        m = self.total(state)
        z = jnp.abs(field - state[0]) / self.pinning(m)
        follows = s * jnp.maximum(s * (0.5 * (g0 + g1) - state[1]), 0.0) * z / (1.0 + z)
        return self.pinning(0.5 * (m + self.c * g1 + (1.0 - self.c) * (state[1] + follows)))

    def total(self, state: State) -> Scalar:
        """M / Ms."""
        return self.c * self.anhysteretic(state[0] / self.a) + (1.0 - self.c) * state[1]

    def derived(self) -> tuple[Derived, ...]:
        """The mean field parameter in the form of the literature."""
        return (Derived("alpha", "u/y", "mean field parameter, He = H + alpha M", lambda m: m.mean_field / m.Ms),)

    def start(self, records: Sequence[Record]) -> JilesAtherton:
        """The best of a grid over a, coupling, k and c, with Ms and the offset by least squares."""
        half, short = input_range(records).half, thinned(records, 300)
        given = {(record.u_unit, record.y_unit) for record in records}
        slope = MU0 if given == {("A/m", "T")} else float(self.slope)
        points = np.array(list(itertools.product(*_GRID, _FALLING if self.q.size else (0.0,)))).T
        grid = {"a": half * points[0], "coupling": points[1], "k": half * points[2], "c": points[3]}
        grid |= {"q": points[4][:, None]} if self.q.size else {}
        second = dict(zip("pr", ([value] for value in _DOUBLE), strict=True)) if self.p.size else {}
        plain = JilesAtherton(curve=self.curve, q=self.q, **second)  # type: ignore[arg-type]
        columns = grid_columns(plain, grid, short)
        u, y = used_samples(short)
        y = y - slope * u
        best = best_of_grid(columns, offset_columns(short), y)
        shape = {name: values[best.which] for name, values in grid.items()} | second
        return dataclasses.replace(self, Ms=best.scale(y), **shape, slope=slope, offset=best.coefficients[1])  # type: ignore[arg-type]

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        return JilesAthertonStep(self)

    def c_part(self) -> CPart:
        return search_in_c(self, self, (1.0, -self.mean_field), (self.slope, 0.0, self.Ms))


class JilesAthertonStep(AbstractStepInverse):
    """Inverse of `JilesAtherton`: one search for the effective field, as for a step of the model, after which H = He - alpha M."""

    model: JilesAtherton
    needs_limits: ClassVar[bool] = True

    def solve(self, state: State, u0: Scalar, target: Scalar, dt: Scalar, low: Scalar, high: Scalar) -> Root:
        ja = self.model
        s = jnp.sign(target - (ja.offset + ja.slope * u0 + ja.Ms * ja.total(state)))
        total = lambda field: ja.total(ja.at_field(state, s, field))
        miss = lambda field: ja.slope * field + (ja.Ms - ja.slope * ja.mean_field) * total(field) + ja.offset - target
        root = solve_rising(miss, state[0], *ja.span(state, low, high))
        return Root(root.x - ja.mean_field * total(root.x), root.rising)


def search_in_c(
    model: Any,
    law: JilesAtherton,
    to_input: tuple[Scalar | float, ...],
    to_output: tuple[Scalar | float, ...],
    dynamic: Mapping[str, Scalar] | None = None,
) -> CPart:
    """C code that searches for the effective field at each input.

    `to_input` are factors of the effective field and of M / Ms in the input, the first one positive; `to_output` those of the input, the
    effective field and M / Ms in the output; `dynamic` has `eddy`, `excess` and `e` of a `JilesAthertonDynamic`.
    """
    second = law.p.size > 0
    values = {"tanh": law.curve == "tanh", "q": law.q[0] if law.q.size else 0.0, "double": second}
    values |= {"p": law.p[0] if second else 1.0, "r": law.r[0] if second else 1.0, "first_curve": FIRST_CURVE}
    values |= {"eddy": 0.0, "excess": 0.0, "e": 1.0} | dict(dynamic or {}) | {"dynamic": dynamic is not None}
    values |= dict(zip(("rise", "lift", "of_input", "of_field", "of_total"), (*to_input, *to_output), strict=True))
    return CPart.of(model, "jiles_atherton", **values)


def on_first_curve(moved: Callable[[State, Scalar, Scalar], State], u0: Scalar) -> State:
    """The state at the input u0, by steps of a model from the demagnetized state."""
    path = u0 * jnp.linspace(0.0, 1.0, FIRST_CURVE + 1)
    begin = jnp.zeros(2) + 0.0 * u0
    return jax.lax.scan(lambda s, ends: (moved(s, *ends), None), begin, (path[:-1], path[1:]))[0]


def langevin(x: Array) -> Array:
    """coth x - 1 / x of numbers of any shape, by its series near zero."""
    near = jnp.abs(x) < 1e-2
    far = jnp.where(near, 1.0, x)
    square = jnp.where(near, x, 0.0) ** 2
    series = x * (1.0 / 3.0 - square * (1.0 / 45.0 - square * (2.0 / 945.0 - square / 4725.0)))
    return jnp.where(near, series, 1.0 / jnp.tanh(far) - 1.0 / far)
