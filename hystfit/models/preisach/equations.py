"""The equations that records pose to a Preisach model: all that is linear, on distinct states, in blocks to be left out in turn."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
import scipy.sparse

from hystfit.data.record import Dataset, Record
from hystfit.errors import ModelError
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.everett import mirror
from hystfit.models.preisach.model import Preisach

_RIDGE = 1e-3  # of the weights themselves, relative to that of their second differences
_BLOCKS = 5
LeftOut = Literal["auto", "blocks", "records"]
Offsets = Literal["each", "shared", "none"]


@dataclasses.dataclass(frozen=True)
class PreisachSystem:
    """Normal equations of all linear parameters of a model: (w, slopes, b, offsets), the outputs in units of `size`.

    Attributes:
        model: gives levels, center and initial state.
        grams: one matrix a block of samples, shape (blocks, p + 1, p + 1); the output comes last.
        counts: sum of weights of each block, shape (blocks,).
        judged: blocks that are left out in turn to choose the smoothness, shape (blocks,), bool.
        roughness: matrix of the smoothness penalty, shape (p, p).
        bounded: which parameters are >= 0, shape (p,).
        reach: part of each cell that the samples that count switched both ways, shape (weights,), 0 for cells never touched.
        size: of the output, by which it was divided.
    """

    model: Preisach
    grams: np.ndarray
    counts: np.ndarray
    judged: np.ndarray
    roughness: np.ndarray
    bounded: np.ndarray
    reach: np.ndarray
    size: float

    @classmethod
    def of(
        cls,
        model: Preisach,
        data: Record | Dataset | Sequence[Record],
        *,
        left_out: LeftOut = "auto",
        nonnegative: bool = True,
        offsets: Offsets = "each",
    ) -> PreisachSystem:
        """Collect the equations of records.

        Args:
            model: levels and terms; its weights do not matter.
            data: records; a sample counts with its weight.
            left_out: what is left out in turn: "blocks", a contiguous fifth of each record; "records", in up to five
                groups, the records that lie inside the range of the others, which asks how well loops between those measured
                are predicted; "auto" takes records where there are such.
            nonnegative: bound weights and slopes from below.
            offsets: each record its own constant, one for all, or none.

        Raises:
            ModelError: no record lies inside the range of the others, and records were asked for.
        """
        records = list(Dataset.of(data))
        inner = _inner(records)
        left_out = ("records" if inner.any() else "blocks") if left_out == "auto" else left_out
        if left_out == "records" and not inner.any():
            raise ModelError('left_out="records" needs a record inside the range of the others; use "blocks"')
        size = float(np.ptp(np.concatenate([r.y[r.used] for r in records]))) or 1.0
        count = model.w.size + model.slopes.size + model.b.size
        own = {"each": len(records), "shared": 1, "none": 0}[offsets]
        folds = _folds(records, inner) if left_out == "records" else [r.blocks(_BLOCKS) for r in records]
        blocks = len(folds[0])
        rows: list[list[np.ndarray]] = [[] for _ in range(blocks)]
        counts = np.zeros(blocks)
        low, high = np.full(model.w.size, np.inf), np.full(model.w.size, -np.inf)
        for number, (record, masks) in enumerate(zip(records, folds, strict=True)):
            A, index = features(model, record.u)
            constant = np.zeros((A.shape[0], own))
            constant[:, number if offsets == "each" else slice(None)] = 1.0
            A = np.column_stack([A, constant])
            for block, mask in enumerate(masks):
                if mask.any():
                    rows[block].append(_rows(A, index[mask], record.y[mask] / size, record.weight[mask]))
                    counts[block] += record.weight[mask].sum()
            seen = A[np.unique(index[record.used]), : model.w.size]
            low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
        joint = (np.concatenate(part) if part else np.zeros((0, count + own + 1)) for part in rows)
        grams = np.stack([part.T @ part for part in joint])
        bounded = np.zeros(count + own, dtype=bool)
        bounded[: model.w.size + model.slopes.size] = nonnegative
        share = np.clip((high - low) / (2 * np.bincount(tied_to(model), minlength=model.w.size)), 0.0, 1.0)
        judged = np.arange(blocks) < (blocks if left_out == "blocks" else blocks - 1)
        return cls(model, grams, counts, judged, _roughness(model, own), bounded, share, size)

    @property
    def untouched(self) -> np.ndarray:
        """Weights whose cell the data never switched, shape (weights,), bool."""
        return self.reach < 1e-9


def _inner(records: Sequence[Record]) -> np.ndarray:
    """Records whose input lies inside the range of all the others together, shape (R,), bool."""
    low = np.array([r.u[r.used].min() for r in records])
    high = np.array([r.u[r.used].max() for r in records])
    slack = 1e-9 * (high.max() - low.min())
    others = [np.arange(low.size) != k for k in range(low.size)] if low.size > 1 else []
    inside = [low[k] >= low[o].min() - slack and high[k] <= high[o].max() + slack for k, o in enumerate(others)]
    return np.array(inside or [False])


def _folds(records: Sequence[Record], inner: np.ndarray) -> list[list[np.ndarray]]:
    """Inner records dealt out to at most five folds, the others in one more: for every record one mask a fold."""
    count = min(int(inner.sum()), _BLOCKS)
    fold = np.where(inner, (np.cumsum(inner) - 1) % count, count)
    return [[r.used & (own == k) for k in range(count + 1)] for r, own in zip(records, fold, strict=True)]


def _rows(A: np.ndarray, index: np.ndarray, y: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Rows (A, y), one a state that the samples visit, and a last one: their sums of squares are those of the samples."""
    states, place = np.unique(index, return_inverse=True)
    mass = np.bincount(place, weight)
    mean = np.bincount(place, weight * y) / mass
    spread = np.zeros((1, A.shape[1] + 1))
    spread[0, -1] = np.sqrt(max(float(weight @ (y - mean[place]) ** 2), 0.0))
    return np.concatenate([np.column_stack([A[states], mean]) * np.sqrt(mass)[:, None], spread])


def tied_to(model: Preisach) -> np.ndarray:
    """Which weight each cell or relay has, shape (n (n + 1) / 2,)."""
    return mirror(model.n)[0] if model.symmetric else np.arange(model.w.size)


def _roughness(model: Preisach, offsets: int) -> np.ndarray:
    sizes = [model.w.size, model.slopes.size, model.b.size + offsets]
    out = np.zeros((sum(sizes), sum(sizes)))
    rough = model.roughness()
    for at, name in ((0, "w"), (sizes[0], "slopes")):
        count = sizes[0] if name == "w" else sizes[1]
        D = scipy.sparse.csr_array(rough.get(name, np.zeros((0, count))))
        out[at : at + count, at : at + count] = (D.T @ D).toarray() + _RIDGE * np.eye(count)
    return out
