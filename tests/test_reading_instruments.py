"""Tables of magnetometers, source-measure units, lock-in amplifiers and furnaces: channels, terminals, components and conditions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.outcome import Code
from hystfit.reading import read
from hystfit.reading.names.column_names import column_quantity
from hystfit.reading.names.names_with_units import split_unit
from hystfit.reading.table.signal_evidence import roughness

N = 120
RNG = np.random.default_rng(4)
U = np.round(np.concatenate([np.linspace(1, -1, N // 2), np.linspace(-1, 1, N // 2)]), 4)
# A wide loop that lags: the falling branch switches below zero, the rising one above.
Y = np.round(np.tanh(6 * (U + np.where(np.arange(N) < N // 2, 0.3, -0.3))), 5)
NOISE = np.round(RNG.normal(0, 1, N), 3)


def loop(folder: Path, header: str, *columns: np.ndarray, mark: str = ",", above: str = "") -> Record:
    lines = (mark.join(map(str, row)) for row in zip(*columns, strict=True))
    path = folder / "loop.dat"
    path.write_text(above + header + "\n" + "\n".join(lines) + "\n")
    data = read(path)
    assert isinstance(data, Record), [record.name for record in data]
    return data


def is_pair(record: Record, u: np.ndarray, y: np.ndarray) -> None:
    np.testing.assert_allclose(record.u, u, rtol=1e-12)
    np.testing.assert_allclose(record.y, y, rtol=1e-12)


@pytest.mark.parametrize("count", [2, 3])
def test_rows_of_other_channels_in_turn_are_left_out(count: int, tmp_path: Path) -> None:
    """A resistance bridge measures one channel a row, and leaves the cells of the others empty."""
    rows, clock = [], 0
    for k in range(N):
        for channel in range(count):
            clock += 2
            cells = [f"{(100 + channel + Y[k]):.5f}" if at == channel else "" for at in range(count)]
            rows.append(f",{clock},{300 + 0.01 * NOISE[k]:.4f},{9000 * U[k]:.2f},{','.join(cells)}")
    named = ",".join(f"Bridge {at + 1} Resistivity (Ohm)" for at in range(count))
    path = tmp_path / "film.dat"
    header = f"Comment,Time Stamp (sec),Temperature (K),Magnetic Field (Oe),{named}"
    path.write_text("[Header]\nTITLE,Resistivity\n[Data]\n" + "\n".join([header, *rows]) + "\n")
    for channel in range(count):
        record = read(path, **({"output": f"Bridge {channel + 1} Resistivity (Ohm)"} if channel else {}))
        assert isinstance(record, Record)
        is_pair(record, np.round(9000 * U, 2), np.round(100 + channel + Y, 5))
        assert not any(note.code is Code.CONDITIONS for note in record.notes)


@pytest.mark.parametrize("in_phase", ["X", "Y"])
def test_of_the_components_of_a_lock_in_amplifier_the_larger_one_is_read(in_phase: str, tmp_path: Path) -> None:
    signal, other = Y, 0.04 * Y + 0.01 * NOISE
    x, y = (signal, other) if in_phase == "X" else (other, signal)
    is_pair(loop(tmp_path, "H(Oe)\tX\tY\tDEG", 300 * U, x, y, np.degrees(np.arctan2(y, x)), mark="\t"), 300 * U, signal)


def test_x_and_y_alone_are_an_input_and_its_output(tmp_path: Path) -> None:
    is_pair(loop(tmp_path, "X,Y,DEG", 300 * U, Y, 0.1 * Y + 0.01 * NOISE), 300 * U, Y)


@pytest.mark.parametrize("header", ["VG,ID,IG", "Vgs (V),Ids (A),Igs (A)", "V_G,I_D,I_G", "Vg,Id,Ig"])
@pytest.mark.parametrize("sweep", ["there and back", "once"])
def test_terminals_of_a_transistor(header: str, sweep: str, tmp_path: Path) -> None:
    gate = U if sweep != "once" else np.linspace(-1, 1, N)
    record = loop(tmp_path, header, 10 * gate, 1e-6 * Y, 1e-12 * NOISE)
    is_pair(record, 10 * gate, 1e-6 * Y)
    assert record.t is None
    assert record.u_unit in ("", "V")


def test_an_id_without_a_gate_is_a_number() -> None:
    assert column_quantity("ID") == column_quantity("Id") == "index"
    assert [column_quantity(name) for name in ("VDS", "V_D", "Vgs", "I_S", "IG")] == ["voltage"] * 3 + ["current"] * 2
    assert split_unit("V_G") == ("V_G", "")
    assert split_unit("V_mV") == ("V", "mV")
    assert split_unit("I_A") == ("I", "A")


def test_two_outputs_of_branches_over_one_input(tmp_path: Path) -> None:
    """The gate's current stands beside that of the drain, each on the way there and back."""
    gate, switched = np.linspace(-3, 3, 61), lambda at: np.round(1 / (1 + np.exp(-(gate_of - at) / 0.15)), 6)
    gate_of = gate
    leak = [1e-9 * NOISE[:61], 1e-9 * NOISE[-61:]]
    record = loop(tmp_path, "Vg,Id_fwd,Id_bwd,Ig_fwd,Ig_bwd", gate, switched(0.8), switched(-0.6), *leak)
    is_pair(record, np.concatenate([gate, gate[::-1]]), np.concatenate([switched(0.8), switched(-0.6)[::-1]]))


def test_a_hall_voltage_responds_to_the_field(tmp_path: Path) -> None:
    record = loop(
        tmp_path, "#B(T) Vxx(V) Vxy(V) T(K)", 1.5 * U, 1e-3 - 1e-6 * U**2, 1e-5 * Y, 10 + 1e-3 * NOISE, mark=" "
    )
    is_pair(record, 1.5 * U, 1e-5 * Y)


def test_the_signed_piezoresponse_is_read_rather_than_its_amplitude(tmp_path: Path) -> None:
    header = "DC Bias (V),Amplitude off (pm),Phase off (deg),Piezoresponse off (a.u.)"
    record = loop(tmp_path, header, 8 * U, 50 * np.abs(Y), np.where(Y > 0, 0, 180), 50 * Y)
    is_pair(record, 8 * U, 50 * Y)


def test_polarization_and_flux_density_over_one_field_are_one_loop(tmp_path: Path) -> None:
    """B is J and mu0 H: whichever is read, the quantities of both follow, and there is nothing to ask."""
    field, flux = 1000 * U, np.round(1.2 * Y, 5)
    record = loop(tmp_path, "H [kA/m];J [T];B [T]", field, flux, np.round(flux + 4e-4 * np.pi * field, 5), mark=";")
    is_pair(record, field, flux)


def test_a_strain_over_the_temperature_at_a_stress_that_is_held(tmp_path: Path) -> None:
    record = loop(tmp_path, "Temperature,Strain,Stress", 70 - 50 * U, 2.5 - 2 * Y, 150 + 0.4 * NOISE)
    is_pair(record, 70 - 50 * U, 2.5 - 2 * Y)


def test_the_measured_temperature_drives_and_is_no_condition(tmp_path: Path) -> None:
    """Of a furnace with a setpoint and two thermometers; the temperatures are no conditions of the loop over one of them."""
    kelvin = np.round(330 + 30 * U, 3)
    measured = kelvin + 0.05 * NOISE
    columns = (2.0 * np.arange(N), kelvin, measured, np.round(0.9 * measured + 30, 4), 100 + 50 * Y)
    record = loop(tmp_path, "time(s)\tSetpoint(K)\tTemp A(K)\tTemp B(K)\tRes(Ohm)", *columns, mark="\t")
    is_pair(record, measured, 100 + 50 * Y)
    assert not any(note.code is Code.CONDITIONS for note in record.notes)


def test_the_question_on_channels_without_names_offers_those_that_are_related(tmp_path: Path) -> None:
    """A loop beside components that are noise: no order of the columns tells which one drives, and their relation tells which belong."""
    from hystfit.errors import DataError

    path = tmp_path / "output"
    columns = [2 * U + 0.005 * NOISE, 0.02 * NOISE, 0.02 * NOISE[::-1], Y, np.abs(Y)]
    text = lambda: "".join(" ".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))
    path.write_text(text())
    with pytest.raises(DataError, match="--input 0 --output 3 "):
        read(path)
    columns[0] = 2 * U  # set by equal steps, as no measurement is
    path.write_text(text())
    is_pair(read(path), 2 * U, Y)


def test_a_column_of_units_belongs_to_the_one_before_it(tmp_path: Path) -> None:
    """As a source-measure unit keeps its buffer: the reading and the value that was sourced, each before its unit."""
    units = np.full(N, "Amp DC"), np.full(N, "Volt DC")
    header = '"Index","Reading","Unit","Value","Unit","Relative Time"'
    record = loop(tmp_path, header, np.arange(1, N + 1), 1e-4 * Y, units[0], 3 * U, units[1], 0.1 * np.arange(N))
    is_pair(record, 3 * U, 1e-4 * Y)
    assert (record.u_unit[:4], record.y_unit[:3]) == ("Volt", "Amp")


@pytest.mark.parametrize(
    ("header", "clock"), [("millis,pwm,current_mA,raw,mT", "ms"), ("micros,pwm,current_mA,raw,mT", "us")]
)
def test_clocks_and_bare_units_of_loggers(header: str, clock: str, tmp_path: Path) -> None:
    counts = np.round(512 + 300 * Y)
    columns = (20 * np.arange(N), np.round(127 + 120 * U), 500 * U, counts, 40 * Y)
    record = loop(tmp_path, header, *columns)
    is_pair(record, 500 * U, 40 * Y)
    assert (record.t_unit, record.y_unit) == (clock, "mT")


def test_numbers_that_are_cut_off_are_no_noise(tmp_path: Path) -> None:
    """A voltage of three decimals, and the current that it drives with more digits."""
    volts = np.round(3 * np.sin(np.linspace(0, 4 * np.pi, 300)), 3)
    current = np.round(1e-4 * volts + 2e-5 * np.tanh(2 * volts - np.cos(np.linspace(0, 4 * np.pi, 300))), 12)
    is_pair(loop(tmp_path, "V (V),I (A)", volts, current), volts, current)
    assert roughness(volts) == 0.0
    assert roughness(volts + 0.01 * RNG.normal(size=300)) > 1e-3


def test_a_quality_factor_beside_a_capacitance_is_no_charge(tmp_path: Path) -> None:
    columns = (5 * U, 120 - 30 * Y, 1e5 + 1e3 * NOISE, 30 + NOISE[::-1])
    is_pair(loop(tmp_path, "BIAS(V)  Cp(pF)  Rp(ohm)  Q", *columns, mark=" "), 5 * U, 120 - 30 * Y)


def test_an_oxide_is_no_number() -> None:
    assert column_quantity("NO2_ppb") == column_quantity("NOx") == ""
    assert column_quantity("No") == column_quantity("Point No") == "index"


def test_a_refractive_index_is_no_number_of_rows(tmp_path: Path) -> None:
    celsius = np.round(50 - 30 * U, 1)
    columns = (celsius, celsius + 0.05 * NOISE, 1.5 - 1e-3 * Y, 3.1 + 0.01 * NOISE[::-1])
    record = loop(tmp_path, "Setpoint T (°C),Actual T (°C),n (-),Power (mW)", *columns)
    is_pair(record, columns[1], columns[2])


def test_lines_of_words_between_two_loops_begin_a_section(tmp_path: Path) -> None:
    rows = lambda *columns: "".join(" ".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))
    head = "@Date: 12 Mar 2018\n@@Columns\n@Column 0: Applied Field [Oe]\n@Column 1: Signal X direction [emu]\n@@END Columns\n"
    section = "@@Data\nNew Section: Section {}\n{}@@END Data.\n"
    path = tmp_path / "film.VHD"
    path.write_text(head + section.format(0, rows(5000 * U, Y)) + section.format(1, rows(9000 * U, 2 * Y)))
    data = read(path)
    assert len(data) == 2
    for record, size in zip(data, (5000, 9000), strict=True):
        is_pair(record, size * U, Y if size == 5000 else 2 * Y)


def test_messages_in_a_record_whose_clock_goes_on_begin_nothing(tmp_path: Path) -> None:
    lines = [f"{0.1 * k:.1f},{a},{b}" for k, (a, b) in enumerate(zip(U, Y, strict=True))]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t (s),V (V),x (um)", *lines[:50], "INFO gain changed", "INFO ready", *lines[50:]]))
    record = read(path)
    assert isinstance(record, Record)
    is_pair(record, U, Y)


@pytest.mark.parametrize("names", ["# H (A/m)  B (T)\n", "H (A/m)  B (T)\n"])
def test_comments_that_differ_in_their_numbers_begin_loops(names: str, tmp_path: Path) -> None:
    rows = lambda size: "".join(f"{size * a:.3f}  {b}\n" for a, b in zip(U, Y, strict=True))
    text = "".join(f"# loop at Hmax = {size} A/m\n{rows(size)}" for size in (50, 100, 200))
    (tmp_path / "ring.txt").write_text(f"# ring core\n{names}{text}")
    data = read(tmp_path / "ring.txt")
    assert len(data) == 3
    for record, size in zip(data, (50, 100, 200), strict=True):
        is_pair(record, np.round(size * U, 3), Y)
        assert (record.u_unit, record.y_unit) == ("A/m", "T")


def test_comments_in_a_record_whose_clock_goes_on_begin_nothing(tmp_path: Path) -> None:
    lines = [f"{0.1 * k:.1f},{a},{b}" for k, (a, b) in enumerate(zip(U, Y, strict=True))]
    rows = ["# saved at 10:20", "t (s),V (V),x (um)", *lines[:50], "# saved at 10:25", *lines[50:]]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    record = read(tmp_path / "log.csv")
    assert isinstance(record, Record)
    is_pair(record, U, Y)
