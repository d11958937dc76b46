"""The work on the loops of a batch: reading, solving several in one program, and the row of each."""

from __future__ import annotations

import dataclasses
import inspect
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import numpy as np

from hystfit.batch.alike import CONVEX, Group, same_columns
from hystfit.batch.bucketed import Task, solve_together
from hystfit.batch.plain_fits import FEWEST, fit_plain
from hystfit.batch.row import Row, row_of
from hystfit.batch.sources import Source
from hystfit.config import enable_x64, one_blas_thread
from hystfit.data.batch import bucket
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError, HystfitError, ParameterError
from hystfit.fitting.fit import fit
from hystfit.fitting.fit_model import judge
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.fit_setup import FitSetup, set_up_fit, solve, starting_vectors
from hystfit.fitting.solvers.estimate import Estimate
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import SEARCH, make_model, model_name
from hystfit.models.storage import to_json
from hystfit.outcome import Status
from hystfit.params.space import ParameterSpace
from hystfit.reading.read import read
from hystfit.results.provenance import Stopwatch
from hystfit.results.result import FitResult

AUTO = "auto"
_TOGETHER = "lm"  # the estimator that runs for many records in one program
_LOOKED_AT = 64  # samples of an input by which it is compared first
SAMPLES = 2**20  # in memory at once: of files read before they are fitted, and of a part of a map on a CPU


@dataclasses.dataclass(frozen=True)
class Work:
    """The task for every loop, as other processes receive it: how files are read, the units of all loops, and the options of each fit."""

    model: AbstractHysteresis | str
    options: FitOptions
    reading: Mapping[str, Any]
    units: Mapping[str, str]

    @classmethod
    def of(
        cls,
        model: AbstractHysteresis | type[AbstractHysteresis] | str,
        options: Mapping[str, Any],
        reading: Mapping[str, Any],
    ) -> Work:
        """Settings checked before any work, with the defaults of those that are not given."""
        known = [field.name for field in dataclasses.fields(FitOptions)]
        if unknown := [name for name in options if name not in known]:
            raise ParameterError(f"fit_many has no setting {unknown[0]!r}; there are {', '.join(known)}")
        if unread := [name for name in reading if name not in inspect.signature(read).parameters]:
            raise ParameterError(f"reading has no setting {unread[0]!r}; see hystfit.read")
        chosen = FitOptions(**options)
        chosen.check()
        work = cls(make_model(model) if isinstance(model, type) else model, chosen, dict(reading), {})
        if work.searches and work.model == AUTO:
            chosen.check_search()
        if not work.searches:
            space = ParameterSpace.of(make_model(work.model), fix=chosen.fix, free=chosen.free, tie=chosen.tie)
            if not len(space):
                raise ParameterError("every parameter is fixed: there is nothing to fit (use predict)")
        return work

    @property
    def searches(self) -> bool:
        """Whether the model itself is chosen for each loop."""
        return isinstance(self.model, str) and self.model in (AUTO, SEARCH)

    @property
    def name(self) -> str:
        """Name of the model."""
        return str(self.model) if isinstance(self.model, str) else model_name(self.model)

    @property
    def settings(self) -> dict[str, str]:
        """The options as text."""
        return {name: repr(value) for name, value in sorted(vars(self.options).items())}

    @property
    def described(self) -> dict[str, Any]:
        """Model and options, which identify a run."""
        return {"model": self.model if isinstance(self.model, str) else to_json(self.model), "options": self.settings}

    @property
    def quick(self) -> bool:
        """Whether a loop is expected to take milliseconds."""
        if self.searches or self.options.method not in ("auto", _TOGETHER, *CONVEX):
            return False
        return make_model(self.model).estimator in (None, *CONVEX) and self.options.plain_noise

    @property
    def plain(self) -> bool:
        """Whether loops of one kind can be judged together."""
        return self.quick and self.options.loss == "linear"

    @property
    def held(self) -> bool:
        """Whether parameters that are fixed without a value keep that of the model."""
        return not isinstance(self.model, str)


@dataclasses.dataclass
class _Loop:
    """State of one loop: its record, its fit setup, its task where others are solved with it, its estimate, and its row at the end."""

    source: Source
    name: str
    record: Record | None = None
    fit_setup: FitSetup | None = None
    task: Task | None = None
    estimate: Estimate | None = None
    row: Row | None = None

    def fails(self, error: Exception) -> None:
        """End with a reason."""
        reason = str(error) if isinstance(error, (HystfitError, OSError)) else f"{type(error).__name__}: {error}"
        sha256 = self.record.sha256 or self.record.digest() if self.record else None
        self.row = Row(self.name, self.source.file, sha256, Status.FAILED, reason)


def fit_sources(work: Work, sources: Sequence[Source]) -> list[list[dict[str, Any]]]:
    """Rows of the loops of each source; an error that concerns one loop alone is the reason in its row."""
    enable_x64()
    with one_blas_thread():  # of 1000 files: 5 s of processor time, 10 s with two threads
        return _rows_of(work, sources)


def _rows_of(work: Work, sources: Sequence[Source]) -> list[list[dict[str, Any]]]:
    """`fit_sources` as JAX and the linear algebra are set."""
    rows: list[list[dict[str, Any]]] = [[] for _ in sources]
    pending, read, size = list[tuple[int, _Loop]](), 0, lambda loop: 0 if loop.record is None else len(loop.record)
    for number, source in enumerate(sources):
        loops = _read(work, source)
        pending += [(number, loop) for loop in loops]
        read += sum(map(size, loops))
        while pending and (read > SAMPLES or number == len(sources) - 1):
            samples = np.cumsum([size(loop) for _, loop in pending])
            part = int(np.searchsorted(samples, SAMPLES, side="right")) + 1
            read -= int(samples[min(part, samples.size) - 1])
            some, pending = pending[:part], pending[part:]
            _fit(work, [loop for _, loop in some])
            for k, loop in some:
                rows[k].append(cast(Row, loop.row).to_dict())
                loop.record = None
    return rows


def fit_alone_rows(
    work: Work,
    records: Sequence[tuple[str, Record]],
    posed: Mapping[int, tuple[FitSetup, Task | None, Estimate | None]],
) -> list[Row]:
    """Rows of named records, none of which is plain; `posed` has the fits of some of them by their number, see `PlainFits.posed`."""
    loops = [_Loop(Source(name, "", record), name, record) for name, record in records]
    for k, one in posed.items():
        loops[k].fit_setup, loops[k].task, loops[k].estimate = one
    _fit(work, loops, plain=False)
    return [cast(Row, loop.row) for loop in loops]


def _fit(work: Work, loops: Sequence[_Loop], plain: bool = True) -> None:
    """Give every loop its row."""
    if work.searches:
        _each(_search, work, loops)
        return
    _each(_convert, work, loops)
    if plain and work.plain:
        _fit_plain(work, loops)
    _each(_pose, work, loops)
    _solve_together(loops)
    _each(_judge, work, loops)


def _each(step: Callable[[Work, _Loop], object], work: Work, loops: Sequence[_Loop]) -> None:
    """A step of the loops that have no row yet; a batch does not end with one of its loops."""
    for loop in loops:
        if loop.row is None:
            try:
                step(work, loop)
            except Exception as error:
                loop.fails(error)


def _read(work: Work, source: Source) -> list[_Loop]:
    unread: dict[str, str] = {}
    try:
        loops = [_Loop(source, name, record) for name, record in source.loops(work.reading, unread)]
    except Exception as error:  # as in `_each`
        loops, unread = [_Loop(source, source.name)], {}
        loops[0].fails(error)
    for name, reason in unread.items():
        loops.append(_Loop(source, name))
        loops[-1].fails(DataError(reason))
    return loops


def _convert(work: Work, loop: _Loop) -> None:
    loop.record = cast(Record, loop.record).in_units(**work.units)


def _search(work: Work, loop: _Loop) -> None:
    _convert(work, loop)
    record = cast(Record, loop.record)
    loop.row = row_of(loop.name, loop.source.file, record, fit(work.model, record, **vars(work.options)))


def _fit_plain(work: Work, loops: Sequence[_Loop]) -> None:
    """Give the rows of loops whose fit is beyond doubt, and the estimates of others of their kind that are solved."""
    kinds: dict[Any, list[_Loop]] = defaultdict(list)
    for loop in loops:
        if loop.row is None and loop.record is not None and loop.record.sigma is None:
            kinds[_kind(loop.record)].append(loop)
    for alike in kinds.values():
        if len(alike) < FEWEST:
            continue
        inputs = _by_input(alike)
        if not _fit_groups(work, inputs):  # weights have a design matrix for each input
            for same in inputs:
                if FEWEST <= len(same) < len(alike):
                    _fit_groups(work, [same])


def _fit_groups(work: Work, inputs: Sequence[Sequence[_Loop]]) -> bool:
    """`_fit_plain` of loops of one kind, input by input; whether they can be solved together."""
    ordered = [loop for same in inputs for loop in same]
    try:
        records = [[cast(Record, loop.record) for loop in same] for same in inputs]
        groups = [Group(same[0], np.stack([record.y for record in same])) for same in records]
        fits = fit_plain(make_model(work.model), groups, work.options, held=work.held)
    except HystfitError:  # each is fitted alone, and its row has the reason
        return False
    if fits is None:
        return False
    for k, loop in enumerate(ordered):
        record = cast(Record, loop.record)
        if fits.judged.plain[k]:
            loop.row = fits.row(k, loop.name, loop.source.file, record)
        elif fits.judged.close[k]:
            loop.fit_setup, loop.task, loop.estimate = fits.posed(k, record, work.options)
    return True


def _kind(record: Record) -> Any:
    """What records have in common that are judged together: labels, and the length of their arrays."""
    labels = (record.u_unit, record.y_unit, record.t_unit, record.u_name, record.y_name)
    return labels, record.t is None, repr(record.notes), bucket(len(record))


def _by_input(loops: Sequence[_Loop]) -> list[list[_Loop]]:
    """Loops of equal input, weights and time beside each other."""
    found: dict[bytes, list[list[_Loop]]] = defaultdict(list)
    for loop in loops:
        record = cast(Record, loop.record)
        near = found[record.u[:: max(1, len(record) // _LOOKED_AT)].tobytes()]
        same = next((one for one in near if same_columns(record, one[0].record, "u", "weight", "t")), None)
        near.append([loop]) if same is None else same.append(loop)
    return [same for near in found.values() for same in near]


def _pose(work: Work, loop: _Loop) -> None:
    if loop.fit_setup is not None:
        return
    data = Dataset.of(cast(Record, loop.record))
    loop.fit_setup = fit_setup = set_up_fit(make_model(work.model), data, work.options, held=work.held)
    if fit_setup.method == _TOGETHER:
        starts = starting_vectors(fit_setup.problem, work.options.starts, work.options.seed, fit_setup.points)
        loop.task = Task.of(fit_setup.problem, starts)


def _solve_together(loops: Sequence[_Loop]) -> None:
    """Solve those that can be solved with others of their structure and length."""
    buckets: dict[Any, list[_Loop]] = defaultdict(list)
    for loop in loops:
        if loop.row is None and loop.task is not None:
            buckets[loop.task.key].append(loop)
    for alike in buckets.values():
        solved = solve_together([cast(Task, loop.task) for loop in alike])
        for loop, estimate in zip(alike, solved, strict=True):
            loop.estimate = estimate


def _judge(work: Work, loop: _Loop) -> None:
    watch, fit_setup, record = Stopwatch(), cast(FitSetup, loop.fit_setup), cast(Record, loop.record)
    starts, seed = work.options.starts, work.options.seed
    estimate = loop.estimate or solve(fit_setup.problem, fit_setup.method, starts, seed, fit_setup.points)
    loop.row = row_of(loop.name, loop.source.file, record, judge(fit_setup, estimate, work.options, watch))
    loop.fit_setup = loop.task = loop.estimate = None  # arrays of the record are not kept


def record_of(work: Work, source: Source, row: Row) -> Record:
    """The record of a row, in the units of the batch."""
    return dict(source.loops(work.reading))[row.name].in_units(**work.units)


def fit_alone(work: Work, source: Source, row: Row) -> FitResult:
    """The fit of one loop with the result in full, as `hystfit.fit` makes it; of the model chosen before."""
    record = record_of(work, source, row)
    model = row.model if work.searches and row.model else work.model
    return fit(model, record, **work.options.of_fit())
