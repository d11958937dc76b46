"""Jiles-Atherton driven by the flux density: the field of field programs and loss models."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.models.base import AbstractHysteresis
from hystfit.models.jiles_atherton import CURVES, JilesAtherton, on_first_curve, search_in_c
from hystfit.models.shared.bracketed import implicit_root
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.reported import Derived
from hystfit.models.shared.shapes import Scalar, State
from hystfit.params.param import param
from hystfit.params.relative_size import ROUNDED
from hystfit.quality.needs import Needs

_SHARED = ("Ms", "a", "coupling", "k", "c", "q", "slope")  # fields of the law in both forms


class JilesAthertonField(AbstractHysteresis):
    """`JilesAtherton` the other way round: input B, output H, with B = mu0 H + M where M is a polarization.

    A step solves for the effective field He at which slope (He - alpha M) + M = B. The left side rises with He for every alpha that
    magnets have, also where M(H) has a jump: there is no singular denominator. Eddy currents and excess loss are terms beside it:
    `jiles-atherton-b+viscous+excess`.
    """

    rate_independent: ClassVar[bool] = True
    searches: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"curve": tuple(CURVES)}
    needs: ClassVar[Needs] = Needs(
        amplitudes=2,
        symmetry="symmetric",
        direction="clockwise",
        magnetic=True,
        too_few="a, coupling and k are nearly redundant below saturation",
    )

    Ms: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u", scale=2.0, doc="saturation polarization")
    a: Scalar = param(0.3, bounds=(0.0, np.inf), unit="y", scale=0.3, doc="shape of the anhysteretic curve")
    coupling: Scalar = param(0.5, bounds=(0.0, 1.0), doc="mean field, alpha Ms / (3 a)")
    k: Scalar = param(0.3, bounds=(0.0, np.inf), unit="y", scale=0.3, doc="pinning, nearly the coercive field")
    c: Scalar = param(0.2, bounds=(0.0, 1.0), doc="reversible part of the magnetization")
    q: Float[Array, " falling"] = param(
        (), bounds=(-5.0, 5.0), vector=True, doc="fall of the pinning with the magnetization, k exp(-q (M / Ms)^2)"
    )
    slope: Scalar = param(0.1, bounds=(0.0, np.inf), unit="u/y", fixed=True, doc="mu0, output without material")
    offset: Scalar = param(0.0, unit="y", per_record=True, doc="field of the demagnetized state", linear=True)
    curve: str = eqx.field(default="langevin", static=True)

    @classmethod
    def of(cls, curve: str = "langevin", pinning: bool = False) -> JilesAthertonField:
        """The model with one of its variants."""
        return cls(curve=curve, q=[0.0] if pinning else ())

    def settings(self) -> dict[str, int | bool | str]:
        return {"curve": self.curve, "pinning": self.q.size > 0}

    @property
    def magnet(self) -> JilesAtherton:
        """The same law with the field as input."""
        return JilesAtherton(**{name: getattr(self, name) for name in _SHARED}, curve=self.curve)

    def init(self, u0: Scalar) -> State:
        """State: effective field and irreversible part of the magnetization over Ms, shape (2,), on the first curve."""
        return on_first_curve(self._moved, u0)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample: the effective field at which the flux density is u1, less the mean field."""
        new, law = self._moved(state, u0, u1), self.magnet
        return new, self.offset + new[0] - law.mean_field * law.total(new)

    def _moved(self, state: State, u0: Scalar, u1: Scalar) -> State:
        law, s = self.magnet, jnp.sign(u1 - u0)
        # What the polarization adds beside the part that its own field takes away.
        rest = self.Ms - self.slope * law.mean_field
        steepest = self.slope + rest * (law.initial_slope / self.a)
        flux = lambda field: self.slope * field + rest * law.total(law.at_field(state, s, field))
        miss = lambda field: (flux(field) - u1) / steepest
        width = jnp.abs(rest) / jnp.maximum(self.slope, jnp.finfo(u1.dtype).tiny)
        low, high = jnp.minimum(u1 / self.slope - width, state[0]), jnp.maximum(u1 / self.slope + width, state[0])
        moved = law.at_field(state, s, implicit_root(miss, state[0], low, high, least=ROUNDED))
        return jnp.where(s == 0, state, moved)  # without a direction no side of the last field is that of the root

    def derived(self) -> tuple[Derived, ...]:
        """The mean field parameter in the form of the literature."""
        return (
            Derived("alpha", "y/u", "mean field parameter, He = H + alpha M", lambda m: m.magnet.mean_field / m.Ms),
        )

    def start(self, records: Sequence[Record]) -> JilesAthertonField:
        """That of `JilesAtherton` on the records with input and output exchanged."""
        law = JilesAtherton.of(self.curve, self.q.size > 0)
        if {(record.u_unit, record.y_unit) for record in records} != {("T", "A/m")}:
            law = dataclasses.replace(law, slope=self.slope)
        found = law.start([_exchanged(record) for record in records])
        return dataclasses.replace(self, **{name: getattr(found, name) for name in _SHARED})

    def c_part(self) -> CPart:
        law = self.magnet
        rest = self.Ms - self.slope * law.mean_field
        return search_in_c(self, law, (self.slope, rest), (0.0, 1.0, -law.mean_field))


def _exchanged(record: Record) -> Record:
    """A record without its unmeasured samples, with input and output exchanged."""
    kept = record.used
    return Record(record.y[kept], record.u[kept], u_unit=record.y_unit, y_unit=record.u_unit, name=record.name)
