"""Models of the rate: Maxwell chains beside ramps and a power law of time, a shift of the coercivity over decades of frequency."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hystfit as hf
from hystfit.errors import ModelError

# -- viscoelastic chain -----------------------------------------------------------------------------------------------------


def springpot(u: np.ndarray, t: np.ndarray, order: float) -> np.ndarray:
    """Force of fractional order: the relaxation t^-order / Gamma(1 - order), exact for straight lines between samples."""
    rates, gamma = np.diff(u) / np.diff(t), math.gamma(2 - order)
    of = lambda x: np.maximum(x, 0.0) ** (1 - order) / gamma
    return np.array([np.sum(rates * (of(now - t[:-1]) - of(now - t[1:]))) for now in t])


def sine_record(frequency: float, order: float, noise: float = 0.0) -> hf.Record:
    t = np.arange(241) / 80 / frequency
    u = np.sin(2 * np.pi * frequency * t)
    y = 0.5 * u + springpot(u, t, order)
    y = y + noise * np.ptp(y) * np.random.default_rng(0).normal(size=y.size)
    return hf.Record(u=u, y=y, t=t, name=f"{frequency:g} Hz")


def test_a_maxwell_element_answers_a_ramp_exactly() -> None:
    """g tau v (1 - exp(-t / tau)) at any sampling, and exp(-t / tau) of it after a hold."""
    model = hf.Viscoelastic(g=(2.0,), tau=(0.3,))
    t = np.array([0.0, 0.001, 0.2, 5.0, 5.0, 7.0])
    u = 3.0 * np.minimum(t, 5.0)
    y = np.asarray(hf.simulate(model, u, np.diff(t, prepend=0.0))[0])
    ramp = lambda x: 2.0 * 0.3 * 3.0 * -np.expm1(-x / 0.3)
    np.testing.assert_allclose(y, [*ramp(t[:5]), ramp(5.0) * np.exp(-2.0 / 0.3)], rtol=1e-12)


def test_the_modulus_is_that_of_a_sine() -> None:
    model = hf.Viscoelastic(g=(2.0, 1.0), tau=(0.3, 0.02))
    t = np.arange(0, 40, 1e-3)
    y = np.asarray(hf.simulate(model, np.sin(2 * np.pi * 0.5 * t), 1e-3)[0])[-2000:]
    found = 2 * np.mean(y * np.exp(-2j * np.pi * 0.5 * t[-2000:])) * 1j
    assert abs(model.modulus(0.5)[0] - found) < 1e-3 * abs(found)


def test_a_chain_predicts_a_rate_that_it_was_not_fitted_to() -> None:
    """A power law of order 0.2 at three rates over four decades; an unseen rate within 1 % of its range."""
    records = [sine_record(f, 0.2, noise=0.002) for f in (0.01, 1.0, 100.0)]
    fit = hf.fit("linear+viscoelastic", records)
    unseen = sine_record(8.0, 0.2)
    assert fit.metrics(unseen).nrmse_percent < 1.0
    assert fit.usable


def test_a_springpot_follows_the_power_law_and_its_modulus() -> None:
    record = sine_record(1.0, 0.35)
    model = hf.Springpot(c=1.0, order=0.35).start([sine_record(f, 0.35) for f in (0.01, 100.0)]).replace(c=1.0)
    y = np.asarray(hf.simulate(model, record.u, record.dt)[0])
    np.testing.assert_allclose(y, record.y - 0.5 * record.u, atol=1e-3 * np.ptp(y))
    assert abs(model.modulus(2.0)[0] - (2j * np.pi * 2.0) ** 0.35) < 1e-12


@pytest.mark.parametrize("order", [1e-3, 0.999])
def test_a_springpot_lies_between_a_spring_and_a_dashpot(order: float) -> None:
    u = np.cumsum(np.random.default_rng(0).normal(size=50))
    y = np.asarray(hf.simulate(hf.Springpot(c=1.0, order=order), u, 0.1)[0])
    expected = u - u[0] if order < 0.5 else np.diff(u, prepend=u[0]) / 0.1
    np.testing.assert_allclose(y, expected, atol=0.01 * np.ptp(expected))


@pytest.mark.parametrize("unseen", [0.01, 100.0])
def test_a_springpot_predicts_a_rate_two_decades_beyond_those_fitted(unseen: float) -> None:
    records = [sine_record(f, 0.2, noise=0.002) for f in (0.01, 1.0, 100.0) if f != unseen]
    fit = hf.fit("linear+springpot", records)
    assert fit.metrics(sine_record(unseen, 0.2)).nrmse_percent < 2.0
    assert abs(fit["order"].value - 0.2) < 4 * fit["order"].stderr


def test_too_few_elements() -> None:
    with pytest.raises(ModelError):
        hf.Viscoelastic.of(0)
    with pytest.raises(ModelError):
        hf.Springpot.of(1)
    with pytest.raises(ModelError):
        hf.Viscoelastic(g=(1.0, 2.0), tau=(1.0,))


# -- shift by the rate -------------------------------------------------------------------------------------------------------


def ferroelectric(frequency: float, noise: float = 0.0) -> hf.Record:
    """A saturating loop whose coercive field is 1 + 0.05 log(1 + rate / 3): sharp branches, independent of hystfit's models."""
    t = np.arange(601) / 200 / frequency
    u = 2.0 * np.sin(2 * np.pi * frequency * t)
    rate = 4 * np.pi * frequency * np.cos(2 * np.pi * frequency * t)
    coercive = 1.0 + 0.05 * np.log1p(np.abs(rate) / 3.0)
    y = np.tanh(4.0 * (u - np.sign(rate) * coercive)) + 0.1 * u
    kept = slice(100, None)
    y = y + noise * np.ptp(y) * np.random.default_rng(0).normal(size=y.size)
    return hf.Record(u=u[kept], y=y[kept], t=t[kept], name=f"{frequency:g} Hz")


def coercivity(record: hf.Record, y: np.ndarray) -> float:
    """Mean size of the inputs where the output crosses zero."""
    at = np.flatnonzero((y[:-1] < 0) != (y[1:] < 0))
    step = y[at] / (y[at] - y[at + 1])
    return float(np.mean(np.abs(record.u[at] + step * (record.u[at + 1] - record.u[at]))))


@pytest.mark.slow
def test_coercivity_at_unseen_frequencies_over_five_decades() -> None:
    """One model fitted at three frequencies; a static one errs by the growth of the coercivity."""
    records = [ferroelectric(f, noise=0.005) for f in (0.1, 10.0, 1000.0)]
    shifted = hf.fit("rate-shift+preisach", records)
    static = hf.fit("preisach", records)
    errors = {}
    for name, fit in (("shifted", shifted), ("static", static)):
        for f in (1.0, 100.0, 5000.0):
            unseen = ferroelectric(f)
            y = np.asarray(hf.simulate(fit.model, unseen.u, unseen.dt)[0])
            errors[name, f] = abs(coercivity(unseen, y) / coercivity(unseen, unseen.y) - 1)
    assert max(error for (name, _), error in errors.items() if name == "shifted") < 0.02
    assert max(error for (name, _), error in errors.items() if name == "static") > 0.1


def test_a_shift_is_that_of_the_rate_of_the_sample_before() -> None:
    u, dt = np.array([0.0, 1.0, 1.0, -1.0, -1.5]), np.array([0.0, 0.5, 0.0, 0.1, 0.2])
    v = np.asarray(hf.simulate(hf.RateShift(c=0.3, q0=2.0), u, dt)[0])
    shift = 0.3 * np.log1p(np.array([0.0, 0.0, 0.0, 2.0, 20.0]) / 2.0) * [0, 0, 0, 1, -1]
    np.testing.assert_allclose(v, u - shift, atol=1e-14)
    with pytest.raises(ModelError, match="no stable inverse"):
        hf.RateShift().step_inverse()


# -- plays whose thresholds grow with the rate -------------------------------------------------------------------------------

PIEZO = {"w": (3.0, 2.0, 4.0), "r": (0.02, 0.08, 0.2), "gain": 20.0, "tau": 0.002, "high": 10.0, "speed": 3000.0}


def driven(frequency: float, noise: float = 0.0, seed: int = 0) -> hf.Record:
    """Cycles of two amplitudes at one frequency, from the definition in a plain loop."""
    t = np.arange(500) / 125 / frequency
    u = 5.0 - np.cos(2 * np.pi * frequency * t) * np.where(t * frequency < 2, 5.0, 2.5)
    y = plays_of_the_rate(u, np.diff(t, prepend=0.0), kappa=0.1)
    return hf.Record(u=u, y=y + noise * np.random.default_rng(seed).normal(size=y.size), t=t, name=f"{frequency:g} Hz")


def plays_of_the_rate(u: np.ndarray, dt: np.ndarray, kappa: float) -> np.ndarray:
    low, high = 0.0, PIEZO["high"]
    p, q, last, out = [(u[0] - low) / (high - low)] * 3, 0.0, 0.0, []
    for k, now in enumerate(u):
        if dt[k] > 0:
            q += (1 - math.exp(-dt[k] / PIEZO["tau"])) * (last - q)
            last = abs(now - u[k - 1]) / dt[k] / PIEZO["speed"] if k else 0.0
        x = (now - low) / (high - low)
        p = [min(max(old, x - r - kappa * q), x + r + kappa * q) for old, r in zip(p, PIEZO["r"], strict=True)]
        out.append(PIEZO["gain"] * x + sum(w * play for w, play in zip(PIEZO["w"], p, strict=True)))
    return np.array(out)


def test_plays_of_the_rate_follow_their_definition_and_invert_exactly() -> None:
    model = hf.RateDependentPlays(**PIEZO, kappa=0.1)
    record = driven(100.0)
    np.testing.assert_allclose(np.asarray(hf.simulate(model, record.u, record.dt)[0]), record.y, atol=1e-12)
    inverse = hf.invert(model, record.y, dt=record.dt, limits=(-5.0, 15.0))
    np.testing.assert_allclose(inverse.u, record.u, atol=1e-12 * 10.0)


def test_noise_is_hardly_enlarged_by_the_inverse() -> None:
    """0.1 % of the output's range in, at most twice that in the input."""
    model, record = hf.RateDependentPlays(**PIEZO, kappa=0.1), driven(100.0)
    noise = 1e-3 * np.ptp(record.y) * np.random.default_rng(0).normal(size=record.y.size)
    inverse = hf.invert(model, record.y + noise, dt=record.dt, limits=(-5.0, 15.0))
    assert np.std(np.asarray(inverse.u) - record.u) < 2e-3 * np.ptp(record.u)


def test_kappa_is_found_at_three_rates_and_static_plays_err() -> None:
    records = [driven(f, noise=0.06, seed=k) for k, f in enumerate((1.0, 20.0, 100.0))]
    template = hf.RateDependentPlays(**{**PIEZO, "w": (1.0, 1.0, 1.0), "gain": 1.0}, kappa=0.01)
    fit = hf.fit(template, records, start="model")
    assert float(fit.model.kappa) == pytest.approx(0.1, rel=0.05)
    static = hf.fit("prandtl-ishlinskii", records)
    assert static.train.rmse > 3 * fit.train.rmse
    assert fit.train.rmse < 1.05 * 0.06
    found = hf.fit("rate-dependent-plays", records)  # thresholds of its own
    assert found.metrics(driven(50.0)).rmse < 0.5 * static.metrics(driven(50.0)).rmse


@pytest.mark.slow
def test_one_rate_is_named_where_several_are_needed() -> None:
    """`check` says that the growth with the rate is not determined by one rate; nothing of the kind at three, or in a sweep."""
    lacking = lambda data, name: [text for text in hf.check(data).verdict(name).reasons if "speed" in text]
    three = [ferroelectric(f) for f in (0.1, 10.0, 1000.0)]
    t = np.arange(2000) / 1000
    swept = hf.Record(u=np.sin(2 * np.pi * 10 ** (2 * t)), y=np.sin(2 * np.pi * 10 ** (2 * t) - 0.2), t=t)
    for name in ("rate-shift", "rate-dependent-plays"):
        assert lacking(three[:1], name)
        assert not lacking(three, name)
    assert not lacking(swept, "rate-dependent-plays")
