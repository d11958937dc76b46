"""Bouc-Wen against its closed form, an ODE solver, plain loops and the laws of a bounded, dissipative element."""

import math
from collections.abc import Callable
from decimal import Decimal, getcontext
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hystfit.data import Dataset, Record
from hystfit.errors import ModelError
from hystfit.fitting.judgment.assessment import notes_of_model
from hystfit.models import AsymmetricBoucWen, BoucWen, simulate
from hystfit.models.bouc_wen_steps import phi, trapezoid, zero_crossing

FEW = settings(max_examples=40, deadline=None, derandomize=True)
PIEZO = dict(c=0.1542, mu=0.45, tau=0.01086, rho=0.88, h0=0.09, offset=1.5)
UNIT = dict(c=1.3, mu=0.6, tau=2.0, rho=0.4, h0=-0.2, offset=0.2)
LENGTH = 24


def path(seed: int, size: float = 1.0, length: int = 60) -> np.ndarray:
    """Random steps with reversals and rests."""
    rng = np.random.default_rng(seed)
    u = size * rng.uniform(-1, 1, length)
    u[length // 2] = u[length // 2 - 1]
    return u


def slope(q: float, s: float, p: dict[str, float]) -> float:
    """dh/dv times one: the law in the docstring for h = s q, written in h."""
    h, delta = s * q, p["rho"] * p["tau"]
    total = p["tau"] + delta
    m = p["mu"] * p["c"]
    a = p.get("skew", 0.0) * total
    shape = (abs(h) * total / m) ** (p.get("n", 1.0) - 1) if h else 0.0
    return m - (s * p["tau"] * np.sign(h) + delta + a * np.sign(h)) * abs(h) * shape


def first(p: dict[str, float]) -> float:
    """h at the first sample: a part of the bound on its side."""
    side = math.copysign(1.0, p["h0"])
    return (
        p["h0"]
        * p["mu"]
        * p["c"]
        / (p["tau"] * (1 + p["rho"]))
        * (1 + side * p.get("skew", 0.0)) ** (-1 / p.get("n", 1.0))
    )


def ode(u: np.ndarray, p: dict[str, float]) -> np.ndarray:
    """h at every sample by a Runge-Kutta solver of high order, stopped and restarted where h changes sign."""
    h, out = first(p), []
    for k, v in enumerate(u):
        start = u[max(k - 1, 0)]
        while start != v:
            s = math.copysign(1.0, v - start)
            side = math.copysign(1.0, h if h else s)
            crosses: Any = lambda v, h: h[0]
            crosses.terminal, crosses.direction = True, -side
            run = solve_ivp(
                lambda v, h, s=s: [slope(s * h[0], s, p)],
                (start, v),
                [h],
                method="DOP853",
                rtol=1e-12,
                atol=1e-14,
                events=crosses if abs(h) > 1e-15 else None,
            )
            start, h = (v, run.y[0, -1]) if run.status == 0 else (run.t_events[0][0], 0.0)
        out.append(h)
    return np.array(out)


def output(u: np.ndarray, h: np.ndarray, p: dict[str, float]) -> np.ndarray:
    return p["offset"] + p["c"] * u - h


def plain(
    u: np.ndarray, p: dict[str, float], moved: Callable[[float, float, float, float, float], float]
) -> np.ndarray:
    """h at every sample; `moved` gives q = h in the direction of the input after a step of size x: from q, x, m, up, down."""
    m, up, down = p["mu"] * p["c"], p["tau"] * (1 + p["rho"]), p["tau"] * (1 - p["rho"])
    h, out = first(p), []
    for k, v in enumerate(u):
        dv = v - u[max(k - 1, 0)]
        s = -1.0 if dv < 0 else 1.0
        h = s * moved(s * h, abs(dv), m, up, down)
        out.append(h)
    return np.array(out)


def exact(q: float, x: float, m: float, up: float, down: float) -> float:
    """The closed form of n = 1, branch by branch."""
    if q < 0:
        crossing = math.log(1 - down * q / m) / down
        if x <= crossing:
            return m / down - (m / down - q) * math.exp(-down * x)
        q, x = 0.0, x - crossing
    return m / up + (q - m / up) * math.exp(-up * x)


def semi_implicit(q: float, x: float, m: float, up: float, down: float) -> float:
    falls = min(-q / m, x) if q < 0 else 0.0  # part of the way before q reaches zero
    half = (down * falls + up * (x - falls)) / 2
    return min(max(q, m / up), ((1 - half) * q + m * x) / (1 + half))


@pytest.mark.parametrize("p", [PIEZO, UNIT], ids=["piezo", "unit"])
@pytest.mark.parametrize(("scheme", "moved"), [("exact", exact), ("semi-implicit", semi_implicit)])
def test_simulation_equals_a_plain_loop(p: dict[str, float], scheme: Any, moved: Any) -> None:
    u = path(0, 0.7 / p["tau"])
    y, _ = simulate(BoucWen(**p, scheme=scheme), u)
    np.testing.assert_allclose(y, output(u, plain(u, p, moved), p), rtol=1e-12, atol=1e-12 * np.ptp(y))


@pytest.mark.parametrize("rho", [-0.7, 0.0, 0.4, 0.95])
def test_the_exact_step_solves_the_differential_equation(rho: float) -> None:
    p = {**UNIT, "rho": rho}
    u = path(1, 1.0, 30)
    h = output(
        u, np.asarray(simulate(BoucWen(**p, scheme="exact"), u)[0]), p
    )  # y -> h is its own inverse up to the offset
    np.testing.assert_allclose(h, ode(u, p), atol=1e-10)


@pytest.mark.parametrize(
    "shape", [dict(n=1.0, skew=0.3), dict(n=2.5, skew=-0.4), dict(n=0.7, skew=0.0)], ids=["skewed", "sharp", "blunt"]
)
def test_the_asymmetric_law_is_that_of_its_docstring(shape: dict[str, float]) -> None:
    p = {**UNIT, **shape}
    u = np.concatenate([np.linspace(0, 1, 30), np.linspace(1, -0.8, 50)[1:], np.linspace(-0.8, 0.6, 40)[1:]])
    y = np.asarray(simulate(AsymmetricBoucWen(**p, scheme="exact"), u)[0])
    np.testing.assert_allclose(y, output(u, ode(u, p), p), atol=1e-5)  # Runge-Kutta over the kink at h = 0


def order(model: Any, shape: dict[str, float]) -> float:
    """Observed order of a scheme on one loop, from the error at its end against a solution on a much finer grid."""
    corners = np.array([0.0, 0.9, -0.7, 0.5])

    def end(steps: int, scheme: str) -> float:
        u = np.concatenate([np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(corners)])
        return float(simulate(model(**UNIT, **shape, scheme=scheme), np.concatenate([[0.0], u]))[0][-1])

    exact = end(2000, "exact")
    errors = [abs(end(steps, "semi-implicit") - exact) for steps in (25, 100)]
    return math.log(errors[0] / errors[1]) / math.log(4)


@pytest.mark.parametrize(
    ("model", "shape"), [(BoucWen, {}), (AsymmetricBoucWen, dict(n=2.5, skew=0.3)), (AsymmetricBoucWen, dict(n=4.0))]
)
def test_the_semi_implicit_step_is_of_second_order(model: Any, shape: dict[str, float]) -> None:
    assert order(model, shape) > 1.7


@pytest.mark.parametrize("scheme", ["exact", "semi-implicit"])
@pytest.mark.parametrize(
    ("kind", "shape"),
    [(BoucWen, {}), (AsymmetricBoucWen, dict(n=1.0, skew=0.3)), (AsymmetricBoucWen, dict(n=2.5, skew=-0.4))],
)
def test_the_output_is_continuous_in_the_parameters(kind: Any, shape: dict[str, float], scheme: Any) -> None:
    """Steps where h passes zero at a sample would trap least squares and samplers: neighbors differ by what the slope says."""
    u, taus = np.concatenate([path(5, 0.4, 40), np.linspace(-1, 1, 40)]), np.linspace(1.2, 1.8, 4001)
    y = jax.vmap(lambda tau: simulate(kind(**{**UNIT, **shape, "tau": tau}, scheme=scheme), u)[0])(taus)
    moves = np.abs(np.diff(np.asarray(y), axis=0))
    assert np.max(moves) < 3 * np.max(np.median(moves, axis=0))


@pytest.mark.parametrize("scheme", ["exact", "semi-implicit"])
def test_without_asymmetry_the_general_form_is_bouc_wen(scheme: Any) -> None:
    u = 0.3 * np.cumsum(path(3, 0.3, 80))
    plain = simulate(BoucWen(**UNIT, scheme=scheme), u)[0]
    general = simulate(AsymmetricBoucWen(**UNIT, n=1.0, skew=0.0, b=(0.0, 0.0), scheme=scheme), u)[0]
    np.testing.assert_allclose(general, plain, atol=1e-13 if scheme == "semi-implicit" else 1e-5)


def test_the_backbone_is_a_legendre_series() -> None:
    u = np.linspace(-3.0, 5.0, 17)
    bent = AsymmetricBoucWen(**UNIT, b=(0.3, -0.2, 0.1), center=1.0, half=4.0)
    straight = AsymmetricBoucWen(**UNIT, b=(0.0, 0.0, 0.0))
    expected = np.polynomial.legendre.legval((u - 1.0) / 4.0, [0.0, 0.0, 0.3, -0.2, 0.1])
    np.testing.assert_allclose(simulate(bent, u)[0] - simulate(straight, u)[0], expected, atol=1e-13)


# -- laws ----------------------------------------------------------------------------------------------------------------

INPUT = st.lists(st.floats(-1.0, 1.0), min_size=LENGTH, max_size=LENGTH).map(np.array)
SIZE = st.floats(-2.0, 3.0).map(lambda e: 10.0**e)
SCHEME = st.sampled_from(["exact", "semi-implicit"])


@eqx.filter_jit
def states(model: Any, u: Any) -> Any:
    """h at every sample."""

    def body(state: Any, pair: Any) -> Any:
        state, _ = model.step(state, *pair, jnp.zeros(()))
        return state, state[0]

    first = model.init(u[0])
    return jnp.concatenate([first, jax.lax.scan(body, first, (u[:-1], u[1:]))[1]])


@pytest.mark.parametrize("kind", [BoucWen, AsymmetricBoucWen])
def test_the_first_state_is_a_part_of_the_bound(kind: Any) -> None:
    begin = lambda **changes: float(kind(**{**UNIT, **changes}).init(jnp.zeros(()))[0])
    assert begin(h0=-0.5) == pytest.approx(-0.5 * 0.6 * 1.3 / (2.0 * 1.4))
    assert begin(h0=-0.5, tau=0.0) == 0.0  # nothing saturates


@FEW
@given(INPUT, SIZE, SCHEME, st.floats(-0.99, 0.99))
def test_h_is_bounded_for_any_step(u: np.ndarray, size: float, scheme: Any, rho: float) -> None:
    model = BoucWen(c=1.3, mu=0.6, tau=2.0, rho=rho, scheme=scheme)
    h = np.asarray(states(model, jnp.asarray(size * u)))
    assert np.max(np.abs(h)) <= 0.6 * 1.3 / (2.0 * (1 + rho)) * (1 + 1e-12)


@FEW
@given(INPUT, SIZE, SCHEME, st.floats(0.5, 12.0), st.floats(-0.95, 0.95), st.floats(-0.9, 1.0))
def test_the_general_form_is_bounded_for_any_step(
    u: np.ndarray, size: float, scheme: Any, n: float, skew: float, rho: float
) -> None:
    model = AsymmetricBoucWen(c=1.3, mu=0.6, tau=2.0, rho=rho, n=n, skew=skew, scheme=scheme)
    h = np.asarray(states(model, jnp.asarray(size * u)))
    bound = 0.6 * 1.3 / (2.0 * (1 + rho))
    assert np.max(h) <= bound * (1 + skew) ** (-1 / n) * (1 + 1e-12)
    assert np.min(h) >= -bound * (1 - skew) ** (-1 / n) * (1 + 1e-12)


@FEW
@given(INPUT, SIZE, st.floats(-1.0, 1.0))
def test_the_semi_implicit_step_is_dissipative_for_any_step(u: np.ndarray, size: float, rho: float) -> None:
    """The work put in, by the trapezoidal rule, is never less than the gain of the storage h^2 / (2 mu c)."""
    u = size * u
    h = np.asarray(states(BoucWen(c=1.3, mu=0.6, tau=2.0, rho=rho), jnp.asarray(u)))
    work = np.diff(u) * 0.5 * (h[1:] + h[:-1])
    gain = np.diff(h**2) / (2 * 0.6 * 1.3)
    assert (work >= gain - 1e-12 * (np.abs(work) + 1.0)).all()


@FEW
@given(INPUT, st.floats(-1.0, 1.0).map(lambda e: 10.0**e), st.floats(-0.99, 0.99))
def test_the_exact_step_is_dissipative(u: np.ndarray, size: float, rho: float) -> None:
    """As above; each branch is run in sixteen parts, which the exact step must not notice, so that the work can be summed."""
    parts = 16
    ends = size * u
    fine = np.concatenate([ends[:1], *(np.linspace(a, b, parts + 1)[1:] for a, b in pairwise(ends))])
    model = BoucWen(c=1.3, mu=0.6, tau=2.0, rho=rho, scheme="exact")
    h = np.asarray(states(model, jnp.asarray(fine)))
    np.testing.assert_allclose(h[::parts], states(model, jnp.asarray(ends)), atol=1e-12)
    # q is concave where it is positive or negative, so that the trapezoid is short by at most x^3 max |q''| / 12.
    rate = 2.0 * (1 + abs(rho))
    x = np.abs(np.diff(fine))
    work = np.diff(fine) * 0.5 * (h[1:] + h[:-1]) + x**2 * (0.6 * 1.3 * 2) * np.minimum(rate * x, 1.0) / 4
    assert (np.cumsum(work) >= (h[1:] ** 2 - h[0] ** 2) / (2 * 0.6 * 1.3) - 1e-12).all()


def test_skew_lowers_the_saturation_above_zero() -> None:
    u = np.concatenate([np.linspace(0, 20, 2000), np.linspace(20, -20, 4000)])
    h = np.asarray(states(AsymmetricBoucWen(c=1.0, mu=0.5, tau=1.0, rho=0.5, n=2.0, skew=0.4), jnp.asarray(u)))
    bound = 0.5 / 1.5
    assert np.max(h) == pytest.approx(bound / math.sqrt(1.4), rel=1e-6)
    assert np.min(h) == pytest.approx(-bound / math.sqrt(0.6), rel=1e-6)


@FEW
@given(INPUT, st.integers(1, 30))
def test_the_output_is_odd_in_the_input(u: np.ndarray, scale: int) -> None:
    model = BoucWen(c=1.3, mu=0.6, tau=0.1 * scale, rho=0.3, scheme="exact")
    np.testing.assert_allclose(states(model, jnp.asarray(-u)), -states(model, jnp.asarray(u)), atol=1e-14)


# -- derivatives where the formulas switch -------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [1e-15, 1e-9, 1e-6, 9e-5, 1.1e-4, 1e-3, 0.5, 20.0])
def test_phi_and_its_derivative_keep_their_digits(k: float) -> None:
    getcontext().prec = 60
    kappa, x = Decimal(k) / Decimal(2), Decimal(2)
    fading = (-kappa * x).exp()
    value = (1 - fading) / kappa
    derivative = (x * fading * kappa - (1 - fading)) / kappa**2
    found, gradient = jax.value_and_grad(phi)(jnp.array(k / 2), jnp.array(2.0))
    assert float(found) == pytest.approx(float(value), rel=1e-14)
    assert float(gradient) == pytest.approx(float(derivative), rel=1e-11)


@pytest.mark.parametrize("k", [1e-15, 1e-9, 1e-6, 9e-5, 1.1e-4, 1e-3, 0.5, 20.0])
def test_the_way_to_zero_and_its_derivative_keep_their_digits(k: float) -> None:
    getcontext().prec = 60
    kappa, part = Decimal(k) / Decimal(2), Decimal(2)
    value = (1 + kappa * part).ln() / kappa
    derivative = (part * kappa / (1 + kappa * part) - (1 + kappa * part).ln()) / kappa**2
    found, gradient = jax.value_and_grad(zero_crossing)(jnp.array(k / 2), jnp.array(-1.0), jnp.array(0.5))
    assert float(found) == pytest.approx(float(value), rel=1e-14)
    assert float(gradient) == pytest.approx(float(derivative), rel=1e-11)


@eqx.filter_jit
def work_gradient(model: Any, u: Any) -> Any:
    return eqx.filter_grad(lambda model: jnp.sum(states(model, u) ** 2))(model)


@pytest.mark.parametrize(
    "model",
    [
        BoucWen(scheme="exact"),
        BoucWen(),
        BoucWen(mu=0.0, scheme="exact"),
        BoucWen(rho=1.0, scheme="exact"),
        BoucWen(rho=-1.0, scheme="exact"),
        BoucWen(rho=-1.0),
        BoucWen(mu=0.0),
        AsymmetricBoucWen(),
        AsymmetricBoucWen(n=0.6),
        AsymmetricBoucWen(n=3.0, scheme="exact"),
        AsymmetricBoucWen(mu=0.0),
        AsymmetricBoucWen(rho=-1.0, n=2.0),
    ],
    ids=range(12),
)
def test_derivatives_are_finite_at_rest_at_zero_and_on_the_bounds(model: Any) -> None:
    """h = 0 at the start, repeated inputs, an exact return to h = 0, parameters on their bounds, a very long step."""
    u = jnp.array([0.0, 0.0, 0.3, 0.3, 0.0, -0.2, 1e3, -1e3, 0.5])
    gradient = work_gradient(model, u)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree_util.tree_leaves(gradient))
    assert np.isfinite(states(model, u)).all()


@pytest.mark.parametrize("amplitude", [1.0, 40.0], ids=["smooth", "held at the bound"])
def test_the_derivative_that_is_written_out_is_that_of_the_formula(amplitude: float) -> None:
    """In compiled scans too, where the same formula may be rounded in two ways."""
    steps = jnp.diff(jnp.asarray(amplitude * path(3, 1.3)))

    def slopes(step: Any) -> np.ndarray:
        run = lambda x: jax.lax.scan(lambda h, dv: (new := step(h, dv, *x), new), 0.1 * x[0], steps)[1]
        return np.asarray(jax.jit(jax.jacfwd(run))(jnp.array([0.9, 1.7, 0.4])))

    np.testing.assert_allclose(slopes(trapezoid), slopes(trapezoid.__wrapped__), rtol=1e-9, atol=1e-9)


# -- sampling and options ------------------------------------------------------------------------------------------------


def test_coarse_sampling_is_warned_about_and_fine_is_not() -> None:
    fine, coarse = np.linspace(0.0, 1.0, 100), np.linspace(0.0, 1.0, 5)
    for kind in (BoucWen, AsymmetricBoucWen):
        assert kind(tau=2.0, rho=0.5).advice(fine) == ()
        assert "scheme='exact'" in kind(tau=2.0, rho=0.5).advice(coarse)[0]
        assert kind(tau=2.0, rho=0.5, scheme="exact").advice(coarse) == ()


@pytest.mark.parametrize("count", [2, 12])
def test_advice_for_many_records_is_one_note(count: int) -> None:
    names = [f"curve={k}" for k in range(count)]
    loops = [Record(u=np.linspace(0.0, 1.0 + 0.1 * k, 5), y=np.zeros(5), name=name) for k, name in enumerate(names)]
    notes = notes_of_model(Dataset(tuple(loops)), BoucWen(tau=2.0, rho=0.5))
    assert len(notes) == (2 if count == 2 else 1)
    assert (f"'curve=0', and likewise {count - 1} other records" in notes[0].text) == (count > 2)


def test_samples_before_those_that_count_are_not_advised_on() -> None:
    """The calibration point of a reversal curve is far from its first sample."""
    u = np.concatenate([[10.0], np.linspace(0.0, 1.0, 100)])
    weight = (np.arange(u.size) > 0).astype(float)
    assert notes_of_model(Dataset((Record(u=u, y=np.zeros(u.size), weight=weight),)), BoucWen(tau=2.0, rho=0.5)) == []


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize("kind", [BoucWen, AsymmetricBoucWen])
def test_an_unknown_scheme_is_refused(kind: Any) -> None:
    with pytest.raises(ModelError, match="semi-implicit or exact, got 'euler'"):
        kind(scheme="euler")


def test_delta_is_rho_tau() -> None:
    assert float(BoucWen(tau=3.0, rho=-0.5).delta) == -1.5
