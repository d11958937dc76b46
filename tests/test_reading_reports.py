"""Tables of notes, spreadsheets and simulators: rules, names in lists, behind labels and for LaTeX, and other notations of numbers."""

from pathlib import Path

import numpy as np
import pytest

import hystfit as hf

PHASE = np.linspace(0, 4 * np.pi, 61)
FIELD = 10 * np.sin(PHASE)
MOMENT = np.round(0.7 * np.tanh(FIELD / 4 - 0.5 * np.cos(PHASE)), 5)
ROWS = [f"{h:.4f} {m:.5f}" for h, m in zip(FIELD, MOMENT, strict=True)]
BARS = [f"| {row.replace(' ', ' | ')} |" for row in ROWS]
PAIR = tuple(np.array([float(row.split()[k]) for row in ROWS]) for k in (0, 1))
LEADING = ["," + row.replace(" ", ",") for row in ROWS]
WRAPPED = [[" ".join(row.split()[k] for row in ROWS[n : n + 8]) for n in range(0, 61, 8)] for k in (0, 1)]
NAMES = ("H (kA/m)", "B (T)")
DRAWN = {
    "Markdown": ["# Loop 7", "", "| H (kA/m) | B (T) |", "| ---: | ---: |", *BARS],
    "framed": ["+----------+-------+", "| H (kA/m) | B (T) |", "+----------+-------+", *BARS, "+----------+-------+"],
    "simple": ["H (kA/m)  B (T)", "--------  -----", *ROWS],
    "table of MATLAB": ["    H (kA/m)    B (T)", "    ________    _____", "", *(f"    {row}" for row in ROWS)],
    "names and units": ["H     B", "kA/m  T", "====  =====", *ROWS],
    "rows": [
        "H (kA/m)," + ",".join(row.split()[0] for row in ROWS),
        "B (T)," + ",".join(row.split()[1] for row in ROWS),
        "Date,12.3.2024",
    ],
    "listed": ["VSM record", "@Column 0: H, [kA/m]", "@Column 1: B, [T]", "@@Data", *ROWS],
    "listed behind corrections": [
        *[f"{k}.000000   {1 + k / 1e4:.6E}   0.0E+0" for k in range(30)],
        "@Column 0: H, [kA/m]",
        "@Column 1: B, [T]",
        *ROWS,
    ],
    "listed behind tabs": ["Nsig\t2", "Sig1\tH (kA/m)", "Sig2\tB (T)", "StartOfData", *ROWS],
    "braces": ["# Columns: {Driver::Field H} {Driver::B}", "# Units: {kA/m} {T}", *ROWS],
    "behind a label": [
        '"Trace","2"',
        '"TraceName","H","B"',
        '"VUnit","kA/m","T"',
        '"Step",1,1',
        '"HUnit","s","s"',
        "",
        *LEADING,
    ],
    "some units": [
        "Pt,H,B,Over",
        "#,kA/m,T,bits",
        *(f"{k},{row.replace(' ', ',')},...." for k, row in enumerate(ROWS)),
    ],
    "LaTeX": ["$H$ ($\\mathrm{kA/m}$),$\\mathrm{B}$ (T)", *(row.replace(" ", ",") for row in ROWS)],
    "LaTeX powers": ["$\\mathbf{H}\\,(\\mathrm{kA/m})$;$B\\,(\\mathrm{T})$", *(row.replace(" ", ";") for row in ROWS)],
    "LaTeX table": [
        r"\begin{tabular}{rr}",
        r"\toprule $H$ [$\si{\kilo\ampere\per\metre}$] & $B$ [$\si{\tesla}$] \\ \midrule",
        *(row.replace(" ", " & ") + r" \\" for row in ROWS),
        r"\end{tabular}",
    ],
    "powers of ten": [
        "H (10^1 kA/m),B (×10⁻³ T)",
        *(f"{h / 10:.9g},{m * 1e3:.9g}" for h, m in zip(*PAIR, strict=True)),
    ],
    "a row of powers": [
        "H;B",
        "x10^-1 kA/m;10-3 T",
        *(f"{h * 10:.9g};{m * 1e3:.9g}" for h, m in zip(*PAIR, strict=True)),
    ],
    "SI prefixes": ["H (kA/m),B (T)", *(f"{h * 1e3:.1f}m,{m * 1e6:.0f}u" for h, m in zip(*PAIR, strict=True))],
    "without E": ["H (kA/m)  B (T)", *(f"{h:.4f}  {1e5 * m:.4f}-005" for h, m in zip(*PAIR, strict=True))],
    "Igor": ["IGOR", "WAVES/D H, B", "BEGIN", *ROWS, "END", 'X SetScale d 0,0,"kA/m", H', 'X SetScale d 0,0,"T", B'],
    "console": [f"10:00:{k / 10:06.3f} -> {row.replace(' ', ',')}" for k, row in enumerate(["H_kA/m B_T", *ROWS])],
    "wrapped": ["H (kA/m)", "61 points", *WRAPPED[0], "B (T)", "61 0.01", *WRAPPED[1]],
    "listed from 1": ["# 1 = H (kA/m)", "# 2 = B (T)", *["# a remark of several words"] * 15, *ROWS],
}


@pytest.mark.parametrize("kind", DRAWN)
def test_names_and_units_of_tables_in_notes(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "note.txt"
    path.write_text("\n".join(DRAWN[kind]) + "\n", encoding="utf-8")
    record = hf.read(path)
    assert (record.u_unit, record.y_unit) == ("kA/m", "T")
    np.testing.assert_allclose(record.u, FIELD, atol=6e-5)
    np.testing.assert_allclose(record.y, MOMENT, atol=1e-9)


@pytest.mark.parametrize(("node", "element"), [("drive", "L1"), ("drive", "V1"), ("h", "L1")])
def test_spice_names_its_voltages_and_currents(node: str, element: str, tmp_path: Path) -> None:
    """V(drive) is the voltage of the node drive, not a quantity V in drives; nor is V(h) in hours."""
    path = tmp_path / "ltspice.txt"
    rows = [f"{1e-3 * k}\t{row.replace(' ', chr(9))}" for k, row in enumerate(ROWS)]
    path.write_text("\n".join([f"time\tV({node})\tI({element})", *rows]) + "\n", encoding="utf-8")
    record = hf.read(path, input=f"V({node})", output=f"I({element})")
    assert (record.u_unit, record.y_unit) == ("V", "A")


def test_numbered_settings_are_no_columns(tmp_path: Path) -> None:
    """Lists of steps or channels with other numbers of entries than columns stay text."""
    path = tmp_path / "steps.txt"
    path.write_text(
        "\n".join(["1: warm up", "2: sweep", "3: rest", "", "H (kA/m)  B (T)", *ROWS]) + "\n", encoding="utf-8"
    )
    record = hf.read(path)
    assert record.u_name.startswith("H")


def test_a_wide_table_with_words_in_front_is_no_table_on_its_side(tmp_path: Path) -> None:
    """Few rows with many channels: the lines below the names begin with a word too."""
    channels = ",".join(f"room {k} (degC)" for k in range(24))
    lines = [f"ok,{row.replace(' ', ',')}," + ",".join(["21.5"] * 24) for row in ROWS[:45]]
    path = tmp_path / "bench.csv"
    path.write_text("\n".join([f"state,H (kA/m),B (T),{channels}", *lines]) + "\n", encoding="utf-8")
    record = hf.read(path, input="H (kA/m)", output="B (T)")
    np.testing.assert_allclose(record.u, FIELD[:45], atol=6e-5)


@pytest.mark.parametrize("date", ["3/2/2020", "2020-02-03", "03-02-2020 14:00:05"])
def test_the_year_above_a_table_is_no_number_of_samples(date: str, tmp_path: Path) -> None:
    """505 rows of four columns are 2020 numbers."""
    phase = np.linspace(0, 10 * np.pi, 505)
    u, y, count = np.round(np.sin(phase), 4), np.round(np.sin(phase - 0.3), 4), np.floor(phase / np.pi)
    rows = [f"{0.1 * k:.1f}\t{b:.4f}\t{a:.4f}\t{c:g}" for k, (a, b, c) in enumerate(zip(u, y, count, strict=True))]
    head = [
        f"Data Acquisition: Cyclic\t{date}",
        "Time\tAxial Force\tAxial Displacement\tAxial Count",
        "sec\tkN\tmm\tsegments",
    ]
    path = tmp_path / "cyclic.txt"
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    record = hf.read(path)
    assert (record.u_unit, record.y_unit) == ("mm", "kN")
    np.testing.assert_allclose(record.u, u)


def test_a_missing_number_of_a_table_on_its_side_loses_no_row(tmp_path: Path) -> None:
    fields, moments = ([row.split()[k] for row in ROWS] for k in (0, 1))
    moments[30] = ""
    path = tmp_path / "turned.csv"
    path.write_text(
        "\n".join([",".join(["H (kA/m)", *fields]), ",".join(["B (T)", *moments])]) + "\n", encoding="utf-8"
    )
    record = hf.read(path)
    assert record.y_unit == "T"
    used = np.arange(len(ROWS)) != 30
    np.testing.assert_allclose(record.y[record.used], MOMENT[used], atol=1e-9)


def test_text_of_an_old_macintosh(tmp_path: Path) -> None:
    """Its lines end in carriage returns alone, and its signs are at other places than those of Windows."""
    path = tmp_path / "loop.txt"
    rows = [f"{row.replace(' ', chr(9))}\t23.4" for row in ROWS]
    path.write_bytes("\r".join(["H (kA/m)\tDehnung (µm/m)\tKühlung (°C)", *rows]).encode("mac_roman"))
    record = hf.read(path)
    assert (record.u_unit, record.y_unit) == ("kA/m", "µm/m")
    assert "Kühlung (°C)" in record.metadata
