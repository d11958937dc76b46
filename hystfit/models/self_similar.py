"""Stops of the input over its largest value so far: loops that grow with their peak, soften and slip, by one convex solve."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.play_columns import play_columns
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.starting import output_range
from hystfit.params.param import element_places, param
from hystfit.quality.loops import APART
from hystfit.quality.needs import Needs

_THRESHOLDS = (0.03, 0.08, 0.15, 0.25, 0.4, 0.6, 0.8)  # of the stops, as fractions of the largest input so far
POWERS = (1, 3, 5)  # of the backbone: odd
_RENEWED = 8  # exponent of the growth of the peak with which the path of the fading part is forgotten
_FLOOR = 0.02  # largest input from which the loop scales, as a fraction of that of the records


class SelfSimilarStops(AbstractHysteresis):
    """Weighted stops of v = u / M, where M is the largest |u| so far, with weights that change with M:

        y = offset + sum over b of B_b(log M) [sum over j of w[b, j] (v - p_j) + sum over i of c[b, i] v^(2 i + 1)]
              + (M / M_K) exp(-path / decay) [sum over j of fading_j (v - p_j) + sum over i of ...]
        p_j <- clip(p_j, v - r_j, v + r_j),   path <- path (M0 / M1)^8 + |du| / M1

    As the plays p_j follow v, a new peak stretches the whole loop along the input: the stiffness falls with the peak (peak-oriented), and
    the slip of pinched loops grows with it. The K functions B_b are linear between the K `peaks` on a logarithmic scale and constant
    outside. The fading part is that of the first cycles at each new peak: cyclic loss of strength. The output is linear in the weights,
    which may have either sign, so that there is no inverse. Before the record the device rests at zero input.

    Raises:
        ModelError: weights whose shapes do not fit the peaks and thresholds.
    """

    no_inverse: ClassVar[str] = (
        "self-similar stops have weights of either sign and no inverse, because the output need not rise with the input"
    )
    rate_independent: ClassVar[bool] = True
    has_fast_run: ClassVar[bool] = True
    estimator: ClassVar[str] = "convex"
    needs: ClassVar[Needs] = Needs(
        amplitudes=3,
        direction="clockwise",
        damage=True,
        too_few="how the loop changes with its peak is not determined",
        regularized=True,
    )

    w: Float[Array, "peaks stops"] = param(unit="y", scale=0.1, linear=True, doc="weights of the stops at each peak")
    c: Float[Array, "peaks powers"] = param(
        unit="y", linear=True, doc="odd powers 1, 3, 5 of the backbone at each peak"
    )
    fading: Float[Array, " fading"] = param(
        (),
        unit="y",
        scale=0.1,
        linear=True,
        doc="weights that fade at constant peak: stops, then odd powers; none without fading",
    )
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the output")
    r: Float[Array, " stops"] = param(
        _THRESHOLDS,
        bounds=(0.0, 2.0),
        fixed=True,
        vector=True,
        doc="half widths of the plays, as fractions of the peak",
    )
    peaks: Float[Array, " peaks"] = element_places(
        (1.0,), unit="u", doc="peaks of the input at which weights apply, rising"
    )
    floor: Scalar = param(0.02, bounds=(0.0, np.inf), unit="u", scale=0.02, fixed=True, doc="least peak of the input")
    decay: Scalar = param(
        6.0, bounds=(0.0, np.inf), scale=6.0, fixed=True, doc="path, in peaks, over which the fading part decays"
    )

    def __check_init__(self) -> None:
        if not all(hasattr(value, "shape") for value in (self.w, self.c, self.r, self.peaks, self.fading)):
            return
        count, stops = self.peaks.shape[-1], self.r.shape[-1]
        shapes = self.w.shape[-2:], self.c.shape[-2:]
        if shapes != ((count, stops), (count, len(POWERS))):
            raise ModelError(f"w and c must have shapes {(count, stops)} and {(count, len(POWERS))}, got {shapes}")
        if self.fading.shape[-1] not in (0, stops + len(POWERS)):
            raise ModelError(f"fading must have no weight or {stops + len(POWERS)}, got {self.fading.shape[-1]}")

    @classmethod
    def of(cls, peaks: int = 4, *, fading: bool = True) -> SelfSimilarStops:
        """A model whose weights change at this many peaks.

        Args:
            peaks: number of peaks of the input at which the loop has weights of its own.
            fading: whether a part fades while the peak stays.

        Raises:
            ModelError: fewer than one peak.
        """
        if peaks < 1:
            raise ModelError(f"at least one peak is needed, got {peaks}")
        stops, powers = len(_THRESHOLDS), len(POWERS)
        return cls(
            w=np.full((peaks, stops), 0.1),
            c=np.tile(np.eye(powers)[0], (peaks, 1)),
            fading=np.zeros(stops + powers if fading else 0),
            peaks=np.geomspace(0.1, 1.0, peaks) if peaks > 1 else (1.0,),
        )

    def settings(self) -> dict[str, int | bool | str]:
        return {"peaks": int(self.peaks.shape[-1]), "fading": bool(self.fading.size)}

    def init(self, u0: Scalar) -> State:
        """State after the way from zero input to u0: the plays, the peak and the path, shape (stops + 2,)."""
        plays = jnp.zeros(self.r.size, u0.dtype)
        rest = jnp.concatenate([plays, jnp.stack([self.floor, jnp.zeros_like(self.floor)])])
        return self._moved(rest, jnp.zeros_like(u0), u0)

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample: the peak, the plays at the new v, and the weights at that peak."""
        new = self._moved(state, u0, u1)
        peak, v = new[-2], u1 / new[-2]
        elements = jnp.concatenate([v - new[:-2], v ** jnp.asarray(POWERS)])
        weights = self._hats(peak) @ jnp.concatenate([self.w, self.c], axis=1)
        if self.fading.size:
            weights = weights + peak / self.peaks[-1] * jnp.exp(-new[-1] / self.decay) * self.fading
        return new, self.offset + jnp.dot(weights, elements)

    def _moved(self, state: State, u0: Scalar, u1: Scalar) -> State:
        peak = jnp.maximum(state[-2], jnp.abs(u1))
        v = u1 / peak
        plays = jnp.maximum(v - self.r, jnp.minimum(v + self.r, state[:-2]))
        path = state[-1] * (state[-2] / peak) ** _RENEWED + jnp.abs(u1 - u0) / peak
        return jnp.concatenate([plays, jnp.stack([peak, path])])

    def _hats(self, peak: Scalar) -> Array:
        """B_b at a peak, shape (K,)."""
        at, knots = jnp.log(peak), jnp.log(self.peaks)
        part = jnp.clip((at - knots[:-1]) / jnp.diff(knots), 0.0, 1.0)
        one = jnp.ones_like(knots[:1])
        return jnp.concatenate([one, part]) - jnp.concatenate([part, jnp.zeros_like(one)])

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns of all weights at once."""
        u = np.asarray(u, dtype=float)
        peak = np.maximum.accumulate(np.maximum(np.abs(u), float(self.floor)))
        v = u / peak
        stops = v[:, None] - play_columns(v, np.asarray(self.r), 0.0)
        powers = v[:, None] ** np.asarray(POWERS)
        knots, at = np.log(np.asarray(self.peaks)), np.log(peak)
        part = np.clip((at[:, None] - knots[:-1]) / np.diff(knots), 0.0, 1.0)
        hats = np.pad(part, ((0, 0), (1, 0)), constant_values=1.0) - np.pad(part, ((0, 0), (0, 1)))
        product = lambda elements: (hats[:, :, None] * elements[:, None, :]).reshape(u.size, -1)
        columns = {"w": product(stops), "c": product(powers), "offset": np.ones((u.size, 1))}
        if self.fading.size:
            # path M^8 is a running sum; over the largest peak, so that no power overflows
            relative = peak / peak[-1]
            ways = np.abs(np.diff(u, prepend=0.0)) / peak * relative**_RENEWED
            path = np.cumsum(ways) / relative**_RENEWED
            left = peak / float(self.peaks[-1]) * np.exp(-path / float(self.decay))
            columns["fading"] = left[:, None] * np.hstack([stops, powers])
        return DesignMatrix.of(self, columns)

    def advice(self, u: np.ndarray, dt: np.ndarray | None = None) -> tuple[str, ...]:
        """Where the input goes beyond the peaks of the weights, or has one peak only."""
        largest, last = float(np.max(np.abs(u))), float(self.peaks[-1])
        if largest <= (1 + APART) * last:
            return ()
        return (
            f"the input reaches {largest / last:.2g} times the largest peak of the fit: the loop there is that at the largest peak, scaled",
        )

    def start(self, records: Sequence[Record]) -> SelfSimilarStops:
        """Peaks at quantiles of the logarithm of the largest input so far; the weights follow from a linear solve."""
        largest = max(float(np.max(np.abs(record.u))) for record in records) or 1.0
        floor = _FLOOR * largest
        so_far = [np.maximum.accumulate(np.maximum(np.abs(record.u), floor))[record.used] for record in records]
        count = self.peaks.shape[-1]
        peaks = (
            np.exp(np.quantile(np.log(np.concatenate(so_far)), np.linspace(0.0, 1.0, count)))
            if count > 1
            else np.array([largest])
        )
        if (peaks[1:] < (1 + APART) * peaks[:-1]).any():  # few peaks: evenly, down to a tenth of the largest
            peaks = np.geomspace(0.1 * largest, largest, count)
        out = output_range(records)
        w = np.full(self.w.shape, 0.02 * out.half)
        c = np.tile(0.5 * out.half * np.eye(len(POWERS))[0], (count, 1))
        fading = np.zeros(self.fading.shape)
        return dataclasses.replace(self, w=w, c=c, fading=fading, peaks=peaks, floor=floor, offset=out.center)

    def c_part(self) -> CPart:
        return CPart.of(self, "self_similar", weights=np.hstack([self.w, self.c]).ravel())
