"""The fits of the loops of an array: maps of each parameter, its error and the status."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hystfit.batch.many_fits import ERRORS, ManyFits
from hystfit.batch.work import Work
from hystfit.data.record import Record
from hystfit.errors import ParameterError, optional
from hystfit.fitting.fit import fit
from hystfit.outcome import Status, Table
from hystfit.params.units import with_unit
from hystfit.registry import near
from hystfit.results.colors import MODEL, SECOND
from hystfit.results.exchange import write_table
from hystfit.results.result import FitResult

_FAR = 6.0  # median deviations from the median, beyond which a usable loop is an outlier
_AXES = ("x", "y", "z")
_ROWS = 2**14  # of a table that are made at once


@dataclasses.dataclass(frozen=True, repr=False)
class LoopMap(ManyFits):
    """Fits of one model to the loops of an array; every array has its shape, NaN where a number is unknown.

    Attributes:
        shape: of the array, without the samples.
        values, stderr: of the free parameters by name.
        quantities: of the steady loop of each fitted model.
        errors: `rmse` [y], `error_percent` and `max_error_percent` [% of the range of each output].
        statuses: of each fit, as text.
        codes: of the notes of each fit, separated by spaces.
        reasons: why a loop has no usable fit, or its warnings, by its place; of loops that were fitted alone.
        alone: which loops were fitted alone.
        units: of parameters and quantities.
        model: its name.
        frame: input, time and units of all loops.
        work: what was done with every loop.
    """

    shape: tuple[int, ...]
    values: Mapping[str, np.ndarray]
    stderr: Mapping[str, np.ndarray]
    quantities: Mapping[str, np.ndarray]
    errors: Mapping[str, np.ndarray]
    statuses: np.ndarray
    codes: np.ndarray
    reasons: Mapping[tuple[int, ...], str]
    alone: np.ndarray
    units: Mapping[str, str]
    model: str
    frame: Record
    work: Work
    schema: ClassVar[str] = "hystfit.map/1"

    @classmethod
    def of(
        cls,
        parts: Sequence[Mapping[str, np.ndarray]],
        shape: tuple[int, ...],
        names: Sequence[str],
        model: str,
        frame: Record,
        work: Work,
    ) -> LoopMap:
        """From the columns of its parts.

        Args:
            parts: columns of numbers and text, part after part.
            shape: of the array.
            names: of the free parameters.
            model: its name.
            frame: input, time and units of all loops.
            work: what was done with every loop.
        """
        known = dict.fromkeys(name for part in parts for name in part if name.startswith("quantity "))
        empty = lambda part: np.full(len(part["status"]), np.nan)
        joined = lambda name: np.concatenate([part.get(name, empty(part)) for part in parts]).reshape(shape)
        edges = np.cumsum([0, *(len(part["status"]) for part in parts)])
        place = lambda k: tuple(int(i) for i in np.unravel_index(k, shape))
        reasons = {
            place(first + k): str(text)
            for part, first in zip(parts, edges, strict=False)
            for k, text in zip(part["reason_of"], part["reason"], strict=True)
            if text
        }
        units = {str(k): str(v) for part in parts for k, v in zip(part["unit_of"], part["unit"], strict=True)}
        return cls(
            shape=shape,
            values={name: joined(f"value {name}") for name in names},
            stderr={name: joined(f"stderr {name}") for name in names},
            quantities={name.removeprefix("quantity "): joined(name) for name in known},
            errors={name: joined(name) for name in ERRORS},
            statuses=joined("status"),
            codes=joined("codes"),
            reasons=reasons,
            alone=joined("alone").astype(bool),
            units=units,
            model=model,
            frame=frame,
            work=work,
        )

    def __len__(self) -> int:
        return int(np.prod(self.shape))

    @property
    def ok(self) -> np.ndarray:
        """Which fits are usable."""
        return self.statuses == str(Status.OK)

    def _statuses(self) -> list[str]:
        return self.statuses.ravel().tolist()

    def __getitem__(self, name: str) -> np.ndarray:
        """The map of a parameter, quantity or error, in the shape of the array."""
        known = {**self.values, **self.quantities, **self.errors}
        if name not in known:
            raise ParameterError(
                f"no parameter or quantity {name!r}{near(name, list(known))}; there are {', '.join(known)}"
            )
        return known[name]

    def outliers(self, name: str) -> np.ndarray:
        """Usable loops far from most others in a parameter or quantity, in the shape of the array, bool."""
        values = np.where(self.ok, self[name], np.nan)
        if not np.isfinite(values).any():
            return np.zeros(self.shape, bool)
        away = np.abs(values - np.nanmedian(values))
        return away > _FAR * np.nanmedian(away)

    def result(self, place: tuple[int, ...], y: Any) -> FitResult:
        """The fit of one loop with everything that `hystfit.fit` gives; it is fitted again.

        Args:
            place: in the array.
            y: its output, shape (T,).
        """
        return fit(self.work.model, self.frame.replace(y=y, name=str(place)), **self.work.options.of_fit())

    def summary(self) -> Table:
        """Distribution of each parameter and quantity over the usable fits, beside the median standard error of one fit."""
        rows = []
        for name, values in {**self.values, **self.quantities}.items():
            known = self.ok & np.isfinite(values)
            errors = self.stderr[name][known] if name in self.stderr else np.array(np.nan)
            error = float(np.nanmedian(errors)) if np.isfinite(errors).any() else None
            far = int(self.outliers(name).sum())
            rows.append((name, self.units.get(name, ""), values[known], (error, far)))
        return self._distribution(rows, ("median stderr", "outliers"))

    def __str__(self) -> str:
        judged = f"{int((~self.alone).sum())} were judged together, {int(self.alone.sum())} were fitted alone"
        bad = [(place, text) for place, text in self.reasons.items() if not self.ok[place]][:5]
        bad = [f"  {place}: {self.statuses[place]}: {text}" for place, text in bad]
        return self._lines([judged], self.summary().lines("  "), bad)

    __repr__ = __str__

    def plot(self, name: str) -> Any:
        """Maps of a parameter and of its standard error, with marks on loops without a usable fit and on outliers; its distribution.

        Returns:
            The matplotlib figure.

        Raises:
            ParameterError: no such parameter, or an array that is no map.
        """
        import matplotlib.pyplot as plt

        if len(self.shape) != 2:
            raise ParameterError(f"a map has two axes, and this array has shape {self.shape}")
        values = np.where(self.ok, self[name], np.nan)
        error = self.stderr.get(name)
        figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
        label = with_unit(name, self.units.get(name, ""))
        for axis, picture, title in ((axes[0], values, label), (axes[1], error, f"standard error of {label}")):
            if picture is None:
                axis.set_axis_off()
                continue
            axis.set_facecolor("#dddddd")
            shown = axis.imshow(np.where(self.ok, picture, np.nan), origin="lower", interpolation="nearest")
            figure.colorbar(shown, ax=axis)
            axis.set_title(title, fontsize=9)
        marked = np.argwhere(self.outliers(name))
        axes[0].scatter(marked[:, 1], marked[:, 0], s=14, facecolors="none", edgecolors=SECOND, label="outliers")
        here = values[np.isfinite(values)]
        if here.size:
            axes[2].hist(here, bins=min(60, max(5, int(np.sqrt(here.size)))), color=MODEL)
        axes[2].set_xlabel(label)
        axes[2].set_ylabel("usable loops")
        return figure

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`: counts and distributions; the maps themselves are in the files of `save`."""
        bad = [
            {"place": list(place), "status": str(self.statuses[place]), "reason": text}
            for place, text in self.reasons.items()
            if not self.ok[place]
        ]
        alone = int(self.alone.sum())
        return super().to_dict() | {"shape": list(self.shape), "fitted_alone": alone, "not_usable": bad[:100]}

    # -- files -----------------------------------------------------------------------------------------------------------

    def to_xarray(self) -> Any:
        """Maps as an xarray dataset, with units as attributes.

        Raises:
            MissingExtraError: xarray is not installed.
        """
        xarray = optional("xarray", "frames", "to_xarray")
        names = self._axes
        data: dict[str, Any] = {}
        for name, values in {**self.values, **self.quantities}.items():
            data[name] = (names, values, {"units": self.units.get(name, "")})
        for name, values in self.stderr.items():
            data[f"{name}_stderr"] = (names, values, {"units": self.units.get(name, "")})
        data |= {name: (names, values) for name, values in self.errors.items()}
        data |= {"status": (names, self.statuses), "notes": (names, self.codes)}
        return xarray.Dataset(data, attrs={"schema": self.schema, "model": self.model})

    def save(self, path: str | Path) -> Path:
        """Write the maps: .nc (netCDF) and .zarr (a Zarr store) over the axes of the array, .parquet with one row a loop.

        Raises:
            DataError: another ending.
            HystfitError: the file cannot be written; an older one stays.
            MissingExtraError: a package for this kind of file is not installed.
        """
        return write_table(path, self._frames, self.to_xarray)

    def _frames(self) -> Iterator[Any]:
        """Parts of the table with one row a loop: a data frame takes three times the memory of the map."""
        data, first, rows = self.to_xarray(), self._axes[0], max(1, _ROWS * self.shape[0] // len(self))
        data = data.assign_coords({first: np.arange(self.shape[0])})
        for begin in range(0, self.shape[0], rows):
            yield data.isel({first: slice(begin, begin + rows)}).to_dataframe().reset_index()

    @property
    def _axes(self) -> Sequence[str]:
        """Names of the axes of the array."""
        count = len(self.shape)
        return _AXES[:count][::-1] if count <= len(_AXES) else [f"axis{k}" for k in range(count)]


def shared(texts: np.ndarray) -> np.ndarray:
    """The same texts as objects, each different one once in a process, so that a loop costs a pointer."""
    different, numbers = np.unique(texts, return_inverse=True)
    return np.array([sys.intern(text) for text in different.tolist()], object)[numbers].reshape(texts.shape)
