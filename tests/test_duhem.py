"""Duhem against plain loops in powers of v, an ODE solver, and what its branches tend to."""

import math
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import polynomial
from scipy.integrate import solve_ivp

from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models import Duhem, simulate
from hystfit.models.duhem import _responses
from hystfit.models.shared.simulation import run

F, G = (0.1, 1.0, 0.02, -0.03), (0.5, 0.05, -0.02)  # in powers of v
ALPHA, W0, LOW, HIGH = 0.8, 0.3, -2.0, 3.0


def model(scheme: Any) -> Duhem:
    return Duhem.from_powers(ALPHA, F, G, LOW, HIGH, w0=W0, scheme=scheme)


def path(seed: int, length: int = 60) -> np.ndarray:
    u = np.random.default_rng(seed).uniform(LOW, HIGH, length)
    u[length // 2] = u[length // 2 - 1]
    return u


def plain(u: np.ndarray, scheme: str) -> np.ndarray:
    """The difference equations written out, with the paper's powers of v."""
    w, out = W0, [W0]
    for a, b in pairwise(u):
        dv, mid = b - a, 0.5 * (a + b)
        f, g = polynomial.polyval(mid, F), polynomial.polyval(mid, G)
        if scheme == "explicit":
            w = w + ALPHA * abs(dv) * (f - w) + g * dv
        else:
            w = (w * (1 - ALPHA * abs(dv) / 2) + ALPHA * abs(dv) * f + g * dv) / (1 + ALPHA * abs(dv) / 2)
        out.append(w)
    return np.array(out)


def ode(u: np.ndarray, alpha: float, f: Any, g: Any, w0: float) -> np.ndarray:
    w, out = w0, [w0]
    for a, b in pairwise(u):
        s = np.sign(b - a)
        if s:
            law = lambda v, w, s=s: s * alpha * (f(v) - w) + g(v)
            w = solve_ivp(law, (a, b), [w], method="DOP853", rtol=1e-11, atol=1e-13).y[0, -1]
        out.append(w)
    return np.array(out)


@pytest.mark.parametrize("scheme", ["explicit", "midpoint"])
def test_simulation_equals_a_plain_loop(scheme: Any) -> None:
    u = path(0)
    np.testing.assert_allclose(simulate(model(scheme), u)[0], plain(u, scheme), rtol=1e-12, atol=1e-12)


def test_the_exact_scheme_solves_the_differential_equation() -> None:
    u = path(1)
    expected = ode(u, ALPHA, lambda v: polynomial.polyval(v, F), lambda v: polynomial.polyval(v, G), W0)
    np.testing.assert_allclose(simulate(model("exact"), u)[0], expected, atol=1e-10)


@pytest.mark.parametrize("orders", [3, 12])
@pytest.mark.parametrize("alpha", [0.1, 1.0, 3.0, 30.0])
def test_the_exact_scheme_is_exact_on_short_and_long_steps_both_ways(orders: int, alpha: float) -> None:
    """alpha |dv| from below 0.1 to above 100, high orders included; a series in 1/alpha alone would lose nine digits."""
    rng = np.random.default_rng(2)
    f, g = rng.normal(size=orders + 1), rng.normal(size=orders)
    legendre = np.polynomial.legendre.legval
    u = np.array([-1.0, 2.9, -0.9, -0.4, 2.0, 1.9, 2.0])
    expected = ode(u, alpha, lambda v: legendre((v - 1) / 2, f), lambda v: legendre((v - 1) / 2, g), 0.3)
    found = simulate(Duhem(alpha=alpha, f=f, g=g, w0=0.3, center=1.0, half=2.0, scheme="exact"), u)[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(("scheme", "least", "most"), [("explicit", 0.9, 1.1), ("midpoint", 1.9, 2.1)])
def test_the_order_of_each_scheme(scheme: Any, least: float, most: float) -> None:
    corners = (0.0, 2.5, -1.5, 1.0)

    def end(steps: int, scheme: Any) -> float:
        u = np.concatenate([[0.0], *(np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(corners))])
        return float(simulate(model(scheme), u)[0][-1])

    exact = end(1, "exact")
    errors = [abs(end(steps, scheme) - exact) for steps in (40, 160)]
    assert least < math.log(errors[0] / errors[1]) / math.log(4) < most


@pytest.mark.parametrize("scheme", ["exact", "midpoint", "explicit"])
def test_far_along_a_branch_the_loop_is_two_times_the_slope_difference_over_alpha_wide(scheme: Any) -> None:
    """f = a v, g = b: the branches tend to a v -+ (a - b) / alpha."""
    a, b, alpha = 1.2, 0.5, 2.0
    loop = Duhem.from_powers(alpha, (0.0, a), (b,), -20.0, 20.0, scheme=scheme)
    up = np.linspace(-20.0, 20.0, 401)
    y = np.asarray(simulate(loop, np.concatenate([up, up[::-1]]))[0])
    at = 200
    early = a * 0.1 if scheme == "explicit" else 0.0  # f in the middle of a step, w at its start: narrower by a |dv|
    assert y[2 * up.size - 1 - at] - y[at] == pytest.approx(2 * (a - b) / alpha - early, rel=1e-10)
    assert y[at] == pytest.approx(-(a - b) / alpha + early / 2, rel=1e-10)


def test_powers_go_to_legendre_and_back() -> None:
    f, g = model("midpoint").powers()
    np.testing.assert_allclose(f, F, atol=1e-14)
    np.testing.assert_allclose(g, G, atol=1e-14)
    curves = model("midpoint").curves(jnp.linspace(LOW, HIGH, 5))
    np.testing.assert_allclose(curves[0], polynomial.polyval(np.linspace(LOW, HIGH, 5), F), atol=1e-13)
    np.testing.assert_allclose(curves[1], polynomial.polyval(np.linspace(LOW, HIGH, 5), G), atol=1e-13)


@pytest.mark.parametrize(("f", "g"), [(7, 5), (0, 0)])
def test_orders_are_free(f: int, g: int) -> None:
    made = Duhem.of_order(f, g, scheme="exact")
    assert (made.f.shape, made.g.shape) == ((f + 1,), (g + 1,))
    assert np.isfinite(simulate(made, np.linspace(-1, 1, 7))[0]).all()


@pytest.mark.parametrize("scheme", ["explicit", "midpoint", "exact"])
def test_derivatives_are_finite_where_the_input_rests_and_on_long_steps(scheme: Any) -> None:
    u = jnp.array([0.0, 0.0, 1.0, 1.0, -1.0, 2.9, 2.9, -2.0])

    @eqx.filter_jit
    def gradient(made: Duhem) -> Any:
        return eqx.filter_grad(lambda made: jnp.sum(simulate(made, u)[0]))(made)

    for alpha in (0.0, 1.0, 40.0):
        made = eqx.tree_at(lambda m: m.alpha, model(scheme), jnp.asarray(alpha))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree_util.tree_leaves(gradient(made)))


def test_the_exact_scheme_has_exact_derivatives_on_both_sides_of_its_switch() -> None:
    u = jnp.array([0.0, 1.0, -0.5])
    made = model("exact")
    f = jax.jit(jax.value_and_grad(lambda a: jnp.sum(run(eqx.tree_at(lambda m: m.alpha, made, a), u, 0 * u)[0])))
    h = 1e-5
    for rate in (7.9, 8.1):
        difference = float(f(rate + h)[0] - f(rate - h)[0]) / (2 * h)
        assert float(f(rate)[1]) == pytest.approx(difference, rel=1e-6)


@pytest.mark.usefixtures("as_users_run")
def test_an_unknown_scheme_is_refused() -> None:
    with pytest.raises(ModelError, match="midpoint, explicit or exact, got 'rk4'"):
        Duhem(scheme="rk4")  # type: ignore[arg-type]


def test_responses_of_the_start_are_those_of_a_plain_loop() -> None:
    """Midpoint steps  w += drive (f - w) + g dv,  linear in the coefficients of f and g and in the first output."""
    v = np.cumsum(np.random.default_rng(3).normal(size=40))
    columns, _ = _responses(Record(v, v), (0.5, 4.0), 3, 2, 0.7)
    f, g, first = np.array([0.3, -1.0, 0.5]), np.array([0.2, 0.4]), 0.9
    w, expected = first, [first]
    for a, b in pairwise(v):
        x, drive = (0.5 * (a + b) - 0.5) / 4.0, 0.7 * abs(b - a)
        forced = drive * np.polynomial.legendre.legval(x, f) + (b - a) * np.polynomial.legendre.legval(x, g)
        w = ((1 - 0.5 * drive) * w + forced) / (1 + 0.5 * drive)
        expected.append(w)
    np.testing.assert_allclose(columns @ np.concatenate([f, g, [first]]), expected, rtol=1e-12)
