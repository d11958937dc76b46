"""One period of a steady loop as it comes: recognized, fitted and predicted from the branch on which it begins."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.data.steady_cycle import from_turning_point, steady_period
from hystfit.fitting.structure.model_structure import Structure
from hystfit.fitting.structure.structure_search import search_structure
from hystfit.results.quantity_estimates import measured_quantities

N = 200
DEVICE = hf.BoucWen(c=1.0, mu=0.5, tau=6.0, rho=0.3)


def period(phase, amplitude=1.0):
    return amplitude * np.sin(phase + 2 * np.pi * np.arange(N + 1) / N)


def steady(phase, noise=0.0, model=DEVICE, amplitude=1.0):
    """The second of two periods."""
    u = period(phase, amplitude)
    y = np.asarray(hf.simulate(model, np.concatenate([u, u]))[0])[-u.size :]
    return hf.Record(u, y + noise * np.ptp(y) * np.random.default_rng(0).normal(size=u.size))


@pytest.mark.parametrize("phase", [0.0, 0.6, 2.6, 3.5, 5.5])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_period_from_any_place_on_either_branch_is_recognized(phase, sign):
    record = steady(phase, noise=0.005)
    assert steady_period(record.replace(y=sign * record.y)) == len(record)


def test_of_several_periods_the_first_is_driven_through_again():
    u = np.tile(period(2.6)[:-1], 4)
    t = 0.01 * np.arange(u.size)
    y = np.asarray(hf.simulate(DEVICE, u)[0])
    record = hf.Record(u[N:-30], y[N:-30], t=t[N:-30])  # neither closed nor a whole number of periods
    prepared = DEVICE.prepared(record)
    np.testing.assert_allclose(prepared.u, u[:-30], atol=1e-12)
    np.testing.assert_allclose(np.diff(prepared.t), 0.01)
    assert not prepared.used[:N].any()
    np.testing.assert_array_equal(prepared.y[N:], record.y)
    assert DEVICE.prepared(prepared) is prepared


def test_a_period_ends_at_the_sample_nearest_to_its_begin():
    """The sine of a multiple of 2 pi is a rounding error on either side of 0, and the next sample would be one too many."""
    u = np.sin(2 * np.pi * 0.005 * np.arange(1000))
    u[200] = -1e-15
    assert steady_period(hf.Record(u, u + 0.2 * np.cos(2 * np.pi * 0.005 * np.arange(1000)))) == 200


@pytest.mark.parametrize("rate", [200.0, 190.7])
@pytest.mark.parametrize("model", ["linear+viscous", "damper"])
def test_forces_of_the_rate_are_fitted_from_the_second_sample_of_a_record_that_begins_in_motion(model, rate):
    """The period before it ends a part of a sample from its begin, so that the rate at the first sample is not that of the motion."""
    t = np.arange(1000) / rate
    x, v = 5 * np.sin(2 * np.pi * t), 10 * np.pi * np.cos(2 * np.pi * (t - 0.5 / rate))
    noise = np.random.default_rng(0).normal(0, 0.5, t.size)
    fit = hf.fit(model, hf.Record(x, 20 * x + 0.8 * v + noise, t, u_unit="mm", y_unit="N"))
    assert fit.train.rmse < 1.02 * np.std(noise)


def virgin():
    u = period(0.0)
    return hf.Record(u, np.asarray(hf.simulate(DEVICE, u)[0]))


OTHERS = {
    "from rest": virgin,
    "from a turning point": lambda: steady(np.pi / 2),
    "not closed": lambda: hf.Record(steady(0.0).u[:180], steady(0.0).y[:180]),
    "growing": lambda: hf.Record(
        *np.hstack([[r.u[:-1], r.y[:-1]] for r in (steady(0.0, amplitude=a) for a in (0.5, 1.0))])
    ),
    "a curve": lambda: hf.Record(period(0.0), period(0.0) ** 3),
    "noise": lambda: hf.Record(period(0.0), np.random.default_rng(2).normal(size=N + 1)),
    "an output missing": lambda: hf.Record(period(0.0), np.where(np.arange(N + 1) == 5, np.nan, steady(0.0).y)),
    "rested before": lambda: steady(0.0).resting_on(0.0),
    "driven through itself": lambda: steady(0.0).repeating(),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_records_are_left_as_they_are(name):
    record = OTHERS[name]()
    assert steady_period(record) is None
    assert DEVICE.prepared(record) is record


def test_loops_of_three_amplitudes_are_fitted_and_predicted_to_the_noise():
    """Hysteresis loops of a magnetic material as an instrument writes them: single periods from zero field."""
    device = hf.ParametricPreisach()
    records = []
    for number, amplitude in enumerate((0.9, 0.54, 0.315)):
        field = np.tile(period(0.0, amplitude), 2)
        flux = np.asarray(device.free_run(field))[-N - 1 :]
        noise = 0.002 * np.ptp(flux) * np.random.default_rng(number).normal(size=N + 1)
        records.append(hf.Record(field[-N - 1 :], flux + noise, name=f"loop {number}", u_unit="A/m", y_unit="T"))
    fit = hf.fit("preisach-magnetic:n=40", records)
    assert fit.train.nrmse_percent < 0.5
    rested = hf.fit("preisach-magnetic:n=40", [record.resting_on(0.0) for record in records])
    assert rested.train.nrmse_percent > 3.0
    # The prediction of a period is the second pass of the model through it, on its own samples.
    twice = np.asarray(hf.simulate(fit.models[1], np.tile(records[1].u, 2))[0])
    np.testing.assert_allclose(fit.predict(records[1]), twice[-N - 1 :], rtol=0, atol=1e-12)
    assert fit.metrics(records[1]).nrmse_percent == pytest.approx(
        100 * np.sqrt(np.mean((twice[-N - 1 :] - records[1].y) ** 2)) / np.ptp(records[1].y)
    )


def test_a_cycle_is_measured_from_its_turning_point():
    record = steady(2.6)
    from_peak = steady(np.pi / 2)
    for given in (record, record.repeating()):
        turned = from_turning_point(given)
        assert abs(turned.u[0]) == abs(turned.u[-1]) == np.abs(record.u).max()
        measured = measured_quantities(hf.Dataset.of(given))
        assert measured["loop_area"] == pytest.approx(
            measured_quantities(hf.Dataset.of(from_peak))["loop_area"], rel=1e-3
        )
    assert from_turning_point(from_peak) is from_peak


def test_a_free_initial_state_of_a_steady_record_is_where_it_starts():
    record = steady(0.0, model=hf.BoucWen(c=1.0, mu=0.4, tau=3.0, rho=0.5))
    assert steady_period(record) is not None
    held, freed = hf.Problem(hf.BoucWen(), record), hf.Problem(hf.BoucWen(), record, free=["h0"])
    assert len(held.data[0]) > len(record)
    assert len(freed.data[0]) == len(record)
    at = lambda h0: freed.predict(freed.space.vector(hf.BoucWen(h0=h0)))[0]
    assert abs(at(0.9)[0] - at(-0.9)[0]) > 0.01  # the state matters at the first sample


def test_cycles_cut_out_of_a_longer_test_begin_on_its_loop():
    """A joint moved to and fro between its ends, from a turn on: at rest its stop would begin half the height of the loop away."""
    angle = 30 - 30 * np.cos(np.linspace(0, 6 * np.pi, 600, endpoint=False))
    slip, stop = 3.0, np.empty(angle.size)
    at = angle[0] + slip  # of the slider: the movement before the record ended in the other direction
    for k, a in enumerate(angle):
        at = min(max(at, a - slip), a + slip)
        stop[k] = 0.5 * (a - at)
    noise = np.random.default_rng(44).normal(0, 0.08, angle.size)
    record = hf.Record(angle, 0.12 * angle + stop + noise)
    assert steady_period(record) == 200
    noisy = 1.2 * 100 * 0.08 / np.ptp(record.y)
    assert hf.fit("prandtl-ishlinskii-stop", record).train.nrmse_percent < noisy
    found = search_structure(hf.Dataset.of(record))
    assert 100 * found.score / np.ptp(record.y) < noisy
    assert found.structure == Structure("stop")
    rested = np.array(stop)
    rested[:100] = np.minimum(0.5 * (angle[:100] - angle[0]), 1.5)
    assert steady_period(record.replace(y=0.12 * angle + rested + noise)) is None
    assert steady_period(hf.Record(angle[:200], record.y[:200])) is None


def butterfly(phase, sign=1.0):
    """The strain of a ferroelectric over one period of the field, in which the branches cross at zero field."""
    field = period(phase, 5.0)
    rises = np.cos(phase + 2 * np.pi * np.arange(N + 1) / N) >= 0
    return hf.Record(field, sign * np.tanh((field - np.where(rises, 1.1, -1.1)) / 0.8) ** 2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_period_from_where_the_branches_of_a_butterfly_cross_is_recognized(sign):
    assert steady_period(butterfly(0.0, sign)) == N + 1


def test_a_virgin_strain_from_where_the_branches_cross_later_is_no_steady_period():
    """A ferroelectric without polarization is shortest at zero field: here it begins where the loop passes later, but by another way."""
    record = butterfly(0.0)
    quarter = record.u[: N // 4 + 1]
    virgin = record.y[0] + (record.y[N // 4] - record.y[0]) * (quarter / quarter[-1]) ** 2
    assert steady_period(record.replace(y=np.concatenate([virgin, record.y[N // 4 + 1 :]]))) is None


def test_an_input_of_an_oscilloscope_with_noise_of_its_last_digit_is_one_period():
    """Eight bits, of which the sine has a hundred steps: near its turning points it goes back by two of them."""
    phase = 2 * np.pi * np.arange(2000) / 2000
    rng = np.random.default_rng(0)
    u = np.round((2.1 * np.sin(phase) + rng.normal(0, 0.01, 2000)) / 0.04) * 0.04
    y = np.round(
        (0.45 * np.tanh((2.1 * np.sin(phase) - 0.35 * np.cos(phase)) / 0.8) + rng.normal(0, 0.002, 2000)) / 0.008
    )
    assert steady_period(hf.Record(u, 0.008 * y)) is not None
