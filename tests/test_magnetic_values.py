"""Data-sheet quantities of magnetic and ferroelectric loops: closed forms, units, corrections, instruments' own results."""

import itertools

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

import hystfit as hf
from hystfit.outcome import Code, Status
from hystfit.results.measured.loop_values import quantities
from hystfit.results.measured.magnetic_sample import Sample, prism_factor

MU0 = 4e-7 * np.pi
JS, HC, WIDTH, SIZE = 1.1, 400e3, 120e3, (2e-3, 2e-3, 4e-3)


def branch(h):
    """Falling branch of a hard magnet [T]."""
    return JS * np.tanh((h + HC) / WIDTH)


def loop(turn=2.4e6, count=1201):
    """Internal field [A/m] and polarization [T], both branches from the positive tip."""
    h = np.linspace(turn, -turn, count)
    falling, rising = branch(h), -branch(-h[::-1])
    return np.append(h, h[::-1]), np.append(falling, rising)


def values_of(record, **options):
    found = quantities(record, **options)
    return {one.name: one for one in found.rows[record.name]}


def magnet(h, j, factor=0.0, noise=0.0, **labels):
    """The loop as a magnetometer of moments measures it, in the units of the labels."""
    m = j / MU0 * np.prod(SIZE)
    applied = h + factor * j / MU0
    labels = {"u_unit": "A/m", "y_unit": "A*m2", "u_name": "Field", "y_name": "Moment"} | labels
    scale = {"A/m": 1.0, "Oe": 4e-3 * np.pi, "T": MU0, "kA/m": 1e-3}[labels["u_unit"]]
    size = {"A*m2": 1.0, "emu": 1e3}[labels["y_unit"]]
    return hf.Record(scale * applied, size * m + np.random.default_rng(0).normal(0, noise, m.size), **labels)


def test_a_hard_magnet_has_the_values_of_its_closed_form():
    h, j = loop()
    found = values_of(hf.Record(h, j + MU0 * h, u_unit="A/m", y_unit="T", u_name="H", y_name="B"))
    product = minimize_scalar(lambda h: h * (branch(h) + MU0 * h), bounds=(-HC, 0), method="bounded")
    knee = minimize_scalar(lambda h: (branch(h) - 0.9 * branch(0.0)) ** 2, bounds=(-HC, 0), method="bounded")
    assert found["HcJ"].value == pytest.approx(HC, rel=1e-5)
    assert found["Br"].value == pytest.approx(branch(0.0), rel=1e-5)
    assert found["energy_product"].value == pytest.approx(-1e-3 * product.fun, rel=1e-5)
    assert found["knee_field"].value == pytest.approx(-knee.x, rel=1e-4)
    assert branch(-found["HcB"].value) == pytest.approx(MU0 * found["HcB"].value, rel=1e-3)
    assert found["switching_distribution"].value == pytest.approx(
        2 * np.arccosh(np.sqrt(2)) * WIDTH / HC, rel=2e-2
    )  # of the smoothed derivative
    assert found["loop_area"].value == pytest.approx(
        4 * JS * HC, rel=1e-4
    )  # of two tanh, 2 HC apart, far from the turns
    assert "mu_a" not in found  # of soft materials alone


@pytest.mark.parametrize("u_unit", ["A/m", "Oe", "T", "kA/m"])
@pytest.mark.parametrize("y_unit", ["A*m2", "emu"])
def test_moments_become_polarizations_in_any_units(u_unit, y_unit):
    factor = prism_factor(SIZE)
    record = magnet(*loop(), factor, u_unit=u_unit, y_unit=y_unit)
    found = values_of(record, sample=Sample(size=SIZE))
    field = MU0 if u_unit == "T" else 1.0 if u_unit == "A/m" else 1e-3
    assert found["HcJ"].value == pytest.approx(field * HC, rel=1e-4)
    assert found["Br"].value == pytest.approx(branch(0.0), rel=1e-4)
    assert found["W"].value == pytest.approx(4 * JS * HC, rel=1e-3)
    assert found["loop_area"].value == pytest.approx(4 * JS * HC * np.prod(SIZE), rel=1e-3)  # J, of the whole sample
    stated = values_of(record, sample=Sample(volume=float(np.prod(SIZE)), demagnetization=factor))
    assert stated["energy_product"].value == pytest.approx(found["energy_product"].value)
    assert "Br" not in values_of(record)  # no volume


def test_prisms_have_their_demagnetizing_factors():
    assert prism_factor((1, 1, 1)) == pytest.approx(1 / 3)
    assert sum(prism_factor(p) for p in ((1, 2, 3), (2, 3, 1), (3, 1, 2))) == pytest.approx(1)
    assert prism_factor((1e3, 1e3, 1)) == pytest.approx(1, abs=0.01)
    for bad in ({"size": (1, 0, 1)}, {"demagnetization": 1.2}, {"mass": -1.0}):
        with pytest.raises(hf.HystfitError):
            Sample(**bad)


def test_the_header_tells_the_sample():
    stated = Sample().with_header({"SAMPLE_SIZE": "(1, 2, 3)", "SAMPLE_MASS": "50", "mass (g)": "0.05", "Age": "7"})
    assert stated.size == pytest.approx((1e-3, 2e-3, 3e-3))
    assert stated.mass == pytest.approx(50e-6)
    assert Sample(volume=1.0).with_header({"SAMPLE_SIZE": "(1, 2, 3)"}).size is None


def test_saturation_follows_the_law_of_approach():
    h = np.linspace(3e6, -3e6, 2001)
    approach = lambda h: np.sign(h) * (JS - 3e4 / np.maximum(np.abs(h), 5e5)) + 2e-8 * h
    j = np.append(approach(h), approach(h[::-1])) + np.repeat([1e-3, -1e-3], h.size)
    record = hf.Record(np.append(h, h[::-1]), j, u_unit="A/m", y_unit="T", u_name="H", y_name="J")
    found = values_of(record)
    assert found["Js"].value == pytest.approx(JS, rel=1e-4)
    assert found["Js"].spread > 10 * found["Js"].stderr  # the laws differ by more than the windows of the right one
    slope = next(one for one in quantities(record).corrections["record"] if one.name == "slope")
    assert slope.value == pytest.approx(2e-8 / MU0, rel=1e-3)


def test_a_field_that_does_not_saturate_gives_no_saturation():
    x = np.linspace(0, 2 * np.pi, 801)
    record = hf.Record(100 * np.cos(x), np.cos(x - 0.2), u_unit="A/m", y_unit="T", u_name="H", y_name="B")
    found = quantities(record)
    assert "Js" not in {one.name for one in found.rows["record"]}
    assert Code.EXTRAPOLATION in {note.code for note in found.notes["record"]}


def test_the_error_of_the_loss_counts_noise_that_is_correlated():
    """An autoregression over 30 samples: white noise of the same size would scatter the loss by a tenth."""
    (h, j), kept, found = loop(count=601), np.exp(-1 / 30), []
    for seed in range(40):
        white = np.random.default_rng(seed).normal(0, 0.01 * JS, j.size)
        record = magnet(h, j + lfilter([np.sqrt(1 - kept**2)], [1, -kept], white))
        found.append(values_of(record, sample=Sample(size=SIZE, demagnetization=0.0))["W"])
    assert 0.5 < np.median([one.stderr for one in found]) / np.std([one.value for one in found]) < 2


def test_several_temperatures_or_modes_in_one_record_are_named(tmp_path):
    h, j = loop(turn=2e4, count=101)
    head, row = "H (Oe),M (emu),T (K)", lambda a, b, T: f"{a:.6g},{(T / 300) * b:.6g},{T}"
    rows = [row(a, b, 300 if k < 50 else 100) for k, (a, b) in enumerate(zip(h, j, strict=True))]  # within a branch
    (tmp_path / "steps.csv").write_text("\n".join([head, *rows, ""]))
    rows = [row(a, b, T) for T in (300, 100) for a, b in zip(h, j, strict=True)]
    (tmp_path / "loops.csv").write_text("\n".join([head, *rows, ""]))
    (tmp_path / "modes.csv").write_text(
        "\n".join(["H (Oe),M (emu),M fixed (emu)", *(f"{a:.6g},{b:.6g}," for a, b in zip(h, j, strict=True))])
        + "\n"
        + "\n".join([*(f"{a:.6g},,{b:.6g}" for a, b in zip(h, j, strict=True)), ""])
    )
    for name, words in (("steps", "from 100 to 300 K"), ("modes", "another mode")):
        notes = quantities(hf.read(tmp_path / f"{name}.csv")).notes[name]
        assert [words in str(note) for note in notes if note.code is Code.CONDITIONS] == [True]
    assert [len(record) for record in hf.read(tmp_path / "loops.csv")] == [h.size] * 2


def test_an_open_loop_has_no_loss():
    h, j = loop()
    gap = np.linspace(0, 0.8 * JS, h.size)
    found = quantities(hf.Record(h, j + gap, u_unit="A/m", y_unit="T", u_name="H", y_name="J"))
    assert "loop_area" not in {one.name for one in found.rows["record"]}
    assert Code.NOT_CLOSED in {note.code for note in found.notes["record"]}


def test_corrections_are_listed_in_order_and_undo_their_errors():
    h, j = loop()
    drift, shift, level = 0.02 * np.linspace(0, 1, h.size), 5e3, 0.03
    record = hf.Record(h + shift, j + level + drift, u_unit="A/m", y_unit="T", u_name="H", y_name="J")
    listed = {one.name: one for one in quantities(record).corrections["record"]}
    assert not any(one.applied for one in listed.values())
    found = values_of(record, correct=("drift", "offset"))
    assert found["HcJ"].value == pytest.approx(HC, rel=1e-4)
    assert found["HcJ"].spread < 1e-4 * HC
    done = quantities(record, correct=("drift", "offset")).corrections["record"]
    assert [one.name for one in done] == ["drift", "offset", "offset", "slope"]
    assert done[0].value == pytest.approx(0.02, rel=0.01)
    assert done[2].value == pytest.approx(shift, rel=0.01)
    with pytest.raises(hf.HystfitError, match="drift, offset, slope"):
        quantities(record, correct=("tilt",))
    field = quantities(record.in_units("Oe", ""), correct=("drift", "offset")).corrections["record"][2]
    assert (field.value, field.unit) == (pytest.approx(shift * 4e-3 * np.pi, rel=0.01), "Oe")


@pytest.mark.parametrize("mirrored", [1.0, -1.0])
@pytest.mark.parametrize(("unit", "name", "label"), [("emu/g", "Moment", ""), ("Am2", "Remanence", " of remanence")])
def test_moments_in_one_direction_have_a_coercivity(mirrored, unit, name, label):
    """Of half a loop, and of the remanences after back fields, where no volume is known."""
    h = np.linspace(0.0 if label else 2.4e6, -2.4e6, 1201)
    record = hf.Record(mirrored * h, mirrored * branch(h), u_unit="A/m", y_unit=unit, u_name="Field", y_name=name)
    found = values_of(record)
    assert found["coercive_input"].label == f"coercivity{label}"
    assert found["coercive_input"].value == pytest.approx(HC, rel=1e-3)
    assert found["remanence"].value == pytest.approx(branch(0.0), rel=1e-3)


@pytest.mark.parametrize("mirrored", [1.0, -1.0])
def test_half_a_loop_has_the_values_of_a_loop(mirrored):
    h = np.linspace(2.4e6, -2.4e6, 1201)
    record = hf.Record(mirrored * h, mirrored * branch(h), u_unit="A/m", y_unit="T", u_name="H", y_name="J")
    found = values_of(record)
    assert found["HcJ"].value == pytest.approx(HC, rel=1e-4)
    assert found["Br"].value == pytest.approx(branch(0.0), rel=1e-4)
    first = np.linspace(0, 1e4, 200)
    assert not values_of(record.replace(u=first, y=JS * np.tanh(first / 3e3), weight=None))


def test_errors_are_the_scatter_of_correlated_noise():
    """Noise that drifts over 40 samples: its differences show less than a tenth of it."""
    h, j = loop()
    draws = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        slow = np.convolve(rng.normal(0, 1, h.size + 200), np.hanning(60), "same")[100:-100]
        record = hf.Record(h, j + 3e-3 * slow / slow.std(), u_unit="A/m", y_unit="T", u_name="H", y_name="J")
        found = values_of(record)
        draws.append([(found[name].value, found[name].stderr) for name in ("HcJ", "Br")])
    draws = np.array(draws)
    ratio = np.median(draws[:, :, 1], axis=0) / draws[:, :, 0].std(axis=0)
    assert ((0.5 < ratio) & (ratio < 2)).all(), ratio


def test_leakage_is_that_of_a_resistor():
    """A capacitor with a resistor beside it: P = C V + the integral of V / R."""
    t = np.linspace(0, 1, 4001)
    v = 10 * (1 - 2 * np.abs(2 * ((t + 0.25) % 1) - 1))
    charge = 2e-3 * v + 5e-4 * np.concatenate([[0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    charge -= 0.5 * (charge.max() + charge.min())
    record = hf.Record(v, charge, t, u_unit="V", y_unit="C/m2", u_name="V", y_name="P")
    found = values_of(record)
    assert found["leakage"].value == pytest.approx(5e-4 * 10 * (1 - 0.05), rel=0.03)  # mean voltage near the tip
    assert found["leakage"].unit == "A/m2"
    assert values_of(record.replace(y_unit=""))["leakage"].unit == ""  # and not that of the time
    assert found["offset_input"].value == pytest.approx(0, abs=1e-2)


def test_soft_materials_have_permeabilities():
    """A first curve by the Rayleigh law, B = mu_i H + nu H^2, then a loop."""
    first, h = np.linspace(0, 20, 401), np.linspace(20, -20, 401)
    falling = lambda h: MU0 * (3000 * h + 25 * (400 - h**2))
    u = np.concatenate([first, h[1:], -h[1:]])
    y = np.concatenate([MU0 * (2000 * first + 50 * first**2), falling(h[1:]), -falling(h[1:])])
    found = values_of(hf.Record(u, y, u_unit="A/m", y_unit="T", u_name="H", y_name="B"))
    assert found["mu_i"].value == pytest.approx(2000, rel=1e-3)
    assert found["mu_max"].value == pytest.approx(3000, rel=1e-3)
    assert found["mu_a"].value == pytest.approx(3000, rel=1e-3)
    assert "energy_product" not in found


@pytest.mark.parametrize(
    "name", ["A4.hys", "PIOX.loop", "LV23C.hyst", "Conc_40_C3B.hys", "A1c_d200_200.hys", "Noise_test_c100.000"]
)
def test_results_of_a_magnetometer_are_met(name, measured):
    """Coercivity, remanence and saturation in the headers of MicroMag files, within 1 % or two standard errors."""
    record = hf.Dataset.of(hf.read(measured / f"wild/{name}"))[0]
    beside = [one for one in values_of(record).values() if one.stated is not None]
    assert {one.name.removesuffix("_corrected") for one in beside} == {"coercive_input", "remanence", "saturation"}
    for one in beside:
        assert abs(one.value - one.stated) <= max(0.01 * abs(one.stated), 2 * one.stderr if one.stderr else 0.0), one


def test_results_of_a_ferroelectric_tester_are_met(measured):
    """Coercivities, remanences, tips, switched polarization, shift and loss of all ten tables of an aixACCT file."""
    data = hf.read(measured / "wild/pnzt_RMN_TRAP_SLOW.dat")
    sides = {f"{name}_{side}" for name in ("coercive_input", "polarization_tip") for side in ("rising", "falling")}
    others = {
        "remanence_falling",
        "remanence_end",
        "remanence_start",
        "switched_polarization",
        "offset_input",
        "loop_area",
    }
    for record in data:
        beside = {one.name: one for one in values_of(record).values() if one.stated is not None}
        assert beside.keys() == sides | others
        for one in beside.values():
            assert one.value == pytest.approx(one.stated, rel=1e-3), (record.name, one)


def test_the_coercivities_of_coarse_loops_have_the_error_of_a_straight_line():
    """Samples four widths of the switching apart, of loops without noise: only the distance of the samples makes errors."""
    beyond = []
    for shift in np.linspace(0.0, 0.9, 7):
        h = np.append(np.linspace(1.5e6, -1.5e6, 18), np.linspace(-1.5e6, 1.5e6, 18)) + 1.7e5 * shift
        j = np.concatenate([branch(h[:18]), -branch(-h[18:])])
        found = values_of(hf.Record(h, j + MU0 * h, u_unit="A/m", y_unit="T", u_name="H", y_name="B"))
        beyond.append(abs(found["HcJ"].value - HC) / found["HcJ"].stderr)
    assert max(beyond) < 3
    assert np.mean(beyond) > 0.1


def test_a_magnetometer_file_gives_a_data_sheet_without_options(measured):
    record = hf.Dataset.of(hf.read(measured / "vsm_magmeas/VSM_MH.DAT"))[0]
    found = values_of(record)
    expected = {
        "HcJ": (245.8, 0.5),
        "HcB": (192.0, 0.3),
        "Br": (0.496, 1e-3),
        "energy_product": (33.9, 0.4),
        "Js": (0.6955, 2e-3),
    }
    for name, (value, within) in expected.items():
        assert found[name].value == pytest.approx(value, abs=within), name
    assert found["W"].value == pytest.approx(547e3, rel=2e-3)
    closed = values_of(record, sample=Sample(demagnetization=0.0))
    assert (closed["Br"].value, closed["HcB"].value) == (pytest.approx(0.453, abs=1e-3), pytest.approx(160.6, abs=0.3))
    sized = values_of(record, sample=Sample(size_stderr=1e-5))
    assert sized["Br"].scale == pytest.approx(0.004, abs=5e-4)
    assert sized["HcB"].scale == pytest.approx(0.7, abs=0.1)


@pytest.mark.parametrize(
    ("name", "coercivity", "product"), [("Ansys.AlNiCo_5-7", 59300, 55.6), ("VegaTechnik.LNGT92", 119300, 85.8)]
)
def test_a_catalog_curve_gives_its_energy_product(name, coercivity, product, measured):
    found = values_of(hf.Dataset.of(hf.read(measured / f"wild/B(H).{name}.tab"))[0])
    assert found["energy_product"].value == pytest.approx(product, rel=5e-3)
    assert found["HcB"].value == pytest.approx(coercivity, rel=1e-3)


def test_a_superconducting_loop_has_no_data_sheet_of_a_magnet():
    """Its currents give the largest moment near no field and little in the largest field (critical state of Kim)."""
    h = np.concatenate([np.linspace(7, -7, 801), np.linspace(-7, 7, 801)[1:]])
    side = np.repeat([1.0, -1.0], [801, 800])
    currents = 4e5 * side / (1 + np.abs(h) / 0.5) * np.tanh(50 * (7.02 - side * h))
    found = values_of(hf.Record(h, currents, u_unit="T", y_unit="A/m", u_name="Field", y_name="M"))
    assert found["loop_area"].value > 0
    assert not {"HcJ", "HcB", "Br", "energy_product", "knee_field"} & found.keys()


def test_a_loop_shifted_by_exchange_bias_has_its_offset_and_the_distribution_of_one_in_the_middle():
    """Both branches cross zero at negative fields, further from it than the loop is wide."""
    h = np.linspace(10.0, -10.0, 301)
    side = lambda at: np.tanh((h - at) / 0.6)
    y = np.append(side(-2.7), side(-0.9)[::-1]) + 0.005 * np.random.default_rng(3).normal(size=2 * h.size)
    found = values_of(hf.Record(np.append(h, h[::-1]), y, u_unit="kOe", y_unit="emu", u_name="Field", y_name="Moment"))
    assert found["offset_input"].value == pytest.approx(-1.8, abs=5 * found["offset_input"].stderr)
    assert found["offset_input"].stderr < 0.01
    exact = 2 * np.arccosh(np.sqrt(2)) * 0.6 / 0.9
    assert found["switching_distribution"].value == pytest.approx(
        exact, rel=0.1
    )  # of a derivative smoothed over 7 samples
    assert found["switching_distribution"].spread < 0.05 * exact


def test_samples_that_crowd_at_the_tips_of_a_sine_are_no_switching():
    """Of two thousand samples a cycle those at the tips are so close that their noise alone has the steepest slope."""
    h = 200 * np.cos(np.linspace(0, 2 * np.pi, 2001))
    y = np.tanh((h + np.where(np.arange(h.size) < 1000, 40, -40)) / 50)
    noisy = y + 0.004 * np.random.default_rng(0).standard_normal(h.size)
    found = values_of(hf.Record(h, noisy, u_unit="A/m", y_unit="T", u_name="H", y_name="J"))
    exact = 2 * np.arccosh(np.sqrt(2)) * 50 / 40
    assert found["switching_distribution"].value == pytest.approx(exact, rel=0.1)  # of a noisy derivative


def test_the_first_curve_of_loops_of_growing_amplitude_leaves_out_what_lies_inside():
    """Inside the loops, the remanent induction over a small field is no permeability."""
    phase = np.linspace(0, 2 * np.pi, 201)[:-1]
    h = np.concatenate([a * np.sin(phase) for a in (5.0, 10.0, 20.0)])
    p = np.zeros_like(h)
    for k in range(1, h.size):
        p[k] = min(max(p[k - 1], h[k] - 4.0), h[k] + 4.0)
    y = MU0 * 5000 * p + 2e-4 * np.random.default_rng(5).normal(size=h.size)
    found = values_of(hf.Record(h, y, u_unit="A/m", y_unit="T", u_name="H", y_name="B"))
    assert found["mu_max"].value == pytest.approx(5000 * (1 - 4.0 / 20.0), rel=0.01)
    assert found["mu_max"].stderr < 50


def test_the_advice_on_a_demagnetization_curve_is_to_use_what_is_read_off_it():
    h = np.linspace(0, -300, 60)
    result = hf.fit(
        "prandtl-ishlinskii:plays=6", hf.Record(h, 0.5 * np.tanh((h + 250) / 30), u_unit="kA/m", y_unit="T")
    )
    assert result.status is Status.NO_LOOP
    assert "read off" in result.advice
    curve = hf.Record(h, 1e-3 * h + 0.3, u_unit="V", y_unit="um")
    assert hf.fit("prandtl-ishlinskii:plays=6", curve).advice == Status.NO_LOOP.advice()


def biased(bias: float, seed: int) -> hf.Record:
    """A soft core under a field that wanders about a bias, as transients of a converter do: no loop, no demagnetization curve."""
    rng = np.random.default_rng(seed)
    levels = bias + np.linspace(-30, 30, 9) + rng.choice([-1, 1]) * np.tile([8.0, -8.0], 5)[:9]
    h = np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in itertools.pairwise(levels)])
    state, flux = 0.0, np.empty(h.size)
    for k, field in enumerate(h):
        state = np.clip(state, field - 8, field + 8)
        flux[k] = 0.3 * np.tanh(state / 60)
    return hf.Record(h, flux, u_unit="A/m", y_unit="T", u_name="H", y_name="B", name=f"core {seed}")


def test_transients_about_a_bias_have_no_data_sheet():
    """Their induction passes zero at some field, which is no coercivity, and the ratio at their tips is no amplitude permeability."""
    found = [hf.quantities(biased(bias, seed)) for bias in (-10.0, 0.0, 15.0) for seed in range(6)]
    names = {row.name for values in found for rows in values.rows.values() for row in rows}
    assert not names & {"HcJ", "HcB", "Br", "switching_distribution", "mu_a"}


def test_one_note_of_many_records_is_given_once():
    h = 40 * np.sin(np.linspace(0, 4 * np.pi, 801))
    loop = hf.Record(h, 0.3 * np.tanh((h - 5 * np.cos(np.linspace(0, 4 * np.pi, 801))) / 60), u_unit="A/m", y_unit="T")
    records = hf.Dataset((*(biased(10.0, seed) for seed in range(20)), loop.replace(name="loop")))
    lines = [line for line in hf.quantities(records).lines() if "no closed loop" in line]
    assert len(lines) == 1
    assert lines[0].startswith("note: 20 of 21 records: no closed loop")


@pytest.mark.parametrize("decimals", [2, 3, 4])
def test_errors_are_no_smaller_than_those_of_the_printed_digits(decimals: int) -> None:
    """A demagnetization curve of a catalogue with a sample where the polarization is zero, of which the noise is that of its digits."""
    field = -np.concatenate([np.linspace(0, 900, 40), np.linspace(905, 1000, 20)])
    slope = 1.29 / 25
    flux = 1.29 * np.tanh((field + 955) / 25) + 4e-4 * np.pi * field
    record = hf.Record(u=field, y=np.round(flux, decimals), u_unit="kA/m", y_unit="T", u_name="H", y_name="B")
    coercivity = values_of(record)["HcJ"]
    assert coercivity.stderr is not None
    assert coercivity.stderr > 0.9 * 10.0**-decimals / np.sqrt(12) / slope
    assert abs(coercivity.value - 955) < 3 * coercivity.stderr + 0.01
