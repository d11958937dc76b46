"""The classical Preisach model: relays, or a density uniform within cells, on the triangle of thresholds (Song et al. 2005, eq. (1))."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import ClassVar, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.polynomial import legendre_series
from hystfit.models.preisach.everett import cells, mirror, second_differences
from hystfit.models.preisach.levels import Spacing, check_levels, choose_levels, levels_of_family
from hystfit.models.preisach.memory import CellMemory
from hystfit.models.preisach.reversible import ramp_count, ramps
from hystfit.models.preisach.staircase import Rest
from hystfit.models.starting import input_range, output_range
from hystfit.params.param import param
from hystfit.quality.reversal_curves import reversal_curves

Elements = Literal["cells", "relays"]


class Preisach(AbstractHysteresis):
    """Weighted relays gamma = +-1 that switch up at alpha and down at beta <= alpha, and a single-valued part:

        y = offset + sum of w_ij g_ij[u] + sum of s_k r_k(u) + sum over i >= 1 of b_i P_i((u - center) / half)

    With elements = "cells" (the default), g_ij is the mean of the relays whose alpha lies between levels i and i + 1 and beta
    between levels j and j + 1, j <= i: the density is uniform within a cell and the output continuous in the input. With
    "relays" g_ij is the one relay with alpha = level i and beta = level j, the classical definition. n (n + 1) / 2 weights
    belong to n + 1 levels of cells and to n levels of relays.

    r_k rises from 0 to 1 between levels k and k + 1 and goes on in a straight line beyond the outermost; `slopes` holds one s_k >= 0 for
    each, or none. With `symmetric`, mirror images in alpha + beta = 2 center share a weight and the r_k are odd about center, with one
    weight for each interval above it: the levels must be symmetric about the center then.

    `initial` is the state before the record: "demagnetized" (relays with alpha + beta > 2 center down, the others up),
    "negative" or "positive" saturation. Linear in w, slopes, b and offset; levels are chosen, not fitted.

    Raises:
        ModelError: levels that do not rise, weights of a number that does not fit them, an unknown option.
    """

    rate_independent: ClassVar[bool] = True

    w: Float[Array, " cells"] = param(
        bounds=(0.0, np.inf),
        unit="y",
        scale=0.01,
        linear=True,
        doc="masses of the cells or relays, (i, j) row by row, j <= i",
    )
    levels: Float[Array, " levels"] = param(unit="u", fixed=True, doc="thresholds, rising")
    slopes: Float[Array, " intervals"] = param(
        (), bounds=(0.0, np.inf), unit="y", scale=0.1, linear=True, doc="rises of the piecewise linear reversible part"
    )
    b: Float[Array, " degree"] = param(
        (), unit="y", linear=True, doc="Legendre coefficients 1, 2, ... of the reversible part"
    )
    offset: Float[Array, ""] = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the output")
    center: Float[Array, ""] = param(0.0, unit="u", fixed=True, doc="input of the demagnetized state")
    half: Float[Array, ""] = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="half of the input range")
    elements: Elements = eqx.field(static=True, default="cells")
    symmetric: bool = eqx.field(static=True, default=False)
    initial: Rest = eqx.field(static=True, default="demagnetized")
    spacing: Spacing = eqx.field(static=True, default="given")
    depth: int = eqx.field(static=True, default=64)

    def __check_init__(self) -> None:
        for name, value, known in (
            ("initial", self.initial, Rest),
            ("elements", self.elements, Elements),
            ("spacing", self.spacing, Spacing),
        ):
            if value not in get_args(known):
                raise ModelError(f"{name} must be one of {', '.join(get_args(known))}, got {value!r}")
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
                f"slopes must have no value or {self.intervals}, one an interval, got shape {self.slopes.shape}"
            )
        levels = self.levels
        if eqx.is_array(levels) and not _traced(levels):
            check_levels(np.asarray(levels), float(self.center) if not _traced(self.center) else None, self.symmetric)

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
        """A model with n (n + 1) / 2 cells or relays, whose levels `start` spreads over the records as `spacing` says.

        Args:
            n: cells, or relay levels, along each axis.
            symmetric: tie mirror images (magnetic materials); n is even then for cells.
            reversible: add the piecewise linear single-valued part.
            degree: of a polynomial single-valued part, 0 for none.
            elements: "cells" or "relays".
            initial: state before the record.
            spacing: "quantile" (equal shares of the samples), "square" (distances from the center that grow as squares),
                "uniform", "reversal-curves" (denser where such curves are steep; the model then starts from the saturation
                that they came from, whatever `initial` says), or "given" (leave the levels alone); None takes "square" where
                symmetric, "quantile" elsewhere.
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

    @classmethod
    def uniform(
        cls, n: int = 20, degree: int = 1, initial: Rest = "demagnetized", *, elements: Elements = "cells"
    ) -> Preisach:
        """Equally spaced levels and a polynomial reversible part.

        Raises:
            ModelError: fewer than one cell or degree one.
        """
        if degree < 1:
            raise ModelError(f"at least degree one is needed, got {degree}")
        return cls.of(n, degree=degree, reversible=False, elements=elements, initial=initial, spacing="uniform")

    # -- structure -------------------------------------------------------------------------------------------------------

    @property
    def n(self) -> int:
        """Cells, or relays, along each axis."""
        return self.levels.shape[0] - (self.elements == "cells")

    @property
    def weights(self) -> int:
        """Number of independent weights."""
        return mirror(self.n)[1].shape[1] if self.symmetric else self.n * (self.n + 1) // 2

    @property
    def intervals(self) -> int:
        """Number of slopes, where there are any."""
        return ramp_count(self.levels.shape[0], self.symmetric)

    def masses(self) -> Float[Array, " all"]:
        """Weights of all cells or relays, mirror images written out, shape (n (n + 1) / 2,)."""
        return self.w[mirror(self.n)[0]] if self.symmetric else self.w

    def thresholds(self) -> tuple[Float[Array, " all"], Float[Array, " all"]]:
        """Up and down threshold of every relay, or of the middle of every cell."""
        i, j = cells(self.n)
        at = self.levels if self.elements == "relays" else 0.5 * (self.levels[1:] + self.levels[:-1])
        return at[i], at[j]

    def single_valued(self, u: Float[Array, "..."]) -> Float[Array, "..."]:
        """The part of the output without memory, the offset included."""
        y = self.offset + legendre_series(
            jnp.concatenate([jnp.zeros(1, self.b.dtype), self.b]), (u - self.center) / self.half
        )
        if self.slopes.size:
            y = y + ramps(self.levels, self.center, u, self.symmetric, jnp) @ self.slopes
        return y

    # -- dynamics --------------------------------------------------------------------------------------------------------

    def init(self, u0: Float[Array, ""]) -> Float[Array, " state"]:
        """State after the input went from the initial state to u0: the dominant extrema, the last one repeated to fill the
        array; or the relays, +1 or -1.
        """
        if self.elements == "cells":
            return jnp.full((self.depth,), u0)
        up, down = self.thresholds()
        if self.initial == "demagnetized":
            rest = jnp.where(up + down > 2.0 * self.center, -1.0, 1.0)
        else:
            rest = jnp.full(up.shape, 1.0 if self.initial == "positive" else -1.0)
        return _switch(rest, up, down, u0)

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, ""], u1: Float[Array, ""], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, ""]]:
        """Wipe out the extrema that u1 passed; or switch the relays whose threshold it passed."""
        if self.elements == "relays":
            state = _switch(state, *self.thresholds(), u1)
            return state, self.single_valued(u1) + jnp.dot(self.masses(), state)
        state = self._remember(state, u1)
        memory = CellMemory.of(self)
        pairs = memory.pair(memory.place(state[1:]), memory.place(state[:-1]), state[1:] > state[:-1])
        return state, self.single_valued(u1) + memory.rest + memory.first(state[0]) + jnp.sum(pairs)

    def _remember(self, extrema: Array, u: Array) -> Array:
        # Nested intervals: those that contain u come first. A full memory forgets its smallest loop.
        before = {"demagnetized": 2 * self.center - extrema[0], "negative": -jnp.inf, "positive": jnp.inf}[self.initial]
        other = jnp.concatenate([jnp.reshape(before, (1,)), extrema[:-1]])
        inside = (jnp.minimum(other, extrema) < u) & (u < jnp.maximum(other, extrema))
        kept = jnp.minimum(jnp.sum(inside), self.depth - 1)
        return jnp.where(jnp.arange(self.depth) < kept, extrema, u)

    # -- host ------------------------------------------------------------------------------------------------------------

    def start(self, records: Sequence[Record]) -> Preisach:
        """Levels spread over the input as `spacing` says; the weights follow from a linear solve.

        Raises:
            DataError: a constant input; records that are no reversal curves, where the spacing asks for them.
        """
        out, place = output_range(records), input_range(records)
        if self.spacing == "reversal-curves":
            family = reversal_curves(records)
            levels = levels_of_family(family, self.n, relays=self.elements == "relays")
            center = 0.5 * float(levels[0] + levels[-1])
            initial: Rest = "positive" if family.rising else "negative"
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
        w = jnp.full(self.w.shape, 0.5 * out.half / self.w.size)
        slopes = jnp.full(self.slopes.shape, 0.5 * out.half / max(self.slopes.size, 1))
        b = jnp.zeros_like(self.b).at[:1].set(0.5 * out.half)
        half = max(abs(place.center + place.half - center), abs(place.center - place.half - center))
        values = (w, levels, slopes, b, out.center, center, half)
        arrays = tuple(jnp.asarray(value, dtype=self.w.dtype) for value in values)
        model = dataclasses.replace(self, initial=initial)
        return eqx.tree_at(lambda m: (m.w, m.levels, m.slopes, m.b, m.offset, m.center, m.half), model, arrays)

    def advice(self, u: np.ndarray) -> tuple[str, ...]:
        """Where the input leaves the levels, beyond which the model has no relays."""
        low, high = float(self.levels[0]), float(self.levels[-1])
        slack = 1e-9 * (high - low)
        out = (u < low - slack) | (u > high + slack)
        if self.elements == "relays" or not out.any():
            return ()
        return (
            f"the input leaves the range of the thresholds, {low:g} to {high:g}, at {int(out.sum())} of {u.size} samples "
            f"(it reaches {u.min():g} to {u.max():g}): the prediction there is extrapolation",
        )

    def roughness(self) -> dict[str, np.ndarray]:
        """Second differences of the weights along both thresholds, counted in cells, and of the slopes."""
        rough = {"w": second_differences(self.n, self.symmetric)}
        if self.slopes.size:
            rough["slopes"] = np.diff(np.eye(self.slopes.size), 2, axis=0)
        return {name: matrix for name, matrix in rough.items() if matrix.size}


def _traced(value: object) -> bool:
    return isinstance(value, Tracer)


def _switch(state: Array, up: Array, down: Array, u: Array) -> Array:
    return jnp.where(u >= up, 1.0, jnp.where(u <= down, -1.0, state))
