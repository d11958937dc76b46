"""Readers for files of single instruments or laboratories: curves, loops and pulses in blocks and matrices."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hystfit.data.record import Dataset, Record
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


def micromag_blocks(path: Path) -> Iterator[np.ndarray]:
    """Blocks of (field, moment) rows of a MicroMag text file, each of shape (N, 2)."""
    rows: list[list[float]] = []
    for line in path.read_text(encoding="latin-1").splitlines():
        cells = line.split(",")
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) == 2:
            rows.append(row)
        elif rows:
            yield np.array(rows)
            rows = []
    if rows:
        yield np.array(rows)


def reversal_curves(paths: tuple[Path, ...]) -> Dataset:
    """One record per curve: the calibration point at saturation (weight 0) before it, then the curve."""
    records: list[Record] = []
    calibration: np.ndarray | None = None
    for block in micromag_blocks(paths[0]):
        if len(block) == 1:
            calibration = block
            continue
        if calibration is None:
            raise DataError(f"{paths[0]}: a curve of {len(block)} points comes before any calibration point")
        table = np.concatenate([calibration, block])
        weight = np.append(0.0, np.ones(len(block)))
        records.append(
            Record(
                table[:, 0],
                table[:, 1],
                weight=weight,
                u_unit="Oe",
                y_unit="emu",
                u_name="H",
                y_name="M",
                name=f"curve-{len(records) + 1}",
            ).noted(Code.CURVES, "the calibration point at saturation is the first sample, with weight 0")
        )
        calibration = None
    return Dataset(tuple(records))


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
