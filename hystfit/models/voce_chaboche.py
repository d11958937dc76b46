"""The updated Voce-Chaboche law of steel (Hartloper, de Castro e Sousa and Lignos 2021), with an exact step for any strain increment."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis, check_same_length
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.starting import best_of_grid, grid_columns, input_range, thinned, used_samples
from hystfit.models.shared.uniaxial_material import UniaxialMaterial, lost_constants
from hystfit.params.param import param
from hystfit.quality.needs import Needs

_NEWTON = 8  # steps that the plastic strain of one sample takes at most, from zero, to rounding
_MOST = 8  # backstresses of the material of OpenSees
_SOFTEST = 0.02  # least slope of the yield condition, as a fraction of E: below it, the law itself softens faster than it unloads
# Yield strain / half range, Q / sy0, g * half range.
_GRID = ((0.003, 0.01, 0.03, 0.1), (0.0, 0.5), (10.0, 100.0, 600.0))


class VoceChaboche(AbstractHysteresis):
    """Stress of steel against its strain, with isotropic hardening, an initial yield plateau and K backstresses:

        sig = E (u - ep),   |sig - sum a_k| <= sy(p),   p = integral of |dep|
        sy(p) = sy0 + Q (1 - exp(-b p)) - D (1 - exp(-a p)),   da_k = g_k (s S_k - a_k) dp

    S_k = C_k / g_k is the largest value of a backstress and g_k the rate with which it is reached; C_k and g_k are those of the
    literature. D lowers the yield stress over the first plastic strains and so makes the plateau. A sample solves the yield condition for
    its plastic strain, with backstresses that are exact for any increment: the sampling has no effect on the stress. Derivatives follow
    from the implicit function theorem. Fits may swap the backstresses, which differ by their rates alone.

    The device rests without stress at zero strain before the record; the output is offset + sig.

    Raises:
        ModelError: S and g of different shapes.

    Source: Hartloper, de Castro e Sousa and Lignos (2021), Journal of Structural Engineering 147, 04021028.
    """

    rate_independent: ClassVar[bool] = True
    counts: ClassVar[dict[str, str]] = {"backstresses": "S"}
    needs: ClassVar[Needs] = Needs(
        amplitudes=2,
        symmetry="symmetric",
        direction="clockwise",
        too_few="isotropic hardening (Q, b) and backstresses (S, g) trade off",
    )

    E: Scalar = param(10.0, bounds=(0.0, np.inf), unit="y/u", scale=10.0, doc="elastic modulus")
    sy0: Scalar = param(0.5, bounds=(0.0, np.inf), unit="y", scale=0.5, doc="initial yield stress")
    Q: Scalar = param(0.1, bounds=(0.0, np.inf), unit="y", scale=0.1, doc="isotropic hardening at saturation")
    b: Scalar = param(5.0, bounds=(0.0, np.inf), unit="1/u", scale=1.0, doc="rate of the isotropic hardening")
    D: Scalar = param(0.05, bounds=(0.0, np.inf), unit="y", scale=0.1, doc="loss of the initial yield stress")
    a: Scalar = param(20.0, bounds=(0.0, np.inf), unit="1/u", scale=10.0, doc="rate of that loss")
    S: Float[Array, " backstresses"] = param(
        (0.2, 0.2), bounds=(0.0, np.inf), unit="y", scale=0.2, vector=True, doc="largest value of each backstress"
    )
    g: Float[Array, " backstresses"] = param(
        (3.0, 30.0), bounds=(0.0, np.inf), unit="1/u", scale=10.0, vector=True, doc="rate of each backstress"
    )
    # Fixed: a free constant stands in for kinematic hardening. On the first 60 % of steel_resspylab/example_2 it becomes -14 MPa, and the
    # error on the rest 4.4 % of the range instead of 2.6.
    offset: Scalar = param(
        0.0, unit="y", fixed=True, linear=True, doc="stress of the undeformed specimen: zero of the load cell"
    )

    def __check_init__(self) -> None:
        check_same_length(self, "S", "g", "backstress")

    @classmethod
    def of(cls, backstresses: int = 2) -> VoceChaboche:
        """A model with this many backstresses.

        Raises:
            ModelError: fewer than one.
        """
        if backstresses < 1:
            raise ModelError(f"at least one backstress is needed, got {backstresses}")
        return cls(S=np.full(backstresses, 0.4 / backstresses), g=np.geomspace(3.0, 30.0, backstresses))

    def init(self, u0: Scalar) -> State:
        """State after loading from zero strain to u0: plastic strain, its path and the backstresses, shape (2 + K,)."""
        rest = jnp.zeros(2 + self.S.size, u0.dtype) + 0.0 * u0
        return self._moved(rest, u0)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample: elastic, or the plastic strain that meets the yield condition."""
        new = self._moved(state, u1)
        return new, self.offset + self.E * (u1 - new[0])

    def _moved(self, state: State, u1: Scalar) -> State:
        back = state[2:]
        trial = self.E * (u1 - state[0])
        s = jnp.where(trial < jnp.sum(back), -1.0, 1.0)
        dp = self._plastic(s * trial, s * back, state[1])
        moved = s * self.S - (s * self.S - back) * jnp.exp(-self.g * dp)
        return jnp.concatenate([jnp.stack([state[0] + s * dp, state[1] + dp]), moved])

    def _plastic(self, trial: Scalar, back: Array, p: Scalar) -> Scalar:
        """The increment dp >= 0 at which the yield condition is met, with all signs in the direction of the stress."""
        still, *constants = jax.tree.map(jax.lax.stop_gradient, (self, trial, back, p))

        def newton(_: Any, dp: Scalar) -> Scalar:
            excess, slope = still._condition(*constants, dp)
            return jnp.maximum(dp - excess / slope, 0.0)

        solved = jax.lax.fori_loop(0, _NEWTON, newton, jnp.zeros_like(trial))
        # One more step, with derivatives of the excess alone, is the implicit function theorem.
        excess, slope = self._condition(trial, back, p, solved)
        yields = trial - jnp.sum(back) > self._yield(p)
        return jnp.where(yields, solved - excess / jax.lax.stop_gradient(slope), 0.0)

    def _condition(self, trial: Scalar, back: Array, p: Scalar, dp: Scalar) -> tuple[Scalar, Scalar]:
        """Stress beyond the yield surface after an increment dp, and its derivative in dp, kept below that of `_SOFTEST`."""
        left = (self.S - back) * jnp.exp(-self.g * dp)
        excess = trial - self.E * dp - jnp.sum(self.S - left) - self._yield(p + dp)
        rates = self.D * self.a * jnp.exp(-self.a * (p + dp)) - self.Q * self.b * jnp.exp(-self.b * (p + dp))
        return excess, jnp.minimum(-self.E - jnp.sum(self.g * left) + rates, -_SOFTEST * self.E)

    def _yield(self, p: Scalar) -> Scalar:
        return self.sy0 - self.Q * jnp.expm1(-self.b * p) + self.D * jnp.expm1(-self.a * p)

    def uniaxial_material(self) -> UniaxialMaterial:
        """`UVCuniaxial`, with C_k = S_k g_k, and the rates in rising order.

        Raises:
            ModelError: more backstresses than the material takes.
        """
        if self.S.size > _MOST:
            raise ModelError(f"UVCuniaxial has at most {_MOST} backstresses, and the model has {self.S.size}")
        first = tuple(float(getattr(self, name)) for name in ("E", "sy0", "Q", "b", "D", "a"))
        g, S = np.asarray(self.g), np.asarray(self.S)
        pairs = tuple(float(value) for k in np.argsort(g) for value in (S[k] * g[k], g[k]))
        lost = lost_constants(offset=float(self.offset))
        return UniaxialMaterial("UVCuniaxial", (*first, int(g.size), *pairs), lost)

    def c_part(self) -> CPart:
        return CPart.of(self, "voce_chaboche", softest=_SOFTEST, newton=_NEWTON)

    def start(self, records: Sequence[Record]) -> VoceChaboche:
        """The best of a grid over yield strain, isotropic hardening and rate, with the stresses scaled by least squares."""
        half, short = input_range(records).half, thinned(records, 400)
        ey, Q, g = np.array(list(itertools.product(*_GRID))).T
        count = self.S.size
        plain = VoceChaboche(sy0=1.0, b=1.0 / half, D=0.1, a=50.0 / half, S=np.full(count, 0.6 / count), g=self.g)
        spread = 10.0 ** (np.arange(count) - 0.5 * (count - 1))  # rates of backstresses a factor of 10 apart
        grid = {"E": 1.0 / (ey * half), "Q": Q + 1e-3, "g": g[:, None] / half * spread}
        columns = grid_columns(plain, grid, short)
        _, y = used_samples(short)
        best = best_of_grid(columns, np.zeros((y.size, 0)), y)
        sy0 = best.scale(y)
        unit = dataclasses.replace(plain, **{name: values[best.which] for name, values in grid.items()})
        scaled = {name: sy0 * np.asarray(getattr(unit, name)) for name in ("E", "sy0", "Q", "D", "S")}
        return dataclasses.replace(self, **scaled, b=unit.b, a=unit.a, g=unit.g)
