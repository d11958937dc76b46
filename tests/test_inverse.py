"""Inverses: forward of inverse is the identity, limits keep the memory right, and what cannot be met says so."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import hystfit as hf
from hystfit.control import InverseStep, Status, invert, lead
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.models.preisach import EverettTable
from hystfit.models.relaxation import Relaxation
from hystfit.models.shared.bracketed import Root, solve_rising

DT = 0.002


def path(seed: int, low: float, high: float, samples: int = 400) -> np.ndarray:
    """Random reversals between low and high."""
    corners = np.random.default_rng(seed).uniform(low, high, 16)
    return np.interp(np.linspace(0, 15, samples), np.arange(16), corners)


def weighted(model: hf.Preisach, seed: int = 3, **fields: float) -> hf.Preisach:
    rng = np.random.default_rng(seed)
    model = eqx.tree_at(lambda m: m.w, model, jnp.asarray(rng.uniform(0, 0.01, model.w.size)))
    for name, value in fields.items():
        model = eqx.tree_at(lambda m, name=name: getattr(m, name), model, jnp.asarray(value))
    return model


COARSE = hf.BoucWen(c=0.1542, mu=0.45, tau=0.01086, rho=0.88)
PLAIN = hf.BoucWen(c=0.1542, mu=0.45, tau=0.01086, rho=0.88, scheme="exact")
PIEZO = hf.BoucWen(c=0.1542, mu=0.45, tau=0.01086, rho=0.88, scheme="exact", offset=0.3)
PLAYS = hf.PrandtlIshlinskii.of(8)
CASES = {
    "bouc-wen": (COARSE, -20, 120, None),
    "bouc-wen exact": (PIEZO, -20, 120, None),
    "bouc-wen coarse": (hf.BoucWen(c=1.0, mu=0.5, tau=0.4, rho=0.5), -20, 120, None),
    "bouc-wen creep": (hf.Series(PIEZO, hf.LogCreep(gamma=(0.0175,))), -20, 120, None),
    "bouc-wen creep of displacement": (hf.Series(PIEZO, hf.LogCreep(gamma=(0.0175, 0.005), span=12.0)), -20, 120, None),
    "plays": (PLAYS, -0.2, 1.2, None),
    "stops": (hf.PrandtlIshlinskii.of(8, operator="stop"), 0, 1, None),
    "envelopes": (hf.PrandtlIshlinskii.of(4, 3, envelopes=3), -0.2, 1.2, None),
    "duhem": (hf.Duhem(alpha=3.0, f=(0.0, 1.0, 0.1, 0.02), g=(0.6, 0.0, 0.0)), -1, 1, None),
    "lag before": (hf.Series(hf.Lag(tau=0.01, rest="first"), PLAYS), 0, 1, None),
    "relaxation after": (hf.Series(PLAYS, Relaxation()), 0, 1, None),
    "creep beside": (hf.Sum(PLAYS, hf.LinearCreep(a=0.02, rest="first")), 0, 1, (-1, 2)),
    "falling": (hf.Sum(hf.BoucWen(c=0.1), hf.PrandtlIshlinskii.of(2, degree=1), hf.Viscous(c=-1e-4)), 0, 1, (-1, 2)),
    "input negated": (hf.Series(hf.Negate(), PLAYS), -1.2, 0.2, None),
    "offset beside": (hf.Sum(hf.BoucWen(), hf.Offset(2.0)), -1, 1, None),
    "preisach off center": (weighted(hf.Preisach.of(6, depth=16, spacing="uniform"), center=0.23), -1, 1, None),
    "preisach negative": (weighted(hf.Preisach.of(6, depth=16, spacing="uniform", initial="negative")), -1, 1, None),
    "preisach symmetric": (
        weighted(hf.Preisach.of(6, depth=16, symmetric=True, degree=3), b=[0.2, 0.0, 0.05]),
        -1,
        1,
        None,
    ),
}


SLOW = (
    "bouc-wen coarse",
    "bouc-wen exact",
    "bouc-wen creep of displacement",
    "offset beside",
    "input negated",
    "relaxation after",
    "preisach off center",
    "preisach negative",
    "preisach symmetric",
)  # another state, one inverse; that of the exact step behind a creep; the inverse of Preisach is that of a bisection below


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in CASES]
)
def test_forward_of_inverse_is_the_identity(name: str) -> None:
    model, low, high, limits = CASES[name]
    dt = None if model.rate_independent else DT
    u = path(1, low, high)
    y = np.asarray(hf.simulate(model, u, dt)[0])
    found = invert(model, y, dt, limits=limits)
    again = np.asarray(hf.simulate(model, found.u, dt, resume=found.start)[0])
    assert np.abs(again - y).max() <= 1e-10 * np.ptp(y)
    assert found.ok
    assert repr(found).startswith(f"Inverse({u.size} samples: {u.size} ok; u from ")
    np.testing.assert_allclose(found.y, again, rtol=0, atol=1e-12 * np.ptp(y))
    if name != "duhem":  # its output at rest does not tell the input
        assert np.abs(found.u - u).max() <= 1e-8 * (high - low)


def cells(initial: str) -> hf.Preisach:
    return weighted(hf.Preisach.of(5, depth=41, spacing="uniform", initial=initial), center=0.1)


@pytest.mark.parametrize("initial", ["demagnetized", pytest.param("negative", marks=pytest.mark.slow)])
@settings(max_examples=20)
@given(levels=st.lists(st.integers(-10, 10), min_size=40, max_size=40))
def test_preisach_inverse_survives_ties_repeats_and_full_reversals(initial: str, levels: list[int]) -> None:
    # Inputs on the levels themselves, where extrema wipe each other out exactly.
    model = cells(initial)
    u = np.asarray(levels) / 10
    y = np.asarray(hf.simulate(model, u)[0])
    found = invert(model, y)
    again = np.asarray(hf.simulate(model, found.u, resume=found.start)[0])
    assert np.abs(again - y).max() <= 1e-6 * np.ptp(y) + 1e-12
    assert found.ok


def test_preisach_inverse_equals_bisection_on_the_forward_model() -> None:
    model = cells("demagnetized")
    y = np.asarray(hf.simulate(model, path(5, -1, 1, 40))[0])
    found = invert(model, y)
    step = eqx.filter_jit(model.step)
    state, u0 = found.start.state, float(found.start.u)
    for k, target in enumerate(y):
        miss = lambda u, state=state, u0=u0, target=target: (
            float(step(state, jnp.asarray(u0), jnp.asarray(u), jnp.asarray(0.0))[1]) - target
        )
        low, high = miss(-1.0), miss(1.0)
        expected = -1.0 if low >= 0 else 1.0 if high <= 0 else brentq(miss, -1.0, 1.0, xtol=1e-13)
        assert abs(float(found.u[k]) - expected) < 1e-9
        state, _ = step(state, jnp.asarray(u0), jnp.asarray(expected), jnp.asarray(0.0))
        u0 = expected


@pytest.mark.slow  # what these inverses do is looked at above; this is how well they do it
def test_inverse_of_coarse_model_tracks_on_a_plant_integrated_ten_times_finer() -> None:
    coarse, fine = (hf.Series(core, hf.LogCreep(gamma=(0.0175,))) for core in (COARSE, PLAIN))
    t = np.arange(0, 1.0, 1e-3)
    reference = 5 - 4 * np.cos(2 * np.pi * 3 * t)
    found = invert(coarse, reference, 1e-3)
    u = np.interp(np.arange(0, (t.size - 1) * 10 + 1) / 10, np.arange(t.size), found.u)
    y = np.asarray(hf.simulate(fine, u, 1e-4)[0])[::10]
    assert np.abs(y - reference).max() < 2e-4 * np.ptp(reference)


def test_saturated_samples_keep_the_memory_of_what_was_given() -> None:
    u = path(2, -20, 120, 300)
    y = np.asarray(hf.simulate(PIEZO, u)[0])
    found = invert(PIEZO, y, limits=(0.0, 90.0))
    assert found.u.min() >= 0.0
    assert found.u.max() <= 90.0
    np.testing.assert_array_equal(found.codes == Status.SATURATED, np.abs(found.y - y) > 1e-7 * np.ptp(y))
    assert 0 < found.counts()["saturated"] < 300
    assert np.isin(found.u[found.codes == Status.SATURATED], [0.0, 90.0]).all()
    given = np.asarray(hf.simulate(PIEZO, found.u, resume=found.start)[0])
    np.testing.assert_allclose(given, found.y, atol=1e-12)
    assert "stays at its limit" in found.notes()[0]


def test_output_that_does_not_rise_gets_a_status_and_never_nan() -> None:
    # g < 0 makes a rising branch fall first: f' - g is too large for the inverse.
    model = hf.Duhem(alpha=2.0, f=(0.0, 1.0), g=(-0.3,))
    found = invert(model, np.sin(np.linspace(0, 12, 300)))
    assert np.isfinite(found.u).all()
    assert found.counts()["not-monotone"] > 0
    assert np.abs(found.u).max() <= 1.25


def test_reference_out_of_the_models_range() -> None:
    model = cells("demagnetized")
    top = float(hf.simulate(model, np.append(-1.0, np.ones(39)))[0][-1])
    found = invert(model, np.tile([0.0, top + 1.0, 0.1, np.nan, 0.0], 8))
    assert found.status == 8 * ("ok", "out-of-range", "ok", "out-of-range", "ok")
    assert found.u[1] == 1.0
    assert found.u[3] == found.u[2]


def test_sample_by_sample_equals_the_whole() -> None:
    model = CASES["bouc-wen creep"][0]
    reference = 5 - 3 * np.cos(np.linspace(0, 9, 40))
    whole = invert(model, reference, DT)
    inverse, memory = InverseStep.of(model), whole.start
    step = eqx.filter_jit(inverse.step)
    for k, target in enumerate(reference):
        memory, answer = step(memory, target, DT)
        assert abs(float(answer.u) - whole.u[k]) < 1e-10
    np.testing.assert_allclose(memory.state, whole.state.state, rtol=1e-12)


def test_two_halves_equal_one_run() -> None:
    y = np.asarray(hf.simulate(PLAYS, path(7, 0, 1))[0])
    whole, first = invert(PLAYS, y), invert(PLAYS, y[:200])
    second = invert(PLAYS, y[200:], resume=first.state)
    np.testing.assert_allclose(np.concatenate([first.u, second.u]), whole.u, atol=1e-12)


@pytest.mark.parametrize("name", ["lag before", "bouc-wen creep", "creep beside", "plays"])
def test_a_device_at_rest_elsewhere_is_followed_from_that_state(name: str) -> None:
    model, *ends, _ = CASES[name]
    low, high = map(float, ends)
    record = hf.Record(u=path(3, low, high), y=np.zeros(400), t=DT * np.arange(400))
    rested = record.resting_on(low)
    y = np.asarray(hf.simulate(model, rested.u, rested.dt)[0])[1:]  # a simulation that begins with the sample at rest
    dt = None if model.rate_independent else DT
    found = invert(model, y, dt, rest=low, limits=(low - 1, high + 1))
    assert found.ok
    np.testing.assert_allclose(found.u, record.u, atol=1e-6 * (high - low))
    np.testing.assert_allclose(np.asarray(hf.simulate(model, found.u, dt, resume=found.start)[0]), y, atol=1e-6)
    assert np.abs(invert(model, y, dt, limits=(low - 1, high + 1)).u - record.u).max() > 1e-3 * (high - low)


def test_a_resonant_device_at_rest_elsewhere_begins_there() -> None:
    model = hf.Series(PLAIN, hf.SecondOrder(omega=2 * np.pi * 630, zeta=0.02))
    reference = 5 - 4 * np.cos(2 * np.pi * 20 * np.arange(0, 0.1, 1e-4))
    found = invert(model, reference, 1e-4, rest=60.0)
    before = np.concatenate([[60.0], found.u])
    np.testing.assert_allclose(found.y, np.asarray(hf.simulate(model, before, 1e-4)[0])[1:], atol=1e-12)
    assert float(found.start.u) == 60.0
    assert np.abs(found.u - invert(model, reference, 1e-4).u).max() > 1.0


def test_resonance_is_led() -> None:
    t = np.arange(0, 0.5, 1e-4)
    reference = 5 - 4 * np.cos(2 * np.pi * 20 * t)
    resonance = hf.SecondOrder(omega=2 * np.pi * 630, zeta=0.02)
    model = hf.Series(PLAIN, resonance)
    output_resonance = np.abs(invert(model, reference, 1e-4).y - reference)[1000:].max()
    plain = np.abs(np.asarray(hf.simulate(model, invert(model.parts[0], reference).u, 1e-4)[0]) - reference)[
        1000:
    ].max()
    assert output_resonance < 0.1 * plain
    ratio = 20 / 630
    assert plain == pytest.approx(4 * abs(1 - 1 / (1 + 0.04j * ratio - ratio**2)), rel=0.02)


def test_lead_of_a_sine_is_the_inverse_transfer_function() -> None:
    t = np.arange(0, 1, 1e-3)
    w, omega, zeta = 2 * np.pi * 5, 2 * np.pi * 52, 0.02
    inverse = 1 + 2 * zeta * 1j * w / omega - (w / omega) ** 2
    expected = (inverse * np.exp(1j * w * t)).imag
    np.testing.assert_allclose(lead(np.sin(w * t), 1e-3, omega=omega, zeta=zeta)[2:-2], expected[2:-2], atol=1e-6)


@jax.jit
def _kinked(root: float, start: float, bend: float) -> Root:
    rise = lambda x: jnp.where(x > 0, bend * x, 0.3 * x) + 0.05 * x**3
    return solve_rising(lambda x: rise(x) - rise(root), start, jnp.asarray(-3.0), jnp.asarray(3.0))


@settings(max_examples=100)
@given(st.floats(-3, 3), st.floats(-2, 2), st.floats(0.1, 4))
def test_bracketed_search_finds_roots_of_kinked_functions(root: float, start: float, bend: float) -> None:
    found = _kinked(root, start, bend)
    assert abs(float(found.x) - root) < 1e-12
    assert bool(found.rising)


def test_signed_masses_get_a_status_where_their_table_is_not_monotone() -> None:
    levels = np.linspace(0, 1, 7)
    table = EverettTable.from_masses(levels, np.full(21, 1.0))
    lowered = table.X.copy()
    lowered[-1] -= 14.0  # to the top of the range the output falls
    table = EverettTable(levels, lowered)
    assert table.turned().max() > 0.1
    model = hf.Preisach(w=table.masses(), levels=levels, initial="negative")
    u = np.concatenate([np.linspace(0, 1, 40), np.linspace(1, 0.2, 40)])
    found = invert(model, np.asarray(hf.simulate(model, u)[0]), limits=(0.0, 1.0))
    assert found.counts()["not-monotone"] > 0
    assert np.isfinite(found.u).all()
    assert "may jump" in " ".join(found.notes())


def test_bad_input_says_what_to_do() -> None:
    with pytest.raises(ModelError, match="give dt"):
        invert(hf.Series(PIEZO, hf.LogCreep()), [1.0, 2.0])
    with pytest.raises(ModelError, match="give limits"):
        invert(hf.Sum(hf.BoucWen(), hf.Viscous(c=0.1)), [1.0, 2.0], 0.1)
    with pytest.raises(ModelError, match="sample by sample"):
        invert(hf.Series(hf.Delay(), PLAYS), [1.0, 2.0])
    with pytest.raises(ModelError, match="low < high"):
        invert(PLAYS, [1.0, 2.0], limits=(1.0, 0.0))
    with pytest.raises(DataError, match="shape"):
        invert(PLAYS, [])
    with pytest.raises(DataError):
        invert(PLAYS, [0.1, 0.2], rest=np.nan)
    with pytest.raises(ParameterError):
        invert(PLAYS, [0.1, 0.2], rest=0.0, resume=invert(PLAYS, [0.1]).state)
    with pytest.raises(DataError, match="sample faster"):
        lead(np.zeros(10), 0.1, omega=100.0, zeta=0.1)


def test_a_search_that_converges_is_not_sent_back_to_the_middle() -> None:
    """The sixth trial of a search by Newton steps was the middle of the bracket, however near the root was."""
    trials = list[float]()

    def root_of_a_root(x: jax.Array) -> jax.Array:
        jax.debug.callback(lambda value: trials.append(float(value)), x)
        return jnp.sqrt(x + 1e-4) - 0.3 + 0.01 * x

    found = solve_rising(root_of_a_root, jnp.asarray(0.0), jnp.asarray(0.0), jnp.asarray(20.0))
    jax.effects_barrier()
    assert float(root_of_a_root(found.x)) == pytest.approx(0.0, abs=1e-14)
    assert len(trials) < 12
