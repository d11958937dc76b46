"""`fit_many`: one model fitted to each of many loops, together where it can be, and resumable after an interruption."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.batch.fits import Fits
from hystfit.batch.row import Row
from hystfit.batch.sources import Source, sources_of, units_of
from hystfit.batch.work import Work, fit_sources
from hystfit.config import verb
from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Status
from hystfit.runs.chunks import claim
from hystfit.runs.pool import computed

# Loops in one task, where each takes milliseconds: what they share is found once for them. An interruption loses the task, so that tasks
# are smaller where finished rows are kept.
_FEW, _MOST = 32, 128
_ROWS = "rows.jsonl"


@verb
def fit_many(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    loops: Iterable[str | Path | Record] | str | Path,
    *,
    folder: str | Path | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    reading: Mapping[str, Any] | None = None,
    progress: Callable[[str, float], object] | None = None,
    **options: Any,
) -> Fits:
    """Fit one model to each of many loops, each on its own, with the estimates, errors and verdicts of `hystfit.fit`.

    Levenberg-Marquardt runs for many loops of similar length in one compiled program, and loops over one input are judged together
    where their fit is beyond doubt. A loop that does not converge there, ends on a bound, or has a model with another estimator is
    fitted as `hystfit.fit` does it. A loop that cannot be read or fitted is a row
    with the reason. All loops are converted to the units of the first one that can be read.

    Args:
        model: a model, its class or its name; "auto" compares models on each loop.
        loops: files, patterns such as "loops/*.csv", and records; every curve of a file is a loop.
        folder: keeps finished rows, from which the same call resumes; loops may be added in between.
        workers: processes on this machine.
        scheduler: address of a Dask scheduler to use instead.
        reading: arguments of `hystfit.read`, for files.
        progress: called with a line of text and the fraction done.
        **options: of `hystfit.fit`: method (no sequential one), fix, free, start, starts, seed, loss, noise, tie.

    Returns:
        A table with one row for each loop.

    Raises:
        HystfitError: settings that no loop can be fitted with, no loops, the same loop twice, or a folder that holds another batch.
    """
    if workers < 1:
        raise ParameterError(f"workers must be at least 1, got {workers}")
    work = Work.of(model, options, reading or {})
    sources = sources_of(loops)
    work = dataclasses.replace(work, units=units_of(sources, work.reading))
    journal = None if folder is None else Journal(claim(Path(folder), "batch.json", _described(work)) / _ROWS)
    rows: dict[str, Sequence[Row]] = {} if journal is None else dict(journal.rows)
    missing = [source for source in sources if source.key not in rows]
    chunks = _chunks(missing, workers if work.quick else len(missing), _MOST if journal is None else _FEW)
    for number, outcome in computed(partial(fit_sources, work), chunks, workers, scheduler):
        finished = _finished(chunks[number], outcome)
        if journal is not None and not isinstance(outcome, Exception):  # what broke is tried again by the next call
            journal.add(finished)
        rows |= dict(finished)
        if progress:
            done = sum(source.key in rows for source in sources)
            progress(f"{done} of {len(sources)} loops", done / len(sources))
    pairs = [(row, source) for source in sources for row in rows[source.key]]
    return Fits(tuple(row for row, _ in pairs), work.name, work.units, work, tuple(source for _, source in pairs))


def _chunks(sources: Sequence[Source], workers: int, few: int) -> list[Sequence[Source]]:
    """Tasks of nearly equal size, of `few` loops or more where there are so many, as many for each process."""
    share = -(-len(sources) // max(1, workers))
    count = max(1, workers) * max(1, round(share / max(few, min(_MOST, share // 4))))
    edges = np.linspace(0, len(sources), count + 1).round().astype(int).tolist()
    return [sources[a:b] for a, b in itertools.pairwise(edges) if b > a]


def _described(work: Work) -> dict[str, Any]:
    """The settings that identify a batch: model, options and reading, not its loops."""
    reading = {name: repr(value) for name, value in sorted(work.reading.items())}
    return work.described | {"reading": reading, "units": dict(work.units)}


def _finished(chunk: Sequence[Source], outcome: Any) -> list[tuple[str, list[Row]]]:
    """Keys and rows of the loops of a task."""
    if isinstance(outcome, Exception):
        reason = f"the worker process failed: {type(outcome).__name__}: {outcome}"
        return [(source.key, [Row(source.name, source.file, None, Status.FAILED, reason)]) for source in chunk]
    return [(source.key, [Row.of(row) for row in rows]) for source, rows in zip(chunk, outcome, strict=True)]


Finished = tuple[str, Sequence[Row]]


class Journal:
    """One line for each file or record: its key and its rows; made with the first. A line that an interruption cut short is ignored."""

    def __init__(self, file: Path):
        self.file = file
        self.rows: dict[str, tuple[Row, ...]] = {}
        try:
            text = file.read_bytes() if file.exists() else b""
        except OSError as error:
            raise DataError(f"cannot read {str(file)!r}: {error.strerror or error}") from error
        whole = [line for line in text.splitlines(keepends=True) if self._accept(line)]
        if (kept := b"".join(whole)) != text:
            scratch = file.with_name(f".{file.name}")
            scratch.write_bytes(kept)
            scratch.replace(file)

    def _accept(self, line: bytes) -> bool:
        """Take the rows of a line; whether it is whole."""
        if not line.endswith(b"\n"):
            return False
        try:
            content = json.loads(line)
            self.rows[content["key"]] = tuple(Row.of(row) for row in content["rows"])
        except (ValueError, KeyError, TypeError):
            return False
        return True

    def add(self, finished: Sequence[Finished]) -> None:
        """Append the rows of several loops."""
        lines = [json.dumps({"key": key, "rows": [row.to_dict() for row in rows]}) + "\n" for key, rows in finished]
        try:
            with self.file.open("a", encoding="utf-8") as handle:
                handle.write("".join(lines))
                handle.flush()
                os.fsync(handle.fileno())
        except OSError as error:
            raise DataError(f"cannot write {str(self.file)!r}: {error.strerror or error}") from error
        self.rows |= {key: tuple(rows) for key, rows in finished}
