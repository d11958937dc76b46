"""First-order reversal curves: saturate, go back to a reversal field, return; a density from them, and the field's diagram of it."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError
from hystfit.fitting.preisach import PreisachFit, fit_preisach
from hystfit.fitting.smooth import SMOOTHNESS
from hystfit.models.free_run import free_run
from hystfit.models.levels import sharp_levels
from hystfit.models.preisach import Elements, Preisach

_CLOSE = 0.05  # spread of the curves' ends at the largest common field, in parts of the output's range, that is told


def reversal_curves(data: Dataset | Sequence[Record]) -> tuple[list[Record], bool, list[str]]:
    """Check that records are first-order reversal curves, each a branch from its reversal point back towards saturation.

    Args:
        data: one record a curve, the reversal point first.

    Returns:
        The curves in order of reversal, whether they rise (from positive saturation), and notes on crossing or open curves.

    Raises:
        DataError: fewer than two curves, branches that turn round, or directions that differ.
    """
    curves = list(Dataset.of(data))
    if len(curves) < 2:
        raise DataError(
            f"reversal curves come in families; got {len(curves)} record(s): read the file with by= its curve column"
        )
    rises = [bool(np.sum(np.sign(np.diff(r.u))) > 0) for r in curves]
    if len(set(rises)) > 1:
        raise DataError(f"{sum(rises)} of {len(curves)} curves rise and the others fall: give one kind at a time")
    for r, rising in zip(curves, rises, strict=True):
        back = np.diff(r.u) * (1 if rising else -1)
        if (back < -0.01 * np.ptp(r.u)).any():
            raise DataError(
                f"curve {r.name!r} turns round at sample {int(np.argmin(back)) + 1}: a reversal curve runs one way from its "
                "reversal point; split it there"
            )
    curves.sort(key=lambda r: r.u[0], reverse=rises[0])
    return curves, rises[0], _family_notes(curves, rises[0])


def _family_notes(curves: list[Record], rising: bool) -> list[str]:
    span = np.ptp(np.concatenate([r.y for r in curves]))
    notes = []
    sign = 1.0 if rising else -1.0
    worst, pair = 0.0, ("", "")
    for upper, lower in itertools.pairwise(curves):
        u = upper.u[(upper.u >= lower.u.min()) & (upper.u <= lower.u.max())]
        if u.size:
            gap = sign * (_at(lower, u) - _at(upper, u))
            if gap.max() > worst:
                worst, pair = float(gap.max()), (upper.name, lower.name)
    if worst > 0.01 * span:
        notes.append(
            f"curves {pair[0]} and {pair[1]} cross by {worst / span:.1%} of the range: non-negative masses cannot follow that"
        )
    end = min(r.u.max() for r in curves) if rising else max(r.u.min() for r in curves)
    ends = [float(_at(r, np.array([end]))[0]) for r in curves]
    if np.ptp(ends) > _CLOSE * span:
        notes.append(
            f"at {end:g} the curves differ by {np.ptp(ends) / span:.1%} of the range: they do not close, "
            "so the largest field was no saturation"
        )
    return notes


def _at(record: Record, u: np.ndarray) -> np.ndarray:
    order = np.argsort(record.u, kind="stable")
    return np.interp(u, record.u[order], record.y[order])


def fit_forc(
    data: Dataset | Sequence[Record],
    n: int = 60,
    *,
    nonnegative: bool = True,
    elements: Elements = "cells",
    smoothness: Sequence[float] = SMOOTHNESS[2:7],
) -> PreisachFit:
    """Preisach masses from first-order reversal curves, on levels denser where the output is steep.

    Args:
        data: one record a curve, the reversal point first.
        n: cells, or relay levels, along each axis.
        nonnegative: bound masses and slopes from below; signed masses follow the data closer, and have no inverse.
        elements: cells, or point relays.
        smoothness: strengths to choose among, by curves left out.

    Returns:
        The fit; its model starts from saturation.

    Raises:
        DataError: see `reversal_curves`.
    """
    curves, rising, notes = reversal_curves(data)
    # The reversal points are samples of the branch on which the field left saturation, which no curve shows.
    start = np.array([(r.u[0], r.y[0]) for r in curves])
    fall = 0.5 * (start[1:, 0] + start[:-1, 0]), _quotient(np.diff(start[:, 1]), np.diff(start[:, 0]))
    back = (
        np.concatenate([r.u for r in curves]),
        np.concatenate([_quotient(np.gradient(r.y), np.gradient(r.u)) for r in curves]),
    )
    levels = sharp_levels([back, fall], n)
    levels = levels if elements == "cells" else 0.5 * (levels[1:] + levels[:-1])
    model = Preisach.of(n, elements=elements, initial="positive" if rising else "negative", spacing="given")
    center = 0.5 * (levels[0] + levels[-1])
    model = eqx.tree_at(lambda m: (m.levels, m.center), model, (jnp.asarray(levels), jnp.asarray(center)))
    fit = fit_preisach(curves, model, nonnegative=nonnegative, smoothness=smoothness, left_out="records")
    return dataclasses.replace(fit, notes=(*notes, *fit.notes))


def _quotient(rise: np.ndarray, run: np.ndarray) -> np.ndarray:
    return rise / np.where(run == 0, np.inf, run)


def predict_curves(model: Preisach, curves: Sequence[Record]) -> list[np.ndarray]:
    """Outputs of a fitted model on reversal curves, each from saturation to its first sample and on."""
    return [free_run(model, r.u) for r in curves]


@dataclasses.dataclass(frozen=True)
class ForcDiagram:
    """FORC distribution rho = -1/2 d2M / dHr dH over reversal field Hr and field H, the field's picture of a density.

    Attributes:
        reversal, field: grid lines, shapes (R,) and (F,).
        density: shape (R, F), NaN where there are no data (H before Hr).
    """

    reversal: np.ndarray
    field: np.ndarray
    density: np.ndarray

    @property
    def coercivity(self) -> np.ndarray:
        """Half the distance from reversal to field, shape (R, F): the horizontal axis as the field draws it."""
        return 0.5 * np.abs(self.field[None, :] - self.reversal[:, None])

    @property
    def interaction(self) -> np.ndarray:
        """Middle of reversal and field, shape (R, F): the vertical axis."""
        return 0.5 * (self.field[None, :] + self.reversal[:, None])


def forc_diagram(data: Dataset | Sequence[Record], smoothing: int = 3) -> ForcDiagram:
    """Local second-degree fits over (2 SF + 1)^2 points, as the field computes it (Pike, Roberts and Verosub 1999).

    Args:
        data: reversal curves.
        smoothing: the factor SF, in curves and as many field steps.

    Raises:
        DataError: see `reversal_curves`; a smoothing factor below one.
    """
    if smoothing < 1:
        raise DataError(f"the smoothing factor must be at least 1, got {smoothing}")
    curves, _, _ = reversal_curves(data)
    reversal = np.array([r.u[0] for r in curves])
    step = float(np.median(np.abs(np.concatenate([np.diff(r.u) for r in curves]))))
    low, high = min(r.u.min() for r in curves), max(r.u.max() for r in curves)
    field = np.arange(low, high + 0.5 * step, step)
    table = np.full((reversal.size, field.size), np.nan)
    for k, r in enumerate(curves):
        inside = (field >= r.u.min()) & (field <= r.u.max())
        table[k, inside] = _at(r, field[inside])
    density = np.full(table.shape, np.nan)
    for k in range(reversal.size):
        for j in np.flatnonzero(np.isfinite(table[k])):
            rows = slice(max(k - smoothing, 0), k + smoothing + 1)
            cols = slice(max(j - smoothing, 0), j + smoothing + 1)
            density[k, j] = _mixed(reversal[rows] - reversal[k], field[cols] - field[j], table[rows, cols])
    order = np.argsort(reversal)
    return ForcDiagram(reversal[order], field, density[order])


def _mixed(a: np.ndarray, b: np.ndarray, block: np.ndarray) -> float:
    """-1/2 of the mixed second derivative at the middle of a block, from the best second-degree polynomial."""
    A, B = np.meshgrid(a, b, indexing="ij")
    ok = np.isfinite(block)
    if ok.sum() < 9 or np.ptp(A[ok]) == 0 or np.ptp(B[ok]) == 0:
        return np.nan
    x, y = A[ok] / np.ptp(a), B[ok] / np.ptp(b)
    columns = np.column_stack([np.ones(x.size), x, y, x * x, x * y, y * y])
    solution, _, rank, _ = np.linalg.lstsq(columns, block[ok], rcond=1e-9)
    return float(-0.5 * solution[4] / (np.ptp(a) * np.ptp(b))) if rank == 6 else np.nan
