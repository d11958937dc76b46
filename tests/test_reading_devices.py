"""Tables of robots, controllers, test benches, soil columns and simulators: clocks, rows in turn, branches and headers of their kind."""

from __future__ import annotations

import datetime
import io
import json
import pickle
from pathlib import Path

import numpy as np
import openpyxl
import pytest
import scipy.io

from hystfit.data import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Severity
from hystfit.params.units import conversion
from hystfit.reading import read
from hystfit.reading.names.column_names import column_quantity

from .loop_files import N, U, Y, is_pair, one, rows, written

RISE = np.round(np.linspace(0, 90, 10), 1)


# Clocks --------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "digits"), [(10**9, 19), (10**6, 16)], ids=["ns", "us"])
def test_whole_numbers_since_1970_without_a_unit_are_a_time(factor: int, digits: int, tmp_path: Path) -> None:
    clock = [1_571_040_302 * factor + k * factor // 100 for k in range(N)]
    assert len(str(clock[0])) == digits
    record = one(tmp_path, "%time,position,effort\n" + rows(",", np.array(clock), U, Y))
    is_pair(record)
    assert record.t is not None
    unit = {"s": 1.0, "us": 1e-6}[record.t_unit]
    np.testing.assert_allclose((record.t - record.t[0]) * unit, 0.01 * np.arange(N), atol=1e-9)


@pytest.mark.parametrize("form", ["%d-%b-%Y %H:%M:%S", "%d*%m*%Y %I:%M:%S %p", "%d %b %y %H:%M:%S"])
def test_dates_with_names_of_months_and_asterisks(form: str, tmp_path: Path) -> None:
    start = datetime.datetime(2019, 5, 28, 11, 59, 30)
    stamps = np.array([f"{start + datetime.timedelta(seconds=20 * k):{form}}" for k in range(N)])
    record = one(tmp_path, "Timestamp,Voltage (V),Stroke (um)\n" + rows(",", stamps, U, Y))
    is_pair(record)
    np.testing.assert_array_equal(record.t, 20.0 * np.arange(N))


# Rows in turn, and words that tell records or units -----------------------------------------------------------------------------


def test_objects_that_take_turns_are_a_record_each(tmp_path: Path) -> None:
    lines = [
        f"{k / 100:.2f},{joint},{(1 + j) * U[k]},{(2 - j) * Y[k]}"
        for k in range(N)
        for j, joint in enumerate(("hip", "knee"))
    ]
    data = read(written(tmp_path, "\n".join(["time,joint,position,effort", *lines]), "joints.csv"))
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == ["hip", "knee"]
    for j, record in enumerate(data):
        is_pair(record, (1 + j) * U, (2 - j) * Y)
        np.testing.assert_allclose(record.t, np.arange(N) / 100)
        assert not any("'joint' (such as" in note.text for note in record.notes)


def test_a_column_states_the_unit_of_another(tmp_path: Path) -> None:
    head = "run_id,pressure_units,loading_units,pressure,loading,uncertainty\n"
    run, pressure, loading = (np.full(N, word) for word in ("1", "kPa", "mg"))
    record = one(tmp_path, head + rows(",", run, pressure, loading, U, Y, np.arange(N) * 7 % 10))
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("kPa", "mg")


def test_numbers_of_runs_tell_curves_apart(tmp_path: Path) -> None:
    lines = [f"{k},{a * u:.6g},{a * y:.6g}" for k, a in ((1, 1.0), (2, 3.0)) for u, y in zip(U, Y, strict=True)]
    data = read(written(tmp_path, "\n".join(["run_id,pressure,loading", *lines]), "runs.csv"))
    assert isinstance(data, Dataset)
    assert [record.u.size for record in data] == [N, N]


@pytest.mark.parametrize(
    "names", [("q_1", "current_1", "moment_1"), ("q", "moment", "current"), ("Position", "Current", "Torque")]
)
def test_targets_of_a_robot_are_no_measurements(names: tuple[str, str, str], tmp_path: Path) -> None:
    """What the controller computes ahead follows from the position without hysteresis; the position that was reached drives."""
    noise = np.random.default_rng(3).standard_normal((3, N))
    q, force = np.round(0.02 * U, 6), np.round(Y + np.sign(np.gradient(U)), 3)
    columns = [0.008 * np.arange(N), q, np.round(q + 1e-4 * noise[0], 6), Y, force, np.round(2 * Y, 3)]
    mark = "_" if names[0].islower() else ""
    part, other, ahead = names
    header = ["timestamp", f"target{mark}{part}", f"actual{mark}{part}"]
    header += [f"target{mark}{other}", f"actual{mark}{other}", f"target{mark}{ahead}"]
    record = one(tmp_path, ",".join(header) + "\n" + rows(",", *columns))
    assert (record.u_name, record.y_name) == (header[2], header[4])


def test_a_load_that_is_controlled_drives_the_angle(tmp_path: Path) -> None:
    """The angle beside a torque that is commanded and measured."""
    torque = np.round(0.1 * U, 4)
    measured = np.round(torque + 0.002 * np.random.default_rng(4).standard_normal(N), 4)
    text = "target_torque(Nm),angle(deg),actual_torque(Nm)\n" + rows(",", torque, Y, measured)
    is_pair(one(tmp_path, text), measured, Y)


@pytest.mark.parametrize(
    ("header", "order"),
    [
        ("Time[s],Volume[uL],Left CA[deg],Right CA[deg],Baseline[mm]", "tuynd"),  # two sides of a drop
        (
            "Time,Current (A),Output Voltage (V),B-Field (T),H-Field (A/m)",
            "tcvyu",
        ),  # of a generator, and the two fields
        ("Time [min],dm (%) - dry,Target % P/Po,Actual % P/Po,Temp [C],Mass [mg]", "tzsudy"),  # vapor sorption
        ("alpha_deg,sense,C_L,C_D", "uwyn"),  # coefficients of a wing
        ("AoA,CL,CD,CM", "uynz"),
        ("Alfa,Cl,Cdp,Cm", "uynz"),
        ("Process,pF [-],Tension [hPa],Water Content [Vol%]", "wusy"),  # suction in soil
        ("weight_g,R_kohm", "uy"),
        ("Time (s),Pressure (mmHg),Outer diameter (um),Axial force (g)", "tuyn"),  # a vessel
        ("LIC101.SP,LIC101.PV,LIC101.OUT", "dyu"),  # tags of process control
        ("LIC-7/SP,LIC-7/PV,LIC-7/OUT", "dyu"),
        ("frame,V_rms,CA_left_deg,CA_right_deg,base_mm", "kuynz"),  # electrowetting
        ("t,HV [kV],stretch [-],leak [uA]", "tuyn"),
        ("Pc [kPa],Sw [-]", "uy"),
        ("input_angle_deg,output_angle_deg,torque_Nm", "uyn"),  # of a gear
        ("pH,Vout_mV,T_degC", "uyd"),
        ("vpd,sapf,ta,sw_in", "uydn"),  # a tree
        ("exx,eyy,Stress (MPa)", "puy"),  # the strain across the load
        ("H (kOe),B (kG),Bi (kG)", "ucz"),  # the induction of a magnet follows a straight line
        ("Time(T),Voltage (V),Current (A)", "tuy"),
    ],
)
def test_columns_of_devices_by_their_names(header: str, order: str, tmp_path: Path) -> None:
    """u drives y; c and v are multiples of u with noise; n is a noisy y, s is u rounded or bent, k counts, d and z are others."""
    noise = np.random.default_rng(5).standard_normal((4, N))
    up = np.where(np.gradient(U) > 0, "up", "down")
    bent = np.round(10 ** (U / 20), 2) if "Tension" in header else np.round(U)
    columns = {
        "t": np.arange(N), "k": np.arange(1, N + 1), "u": U, "y": Y, "p": -0.45 * U + 0.02 * noise[3],
        "c": 0.02 * U + 1e-4 * noise[0], "v": 3 * U, "n": Y + 0.05 * noise[1], "s": bent,
        "d": 25 + 0.01 * noise[2], "z": 10 + 0.1 * Y, "w": up,
    }  # fmt: skip
    y = columns["c"] if "c" in order[:2] and "y" not in order else Y
    is_pair(one(tmp_path, header + "\n" + rows(",", *(columns[letter] for letter in order))), y=y)


def test_the_measurement_of_what_was_set_drives_beside_it(tmp_path: Path) -> None:
    set_values = np.append(RISE, RISE[-2::-1])
    noise = np.random.default_rng(6).standard_normal((2, set_values.size))
    measured, y = np.round(set_values + 0.3 * noise[0], 3), np.round(np.tanh(set_values / 30) + 0.01 * noise[1], 4)
    text = "Temperature (K),Min. Temperature (K),Moment (emu)\n" + rows(",", measured, set_values, y)
    is_pair(one(tmp_path, text), measured, y)


def test_the_name_of_a_first_column_below_the_units(tmp_path: Path) -> None:
    """As pandas writes columns of two levels and an index."""
    text = "sensor,LVDT,LoadCell\nunit,mm,kN\ntime,,\n" + rows(",", 0.1 * np.arange(N), U, Y)
    record = one(tmp_path, text)
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("mm", "kN")
    np.testing.assert_allclose(record.t, 0.1 * np.arange(N))


def test_terminals_of_a_transistor_are_one_experiment(tmp_path: Path) -> None:
    rise, noise = np.linspace(0, 90, 31), np.random.default_rng(7).standard_normal((2, 61))
    gate = np.append(rise, rise[-2::-1])
    drain = np.round(np.tanh(gate / 30) + 0.01 * noise[0], 4)
    text = "DrainI,DrainV,GateI,GateV\n" + rows(",", drain, np.full(gate.size, 0.05), 1e-9 * noise[1], gate)
    is_pair(one(tmp_path, text), gate, drain)


def test_a_load_that_was_held_at_every_level_drives_the_settlement(tmp_path: Path) -> None:
    load = np.repeat([0, 50, 100, 150, 200, 150, 100, 50, 0, 100, 200, 300, 400, 300, 200, 100, 0], 6)
    settlement = np.round(0.03 * load + 0.3 * np.sin(0.7 * np.arange(load.size)), 3)
    is_pair(one(tmp_path, "Load (kN),Settlement (mm)\n" + rows(",", load, settlement)), load, settlement)


def test_pulses_of_a_current_do_not_drive_a_cell(tmp_path: Path) -> None:
    """A titration: pulses of charge and rests, up and down; the charge that passed drives the voltage."""
    pulse = np.tile(np.repeat([1.0, 0.0], 6), 10)
    current = np.concatenate([pulse, -pulse])
    charge = np.round(np.cumsum(current) * 0.01, 4)
    voltage = np.round(3.3 + 0.4 * charge + 0.02 * current, 4)
    text = "Test_Time(s),Current(A),Voltage(V),Capacity(Ah)\n"
    is_pair(one(tmp_path, text + rows(",", 60 * np.arange(current.size), current, voltage, charge)), charge, voltage)


def test_a_log_of_changes_has_no_set_values(tmp_path: Path) -> None:
    """A room that a flow of water warms: a row whenever the temperature has changed by its last digit, at uneven times."""
    room = np.append(np.arange(19.0, 21.05, 0.1), np.arange(20.9, 18.95, -0.1)).round(1)
    time = np.cumsum(60 * (1 + np.arange(room.size) % 5 * (np.arange(room.size) % 3)))
    flow = np.round(1000 + 300 * np.cos(np.arange(room.size) / 7) + 5 * np.sin(np.arange(room.size)), 1)
    text = "time (s),Flow (L/min),Room temperature (degC)\n" + rows(",", time, flow, room)
    is_pair(one(tmp_path, text), flow, room)


def test_a_measurement_of_few_digits_was_not_set(tmp_path: Path) -> None:
    """A sensor of one step in 0.1 mm stays for some samples and moves by one step up or down."""
    phase = np.linspace(0, 4 * np.pi, 400)
    u = np.round(50 + 30 * np.sin(phase) + 0.02 * np.cos(np.arange(400)), 3)
    y = np.round(2 * np.sin(phase - 0.2), 1)
    is_pair(one(tmp_path, "Voltage (V),Position (mm)\n" + rows(",", u, y)), u, y)


def test_groups_at_conditions_that_share_a_time_are_records(tmp_path: Path) -> None:
    columns = (0.1 * np.arange(N), U, Y, 2 * U, 3 * Y)
    data = read(written(tmp_path, "t (s),V_1Hz (V),x_1Hz (um),V_5Hz (V),x_5Hz (um)\n" + rows(",", *columns), "a.csv"))
    assert [record.name for record in data] == ["1Hz", "5Hz"]
    is_pair(data[1], 2 * U, 3 * Y)
    np.testing.assert_allclose(data[1].t, columns[0])
    channels = "t (s),V_left (V),x_left (um),V_right (V),x_right (um)\n"
    assert isinstance(read(written(tmp_path, channels + rows(",", *columns), "b.csv")), Record)


@pytest.mark.parametrize(
    "names", ["voltage_V,position_mm", "output (mV),applied force (N)", "sensor voltage [V],pressure [bar]"]
)
def test_what_was_set_by_equal_steps_drives_the_voltage_of_its_sensor(names: str, tmp_path: Path) -> None:
    """A voltage that was set drives an actuator; beside a position that was set it is a measurement."""
    set_values = np.append(RISE, RISE[-2::-1])
    measured = np.round(0.02 * set_values + 0.01 * np.sin(np.arange(set_values.size)), 4)
    first, second = names.split(",")
    is_pair(one(tmp_path, f"{first},{second}\n" + rows(",", measured, set_values)), set_values, measured)
    is_pair(one(tmp_path, "voltage_V,position_mm\n" + rows(",", set_values, measured), "b.csv"), set_values, measured)


@pytest.mark.parametrize("cycles", [3, 4])  # of three the displacement goes by equal steps too
def test_a_force_beside_displacement_and_velocity_answers_by_equal_steps_too(cycles: int, tmp_path: Path) -> None:
    """A damper under triangles of growing size: its simulated force is a straight line along each branch, as a load that is set."""
    cycle = np.arange(200 * cycles) / 200
    x = np.round((0.2 + 0.8 * (cycle // 1) / (cycles - 1)) * (1 - 2 * np.abs(2 * ((cycle + 0.25) % 1) - 1)), 7)
    v = np.gradient(x)
    a = np.round(np.gradient(v) + 0.001 * np.random.default_rng(0).normal(size=x.size), 6)
    force = np.round(750 * np.tanh(v / 0.002) + 100 * x, 4)
    for names, more in (("t,V,D,F", ()), ("t,A,V,D,F", (a,))):
        columns = (0.001 * np.arange(x.size), *more, np.round(v, 6), x, force)
        is_pair(one(tmp_path, f"{names}\n" + rows(",", *columns)), x, force)


def test_words_glued_to_names_name_loops_side_by_side(tmp_path: Path) -> None:
    for names, titles in (
        ("vxSteel,vySteel,vxIron,vyIron", ["Steel", "Iron"]),
        ("H_0.5T,m_0.5T,H_1.5T,m_1.5T", ["0.5T", "1.5T"]),
    ):
        data = read(written(tmp_path, f"{names}\n" + rows(",", U, Y, 2 * U, 3 * Y), "loops.csv"))
        assert [record.name for record in data] == titles
        is_pair(data[1], 2 * U, 3 * Y)


def test_a_unit_in_the_cells_of_some_rows_loses_no_row(tmp_path: Path) -> None:
    """The change from the way up in percent, which only the way down has."""
    half = N // 2
    lines = [f"{u},{y},{'' if k < half else f'{0.1 * k - 5:.1f}%'}" for k, (u, y) in enumerate(zip(U, Y, strict=True))]
    is_pair(one(tmp_path, "\n".join(["strain,stress,change", *lines])))


def test_tables_without_titles_whose_clock_goes_on_are_one_record(tmp_path: Path) -> None:
    """Up, hold and down of a rheometer, each below its own header; another clock in each leaves them apart."""
    thirds = np.array_split(np.arange(N), 3)

    def text(start: float) -> str:
        lines = []
        for k, part in enumerate(thirds):
            lines += [f"Interval:\t{k + 1}\t{part.size}", "Time\tShear Rate\tShear Stress", "[s]\t[1/s]\t[Pa]"]
            lines += [f"{j - start * part[0]}\t{U[j]}\t{Y[j]}" for j in part] + [""]
        return "\n".join(lines)

    is_pair(one(tmp_path, text(0.0), "a.txt"))
    assert len(read(written(tmp_path, text(1.0), "b.txt"))) == 3


def test_the_output_of_a_controller_drives_the_process(tmp_path: Path) -> None:
    is_pair(one(tmp_path, "FIC101.SP,FIC101.PV,FIC101.OP\n" + rows(",", np.full(N, 50), Y, U)))


# Branches ------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        ("Sorption", "Desorption"),
        ("theta_drying", "theta_wetting"),
        ("Load1", "Unload1"),
        ("Anzeige steigend in mV", "Anzeige fallend in mV"),
        ("Sortie croissante (mA)", "Sortie décroissante (mA)"),
    ],
    ids=lambda pair: pair[0],
)
def test_branches_over_one_input(words: tuple[str, str], tmp_path: Path) -> None:
    up, down = np.round(RISE**1.3, 2), np.round(RISE**1.3 + 9 * np.sin(np.pi * RISE / 90), 2)
    record = one(tmp_path, f"x,{','.join(words)}\n" + rows(",", RISE, up, down))
    is_pair(record, np.r_[RISE, RISE[::-1]], np.r_[up, down[::-1]])


def test_cycles_side_by_side_over_one_input(tmp_path: Path) -> None:
    up = [np.round(421.5 * RISE + 3 * k, 1) for k in range(3)]
    down = [np.round(one + 900 * np.sin(np.pi * RISE / 90), 1) for one in up]
    names = ",".join(f"Load{k},Unload{k}" for k in (1, 2, 3))
    columns = [column for pair in zip(up, down, strict=True) for column in pair]
    record = one(tmp_path, f"Weight(g),{names}\n" + rows(",", RISE, *columns))
    is_pair(
        record,
        np.tile(np.r_[RISE, RISE[::-1]], 3),
        np.concatenate([np.r_[a, b[::-1]] for a, b in zip(up, down, strict=True)]),
    )
    two = one(tmp_path, "Weight(g),Load1,Unload1,Load2,Unload2\n" + rows(",", RISE, *columns[:4]), "two.csv")
    is_pair(two, record.u[:40], record.y[:40])


@pytest.mark.parametrize("way", [1, -1], ids=["upward", "downward"])
def test_sheets_named_as_branches_are_one_loop(way: int, tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.title = "Info"
    up, down = RISE**1.3, (RISE**1.3 + 9 * np.sin(np.pi * RISE / 90))[::-1]
    for title, u, y in (("Adsorption", RISE, up), ("Desorption", RISE[::-1][::way], down[::way])):
        sheet = book.create_sheet(title)
        for row in [["p (kPa)", "Loading (mg)"], *np.column_stack([u, y]).tolist()]:
            sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    is_pair(one(tmp_path, stream.getvalue(), "isotherm.xlsx"), np.r_[RISE, RISE[::-1]], np.r_[up, down])


# Headers -------------------------------------------------------------------------------------------------------------------------


def test_titles_of_channels_and_units_of_some(tmp_path: Path) -> None:
    head = [
        "Interval=\t0.010 s",
        "TimeFormat=\tStartOfBlock",
        "ChannelTitle=\tECG\tPressure\tVolume",
        "Range=\t10.000 V\t200.0 mmHg\t200.0 mL",
    ]
    head += ["UnitName=\t*\tmmHg\tmL", "TopValue=\t*\t210\t220", "BottomValue=\t*\t-10\t-5"]
    ecg = np.round(np.cos(9.0 * np.arange(N)), 4)
    clock = [f"{432 + 0.01 * k:.2f}" for k in range(N)]
    record = one(tmp_path, "\r\n".join(head) + "\r\n" + rows("\t", np.array(clock), ecg, U, Y), "heart.txt")
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("mmHg", "mL")
    np.testing.assert_allclose(record.t, 432 + 0.01 * np.arange(N))


def test_columns_numbered_in_words(tmp_path: Path) -> None:
    names = [
        "first column: time",
        "2 column: 1th component of the strain (EXX)",
        "3 column: 1th component of the stress (SXX)",
    ]
    names += ["4 column: EquivalentPlasticStrain (p)"]
    plastic = np.round(np.cumsum(np.abs(np.gradient(U))), 4)
    record = one(
        tmp_path, "".join(f"# {name}\n" for name in names) + rows(" ", 0.5 * np.arange(N), U, Y, plastic), "test.res"
    )
    is_pair(record)
    assert record.u_name == "1th component of the strain (EXX)"
    np.testing.assert_allclose(record.t, 0.5 * np.arange(N))


def test_formats_below_the_names_are_no_units(tmp_path: Path) -> None:
    head = "# gauge\n#\nagency\tdischarge\tdischarge_cd\tstage\tstage_cd\n5s\t14n\t10s\t14n\t10s\n"
    record = one(tmp_path, head + "".join(f"USGS\t{u}\tA\t{y}\tA\n" for u, y in zip(U, Y, strict=True)), "river.rdb")
    is_pair(record)
    assert (record.u_name, record.u_unit, record.y_unit) == ("discharge", "", "")


def test_currents_of_elements_beside_resistances(tmp_path: Path) -> None:
    head = "time\tV(pre)\tR1\tIx(U1:TE)\n"
    record = one(tmp_path, head + rows("\t", 0.1 * np.arange(N), U, np.round(U / Y, 6), Y), "memristor.txt")
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("V", "A")


def test_symbols_in_brackets_are_no_units(tmp_path: Path) -> None:
    head = "strain (EXX),strain (EYY),stress (SXX)\n"
    record = one(tmp_path, head + rows(",", U, np.round(-0.3 * U, 4), Y))
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("", "")


def test_names_behind_a_word_and_a_row_of_tabs_above_the_units(tmp_path: Path) -> None:
    head = [
        "Test:\tWave 1",
        "",
        "Interval data:\tPoint No.\tTime\tShear Strain\tShear Stress",
        "\t\t\t\t",
        "\t\t[s]\t[1]\t[Pa]",
        "",
    ]
    body = "".join(f"\t{k + 1}\t{0.01 * k:.2f}\t{u}\t{y}\n" for k, (u, y) in enumerate(zip(U, Y, strict=True)))
    record = one(tmp_path, "\n".join(head) + "\n" + body, "wave.txt")
    is_pair(record)
    assert (record.u_name, record.y_unit) == ("Shear Strain", "Pa")


def test_a_row_that_has_only_the_time_at_which_a_report_begins(tmp_path: Path) -> None:
    head = "Isotherm Tabular Report,,\nPressure (kPa),Quantity Adsorbed (mg),Elapsed Time (h:min)\n,,00:54\n"
    record = one(
        tmp_path, head + "".join(f"{u},{y},01:{k % 60:02d}\n" for k, (u, y) in enumerate(zip(U, Y, strict=True)))
    )
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("kPa", "mg")


def test_names_above_a_blank_line_and_the_abscissa_of_a_report(tmp_path: Path) -> None:
    head = "\n            X              U2 PI: TOP N: 12     RF2 PI: TOP N: 12\n\n"
    record = one(tmp_path, head + rows("   ", np.round(np.linspace(0, 1, N), 4), U, Y), "abaqus.rpt")
    is_pair(record)
    assert (record.u_name, record.y_name) == ("U2 PI: TOP N: 12", "RF2 PI: TOP N: 12")
    np.testing.assert_allclose(record.t, np.round(np.linspace(0, 1, N), 4))


# Columns -------------------------------------------------------------------------------------------------------------------------


def test_the_way_in_is_no_inch(tmp_path: Path) -> None:
    for name, unit in (("sw_in", ""), ("stroke_in", "in"), ("x_in", "in")):
        assert one(tmp_path, f"{name},Force (kN)\n" + rows(",", U, Y)).u_unit == unit
    assert one(tmp_path, "vpd_kPa,flow_cm3_cm2_h\n" + rows(",", U, Y)).y_unit == "cm3/cm2/h"


def test_a_counter_without_a_name_drives_nothing(tmp_path: Path) -> None:
    lines = "\t[s]\t[1]\t[Pa]\n" + "".join(
        f"{k + 1}\t{0.1 * k:.1f}\t{u}\t{y}\n" for k, (u, y) in enumerate(zip(U, Y, strict=True))
    )
    is_pair(one(tmp_path, lines, "points.txt"))


def test_angles_and_torques_of_the_joints_of_a_robot(tmp_path: Path) -> None:
    still = np.round(0.3 + 1e-5 * np.cos(7.0 * np.arange(N)), 6)
    clock = 0.008 * np.arange(N)
    for torque in ("target_moment", "tau"):
        head = f"timestamp actual_q_0 actual_q_1 {torque}_0 {torque}_1\n"
        record = one(tmp_path, head + rows(" ", np.round(clock, 3), still, U, np.round(12 + still, 6), Y), "robot.csv")
        is_pair(record)


def test_a_column_that_follows_the_direction_is_no_condition(tmp_path: Path) -> None:
    u = np.r_[np.linspace(0, 1.5, 120), np.linspace(1.5, 0, 120)].round(4)
    current = np.where(np.arange(240) < 120, 0.15, -0.15)
    record = one(tmp_path, "Ah[Ah],U[V],I[A]\n" + rows(",", u, np.round(3.2 + 0.4 * u + 0.3 * current, 4), current))
    np.testing.assert_array_equal(record.u, u)
    assert not any("levels" in note.text for note in record.notes)


def test_texts_name_the_columns_of_a_matrix(tmp_path: Path) -> None:
    names = np.array(["Time (s)", "LVDT (mm)", "Load (kN)"], dtype=object)
    scipy.io.savemat(tmp_path / "wall.mat", {"data": np.column_stack([0.1 * np.arange(N), U, Y]), "channels": names})
    record = read(tmp_path / "wall.mat")
    assert isinstance(record, Record)
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("mm", "kN")


def test_a_pickle_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="a pickle of Python"):
        read(written(tmp_path, pickle.dumps({"u": 1}, protocol=4), "loop.pkl"))


def test_pressures_by_their_letter() -> None:
    assert [column_quantity(name) for name in ("p (kPa)", "P [bar]", "p (kN)")] == ["pressure", "pressure", "force"]


@pytest.mark.parametrize(
    ("header", "pair"),
    [
        ("Shear Rate [1/s],Shear Stress [Pa],Viscosity [Pa·s],Torque [µNm]", (0, 1)),  # thixotropy
        ("lambda_11,lambda_22,P11_kPa,Temp_C", (0, 2)),  # stretches of tissue
        ("ShearStress(kPa),ShearStrain(%),NormalStress(kPa),VertStrain(%)", (1, 0)),
        ("Vert_Force_kN,Hor_Force_X_kN,Hor_Force_Y_kN,Disp_X_mm,Disp_Y_mm", (3, 1)),
        ("input_shaft_deg,output_shaft_deg,input_torque_Nm", (0, 1)),
        ("Axial Strain (%),Mean Stress (kPa),Deviator Stress (kPa),Eff. Axial Stress (kPa)", (0, 2)),
        ("Valve Position (%),Flow Rate (GPM),Ambient Temp (C)", (0, 1)),
        ("Stage (m),Discharge (m3/s)", (0, 1)),
        ("vwc_m3m3,matric_potential_kPa,soil_temp_C", (1, 0)),
        ("J1_pos,J2_pos,J1_trq,J2_trq", (0, 2)),
        ("slip_ratio,sinkage_mm,drawbar_pull_N,torque_Nm", (0, 2)),
    ],
)
def test_columns_beside_each_other_in_tables_of_devices(header: str, pair: tuple[int, int], tmp_path: Path) -> None:
    names = header.split(",")
    others = {k: np.round(5 + 0.1 * U**0.5 + 0.01 * (k + 1) * Y, 4) for k in range(len(names))}
    table = rows(",", *({**others, pair[0]: U, pair[1]: Y}[k] for k in range(len(names))))
    record = one(tmp_path, f"{header}\n{table}")
    is_pair(record)
    assert (record.u_name, record.y_name) == (names[pair[0]], names[pair[1]])


@pytest.mark.parametrize("names", [["q1_mm", "tip_x_mm", "tip_y_mm"], ["Fx (N)", "Fy (N)", "Fz (N)", "Mx (Nm)"]])
def test_of_columns_of_one_quantity_the_user_chooses(names: list[str], tmp_path: Path) -> None:
    columns = (np.round(U + k * Y**0.5, 3) for k in range(len(names)))
    with pytest.raises(DataError, match="nothing in the file tells"):
        one(tmp_path, ",".join(names) + "\n" + rows(",", *columns))


def test_variables_of_a_plot_file(tmp_path: Path) -> None:
    head = 'variables = "time" "alpha" "CL" "CM"\nzone t="run 12"\n'
    record = one(tmp_path, head + rows(" ", 0.1 * np.arange(N), U, Y, np.round(0.2 * U**0.5, 4)), "stall.dat")
    is_pair(record)
    assert (record.u_name, record.y_name) == ("alpha", "CL")


def test_a_flow_is_the_rate_of_a_volume(tmp_path: Path) -> None:
    record = one(tmp_path, "Paw_cmH2O,Flow_L_s,Volume_L\n" + rows(",", U, np.round(np.gradient(Y), 4), Y))
    is_pair(record)


def test_a_monitor_counts_less_only_beside_the_quantity_itself(tmp_path: Path) -> None:
    rate = np.round(np.gradient(U), 3)
    is_pair(one(tmp_path, "HV monitor [kV],Current [uA],Laser [um]\n" + rows(",", U, rate, Y)))
    is_pair(one(tmp_path, "HV monitor [kV],HV [kV],Laser [um]\n" + rows(",", U + 0.3 * rate, U, Y)))


def test_what_a_controller_reached_has_words_of_its_own(tmp_path: Path) -> None:
    noisy = np.round(U + 0.01 * np.random.default_rng(4).standard_normal(N), 3)
    is_pair(one(tmp_path, "P_des_bar,P_meas_bar,Length_mm\n" + rows(",", U, noisy, Y)), u=noisy)


def test_names_of_units_in_columns(tmp_path: Path) -> None:
    record = one(tmp_path, "millis,angle_deg,moment_Nm_kg\n" + rows(",", 7 * np.arange(N), U, Y))
    is_pair(record)
    assert (record.t_unit, record.y_unit) == ("ms", "Nm/kg")
    force = one(tmp_path, "Force,Distance,Time\ng,mm,sec\n" + rows(",", Y, U, 0.1 * np.arange(N)))
    is_pair(force)
    flow = one(tmp_path, "SSC_mgL,Q_cms\n" + rows(",", Y, U))
    assert (flow.u_unit, flow.y_name) == ("m3/s", "SSC_mgL")  # the discharge drives the sediment
    assert column_quantity("P_11") == column_quantity("P")
    assert column_quantity("Ta_C") == "temperature"


def test_a_table_of_a_dynamometer(tmp_path: Path) -> None:
    """Names of which one has a bracket, and units under all but the first."""
    head = "Side: Right\nmSec  TORQUE  POSITION  POS (ANAT)  VELOCITY\n       N-M     DEGREES   DEGREES   DEG/SEC\n"
    record = one(tmp_path, head + rows("  ", 10 * np.arange(N), Y, U, U + 90, np.round(np.gradient(U), 2)), "test.txt")
    is_pair(record)
    assert (record.u_unit, record.y_unit, record.t_unit) == ("DEGREES", "", "ms")


def test_points_of_a_calibration_with_their_durations(tmp_path: Path) -> None:
    """A duration in seconds goes up and down, and is no clock; deviations of counts are no answer."""
    names = "index,reference_force_n,raw_adc_mean,raw_adc_stddev,sample_count,duration_s,residual_force_n"
    noise = np.round(np.random.default_rng(5).uniform(1, 2, (3, N)), 4)
    columns = (np.arange(1, N + 1), U, Y, noise[0], 120 + 0 * U, 12 + noise[1], noise[2])
    record = one(tmp_path, f"{names}\n{rows(',', *columns)}\n\nconstexpr float Slope = 0.00226f;\n")
    is_pair(record)
    assert record.t is None


def test_a_header_with_rows_of_settings_is_no_table(tmp_path: Path) -> None:
    """The calibration of channels and the protocol above the data of a muscle lever."""
    head = (
        "Sample Frequency (Hz): 100\nCalibration Data:\nChannel\tAI0\tAI1\nUnits\tmm\tmN\nScale (units/V)\t0.5\t50.0\n"
    )
    head += "Offset (volts)\t0.0\t0.0\nTADs\t0\t0\n\n*** Protocol ***\nTime (ms)\tControl Function\tOptions\n0.0\tSine\t1 Hz\n\n"
    record = one(
        tmp_path, f"{head}Test Data in Volts:\nSample\tAI0\tAI1\n" + rows("\t", np.arange(N), U, Y), "work.ddf"
    )
    is_pair(record, u=0.5 * U, y=50 * Y)
    assert record.t is not None
    np.testing.assert_allclose(record.t, 0.01 * np.arange(N))


@pytest.mark.parametrize("names", ["y (mm),p (kN/m)", "y (mm),F (kN)", "Drift (mm),v (kN/m)"])
def test_forces_per_length_resist_a_displacement(names: str, tmp_path: Path) -> None:
    is_pair(one(tmp_path, f"{names}\n" + rows(",", U, Y)))


def test_flows_and_years(tmp_path: Path) -> None:
    record = one(tmp_path, "year,Q_m3s,SSC\n" + rows(",", 1960 + np.arange(N), U, Y))
    is_pair(record)
    assert (record.u_name, record.u_unit, record.t_unit) == ("Q_m3s", "m3/s", "year")


def test_records_within_the_points_of_an_isotherm(tmp_path: Path) -> None:
    points = [
        {"pressure": u, "species_data": [{"gas": "N2", "adsorption": y}]}
        for u, y in zip(U.tolist(), Y.tolist(), strict=True)
    ]
    is_pair(one(tmp_path, json.dumps({"adsorbent": {"name": "MIL-101"}, "isotherm_data": points}), "isotherm.json"))


# Factors of units ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("zeros", "units", "scales"), [("0.0", ("mm", "mN"), (0.5, 500.0)), ("1.5", ("V", "V"), (1.0, 1.0))]
)
def test_channels_in_volts_have_the_scales_that_the_header_states(zeros, units, scales, tmp_path: Path) -> None:
    """Where it states zeros of the sensors too, the volts stay."""
    header = f"DMC Data File\nChannel\tAI0\tAI1\nUnits\tmm\tmN\nScale (units/V)\t0.5\t500.0\nOffset (volts)\t0.0\t{zeros}\n\n"
    record = one(
        tmp_path, header + "Test Data in Volts:\nSample\tAI0\tAI1\n" + rows("\t", np.arange(N), U, Y), "loop.ddf"
    )
    assert (record.u_unit, record.y_unit) == units
    is_pair(record, scales[0] * U, scales[1] * Y)


def test_a_number_before_a_unit_multiplies_the_column(tmp_path: Path) -> None:
    record = one(tmp_path, "Displacement (mm),Force (x100 N)\n" + rows(",", U, Y))
    assert record.y_unit == "N"
    is_pair(record, U, 100 * Y)


def test_the_field_of_a_magnet_drives_beside_its_set_current(tmp_path: Path) -> None:
    """The current goes by equal steps, as what was set does; the field was measured and is proportional to it."""
    current = np.concatenate([np.linspace(8, -8, 81), np.linspace(-8, 8, 81)[1:]])
    field = 50 * current + 0.4 * np.random.default_rng(0).normal(size=current.size)
    rises = np.gradient(current) > 0
    kerr = np.tanh((current - np.where(rises, 1.0, -1.0)) / 2)
    text = "Applied field (kA/m),Intensity (mV),Magnet current (A)\n"
    text += "".join(f"{h:.2f},{y:.5f},{i:.4f}\n" for h, y, i in zip(field, kerr, current, strict=True))
    (tmp_path / "loop.dat").write_text(text, encoding="utf-8")
    record = read(tmp_path / "loop.dat")
    assert (record.u_name, record.u_unit, record.y_unit) == ("Applied field (kA/m)", "kA/m", "mV")


# Names and units as instruments and programs write them ----------------------------------------------------------------------------


def test_a_clock_of_arduino_counts_thousandths(tmp_path: Path) -> None:
    for name in ("Millis", "MILLIS", "timestamp_millis"):
        record = one(tmp_path, f"{name},pos (mm),load (N)\n" + rows(",", 11 * np.arange(N), U, Y))
        assert record.t is not None
        assert conversion(record.t_unit, "s") == pytest.approx(1e-3, rel=1e-12)


@pytest.mark.parametrize("word", ["scaled", "filtered", "left", "raw"])
def test_a_word_in_brackets_is_no_unit(word: str, tmp_path: Path) -> None:
    record = one(tmp_path, f"Stroke ({word}),Load ({word})\n" + rows(",", U, Y))
    is_pair(record)
    assert (record.u_unit, record.y_unit) == ("", "")
    assert one(tmp_path, "Stroke (steps),Load (N)\n" + rows(",", U, Y)).u_unit == "steps"


def test_a_log_of_lammps_names_variables_and_fixes(tmp_path: Path) -> None:
    """f_born is a force of a fix by its mark alone, v_Pz a polarization, and the temperature of a thermostat is held."""
    steps, random = 10 * np.arange(N), np.random.default_rng(3)
    noisy = (300 + 6 * random.standard_normal(N)).round(3)
    columns = steps, 0.002 * steps, noisy, -np.cumsum(Y).round(4), U, Y
    bins = "  binsize = 8, bins = 6 6 7\n"
    content = f"units metal\n{bins}   Step   Time   Temp   f_born   v_efield   v_Pz\n" + rows("   ", *columns)
    record = one(tmp_path, content + "Loop time of 44.2 on 32 procs for 600 steps with 8640 atoms\n", "log.lammps")
    is_pair(record)
    assert not any("bin" in key for key in record.metadata)


def test_groups_of_rows_are_counted(tmp_path: Path) -> None:
    columns = np.arange(N) // 2, np.where(np.arange(N) % 2, 0.0, 1.0), U, Y
    is_pair(one(tmp_path, "attempt,pw,level,response\n" + rows(",", *columns)))


def test_of_a_propeller_the_signal_drives_the_thrust(tmp_path: Path) -> None:
    signal = np.round(1000 + 4 * np.abs(np.linspace(-100, 100, N)))
    torque, current = (
        (0.01 * Y + 0.003 * np.cos(np.arange(N))).round(5),
        (0.1 * Y + 0.02 * np.sin(np.arange(N))).round(4),
    )
    thrust = np.round((signal - 1000) ** 2 / 1e5 + 0.02 * np.gradient(signal), 4)
    head = "Time (s),ESC signal (µs),Torque (N·m),Thrust (kgf),Voltage (V),Current (A)\n"
    others = 0.1 * np.arange(N), signal, torque, thrust, (14.8 - 0.01 * Y).round(3), current
    is_pair(one(tmp_path, head + rows(",", *others)), signal, thrust)


@pytest.mark.parametrize(
    "names",
    [
        ("ta_C", "vpd_kPa", "sapflow_cm3_cm2_h", "par_umol_m2_s"),
        ("Air temp (C)", "VPD (kPa)", "Sap flux density (cm h-1)", "PAR (umol m-2 s-1)"),
    ],
)
def test_sap_flows_while_the_air_is_dry(names: tuple[str, ...], tmp_path: Path) -> None:
    warmth = np.round(18 + U / 5 + 0.2 * np.cos(np.arange(N)), 3)
    content = ",".join(names) + "\n" + rows(",", warmth, U, Y, np.round(9 * U + 3 * Y, 3))
    is_pair(one(tmp_path, content))


def test_a_table_of_results_has_no_loop(tmp_path: Path) -> None:
    names, random = np.array([f"CNF{k}" for k in range(N)]), np.random.default_rng(4)
    classes = [random.integers(1, count, N) for count in (6, 15, 4)]
    table = "specimen,Type,Color,Shade\n" + rows(",", names, *classes)
    with pytest.raises(DataError, match="every row has a 'specimen' of its own"):
        read(written(tmp_path, table, "results.csv"))
    file = written(
        tmp_path, "specimen,diameter (mm),load (kN)\n" + rows(",", names, *random.random((2, N)).round(4)), "s.csv"
    )
    with pytest.raises(DataError, match=r"--input 'diameter \(mm\)' --output 'load \(kN\)' reads them"):
        read(file)
    record = read(file, input="diameter (mm)", output="load (kN)")
    assert isinstance(record, Record)
    assert [note.severity for note in record.notes if "'specimen' of its own" in note.text] == [Severity.WARNING]
    plain = one(tmp_path, "state,stroke (mm),load (kN)\n" + rows(",", np.repeat(["a", "b"], N // 2), U, Y))
    assert not any("of its own" in note.text for note in plain.notes)


def test_a_strain_sensor_under_a_force_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="Strain sensor"):
        read(written(tmp_path, "Force (N),Strain sensor (ue)\n" + rows(",", U, Y), "sensor.csv"))
    is_pair(one(tmp_path, "Load (N),Strain (ue)\n" + rows(",", Y, U)))


@pytest.mark.parametrize("unit", ["Coulombs", "C", "mAh"])
def test_charge_that_starts_again_in_each_state_of_a_cell_drives_its_voltage(tmp_path: Path, unit: str) -> None:
    rows, t = [], 0
    for state, current in (("CHARGE", 2.0), ("DISCHARGE", -2.0), ("CHARGE", 2.0)):
        for k in range(40):
            t += 60
            level = k / 40 if current > 0 else 1 - k / 40
            rows.append(f"{t},{3.2 + 0.7 * level + 0.03 * current:.4f},{current},{120 * (k + 1)},{state}\n")
    file = tmp_path / "cell.csv"
    file.write_text(f"Timestamp (s),Voltage (V),Current (A),Charge ({unit}),Test State\n{''.join(rows)}")
    record = read(file)
    assert isinstance(record, Record)
    assert record.u_name == "Charge throughput"
    assert record.y_name == "Voltage (V)"
    assert record.u[[39, 79, 119]] == pytest.approx([4680, -120, 4680])


def test_charge_without_states_is_the_output_of_a_voltage(tmp_path: Path) -> None:
    t = np.arange(200) * 0.05
    file = tmp_path / "capacitor.csv"
    rows = (f"{a:.2f},{np.sin(a):.5f},{np.sin(a - 0.3):.5f}\n" for a in t)
    file.write_text(f"Time (s),Voltage (V),Charge (C)\n{''.join(rows)}")
    record = read(file)
    assert isinstance(record, Record)
    assert (record.u_name, record.y_name) == ("Voltage (V)", "Charge (C)")


# Devices of electronics ----------------------------------------------------------------------------------------------------------


def test_sweeps_at_levels_of_a_gate_are_curves_of_their_voltage_and_current(tmp_path: Path) -> None:
    voltage = np.round(np.r_[np.arange(0, 3.3, 0.1), np.arange(3.2, -0.01, -0.1)], 1)
    rises = np.arange(voltage.size) < 33
    gates = (0.6, 1.2, 1.8, 2.4)
    current = [2e-4 * (gate - 0.5) * np.tanh(voltage / 0.6) * np.where(rises, 1.0, 1.12) for gate in gates]
    gate, swept = np.repeat(gates, voltage.size), np.tile(voltage, 4)
    data = read(
        written(
            tmp_path,
            "SCAN MODE\n\nGate (V),Voltage (V),Current (A)\n" + rows(",", gate, swept, np.concatenate(current)),
            "tracer.csv",
        )
    )
    assert isinstance(data, Dataset)
    assert [record.name for record in data] == [f"Gate={level:g}" for level in gates]
    for record, expected in zip(data, current, strict=True):
        np.testing.assert_allclose(record.u, voltage, atol=1e-9)
        np.testing.assert_allclose(record.y, expected, rtol=1e-6)
        assert (record.u_unit, record.y_unit) == ("V", "A")


def test_channels_that_easyexpert_names_by_their_kind_have_its_units(tmp_path: Path) -> None:
    head = "\nSetupTitle, Gate Sweep\nTestParameter, Channel.IName, DrainI, SrcI, GateI\n"
    head += (
        "TestParameter, Channel.VName, DrainV, SrcV, GateV\nDimension1, 80, 80, 80\nDataName, GateV, DrainI, GateI\n"
    )
    gate = np.r_[np.arange(-20, 20), np.arange(20, -20, -1)]
    drain = 1e-7 * (1 + np.tanh((gate - np.repeat([4.0, -4.0], 40)) / 5))
    lines = [
        f"DataValue, {v}, {i:.6E}, {1e-12 * (k % 3):.3E}\n" for k, (v, i) in enumerate(zip(gate, drain, strict=True))
    ]
    record = one(tmp_path, head + "".join(lines))
    np.testing.assert_allclose(record.y, drain, rtol=1e-5)
    assert (record.u_unit, record.y_unit) == ("V", "A")


@pytest.mark.parametrize("cycles", [1, 3])
def test_charges_and_discharges_of_a_cell_side_by_side_are_loops(cycles: int, tmp_path: Path) -> None:
    state, columns, names = np.linspace(0, 1, 40), [], []
    voltage = 3.2 + 0.1 * np.log((state + 0.05) / (1.05 - state))
    for cycle in range(1, cycles + 1):
        charge = (2.5 - 0.1 * cycle) * state
        columns += [voltage + 0.03 * cycle, charge, voltage[::-1] - 0.03 * cycle, charge]
        names += [f"{name}_{way}_{cycle}" for way in ("ch", "dch") for name in ("Voltage", "Capacity")]
    data = Dataset.of(read(written(tmp_path, ",".join(names) + "\n" + rows(",", *columns), "cell.csv")))
    assert len(data) == cycles
    for cycle, record in enumerate(data, start=1):
        charge = (2.5 - 0.1 * cycle) * state
        np.testing.assert_allclose(record.u, np.r_[charge, charge[::-1]], atol=1e-6)
        np.testing.assert_allclose(record.y, np.r_[voltage + 0.03 * cycle, (voltage - 0.03 * cycle)[::-1]], atol=1e-6)


def test_a_loop_in_volt_seconds_beside_the_same_in_units_of_magnetism_is_that_one(tmp_path: Path) -> None:
    time = np.arange(200) * 5e-9
    field = 36.4 * np.cos(2 * np.pi * time / 1e-6)
    moment = 420 * np.tanh((field - 6 * np.sign(np.gradient(field))) / 9)
    names = "Tiempo_(s)\tCampo_(Vs)\tMagnetizacion_(Vs)\tCampo_(kA/m)\tMagnetizacion_(A/m)\n"
    numbers = [time, field * 2.1e-9, moment * 3.3e-11, field, moment]
    body = "".join("\t".join(f"{value:.6e}" for value in row) + "\n" for row in zip(*numbers, strict=True))
    record = one(tmp_path, "#Temperatura_=_22.8_°C\n#frecuencia_=_300290.0 Hz\n\n" + names + body)
    np.testing.assert_allclose(record.u, field, atol=1e-4)
    np.testing.assert_allclose(record.y, moment, atol=1e-3)
    assert (record.u_unit, record.y_unit) == ("kA/m", "A/m")


@pytest.mark.parametrize("noisy_first", [False, True])
def test_of_two_signals_without_a_role_the_smooth_one_is_the_command(noisy_first: bool, tmp_path: Path) -> None:
    phase = np.linspace(0, 6 * np.pi, 600)
    drive, answer = np.sin(phase), np.sin(phase - 0.3) + 0.01 * np.random.default_rng(0).normal(size=600)
    columns = (answer, drive) if noisy_first else (drive, answer)
    record = one(tmp_path, "ch1,ch2\n" + rows(",", *columns))
    np.testing.assert_allclose(record.u, drive, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("field.actual0", ""),
        ("field.data", ""),
        ("field.position0", "displacement"),
        ("field.wrench.force.z", "force"),
        ("wrench.force.z", "force"),
        ("sensor.x", "displacement"),
        ("field.magnetic_field.z", "field"),
        ("Field.value", "field"),
        ("field", "field"),
    ],
)
def test_the_container_of_a_message_is_no_magnetic_field(name: str, meant: str) -> None:
    """Messages of robots are written as field.NAME; a direction has the meaning of the vector that it belongs to."""
    assert column_quantity(name) == meant


# Several devices and files ---------------------------------------------------------------------------------------------------------


def test_further_outputs_of_one_drive_are_named_with_their_option(tmp_path: Path) -> None:
    record = one(
        tmp_path,
        "Drive (V),Actuator A (um),Actuator B (um),Room (degC)\n" + rows(",", U, Y, 2 * Y**2, 0 * U + 21 + 0.1 * Y),
    )
    is_pair(record)
    (note,) = (note.text for note in record.notes if note.text.startswith("columns not used"))
    assert "--output 'Actuator B (um)'" in note


def test_files_of_two_branches_are_no_input_and_output(tmp_path: Path) -> None:
    """Each has a field and a magnetization; joined as a pair, the field of one would drive the magnetization of the other."""
    half = N // 2
    for name, part in (("up", slice(half)), ("down", slice(half, 2 * half))):
        written(tmp_path, "H (Oe),M (emu)\n" + rows(",", U[part], Y[part]), f"{name}.csv")
    with pytest.raises(DataError, match="each is a curve of its own"):
        read(f"{tmp_path}/up.csv+{tmp_path}/down.csv")
    chosen = read(f"{tmp_path}/up.csv+{tmp_path}/down.csv", input="H (Oe)", output="M (emu)")
    assert isinstance(chosen, Record)


def test_files_of_signals_of_one_name_are_an_input_and_an_output(tmp_path: Path) -> None:
    clock = np.arange(N) / 10
    for name, values in (("u", U), ("y", Y)):
        written(tmp_path, "t (s),value\n" + rows(",", clock, values), f"{name}.csv")
    is_pair(read(f"{tmp_path}/u.csv+{tmp_path}/y.csv"))
