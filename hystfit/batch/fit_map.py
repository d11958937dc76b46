"""`fit_map`: one model fitted to every loop of an array, such as that of a scan over a sample, part by part."""

from __future__ import annotations

import hashlib
import itertools
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.batch.alike import Group
from hystfit.batch.loop_map import LoopMap, shared
from hystfit.batch.plain_fits import FEWEST, PlainFits, fit_plain
from hystfit.batch.row import Row
from hystfit.batch.work import SAMPLES, Work, fit_alone_rows
from hystfit.config import device_of_many, verb
from hystfit.data.record import Record
from hystfit.errors import DataError, HystfitError, ParameterError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model
from hystfit.outcome import Status
from hystfit.params.space import ParameterSpace
from hystfit.runs.chunks import claim, keep, load
from hystfit.runs.threads import Workers

_ON_GPU = 2**24  # samples of a part with a GPU: each of few threads holds some copies of them
Columns = dict[str, np.ndarray]


@verb
def fit_map(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    u: Any,
    y: Any,
    t: Any = None,
    *,
    u_unit: str = "",
    y_unit: str = "",
    t_unit: str = "s",
    folder: str | Path | None = None,
    workers: int | None = None,
    progress: Callable[[str, float], object] | None = None,
    **options: Any,
) -> LoopMap:
    """Fit one model to every loop of an array, each on its own, with the estimates, errors and verdicts of `hystfit.fit`.

    All loops have one input. Those whose fit is beyond doubt are solved and judged together, on a GPU where JAX finds one and there are
    1024 or more; every other loop is fitted as `hystfit.fit` does it. A loop that cannot be fitted has a status and a reason.

    Args:
        model: a model, its class or its name.
        u: input, shape (T,).
        y: outputs, shape (..., T): an array of NumPy, or anything with a shape and slices (an HDF5 data set, a Zarr array), which is
            read part by part. NaN marks a missing measurement.
        t: time of each sample, shape (T,).
        u_unit, y_unit, t_unit: units.
        folder: keeps finished parts, from which the same call resumes.
        workers: threads; by default one for each core, at most four.
        progress: called with a line of text and the fraction done.
        **options: of `hystfit.fit`: method (no sequential one), fix, free, start, starts, seed, loss, noise, tie.

    Returns:
        The parameters, their errors and the status of every loop, in the shape of the array.

    Raises:
        HystfitError: settings that no loop can be fitted with, columns that do not fit each other, or a folder that holds another map.
    """
    work = Work.of(model, options, {})
    if work.searches:
        raise ParameterError("fit_map fits one model, such as 'bouc-wen' (fit_many compares models on each loop)")
    frame = _frame(u, y, t, u_unit, y_unit, t_unit)
    place = None if folder is None else claim(Path(folder), "map.json", _described(work, frame, np.shape(y)))
    parts = list(_parts(np.shape(y), len(frame)))
    done, telling = itertools.count(1), threading.Lock()

    def run(number: int, part: slice) -> Columns:
        columns = _kept(place, number, work, frame, y, part)
        columns |= {name: shared(columns[name]) for name in ("status", "codes")}
        with telling:
            count = next(done)
            if progress:
                progress(f"{count} of {len(parts)} parts", count / len(parts))
        return columns

    found = Workers(workers).run([partial(run, number, part) for number, part in enumerate(parts)])
    space = ParameterSpace.of(
        make_model(work.model), fix=work.options.fix, free=work.options.free, tie=work.options.tie
    )
    return LoopMap.of(found, np.shape(y)[:-1], space.names, work.name, frame, work)


def _frame(u: Any, y: Any, t: Any, u_unit: str, y_unit: str, t_unit: str) -> Record:
    """A record with the input, the time and the units of all loops."""
    shape = np.shape(y)
    if len(shape) < 2 or 0 in shape:
        raise DataError(f"the outputs must have shape (..., T) with at least one loop, got {shape}")
    labels = {"u_unit": u_unit, "y_unit": y_unit, "t_unit": t_unit, "name": "loop"}
    frame = Record(u=u, y=np.asarray(u, float), t=t, **labels)
    if len(frame) != shape[-1]:
        raise DataError(f"the input has {len(frame)} samples, and each loop {shape[-1]}")
    return frame


def _parts(shape: tuple[int, ...], samples: int) -> Iterator[slice]:
    """Slices of the first axis, each with as many loops as are solved at once: on a GPU a power of two, to which lanes are padded."""
    gpu = device_of_many() is not None
    loops = 1 << ((_ON_GPU // samples).bit_length() - 1) if gpu else SAMPLES // samples
    most = max(1, loops // int(np.prod(shape[1:-1])))
    edges = np.linspace(0, shape[0], -(-shape[0] // most) + 1).round().astype(int)  # of nearly equal size
    yield from map(slice, edges[:-1].tolist(), edges[1:].tolist())


def _described(work: Work, frame: Record, shape: tuple[int, ...]) -> Mapping[str, Any]:
    """What identifies a map but its outputs, which every part compares."""
    units = (frame.u_unit, frame.y_unit, frame.t_unit)
    return work.described | {"units": units, "input": frame.digest(), "shape": list(shape)}


def _kept(place: Path | None, number: int, work: Work, frame: Record, y: Any, part: slice) -> Columns:
    """Columns of a part, from the folder or computed and kept there."""
    rows = np.asarray(y[part], dtype=float).reshape(-1, len(frame))
    if place is None:
        return _fit_part(work, frame, rows)
    file, digest = place / f"part{number}.npz", np.array(hashlib.sha256(np.ascontiguousarray(rows)).hexdigest())
    kept = load(file)
    if kept is not None and kept.pop("digest", None) == digest:
        return kept
    columns = _fit_part(work, frame, rows)
    try:
        keep(file, {**columns, "digest": digest})
    except OSError as error:
        raise DataError(f"cannot write {str(file)!r}: {error.strerror or error}") from error
    return columns


def _fit_part(work: Work, frame: Record, y: np.ndarray) -> Columns:
    """Columns of numbers and text, one entry a loop; see `LoopMap`."""
    fits = None
    if work.plain and len(y) >= FEWEST:
        try:
            fits = fit_plain(make_model(work.model), [Group(frame, y)], work.options, held=work.held)
        except HystfitError:  # each is fitted alone, and has the reason
            fits = None
    plain = np.zeros(len(y), bool) if fits is None else fits.judged.plain
    alone = np.flatnonzero(~plain)
    rows: dict[int, Row] = {}
    records: dict[int, Record] = {}
    for k in alone.tolist():
        try:
            records[k] = frame.replace(y=y[k])
        except DataError as error:
            rows[k] = Row("loop", "", None, Status.FAILED, str(error))
    posed = {
        number: fits.posed(k, record, work.options)
        for number, (k, record) in enumerate(records.items())
        if fits is not None and fits.judged.close[k]
    }
    fitted = fit_alone_rows(work, [("loop", record) for record in records.values()], posed)
    rows |= dict(zip(records, fitted, strict=True))
    return _columns(len(y), plain, fits, rows)


def _columns(count: int, plain: np.ndarray, fits: PlainFits | None, rows: Mapping[int, Row]) -> Columns:
    """Columns of loops that were judged together, and of those that were fitted alone."""
    columns: Columns = {"alone": ~plain}
    together, alone = {} if fits is None else fits.columns(), {k: row.numbers() for k, row in rows.items()}
    for name in dict.fromkeys([*together, *(name for one in alone.values() for name in one)]):
        column = columns[name] = np.full(count, np.nan)
        if name in together:
            column[plain] = together[name][plain]
        for k, one in alone.items():
            column[k] = np.nan if one.get(name) is None else one[name]
    columns["status"], columns["codes"] = _texts(plain, fits, rows)
    numbers = sorted(rows)
    columns["reason_of"], columns["reason"] = np.array(numbers, int), np.array([rows[k].reason for k in numbers], str)
    with_units = [] if fits is None or fits.example is None else [fits.example]
    units = next((row.units for row in [*with_units, *rows.values()] if row.units), {})
    columns["unit_of"], columns["unit"] = np.array(list(units), dtype=str), np.array(list(units.values()), dtype=str)
    return columns


def _texts(plain: np.ndarray, fits: PlainFits | None, rows: Mapping[int, Row]) -> tuple[np.ndarray, np.ndarray]:
    """Status of each loop, and the codes of its notes, separated by spaces."""
    status, codes = np.full(len(plain), str(Status.OK), object), np.full(len(plain), "", object)
    if fits is not None:
        codes[plain] = np.array([" ".join(one) for one in fits.notes.sets], object)[fits.notes.of[plain]]
    for k, row in rows.items():
        status[k], codes[k] = str(row.status), " ".join(row.codes)
    return status.astype(str), codes.astype(str)
