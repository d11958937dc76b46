"""The classical Preisach model: relays, or a density uniform within cells, on the triangle of thresholds (Song et al. 2005, eq. (1))."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, get_args

import equinox as eqx
import numpy as np
import scipy  # loads its subpackages when they are first used
from jax.core import Tracer
from jaxtyping import Array, Float
from numpy.polynomial.legendre import legder, legval

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import Use
from hystfit.models.preisach.design_matrix import output, states_of_several
from hystfit.models.preisach.everett import cells, mirror, second_differences
from hystfit.models.preisach.levels import Spacing, check_levels, choose_levels, levels_of_family, steep_levels
from hystfit.models.preisach.plane import AbstractPlane, Elements, ramp_count, ramps
from hystfit.models.preisach.stack_inverse import PreisachStep
from hystfit.models.preisach.staircase import Rest
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import Block, DesignMatrix, Penalty
from hystfit.models.shared.shapes import Scalar
from hystfit.models.shared.simulation import checked_drive
from hystfit.models.shared.slopes import Slopes
from hystfit.models.shared.starting import input_range, output_range
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.param import element_weights, leaves_of, param
from hystfit.quality.loops import SAME_LEVEL
from hystfit.quality.needs import Needs
from hystfit.quality.reversal_curves import reversal_curves

_RIDGE = 1e-3  # penalty on the weights themselves, relative to that on their second differences
# Cells along an axis that a comparison tries, one step from the model's own at a time.
_SIZES = (8, 12, 16, 24, 30, 40, 48, 60)
# The largest of them, for reversal curves and for other records: measured loops gain less than 10 % from 48 to 60 cells, in four times
# the time.
_MOST = {True: 60, False: 48}


class Preisach(AbstractPlane):
    """Weighted relays gamma = +-1 that switch up at alpha and down at beta <= alpha, and a single-valued part:

        y = offset + sum of w_ij g_ij[u] + sum of s_k r_k(u) + sum over i >= 1 of b_i P_i((u - center) / half)

    With elements = "cells" (the default), g_ij is the mean of the relays whose alpha lies between levels i and i + 1 and beta
    between levels j and j + 1, j <= i: the density is uniform within a cell and the output continuous in the input. With
    "relays" g_ij is the one relay with alpha = level i and beta = level j, the classical definition. n (n + 1) / 2 weights
    belong to n + 1 levels of cells and to n levels of relays.

    r_k rises from 0 to 1 between levels k and k + 1 and continues in a straight line beyond the outermost; `slopes` holds one s_k >= 0 for
    each, or none. With `symmetric`, mirror images in alpha + beta = 2 center share a weight and the r_k are odd about center, with one
    weight for each interval above it: the levels must be symmetric about the center then.

    `initial` is the state before the record: "demagnetized" (relays with alpha + beta > 2 center down, the others up),
    "negative" or "positive" saturation. Linear in w, slopes, b and offset; levels are chosen, not fitted.

    Raises:
        ModelError: levels that do not rise, weights of a number that does not fit them, an unknown option.
    """

    rate_independent: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "initial": get_args(Rest),
        "elements": get_args(Elements),
        "spacing": get_args(Spacing),
    }
    has_fast_run: ClassVar[bool] = True
    estimator: ClassVar[str] = "preisach"
    needs: ClassVar[Needs] = Needs(
        turning_pairs=(3, 10),
        direction="counter-clockwise",
        regularized=True,
        too_few="weights of relays that never switch are not determined; regularize, or measure first-order reversal curves",
    )

    w: Float[Array, " cells"] = element_weights(
        scale=0.01, doc="weights of the cells or relays, (i, j) row by row, j <= i"
    )
    levels: Float[Array, " levels"] = param(unit="u", fixed=True, doc="thresholds, rising")
    slopes: Float[Array, " intervals"] = element_weights((), doc="rises of the piecewise linear reversible part")
    b: Float[Array, " degree"] = param(
        (), unit="y", linear=True, doc="Legendre coefficients 1, 2, ... of the reversible part"
    )
    offset: Scalar = param(
        0.0,
        unit="y",
        per_record=True,
        linear=True,
        # Reversal curves start from one state: an offset for each would absorb the differences between them.
        common=lambda model: model.from_saturation,
        doc="constant part of the output",
    )
    center: Scalar = param(0.0, unit="u", fixed=True, doc="input of the demagnetized state")
    half: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="half of the input range")
    elements: Elements = eqx.field(static=True, default="cells")
    symmetric: bool = eqx.field(static=True, default=False)
    initial: Rest = eqx.field(static=True, default="demagnetized")
    spacing: Spacing = eqx.field(static=True, default="given")
    depth: int = eqx.field(static=True, default=64)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.depth < 2:
            raise ModelError(f"depth must be at least 2 extrema, got {self.depth}")
        if all(hasattr(leaf, "shape") for leaf in (self.w, self.levels, self.slopes)):
            self._check_shapes()

    def _check_shapes(self) -> None:
        if self.levels.shape[0] < 1 + (self.elements == "cells"):
            raise ModelError(f"{self.elements} need more levels than {self.levels.shape[0]}")
        if self.w.shape != (self.weights,):
            raise ModelError(
                f"{self.levels.shape[0]} levels of {'symmetric ' * self.symmetric}{self.elements} have {self.weights} weights, "
                f"got shape {self.w.shape}"
            )
        if self.slopes.shape not in ((0,), (self.intervals,)):
            raise ModelError(
                f"slopes must have no value or {self.intervals}, one per interval, got shape {self.slopes.shape}"
            )
        if eqx.is_array(self.levels) and not isinstance(self.levels, Tracer):
            center = None if isinstance(self.center, Tracer) else float(self.center)
            check_levels(np.asarray(self.levels), center, self.symmetric)

    @classmethod
    def of(
        cls,
        n: int = 24,
        *,
        symmetric: bool = False,
        reversible: bool = True,
        degree: int = 0,
        elements: Elements = "cells",
        initial: Rest = "demagnetized",
        spacing: Spacing | None = None,
        depth: int = 64,
    ) -> Preisach:
        """A model with n (n + 1) / 2 cells or relays, whose levels `start` spreads over the records by `spacing`.

        Args:
            n: cells, or relay levels, along each axis.
            symmetric: tie mirror images (magnetic materials); n is even then for cells.
            reversible: add the piecewise linear single-valued part.
            degree: of a polynomial single-valued part, 0 for none.
            elements: "cells" or "relays".
            initial: state before the record.
            spacing: "quantile" (equal shares of the samples), "square" (distances from the center that grow as squares),
                "uniform", "steep" (denser where the branches are steep), "reversal-curves" (denser where such curves are
                steep; the model then starts from the saturation that they came from, regardless of `initial`), or "given"
                (leave the levels alone); None takes "square" where symmetric, "quantile" elsewhere.
            depth: extrema that the sample-by-sample form remembers; the compiled form has no limit.

        Raises:
            ModelError: n less than one, or odd with symmetric cells; a negative degree; symmetric levels from reversal curves.
        """
        if n < 1 or degree < 0:
            raise ModelError(f"n must be at least one and degree not negative, got {n} and {degree}")
        if symmetric and spacing == "reversal-curves":
            raise ModelError("levels from reversal curves follow the curves' slopes, and are not symmetric")
        if symmetric and n % 2 and elements == "cells":
            raise ModelError(f"symmetric cells need an even n, so that the center is a level; got {n}")
        levels = np.linspace(-1, 1, n + 1) if elements == "cells" else (2 * np.arange(n) + 1 - n) / n
        count = mirror(n)[1].shape[1] if symmetric else n * (n + 1) // 2
        intervals = ramp_count(levels.size, symmetric) if reversible else 0
        return cls(
            w=np.full(count, 1e-3),
            levels=levels,
            slopes=np.full(intervals, 0.5 / max(intervals, 1)),
            b=np.zeros(degree),
            elements=elements,
            symmetric=symmetric,
            initial=initial,
            spacing=spacing or ("square" if symmetric else "quantile"),
            depth=depth,
        )

    def start(self, records: Sequence[Record]) -> Preisach:
        """Levels spread over the input by `spacing`; the weights follow from a linear solve.

        Raises:
            DataError: a constant input; records that are not reversal curves, where the spacing needs them.
        """
        out, place = output_range(records), input_range(records)
        if self.spacing == "reversal-curves":
            family = reversal_curves(records)
            levels = levels_of_family(family, self.n, relays=self.elements == "relays")
            center = 0.5 * float(levels[0] + levels[-1])
            initial: Rest = "positive" if family.rising else "negative"
        elif self.spacing == "steep":
            initial, relays = self.initial, self.elements == "relays"
            about = float(self.center) if self.symmetric else None
            levels, center = steep_levels(records, self.n, about, relays=relays)
        else:
            initial = self.initial
            levels, center = choose_levels(
                [r.u for r in records],
                np.asarray(self.levels),
                None if self.spacing != "given" and not self.symmetric else float(self.center),
                spacing=self.spacing,
                symmetric=self.symmetric,
                margin=self.elements == "relays",
            )
        return dataclasses.replace(
            self,
            w=np.full(self.w.shape, 0.5 * out.half / self.w.size),
            levels=levels,
            slopes=np.full(self.slopes.shape, 0.5 * out.half / max(self.slopes.size, 1)),
            b=np.where(np.arange(self.b.size) == 0, 0.5 * out.half, 0.0),
            offset=out.center,
            center=center,
            half=max(abs(place.high - center), abs(place.low - center)),
            initial=initial,
        )

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Where the input leaves the levels, beyond which the model has no relays."""
        low, high = float(self.levels[0]), float(self.levels[-1])
        slack = 1e-4 * (high - low)  # calibration points and the noise of a field sensor lie so far outside
        out = (u < low - slack) | (u > high + slack)
        if self.elements == "relays" or not out.any():
            return ()
        return (
            f"the input leaves the range of the thresholds, {low:g} to {high:g}, at {int(out.sum())} of {u.size} samples "
            f"(it reaches {u.min():g} to {u.max():g}): the prediction there is extrapolation",
        )

    # -- optional methods ------------------------------------------------------------------------------------------------

    def settings(self) -> dict[str, int | bool | str]:
        return {
            "n": self.n,
            "symmetric": self.symmetric,
            "reversible": bool(self.slopes.size),
            "degree": self.b.shape[0],
            "elements": self.elements,
            # Reversal curves start from the saturation that they came from, whatever is set.
            "initial": "demagnetized" if self.from_saturation else self.initial,
            "spacing": self.spacing,
            "depth": self.depth,
        }

    @property
    def from_saturation(self) -> bool:
        """Whether its levels come from reversal curves."""
        return self.spacing == "reversal-curves"

    def free_run(self, u: Any, dt: Any = None) -> np.ndarray:
        """By the distinct states that the input visits, without a program to compile."""
        return output(self, np.asarray(checked_drive(self, u, dt)[0]))

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns on the distinct states that the input visits."""
        return next(self.design_matrices([np.asarray(checked_drive(self, u, dt)[0])]))

    def design_matrices(self, inputs: Sequence[np.ndarray]) -> Iterator[DesignMatrix]:
        """`design_matrix` for each of several inputs, in less time."""
        count = np.bincount(mirror(self.n)[0]) if self.symmetric else np.ones(self.w.size, dtype=int)
        penalties = {"w": Penalty(_smoothing(self.n, self.symmetric), count, self.elements)}
        if self.slopes.size:
            penalties["slopes"] = Penalty(_smoothing(self.slopes.size))
        names = ("w", *("slopes",) * bool(self.slopes.size), *("b",) * bool(self.b.size), "offset")
        leaves = {leaf.path[-1]: leaf for leaf in leaves_of(self)}
        for columns, single_valued, index in states_of_several(self, inputs):
            parts = zip(names, (columns, *single_valued, np.ones((columns.shape[0], 1))), strict=True)
            blocks = (Block(leaves[name].index, leaves[name].info, part, penalties.get(name)) for name, part in parts)
            yield DesignMatrix(tuple(blocks), np.zeros(columns.shape[0]), index)

    def choices(self, records: Sequence[Record]) -> tuple[tuple[Preisach, ...], ...]:
        """Other levels, with no more cells than distinct inputs; other states before the records; a line; more or fewer cells."""
        distinct = np.unique(np.concatenate([record.u[record.used] for record in records])).size
        even = lambda n: max(n - n % 2, 2) if self.symmetric else max(n, 1)
        n = even(min(self.n, distinct))
        known = sorted({even(size) for size in _SIZES if size <= min(distinct, _MOST[self.from_saturation])})
        sizes = [{"n": size} for size in ([k for k in known if k < n][-1:] + [k for k in known if k > n][:1])]
        spacings = ("square", "uniform", "steep") if self.symmetric else ("quantile", "uniform", "steep")
        groups: list[list[dict[str, Any]]] = [[{}], sizes]
        if not self.from_saturation:
            levels = [{"spacing": spacing} for spacing in spacings if spacing != self.spacing]
            inside = any(rest_before(record) == "demagnetized" for record in records)
            rests = get_args(Rest) if inside and not self.symmetric else ()
            before = [{"initial": rest} for rest in rests if rest != self.initial]
            # A straight line of either sign beside the rising parts.
            groups = [[{}, *levels], before, [{"degree": 1 - self.b.size}] if self.b.size < 2 else [], sizes]
        make = lambda change: type(self).of(**{**self.settings(), "n": n, **change})
        return tuple(tuple(map(make, group)) for group in groups)

    def plane(self) -> Preisach:
        """Itself."""
        return self

    def reach(self) -> tuple[float, float]:
        """From the lowest to the highest level."""
        return float(self.levels[0]), float(self.levels[-1])

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """After every reversal, in every interval between levels; None for point relays, whose output jumps."""
        if self.elements != "cells":
            return None
        n, levels, weights = self.n, np.asarray(self.levels), np.asarray(self.w)
        width, mass = np.diff(levels), np.zeros((n, n))
        mass[cells(n)] = 2 * (weights[mirror(n)[0]] if self.symmetric else weights)
        # The cell on the diagonal, a triangle, counts from nothing at the start of the interval to twice its mass at the end.
        ends, off = (np.zeros(n), 2 * np.diag(mass)), np.tril(mass, -1)
        rising, falling = np.cumsum(off[:, ::-1], axis=1), np.cumsum(off, axis=0)
        x = (np.linspace(levels[:-1], levels[1:], 5) - float(self.center)) / float(self.half)
        bent = legval(x, legder(np.append(0.0, np.asarray(self.b)))) / float(self.half)
        single = np.zeros(n)
        if self.slopes.size:
            single = np.diff(
                ramps(levels, np.asarray(self.center), levels, self.symmetric, np) @ np.asarray(self.slopes)
            )
        alone = single / width + bent
        return Slopes.of(*(alone + (part + end) / width for part in (*rising.T, *falling) for end in ends))

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """See `PreisachStep`; a search for point relays."""
        return PreisachStep.of(self) if self.elements == "cells" and not self.no_inverse else super().step_inverse(sign)

    def obstacle(self, use: Use) -> str | None:
        """See the base class; cells have none, which needs no tables of an inverse."""
        return None if self.elements == "cells" and not self.no_inverse else super().obstacle(use)

    def c_part(self) -> CPart:
        """Stack of extrema with the tables of the inverse.

        Raises:
            ModelError: point relays.
        """
        if self.elements != "cells":
            raise ModelError(
                "point relays have no continuous inverse and no C code: fit Preisach with cells (--model preisach, or "
                "elements='cells')"
            )
        solver = PreisachStep.of(self)
        knots, everett = np.asarray(solver.knots), solver.memory.everett
        tables = {"off": everett.off.ravel(), "diagonal": everett.diagonal, "sums": everett.sums, "knots": knots}
        tables |= {"first": solver.excursion, "b": np.append(0.0, self.b)}
        tables["straight"] = solver.straight if self.slopes.size else np.zeros(knots.size)
        initial = {"negative": -1, "demagnetized": 0, "positive": 1}[self.initial]
        states = 1 + 2 * self.depth
        return CPart.of(self, "preisach", states, rest=solver.memory.rest, initial=initial, **tables)


def rest_before(record: Record) -> Rest:
    """Saturation before a record that starts at its lowest or highest input, where the state before it hardly matters."""
    place = (record.u[0] - record.u.min()) / (float(np.ptp(record.u)) or 1.0)
    return "negative" if place <= SAME_LEVEL else "positive" if place >= 1 - SAME_LEVEL else "demagnetized"


@functools.lru_cache(maxsize=16)
def _smoothing(count: int, symmetric: bool | None = None) -> np.ndarray:
    """Penalty on second differences, with a small one on the weights themselves.

    `count` is that of the cells along each axis, or where `symmetric` is None of the slopes.
    """
    along_axis = lambda: scipy.sparse.csr_array(np.diff(np.eye(count), 2, axis=0))
    D = along_axis() if symmetric is None else second_differences(count, symmetric)
    matrix = (D.T @ D).toarray()
    matrix[np.diag_indices_from(matrix)] += _RIDGE
    matrix.flags.writeable = False
    return matrix
