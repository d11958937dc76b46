"""From arguments to records and fits: files and data sets by name, windows, and what is kept for the test."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hystfit.cli.options import Output, Reading, Split, bounds_of, named_values
from hystfit.errors import DataError
from hystfit.registry import near

if TYPE_CHECKING:
    from hystfit.data.dataset import Dataset
    from hystfit.data.record import Record
    from hystfit.reading.table.raw_table import Table
    from hystfit.results.result import FitResult
    from hystfit.sampling.posterior import Posterior


def open_fit(
    folder: Path, output: Output, trust: bool, own: str = "", covariates: Sequence[str] | None = None
) -> FitResult:
    """The saved fit of a folder, or that behind its draws, once the result can be written (`Output.check`); `covariates` are NAME=VALUE."""
    from hystfit.results.saved import load_fit

    result = load_fit(fit_folder(folder), trust=trust)
    output.check(own)
    return result.at(**chosen_covariates(covariates)) if covariates else result


def fit_folder(folder: Path) -> Path:
    """The folder itself, or where it holds draws that of the fit behind them."""
    return folder / "fit" if (folder / "posterior.nc").is_file() else folder


def open_posterior(folder: Path, trust: bool, covariates: Sequence[str] | None = None) -> Posterior | None:
    """The draws of a folder; None where it holds a fit. Arguments and errors are those of `open_fit`."""
    if fit_folder(folder) == folder:
        return None
    from hystfit.sampling.files import load_posterior

    posterior = load_posterior(folder, trust=trust)
    return posterior.at(**chosen_covariates(covariates)) if covariates else posterior


def chosen_covariates(pairs: Sequence[str]) -> dict[str, float]:
    """Values of covariates from NAME=VALUE."""
    return {name: value for name, value in named_values(list(pairs), "--covariate").items() if value is not None}


_LAYOUT = ("sheet", "delimiter", "decimal", "encoding")
_TREATMENT = ("rate", "dt", "units", "integrate", "smooth")


def load(loops: Sequence[str], reading: Reading) -> Dataset:
    """The records of LOOP arguments, in the units of the first."""
    from hystfit.data.dataset import Dataset
    from hystfit.reading import datasets
    from hystfit.reading.files.archive import members_of
    from hystfit.reading.read import read
    from hystfit.reading.several import combined, files_of, pair_of

    if not loops:
        raise DataError(
            "LOOP is missing: name the file of a measured loop, or a data set (hystfit datasets lists them)"
        )
    known = [loop for loop in loops if loop in datasets.names() and not Path(loop).exists()]
    whole = lambda loop: loop in known or members_of(Path(loop))  # an archive may hold other files than measurements
    files = [str(file) for loop in loops for file in ([loop] if whole(loop) else files_of(loop))]
    if twice := sorted({file for file in files if files.count(file) > 1}):
        raise DataError(f"{twice[0]!r} is given twice")
    if all(Path(file).is_file() or pair_of(file) for file in files):
        return Dataset.of(read(files, **dataclasses.asdict(reading)))
    return Dataset.of(combined([(file, _load_one(file, reading)) for file in files]))


def load_like(loops: Sequence[str], reading: Reading, fitted: Record) -> Dataset:
    """The records of LOOP arguments, from the columns that have the names of a fit's input and output where no option names others.

    A file that is read otherwise, or has no such columns, is read as it is without a fit.
    """
    named = dataclasses.replace(reading, input=fitted.u_name, output=fitted.y_name)
    free = reading.input is None and reading.output is None
    data, refused = None, None
    try:
        data = load(loops, reading)
    except DataError as error:
        refused = error
    same = data is not None and all((one.u_name, one.y_name) == (fitted.u_name, fitted.y_name) for one in data)
    if free and not same:
        with contextlib.suppress(DataError):
            return load(loops, named)
    if data is None:
        assert refused is not None
        raise refused
    return data


def _load_one(loop: str, reading: Reading) -> Dataset:
    from hystfit.data.dataset import Dataset
    from hystfit.reading import datasets
    from hystfit.reading.files.file_bytes import no_file
    from hystfit.reading.read import read
    from hystfit.reading.several import pair_of

    if Path(loop).is_dir():
        raise no_file(loop, f"name a file in it, or give a pattern ('{loop}/*.csv')")
    if Path(loop).exists() or pair_of(loop):
        return Dataset.of(read(loop, **dataclasses.asdict(reading)))
    if loop in datasets.names():
        return _load_data_set(loop, reading)
    hint = near(loop, datasets.names()) or "; hystfit datasets lists the data sets known by name"
    raise DataError(f"no file {loop!r}, and no data set of that name{hint}")


def _load_data_set(name: str, reading: Reading) -> Dataset:
    from hystfit.data.dataset import Dataset
    from hystfit.reading import datasets
    from hystfit.reading.curves.split_curves import select_curves
    from hystfit.reading.treatment import Treatment

    chosen = {field: getattr(reading, field) for field in (*_TREATMENT, "only")}
    default = Reading(**chosen)
    changed = [field for field, value in vars(reading).items() if value != getattr(default, field)]
    if changed:
        raise DataError(f"{name!r} is a data set whose columns are known: leave out --{' --'.join(changed)}")
    treatment = Treatment(**{field: chosen[field] for field in _TREATMENT})
    data = Dataset.of(datasets.load(name)).map(treatment.of)
    if reading.only is None:
        return data
    if len(data) == 1:
        raise DataError(f"{name!r} holds one curve: leave out --only {reading.only}")
    curves = select_curves([(record.name, record) for record in data], reading.only, name)
    return Dataset(tuple(record for _, record in curves), name=data.name)


def load_one_sided(
    files: Sequence[str], reading: Reading, missing: Literal["input", "output"], fitted: Record
) -> Dataset:
    """Records of files that have no input (a reference) or no output (an excitation), or of which that is not used.

    The missing input is the number of the sample; the missing output is 0 with weight 0.

    Args:
        reading: how they are read; names no column for what is missing.
        fitted: the record of a fit: without an option for the column, the one of the same name or, if only one has it, of the same
            quantity is read.
    """
    from hystfit.data.dataset import Dataset
    from hystfit.reading.several import combined, files_of

    useless = (missing, "integrate", "sigma", *(("smooth",) if missing == "input" else ()))
    if senseless := [name for name in useless if getattr(reading, name)]:
        raise DataError(f"--{senseless[0]} does not apply to a file without {missing}: leave it out")
    paths = [str(path) for path in files_of(files)]
    return Dataset.of(combined([(path, _one_sided(path, reading, missing, fitted)) for path in paths]))


def _one_sided(path: str, reading: Reading, missing: Literal["input", "output"], fitted: Record) -> Dataset:
    import numpy as np

    from hystfit.data.dataset import Dataset
    from hystfit.outcome import Code
    from hystfit.reading.assemble import assemble
    from hystfit.reading.read import table_of
    from hystfit.reading.treatment import Treatment

    if not Path(path).is_file():
        raise DataError(f"no file {path!r} with the {'reference' if missing == 'input' else 'input'}")
    options: dict[str, Any] = dataclasses.asdict(reading)
    treatment = Treatment(**{key: options.pop(key) for key in _TREATMENT})
    table = table_of(path, **{key: options.pop(key) for key in _LAYOUT})
    column = np.arange(float(table.rows)) * (missing == "input")
    options[missing] = len(table.names)
    present, label = ("output", fitted.y_name) if missing == "input" else ("input", fitted.u_name)
    same = _column_like(table, label, fitted.y_unit if missing == "input" else fitted.u_unit)
    chosen = options[present] is None and same is not None
    if chosen:
        options[present] = same
    data = Dataset.of(assemble(table.beside(f"no {missing}", column), **options, treatment=treatment))
    if chosen:
        role = "reference" if missing == "input" else "input"
        text = f"{role}: column {same}, {table.names[same]!r}, which matches {label!r} of the fit"
        data = data.map(lambda record: record.noted(Code.COLUMN_CHOICE, text))
    return data if missing == "input" else data.map(lambda record: record.replace(weight=np.zeros(len(record))))


def _column_like(table: Table, name: str, unit: str) -> int | None:
    """Position of the column with this name, or of the only one of the quantity of this unit; None without one."""
    from hystfit.params.units import quantity
    from hystfit.reading.choice.chosen_columns import find

    try:
        return find(table, name, "reference")
    except DataError:
        kind = quantity(unit)
        alike = [k for k, other in enumerate(table.units) if kind and quantity(other) == kind]
        return alike[0] if len(alike) == 1 else None


def train_and_test(loops: Sequence[str], reading: Reading, split: Split) -> tuple[Dataset, Dataset | None]:
    """Records to fit and records to test on; without a window or curves to fit, all that are not tested are fitted."""
    train_window, test_window = bounds_of(split.window), bounds_of(split.test_window)
    train = load(loops, reading)
    test = None
    if split.test is not None:
        test = load_like([split.test], dataclasses.replace(reading, only=split.test_only), train[0])
        names = {record.name for record in train}  # whose offsets a test record of the same name would take
        test = test.map(lambda r: r.replace(name=f"{r.name} (test)") if r.name in names else r)
    elif split.test_only is not None:
        test = load(loops, dataclasses.replace(reading, only=split.test_only))
        names = {record.name for record in test}
        if reading.only is None:
            rest = tuple(record for record in train if record.name not in names)
            if not rest:
                raise DataError(f"--test-only {split.test_only} leaves no curve to fit")
            train = dataclasses.replace(train, records=rest)
    elif test_window is not None:
        test = train
        if train_window is None:
            train = train.map(lambda record: _without_window(record, *test_window))
    elif split.refit_offset:
        raise DataError(
            "--refit-offset shifts the prediction of test records: give --test, --test-only or --test-window"
        )
    if train_window is not None:
        train = train.map(lambda record: record.window(*train_window))
    if test is not None and test_window is not None:
        test = test.map(lambda record: record.window(*test_window))
    if (level := split.rest) is not None:
        before = lambda record: record.repeating() if level == "cycle" else record.resting_on(level)
        train, test = train.map(before), test and test.map(before)
    _refuse_overlap(train, test)
    return train, test


def _without_window(record: Record, start: float | None, stop: float | None) -> Record:
    """The record in which the samples of a window have no weight."""
    import numpy as np

    inside = record.window(start, stop).weight > 0
    outside = record.replace(weight=np.where(inside, 0.0, record.weight))
    if not outside.used.any():
        raise DataError(f"record {record.name!r}: the test window leaves no sample to fit")
    return outside


def _refuse_overlap(train: Dataset, test: Dataset | None) -> None:
    for one in train:
        for other in test or ():
            shared = int((one.used & other.used).sum()) if _same_samples(one, other) else 0
            if shared:
                raise DataError(
                    f"training and test data share {shared} samples of {other.name!r}: make --window and --test-window (or "
                    "the curves) disjoint"
                )


def _same_samples(one: Record, other: Record) -> bool:
    """Whether two records hold the same measurement, whatever its units."""
    import numpy as np

    if one.u.shape != other.u.shape:
        return False
    other = other.in_units(one.u_unit, one.y_unit)
    pairs = ((one.u, other.u), (one.y[one.used], other.y[one.used]))
    return all(np.allclose(a, b, rtol=1e-9, atol=1e-9 * np.ptp(a)) for a, b in pairs)
