"""The material of a magnetic fit in SI units: its law and the branches of its steady loop, as field and circuit programs need them."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hystfit.errors import ModelError
from hystfit.models.jiles_atherton import JilesAtherton
from hystfit.models.jiles_atherton_dynamic import JilesAthertonDynamic
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.linear import Linear
from hystfit.models.rate import Excess, Viscous
from hystfit.models.sum import Sum
from hystfit.params.units import MU0, size_in
from hystfit.results.measured.steady_loops import Excitation

if TYPE_CHECKING:
    from hystfit.results.result import FitResult


@dataclasses.dataclass(frozen=True)
class Law:
    """B' = mu0 (mu H' + M),  H = H' + eddy dB'/dt + excess dB'/dt / ((dB'/dt)^2 + e^2)^(1/4) + gap B',  B = B' + air H.

    H' and M are those of `JilesAtherton`: the field inside the material, and what it magnetizes.
    """

    Ms: float  # Ms, a, k: [A/m]
    a: float
    k: float
    alpha: float  # alpha, c: of the mean field, and reversible part
    c: float
    q: float = 0.0  # fall of the pinning with the magnetization
    # p, r: weight of the first of two anhysteretic curves, and ratio of their shapes; p = 1 for one curve
    p: float = 1.0
    r: float = 1.0
    tanh: bool = False  # whether that is the curve, instead of the Langevin function
    eddy: float = 0.0  # [A s/(m T)]
    excess: float = 0.0  # [A s^0.5/(m T^0.5)]
    e: float = 1e-6  # [T/s]
    mu: float = 1.0  # relative permeability beside the magnetization, 1 in the published law
    air: float = 0.0  # flux density over the field, of a path beside the material [T m/A]
    gap: float = 0.0  # field over the flux density, of a gap in the material [A/(m T)]

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
    """A Jiles-Atherton model taken apart: its static law by the field, those dynamic fields that it has, and a straight line beside."""

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
        """The parameters in SI units, from the units of the model; in `vacuum` the field itself adds to the flux density."""
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
    parts: dict[type, Any] = {type(part): part for part in members}
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


POINTS = 401  # of each branch
_SEEN = 1e-3  # of the range, from which a line beside the law is a term of its own: the accuracy of every file


@dataclasses.dataclass(frozen=True, eq=False)
class Material:
    """A fitted material in SI units."""

    # h, b: branches of the steady loop over the fitted range, rising then falling, fields [A/m] rising and flux densities [T], shape (2,
    # POINTS)
    h: np.ndarray
    b: np.ndarray
    law: Law | None  # Jiles-Atherton; None for other models
    lacking: str = ""  # terms that the published static law lacks, such as pinning that falls

    @classmethod
    def of(cls, result: FitResult) -> Material:
        """The material of a fit: of a dynamic model its static loop, with the dynamic fields in the law.

        Raises:
            ModelError: field and output have other units, the model depends on time in another way, its dynamic fields act on J, or
                its line makes the field fall while the flux density rises.
        """
        parts = parts_of(result.model)
        by_flux = parts is not None and parts.by_flux
        sizes = _Sizes.of(result, by_flux=by_flux)
        model = result.model if parts is None else parts.slow
        if not model.rate_independent:
            raise ModelError(
                "these programs take static models, or jiles-atherton-dynamic without other time-dependent terms: refit with --model"
            )
        if parts is not None and parts.dynamic and float(parts.static.slope) == 0.0:
            raise ModelError("the dynamic fields act on the polarization: fit B over H with --units A/m,T")
        low, high = result.input_range
        if parts is not None and by_flux:
            inside = [record.y[record.used] - parts.line * record.u[record.used] for record in result.data]
            low, high = (float(of([of(fields) for fields in inside])) for of in (np.min, np.max))
        excitation = Excitation(low, high, 1.0, points=2 * (POINTS - 1))
        steady, h = excitation.loops(model.free_run(excitation.loop.u)[None]), sizes.field * excitation.inputs
        flux = sizes.output * np.stack([steady.rising[0], steady.falling[0]])
        if sizes.vacuum:
            flux = flux + MU0 * h
        if parts is None:
            return cls(np.stack([h] * 2), flux, None, f"{type(model).__name__} is no Jiles-Atherton model")
        law = parts.law(sizes.field, sizes.output, vacuum=sizes.vacuum)
        if law.gap:
            h, flux = _with_gap(h, flux, law.gap)
        beside = np.abs([law.mu - 1.0, law.air / MU0]).sum() * MU0 * np.abs(h).max() / np.ptp(flux)
        line = max(beside, np.abs(law.gap * flux).max() / np.ptp(h)) > _SEEN
        lacking = ", ".join(filter(None, (law.variants, "a line beside the law" * bool(line))))
        if law.air < 0 and not line:
            law = dataclasses.replace(law, air=0.0)
        return cls(np.stack([h] * 2), flux, law, lacking)


def _with_gap(h: np.ndarray, flux: np.ndarray, gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Fields and branches of a material in a circuit with a gap, at fields that both branches share."""
    outside = h + gap * flux
    if (np.diff(outside) <= 0).any():
        raise ModelError("with the straight line, the field falls while the flux density rises: refit without linear")
    common = np.linspace(outside[:, 0].max(), outside[:, -1].min(), POINTS)
    return common, np.stack([np.interp(common, *branch) for branch in zip(outside, flux, strict=True)])


class _Sizes(NamedTuple):
    """Units of a fit: of the field [A/m], and of the flux density, polarization or magnetization [T]; a magnetization adds the field."""

    field: float
    output: float
    vacuum: bool

    @classmethod
    def of(cls, result: FitResult, *, by_flux: bool) -> _Sizes:
        """Those of a fit; `by_flux` where the input is not the field, but what it magnetizes."""
        first = result.data[0]
        names = (first.y_unit, first.u_unit) if by_flux else (first.u_unit, first.y_unit)
        field, output = (size_in(name, "A/m", "T") for name in names)
        if field is None or output is None:
            raise ModelError(
                "a field program needs H in A/m, Oe or T and B, J or M in T or A/m; "
                f"the fit has {first.u_unit or 'no unit'} and {first.y_unit or 'no unit'}: give --units, or divide the moment by the volume"
            )
        per_field, per_output = (
            field[1] / (MU0 if field[0] == "T" else 1.0),
            output[1] * (MU0 if output[0] == "A/m" else 1.0),
        )
        return cls(per_field, per_output, output[0] == "A/m")
