"""Weights of a Preisach model from any records: convex, non-negative, smooth, the smoothness chosen on data left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.models.free_run import free_run
from hystfit.models.preisach.equations import LeftOut, Offsets, PreisachSystem, tied_to
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.smooth import SMOOTHNESS, SmoothFit, fit_smooth
from hystfit.results.metrics import Metrics

_TERMS = ("w", "slopes", "b")


@dataclasses.dataclass(frozen=True)
class PreisachFit:
    """A fitted Preisach model and what the data say about it.

    Attributes:
        model: as seen by the first record.
        offsets: of every record, shape (R,).
        train: error on the samples that counted.
        smoothness: strength that blocks left out chose.
        left_out_percent: error on those blocks, percent of the output's range; None where one strength was given.
        reach: part of each weight's cells that the data switched, shape (weights,).
        notes: one sentence each.
    """

    model: Preisach
    offsets: np.ndarray
    train: Metrics
    smoothness: float
    left_out_percent: float | None
    reach: np.ndarray
    notes: tuple[str, ...]

    @property
    def untouched(self) -> np.ndarray:
        """Weights whose cell the data never switched: they follow from smoothness alone, shape (weights,), bool."""
        return self.reach < 1e-9

    def predict(self, u: np.ndarray) -> np.ndarray:
        """Output of the fitted model on an input, shape (T,)."""
        return free_run(self.model, u)


def fit_preisach(
    data: Record | Dataset | Sequence[Record],
    model: Preisach | int = 24,
    *,
    smoothness: Sequence[float] = SMOOTHNESS,
    left_out: LeftOut = "auto",
    nonnegative: bool = True,
    offsets: Offsets = "shared",
    **structure: Any,
) -> PreisachFit:
    """Fit the weights of a Preisach model to arbitrary loops.

    Args:
        data: records.
        model: a model (its levels are chosen anew unless its spacing is "given"), or the number of cells along an axis of a new one.
        smoothness: strengths of the penalty on second differences, to choose among.
        left_out: what chooses the smoothness, see `PreisachSystem.of`.
        nonnegative: bound the masses from below.
        offsets: each record its own constant, one for all, or none.
        **structure: of a new model, as in `Preisach.of` (symmetric, reversible, initial, ...).

    Returns:
        The model and what the data touched.

    Raises:
        HystfitError: data or settings that cannot be used.
    """
    records = list(Dataset.of(data))
    model = Preisach.of(model, **structure) if isinstance(model, int) else model
    model = model.start(records)
    system = PreisachSystem.of(model, records, left_out=left_out, nonnegative=nonnegative, offsets=offsets)
    fit = fit_smooth(system, smoothness)
    return _conclude(model, records, system, fit)


def _conclude(model: Preisach, records: list[Record], system: PreisachSystem, fit: SmoothFit) -> PreisachFit:
    split = np.cumsum([model.w.size, model.slopes.size, model.b.size])
    w, slopes, b, own = np.split(fit.weights, split)
    own = np.resize(own, len(records)) if own.size else np.zeros(len(records))
    models = [with_weights(model, w, slopes, b, offset) for offset in own]
    fitted = [free_run(m, r.u) for m, r in zip(models, records, strict=True)]
    train = Metrics.of([r.y[r.used] for r in records], [y[r.used] for y, r in zip(fitted, records, strict=True)])
    error = float(100 * fit.left_out.min()) if fit.left_out.size else None
    notes = reach_notes(model, system.reach)
    return PreisachFit(models[0], own, train, fit.smoothness, error, system.reach, notes)


def with_weights(model: Preisach, w: np.ndarray, slopes: np.ndarray, b: np.ndarray, offset: float) -> Preisach:
    """The model with other weights."""
    arrays = tuple(jnp.asarray(value, dtype=model.levels.dtype) for value in (w, slopes, b, offset))
    return eqx.tree_at(lambda m: (m.w, m.slopes, m.b, m.offset), model, arrays)


def reach_notes(model: Preisach, reach: np.ndarray) -> tuple[str, ...]:
    """What to say of cells that the data never switched."""
    tied = tied_to(model)
    missing = int((reach[tied] < 1e-9).sum())
    if not missing:
        return ()
    return (
        f"{missing} of {tied.size} {model.elements} were never switched by the data ({missing / tied.size:.0%}): their weights "
        "follow from smoothness alone, and a prediction that reaches them is extrapolation",
    )
