"""The FORC diagram: local second-degree fits to reversal curves, with standard errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import scipy  # loads its subpackages when they are first used

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.models.preisach.everett import cells
from hystfit.models.preisach.model import Preisach
from hystfit.quality.faults import MAD_TO_RMS
from hystfit.quality.reversal_curves import reversal_curves

_FEWEST = 9  # points of a local fit
_FINEST = 8.0  # fields for each step of the reversals at most: more cost memory, and a window averages over all of them


@dataclasses.dataclass(frozen=True)
class ForcDiagram:
    """FORC distribution rho = -1/2 d2M / dHr dH over reversal field Hr and field H.

    Attributes:
        reversal, field: grid lines, shapes (R,) and (F,).
        density: shape (R, F), NaN where there are no data (H before Hr).
        area: of each cell of the grid, shape (R, F); None where it follows from the grid lines.
        resolution: half width over which the density was smoothed, along either field [u]; 0 for a fitted density.
        stderr: standard error of the density from the noise of the curves, shape (R, F); None if unknown.
        repeats: densities of the same curves with their noise drawn once more, shape (N, R, F); None if unknown.
    """

    reversal: np.ndarray
    field: np.ndarray
    density: np.ndarray
    area: np.ndarray | None = None
    resolution: float = 0.0
    stderr: np.ndarray | None = None
    repeats: np.ndarray | None = None

    @classmethod
    def of_model(cls, model: Preisach, *, rising: bool = True) -> ForcDiagram:
        """The density of a fitted model over the middles of its cells; `rising` as for curves that begin at positive saturation."""
        levels, (i, j) = np.asarray(model.levels), cells(model.n)
        width, middle = np.diff(levels), 0.5 * (levels[1:] + levels[:-1])
        area = width[:, None] * width[None, :] * np.where(np.eye(model.n, dtype=bool), 0.5, 1.0)
        density, at = np.full(area.shape, np.nan), (j, i) if rising else (i, j)
        density[at] = np.asarray(model.masses()) / area[at]
        return cls(middle, middle, density, area)

    @property
    def coercivity(self) -> np.ndarray:
        """Half the distance from reversal to field, shape (R, F): the horizontal axis as the field draws it."""
        return 0.5 * np.abs(self.field[None, :] - self.reversal[:, None])

    @property
    def interaction(self) -> np.ndarray:
        """Middle of reversal and field, shape (R, F): the vertical axis."""
        return 0.5 * (self.field[None, :] + self.reversal[:, None])

    @property
    def mass(self) -> np.ndarray:
        """Integral of the density over each cell of the grid, shape (R, F); 0 where there are no data."""
        area = self.area
        if area is None:
            area = np.abs(np.gradient(self.reversal))[:, None] * np.abs(np.gradient(self.field))[None, :]
        return np.nan_to_num(self.density) * area

    def at(self, coercivity: np.ndarray, interaction: np.ndarray) -> np.ndarray:
        """The density at points, shape of the arguments, by bilinear interpolation; NaN where there are no data."""
        from scipy.interpolate import RegularGridInterpolator

        low, high = interaction - coercivity, interaction + coercivity
        rising = not np.isfinite(self.density[-1, 0])  # no data before the reversal field
        points = np.stack([low, high] if rising else [high, low], axis=-1)
        return RegularGridInterpolator((self.reversal, self.field), self.density, bounds_error=False)(points)

    def again(self) -> Iterator[ForcDiagram]:
        """The diagrams of the curves with their noise drawn once more: their scatter is the error of what is read off this one."""
        for density in () if self.repeats is None else self.repeats:
            yield dataclasses.replace(self, density=density, repeats=None)


def forc_diagram(
    data: Dataset | Sequence[Record], smoothing: int = 3, *, repeats: int = 0, seed: int = 0
) -> ForcDiagram:
    """Local second-degree fits over (2 SF + 1)^2 points, as the field computes it (Pike, Roberts and Verosub 1999).

    Standard errors follow from the scatter of the curves about the local fits (Heslop and Roberts 2012). Where fields are denser than
    reversals, the fit takes as many of them as cover the width of SF reversals.

    Args:
        data: reversal curves.
        smoothing: the factor SF, in curves and as many field steps.
        repeats: densities to compute with the noise drawn once more, for errors of numbers.
        seed: of these draws.

    Raises:
        DataError: see `hystfit.quality.reversal_curves.reversal_curves`; a smoothing factor below one.
    """
    if smoothing < 1:
        raise DataError(f"the smoothing factor must be at least 1, got {smoothing}")
    curves = sorted(reversal_curves(data).curves, key=lambda r: r.u[0])
    reversal = np.array([r.u[0] for r in curves])
    step = float(np.median(np.abs(np.concatenate([np.diff(r.u) for r in curves]))))
    apart = float(np.median(np.abs(np.diff(reversal))))
    step = min(max(step, apart / _FINEST), apart) if apart > 0 else step
    low, high = min(r.u.min() for r in curves), max(r.u.max() for r in curves)
    field = np.arange(low, high + 0.5 * step, step)
    table = _tabulate(curves, [r.y for r in curves], field)
    fits_over = lambda factor: _LocalFits.of(
        reversal, field, np.isfinite(table), factor, round(factor * max(apart / step, 1.0))
    )
    fits = fits_over(smoothing)
    smallest = fits if smoothing == 1 else fits_over(1)  # these windows have the least curvature left
    draw = np.random.default_rng(seed).standard_normal
    noise = [_tabulate(curves, [draw(len(r)) for r in curves], field) for _ in range(max(repeats, 1))]
    sigma = smallest.noise(table) / (smallest.noise(noise[0]) or 1.0)  # of single samples, which the table interpolates
    drawn = np.stack([fits.density(table + sigma * one) for one in noise]) if repeats else None
    stderr = sigma * fits.density_factor
    return ForcDiagram(reversal, field, fits.density(table), None, smoothing * max(apart, step), stderr, drawn)


def _tabulate(curves: Sequence[Record], values: Sequence[np.ndarray], field: np.ndarray) -> np.ndarray:
    """Values at the samples of curves as a table over their fields, shape (R, F); NaN outside a curve."""
    table = np.full((len(curves), field.size), np.nan)
    for k, (r, y) in enumerate(zip(curves, values, strict=True)):
        inside = (field >= r.u.min()) & (field <= r.u.max())
        order = np.argsort(r.u, kind="stable")
        table[k, inside] = np.interp(field[inside], r.u[order], y[order])
    return table


@dataclasses.dataclass(frozen=True)
class _LocalFits:
    """The local polynomials of a whole table as linear operators on it, since they depend on its fields alone."""

    # from the table to -1/2 of the mixed second derivative, one row for each point with enough neighbors, shape (P, R F)
    mixed: scipy.sparse.csr_array
    middle: scipy.sparse.csr_array  # to the value of the polynomial at the point itself, shape (P, R F)
    rows: np.ndarray  # the points in the table
    shape: tuple[int, int]  # of the table

    @classmethod
    def of(cls, reversal: np.ndarray, field: np.ndarray, known: np.ndarray, curves: int, fields: int) -> _LocalFits:
        """The operators over windows of 2 `curves` + 1 reversals and 2 `fields` + 1 fields where values are known."""
        step = field[1] - field[0]
        rows, columns, mixed, middle = [], [], [], []
        for k, near in (
            (k, np.arange(max(k - curves, 0), min(k + curves + 1, reversal.size))) for k in range(len(known))
        ):
            solved: dict[bytes, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None] = {}
            padded = np.pad(known[near], ((0, 0), (fields, fields)))
            for j in np.flatnonzero(known[k]):
                block = padded[:, j : j + 2 * fields + 1]
                if (pattern := block.tobytes()) not in solved:
                    solved[pattern] = _local_fit(
                        reversal[near] - reversal[k], step * np.arange(-fields, fields + 1), block
                    )
                if (fit := solved[pattern]) is None:
                    continue
                at, shift, to_mixed, to_middle = fit
                rows.append(k * field.size + j)
                columns.append(near[at] * field.size + j + shift - fields)
                mixed.append(to_mixed)
                middle.append(to_middle)
        sizes = np.cumsum([0, *(len(one) for one in columns)])
        whole = (len(rows), known.size)
        join = lambda parts: np.concatenate(parts) if parts else np.zeros(0)
        operator = lambda parts: scipy.sparse.csr_array((join(parts), join(columns).astype(int), sizes), shape=whole)
        return cls(operator(mixed), operator(middle), np.array(rows, dtype=int), known.shape)

    def density(self, table: np.ndarray) -> np.ndarray:
        """-1/2 of the mixed second derivative, shape (R, F); NaN where there are too few neighbors."""
        return self._placed(self.mixed @ np.nan_to_num(table).ravel())

    @property
    def density_factor(self) -> np.ndarray:
        """Standard error of the density for noise of size one, shape (R, F)."""
        return self._placed(np.sqrt(np.asarray(self.mixed.power(2).sum(axis=1)).ravel()))

    def noise(self, table: np.ndarray) -> float:
        """Standard deviation of single values about the local polynomials, from the median, which steep places do not move."""
        if not self.rows.size:
            return 0.0
        known = np.nan_to_num(table).ravel()
        own = self.middle[np.arange(self.rows.size), self.rows]
        freedom = 1 - np.asarray(own).ravel()
        left = known[self.rows] - self.middle @ known
        return float(MAD_TO_RMS * np.sqrt(np.median(left**2 / np.maximum(freedom, 1e-12))))

    def _placed(self, values: np.ndarray) -> np.ndarray:
        table = np.full(self.shape, np.nan)
        table.ravel()[self.rows] = values
        return table


def _local_fit(
    reversal: np.ndarray, field: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """The best polynomial of second degree on a window: its points, and their weights in the mixed derivative and in the middle value.

    None where the points do not determine it.
    """
    at, shift = np.nonzero(known)
    x, y = reversal[at], field[shift]
    if at.size < _FEWEST or np.ptp(x) == 0 or np.ptp(y) == 0:
        return None
    scale = np.ptp(x), np.ptp(y)
    x, y = x / scale[0], y / scale[1]
    terms = np.column_stack([np.ones(x.size), x, y, x * x, x * y, y * y])
    if np.linalg.matrix_rank(terms, tol=1e-9 * np.sqrt(terms.size)) < terms.shape[1]:
        return None
    weights = np.linalg.pinv(terms)
    return at, shift, -0.5 * weights[4] / (scale[0] * scale[1]), weights[0]
