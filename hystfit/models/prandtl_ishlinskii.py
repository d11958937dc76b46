"""The Prandtl-Ishlinskii model: weighted play operators, with envelopes for asymmetric loops."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial.legendre import legder, legval, legvander

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis, Rest
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.play_columns import (
    Envelope,
    element_columns,
    envelope,
    envelope_slope,
    fading,
    play_thresholds,
    rising_columns,
)
from hystfit.models.shared.polynomial import legendre_series, rising_series, rising_slope
from hystfit.models.shared.reported import PlayWeights
from hystfit.models.shared.sample_scan import scan_samples
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.slopes import POINTS, Slopes
from hystfit.models.shared.starting import fitted_input_range, output_range
from hystfit.models.shared.step_inverse import AbstractStepInverse, SearchStep
from hystfit.params.param import element_places, element_weights, param
from hystfit.quality.needs import Needs

Operator = Literal["play", "stop"]
_LANES = 8  # sums side by side, as wide as a vector of the processor: a step of 30 plays takes 31 ns for 45


class PrandtlIshlinskii(AbstractHysteresis):
    """Weighted plays, or stops, of envelopes of the input, and a single-valued polynomial.

        y = offset + sum over e, j of w[e, j] E[e, j] + s(x),   x = (u - low) / (high - low)
        s(x) = sum over i >= 1 of rise_i (sum over k >= i of B_k(x)) + b_i P_i(2 x - 1)
        p[e, j] <- max(gamma_e(x) - r_j, min(gamma_e(x) + r_j, p[e, j]));   E = p (play) or gamma_e(x) - p (stop)

    Plays make the output lag (piezo, magnetics: counter-clockwise loops), stops make it lead (force against displacement of
    dampers and steel). One envelope, the identity, is the classical symmetric model; with "square" and "mirror" (a
    parabola and its mirror image) beside it, branches may bend differently up and down: the generalized model (after
    Al Janaideh et al. 2009). `hardening` adds, for the first envelope, weights that decay with the path length of x:
    w_h[j] exp(-path / s0) E[0, j], for steel that hardens or softens in its first cycles.

    The output is linear in w, hardening, rise, b and offset; its derivative in the thresholds r has kinks (a play that sticks
    does not feel its width). B_k are the Bernstein polynomials of degree n = number of rise_i, continued by straight lines outside
    0 <= x <= 1: with w, rise >= 0 and no b the output of plays never falls while the input rises, and an inverse exists. `of` therefore
    gives plays a rising polynomial; stops, whose loops may descend, get Legendre coefficients of either sign. Before the record the input
    rested at `level`, or at the record's first input where rest = "first".

    Raises:
        ModelError: an unknown envelope, operator or rest, or weights whose shape does not fit the thresholds.
    """

    w: Float[Array, "envelopes plays"] = element_weights(
        effect=lambda model: model.r if model.operator == "stop" else 1.0, doc="weights of the plays or stops"
    )
    r: Float[Array, " plays"] = element_places(
        scale=0.1, doc="half widths of the plays, as fractions of the input range"
    )
    b: Float[Array, " degree"] = param(
        (), unit="y", linear=True, doc="Legendre coefficients 1, 2, ... of the single-valued part"
    )
    rise: Float[Array, " degree"] = element_weights(
        (), scale=1.0, doc="increments of the rising single-valued part over the range"
    )
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the output")
    hardening: Float[Array, " fading"] = param(
        (), unit="y", linear=True, doc="weights that decay with the path, none or one per play"
    )
    s0: Scalar = param(3.0, bounds=(0.0, np.inf), fixed=True, doc="path, in input ranges, over which hardening fades")
    low: Scalar = param(0.0, unit="u", fixed=True, doc="input where x = 0")
    high: Scalar = param(1.0, unit="u", fixed=True, doc="input where x = 1")
    level: Scalar = param(0.0, unit="u", fixed=True, doc="input at which the device rested before the record")
    envelopes: tuple[Envelope, ...] = eqx.field(static=True, default=("identity",))
    operator: Operator = eqx.field(static=True, default="play")
    rest: Rest = eqx.field(static=True, default="level")

    rate_independent: ClassVar[bool] = True
    words: ClassVar[Mapping[str, tuple[str, ...]]] = {"operator": get_args(Operator), "rest": get_args(Rest)}
    has_fast_run: ClassVar[bool] = True

    def __check_init__(self) -> None:
        unknown = [kind for kind in self.envelopes if kind not in get_args(Envelope)]
        if unknown or not self.envelopes:
            raise ModelError(f"envelopes must be identity, square or mirror, got {self.envelopes}")
        if not (hasattr(self.w, "shape") and hasattr(self.r, "shape")):
            return
        if self.w.shape != (len(self.envelopes), *self.r.shape):
            raise ModelError(
                f"w must have shape (envelopes, plays) = {(len(self.envelopes), *self.r.shape)}, got {self.w.shape}"
            )
        if self.hardening.shape not in ((0,), self.r.shape):
            raise ModelError(f"hardening must have no weight or one per play, got shape {self.hardening.shape}")

    def plays(self) -> tuple[PlayWeights, ...]:
        """The weights of each envelope."""
        threshold = np.asarray(self.r) * (float(self.high) - float(self.low))
        return tuple(
            PlayWeights(
                f"{self.operator}s of {kind}" if len(self.envelopes) > 1 else f"{self.operator}s",
                threshold,
                np.asarray(row),
                tuple(f"w[{e},{j}]" for j in range(threshold.size)),
            )
            for e, (kind, row) in enumerate(zip(self.envelopes, np.asarray(self.w), strict=True))
        )

    @classmethod
    def of(
        cls,
        plays: int = 20,
        degree: int = 1,
        *,
        envelopes: Sequence[Envelope] | int = 1,
        operator: Operator = "play",
        hardening: int = 0,
        rest: Rest = "level",
    ) -> PrandtlIshlinskii:
        """A model with this many plays, thresholds 0.5 (j / (plays + 1))^2 of the input range: dense where loops are small.

        Args:
            plays: number of thresholds.
            degree: of the single-valued polynomial, which rises where the operator is "play".
            envelopes: of the input, one row of weights each: their names, or 1 (symmetric loops) or 3 (all, for asymmetric loops).
            operator: "play" or "stop".
            hardening: path, in input ranges, over which additional weights fade; 0 for none.
            rest: where the input rested before the record.

        Raises:
            ModelError: fewer than one play or degree one, another number of envelopes, a negative path.
        """
        if degree < 1:
            raise ModelError(f"the polynomial is of degree one at least, got {degree}")
        if hardening < 0:
            raise ModelError(f"hardening fades over a path of at least 0 input ranges, got {hardening}")
        if isinstance(envelopes, int):
            if envelopes not in (1, 3):
                raise ModelError(f"there are 1 or 3 envelopes, got {envelopes}")
            envelopes = get_args(Envelope)[:envelopes]
        r = play_thresholds(plays)
        w = np.full((len(envelopes), plays), 0.01)
        fading = np.zeros(plays if hardening else 0)
        single = {"rise": np.full(degree, 2.0 / degree)} if operator == "play" else {"b": np.eye(degree)[0]}
        return cls(
            w=w,
            r=r,
            **single,
            hardening=fading,
            s0=float(hardening or 3.0),
            envelopes=tuple(envelopes),
            operator=operator,
            rest=rest,
        )

    @property
    def needs(self) -> Needs:
        """Plays describe loops that lag, stops loops that lead."""
        if self.operator == "play":
            return Needs(amplitudes=2, symmetry="generalized", direction="counter-clockwise")
        return Needs(amplitudes=2, symmetry="symmetric", direction="clockwise")

    def _position(self, u: Array) -> Array:
        return (u - self.low) / (self.high - self.low)

    def _envelopes(self, u: Array) -> Array:
        """Envelopes of inputs of any shape, to lie beside the plays: shape (..., envelopes, 1)."""
        x = self._position(u)
        return jnp.stack([envelope(kind, x) for kind in self.envelopes], axis=-1)[..., None]

    def _move(self, plays: Array, target: Array) -> Array:
        return jnp.maximum(target - self.r, jnp.minimum(target + self.r, plays))

    def _single(self, x: Array) -> Array:
        return legendre_series(self.b, 2.0 * x - 1.0, first=1) + rising_series(self.rise, x)

    def init(self, u0: Scalar) -> State:
        """State: the plays, moved from rest to u0, and with hardening the path run so far."""
        rest = u0 if self.rest == "first" else self.level + 0.0 * u0
        plays = self._move(jnp.broadcast_to(self._envelopes(rest), self.w.shape), self._envelopes(u0)).reshape(-1)
        if not self.hardening.size:
            return plays
        return jnp.append(plays, jnp.abs(self._position(u0) - self._position(rest)))

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample: every play follows the input."""
        plays, total, *fading = self._dragged(state[: self.w.size].reshape(self.w.shape), self._envelopes(u1))
        x = self._position(u1)
        y = self.offset + total + self._single(x)
        if not self.hardens:
            return plays.reshape(-1), y
        path = state[-1] + jnp.abs(x - self._position(u0))
        return jnp.append(plays.reshape(-1), path), y + jnp.exp(-path / self.s0) * fading[0]

    def sweep(self, state: State, u0: Scalar, u: Signal, dt: Signal) -> tuple[State, Signal]:
        """The plays and the path apart, and what needs neither before the scan, where there is more than plays."""
        if self.one_scan:
            return super().sweep(state, u0, u, dt)
        x = self._position(u)
        ways = jnp.abs(jnp.diff(x, prepend=self._position(u0)))

        def once(carry: tuple[Array, ...], row: tuple[Array, Array]) -> tuple[tuple[Array, ...], Array]:
            plays, total, *fading = self._dragged(carry[0], row[0])
            if not fading:
                return (plays,), total
            path = carry[1] + row[1]
            return (plays, path), total + jnp.exp(-path / self.s0) * fading[0]

        plays, path = state[: self.w.size].reshape(self.w.shape), state[self.w.size :]
        (plays, *path), y = scan_samples(once, (plays, *path), (self._envelopes(u), ways))
        return jnp.concatenate([plays.reshape(-1), *(one[None] for one in path)]), self.offset + y + self._single(x)

    @property
    def one_scan(self) -> bool:
        """Several envelopes and the path have work that needs no state."""
        return len(self.envelopes) == 1 and not self.hardens

    def _dragged(self, plays: Array, target: Array) -> tuple[Array, ...]:
        """Plays at the envelopes of an input, the weighted sum of all elements, and that of those which fade, where there are any."""
        plays = self._move(plays, target)
        elements = target - plays if self.operator == "stop" else plays
        fading = (jnp.dot(self.hardening, elements[0]),) if self.hardens else ()
        return plays, _sum(self.w * elements), *fading

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns run by run of monotonic input, without a pass for each of the weights."""
        u = np.asarray(u, dtype=float)
        low, span = float(self.low), float(self.high) - float(self.low)
        x, before = (u - low) / span, (float(u[0] if self.rest == "first" else self.level) - low) / span
        elements = [
            element_columns(envelope(k, x), np.asarray(self.r), envelope(k, before), self.operator)
            for k in self.envelopes
        ]
        columns = {"w": elements[0] if len(elements) == 1 else np.hstack(elements), "offset": np.ones((u.size, 1))}
        if self.b.size:
            columns["b"] = legvander(2.0 * x - 1.0, self.b.size)[:, 1:]
        if self.rise.size:
            columns["rise"] = rising_columns(self.rise.size, x)
        if self.hardening.size:
            columns["hardening"] = fading(x, before, float(self.s0))[:, None] * elements[0]
        return DesignMatrix.of(self, columns)

    def start(self, records: Sequence[Record]) -> PrandtlIshlinskii:
        """Ranges from the samples that count; the weights follow from a linear solve."""
        place, out = fitted_input_range(records), output_range(records)
        w = np.full(self.w.shape, 0.2 * out.half / self.w.size)
        b = np.where(np.arange(self.b.size) == 0, 0.8 * out.half, 0.0)
        rise = np.full(self.rise.shape, 1.6 * out.half / max(self.rise.size, 1))  # equal increments: a straight line
        offset = out.center - 0.5 * np.sum(rise)
        return dataclasses.replace(self, w=w, b=b, rise=rise, offset=offset, low=place.low, high=place.high)

    def settings(self) -> dict[str, int | bool | str]:
        count, plays = self.w.shape
        path = round(float(self.s0)) if self.hardening.size else 0
        return {
            "plays": plays,
            "degree": self.b.size + self.rise.size,
            "envelopes": count,
            "operator": self.operator,
            "hardening": path,
            "rest": self.rest,
        }

    def reach(self) -> tuple[float, float]:
        """A quarter of the range beyond it on either side."""
        low, high = float(self.low), float(self.high)
        return low - 0.25 * (high - low), high + 0.25 * (high - low)

    @property
    def hardens(self) -> bool:
        return bool(self.hardening.size)

    def slope_range(self, low: float, high: float, dt: float | None) -> Slopes | None:
        """After every reversal, at every input behind it: the plays that move are those with the smallest thresholds.

        None with hardening, which changes with the path.
        """
        if self.hardening.size:
            return None
        place, span = float(self.low), float(self.high) - float(self.low)
        x = np.linspace((low - place) / span, (high - place) / span, POINTS)
        order = np.argsort(np.asarray(self.r))
        single = 2.0 * legval(2.0 * x - 1.0, legder(np.append(0.0, np.asarray(self.b)))) + rising_slope(
            np.asarray(self.rise), x
        )
        widths, total = 2 * np.asarray(self.r)[order], single[None, :]
        for kind, weights in zip(self.envelopes, np.asarray(self.w), strict=True):
            bent = envelope(kind, x)
            moving = np.searchsorted(widths, np.abs(bent[None, :] - bent[:, None]), side="right")
            together = np.append(0.0, np.cumsum(weights[order]))
            if self.operator == "stop":
                together = together[-1] - together
            total = total + envelope_slope(kind, x)[None, :] * together[moving]
        return Slopes.of(total / span)

    def step_inverse(self, sign: float = 1.0) -> AbstractStepInverse:
        """See `PlayStep`; a search where the model has envelopes, a bent single-valued part or hardening."""
        straight = self.b.size <= 1 and self.rise.size <= 1
        plain = self.envelopes == ("identity",) and straight and not self.hardening.size
        return PlayStep(self) if plain else SearchStep(self, sign)

    def c_part(self) -> CPart:
        """Plays or stops, envelopes and hardening are in one template."""
        kinds = np.array([get_args(Envelope).index(kind) for kind in self.envelopes])
        switches = {"first": self.rest == "first", "stops": self.operator == "stop"}
        return CPart.of(self, "prandtl_ishlinskii", kinds=kinds, b=np.append(0.0, self.b), **switches)


def _sum(values: Array) -> Array:
    """Sum of values, shape (envelopes, plays).

    Those of several envelopes in lanes side by side: one after another each addition would wait for the one before. Of one envelope that
    gains nothing, and a Jacobian takes half as long again.
    """
    if len(values) == 1:
        return jnp.sum(values)
    flat = values.reshape(-1)
    lanes = jnp.pad(flat, (0, -flat.size % _LANES)).reshape(-1, _LANES).sum(axis=0)
    while lanes.size > 1:
        lanes = lanes[: lanes.size // 2] + lanes[lanes.size // 2 :]
    return lanes[0]


class PlayStep(AbstractStepInverse):
    """Exact inverse of `PrandtlIshlinskii` with one identity envelope and a straight single-valued part.

    A way d from the last input moves the plays whose dead band t_j it has passed: b d + sum of w_j max(0, d - t_j) is
    piecewise linear and rising, and the active plays follow from its values at the t_j. Stops give min(d, t_j) instead.
    """

    model: PrandtlIshlinskii
    needs_limits: ClassVar[bool] = False

    def solve(self, state: Array, u0: Array, target: Array, dt: Array, low: Array, high: Array) -> Root:
        pi = self.model
        w, x0 = pi.w[0], (u0 - pi.low) / (pi.high - pi.low)
        steepness = 2.0 * jnp.sum(pi.b) + jnp.sum(pi.rise)
        now = pi.step(state, u0, u0, dt)[1]
        s, way = jnp.where(target < now, -1.0, 1.0), jnp.abs(target - now)
        dead = jnp.maximum(s * (state - x0) + pi.r, 0.0)
        reached = dead[:, None] - dead[None, :]  # way at the start of play k less the dead band of play j
        if pi.operator == "play":
            gains = steepness * dead + jnp.maximum(reached, 0.0) @ w
            active = gains < way
            slope, shift = steepness + jnp.sum(jnp.where(active, w, 0.0)), jnp.sum(jnp.where(active, w * dead, 0.0))
        else:
            gains = steepness * dead + jnp.minimum(dead[:, None], dead[None, :]) @ w
            active = gains < way
            slope, shift = steepness + jnp.sum(jnp.where(active, 0.0, w)), -jnp.sum(jnp.where(active, w * dead, 0.0))
        d = jnp.where(slope > 0, (way + shift) / jnp.where(slope > 0, slope, 1.0), jnp.where(way > 0, jnp.inf, 0.0))
        return Root(pi.low + (x0 + s * d) * (pi.high - pi.low), slope >= 0)
