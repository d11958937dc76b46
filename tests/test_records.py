"""How records come in: clocks, units, several files, pairs of files, standard deviations, integrals and smoothing."""

import dataclasses
import json

import numpy as np
import pytest
import scipy.constants
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

import hystfit as hf
from hystfit.cli import run
from hystfit.data.preparation import CoarseClock, RoundedStamps, integral, smooth
from hystfit.errors import DataError
from hystfit.fitting.comparison.left_out import left_out_error
from hystfit.fitting.solvers.ridge import LinearSystem, fit_ridge
from hystfit.fitting.trial import with_test
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.params.units import conversion, integral_unit
from hystfit.quality.held_out import held_out

RATE = 200.0


def wave(n=400, seed=0):
    """Time [s], input [V] and a loop [um]: a backlash by a plain loop, with a little noise."""
    t = np.arange(n) / RATE
    u = 2 * (1 - np.cos(2 * np.pi * t)) * (1 - 0.1 * np.floor(t))
    p, y = 0.0, []
    for x in u:
        p = max(x - 0.3, min(x + 0.3, p))
        y.append(5 * p)
    return t, u, np.array(y) + 0.02 * np.random.default_rng(seed).standard_normal(n)


def table(path, header, *columns):
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True))
    path.write_text(f"{header}\n{rows}\n" if header else rows + "\n")
    return path


def codes(record):
    return {note.code for note in record.notes}


# -- clocks --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("option", [{"rate": RATE}, {"dt": 1 / RATE}])
def test_a_file_without_a_clock_gets_one(tmp_path, option):
    t, u, y = wave()
    record = hf.read_csv(table(tmp_path / "a.csv", "u_V,y_um", u, y), **option)
    assert np.allclose(record.t, t, rtol=1e-12)
    assert record.t_unit == "s"
    assert Code.PREPARED in codes(record)


@pytest.mark.parametrize("header", ["t_s,u_V,y_um", ""])
def test_whole_seconds_are_no_clock(tmp_path, header):
    t, u, y = wave(800)
    path = table(tmp_path / "a.csv", header, np.floor(t), u, y)
    record = hf.read_csv(path)
    assert record.t is None
    assert Code.COARSE_CLOCK in codes(record)
    assert np.allclose(record.u, u)
    timed = hf.read_csv(path, rate=RATE)
    assert np.allclose(timed.t, t)
    assert Code.COARSE_CLOCK not in codes(timed)


def test_a_constant_clock_needs_the_rate(tmp_path):
    t, u, y = wave()
    path = table(tmp_path / "a.csv", "t_s,u_V,y_um", 0 * t + 3, u, y)
    with pytest.raises(DataError):
        hf.read_csv(path, time="t_s")
    assert np.allclose(hf.read_csv(path, time="t_s", rate=RATE).t, t)


def test_a_usable_clock_must_agree_with_the_rate(tmp_path):
    t, u, y = wave()
    path = table(tmp_path / "a.csv", "t_ms,u_V,y_um", 1e3 * t, u, y)
    record = hf.read_csv(path, rate=RATE)
    assert np.allclose(record.t, 1e3 * t)
    assert record.t_unit == "ms"
    with pytest.raises(DataError):
        hf.read_csv(path, rate=2 * RATE)
    assert np.allclose(hf.read_csv(path, rate=2 * RATE, time=False).t, t / 2)


@pytest.mark.parametrize("option", [{"rate": 1.0, "dt": 1.0}, {"rate": 0.0}, {"dt": -1.0}, {"rate": np.nan}])
def test_impossible_rates_are_refused(tmp_path, option):
    _, u, y = wave()
    with pytest.raises(DataError):
        hf.read_csv(table(tmp_path / "a.csv", "u_V,y_um", u, y), **option)
    with pytest.raises(DataError):
        hf.Record(u, y).sampled(**option)


@given(st.floats(3.0, 900.0), st.sampled_from([1.0, 0.1, 0.001, 60.0]), st.integers(0, 100), st.floats(0.0, 0.4))
def test_stamps_that_repeat_are_recognized_and_true_ones_are_not(samples, step, seed, jitter):
    n = int(8 * samples) + 20
    t = step * (np.arange(n) + np.random.default_rng(seed).uniform(-jitter, jitter, n)) / samples
    t -= t[0]
    clock = CoarseClock.of(step * np.floor(t / step + 1e-6))
    assert clock is not None
    assert clock.step == pytest.approx(step)
    assert abs(clock.samples - samples) <= 1.5
    assert CoarseClock.of(np.sort(t)) is None


@pytest.mark.parametrize(
    ("written", "interval"),
    [
        ([f"{3.2 + k / 30:.2f}" for k in range(1000)], 1 / 30),
        ([f"{1000 * k // 60}" for k in range(1000)], 1000 / 60),
        ([f"{k / 20_000:.6g}" for k in range(300_000)], 1 / 20_000),
    ],
)
def test_rounded_time_stamps_are_those_of_even_samples(tmp_path, written, interval):
    """Fixed decimals, a counter of whole milliseconds, and six digits whatever the size, as C++ writes them."""
    rows = zip(written, np.sin(0.01 * np.arange(len(written))), strict=True)
    text = "t_s,u_V,y_um\n" + "".join(f"{t},{u:.4f},{2 * u:.4f}\n" for t, u in rows)
    (tmp_path / "loop.csv").write_text(text)
    record = hf.read(tmp_path / "loop.csv")
    steps = np.diff(record.t)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-6)
    assert steps.mean() == pytest.approx(interval, rel=1e-4)
    resolution = np.ptp(np.diff(np.array(written, float)))
    assert np.abs(record.t - np.array(written, float)).max() < 0.51 * resolution
    assert not any("time step" in str(note) or "repeated" in str(note) for note in record.notes)


def test_a_clock_that_jitters_keeps_its_stamps():
    rng, k = np.random.default_rng(3), np.arange(1000)
    for t in (
        np.round(0.01 * k + rng.uniform(-1e-3, 1e-3, k.size), 3),  # late by up to a few units of the last digit
        np.round(np.cumsum(0.0333 + 3e-4 * rng.normal(size=k.size)), 2),  # a random walk, rounded
        np.concatenate([0.01 * k, 10 + 0.02 * k]),  # two rates
    ):
        assert RoundedStamps.of(t) is None


@pytest.mark.usefixtures("findings_alone")
def test_check_and_fit_name_what_is_missed_without_time(tmp_path, capsys):
    t, u, y = wave(800)
    path = table(tmp_path / "a.csv", "t_s,u_V,y_um", np.floor(t), u, y)
    run(["check", str(path), "--json"])
    report = json.loads(capsys.readouterr().out)
    assert "no-time" in {note["code"] for note in report["findings"]}
    assert "coarse-clock" in {note["code"] for note in report["reading"]["a"]}
    run(["check", str(path), "--rate", "200", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert "no-time" not in {note["code"] for note in report["findings"]}
    assert report["records"][0]["sampling"]["rate"] == pytest.approx(RATE)
    # A record made in Python keeps its stamps, and check does not take them for time.
    assert has(hf.check(hf.Record(u, y, np.floor(t))).findings, Code.NO_TIME)
    fits = [hf.fit(hf.BoucWen(), record, starts=1) for record in (hf.Record(u, y), hf.Record(u, y, t))]
    assert [has(fit.notes, Code.NO_TIME) for fit in fits] == [True, False]


# -- units ---------------------------------------------------------------------------------------------------------------

C = scipy.constants


@pytest.mark.parametrize(
    ("source", "target", "factor"),
    [
        ("um", "nm", 1e3),
        ("µm", "μm", 1.0),
        ("mV", "V", 1e-3),
        ("kN", "N", 1e3),
        ("T", "mT", 1e3),
        ("G", "T", 1e-4),
        ("Oe", "A/m", 1e3 / (4 * np.pi)),
        ("kOe", "kA/m", 1e3 / (4 * np.pi)),
        ("emu", "A m^2", 1e-3),
        ("emu", "Am2", 1e-3),
        ("emu/g", "A·m²/kg", 1.0),
        ("emu/cm3", "kA/m", 1.0),
        ("uC/cm2", "C/m^2", 1e-2),
        ("in", "mm", C.inch / C.milli),
        ("kip", "kN", C.lbf),
        ("ksi", "MPa", C.psi / C.kilo),
        ("lbf", "N", C.lbf),
        ("kgf", "N", C.g),
        ("deg", "rad", C.degree),
        ("min", "s", C.minute),
        ("h", "s", C.hour),
        ("bar", "kPa", C.bar / C.kilo),
        ("mm/s", "m s^-1", 1e-3),
        ("ft-lb", "N*m", C.foot * C.lbf),
        ("kip-in", "kN*m", C.inch * C.lbf),
        ("mmHg", "Pa", C.mmHg),
        ("atm", "kPa", C.atm / C.kilo),
        ("dynes", "uN", C.dyn / C.micro),
        ("oz", "N", C.lbf / 16),
        ("kpsi", "MPa", C.psi / C.kilo),
        ("kGauss", "mT", 100.0),
        ("microstrain", "ppm", 1.0),
        ("mVs", "Wb", 1e-3),
        ("MM", "mm", 1.0),
        ("Deg C", "degC", 1.0),
        ("N*m", "Nmm", 1e3),
        ("%", "mm/mm", 1e-2),
        ("V", "V", 1.0),
        ("furlong", "furlong", 1.0),
        ("furlong", "m", None),
        ("", "m", None),
    ],
)
def test_units_convert_as_defined(source, target, factor):
    assert conversion(source, target) == (None if factor is None else pytest.approx(factor, rel=1e-12))


@pytest.mark.parametrize(("one", "other"), [("um", "V"), ("T", "A/m"), ("emu", "A/m"), ("N", "MPa"), ("deg", "mm")])
def test_units_of_different_quantities_do_not_convert(one, other):
    with pytest.raises(DataError):
        conversion(one, other)


def test_units_of_integrals():
    assert [integral_unit(unit) for unit in ("A", "uA", "mA/cm2", "V", "")] == ["C", "uC", "mC/cm2", "V*s", ""]


def test_the_user_gives_units_where_the_file_has_none(tmp_path):
    _, u, y = wave()
    bare = hf.read_csv(table(tmp_path / "a.csv", "in,out", u, y), units="V,um")
    assert (bare.u_unit, bare.y_unit) == ("V", "um")
    assert np.allclose(bare.y, y)
    named = table(tmp_path / "b.csv", "u_mV,y_um", u, y)
    converted = hf.read_csv(named, units=("V", "nm"))
    assert np.allclose(converted.u, u / 1e3)
    assert np.allclose(converted.y, 1e3 * y)
    assert Code.UNITS in codes(converted)
    assert hf.read_csv(named, units=",nm").u_unit == "mV"
    for wrong in ("um,V", "V", "V,um,s"):
        with pytest.raises(DataError):
            hf.read_csv(named, units=wrong)


def test_records_are_combined_in_the_units_of_the_first():
    t, u, y = wave()
    one = hf.Record(u, y, t, u_unit="V", y_unit="um", name="one")
    other = hf.Record(1e3 * u, 1e3 * y, 1e3 * t, u_unit="mV", y_unit="nm", t_unit="ms", name="other")
    unknown = hf.Record(u, y, t, name="unknown")
    data = hf.Dataset((one, other, unknown))
    assert {(r.u_unit, r.y_unit, r.t_unit) for r in data} == {("V", "um", "s")}
    assert np.allclose(data[1].u, u)
    assert np.allclose(data[1].y, y)
    assert np.allclose(data[1].dt, one.dt)
    assert [Code.UNITS in codes(r) for r in data] == [False, True, True]
    assert hf.Dataset.of(list(data))[1].notes == data[1].notes  # converted once
    with pytest.raises(DataError):
        hf.Dataset((one, other.replace(y_unit="N")))
    strange = hf.Dataset((one, other.replace(u=u, y_unit="ticks", u_unit="V")))[1]
    assert np.allclose(strange.y, 1e3 * y)
    assert next(note.severity for note in strange.notes if note.code is Code.UNITS) == "warning"


@pytest.fixture(scope="module")
def fitted():
    """A fit in V, um and s of a model with a time constant."""
    t, u, y = wave()
    record = hf.Record(u, y, t, u_unit="V", y_unit="um", name="fitted")
    return hf.fit(hf.BoucWen(), record, starts=1, fix=["mu", "tau", "rho"], noise="iid")


def test_predictions_are_in_the_units_of_their_record(fitted):
    record = fitted.data[0]
    other = record.replace(
        u=1e3 * record.u, y=1e3 * record.y, t=1e3 * record.t, u_unit="mV", y_unit="nm", t_unit="ms", name="other"
    )
    assert np.allclose(fitted.predict(other), 1e3 * fitted.predict(record), rtol=1e-9)
    assert fitted.metrics(other).rmse == pytest.approx(fitted.train.rmse, rel=1e-9)
    assert fitted.extrapolation(other) is None
    assert np.allclose(fitted.predict(record.replace(u_unit="", y_unit="")), fitted.predict(record))
    tested = with_test(fitted, other)
    assert tested.test.rmse == pytest.approx(fitted.train.rmse, rel=1e-9)
    assert has(tested.notes, Code.UNITS)
    for wrong in ({"y_unit": "N"}, {"u_unit": "Oe"}):
        with pytest.raises(DataError):
            fitted.predict(record.replace(**wrong))
        with pytest.raises(DataError):
            with_test(fitted, record.replace(**wrong))


def test_predict_at_the_shell_converts_or_refuses(fitted, tmp_path, capsys):
    record = fitted.data[0]
    fitted.save(tmp_path / "fit", report=False)
    scaled = 1e3 * record.t, 1e3 * record.u, 1e3 * record.y
    nm = table(tmp_path / "nm.csv", "t_ms,u_mV,y_nm", *scaled)
    assert run(["predict", str(tmp_path / "fit"), str(nm), "--json"]) == 1
    content = json.loads(capsys.readouterr().out)
    assert content["status"] == "fit-not-usable"  # three parameters are fixed at wrong values
    assert content["metrics"]["test"]["rmse"] == pytest.approx(fitted.train.rmse, rel=1e-5)
    assert "units" in {note["code"] for note in content["notes"]}
    newton = table(tmp_path / "newton.csv", "t_s,u_V,y_N", record.t, record.u, record.y)
    assert run(["predict", str(tmp_path / "fit"), str(newton)]) == 2
    assert run(["predict", str(tmp_path / "fit"), str(newton), "--units", "V,um"]) == 2
    assert run(["invert", str(tmp_path / "fit"), str(newton), "--output", "y"]) == 2


# -- several files -------------------------------------------------------------------------------------------------------


@pytest.fixture
def loops(tmp_path):
    t, u, y = wave()
    table(tmp_path / "loop1.csv", "t_s,u_V,y_um", t, u, y)
    table(tmp_path / "loop2.csv", "t_s,u_mV,y_nm", t, 1e3 * u, 1e3 * y)
    table(tmp_path / "loop10.csv", "t_s,u_V,y_um", t, u, y)
    return tmp_path


def test_several_files_are_one_data_set(loops):
    data = hf.read_csv(str(loops / "loop*.csv"))
    assert [record.name for record in data] == ["loop1", "loop2", "loop10"]
    assert data.units == {"u": "V", "y": "um", "t": "s"}
    assert np.allclose(data[1].y, data[0].y, atol=1e-6)
    listed = hf.read([loops / "loop10.csv", str(loops / "loop[12].csv")])
    assert [record.name for record in listed] == ["loop10", "loop1", "loop2"]
    for wrong in (
        str(loops / "none*.csv"),
        [],
        [loops / "loop1.csv", str(loops / "loop*.csv")],
        [loops / "loop1.csv", str(loops / "loop1.csv")],
    ):
        with pytest.raises(DataError):
            hf.read(wrong)


def test_equal_names_are_told_apart(loops):
    (loops / "more").mkdir()
    twin = loops / "more" / "loop1.csv"
    twin.write_bytes((loops / "loop1.csv").read_bytes())
    data = hf.read([loops / "loop1.csv", twin])
    assert len({record.name for record in data}) == 2
    t, u, y = wave()
    half = 1 + (np.arange(t.size) >= t.size // 2)
    for name in ("a", "b"):
        table(loops / f"{name}.csv", "t_s,u_V,y_um,loop", t, u, y, half)
    data = hf.read([loops / "a.csv", loops / "b.csv"], by="loop")
    assert [record.name for record in data] == ["a loop=1", "a loop=2", "b loop=1", "b loop=2"]


@pytest.mark.usefixtures("findings_alone")
def test_several_files_at_the_shell(loops, capsys):
    pattern = str(loops / "loop?.csv")
    assert run(["check", pattern, str(loops / "loop10.csv"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [record["name"] for record in report["records"]] == ["loop1", "loop2", "loop10"]
    assert [r["units"]["y"] for r in report["provenance"]["records"]] == ["um"] * 3
    changed = report["provenance"]["records"][1]["changes"]
    assert len(changed) == 2  # input and output were converted
    out = loops / "fit"
    run(["fit", pattern, "--model", "bouc-wen", "--starts", "1", "--out", str(out)])
    assert [record.name for record in hf.load_fit(out).data] == ["loop1", "loop2"]
    same = ["fit", str(loops / "loop1.csv"), "--test", str(loops / "loop2.csv"), "--model", "bouc-wen"]
    assert run(same) == 2  # the same measurement in other units
    for wrong in ([], [str(loops / "none*.csv")], [pattern, str(loops / "loop1.csv")], [str(loops)]):
        assert run(["check", *wrong]) == 2


@pytest.mark.usefixtures("findings_alone")
def test_input_and_output_in_two_files(tmp_path, capsys):
    t, u, y = wave()
    first = table(tmp_path / "u.csv", "t_s,u_V", t, u)
    second = table(tmp_path / "y.csv", "t_ms,y_um", 1e3 * t, y)
    record = hf.read(f"{first}+{second}")
    assert (record.u_unit, record.y_unit, record.name) == ("V", "um", "u")
    for column, values in (("t", t), ("u", u), ("y", y)):
        assert np.allclose(getattr(record, column), values, atol=1e-8)
    alone = table(tmp_path / "alone.csv", "", u)
    assert np.allclose(hf.read(f"{alone}+{second}").dt[1:], 1e3 / RATE)
    bare = table(tmp_path / "bare.csv", "", y)
    numbered = hf.read(f"{first}+{bare}", time=0, input=1, output=0)
    assert np.allclose(numbered.t, t, atol=1e-8)
    assert np.allclose(numbered.y, y, atol=1e-8)
    late = table(tmp_path / "late.csv", "t_s,y_um", t * 1.1, y)
    short = table(tmp_path / "short.csv", "t_s,y_um", t[:-1], y[:-1])
    for other in (late, short, tmp_path / "missing.csv"):
        with pytest.raises((DataError, OSError)):
            hf.read(f"{first}+{other}")
        assert run(["check", f"{first}+{other}"]) == 2
    assert run(["check", f"{first}+{second}", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["records"][0]["units"] == {"u": "V", "y": "um", "t": "s"}


# -- standard deviations -------------------------------------------------------------------------------------------------


def linear_problem(seed=1):
    """A record with known standard deviations, and the regressors of c and offset in y = c g(u) + offset."""
    t, u, y = wave(seed=seed)
    sigma = np.where(t < 1, 0.05, 0.5)
    noise = sigma * np.random.default_rng(seed).standard_normal(t.size)
    record = hf.Record(u, y + noise, t, u_unit="V", y_unit="um").with_sigma(sigma)
    g = np.asarray(hf.simulate(hf.BoucWen(c=1.0), u)[0])
    return record, np.column_stack([g, np.ones_like(g)]), sigma


def weighted_lines(A, y, sigma):
    root = 1 / sigma[:, None]
    return np.linalg.lstsq(A * root, y / sigma, rcond=None)[0]


def test_standard_deviations_weight_the_fit_and_its_errors():
    record, A, sigma = linear_problem()
    result = hf.fit(
        hf.BoucWen(), record, starts=1, start="model", noise="iid", fix=["mu", "tau", "rho", "h0"], free=["offset"]
    )
    value = weighted_lines(A, record.y, sigma)
    assert [result[name].value for name in ("c", "offset")] == pytest.approx(value, rel=1e-6)
    residual = (record.y - A @ value) / sigma
    covariance = residual @ residual / (sigma.size - 2) * np.linalg.inv((A / sigma[:, None]).T @ (A / sigma[:, None]))
    errors = [result[name].stderr for name in ("c", "offset")]
    assert errors == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-3)
    # The samples that are held out in turn count by their weight.
    fold = held_out([record]).folds[0]
    parts = [np.flatnonzero(fold == k) for k in range(fold.max() + 1)]
    squares = 0.0
    for part in parts:
        kept = np.setdiff1d(np.arange(sigma.size), part)
        line = weighted_lines(A[kept], record.y[kept], sigma[kept])
        squares += np.sum(((record.y - A @ line)[part] / sigma[part]) ** 2)
    assert left_out_error(result) == pytest.approx(np.sqrt(squares / np.sum(sigma[fold >= 0] ** -2.0)), rel=1e-5)


def test_left_out_errors_of_linear_weights_do_not_depend_on_the_scale_of_all_weights():
    record, _, _ = linear_problem()
    scores = []
    for weight in (1.0, 4.0):
        problem = hf.Problem(hf.PrandtlIshlinskii.of(4).start([record]), record.replace(weight=weight * record.weight))
        scores.append(fit_ridge(LinearSystem.of(problem, problem.space.vector(problem.model))).score)
    assert scores[0] == pytest.approx(scores[1], rel=1e-6)


def test_a_column_of_standard_deviations(tmp_path):
    t, u, y = wave()
    sigma = np.where(t < 1, 50.0, 500.0)
    record = hf.read_csv(table(tmp_path / "a.csv", "t_s,u_V,y_um,s_nm", t, u, y, sigma), sigma="s_nm")
    assert np.allclose(record.sigma / np.sqrt(record.weight), sigma / 1e3)  # in um
    assert np.allclose(record.in_units(y="mm").sigma / np.sqrt(record.weight), sigma / 1e6)
    assert Code.WEIGHTED in codes(record)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        bad = sigma.copy()
        bad[7] = wrong
        with pytest.raises(DataError):
            hf.read_csv(table(tmp_path / "b.csv", "t_s,u_V,y_um,s_nm", t, u, y, bad), sigma="s_nm")
    missing = y.copy()
    missing[7], bad[7] = np.nan, np.nan  # nothing was measured there
    assert hf.Record(u, missing, t).with_sigma(bad).weight[7] == 0
    with pytest.raises(DataError):
        hf.read_csv(table(tmp_path / "c.csv", "t_s,u_V,y_um,s_V", t, u, y, sigma), sigma="s_V")


def test_records_share_one_standard_deviation():
    t, u, y = wave()
    one = hf.Record(u, y, t, y_unit="um", name="one").with_sigma(np.full(t.size, 0.1))
    other = hf.Record(u, 1e3 * y, t, y_unit="nm", name="other").with_sigma(np.full(t.size, 300.0))
    data = hf.Dataset((one, other))
    assert [record.sigma for record in data] == [0.1, 0.1]
    assert np.allclose(data[1].weight, (0.1 / 0.3) ** 2)
    with pytest.raises(DataError):
        hf.Dataset((one, hf.Record(u, y, t, name="bare")))


def test_standard_deviations_survive_saving_and_windows(tmp_path):
    from hystfit.results.saved import load_records, save_records

    record, _, _ = linear_problem()
    data = hf.Dataset.of(record.window(0.2, 1.5))
    save_records(tmp_path / "r.npz", data)
    loaded = load_records(tmp_path / "r.npz")[0]
    assert loaded.sigma == record.sigma
    assert np.array_equal(loaded.weight, data[0].weight)


def test_a_sequential_method_warns_that_it_does_not_weight():
    record = hf.datasets.load("stage-sine")
    result = hf.fit("duhem", record.with_sigma(np.linspace(1, 2, len(record))), method="rls")
    assert has(result.notes, Code.WEIGHTED)


# -- integrals and smoothing ---------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("findings_alone")
def test_the_integral_of_a_current_is_its_charge(tmp_path, capsys):
    t = np.arange(1, 801) / 400
    charge = np.sin(2 * np.pi * t)
    path = table(
        tmp_path / "a.csv", "t_ms,u_V,i_mA", 1e3 * t, np.sin(2 * np.pi * t + 0.3), 2 * np.pi * np.cos(2 * np.pi * t)
    )
    record = hf.read_csv(path, integrate=True)
    assert record.y_unit == "mC"
    assert np.allclose(record.y, charge - charge[0], atol=1e-3)
    assert record.y[0] == 0
    assert Code.PREPARED in codes(record)
    run(["check", str(path), "--json"])
    assert "rate" in {note["code"] for note in json.loads(capsys.readouterr().out)["findings"]}
    run(["check", str(path), "--integrate", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert "rate" not in {note["code"] for note in report["findings"]}
    assert report["provenance"]["records"][0]["changes"]
    with pytest.raises(DataError):
        hf.read_csv(path, integrate=True, time=False)
    with pytest.raises(DataError):
        record.replace(y=np.where(t < 1, np.nan, record.y)).integrated()
    with pytest.raises(DataError):
        hf.read_csv(path, integrate=True, sigma="u_V")


def test_the_trapezoidal_rule_is_exact_for_lines_between_uneven_samples():
    t = np.array([0.0, 1.0, 1.5, 4.0])
    assert np.allclose(integral(3 * t + 1, t), 1.5 * t**2 + t)


@pytest.mark.parametrize("length", [5, 9, 21])
def test_smoothing_has_zero_phase_and_keeps_parabolas(length):
    t = np.linspace(-1, 1, 101)
    assert np.allclose(smooth(3 * t**2 - t + 2, length), 3 * t**2 - t + 2)
    noise = np.random.default_rng(0).standard_normal(t.size)
    assert np.allclose(smooth(noise[::-1], length), smooth(noise, length)[::-1])  # the same forward and backward
    assert np.std(smooth(noise, length)) < np.std(noise)
    assert np.allclose(smooth(noise, length), savgol_filter(noise, length, 2))


@pytest.mark.parametrize("length", [1, 3, 4, 8, 999])
def test_impossible_smoothing_lengths_are_refused(length):
    _, u, y = wave()
    with pytest.raises(DataError):
        hf.Record(u, y).smoothed(length)


@pytest.mark.usefixtures("findings_alone")
def test_check_advises_a_smoothing_that_removes_the_chatter(tmp_path, capsys):
    t, u, y = wave(1200)
    noisy = u + 0.03 * np.random.default_rng(5).standard_normal(u.size)
    path = table(tmp_path / "a.csv", "t_s,u_V,y_um", t, noisy, y)
    run(["check", str(path), "--json"])
    report = json.loads(capsys.readouterr().out)
    assert "chatter" in {note["code"] for note in report["findings"]}
    length = report["records"][0]["motion"]["smoothing"]
    run(["check", str(path), "--smooth", str(length), "--json"])
    smoothed = json.loads(capsys.readouterr().out)
    assert "chatter" not in {note["code"] for note in smoothed["findings"]}
    assert smoothed["provenance"]["records"][0]["changes"]
    record = hf.read_csv(path, smooth=length)
    assert np.sqrt(np.mean((record.u - u) ** 2)) < 0.6 * np.sqrt(np.mean((noisy - u) ** 2))
    assert np.array_equal(record.y, hf.read_csv(path).y)


@pytest.mark.usefixtures("findings_alone")
def test_data_sets_by_name_take_the_same_changes(capsys):
    assert run(["check", "stage-sine", "--units", ",nm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["records"][0]["units"]["y"] == "nm"
    assert run(["check", "stage-sine", "--rate", "7"]) == 2


@pytest.mark.usefixtures("findings_alone")
def test_measured_piezo_record_without_its_clock(measured, tmp_path, capsys):
    path = measured / "tidy" / "piezo_dbo_model.csv"
    whole = hf.read_csv(path)
    bare = table(tmp_path / "bare.csv", "u_V,y_um", whole.u, whole.y)
    record = hf.read_csv(bare, rate=RATE)
    assert np.allclose(record.t, whole.t - whole.t[0], atol=1e-6)
    found, known = (hf.check(dataclasses.replace(r, name="r")) for r in (record, whole))
    assert found.records[0].lag.samples == pytest.approx(known.records[0].lag.samples, rel=1e-3)


def test_numbers_of_a_record_are_shared_with_its_copies_and_with_nothing_that_can_change():
    u, y = np.sin(np.arange(50.0)), np.cos(np.arange(50.0))
    record = hf.Record(u=u, y=y)
    assert record.replace(y=2 * y).u is record.u
    for values in (u, u.view(), np.broadcast_to(0.5, 50), u.astype(np.float32)):
        assert not np.shares_memory(hf.Record(u=values, y=y).u, values)
    frozen = u.view()
    frozen.flags.writeable = False  # the array behind it can still be written to
    assert not np.shares_memory(hf.Record(u=frozen, y=y).u, u)
    view = u.view()
    u.flags.writeable = False
    other = hf.Record(u=u, y=y)
    view[3] = 9.0
    assert other.u[3] == record.u[3] != 9.0


@pytest.mark.parametrize("place", [0, 7, 49])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_time_that_is_not_finite_is_refused(place, bad):
    t = np.arange(50.0)
    t[place] = bad
    with pytest.raises(DataError, match="time is not finite or decreases"):
        hf.Record(u=np.sin(np.arange(50.0)), y=np.zeros(50), t=t)
