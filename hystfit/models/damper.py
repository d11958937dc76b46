"""A damper: forces of displacement and velocity, friction, and a force that lags the velocity, by one convex solve."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.c_code import CPart
from hystfit.models.shared.design import DesignMatrix
from hystfit.models.shared.nonnegative import solve_nonnegative
from hystfit.models.shared.play_columns import play_columns
from hystfit.models.shared.shapes import Scalar, State
from hystfit.models.shared.starting import LARGE, SAMPLES, input_range, output_range, sampling_interval, speed
from hystfit.params.param import element_weights, param
from hystfit.quality.host_operators import recursion
from hystfit.quality.needs import Needs

# Of stops of the displacement and of the velocity, over half the stroke and the speed; and of the bends of saturating forces.
_STROKES = tuple(np.geomspace(0.002, 1.2, 16))
_LAGS = tuple(np.geomspace(0.005, 0.9, 12))
_BENDS = tuple(np.geomspace(0.01, 1.0, 8))
_SPRING = (1, 2, 3, 5)  # powers of the displacement in the force of the spring
# Strains of the stops of x at the start: free of force, or slipping, as after a movement in either direction.
_STRAINS = (0.0, -1.0, 1.0)
_READ, _MOVING = 1.0, 2.0  # stages of the start: the first sample is read, and its velocity is known
# Of the velocity, in sampling intervals: that of the middle of the last interval, or that of the sample.
_LEADS = (0.0, 0.5)
# Sampling intervals, each twice the one before: lags from which a fit may start.
_DELAYS = (0.35, 0.7, 1.4, 2.8, 5.6, 11.2)


class Damper(AbstractHysteresis):
    """Force of a damper in displacement and velocity (hydraulic, gas-charged, magnetorheological, friction):

        y = offset + sum spring_k x^k + viscous w + b1 w |w| + b2 w^3 + b3 w^2 + c1 x |w| + c2 x w + c3 x^2 w + c4 x^2 |w|
              + sum over e, j of saturating[e, j] g_e(x) tanh(w / s_j)
              + sum friction_j (x - p_j) + sum lagging_j (w - q_j)
        p_j <- clip(p_j, x - r_j, x + r_j),   q_j <- clip(q_j, w - h_j, w + h_j)

    x = (u - center) / half is the displacement, w the velocity over `speed` behind a first-order lag `tau`. The velocity is the rate over
    the last interval, extrapolated by `lead` intervals from its middle: 0.5 gives that of the sample, 0 has less noise. The powers of x
    are a mechanical or gas spring; those of w and their products with x the valves, whose force may depend on the direction and on the
    place. g_0 falls from 1 to 0 over the stroke and g_1 rises.
    Saturating forces are the yield force of a magnetorheological damper, stops of x friction and the elasticity before it slips. Stops of
    w are forces that differ between rising and falling speed: the compressibility of the fluid and the inertia of a valve. `viscous`,
    `saturating`, `friction` and `lagging` are >= 0, so that these terms dissipate. Everything but tau follows from one convex solve. A
    damper that was moved before the record rests with its stops strained: p_j = x - strain r_j at the first sample. It has
    moved at the velocity of the first interval before the record, so that w has no transient; for one at rest use `Record.resting_on`
    with the first displacement.
    """

    no_inverse: ClassVar[str] = (
        "a damper has no inverse: its force depends on the velocity, and its spring may have either sign"
    )
    rate_independent: ClassVar[bool] = False
    takes_rate: ClassVar[bool] = True
    has_fast_run: ClassVar[bool] = True
    estimator: ClassVar[str] = "convex"
    needs: ClassVar[Needs] = Needs(time=True, rate=True, direction="clockwise", force=True, regularized=True)

    spring: Float[Array, " powers"] = param(
        (0.0,) * 4, unit="y", linear=True, doc="force of the displacement: powers 1, 2, 3, 5 of x"
    )
    viscous: Scalar = param(0.1, bounds=(0.0, np.inf), unit="y", linear=True, doc="force proportional to the velocity")
    bent: Float[Array, " powers"] = param((0.0,) * 3, unit="y", linear=True, doc="forces w |w|, w^3 and w^2")
    coupling: Float[Array, " products"] = param(
        (0.0,) * 4, unit="y", linear=True, doc="forces x |w|, x w, x^2 w and x^2 |w|"
    )
    saturating: Float[Array, "ends bends"] = element_weights(
        ((0.05,) * len(_BENDS),) * 2,
        doc="forces that saturate in the velocity, at the lower and the upper end of the stroke",
    )
    friction: Float[Array, " strokes"] = element_weights((0.05,) * len(_STROKES), doc="weights of the stops of x")
    lagging: Float[Array, " lags"] = element_weights((0.05,) * len(_LAGS), doc="weights of the stops of w")
    offset: Scalar = param(0.0, unit="y", per_record=True, linear=True, doc="constant part of the force")
    tau: Scalar = param(0.01, bounds=(0.0, np.inf), unit="s", scale=0.01, doc="lag of the velocity")
    strain: Scalar = param(
        0.0,
        bounds=(-1.0, 1.0),
        per_record=True,
        fixed=True,
        doc="strain of the stops of x at the first sample, over their half widths",
    )
    lead: Scalar = param(
        0.0, bounds=(-1.0, 1.0), fixed=True, doc="extrapolation of the velocity, in sampling intervals"
    )
    center: Scalar = param(0.0, unit="u", fixed=True, doc="displacement where x = 0")
    half: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u", fixed=True, doc="half of the stroke")
    speed: Scalar = param(1.0, bounds=(0.0, np.inf), unit="u/s", fixed=True, doc="velocity where w = 1")

    def __check_init__(self) -> None:
        wanted = {
            "spring": (4,),
            "bent": (3,),
            "coupling": (4,),
            "saturating": (2, len(_BENDS)),
            "friction": (len(_STROKES),),
            "lagging": (len(_LAGS),),
        }
        for name, shape in wanted.items():
            value = getattr(self, name)
            if hasattr(value, "shape") and value.shape[-len(shape) :] != shape:
                raise ModelError(f"{name} must have shape {shape}, got {value.shape}")

    def init(self, u0: Scalar) -> State:
        """State at rest on u0: the plays of x and of w, w, the last rate, and a stage of the start, shape (31,)."""
        x = (u0 - self.center) / self.half
        return jnp.concatenate([x - self.strain * jnp.asarray(_STROKES), jnp.zeros(len(_LAGS) + 3) * u0])

    def step(self, state: State, u0: Scalar, u1: Scalar, dt: Scalar) -> tuple[State, Scalar]:
        """One sample: the velocity, the plays, and the sum of all forces."""
        before, last, stage = state[-3:]
        rate = jnp.where(dt > 0, (u1 - u0) / jnp.where(dt > 0, dt, 1.0) / self.speed, last)
        left = jnp.where(stage == _READ, 0.0, jnp.exp(-dt / self.tau))
        ahead = rate + self.lead * (rate - jnp.where(stage == _READ, rate, last))
        w = jnp.where(dt > 0, left * before + (1.0 - left) * ahead, before)
        stage = jnp.where(((stage == 0) & (u1 == u0)) | ((stage == _READ) & (dt <= 0)), _READ, _MOVING)
        x = (u1 - self.center) / self.half
        p, q = _follow(state[: len(_STROKES)], x, _STROKES), _follow(state[len(_STROKES) : -3], w, _LAGS)
        y = self.offset + jnp.dot(self.spring, x ** jnp.asarray(_SPRING)) + self.viscous * w
        y += self.bent @ jnp.stack([w * jnp.abs(w), w**3, w**2])
        y += self.coupling @ jnp.stack([x * jnp.abs(w), x * w, x**2 * w, x**2 * jnp.abs(w)])
        part = jnp.clip(0.5 * (1.0 + x), 0.0, 1.0)
        y += jnp.dot((1.0 - part) * self.saturating[0] + part * self.saturating[1], jnp.tanh(w / jnp.asarray(_BENDS)))
        y += jnp.dot(self.friction, x - p) + jnp.dot(self.lagging, w - q)
        return jnp.concatenate([p, q, jnp.stack([w, rate, stage])]), y

    def design_matrix(self, u: Any, dt: Any = None) -> DesignMatrix:
        """Columns of all weights at once."""
        u, dt = np.asarray(u, dtype=float), np.asarray(dt, dtype=float)
        x, w = (u - float(self.center)) / float(self.half), self._velocity(u, dt)[:, None]
        strokes, one, size, bends = np.asarray(_STROKES), x[:, None], np.abs(w), np.tanh(w / np.asarray(_BENDS))
        part = np.clip(0.5 * (1.0 + one), 0.0, 1.0)
        columns = {
            "spring": one ** np.asarray(_SPRING),
            "viscous": w,
            "bent": np.hstack([w * size, w**3, w**2]),
            "coupling": np.hstack([one * size, one * w, one**2 * w, one**2 * size]),
            "saturating": np.hstack([(1.0 - part) * bends, part * bends]),
            "friction": one - play_columns(x, strokes, x[0] - float(self.strain) * strokes),
            "lagging": w - play_columns(w[:, 0], np.asarray(_LAGS), 0.0),
            "offset": np.ones((u.size, 1)),
        }
        return DesignMatrix.of(self, columns)

    def _velocity(self, u: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """w at every sample, shape (T,)."""
        with np.errstate(divide="ignore", invalid="ignore"):  # without a lag, the velocity is that of the sample
            left = np.where(dt > 0, np.exp(-dt / float(self.tau)), 1.0)
        at, driven = 1 + np.flatnonzero(dt[1:] > 0), np.zeros(u.size)
        left[at[:1]] = 0.0  # no transient in the first interval
        rates = np.diff(u)[at - 1] / dt[at] / float(self.speed)
        changes = np.diff(rates, prepend=rates[:1])
        driven[at] = (1.0 - left[at]) * (rates + float(self.lead) * changes)
        return recursion((1.0, np.append(-left[1:], 0.0)), driven[:, None])[:, 0]

    def start(self, records: Sequence[Record]) -> Damper:
        """Stroke and speed of the records, and the best of a few strains, leads and lags; the weights follow from a linear solve."""
        place, out, interval = input_range(records), output_range(records), sampling_interval(records)
        ranges = {"center": place.center, "half": place.half, "speed": speed(records, LARGE)}
        model = dataclasses.replace(self, **ranges, viscous=0.2 * out.half, offset=out.center)
        heads = [record.segment(0, min(len(record), SAMPLES)) for record in records]
        pairs = itertools.product(_STRAINS, _LEADS)
        starts = [
            dataclasses.replace(model, strain=strain, lead=lead)._with_lag(heads, interval) for strain, lead in pairs
        ]
        return min(starts, key=lambda start: start[1])[0]

    def _with_lag(self, records: Sequence[Record], interval: float) -> tuple[Damper, float]:
        """The same damper with the lag that leaves the smallest misfit, and that misfit."""
        lagging = lambda log_tau: dataclasses.replace(self, tau=float(np.exp(log_tau)))
        logs = np.log(interval * np.array(_DELAYS))
        best = int(np.argmin([lagging(log_tau)._misfit(records) for log_tau in logs]))
        around = logs[max(best - 1, 0)], logs[min(best + 1, logs.size - 1)]
        found = scipy.optimize.minimize_scalar(
            lambda log_tau: lagging(log_tau)._misfit(records), bounds=around, method="bounded", options={"xatol": 0.01}
        )
        return lagging(found.x), float(found.fun)

    def _misfit(self, records: Sequence[Record]) -> float:
        """Least sum of squared errors that the weights reach, with an offset for each record."""
        rows, bounded = [], np.zeros(0, dtype=bool)
        for record in records:
            blocks = self.design_matrix(record.u, record.dt).blocks
            bounded = np.concatenate([np.full(block.columns.shape[1], block.info.bounds[0] == 0) for block in blocks])
            part = np.hstack([*(block.columns for block in blocks), record.y[:, None]])[record.used]
            rows.append(part - part.mean(axis=0))
        centered = np.concatenate(rows)
        gram = centered.T @ centered
        A, b = gram[:-1, :-1], gram[:-1, -1]
        A[np.diag_indices_from(A)] += 1e-10 * np.trace(A) / b.size  # weights may be collinear
        w, _ = solve_nonnegative(A, b, bounded)
        return float(gram[-1, -1] - 2 * b @ w + w @ A @ w)

    def c_part(self) -> CPart:
        return CPart.of(self, "damper", strokes=_STROKES, lags=_LAGS, bends=_BENDS)


def _follow(plays: Array, at: Scalar, widths: tuple[float, ...]) -> Array:
    """Plays of these half widths, dragged to a new position."""
    r = jnp.asarray(widths)
    return jnp.maximum(at - r, jnp.minimum(at + r, plays))
