"""Delay, lags, resonance and rate terms against interpolation, closed forms and ODE solvers."""

import math
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lsim

import hystfit as hf
from hystfit.errors import ModelError
from hystfit.models import Delay, Lag, SaturatingRate, SecondOrder, Viscous, simulate


def path(seed: int, length: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """Smooth random input and irregular time steps, a repeated time stamp among them."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.002, 0.05, length)
    dt[0] = 0.0
    t = np.cumsum(dt)
    return np.sin(7 * t) + 0.4 * np.sin(23 * t + 1), dt


# -- delay -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lag", [0.0, 0.3, 1.0, 2.75, 8.0])
def test_a_delay_interpolates_between_samples(lag: float) -> None:
    u = np.random.default_rng(0).normal(size=40)
    expected = np.interp(np.arange(40) - lag, np.arange(40), u)  # before the record: its first value
    np.testing.assert_allclose(simulate(Delay(lag=lag), u)[0], expected, atol=1e-14)


def test_a_delay_stops_at_its_longest() -> None:
    u = np.random.default_rng(1).normal(size=20)
    np.testing.assert_array_equal(simulate(Delay(lag=7.5, longest=3), u)[0], simulate(Delay(lag=3.0, longest=3), u)[0])
    with pytest.raises(ModelError, match="at least one sample"):
        Delay(longest=0)


# -- lags ------------------------------------------------------------------------------------------------------------------


def test_the_lag_is_exact_for_steps_whatever_the_sampling() -> None:
    """Two lags of tau / 2: 1 - (1 + t / T) exp(-t / T) with T = tau / 2 after a step."""
    tau = 0.04
    t = np.sort(np.random.default_rng(2).uniform(0.0, 0.3, 30))
    u = np.full(31, 5.0)
    u[0] = 1.0
    y = simulate(Lag(tau=tau, level=1.0), u, np.concatenate([[0.0], np.diff(t, prepend=0.0)]))[0]
    x = t / (tau / 2)
    np.testing.assert_allclose(y[1:], 5.0 - 4.0 * (1 + x) * np.exp(-x), atol=1e-13)


@pytest.mark.usefixtures("as_users_run")
def test_the_lag_smooths_a_jump_at_the_first_sample_or_rests_on_it() -> None:
    u, dt = np.full(4, 2.0), np.array([0.0, 0.1, 0.1, 5.0])
    y = np.asarray(simulate(Lag(tau=0.1), u, dt)[0])
    assert y[0] == 0.0
    assert (np.diff(y) > 0).all()
    assert y[-1] == pytest.approx(2.0, rel=1e-12)
    assert np.asarray(simulate(Lag(tau=0.1, rest="first"), u, dt)[0]).tolist() == [2.0] * 4
    with pytest.raises(ModelError, match="level or first"):
        Lag(rest="never")  # type: ignore[arg-type]


# -- resonance -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("zeta", [0.02, 0.5, 0.999])
def test_the_resonance_equals_lsim_on_regular_samples(zeta: float) -> None:
    omega, t = 30.0, np.arange(80) * 0.01
    u = np.sin(9 * t) + (t > 0.3)
    _, expected, _ = lsim(([omega**2], [1, 2 * zeta * omega, omega**2]), u, t, X0=None)
    found = simulate(SecondOrder(omega=omega, zeta=zeta), u, 0.01)[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_resonance_is_exact_on_irregular_samples() -> None:
    u, dt = path(3)
    omega, zeta = 40.0, 0.1
    state, expected = [u[0], 0.0], [u[0]]
    for (a, b), h in zip(pairwise(u), dt[1:], strict=True):
        law = lambda t, s, a=a, b=b, h=h: [s[1], omega**2 * (a + (b - a) * t / h - s[0]) - 2 * zeta * omega * s[1]]
        state = solve_ivp(law, (0.0, h), state, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        expected.append(state[0])
    np.testing.assert_allclose(simulate(SecondOrder(omega=omega, zeta=zeta), u, dt)[0], expected, atol=1e-9)


def test_a_jump_between_equal_time_stamps_sets_the_resonance_ringing() -> None:
    omega, zeta = 50.0, 0.2
    t = np.linspace(0.0, 0.3, 40)
    u, dt = np.concatenate([[0.0], np.ones(40)]), np.concatenate([[0.0, 0.0], np.diff(t)])
    y = np.asarray(simulate(SecondOrder(omega=omega, zeta=zeta), u, dt)[0])[1:]
    damped = omega * math.sqrt(1 - zeta**2)
    expected = 1 - np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))
    np.testing.assert_allclose(y, expected, atol=1e-12)


def test_the_resonance_is_differentiable_up_to_critical_damping() -> None:
    u, dt = path(4)

    @jax.jit
    def last(zeta: Any) -> Any:
        model = eqx.tree_at(lambda m: m.zeta, SecondOrder(omega=40.0), zeta)
        return simulate(model, u, dt)[0][-1]

    assert np.isfinite(float(jax.grad(last)(1.0)))
    assert float(last(1.0)) == pytest.approx(float(last(1.0 - 1e-9)), abs=1e-7)
    # critical damping against the closed form of a step
    step = np.ones(50)
    step[0] = 0.0
    jump = np.concatenate([[0.0, 0.0], dt[2:]])
    x = 40.0 * np.cumsum(jump)
    y = simulate(eqx.tree_at(lambda m: m.zeta, SecondOrder(omega=40.0), jnp.asarray(1.0)), step, jump)[0]
    np.testing.assert_allclose(y[1:], 1 - (1 + x[1:]) * np.exp(-x[1:]), atol=1e-9)


# -- rate terms ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("repeated", [[], [20], [-3, -2, -1], [1], [20, -1], [1, 2, 3, 4]])
def test_rate_terms_follow_the_backward_difference(repeated: list[int]) -> None:
    u, dt = path(5)
    dt[repeated] = 0.0  # a repeated time stamp keeps the last rate
    rate = [0.0]
    for k in range(1, u.size):
        rate.append((u[k] - u[k - 1]) / dt[k] if dt[k] > 0 else rate[-1])
    rate = np.array(rate)
    viscous, saturating = Viscous(c=0.3), SaturatingRate(F=2.0, v0=4.0)
    y, resume = simulate(viscous, u, dt)
    np.testing.assert_allclose(y, 0.3 * rate, rtol=1e-13)
    np.testing.assert_allclose(resume.state, rate[-1:], rtol=1e-13)
    np.testing.assert_allclose(simulate(saturating, u, dt)[0], 2.0 * np.tanh(rate / 4.0), rtol=1e-12)
    # a run that is resumed where time stamps repeat goes on with its rate
    first, resume = simulate(viscous, u[:15], dt[:15])
    rest, _ = simulate(viscous, u[15:], dt[15:], resume=resume)
    np.testing.assert_allclose(np.concatenate([first, rest]), 0.3 * rate, rtol=1e-13)


def test_rate_derivatives_are_finite_over_repeated_time_stamps() -> None:
    u, dt = jnp.array([0.0, 1.0, 1.0, 2.0]), jnp.array([0.0, 0.1, 0.0, 0.0])
    for model in (Viscous(c=0.3), SaturatingRate(F=2.0, v0=4.0), SecondOrder(), Lag()):
        gradient = eqx.filter_grad(lambda m: jnp.sum(simulate(m, u, dt)[0]))(model)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree_util.tree_leaves(gradient))


def test_a_lag_starts_from_what_the_loops_of_steep_relays_show():
    """A field that lags by 8 samples, in a sweep of the frequency; at three samples a Preisach model errs five times as much."""
    rng, rate, tau = np.random.default_rng(0), 1e4, 8e-4
    phase = np.concatenate(
        [np.arange(round(rate * n / f)) * 2 * np.pi * f / rate for f, n in ((10, 2), (50, 3), (200, 6))]
    )
    u, lagged = 250 * np.sin(phase), np.zeros(phase.size)
    for k in range(1, u.size):
        lagged[k] = u[k] + (lagged[k - 1] - u[k]) * np.exp(-1 / (rate * tau))
    coercive, bias = 40 * np.exp(0.35 * rng.standard_normal(300)), 15 * rng.standard_normal(300)
    state, y = np.full(300, -1.0), np.empty(u.size)
    for k, value in enumerate(lagged):
        state = np.where(value >= bias + coercive, 1.0, np.where(value <= bias - coercive, -1.0, state))
        y[k] = state.mean() + 4e-4 * value + 0.005 * rng.standard_normal()
    record = hf.Record(u, y, t=np.arange(u.size) / rate)
    assert float(Lag().start([record]).tau) == pytest.approx(tau, rel=0.2)  # of sixteen that were tried
    still = hf.Record(u, 0.01 * u + 0.005 * rng.standard_normal(u.size), t=record.t)
    assert float(Lag().start([still]).tau) == pytest.approx(3 / rate)
