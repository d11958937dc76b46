"""Readers for single published data sets: loops and pulses in blocks and matrices."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code, Note


def magnetic_loops(paths: tuple[Path, ...]) -> Dataset:
    """Loops in the columns of two matrices HmeasT [A/m] and BmeasT [T], smallest first."""
    from scipy.io import loadmat

    fields, flux = loadmat(paths[0])["HmeasT"], loadmat(paths[1])["BmeasT"]
    records = []
    for number in range(fields.shape[1]):
        u, y = fields[:, number], flux[:, number]
        records.append(Record(u, y, u_unit="A/m", y_unit="T", u_name="H", y_name="B", name=f"loop-{number + 1}"))
    return Dataset(tuple(records))


def shaking_table(paths: tuple[Path, ...]) -> Record:
    """Position x and force F from the matrix x_F = [x v F], 0.01 s."""
    from scipy.io import loadmat

    table = loadmat(paths[0])["x_F"]
    record = Record(table[:, 0], table[:, 2], t=0.01 * np.arange(len(table)), u_name="x", y_name="F")
    return record.noted(Code.LEFT_OUT, "left out: the measured velocity (second column of x_F)")


def pulse_train(paths: tuple[Path, ...]) -> Dataset:
    """Rows `DataValue, V, I, t, t` of an instrument's CSV: one record per pulse, with its own time."""
    rows = []
    for line in paths[0].read_text(encoding="utf-8-sig").splitlines():
        if line.startswith("DataValue"):
            rows.append([float(cell) for cell in line.split(",")[1:4]])
    if not rows:
        raise DataError(f"{paths[0]} has no DataValue rows")
    table = np.array(rows)
    pulses = np.split(table, np.flatnonzero(np.diff(table[:, 2]) < 0) + 1)
    units = {"u_unit": "V", "y_unit": "A", "u_name": "V", "y_name": "I"}
    note = Note(Code.PREPARED, "the output is a current: integrate it over time for the charge")
    return Dataset(
        tuple(
            Record(*pulse.T[:3], name=f"pulse-{number}", notes=(note,), **units)  # type: ignore[arg-type]
            for number, pulse in enumerate(pulses, start=1)
        )
    )
