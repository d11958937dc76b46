"""Jiles-Atherton with its variants, dynamic fields and a line beside it in SI units, as files of other programs state it."""

from __future__ import annotations

import dataclasses
from typing import Any

from hystfit.models.jiles_atherton import JilesAtherton
from hystfit.models.jiles_atherton_dynamic import JilesAthertonDynamic
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.linear import Linear
from hystfit.models.rate import Excess, Viscous
from hystfit.models.sum import Sum
from hystfit.params.units import MU0


@dataclasses.dataclass(frozen=True)
class Law:
    """B' = mu0 (mu H' + M),  H = H' + eddy dB'/dt + excess dB'/dt / ((dB'/dt)^2 + e^2)^(1/4) + gap B',  B = B' + air H.

    H' and M are those of `JilesAtherton`: the field inside the material, and what it magnetizes.

    Attributes:
        Ms, a, k: [A/m].
        alpha, c: of the mean field, and reversible part.
        q: fall of the pinning with the magnetization.
        p, r: weight of the first of two anhysteretic curves, and ratio of their shapes; p = 1 for one curve.
        tanh: whether that is the curve, instead of the Langevin function.
        eddy: [A s/(m T)].
        excess: [A s^0.5/(m T^0.5)].
        e: [T/s].
        mu: relative permeability beside the magnetization, 1 in the published law.
        air: flux density over the field, of a path beside the material [T m/A].
        gap: field over the flux density, of a gap in the material [A/(m T)].
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
    mu: float = 1.0
    air: float = 0.0
    gap: float = 0.0

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
        line: slope of a straight line beside the law, output over input of the model.
        by_flux: whether the input of the model is the flux density.
    """

    static: JilesAtherton
    dynamic: dict[str, float]
    line: float = 0.0
    by_flux: bool = False

    @property
    def slow(self) -> JilesAtherton:
        """The model under a slow field, without its gap."""
        line = 0.0 if self.by_flux else self.line
        return dataclasses.replace(self.static, slope=self.static.slope + line)

    def law(self, per_field: float, per_output: float, *, vacuum: bool = False) -> Law:
        """The parameters in SI units.

        Args:
            per_field: size of the unit of the field [A/m].
            per_output: size of the unit of the flux density, polarization or magnetization [T].
            vacuum: whether the field itself adds to the flux density, beside what the model gives.
        """
        static, one = self.static, lambda values, other: float(values[0]) if values.size else other
        saturation = per_output / MU0 * float(static.Ms)
        units = {"eddy": per_field / per_output, "excess": per_field / per_output**0.5, "e": per_output}
        beside = self.line if self.dynamic and not self.by_flux else 0.0  # the dynamic fields do not act on it
        mu = float(vacuum) + per_output / per_field / MU0 * float(static.slope if beside else self.slow.slope)
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
            mu=mu or 1.0,
            air=per_output / per_field * beside,
            gap=per_field / per_output * self.line if self.by_flux else 0.0,
            **{name: units[name] * value for name, value in self.dynamic.items()},
        )


def parts_of(model: Any) -> Parts | None:
    """The parts of a model driven by the field, or by the flux density with `Viscous` and `Excess`, and a line; None of others."""
    members = model.parts if isinstance(model, Sum) else (model,)
    parts = {type(part): part for part in members}
    line, viscous, excess = (parts.pop(kind, None) for kind in (Linear, Viscous, Excess))
    if len(parts) != 1 or len(members) != 1 + sum(part is not None for part in (line, viscous, excess)):
        return None
    (law,) = parts.values()
    slope = 0.0 if line is None else float(line.k)
    rates = {} if viscous is None else {"eddy": float(viscous.c)}
    rates |= {} if excess is None else {"excess": float(excess.g), "e": float(excess.e)}
    if isinstance(law, JilesAthertonField):
        return Parts(law.magnet, rates, slope, by_flux=True)
    if rates or not isinstance(law, JilesAtherton):
        return None
    if not isinstance(law, JilesAthertonDynamic):
        return Parts(law, {}, slope)
    shared = {field.name: getattr(law, field.name) for field in dataclasses.fields(JilesAtherton)}
    return Parts(JilesAtherton(**shared), {name: float(getattr(law, name)) for name in ("eddy", "excess", "e")}, slope)
