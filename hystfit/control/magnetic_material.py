"""The material of a magnetic fit in SI units: its law and the branches of its steady loop, as field and circuit programs need them."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hystfit.control.magnetic_law import Law, parts_of
from hystfit.errors import ModelError
from hystfit.params.units import MU0, parse_unit
from hystfit.results.steady_loops import Excitation

if TYPE_CHECKING:
    from hystfit.results.result import FitResult

POINTS = 401  # of each branch
_SEEN = 1e-3  # of the range, from which a line beside the law is a term of its own: the accuracy of every file


@dataclasses.dataclass(frozen=True, eq=False)
class Material:
    """A fitted material in SI units.

    Attributes:
        h, b: branches of the steady loop over the fitted range, rising then falling, fields [A/m] rising and flux densities [T],
            shape (2, POINTS).
        law: Jiles-Atherton; None for other models.
        lacking: terms that the published static law lacks, such as pinning that falls.
    """

    h: np.ndarray
    b: np.ndarray
    law: Law | None
    lacking: str = ""

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
                "these programs read static loops, or jiles-atherton-dynamic without terms of time beside it: refit with --model"
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
    """Fields and branches of a material in a circuit with a gap, at fields that both branches share.

    Raises:
        ModelError: the field falls while the flux density rises.
    """
    outside = h + gap * flux
    if (np.diff(outside) <= 0).any():
        raise ModelError(
            "the line beside the law makes the field fall while the flux density rises: refit without linear"
        )
    common = np.linspace(outside[:, 0].max(), outside[:, -1].min(), POINTS)
    return common, np.stack([np.interp(common, *branch) for branch in zip(outside, flux, strict=True)])


class _Sizes(NamedTuple):
    """Units of a fit.

    Attributes:
        field: size of the unit of the field [A/m].
        output: size of the unit of the flux density, polarization or magnetization [T].
        vacuum: whether that is a magnetization, to which the field adds for the flux density.
    """

    field: float
    output: float
    vacuum: bool

    @classmethod
    def of(cls, result: FitResult, *, by_flux: bool) -> _Sizes:
        """Those of a fit.

        Args:
            result: the fit.
            by_flux: the input is not the field, but what it magnetizes.

        Raises:
            ModelError: the units are no such units.
        """
        first = result.data[0]
        powers = lambda unit: getattr(parse_unit(unit), "powers", None)
        names = (first.y_unit, first.u_unit) if by_flux else (first.u_unit, first.y_unit)
        field, output = map(parse_unit, names)
        per_field = {powers("A/m"): 1.0, powers("T"): 1 / MU0}.get(field.powers) if field else None
        per_output = {powers("T"): 1.0, powers("A/m"): MU0}.get(output.powers) if output else None
        if field is None or output is None or per_field is None or per_output is None:
            raise ModelError(
                "a field program needs H in A/m, Oe or T and B, J or M in T or A/m; "
                f"the fit has {first.u_unit or 'no unit'} and {first.y_unit or 'no unit'}: give --units, or divide the moment by the volume"
            )
        return cls(per_field * field.factor, per_output * output.factor, output.powers == powers("A/m"))
