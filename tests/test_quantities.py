"""Engineering quantities of a fit: against the measured loop, draws from the covariance, closed forms, and the reasons for gaps."""

import dataclasses
import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import hystfit as hf
from hystfit.data.dataset import Dataset
from hystfit.quality.loops import loop_area
from hystfit.results.measured.loop_kinds import LoopKind
from hystfit.results.measured.loop_values import quantities
from hystfit.results.measured.magnetic_sample import Sample
from hystfit.results.measured.quantities import QUANTITIES, QuantityEstimate, Unknown, applicable
from hystfit.results.measured.steady_loops import Excitation, SteadyLoops
from hystfit.results.quantity_estimates import measured_quantities, quantity_values
from hystfit.results.report import html_report, text_report

TRUTH = hf.BoucWen(c=1.2, mu=0.5, tau=2.0, rho=0.4, offset=0.3)
SAMPLES = 200  # in a cycle
NOISE = 0.02


def cycles(count: int = 3) -> np.ndarray:
    """Triangular cycles between -1 and 1."""
    edge = np.linspace(-1, 1, SAMPLES // 2 + 1)
    return np.append(np.tile(np.concatenate([edge[:-1], edge[:0:-1]]), count), -1.0)


@pytest.fixture(scope="module")
def record() -> hf.Record:
    u = cycles()
    y = np.asarray(hf.simulate(TRUTH, u)[0]) + NOISE * np.random.default_rng(3).normal(size=u.size)
    return hf.Record(u=u, y=y, u_unit="mm", y_unit="kN")


@pytest.fixture(scope="module")
def fit(record: hf.Record) -> hf.FitResult:
    return hf.fit(TRUTH, record, starts=1, noise="iid")


def drawn(fit: hf.FitResult, count: int) -> np.ndarray:
    """Draws of the parameters from the covariance of the fit."""
    return np.random.default_rng(0).multivariate_normal(fit.x, fit.joint, size=count)


def of_draws(fit: hf.FitResult, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Quantities of each draw, simulated one by one."""
    excitation = Excitation.of(fit.data)
    models = [fit.problem.space.coordinates.assemble(jnp.asarray(row), 0) for row in rows]
    y = np.stack([np.asarray(hf.simulate(m, excitation.loop.u, excitation.loop.dt)[0]) for m in models])
    loops = excitation.loops(y)
    return {name: q.of_loops(loops) for name, q in QUANTITIES.items() if q.of_loops is not None}


def test_values_are_those_of_the_measured_loop_within_their_errors(fit, record):
    u, y = record.u[-SAMPLES - 1 :], record.y[-SAMPLES - 1 :]
    half = SAMPLES // 2
    rising, falling, inputs = y[: half + 1], y[half:][::-1], u[: half + 1]
    area = abs(loop_area(u, y))
    force = 0.5 * abs(rising[-1] + falling[-1] - rising[0] - falling[0])
    middle = slice(half // 2 - 5, half // 2 + 6)  # eleven samples average the noise
    height = float(np.mean((falling - rising)[middle]))
    expected = {
        "loop_area": (area, 0.01),
        "remanence": (0.5 * abs(height), NOISE / np.sqrt(11)),
        "secant_stiffness": (force / 2.0, NOISE),
        "equivalent_damping_percent": (100 * area / (2 * np.pi * 1.0 * force / 2), 0.5),
    }
    found = {q.name: q for q in fit.quantities}
    for name, (value, noise) in expected.items():
        assert found[name].value == pytest.approx(value, abs=4 * np.hypot(found[name].stderr, noise)), name
        assert found[name].stderr < 0.05 * found[name].value
    smooth = np.asarray(hf.simulate(TRUTH, cycles())[0])[-SAMPLES - 1 :]
    level = 0.5 * (smooth.max() + smooth.min())
    widths = [np.interp(level, branch, inputs) for branch in (smooth[: half + 1], smooth[half:][::-1])]
    coercive = found["coercive_input"]
    assert coercive.value == pytest.approx(0.5 * abs(widths[0] - widths[1]), abs=4 * coercive.stderr)


def test_measured_quantities_need_no_model():
    """A play of threshold 0.3 between -1 and 1: a parallelogram, of which the corners give everything."""
    corners = np.array([[-1.0, -0.7], [-0.4, -0.7], [1.0, 0.7], [0.4, 0.7], [-1.0, -0.7]])
    path = np.linspace(0, 4, 161)
    loop = [np.interp(path, np.arange(5), corners[:, k]) for k in (0, 1)]
    record = hf.Record(np.tile(loop[0][:-1], 3), np.tile(loop[1][:-1], 3), u_unit="A/m", y_unit="T")
    half = hf.Record(0.5 * record.u, 0.5 * record.y, u_unit="A/m", y_unit="T", name="half")
    found = measured_quantities(hf.Dataset((half, record)))
    expected = {"loop_area": 0.84, "coercive_input": 0.3, "remanence": 0.3, "stroke": 1.4}
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=2e-3), name
    wider = hf.Record(np.array([-1.0, 2.0]), np.zeros(2), u_unit="A/m", y_unit="T", name="wider")
    assert measured_quantities(hf.Dataset((record, wider))) == {}


def test_measured_loops_at_another_rate_than_the_first_do_not_count():
    """Two loops of width 0.2 at one rate, and three of width 0.8 that are ten times as fast."""
    u = np.interp(np.arange(401), [0, 100, 200, 300, 400], [-1.0, 1.0, -1.0, 1.0, -1.0])
    side = np.sign(np.append(np.diff(u), -1.0))
    loop = lambda width, rate: hf.Record(
        u, u - 0.5 * width * side * (1 - u**2), t=np.arange(u.size) / rate, name=f"{rate}"
    )
    slow, fast = loop(0.2, 1.0), [loop(0.8, rate) for rate in (10.0, 11.0, 12.0)]
    assert measured_quantities(hf.Dataset((slow, *fast))) == pytest.approx(measured_quantities(hf.Dataset((slow,))))
    assert measured_quantities(hf.Dataset((fast[0], slow)))["loop_area"] == pytest.approx(0.8 * 4 / 3, rel=0.01)


def test_the_steady_loop_of_a_record_that_begins_in_the_middle_has_its_rate():
    """Its first rise is half the range; the cycle after it counts all the same."""
    t = np.arange(241) / 600
    record = hf.Record(150 * np.sin(2 * np.pi * 5 * t), np.sin(2 * np.pi * 5 * t - 0.3), t=t)
    found = Excitation.of(hf.Dataset((record,)))
    assert found.interval * found.points == pytest.approx(0.2)
    assert found.sine


def test_a_first_rise_from_rest_is_no_measured_loop():
    """The same play, at rest on -1: the fall after the first rise ends 0.3 above the start, and every later loop closes."""
    corners = np.array([[-1.0, -1.0], [-0.7, -1.0], [1.0, 0.7], [0.4, 0.7], [-1.0, -0.7], [-0.4, -0.7], [1.0, 0.7]])
    path = np.linspace(0, 6, 241)
    u, y = (np.interp(path, np.arange(7), corners[:, k]) for k in (0, 1))
    record = hf.Record(u, y, u_unit="A/m", y_unit="T")
    assert measured_quantities(hf.Dataset((record.window(None, 161.0),))) == {}
    assert measured_quantities(hf.Dataset((record,)))["stroke"] == pytest.approx(1.4, rel=2e-3)


def test_a_quantity_that_the_model_misses_is_named_with_the_measured_one():
    """A Bouc-Wen law on a loop that switches: its error bar is far smaller than its error."""
    inputs = np.linspace(-1, 1, 101)
    branch = np.tanh(20 * (inputs - 0.5))
    u = np.tile(np.concatenate([inputs[:-1], inputs[:0:-1]]), 3)
    y = np.tile(np.concatenate([branch[:-1], -branch[:-1]]), 3)
    fit = hf.fit(TRUTH, hf.Record(u, y, u_unit="A/m", y_unit="T"), starts=1, noise="iid")
    coercive = {q.name: q for q in fit.quantities}["coercive_input"]
    assert coercive.measured == pytest.approx(0.5, abs=1e-6)
    assert coercive.differs == (abs(coercive.value - 0.5) > 2 * coercive.stderr)
    assert coercive.differs
    assert "0.5 A/m in the measured loop" in text_report(fit)


def test_the_coercivity_of_a_loop_with_an_offset_is_read_where_it_passes_zero():
    """Two phases of half widths 1 and 0.2, and an offset of 0.4 in the output, where the loop is narrower than in its middle."""
    inputs = np.linspace(-3, 3, 121)
    falling = lambda u: np.tanh((u + 1.0) / 0.3) + 0.6 * np.tanh((u + 0.2) / 0.3) + 0.9
    rising = lambda u: np.tanh((u - 1.0) / 0.3) + 0.6 * np.tanh((u - 0.2) / 0.3) + 0.9
    u = np.tile(np.concatenate([inputs[:-1], inputs[:0:-1]]), 2)
    y = np.tile(np.concatenate([rising(inputs)[:-1], falling(inputs[:0:-1])]), 2)
    fit = hf.fit(
        "preisach:n=24", hf.Record(u, y + np.random.default_rng(0).normal(0, 0.005, y.size), u_unit="A/m", y_unit="T")
    )
    at_zero = 0.5 * (brentq(rising, -2, 2) - brentq(falling, -2, 2))
    level = lambda branch: lambda u: branch(u) - 0.9
    in_the_middle = 0.5 * (brentq(level(rising), -2, 2) - brentq(level(falling), -2, 2))
    assert abs(at_zero - in_the_middle) > 0.1 * in_the_middle
    coercive = {q.name: q for q in fit.quantities}["coercive_input"]
    assert (coercive.value, coercive.measured) == pytest.approx((at_zero, at_zero), rel=0.03)
    assert float(dict(fit.answer)["Coercivity (half width)"].split()[0]) == pytest.approx(at_zero, rel=0.03)


def test_the_error_of_a_measured_quantity_is_that_of_its_own_loop():
    """A small loop, measured after a large one, does not lend it its relative error."""
    rng = np.random.default_rng(0)
    u = [size * np.cos(np.linspace(0, 6 * np.pi, 1201)) for size in (1.0, 0.1)]
    records = [
        hf.Record(one, hf.simulate(TRUTH, one)[0] + 0.01 * rng.normal(size=one.size), name=name)
        for one, name in zip(u, ("large", "small"), strict=True)
    ]
    both, alone = (
        {q.name: q.measured_stderr for q in hf.fit(TRUTH, data, starts=1, noise="iid").quantities}
        for data in (records, records[:1])
    )
    assert alone["loop_area"] > 0
    assert both == pytest.approx(alone, rel=0.1)


def _two_loops(rising, falling, low: float, high: float, units: tuple[str, str]) -> Dataset:
    """Two loops of two branches, from zero input, with the output counted from the start of the record."""
    u = np.concatenate([np.linspace(0, high, 801), np.linspace(high, low, 1601)[1:], np.linspace(low, 0, 801)[1:]])
    y = np.where(np.append(True, np.diff(u) > 0), rising(u), falling(u))
    return Dataset.of(hf.Record(np.tile(u, 2), np.tile(y - y[0], 2), u_unit=units[0], y_unit=units[1]))


@pytest.mark.parametrize(
    ("units", "low", "center", "want"),
    [
        (("A/m", "T"), -3.0, 0.0, np.tanh(1.5)),  # at zero field, where the loop is open
        (("V", "um"), -3.0, 0.0, 0.0),  # in the middle of the input, at 3 V, where it is closed
        (("A/m", "T"), 0.0, 4.5, np.tanh(1.5)),  # fields of one sign: zero is an end
    ],
)
def test_the_height_of_a_loop_of_unequal_fields_is_that_at_zero_field(units, low, center, want):
    branch = lambda side: lambda u: np.tanh(3 * (u - center - 0.5 * side))
    found = measured_quantities(_two_loops(branch(1.0), branch(-1.0), low, 9.0, units))
    assert found["remanence"] == pytest.approx(want, abs=2e-3)


@pytest.mark.parametrize(("units", "want"), [(("V", "uC"), 0.5), (("A/m", "T"), 1.0)])
def test_a_charge_counted_from_the_start_of_the_record_has_its_width_in_the_middle(units, want):
    """Branches of two slopes: the width is 0.5 in the middle, and 1 at the output of the start, tanh(1.5) below it."""
    loops = _two_loops(lambda u: np.tanh(3 * (u - 0.5)), lambda u: np.tanh(u + 0.5), -8.0, 8.0, units)
    assert measured_quantities(loops)["coercive_input"] == pytest.approx(want, rel=5e-3)


def test_errors_are_the_spread_of_draws_from_the_covariance(fit):
    spread = {name: np.std(values) for name, values in of_draws(fit, drawn(fit, 400)).items()}
    for q in fit.quantities:
        # 3.5 % is one standard deviation of 400 draws
        assert q.stderr == pytest.approx(spread[q.name], rel=0.15), q.name


def test_errors_of_many_weights_are_the_spread_of_their_draws():
    u = np.concatenate([np.linspace(0, 1, 60), np.linspace(1, -1, 90), np.linspace(-1, 1, 90), np.linspace(1, 0, 60)])
    truth = hf.PrandtlIshlinskii.of(50)
    y = np.asarray(hf.simulate(truth, u)[0])
    y = y + 0.01 * np.ptp(y) * np.random.default_rng(1).normal(size=u.size)
    many = hf.fit(hf.PrandtlIshlinskii.of(50), hf.Record(u=u, y=y, u_unit="V", y_unit="um"), noise="iid")
    assert len(many.x) > 40
    spread = of_draws(many, drawn(many, 300))
    found = {q.name: q for q in many.quantities}
    for name in ("loop_area", "remanence", "stroke"):
        assert found[name].stderr == pytest.approx(np.std(spread[name]), rel=0.2), name


def test_a_quantity_is_determined_where_its_parameters_are_not(fit, record):
    """Both parts are a multiple of the input: the data determine only the sum of their slopes."""
    straight = hf.BoucWen(c=0.2, mu=0.0, tau=1.0, rho=0.0)
    fixed = [f"bouc_wen2.{name}" for name in ("mu", "tau", "rho", "offset")]
    twice = hf.fit(hf.Sum(TRUTH, straight), record, starts=1, noise="iid", fix=fixed)
    assert [p.name for p in twice.parameters if p.identifiable is False], "the slopes are separated"
    single = {q.name: q for q in fit.quantities}
    for q in twice.quantities:
        assert q.value == pytest.approx(single[q.name].value, rel=1e-3)
        assert q.stderr == pytest.approx(single[q.name].stderr, rel=0.1)


def test_creep_a_decade_has_the_value_and_error_of_the_closed_form():
    T, dt, tau = 400, 0.05, 3.0
    model = hf.Sum(hf.BoucWen(c=1.0, mu=0.0, tau=1.0, rho=0.0), hf.LinearCreep(a=(0.2,), tau=(tau,)))
    u = np.sin(2 * np.pi * np.arange(T) / 100)
    y = np.asarray(hf.simulate(model, u, dt)[0]) + 1e-3 * np.random.default_rng(0).normal(size=T)
    fixed = [name for name in hf.ParameterSpace.of(model).names if not name.startswith("a[")]
    data = hf.Record(u=u, y=y, t=dt * np.arange(T), u_unit="V", y_unit="um")
    creeping = hf.fit(model, data, fix=fixed, start="model", starts=1, noise="iid")
    found = {q.name: q for q in creeping.quantities}["creep_percent_per_decade"]
    part = creeping.model.parts[1]
    size, (a,), ((variance,),) = float(part.high - part.low), creeping.x, creeping.covariance
    rise = lambda t: -np.expm1(-t / tau) / size  # of the unit step, for a = 1
    decade, start = 100 * (rise(10.0) - rise(1.0)), rise(1.0)
    assert found.value == pytest.approx(decade * a / (1 + a * start), rel=0.02)
    assert found.stderr == pytest.approx(decade / (1 + a * start) ** 2 * np.sqrt(variance), rel=0.03)


def test_the_cycle_of_a_model_with_time_lasts_as_long_as_that_of_the_record():
    t = np.arange(1000) / 50.0
    data = hf.Record(u=np.sin(2 * np.pi * t / 4), y=np.zeros(t.size), t=t)
    excitation = Excitation.of(hf.Dataset.of(data))
    assert excitation.interval * excitation.points == pytest.approx(4.0)


def test_the_remanence_of_a_fit_is_read_between_the_samples_of_the_record():
    """The height of a loop is largest at zero field, about which a cycle of 162 samples has two, 0.1 widths of the transition away."""
    h = np.concatenate([np.linspace(0, 20, 41), np.linspace(20, -20, 81), np.linspace(-20, 20, 81)])
    turned = np.repeat([-0.85, 0.85, -0.85], [41, 81, 81])
    data = hf.Record(u=h, y=3.2 * np.tanh((h + turned) / 2.5), t=7.3 * np.arange(h.size), u_unit="kOe", y_unit="memu")
    result = hf.fit("preisach-magnetic:n=48:degree=1", data)
    assert quantity_values(result)["remanence"] == pytest.approx(3.2 * np.tanh(0.85 / 2.5), rel=3e-3)


def test_the_steady_loop_behind_a_lag_is_that_of_the_fit_on_its_record():
    """A lag of three samples acts at the sampling rate of the record: at four times that rate the loop would be wider."""
    t = np.arange(501) / 100
    u = np.sin(2 * np.pi * t)
    device = hf.Series(hf.Lag(tau=0.03, rest="first"), TRUTH)
    y = np.asarray(hf.simulate(device, u, 0.01)[0])
    fit = hf.fit(device, hf.Record(u=u, y=y, t=t), start="model", starts=1, noise="iid")
    cycle = fit.predict(fit.data[0])[-101:]
    assert quantity_values(fit)["loop_area"] == pytest.approx(loop_area(u[-101:], cycle), rel=2e-3)


@pytest.mark.parametrize(("wave", "loss"), [(hf.signals.sine, np.pi**2 * 2), (hf.signals.triangle, 16.0)])
def test_the_steady_loop_has_the_waveform_of_the_record(wave, loss):
    """A dashpot c dissipates 2 pi^2 c A^2 / T in a cycle of a sine, and 16 c A^2 / T in one of a triangle."""
    c, size, period = 0.3, 1.5, 2.0
    t, u = wave(7.0, 200, frequency=1 / period, low=-size, high=size)
    excitation = Excitation.of(hf.Dataset.of(hf.Record(u=u, y=np.zeros(u.size), t=t)))
    rate = np.diff(excitation.loop.u, prepend=excitation.loop.u[0]) / excitation.interval
    loops = excitation.loops(c * rate[None])
    assert QUANTITIES["loop_area"].of_loops(loops)[0] == pytest.approx(loss * c * size**2 / period, rel=0.01)


def test_the_steady_loop_of_a_model_that_hardens_is_that_at_the_end_of_the_record():
    truth = hf.PrandtlIshlinskii(
        w=[[0.5, 0.8, 0.6]],
        r=(0.05, 0.15, 0.3),
        low=-1.0,
        high=1.0,
        operator="stop",
        hardening=(2.0, 3.0, 2.0),
        s0=10.0,
    )
    u = cycles(12)
    y = np.asarray(hf.simulate(truth, u)[0])
    fit = hf.fit(truth, hf.Record(u=u, y=y, u_unit="mm", y_unit="kN"), starts=1, noise="iid")
    last = slice(u.size - SAMPLES - 1, u.size)
    assert quantity_values(fit)["loop_area"] == pytest.approx(abs(loop_area(u[last], y[last])), rel=0.01)


def test_a_viscous_model_has_no_creep():
    t = np.arange(200) / 50.0
    u = np.sin(2 * np.pi * t)
    y = 2.0 * u + 0.1 * np.gradient(u, t)
    model = hf.Sum(hf.BoucWen(c=2.0, mu=0.0, tau=0.0, rho=0.0), hf.Viscous(c=0.1))
    fixed = [name for name in hf.ParameterSpace.of(model).names if "BoucWen" in name or name in ("mu", "tau", "rho")]
    data = hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="um")
    result = hf.fit(model, data, fix=fixed, start="model", starts=1, noise="iid")
    assert "stroke" in {q.name for q in result.quantities}
    assert "creep_percent_per_decade" not in {q.name for q in result.quantities} | set(quantity_values(result))


@pytest.mark.parametrize(
    ("u", "y", "kind"),
    [
        ("A/m", "T", LoopKind.MAGNETIC),
        ("Oe", "emu", LoopKind.MAGNETIC),
        ("kV/cm", "uC/cm2", LoopKind.FERROELECTRIC),
        ("V", "um", LoopKind.ACTUATOR),
        ("A", "mrad", LoopKind.ACTUATOR),
        ("mT", "mdeg", LoopKind.MAGNETIC),
        ("mm", "kN", LoopKind.DISPLACEMENT_DRIVEN),
        ("N", "mm", LoopKind.FORCE_DRIVEN),
        ("", "", LoopKind.OTHER),
    ],
)
def test_units_decide_which_quantities_there_are(u, y, kind):
    data = hf.Dataset.of(hf.Record(u=np.array([0.0, 1.0]), y=np.array([0.0, 1.0]), u_unit=u, y_unit=y))
    assert LoopKind.of(data) is kind
    structural = kind in (LoopKind.DISPLACEMENT_DRIVEN, LoopKind.FORCE_DRIVEN)
    names = set(applicable(data, timed=False))
    assert {"loop_area", "coercive_input", "remanence", "hysteresis_percent", "stroke"} <= names
    assert ({"secant_stiffness", "equivalent_damping_percent"} <= names) == structural
    assert "creep_percent_per_decade" in applicable(data, timed=True)
    stiffness = QUANTITIES["secant_stiffness"].units(data)
    assert stiffness == {LoopKind.DISPLACEMENT_DRIVEN: "kN/mm", LoopKind.FORCE_DRIVEN: "N/mm"}.get(kind, stiffness)


def test_the_loss_is_an_energy_where_the_units_tell_it():
    """Oe and emu/g: 1e-4 T times A m2/kg is 1e-4 J/kg, as of the loops read without a model."""
    x = np.linspace(0, 6 * np.pi, 1201)
    data = hf.Dataset.of(hf.Record(50 * np.sin(x), 3 * np.sin(x - 0.5), u_unit="Oe", y_unit="emu/g"))
    assert QUANTITIES["loop_area"].units(data) == "J/kg"
    assert measured_quantities(data)["loop_area"] == pytest.approx(1e-4 * np.pi * 150 * np.sin(0.5), rel=1e-3)


def test_an_area_has_no_unit_where_one_column_has_none():
    """That of the other column stays for heights and ranges, also where it is a ratio."""
    x = np.linspace(0, 6 * np.pi, 1201)
    data = hf.Dataset.of(hf.Record(15 * np.sin(x), 30 * np.sin(x - 0.5), u_name="Drive voltage", y_unit="uC/cm2"))
    units = {name: one.units(data) for name, one in QUANTITIES.items()}
    assert (units["loop_area"], units["stroke"], units["remanence"], units["coercive_input"]) == (
        "",
        "uC/cm2",
        "uC/cm2",
        "",
    )
    read = {one.name: one.unit for one in quantities(data).rows["record"]}
    assert (read["loop_area"], read["stroke"]) == ("", "uC/cm2")


def test_gaps_have_their_reason(fit):
    no_error = dataclasses.replace(fit, joint=None)
    assert {q.reason for q in no_error.quantities} == {Unknown.NO_ERRORS}
    assert all(q.value is not None and q.stderr is None for q in no_error.quantities)
    unseen = fit.joint.copy()
    unseen[fit.free_names.index("tau")] = unseen[:, fit.free_names.index("tau")] = np.nan
    found = {q.name: q for q in dataclasses.replace(fit, joint=unseen).quantities}
    assert found["loop_area"].reason is Unknown.NOT_DETERMINED
    assert found["loop_area"].to_dict() == {
        "value": None, "stderr": None, "unit": "J", "reason": "not-determined", "measured": fit.quantities[0].measured,
        "measured_stderr": fit.quantities[0].measured_stderr, "differs": False,
    }  # fmt: skip
    loose = dataclasses.replace(fit, joint=1e10 * fit.joint)
    assert {q.reason for q in loose.quantities if q.name == "remanence"} == {Unknown.NOT_DETERMINED}


def test_quantities_are_lazy_and_in_every_form_of_the_result(fit, tmp_path):
    again = dataclasses.replace(fit)
    assert "quantities" not in vars(again)
    fit.save(tmp_path / "fit")
    loaded = hf.load_fit(tmp_path / "fit")
    for ours, theirs in zip(fit.quantities, loaded.quantities, strict=True):
        assert theirs.value == pytest.approx(ours.value, rel=1e-9)
        assert theirs.stderr == pytest.approx(ours.stderr, rel=1e-6)
    assert fit.to_dict()["quantities"]["loop_area"] == fit.quantities[0].to_dict()
    assert quantity_values(fit) == pytest.approx({q.name: q.value for q in fit.quantities})
    for page in (text_report(fit), html_report(fit)):
        assert "equivalent damping" in page
        assert "secant stiffness" in page


def test_a_measured_magnetic_loop_has_its_coercivity_and_loss():
    if not os.environ.get("HYSTFIT_DATA"):
        pytest.skip("HYSTFIT_DATA does not name the folder of measured data")
    folder = Path(os.environ["HYSTFIT_DATA"]) / "tidy"
    data = hf.read_csv(folder / "mag_bh_M130_27s.csv", by="loop")
    largest = data[2]
    found = {q.name: q for q in hf.fit("preisach-magnetic", data).quantities}
    crossing = np.flatnonzero(np.diff(np.signbit(largest.y)))
    zeros = [np.interp(0.0, *sorted_pair(largest, k)) for k in crossing]
    coercive = 0.5 * (max(zeros) - min(zeros))
    # the model is wrong by 3 % of the range where the steep branches cross zero
    assert found["coercive_input"].value == pytest.approx(coercive, rel=0.1)
    assert found["loop_area"].value == pytest.approx(abs(loop_area(largest.u, largest.y)), rel=0.02)


def sorted_pair(record: hf.Record, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and inputs of two neighboring samples, by rising output."""
    order = np.argsort(record.y[k : k + 2])
    return record.y[k : k + 2][order], record.u[k : k + 2][order]


COARSE = {"three samples a half cycle of a sine": (60, 2.9, 0.15), "six of a triangle": (37, 6.0, 0.25)}


def coarse_record(kind: str) -> tuple[hf.Record, dict[str, float]]:
    """A loop of plays behind a saturation at few samples, and the values of its steady loop, by dense simulation in NumPy."""
    count, half, width = COARSE[kind]
    phase = np.arange(count) / half
    corners = np.sin(np.pi * phase) if "sine" in kind else 4 * np.abs((0.5 * phase) % 1 - 0.5) - 1
    radii = width * np.linspace(0.2, 1.8, 21)

    def plain(u: np.ndarray) -> np.ndarray:
        p, out = u[0] - radii, []
        for x in u:
            p = np.clip(p, x - radii, x + radii)
            out.append(np.tanh(3 * p).mean())
        return np.array(out)

    dense = np.interp(np.arange(100 * (count - 1) + 1) / 100, np.arange(count), corners)
    record = hf.Record(500 * corners, 1.2 * plain(dense)[::100], u_unit="A/m", y_unit="T", u_name="H", y_name="B")
    edge = np.linspace(-1, 1, 1001) * np.abs(corners).max()
    u = np.concatenate([edge, edge[::-1], edge])
    falling, rising = plain(u)[1001:2002][::-1], plain(u)[2002:]
    truth = {"loop_area": 600 * np.trapezoid(falling - rising, edge), "remanence": 0.6 * (falling - rising)[500]}
    truth["coercive_input"] = 250 * float(np.interp(0, rising, edge) - np.interp(0, falling, edge))
    return record, truth


@pytest.mark.parametrize("kind", COARSE)
def test_the_errors_of_a_coarse_loop_include_what_lies_between_its_samples(kind: str) -> None:
    """The model and the straight lines between the samples are both right at the samples alone."""
    record, truth = coarse_record(kind)
    found = {one.name: one for one in hf.fit("preisach-magnetic:n=6", record, noise="iid").quantities}
    for name, true in truth.items():
        value, error = found[name].value, found[name].stderr
        assert value is not None, name
        assert error is not None, name
        assert abs(value - true) < max(3 * error, 1e-6 * true), name
        assert error < true, name
    assert not any(one.differs for one in found.values())


def test_the_error_of_a_finely_sampled_loop_is_that_of_its_parameters(fit: hf.FitResult) -> None:
    errors = {one.name: one.stderr for one in fit.quantities}
    scatter = {name: float(np.std(values)) for name, values in of_draws(fit, drawn(fit, 300)).items()}
    assert errors["loop_area"] == pytest.approx(scatter["loop_area"], rel=0.25)


def test_the_width_of_a_film_on_a_diamagnetic_substrate_is_that_of_its_step():
    """The slope of the substrate takes the output through the middle near both ends also."""
    u = np.linspace(-20, 20, 801)
    film = lambda side: 0.25 * np.tanh((u - 0.11 * side) / 0.16) - 0.045 * u
    loops = SteadyLoops(u, film(1.0)[None], film(-1.0)[None])
    assert loops.coercive_input == pytest.approx(
        [0.11], rel=0.2
    )  # 0.117 with the slope, and 0.06 between the outer crossings


def test_a_pinched_loop_has_no_width_where_its_branches_cross():
    """A memristor: both branches pass zero, between lobes that run in opposite directions."""
    u = np.linspace(-1, 1, 401)
    loops = SteadyLoops(u, (u + 0.3 * np.sin(np.pi * u))[None], (u - 0.3 * np.sin(np.pi * u))[None])
    assert loops.lobed.all()
    assert np.isnan([loops.coercive_input[0], loops.remanence[0], loops.loss[0]]).all()


def test_the_answer_of_a_curve_gives_the_measured_loop_first():
    """A model without a loop has the half width 0, which is not that of the device."""
    phase = np.linspace(0, 4 * np.pi, 321)
    result = hf.fit("curve:knots=4", hf.Record(np.cos(phase), np.cos(phase - 0.1), u_unit="V", y_unit="V"))
    assert float(dict(result.answer)["Half width"].split()[0]) == pytest.approx(np.sin(0.1), rel=0.02)


def test_no_damping_ratio_is_above_the_critical_damping():
    """Of a spring k and a damper of loss factor h it is h / 2."""
    phase = np.linspace(-np.pi / 2, np.pi / 2, 401)
    u = np.sin(phase)
    made = lambda h: SteadyLoops(u, (u + h * np.cos(phase))[None], (u - h * np.cos(phase))[None], stiffness=1000.0)
    assert made(1.8).damping_percent == pytest.approx([90.0], rel=1e-4)
    assert np.isnan(made(2.2).damping_percent).all()
    assert made(2.2).secant_stiffness == pytest.approx([1000.0])


def test_the_slope_of_a_substrate_is_named():
    h = np.concatenate([np.linspace(20, -20, 801), np.linspace(-20, 20, 801)[1:]])
    side = np.repeat([1.0, -1.0], [801, 800])
    record = lambda slope: hf.Record(
        h,
        0.25 * np.tanh((h + 0.11 * side) / 0.16) + slope * h,
        u_unit="kOe",
        y_unit="emu",
        u_name="Field",
        y_name="Moment",
    )
    named = lambda slope, **correct: [
        note
        for notes in quantities(record(slope), **correct).notes.values()
        for note in notes
        if "diamagnetic" in note.text
    ]
    assert named(-0.045)
    assert not named(0.045)
    assert not named(-0.045, correct=("slope",))


def test_an_output_that_rises_to_the_largest_field_has_no_substrate():
    """The law of approach bends down along a branch that follows no such law: its slope is negative, and the output rises."""
    h = np.concatenate([np.linspace(10e3, -10e3, 61), np.linspace(-10e3, 10e3, 61)[1:]])
    side = np.repeat([1.0, -1.0], [61, 60])
    noise = np.random.default_rng(1).normal(0, 0.02, h.size)
    record = hf.Record(
        h, 25 * np.tanh((h + 300 * side) / 3000) + noise, u_unit="Oe", y_unit="emu/g", u_name="Field", y_name="Moment"
    )
    assert not any("diamagnetic" in note.text for note in quantities(record).notes["record"])


def test_the_slope_of_a_substrate_is_removed_where_fields_are_set_in_equal_ratios():
    """Six fields are above a third of the largest one, as a superconducting magnet is driven in steps of 20 %."""
    half = 70e3 * 0.8 ** np.arange(34)
    down = np.concatenate([half, [0.0], -half[::-1]])
    h, side = np.append(down, down[::-1]), np.repeat([1.0, -1.0], down.size)
    noise = np.random.default_rng(0).normal(0, 2e-8, h.size)
    made = lambda film: hf.Record(
        h, film - 6e-9 * h + noise, u_unit="Oe", y_unit="emu", u_name="Field", y_name="Moment"
    )
    record = made(2.7e-6 * np.tanh((h + 42 * side) / 300))
    assert any("--correct slope" in note.text for note in quantities(record).notes["record"])
    raw = {one.name: one for one in quantities(record).rows["record"]}
    for branch, sign in (
        ("", 1),
        ("_rising", 1),
        ("_falling", -1),
    ):  # with the slope, a rising branch passes zero first
        one = raw[f"coercive_input{branch}"]
        assert one.value == pytest.approx(sign * 42, abs=3 * one.stderr)
        assert one.stderr < 10
        assert one.label.endswith("without the slope")
    corrected = {one.name: one for one in quantities(record, correct=("slope",)).rows["record"]}
    assert corrected["Js"].value == pytest.approx(2.7e-6, rel=0.05)
    assert corrected["Js"].spread < 0.1 * 2.7e-6  # a law without the slope is none of the laws of this loop
    ratio = corrected["squareness"]
    assert ratio.value == pytest.approx(np.tanh(42 / 300), abs=3 * ratio.stderr)
    assert ratio.stderr > 0.5 * ratio.value * 2e-8 / (2.7e-6 * np.tanh(42 / 300))  # the remanence has noise too
    film = Sample(volume=1e-12)
    assert not {"HcJ", "HcB"} & {one.name for one in quantities(record, sample=film).rows["record"]}
    known = {one.name: one for one in quantities(record, sample=film, correct=("slope",)).rows["record"]}
    assert known["HcJ"].value == pytest.approx(42e3 / (4 * np.pi) * 1e-3, abs=3 * known["HcJ"].stderr)
    unsettled = made(2.7e-6 * np.tanh((h + 2e4 * side) / 4e4))  # the largest field does not saturate this film
    assert "Js" not in {one.name for one in quantities(unsettled, correct=("slope",)).rows["record"]}


def test_a_small_loop_inside_a_measured_branch_does_not_change_its_width():
    """Soil that is dried, wetted to the middle of its water and dried on, over a suction of which both are a small part."""
    main = lambda u, half: 1 / (1 + (u / half) ** 6)
    parts = [
        np.linspace(0, 2.6, 200),
        np.linspace(2.6, 1.0, 200)[1:],
        np.linspace(1.0, 2.6, 200)[1:],
        np.linspace(2.6, 50, 4000)[1:],
    ]
    wetting = np.linspace(50, 0, 6000)[1:]
    inside = lambda u: np.interp(u, [1.0, 2.6], [0.6, main(2.6, 1.5)])
    dried = [main(parts[0], 1.5), inside(parts[1]), inside(parts[2]), main(parts[3], 1.5)]
    record = hf.Record(np.concatenate([*parts, wetting]), np.concatenate([*dried, main(wetting, 0.5)]), u_unit="kPa")
    assert measured_quantities(Dataset.of(record))["coercive_input"] == pytest.approx(0.5, rel=0.02)


def test_an_even_output_has_no_width_and_no_loss() -> None:
    """Magnetoresistance and strain: the branches end where they begin, and the lobes of the loop run in opposite directions."""
    phase = np.linspace(0, 2 * np.pi, 401)
    u, rises = 2.0 * np.cos(phase), np.sin(phase) < 0
    polarization = np.tanh((u - np.where(rises, 0.6, -0.6)) / 0.2)
    strain = 0.12 * polarization**2 + 1e-3 * np.random.default_rng(1).normal(size=u.size)
    names = {row.name for row in quantities(hf.Record(u, strain, u_unit="kV/mm", y_unit="%")).rows["record"]}
    assert not names & {"coercive_input", "remanence", "loop_area"}
    measured = measured_quantities(hf.Dataset.of(hf.Record(u, strain)))
    assert not {"coercive_input", "remanence", "loop_area"} & measured.keys()
    widest = (
        np.abs(np.diff(np.tanh((u[:201, None] + [0.6, -0.6]) / 0.2) ** 2, axis=1)).max() * 0.12
    )  # of the two branches
    assert measured["hysteresis_percent"] == pytest.approx(100 * widest / np.ptp(strain), abs=3)
    odd = measured_quantities(hf.Dataset.of(hf.Record(u, polarization)))
    assert odd["coercive_input"] == pytest.approx(0.6, abs=1e-3)
    assert odd["remanence"] == pytest.approx(np.tanh(3.0), abs=1e-3)


@pytest.mark.parametrize(
    ("u", "y", "names"),
    [
        ("V", "um", {"half width", "half height", "hysteresis (of the stroke)", "stroke"}),
        ("mm", "kN", {"half width", "half height", "hysteresis (of the range)", "range of the output"}),
        ("A/m", "T", {"coercivity (half width)", "remanence (half height)", "range of the output"}),
    ],
)
def test_quantities_have_the_names_of_their_field(u: str, y: str, names: set[str]) -> None:
    data = hf.Dataset.of(hf.Record(u=np.array([0.0, 1.0]), y=np.array([0.0, 1.0]), u_unit=u, y_unit=y))
    assert names <= {one.label_on(data) for one in QUANTITIES.values()}


def test_the_report_says_how_long_a_cycle_lasts_where_time_matters() -> None:
    t = np.linspace(0, 3.0, 601)
    u = np.sin(4 * np.pi * t)
    result = hf.fit("bouc-wen+viscous", hf.Record(u, hf.BoucWen.free_run(TRUTH, u, None) + 0.01 * np.gradient(u, t), t))
    assert "fitted input range, one cycle in 0.5 s" in text_report(result)
    assert "one cycle in" not in text_report(hf.fit("bouc-wen", hf.Record(u, hf.BoucWen.free_run(TRUTH, u, None), t)))


def test_the_largest_height_of_a_noisy_loop_is_within_its_error() -> None:
    """Noise widens a narrow loop where it is read at its widest: half the range of a backlash of half width 4 in 56."""
    phase = np.linspace(-0.5 * np.pi, 3.5 * np.pi, 801)
    u = 28 * np.sin(phase)
    p = np.empty_like(u)
    p[0] = u[0] + 4
    for k in range(1, u.size):
        p[k] = min(max(p[k - 1], u[k] - 4), u[k] + 4)
    record = hf.Record(u, 0.2 * p + 0.035 * np.random.default_rng(7).normal(size=u.size), u_unit="deg", y_unit="deg")
    result = hf.fit("prandtl-ishlinskii", record)
    (height,) = (one for one in result.quantities if one.name == "hysteresis_percent")
    exact = 100 * 0.2 * 8 / (0.2 * 48)
    assert height.measured is not None
    assert height.measured_stderr is not None
    assert height.measured > exact + 0.5  # the bias by noise
    assert abs(height.measured - exact) < 2 * height.measured_stderr
    assert not height.differs


def test_an_input_switched_between_two_values_has_no_quantities_of_a_loop() -> None:
    """The heater of a thermostat drives the temperature through a lag: what it does in between was not measured."""
    t = np.arange(0, 300.0)
    heater = (np.sin(2 * np.pi * t / 80) > 0).astype(float)
    data = hf.Dataset.of(hf.Record(heater, 20 + 3 * np.sin(2 * np.pi * t / 80), t, y_unit="degC"))
    assert applicable(data, timed=True) == ("creep_percent_per_decade",)
    assert not any(quantities(data).rows.values())
    ramps = hf.Dataset.of(hf.Record(np.interp(t, [0, 75, 150, 225, 299], [0, 1, 0, 1, 0]), data[0].y, t, y_unit="degC"))
    assert "coercive_input" in applicable(ramps, timed=True)


def test_the_steady_loop_of_a_slow_relaxation_is_settled():
    """A Maxwell element of stiffness k dissipates pi k A^2 wt / (1 + (wt)^2) in a steady cycle, however long it takes to get there."""
    k, tau, period, size = 0.3, 4.0, 2.0, 20.0
    t = np.arange(0, 12, 0.02)
    data = hf.Record(u=size * np.sin(2 * np.pi * t / period), y=np.zeros(t.size), t=t, u_unit="mm", y_unit="kN")
    excitation = Excitation.of(Dataset.of(data))
    force = np.zeros(len(excitation.loop))
    decay = np.exp(-excitation.interval / tau)
    for i, step in enumerate(np.diff(excitation.loop.u), start=1):
        force[i] = decay * force[i - 1] + k * step * (1 - decay) * tau / excitation.interval
    turn = 2 * np.pi * tau / period
    loss = np.pi * k * size**2 * turn / (1 + turn**2)
    assert QUANTITIES["loop_area"].of_loops(excitation.loops(force[None]))[0] == pytest.approx(loss, rel=0.01)


@pytest.mark.parametrize(("tau", "size"), [(0.05, 0.02), (0.1, 0.02)])
def test_creep_behind_a_lag_is_that_of_the_device(tau, size):
    model = hf.Series(hf.Lag(tau=tau, rest="first"), hf.LogCreep(gamma=(size,)))
    record = hf.Record(np.sin(np.arange(400) / 20), np.zeros(400), 0.01 * np.arange(400), u_unit="V", y_unit="um")
    step = Excitation.of(Dataset.of(record)).step
    found = Excitation.creep(np.asarray(hf.simulate(model, step.u, step.dt)[0])[None])[0]
    assert found == pytest.approx(100 * size, rel=0.1)


def test_a_lag_is_no_creep():
    t = np.arange(400) / 2.0
    u = 50 + 40 * np.sin(2 * np.pi * t / 50)
    y = np.asarray(hf.simulate(hf.Series(hf.Lag(tau=1.3, rest="first"), hf.Linear(k=1.0)), u, 0.5)[0])
    model = hf.Series(hf.Lag(tau=1.0, rest="first"), hf.Linear(k=1.0))
    result = hf.fit(model, hf.Record(u, y + 0.01 * np.sin(1e3 * t), t), start="model", starts=1, noise="iid")
    assert "stroke" in {q.name for q in result.quantities}
    assert "creep_percent_per_decade" not in {q.name for q in result.quantities} | set(quantity_values(result))


def test_measured_loops_beside_the_steady_loop_have_its_rate():
    """A chirp through a viscous element, whose loops widen with the frequency: the steady loop lasts as long as the usual cycle."""
    t = np.arange(4000) / 2000
    phase = 2 * np.pi * np.cumsum(2 + 9 * t) / 2000
    u = 60 - 60 * np.cos(phase)
    rate = np.gradient(u, t)
    data = Dataset.of(hf.Record(u, 0.1 * u + 2e-4 * rate, t, u_unit="V", y_unit="um"))
    excitation = Excitation.of(data)
    step = np.gradient(excitation.loop.u, excitation.interval)
    steady = excitation.loops((0.1 * excitation.loop.u + 2e-4 * step)[None])
    assert measured_quantities(data)["loop_area"] == pytest.approx(float(steady.area[0]), rel=0.1)


def test_noise_has_no_measured_loop_and_no_loop_is_found_in_it():
    edge = np.linspace(-5, 5, 101)
    u = np.append(np.tile(np.concatenate([edge[:-1], edge[:0:-1]]), 3), -5)
    record = hf.Record(u, np.random.default_rng(25).normal(size=u.size), u_unit="mT", y_unit="V")
    result = hf.fit("bouc-wen", record, starts=1)
    assert result.status == "no-loop"
    assert all(q.measured is None for q in result.quantities)
    assert "e+02" not in str(result)


def test_the_range_of_one_large_branch_is_that_of_its_loop():
    """Friction with growing strokes: the only branch over the whole range begins at the force of the reversal."""
    t = np.arange(0, 8, 0.004)
    u = 6 * np.sin(2 * np.pi * 0.25 * t) * np.minimum(1, 0.2 + t / 8)
    v = np.gradient(u, t)
    y = 3 * np.tanh(v / 0.3) + 0.4 * v + 0.01 * np.random.default_rng(4).normal(size=t.size)
    found = quantities(hf.Record(u, y, t, u_unit="mm", y_unit="N")).rows["record"]
    assert {one.name: one.value for one in found}["stroke"] == pytest.approx(np.ptp(y), rel=0.05)


def test_a_cycle_that_does_not_come_back_has_an_error_that_covers_its_loop():
    """Strokes that grow to the last, elastic-plastic: the largest branches enclose no whole loop, and one of them is shorter."""
    u = np.concatenate([a * np.sin(np.linspace(0, 2 * np.pi, 121)[:-1]) for a in (0.4, 0.6, 0.8, 1.0, 1.2)])
    whole = 1.2 * np.sin(np.linspace(0, 4 * np.pi, 241))

    def force(path):
        plastic, out = 0.0, []
        for x in path:
            size = 2000 * (x - plastic) - 100 * plastic
            if abs(size) > 250:
                plastic += np.sign(size) * (abs(size) - 250) / 2100
            out.append(2000 * (x - plastic))
        return np.array(out)

    y = force(u) + 2 * np.random.default_rng(36).normal(size=u.size)
    found = {one.name: one for one in quantities(hf.Record(u, y, u_unit="mm", y_unit="kN")).rows["record"]}
    steady = force(whole)[120:]
    loss = abs(loop_area(whole[120:], steady))
    stiffness = (steady.max() - steady.min()) / 2.4
    for name, truth in (("loop_area", loss), ("secant_stiffness", stiffness)):
        assert found[name].value == pytest.approx(truth, abs=3 * found[name].stderr), name


def test_a_vague_value_of_the_model_stands_behind_that_of_the_measured_loops():
    vague = QuantityEstimate("loop_area", 1010.0, 840.0, "J")
    assert vague.vaguer_than(11.0)
    assert not dataclasses.replace(vague, stderr=10.5).vaguer_than(11.0)
    assert not dataclasses.replace(vague, stderr=15.0).vaguer_than(11.0)  # 1.5 % of the value
    assert not dataclasses.replace(vague, measured=1000.0).vaguer_than(11.0)
    assert not vague.vaguer_than(None)


def test_thresholds_of_relays_have_the_error_of_the_cell_in_which_they_lie() -> None:
    """Four switches with thresholds anywhere in cells of 1 V: the half width was off by ten of its standard errors (rms)."""
    t = np.arange(0, 20, 0.02)
    u = 12 * np.sin(0.4 * np.pi * t) * np.where(t < 10, 1.0, 0.75)
    off = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        up, down = rng.uniform(2, 6), -rng.uniform(2, 6)
        on, y = -1.0, np.empty(t.size)
        for k, x in enumerate(u):
            on = 1.0 if x >= up else -1.0 if x <= down else on
            y[k] = 2.5 * on
        result = hf.fit("preisach", hf.Record(u, y + rng.normal(0, 0.05, t.size), u_unit="V", y_unit="N"))
        one = next(q for q in result.quantities if q.name == "coercive_input")
        assert one.value is not None
        assert one.stderr is not None
        off.append((one.value - (up - down) / 2) / one.stderr)
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 2.0


def test_a_width_read_through_noise_is_not_preferred_to_that_of_the_model():
    """At a noise of 10 % of the range, single samples near the middle make the measured loop narrower and lower."""
    u = 5 * np.sin(2 * np.pi * np.arange(1200) / 400)
    y = np.asarray(hf.simulate(hf.BoucWenForce(kappa_x=0.2, kappa_w=8.0, rho=1.25), u)[0])
    noisy = y + 0.1 * np.ptp(y) * np.random.default_rng(5).normal(size=u.size)
    result = hf.fit("prandtl-ishlinskii-stop", hf.Record(u=u, y=noisy, u_unit="mm", y_unit="N"))
    found = {one.name: one for one in result.quantities}
    true = measured_quantities(Dataset.of(hf.Record(u=u, y=y)))
    for name in ("coercive_input", "remanence"):
        one = found[name]
        assert abs(one.value - true[name]) < 3 * one.stderr
        assert one.measured is None  # read from single samples, it would have no error
        assert not one.differs


def test_a_butterfly_from_zero_has_a_range_and_no_ratio_to_the_distance_of_its_ends():
    """Both ends have one output: the damping ratio would be divided by zero, in silence."""
    phase = 2 * np.pi * np.arange(401) / 400
    u = 5 * np.sin(phase)
    y = np.tanh((u - np.where(np.cos(phase) >= 0, 1.1, -1.1)) / 0.8) ** 2
    with np.errstate(all="raise"):
        found = measured_quantities(Dataset.of(hf.Record(u=u, y=y)))
    assert found["stroke"] == pytest.approx(1.0, abs=1e-3)
    assert "equivalent_damping_percent" not in found


def test_measured_loops_at_one_of_several_rates_in_a_record_are_those_of_the_steady_loop() -> None:
    """Of an output that follows the input by 3 ms, 10 cycles at 20 Hz and 8 at 50 Hz: the loops differ by a factor of two."""
    rate, counts = 2000.0, {1.0: 2, 5.0: 4, 20.0: 10, 50.0: 8}
    pieces = [np.arange(round(rate * count / f)) * f / rate for f, count in counts.items()]
    frequency = np.repeat([*counts], [piece.size for piece in pieces])
    phase = 2 * np.pi * np.concatenate(pieces)
    u, y = 75 - 75 * np.cos(phase), 75 - 75 * np.cos(phase - 2 * np.pi * frequency * 0.003)
    data = hf.Dataset((hf.Record(u, y, t=np.arange(u.size) / rate, u_unit="V", y_unit="um"),))
    steady = Excitation.of(data)
    assert steady.interval * steady.points == pytest.approx(0.05, rel=1e-3)
    assert measured_quantities(data)["remanence"] == pytest.approx(75 * np.sin(2 * np.pi * 20 * 0.003), rel=0.02)


def test_a_narrow_loop_that_starts_from_rest_is_no_steady_loop() -> None:
    """Plays from rest at 0: after the first rise the output ends 3 % of its range above the start, and half the height of the loop."""
    u = np.interp(np.arange(601), [0, 100, 200, 300, 400, 500, 600], [0.0, 10.0, 0.0, 10.0, 0.0, 10.0, 0.0])
    y, p = np.zeros(u.size), 0.0
    for k, value in enumerate(u):
        p = max(value - 0.5, min(value + 0.5, p))
        y[k] = p + 0.5 * value
    record = hf.Record(u, y, u_unit="V", y_unit="um")
    assert measured_quantities(hf.Dataset((record.window(None, 201.0),))) == {}
    assert measured_quantities(hf.Dataset((record,)))["loop_area"] == pytest.approx(9.0, rel=1e-3)
