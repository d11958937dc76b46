"""Jiles-Atherton with its variants and dynamic fields in SI units, as files of other programs state it."""

from __future__ import annotations

import dataclasses
from typing import Any

from hystfit.models.jiles_atherton import JilesAtherton
from hystfit.models.jiles_atherton_dynamic import JilesAthertonDynamic
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.rate import Excess, Viscous
from hystfit.models.sum import Sum
from hystfit.params.units import MU0


@dataclasses.dataclass(frozen=True)
class Law:
    """B = mu0 (H' + M), H = H' + eddy dB/dt + excess dB/dt / ((dB/dt)^2 + e^2)^(1/4), with H' and M of `JilesAtherton`.

    Attributes:
        Ms, a, k: [A/m].
        alpha, c: of the mean field, and reversible part.
        q: fall of the pinning with the magnetization.
        p, r: weight of the first of two anhysteretic curves, and ratio of their shapes; p = 1 for one curve.
        tanh: whether that is the curve, instead of the Langevin function.
        eddy: [A s/(m T)].
        excess: [A s^0.5/(m T^0.5)].
        e: [T/s].
    """

    Ms: float
    a: float
    k: float
    alpha: float
    c: float
    q: float = 0.0
    p: float = 1.0
    r: float = 1.0
    tanh: bool = False
    eddy: float = 0.0
    excess: float = 0.0
    e: float = 1e-6

    @property
    def variants(self) -> str:
        """Terms of the static law that the published one lacks, in words."""
        terms = {
            "pinning that falls (q)": self.q != 0.0,
            "a second anhysteretic curve (p, r)": self.p != 1.0,
            "the curve tanh": self.tanh,
        }
        return ", ".join(name for name, present in terms.items() if present)


@dataclasses.dataclass(frozen=True)
class Parts:
    """A Jiles-Atherton model taken apart.

    Attributes:
        static: the static law, with the field as input.
        dynamic: `eddy`, `excess` and `e` of the dynamic fields, in the units of the model; without those that it does not have.
        by_flux: whether the input of the model is the flux density.
    """

    static: JilesAtherton
    dynamic: dict[str, float]
    by_flux: bool = False

    def law(self, per_field: float, per_output: float) -> Law:
        """The parameters in SI units.

        Args:
            per_field: size of the unit of the field [A/m].
            per_output: size of the unit of the flux density, polarization or magnetization [T].
        """
        static, one = self.static, lambda values, other: float(values[0]) if values.size else other
        saturation = per_output / MU0 * float(static.Ms)
        units = {"eddy": per_field / per_output, "excess": per_field / per_output**0.5, "e": per_output}
        return Law(
            Ms=saturation,
            a=per_field * float(static.a),
            k=per_field * float(static.k),
            alpha=per_field * float(static.mean_field) / saturation,
            c=float(static.c),
            q=one(static.q, 0.0),
            p=one(static.p, 1.0),
            r=one(static.r, 1.0),
            tanh=static.curve == "tanh",
            **{name: units[name] * value for name, value in self.dynamic.items()},
        )


def parts_of(model: Any) -> Parts | None:
    """The parts of a model driven by the field, or by the flux density, alone or in a sum with `Viscous` and `Excess`; None of others."""
    if isinstance(model, JilesAthertonDynamic):
        shared = {field.name: getattr(model, field.name) for field in dataclasses.fields(JilesAtherton)}
        return Parts(JilesAtherton(**shared), {name: float(getattr(model, name)) for name in ("eddy", "excess", "e")})
    if isinstance(model, JilesAtherton):
        return Parts(model, {})
    parts = {type(part): part for part in (model.parts if isinstance(model, Sum) else (model,))}
    law, viscous, excess = (parts.pop(kind, None) for kind in (JilesAthertonField, Viscous, Excess))
    if (
        law is None
        or parts
        or (isinstance(model, Sum) and len(model.parts) != 1 + (viscous is not None) + (excess is not None))
    ):
        return None
    dynamic = {} if viscous is None else {"eddy": float(viscous.c)}
    return Parts(
        law.magnet,
        dynamic | ({} if excess is None else {"excess": float(excess.g), "e": float(excess.e)}),
        by_flux=True,
    )
