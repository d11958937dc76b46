"""The data in the form that noise models need."""

from __future__ import annotations

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.batch import Batch
from hystfit.data.preparation import EVEN
from hystfit.data.record import median_interval
from hystfit.params.host_arrays import to_device


class Setting(eqx.Module):
    """The data in the form that noise models need.

    Attributes:
        gap: time since the sample before, in typical sampling intervals, shape (R, T), or () where sampling is even.
        weight: shape (R, T), 0 where a sample does not count; white noise has variance white^2 / weight.
        place: input as a fraction of its range, 0 to 1, shape (R, T).
        rising: whether the input last rose, shape (R, T), bool.
        count: of the samples that count.
        log_weight: sum of the logarithms of their weights.
        full: samples of each record that count, shape (R,), where sampling is even and in each record these are the first ones and
            have one weight; None elsewhere.
    """

    gap: Float[Array | np.ndarray, "*samples"]
    weight: Float[Array | np.ndarray, "R T"]
    place: Float[Array | np.ndarray, "R T"]
    rising: Array | np.ndarray
    count: Float[Array | np.ndarray, ""]
    log_weight: Float[Array | np.ndarray, ""]
    full: Float[Array | np.ndarray, " R"] | None = None

    @classmethod
    def of(cls, batch: Batch, limits: tuple[float, float] | None = None) -> Setting:
        """The setting of a batch; records without time count as evenly sampled. `limits` are those of the input, by default the batch's."""
        return cls.on_host(batch, limits).on_device()

    @classmethod
    def on_host(cls, batch: Batch, limits: tuple[float, float] | None = None) -> Setting:
        """`of` with arrays of NumPy, which is all that the analysis of residuals needs."""
        u, dt, weight = (np.asarray(v) for v in (batch.u, batch.dt, batch.weight))
        low, high = limits or (float(u.min()), float(u.max()))
        typical = median_interval(dt) or 1.0
        gap = np.where((dt > 0).any(axis=1, keepdims=True), dt / typical, 1.0)
        last = [int(np.flatnonzero(row)[-1]) if row.any() else 0 for row in weight]
        inside = np.concatenate([row[1 : end + 1] for row, end in zip(gap, last, strict=True)])
        even = bool(np.all(np.abs(inside - 1.0) < EVEN))
        turning = np.sign(np.diff(u, axis=1, prepend=u[:, :1]))
        return cls(
            gap=np.array(1.0) if even else gap,
            weight=weight,
            place=(u - low) / (high - low),
            rising=np.stack([_held(row) for row in turning]) > 0,
            count=np.array(float(np.count_nonzero(weight))),
            log_weight=np.array(float(np.sum(np.log(weight[weight > 0])))),
            full=_full(weight) if even else None,
        )

    def on_device(self) -> Setting:
        """The same with arrays of JAX."""
        return jax.tree_util.tree_map(to_device, self)


def _full(weight: Float[np.ndarray, "R T"]) -> Float[np.ndarray, " R"] | None:
    """Samples of each record that count, where these are the first ones and have one weight; None elsewhere."""
    count = np.count_nonzero(weight, axis=1)
    alike = weight == np.where(np.arange(weight.shape[1]) < count[:, None], weight[:, :1], 0.0)
    return count.astype(float) if alike.all() and count.all() else None


def _held(sign: np.ndarray) -> np.ndarray:
    """Signs with each zero replaced by the last sign before it, or the first after it."""
    known = np.flatnonzero(sign)
    if not known.size:
        return np.ones_like(sign)
    at = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), known[0]))
    return sign[at]
