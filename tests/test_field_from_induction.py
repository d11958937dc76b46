"""B to H: a core of known stops and eddy currents, whose sequences begin in unknown states."""

import dataclasses

import numpy as np
import pytest

import hystfit as hf
from hystfit.errors import DataError
from hystfit.identify.field_from_induction import FieldFromInduction, FluxSequence, _jackknife

DT, COUNT, EDDY = 1e-6, 600, 4e-5
WIDTHS, WEIGHTS = np.array([3e-3, 0.02, 0.08]), np.array([2e3, 600.0, 150.0])


def core(b, dt):
    """Field of three stops, a curve and eddy currents, by a plain loop from rest."""
    stops, h = np.zeros(3), np.empty(b.size)
    rate = np.gradient(b, dt)
    for k in range(b.size):
        if k:
            stops = np.clip(stops + b[k] - b[k - 1], -WIDTHS, WIDTHS)
        h[k] = WEIGHTS @ stops + 80 * b[k] + 500 * (b[k] / 0.47) ** 5 + EDDY * rate[k]
    return h


def sequences(count, seed, past=COUNT):
    """Parts out of the middle of long ways, so that what came before is unknown."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        turns = rng.uniform(-0.3, 0.3, 12)
        t = np.arange(COUNT + 600)
        b = np.interp(t, np.linspace(0, t[-1], 12), turns)
        b = np.convolve(np.pad(b, 8, mode="edge"), np.ones(17) / 17, "valid")
        h = core(b, DT)[600:]
        found.append((FluxSequence(b[600:], np.where(np.arange(COUNT) < past, h, np.nan), DT), h))
    return found


@pytest.fixture(scope="module")
def model():
    return FieldFromInduction.fit([one for one, _ in sequences(12, 0)])


@pytest.mark.parametrize("other", [1.0, 1.15])
def test_it_predicts_unseen_sequences_from_a_known_past(model, other):
    """Of the same core, and of one whose field is 15 % larger, to which the coefficients adapt."""
    errors = {True: [], False: []}
    for one, h in sequences(6, 1, past=200):
        past, true = FluxSequence(one.b, other * one.h, DT), other * h
        for adapt in errors:
            miss = (model.predict(past, adapt=adapt) - true)[200:]
            errors[adapt].append(np.sqrt(np.mean(miss**2) / np.mean(true[200:] ** 2)))
    assert np.mean(errors[True]) < (0.05 if other == 1.0 else 0.9 * np.mean(errors[False]))


def test_the_loss_over_frequency_is_that_of_the_core(model):
    """Hysteresis and eddy currents apart: the loss of a sine of 0.2 T at two frequencies."""
    for frequency in (1e3, 2e4):
        t = np.arange(4001) / 2000 / frequency
        b = 0.2 * np.sin(2 * np.pi * frequency * t)
        h = core(b, t[1])[2000:]
        loss = np.sum(0.5 * (h[1:] + h[:-1]) * np.diff(b[2000:]))
        assert model.loss(0.2, frequency)[0] == pytest.approx(loss, rel=0.06)


def test_the_error_of_the_loss_is_that_of_its_coefficients(model):
    """The jackknife of a mean is its standard error; the error of the loss is the scatter of losses over drawn coefficients."""
    y = np.random.default_rng(0).normal(size=9)
    found = _jackknife(np.stack([np.ones(9), y], axis=-1)[:, None, :], 0.0)
    assert found.item() == pytest.approx(y.var(ddof=1) / 9)
    assert np.isnan(_jackknife(np.ones((1, 1, 2)), 0.0)).all()
    drawn = np.random.default_rng(1).multivariate_normal(model.w, model.covariance, 80, method="eigh")
    losses = [dataclasses.replace(model, w=w).loss(0.2, 1e3)[0] for w in drawn]
    assert np.std(losses) == pytest.approx(model.loss(0.2, 1e3)[1], rel=0.3)


def test_a_loss_beyond_the_sequences_is_refused(model):
    """The saturating terms are clipped, and every coefficient is linear in the temperature: losses there were negative."""
    with pytest.raises(DataError, match="flux density of 2 T"):
        model.loss(2.0, 1e3)
    with pytest.raises(DataError, match="temperature of 150 degC"):
        model.loss(0.1, 1e3, temperature=150.0)
    assert len(repr(model)) < 1000  # no matrices


def test_bad_sequences_are_refused(model):
    b = np.zeros(100)
    for bad in ((b, np.zeros(99), 1e-6), (b, np.full(100, np.nan), 1e-6), (b, b, 0.0), (b * np.nan, b, 1e-6)):
        with pytest.raises(hf.HystfitError):
            FluxSequence(*bad)
    with pytest.raises(hf.HystfitError):
        FieldFromInduction.fit([])
    with pytest.raises(hf.HystfitError):
        model.loss(0.1, 0.0)
