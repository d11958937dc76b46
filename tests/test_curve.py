"""A single-valued curve in place of plays: its shape, and the records for which the search takes it, alone or behind a lag."""

from __future__ import annotations

import numpy as np
import pytest

import hystfit as hf
from hystfit.errors import ModelError
from hystfit.fitting.structure.structure_search import search_structure
from hystfit.models.curve import Curve
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has

KNOTS, BENDS = (0.0, 0.15, 0.6, 1.0), (0.3, -2.0, 4.0, 1.0)
CURVE = Curve(rise=0.7, bend=BENDS, knots=KNOTS, offset=0.1, low=-2.0, high=3.0)


def test_curvature_is_interpolated_between_the_knots_and_ends_with_them():
    h, x = 1e-3, np.array([-0.3, -0.1, 0.05, 0.1, 0.3, 0.5, 0.7, 0.95, 1.1, 1.4])
    y = [CURVE.free_run(5.0 * (x + shift) - 2.0) for shift in (-h, 0.0, h)]
    curvature = (y[0] - 2 * y[1] + y[2]) / h**2  # of a cubic polynomial, exactly
    expected = np.where((x > 0) & (x < 1), np.interp(x, KNOTS, BENDS), 0.0)
    np.testing.assert_allclose(curvature, expected, atol=1e-6)
    np.testing.assert_allclose(CURVE.free_run(np.array([-2.0, 3.0])), [0.1, 0.8], rtol=1e-12)


def test_few_knots_or_bends_are_refused():
    with pytest.raises(ModelError, match="two knots or more"):
        Curve.of(1)
    with pytest.raises(ModelError, match="one value for each knot"):
        Curve(bend=(0.0, 0.0), knots=(0.0, 0.5, 1.0))


def test_inputs_that_decay_to_a_hold_leave_knots_apart():
    """A lag behind a clipped sine: a third of the samples lie closer to zero than numbers can be divided by."""
    u = np.concatenate([np.linspace(0, 1, 200), np.linspace(1, 0, 200)[1:], np.exp(-np.arange(300.0))])
    curve = Curve.of(20).start([hf.Record(u, u**2)])
    columns = np.hstack([block.columns for block in curve.design_matrix(u).blocks])
    assert np.abs(columns).max() < 1e6
    assert np.all(np.diff(curve.knots) > 0)


def lagged(u: np.ndarray, passed: np.ndarray) -> np.ndarray:
    """Output of a first-order lag, by a plain loop; `passed` is the time between samples over the time constant."""
    out, state = np.empty(u.size), u[0]
    for k, value in enumerate(u):
        state = value + (state - value) * np.exp(-passed[k])
        out[k] = state
    return out


def two_rates(noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, input, and output of a saturating sensor behind a lag of 0.12 s."""
    t = np.arange(0, 20, 0.025)
    u = 3.0 * np.sin(2 * np.pi * np.where(t < 10, 0.2 * t, 0.5 * (t - 10)))
    rng = np.random.default_rng(1)
    return t, u, 4.0 * np.tanh(lagged(u, np.full(t.size, 0.025 / 0.12)) / 2) + noise * rng.normal(size=t.size)


@pytest.mark.usefixtures("few_families")
def test_a_sensor_that_only_lags_has_no_hysteresis():
    t, u, y = two_rates(0.01)
    result = hf.fit("auto", u, y, t)
    assert result.name == "lag:order=1+curve"
    assert result.status is Status.OK
    assert has(result.notes, Code.SPEED_DEPENDENT)
    tau = next(one for one in result.parameters if one.name.endswith("tau"))
    assert tau.stderr is not None
    assert abs(tau.value - 0.12) < 4 * tau.stderr < 0.001


def test_a_lag_of_one_order_answers_a_step_as_the_closed_form_does():
    y = hf.simulate(hf.Lag(tau=0.3, order=1), np.ones(4), np.array([0.1, 0.2, 0.0, 0.3]))[0]
    np.testing.assert_allclose(y, 1 - np.exp(-np.array([0.1, 0.3, 0.3, 0.6]) / 0.3), rtol=1e-12)
    with pytest.raises(ModelError, match="order of a lag"):
        hf.Lag(order=3)


@pytest.mark.usefixtures("few_families")
def test_a_coarse_curve_without_a_loop_is_no_hysteresis():
    voltage = np.concatenate([np.linspace(-1, 0.8, 23), np.linspace(0.8, -1, 23)])
    y = 1e-3 * np.expm1(voltage / 0.07) + 0.02 * voltage  # a diode and its series resistance
    result = hf.fit("auto", voltage, y)
    assert result.status is Status.NO_LOOP
    assert result.model.memoryless
    assert has(result.notes, Code.SINGLE_VALUED)
    assert result.left_out is not None
    assert result.left_out < 0.003 * np.ptp(y)


def play(u: np.ndarray, half: float) -> np.ndarray:
    """A play, by a plain loop."""
    out, place = np.empty(u.size), u[0]
    for k, value in enumerate(u):
        out[k] = place = min(value + half, max(value - half, place))
    return out


def test_narrow_loops_of_one_pace_are_plays_and_no_lag():
    t = np.arange(1000) * 0.02
    u = np.sin(2 * np.pi * 0.2 * t)
    y = u + 0.02 * play(u, 0.1) + 0.02 * play(u, 0.4) + 1e-4 * np.random.default_rng(2).normal(size=t.size)
    found = search_structure(hf.Dataset.of(hf.Record(u=u, y=y, t=t)))
    assert found.structure.operator != "curve"
    assert not found.structure.lag


def test_an_error_that_the_noise_of_the_input_explains_is_no_fault_of_the_model():
    """A thermostat whose temperature was measured with noise: every switch is some samples early or late."""
    ramp = np.linspace(0, 12, 150)
    true = np.concatenate([ramp, ramp[::-1]] * 4)
    on, state = np.empty(true.size), 1.0
    for k, value in enumerate(true):
        state = 0.0 if value > 7 else 1.0 if value < 3 else state
        on[k] = state
    measured = true + np.random.default_rng(4).normal(0, 0.06, true.size)
    noisy, coarse = (hf.fit("preisach-signed:n=30", u, on) for u in (measured, true))
    assert (noisy.train.nrmse_percent or 0.0) > 3.0
    assert noisy.status is Status.OK
    assert has(noisy.notes, Code.MEASUREMENT_NOISE)
    assert (
        coarse.train.nrmse_percent or 0.0
    ) > 3.0  # its levels lie too far apart for a single relay, whose input has no noise
    assert coarse.status is Status.ROUGH


@pytest.mark.parametrize("timed", [False, True], ids=["without time", "with time"])
def test_a_curve_in_one_direction_is_no_plays(timed: bool):
    """The knee of a demagnetization curve in 24 points, of which stops and their kinks describe the corner with fewer weights."""
    field = np.linspace(-60.0, 0.0, 24)
    induction = 1.33 + 0.004 * field - 1.1 / (1 + np.exp((field + 57.0) / 0.8))
    found = search_structure(hf.Dataset([hf.Record(field, induction, t=np.arange(24.0) if timed else None)]))
    assert isinstance(found.model, Curve)
