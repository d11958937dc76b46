"""Reports in aligned columns, meters that average, pixels, ventricles, spoilt numbers and described columns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.reading import read

from .loop_files import N, U, Y, is_pair, one, rows, written


def test_names_and_units_wrapped_over_aligned_lines_between_rules(tmp_path: Path) -> None:
    """Sorption balances write a series below each other, each with names over two lines, units below most of them, and rules."""
    rule, text = "-" * 60 + "\n", ""
    for number in (1, 2):
        text += f"{rule}     S E R I E S   R E C O R D\n{rule}\nExperiment No   00{number}\nBalance Trim (V)   0.0024 cc\n\n"
        text += (
            "Pressure   Gas        p/p0    Excess       Sample  \n           Density            Adsorption           \n"
        )
        text += f"(mbar)     (g/cc)             (mmol/g)     (°C)    \n{rule}"
        lines = zip(number * U, Y, strict=True)
        text += "".join(f"{u:<11.3f}{u * 1.15e-6:<11.6f}0.00    {y:<13.4f}20.01   \n" for u, y in lines)
        text += f"{rule}\nScan Ends   02:36:36 on 16 January 2020\nReference State   20.01°C\n\n\n\n"
    data = read(written(tmp_path, text, "series.txt"))
    assert isinstance(data, Dataset)
    for number, record in enumerate(data, start=1):
        is_pair(record, number * U)
        assert (record.u_unit, record.y_name, record.y_unit) == ("mbar", "Excess Adsorption (mmol/g)", "mmol/g")


def test_units_of_channels_beside_a_trigger_and_unused_ones(tmp_path: Path) -> None:
    head = "Channel\tAI0\tAI1\tAI2\tAI3\tAO0\nUnits\tmm\tmN\tTTL\t\tmm\n"
    head += (
        "Scale (units/V)\t1.0\t500.0\t0.2\t0.0\t1.0\nOffset (volts)\t0.0\t0.0\t0.0\t0.0\t0.0\n\nTest Data in Volts:\n\n"
    )
    noise = np.random.default_rng(3).normal(0, 0.004, N).round(4)
    columns = np.arange(N), U, Y, (np.arange(N) % 7 < 2) * 4.1, noise, (U - 40).round(2), (np.arange(N) % 7 < 2) * 1
    names = "Sample\tAI0\tAI1\tAI2\tAI3\tAO0\tStim\n"
    record = one(
        tmp_path, f"DMC Data File\nSample Frequency (Hz): 1000\n{head}{names}" + rows("\t", *columns), "loop.ddf"
    )
    is_pair(record, U, 500 * Y)
    assert (record.u_unit, record.y_unit) == ("mm", "mN")


def test_extremes_of_averaged_readings_are_no_other_signal(tmp_path: Path) -> None:
    """Meters and loggers write the largest, the smallest and the mean of the readings since the row before."""
    logged = rows(",", np.arange(1, N + 1), U, U + 0.5, U + 0.02, U - 0.4)
    file = written(tmp_path, "Reading,Sample,Max,Average,Min\n" + logged, "meter.csv")
    with pytest.raises(DataError, match=r"found 1 column.*INPUT_FILE"):
        read(file)
    record = one(
        tmp_path, "Strain (%),Stress min (MPa),Stress max (MPa),Stress mean (MPa)\n" + rows(",", U, Y - 1, Y + 1, Y)
    )
    is_pair(record)
    assert record.y_name == "Stress mean (MPa)"


@pytest.mark.parametrize("title", ["index pix", "Pixel", "device no"])
def test_numbered_pixels_and_devices_are_a_record_each(title: str, tmp_path: Path) -> None:
    text = "".join(rows("\t\t", np.full(N, k), U, k * Y) for k in (1, 2, 3))
    data = read(written(tmp_path, f"# on\n# {title}\t\tvoltage\t\tpiezoresponse\n{text}", "best_loop.txt"))
    assert isinstance(data, Dataset)
    for k, record in enumerate(data, start=1):
        is_pair(record, U, k * Y)


@pytest.mark.parametrize(
    ("names", "drives"), [("LV Pressure (mmHg),LV Volume (mL)", 1), ("Paw (cmH2O),Volume (mL)", 0)]
)
def test_the_volume_of_a_ventricle_is_under_its_pressure_and_that_of_a_lung_follows_it(names, drives, tmp_path) -> None:
    record = one(
        tmp_path,
        f"Time (ms),{names},ECG (mV)\n" + rows(",", 2 * np.arange(N), U, Y, 0.1 * np.cos(np.arange(N)).round(3)),
    )
    is_pair(record, *((Y, U) if drives else (U, Y)))


def test_columns_of_cooling_and_heating_are_one_loop(tmp_path: Path) -> None:
    falls, rises = np.linspace(300, 100, N), np.linspace(100, 300, N)
    chi = [np.round(3 / (1 + np.exp((at - t) / 4)), 4) for t, at in ((falls, 170), (rises, 205))]
    record = one(
        tmp_path,
        "T_cool (K),chiT_cool (cm3 K mol-1),T_heat (K),chiT_heat (cm3 K mol-1)\n"
        + rows(",", falls, chi[0], rises, chi[1]),
    )
    is_pair(record, np.r_[rises, falls], np.r_[chi[1], chi[0]])


def test_numbers_that_lost_a_zero_behind_the_comma_are_refused(tmp_path: Path) -> None:
    """A spreadsheet read 1.0114 as 10.114 and wrote 1.0630 as 1.063 in the same column."""
    stroke = np.round(np.linspace(1, 9, 8 * N), 4)
    cut = [f"{x:.4f}".rstrip("0") for x in stroke]
    spoilt = [text if len(text) < 6 else f"{text[0]}{text[2]}.{text[3:]}" for text in cut]
    assert any(len(text) < 6 for text in cut)
    loads = np.round(np.sqrt(stroke), 4).astype(str)
    table = lambda texts: (
        "Weg (mm);Kraft (N)\n" + "".join(f"{x};{y}\n" for x, y in zip(texts, loads, strict=True)).replace(".", ",")
    )
    with pytest.raises(DataError, match=r"are a tenth of those around them.*decimal marks were lost"):
        read(written(tmp_path, table(spoilt), "zug.csv"))
    assert isinstance(read(written(tmp_path, table(map(str, stroke)), "zug.csv")), Record)
    noise = np.random.default_rng(1).normal(size=2000).round(4)
    assert isinstance(
        read(written(tmp_path, "V (V);I (A)\n" + rows(";", np.tile([0.1, 1.0], 1000), noise), "pulses.csv")), Record
    )


def test_descriptions_of_columns_and_units_beside_arrays_of_json(tmp_path: Path) -> None:
    described = [{"name": name, "unit": unit} for name, unit in (("time", "s"), ("disp", "mm"), ("force", "kN"))]
    table = [[0.1 * k, u, y] for k, (u, y) in enumerate(zip(U.tolist(), Y.tolist(), strict=True))]
    record = one(tmp_path, json.dumps({"columns": described, "data": table}), "loop.json")
    is_pair(record)
    assert (record.u_name, record.u_unit, record.y_unit) == ("disp [mm]", "mm", "kN")
    points = [{"pressure": u, "total_adsorption": y} for u, y in zip(U.tolist(), Y.tolist(), strict=True)]
    tree = {"pressureUnits": "bar", "adsorptionUnits": "mol/kg", "concentrationUnits": "", "isotherm_data": points}
    record = one(tmp_path, json.dumps(tree), "isotherm.json")
    assert (record.u_unit, record.y_unit) == ("bar", "mol/kg")


@pytest.mark.parametrize("names", ["Zaman (sn);Kuvvet (N);Uzama (mm)", "Čas (s);Síla (N);Posuv (mm)"])
def test_times_in_turkish_and_czech(names: str, tmp_path: Path) -> None:
    record = one(tmp_path, f"{names}\n" + rows(";", 0.5 * np.arange(N), Y, U).replace(".", ","))
    is_pair(record)
    np.testing.assert_allclose(record.t, 0.5 * np.arange(N))


def test_a_temperature_drives_where_the_load_is_held(tmp_path: Path) -> None:
    """Shape memory alloys are loaded, and then heated and cooled at constant load."""
    load = np.r_[np.linspace(3, 120, 20), 120 + 0.2 * np.cos(np.arange(N))].round(3)
    warm = np.r_[np.full(20, 49.5), 1.5 * U]
    stretch = np.r_[np.linspace(0, 0.3, 20), 0.3 + Y / 50].round(4)
    columns = np.arange(N + 20) * 0.5, load, stretch, warm, (2.19 * load).round(3)
    record = one(
        tmp_path, "Time (s),Load (N),Extension (mm),Temperature Chamber (C),Stress (MPa)\n" + rows(",", *columns)
    )
    is_pair(record, warm, stretch)
    swept = columns[0], np.r_[np.linspace(3, 120, 20), 3 * Y], np.r_[np.linspace(0, 0.3, 20), U / 50], warm
    is_pair(
        one(tmp_path, "Time (s),Load (N),Extension (mm),Temperature Chamber (C)\n" + rows(",", *swept)),
        swept[2],
        swept[1],
    )


@pytest.mark.parametrize("title", ["102 (C)", "_COM1 (C)", "Chamber (C)"])
def test_channels_in_c_are_temperatures(title: str, tmp_path: Path) -> None:
    record = one(tmp_path, f"Scan,101 (VDC),103 (OHM),{title}\n" + rows(",", np.arange(N), 5 + 0 * U, Y, U))
    is_pair(record)
    assert record.u_unit == "degC"
    charge = one(tmp_path, "Voltage (V),Charge (C)\n" + rows(",", U, Y))
    assert charge.y_unit == "C"
