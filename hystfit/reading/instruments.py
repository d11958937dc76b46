"""Readers for files of single instruments or laboratories: curves, loops and pulses in blocks and matrices."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
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


_MICROMAG_UNITS = {"cgs": ("Oe", "emu"), "hybrid si": ("T", "Am2"), "si": ("A/m", "Am2")}


def micromag_columns(above: Sequence[str]) -> list[tuple[str, str]] | None:
    """Names and units of field and moment in a MicroMag text file; None if it is none."""
    if not any(line.startswith("MicroMag") for line in above[:3]):
        return None
    stated = (re.match(r"Units of measure\s*:?\s*(.+)", line) for line in above)
    system = next((match[1].strip().lower() for match in stated if match), "")
    return list(zip(("H", "M"), _MICROMAG_UNITS.get(system, ("", "")), strict=True))


_MEASURED = {"Vmeas": "V", "Imeas": "A"}  # end of the operation mode of a channel of a Keysight EasyEXPERT waveform


def waveform_units(above: Sequence[str], names: Sequence[str]) -> list[str]:
    """Units of the columns in a CSV of Keysight EasyEXPERT, whose channels measure a voltage or a current; "" where unknown.

    Args:
        above: lines above the numbers, of which one has the names of the test's parameters and the next one their values.
        names: of the columns.
    """
    rows = [[cell.strip() for cell in line.split(",")] for line in above if line.startswith("TestParameter")]
    titles, values = ([row for row in rows if row[1:2] == [kind]] for kind in ("Name", "Value"))
    if not (titles and values):
        return [""] * len(names)
    modes = dict(zip(titles[0], values[0], strict=False))
    return [_waveform_unit(name, modes) for name in names]


def _waveform_unit(name: str, modes: Mapping[str, str]) -> str:
    """The unit of a column such as MeasResult2_value, given the operation modes of the channels."""
    column = re.fullmatch(r"MeasResult(\d+)_(time|value)", name)
    if column is None:
        return ""
    mode = modes.get(f"OperationMode{column[1]}", "")
    return "s" if column[2] == "time" else next((unit for end, unit in _MEASURED.items() if mode.endswith(end)), "")


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
