"""Files as the instruments of sorption, indentation and dampers write them, with units where each of them states them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.params.units import conversion, quantity
from hystfit.reading import read
from hystfit.results.measured.loop_values import quantities

N = 60
TOP = 33  # samples of the branch that rises
P = np.round(np.append(np.linspace(0.5, 101, TOP), np.linspace(99, 4, N - TOP)), 3)
Q = np.round(40 + 2.1 * P + 30 * np.sin(np.pi * np.arange(N) / N), 3)
X = np.round(12 * np.sin(np.linspace(0, 4 * np.pi, 200)), 4)
V = np.round(np.gradient(X) / 0.01, 3)
F = np.round(300 * np.tanh(V / 20) + 4 * X, 3)


def one(folder: Path, lines: Iterable[str], name: str = "sample.csv") -> Record:
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    record = read(folder / name)
    assert isinstance(record, Record)
    return record


def is_isotherm(record: Record, u_unit: str, y_unit: str) -> None:
    np.testing.assert_allclose(record.u, P, rtol=1e-12)
    np.testing.assert_allclose(record.y, Q, rtol=1e-12)
    assert (record.u_unit, record.y_unit) == (u_unit, y_unit)


def rows(*columns: np.ndarray, mark: str = ",") -> list[str]:
    return [mark.join(map(str, row)) for row in zip(*columns, strict=True)]


@pytest.mark.parametrize("saturated", [False, True])
def test_branches_of_star_files_are_one_loop(saturated: bool, tmp_path: Path) -> None:
    columns = [P, np.full(N, 101.3), Q] if saturated else [P, Q]
    lines = ["data_raw", "_exptl_adsorptive N2", "_units_pressure kPa", "_units_loading 'ml(STP) g-1'"]
    for branch, part in (("adsorp", slice(0, TOP)), ("desorp", slice(TOP, None))):
        names = ["pressure", *(["p0"] if saturated else []), "amount"]
        lines += ["", "loop_", *(f"_{branch}_{name}" for name in names)]
        lines += rows(*(column[part] for column in columns), mark=" ")
    record = one(tmp_path, lines, "sample.aif")
    is_isotherm(record, "kPa", "ml(STP) g-1")
    assert not any("left out" in note.text for note in record.notes)


def test_a_desorption_that_starts_below_the_last_adsorbed_point_is_the_other_branch(tmp_path: Path) -> None:
    """As points of an instrument that lowers the pressure by its own steps, and at a gate, where the branches share no end."""
    lines = ["data_raw", "_units_pressure kPa", "_units_loading 'ml(STP) g-1'"]
    for branch, part in (("adsorp", slice(0, TOP - 3)), ("desorp", slice(TOP + 6, N - 8))):
        lines += ["", "loop_", f"_{branch}_pressure", f"_{branch}_amount", *rows(P[part], Q[part], mark=" ")]
    record = one(tmp_path, lines, "sample.aif")
    assert record.u.size == TOP - 3 + N - 8 - (TOP + 6)


def test_tables_of_other_columns_in_star_files_are_left_out_and_named(tmp_path: Path) -> None:
    lines = [
        "loop_",
        "_peak_width",
        "_peak_height",
        "1 2",
        "2 5",
        "",
        "loop_",
        "_pressure",
        "_amount",
        *rows(P, Q, mark=" "),
    ]
    record = one(tmp_path, lines, "sample.cif")
    is_isotherm(record, "", "")
    assert any("1 of other columns are left out" in note.text for note in record.notes)


def test_the_amount_adsorbed_is_the_output_over_the_relative_pressure(tmp_path: Path) -> None:
    names = "No,pi/kPa,pe/kPa,p0/kPa,p/p0,Va/cm^3(STP) g^-1"
    noisy = np.round(P + 0.4 * np.cos(7.0 * np.arange(N)), 3)
    table = rows(np.arange(1, N + 1), noisy, P, np.full(N, 101.3), np.round(P / 101.3, 8), Q)
    head = ["Sample name:,", "Sample weight,0.0813,[g]", 'Sample comment,"dried"', ""]
    record = one(tmp_path, [*head, names, "ADS", *table[:TOP], "DES", *table[TOP:]])
    np.testing.assert_allclose(record.u, P / 101.3, rtol=1e-6)
    np.testing.assert_allclose(record.y, Q)
    assert record.y_unit == "cm^3(STP) g^-1"
    text = " ".join(note.text for note in record.notes)
    assert "0.0813 [g]" in text
    assert '"' not in text
    assert "Sample name" not in text


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_units_are_stated_by_the_name_of_the_column(kind: str, tmp_path: Path) -> None:
    units = {"loading_unit": "mmol", "pressure_unit": "bar"}
    if kind == "csv":
        lines = [*map(",".join, units.items()), "t_iso,77.0", "loading,pressure", *rows(Q, P)]
    else:
        points = [{"loading": q, "pressure": p} for p, q in zip(P.tolist(), Q.tolist(), strict=True)]
        lines = [json.dumps({"isotherm_data": points} | units, indent=1)]
    is_isotherm(one(tmp_path, lines, f"sample.{kind}"), "bar", "mmol")


@pytest.mark.parametrize("unit", ["cm^3(STP) g^-1", "ml(STP) g-1", "cm3/g STP", "mmol/g", "mmol"])
def test_units_of_amounts_adsorbed(unit: str) -> None:
    assert quantity(unit) == "loading"


def test_percent_as_machines_write_it() -> None:
    assert conversion("pct", "%") == 1


def test_water_lost_is_read_over_the_suction_rather_than_the_temperature(tmp_path: Path) -> None:
    t = np.arange(N) * 600
    temperature = np.round(20 + 2 * np.sin(np.arange(N) / 9.0), 3)
    names = "Time [s],Suction [kPa],Weight [g],Temperature [°C]"
    is_isotherm(one(tmp_path, [names, *rows(t, P, Q, temperature)]), "kPa", "g")


def test_segments_whose_clock_goes_on_are_one_record(tmp_path: Path) -> None:
    lines = ["Time_s\tDepth_nm\tLoad_uN", *rows(np.arange(N) * 0.5, P, Q, mark="\t")]
    for place in (TOP + 9, TOP, 1):
        lines.insert(place + 1, "")
    is_isotherm(one(tmp_path, lines, "indent.txt"), "nm", "uN")
    anew = ["t\tx\tF", *rows(np.arange(N) * 0.5, P, Q, mark="\t"), "", *rows(np.arange(N) * 0.5, P, Q + 3, mark="\t")]
    (tmp_path / "two.txt").write_text("\n".join(anew))
    data = read(tmp_path / "two.txt")
    assert isinstance(data, Dataset)
    assert len(data) == 2


def test_a_v_that_is_the_rate_of_d_is_a_velocity(tmp_path: Path) -> None:
    t = np.round(np.arange(X.size) * 0.01, 2)
    acceleration = np.round(np.gradient(V) / 0.01, 2)
    record = one(tmp_path, ["t,A,D,V,F", *rows(t, acceleration, X, V, F)])
    np.testing.assert_allclose(record.u, X)
    np.testing.assert_allclose(record.y, F)
    other = one(tmp_path, ["t,V,D", *rows(t, F, X)])  # no rate of D: a voltage
    np.testing.assert_allclose(other.u, F)


@pytest.mark.parametrize("sign", [1, -1])
def test_one_signal_twice_is_half_of_a_pair(sign: int, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"one signal.*INPUT_FILE\+.*OUTPUT_FILE"):
        one(tmp_path, rows(np.round(np.arange(X.size) * 0.01, 2), X, sign * X, mark=" "), "reaction.out")


def test_counters_and_clocks_are_no_levels(tmp_path: Path) -> None:
    x, force = np.tile(X, 3), np.tile(F, 3)
    cycle = np.repeat(np.arange(1, 7), 100)
    names = "Total Time (s),Total Cycles,Elapsed Segments,Displacement (mm),Load (N)"
    record = one(tmp_path, [names, *rows(np.arange(600) / 100, cycle, 2 * cycle, x, force)])
    assert not any("levels" in note.text for note in record.notes)
    assert (record.u_unit, record.y_unit) == ("mm", "N")


@pytest.mark.parametrize("specimens", [1, 2])
def test_the_results_of_specimens_in_a_magic_file_stand_beside_ours(specimens: int, tmp_path: Path) -> None:
    """tanh loops of known coercivity and moment over a paramagnet, of which the results of another table are without its slope."""
    chi, field = 2e-7, np.r_[np.linspace(1, -1, 201), np.linspace(-0.99, 1, 200)]
    head = "specimen\tmethod_codes\thyst_ms_mass\thyst_mr_mass\thyst_bcr\thyst_bc\thyst_xhf\n"
    results, rows = f"tab\tspecimens\n{head}", "specimen\tmethod_codes\tmeas_field_dc\tmagn_mass\tmeas_temp\n"
    truth = {}
    for k in range(specimens):
        name, ms, bc = f"S{k + 1}", 0.1 * (k + 1), 0.02 + 0.01 * k
        side = np.where(np.arange(field.size) <= 200, 1, -1)
        moment = ms * np.tanh((field + side * bc) / 0.1) + chi * field / (4e-7 * np.pi)
        truth[name] = {"saturation": ms, "remanence": ms * np.tanh(bc / 0.1), "coercive_input": bc}
        results += f"{name}\tLP-BCR-BF\t\t{0.5 * ms}\t{2 * bc}\t\t\n"
        results += f"{name}\tLP-HYS:SM-SLOPE\t{ms}\t{truth[name]['remanence']:.6g}\t\t{bc}\t{chi}\n"
        rows += "".join(f"{name}\tLP-HYS\t{b:.5f}\t{m:.8g}\t300\n" for b, m in zip(field, moment, strict=True))
    path = tmp_path / "contribution.txt"
    path.write_text(f"{results}>>>>>>>>>>\ntab\tmeasurements\n{rows}>>>>>>>>>>\n", encoding="utf-8")
    data = Dataset.of(read(path))
    assert len(data) == specimens
    for record, expected, values in zip(data, truth.values(), quantities(data).rows.values(), strict=True):
        assert {one.quantity: one.value for one in record.stated if one.quantity} == pytest.approx(expected, rel=1e-5)
        corrected = {one.name: one for one in values if one.name.endswith("_corrected") and one.stated is not None}
        assert len(corrected) == 3
        for one in corrected.values():
            assert one.value == pytest.approx(one.stated, rel=0.01)
