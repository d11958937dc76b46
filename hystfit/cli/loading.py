"""From arguments to records: files and data sets by name, windows, and what is kept for the test."""

from __future__ import annotations

import dataclasses
import difflib
from pathlib import Path
from typing import TYPE_CHECKING

from hystfit.cli.options import Reading, Split, limits
from hystfit.errors import DataError

if TYPE_CHECKING:
    from hystfit.data.record import Dataset


def load(loop: str, reading: Reading) -> Dataset:
    """The records that a LOOP argument means.

    Raises:
        DataError: neither a file nor a data set, or it cannot be read as asked.
    """
    from hystfit.data.record import Dataset
    from hystfit.reading import datasets
    from hystfit.reading.read import read

    if Path(loop).is_dir():
        raise DataError(f"{loop!r} is a folder; name a file in it")
    if Path(loop).exists():
        return Dataset.of(read(loop, **dataclasses.asdict(reading)))
    if loop in datasets.names():
        return _by_name(loop, reading)
    close = difflib.get_close_matches(loop, datasets.names(), n=3)
    hint = f"did you mean {' or '.join(close)}?" if close else "hystfit datasets lists the data sets known by name"
    raise DataError(f"no file {loop!r}, and no data set of that name; {hint}")


def _by_name(name: str, reading: Reading) -> Dataset:
    from hystfit.data.record import Dataset
    from hystfit.reading import datasets
    from hystfit.reading.read import select_curves

    asked = [field for field, value in vars(reading).items() if value not in (None, "error") and field != "only"]
    if asked:
        raise DataError(f"{name!r} is a data set with its columns known: leave out --{' --'.join(asked)}")
    data = Dataset.of(datasets.load(name))
    if reading.only is None:
        return data
    if len(data) == 1:
        raise DataError(f"{name!r} holds one curve, so that --only {reading.only} has nothing to choose from")
    chosen = select_curves([(record.name, record) for record in data], reading.only, name)
    return Dataset(tuple(record for _, record in chosen), name=data.name)


def train_and_test(loop: str, reading: Reading, split: Split) -> tuple[Dataset, Dataset | None]:
    """Records to fit and records to test on; without a window or curves to fit, those are all that are not tested.

    Raises:
        DataError: as `load`, an empty window, or a test that shares samples with the fit.
    """
    fitted, tested = limits(split.window), limits(split.test_window)
    train = load(loop, reading)
    test = None
    if split.test is not None:
        chosen = dataclasses.replace(reading, only=split.test_only)
        test = _apart(load(split.test, chosen), train)
    elif split.test_only is not None:
        test = load(loop, dataclasses.replace(reading, only=split.test_only))
        names = {record.name for record in test}
        if reading.only is None:
            left = tuple(record for record in train if record.name not in names)
            if not left:
                raise DataError(f"--test-only {split.test_only} leaves no curve to fit")
            train = dataclasses.replace(train, records=left)
    elif tested is not None:
        test = train
        if fitted is None:
            train = train.map(lambda record: _without(record, *tested))
    elif split.refit_offset:
        raise DataError(
            "--refit-offset shifts the prediction of test records: give --test, --test-only or --test-window"
        )
    if fitted is not None:
        train = train.map(lambda record: record.window(*fitted))
    if test is not None and tested is not None:
        test = test.map(lambda record: record.window(*tested))
    if (rest := split.rest) is not None:
        train = train.map(lambda record: record.resting_on(rest))
        test = test and test.map(lambda record: record.resting_on(rest))
    _refuse_overlap(train, test)
    return train, test


def _without(record, start: float | None, stop: float | None):
    """The record in which the samples of a window do not count."""
    import numpy as np

    inside = record.window(start, stop).weight > 0
    rest = record.replace(weight=np.where(inside, 0.0, record.weight))
    if not rest.used.any():
        raise DataError(f"record {record.name!r}: the test window leaves no sample to fit")
    return rest


def _apart(test: Dataset, train: Dataset) -> Dataset:
    """Test records from another file under names that no fitted record has (it would lend them its offset)."""
    names = {record.name for record in train}
    return test.map(lambda r: r.replace(name=f"{r.name} (test)") if r.name in names else r)


def _refuse_overlap(train: Dataset, test: Dataset | None) -> None:
    for one in train:
        for other in test or ():
            same = one.u.shape == other.u.shape and (one.u == other.u).all() and (one.y == other.y)[one.used].all()
            shared = int((one.used & other.used).sum()) if same else 0
            if shared:
                raise DataError(
                    f"{shared} samples of {other.name!r} would be fitted and tested at once, and their error says nothing "
                    "about prediction: let --window and --test-window (or the curves) not overlap"
                )
