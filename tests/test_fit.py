"""Estimators against each other and against linear theory; what a result says of data that determine little."""

import dataclasses
import inspect
import itertools
from types import SimpleNamespace
from unittest.mock import Mock

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.fitting.comparison.left_out import left_out_error
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.solvers.bounded import TrustRegion
from hystfit.fitting.solvers.multistart import spread_starts
from hystfit.fitting.solvers.registry import ESTIMATORS
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code
from hystfit.outcome.note import has

from . import test_recovery

T = np.linspace(0.0, 6.0, 600)
TRUTH = {"c": 0.15, "mu": 0.45, "tau": 0.02, "rho": 0.6, "offset": 3.0}


def sweep(amplitude=60.0, cycles=6.0):
    return amplitude * (0.2 + 0.8 * T / T[-1]) * np.sin(2 * np.pi * cycles * T / T[-1])


def record(model, u=None, noise=0.01, seed=0, **labels):
    u = sweep() if u is None else u
    y = np.asarray(hf.simulate(model, u, np.gradient(T))[0])
    return hf.Record(u=u, y=y + np.random.default_rng(seed).normal(0, noise, u.size), t=T, **labels)


@pytest.fixture(scope="module")
def piezo():
    return record(hf.BoucWen(**TRUTH), u_unit="V", y_unit="um")


@pytest.fixture(scope="module")
def fitted(piezo):
    return hf.fit(hf.BoucWen(), piezo)


def test_fit_needs_no_guess_and_reports_units(fitted):
    assert fitted.usable
    for name, value in TRUTH.items():
        assert abs(fitted[name].value - value) < 4 * fitted[name].stderr
    assert fitted["c"].unit == "um/V"
    assert fitted["tau"].unit == "1/V"
    assert fitted["h0"].fixed
    assert fitted["h0"].stderr is None
    assert fitted.in_best_basin >= 4


def test_the_options_of_every_fit_are_those_of_the_public_function():
    """Fits of a comparison or a batch begin with `FitOptions()`."""
    public = inspect.signature(hf.fit).parameters
    own = [field for field in dataclasses.fields(FitOptions) if field.name != "spacing"]  # which a comparison sets
    assert {field.name: field.default for field in own} == {
        name: p.default
        for name, p in public.items()
        if name not in ("model", "data", "y", "t", "u", "test", "settings")
    }
    assert FitOptions(fix=[], free=[], seed=3).changed() == []
    assert FitOptions(fix={"c": 1.0}, starts=1).changed() == ["fix", "starts"]


# Without jaxopt, the bounded quasi-Newton method is compared in tests/test_versions.py.
@pytest.mark.parametrize("method", ["dogleg", "trf", pytest.param("lbfgsb", marks=pytest.mark.slow)])
def test_estimators_reach_one_optimum(fitted, piezo, method):
    other = hf.fit(hf.BoucWen(), piezo, method=method, starts=8 if method == "dogleg" else 1)
    # The start is off by thirty standard errors.
    for name in TRUTH:
        assert abs(other[name].value - fitted[name].value) < 0.02 * fitted[name].stderr


@pytest.mark.parametrize("method", ["lm", "trf"])
def test_parameters_of_a_record_without_weight_stay_where_they_start(method):
    """The third record has zero weight: its offset does not move, and the others are fitted as they are without it."""
    truth, u = hf.BoucWen(c=1.0, mu=0.5, tau=3.0, rho=0.5), np.sin(2 * np.pi * T)
    data = [record(truth, a * u, seed=k, name=f"r{k}") for k, a in enumerate((0.5, 0.7, 0.85, 1.0))]
    whole, alone = (Problem(hf.BoucWen(), hf.Dataset.of(some)) for some in (data, [*data[:2], data[3]]))
    part = whole.reweighted([one.weight * (k != 2) for k, one in enumerate(data)])
    start = whole.space.clip(whole.space.vector(whole.model) + 0.05)
    without, there = whole.space.names.index("offset@r2"), np.arange(start.size) != whole.space.names.index("offset@r2")
    ends = [
        ESTIMATORS.make(method).estimate(problem, problem.space.unconstrained(x)[None]).x
        for problem, x in ((part, start), (alone, start[there]))
    ]
    assert ends[0][without] == pytest.approx(start[without], rel=1e-9)
    np.testing.assert_allclose(ends[0][there], ends[1], rtol=1e-4, atol=1e-4)


def test_errors_equal_linear_regression():
    """A model that is linear in all that is free: covariance = sigma^2 (A'A)^-1."""
    u = sweep()
    model = hf.BoucWenForce(kappa_x=0.2, kappa_w=3.0, rho=0.1, n=1.0, offset=1.0)
    data = record(model, u, noise=0.05)
    result = hf.fit(model, data, fix=["rho", "sigma", "n"], start="model", noise="iid")
    w = (np.asarray(hf.simulate(model, u)[0]) - 1.0 - 0.2 * u) / 3.0
    A = np.column_stack([u, w, np.ones(u.size)])
    theta, rss = np.linalg.lstsq(A, data.y, rcond=None)[:2]
    covariance = rss[0] / (u.size - 3) * np.linalg.inv(A.T @ A)
    names = ["kappa_x", "kappa_w", "offset"]
    assert [result[name].value for name in names] == pytest.approx(theta, rel=1e-6)
    assert [result[name].stderr for name in names] == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)


def test_the_condition_is_that_of_centered_columns_of_unit_length(piezo, fitted):
    """The offset takes the means of the other columns, so that it is no reason for a large condition."""
    J = fitted.problem.linearize(fitted.x)[1].reshape(-1, len(fitted.free_names))[: len(piezo)]
    others = J[:, [name != "offset" for name in fitted.free_names]]
    others = others - others.mean(axis=0)
    assert fitted.condition == pytest.approx(np.linalg.cond(others / np.linalg.norm(others, axis=0)), rel=1e-3)
    assert fitted.condition > 10


def test_correlated_residuals_widen_the_errors(piezo):
    rng = np.random.default_rng(1)
    slow = np.zeros(T.size)
    for k in range(1, T.size):
        slow[k] = 0.95 * slow[k - 1] + rng.normal(0, 0.01)
    noisy = piezo.replace(y=piezo.y + slow)
    honest, naive = hf.fit(hf.BoucWen(), noisy), hf.fit(hf.BoucWen(), noisy, noise="iid")
    # Least squares under the dense covariance of the noise that was added: white of sd 0.01, AR(1) with innovations of sd 0.01.
    names = ["c", "mu", "tau", "rho", "offset"]
    output = lambda x: hf.simulate(hf.BoucWen(**dict(zip(names, x, strict=True))), sweep())[0]
    inverse = np.linalg.pinv(np.asarray(jax.jacfwd(output)(jnp.asarray([TRUTH[name] for name in names]))))
    lag = np.abs(np.subtract.outer(np.arange(T.size), np.arange(T.size)))
    covariance = 0.01**2 * np.eye(T.size) + 0.01**2 / (1 - 0.95**2) * 0.95**lag
    expected = np.sqrt(np.diag(inverse @ covariance @ inverse.T))
    assert "no significant autocorrelation" not in naive.report()
    assert has(naive.notes, Code.ERROR_RATIO)
    for k, name in enumerate(names[:4]):  # the offset depends on the slowest noise, which one record hardly shows
        assert honest[name].stderr == pytest.approx(expected[k], rel=0.2)
        assert naive[name].stderr < 0.5 * expected[k]
    assert has(honest.notes, Code.ERROR_RATIO)


def test_residuals_that_oscillate_are_not_called_white(piezo):
    """A ripple of an instrument: its autocorrelations cancel in their sum, of which errors and report take the root."""
    ripple = piezo.replace(y=piezo.y + 0.02 * np.sin(2 * np.pi * np.arange(T.size) / 16))
    result = hf.fit(hf.BoucWen(), ripple)
    assert result.correlation_time == 1.0
    assert has(result.notes, Code.ERROR_RATIO)
    assert "no significant autocorrelation" not in result.report()
    assert "no significant autocorrelation" in hf.fit(hf.BoucWen(), piezo).report()


def test_several_records_share_the_model_and_keep_their_offsets():
    model = hf.BoucWen(**TRUTH)
    first = record(model, name="first")
    second = record(eqx.tree_at(lambda m: m.offset, model, jnp.asarray(-7.0)), u=0.8 * sweep(), seed=1, name="second")
    result = hf.fit(hf.BoucWen(), [first, second.segment(0, 500)])
    assert result["offset@first"].value == pytest.approx(3.0, abs=0.01)
    assert result["offset@second"].value == pytest.approx(-7.0, abs=0.01)
    assert result["c"].stderr < hf.fit(hf.BoucWen(), first)["c"].stderr
    assert result.metrics(second).rmse < 0.012  # predicts a record with that record's own offset


def test_robust_loss_ignores_outliers(piezo, fitted):
    y = piezo.y.copy()
    y[::50] += 4.0
    spoiled = piezo.replace(y=y)
    plain, robust = hf.fit(hf.BoucWen(), spoiled), hf.fit(hf.BoucWen(), spoiled, loss="cauchy")
    wrong = lambda result: abs(result["offset"].value - fitted["offset"].value)
    assert wrong(robust) < 0.1 * wrong(plain)


def test_missing_output_is_left_out(piezo):
    y = piezo.y.copy()
    y[100:200] = np.nan
    result = hf.fit(hf.BoucWen(), piezo.replace(y=y))
    assert result.train.n == 500
    assert abs(result["c"].value - 0.15) < 4 * result["c"].stderr


def test_window_holds_its_samples_back(piezo):
    result = hf.fit(hf.BoucWen(), piezo.window(1.0, 4.0), test=piezo.window(4.0, None))
    assert result.train.n == 300
    assert result.test.n == 200
    assert result.test.rmse < 0.02
    assert has(result.notes, Code.EXTRAPOLATION)  # the sweep still grows after 4 s


def test_small_loops_leave_the_shape_open():
    """At a tenth of the amplitude the loop is all but straight: tau and rho trade against each other."""
    data = record(hf.BoucWen(**TRUTH), u=0.02 * sweep(), noise=0.01)
    result = hf.fit(hf.BoucWen(), data)
    assert has(result.notes, Code.NOT_DETERMINED)
    assert result["rho"].stderr is None
    assert result["rho"].identifiable is False


def test_parameter_without_influence_is_named(piezo):
    late = piezo.window(5.0, None)
    result = hf.fit(hf.AsymmetricBoucWen(), late, free=["h0"], fix={"n": 1.0, "skew": 0.0})
    # The memory of h0 has decayed by exp(-tau * path) long before the window.
    assert result["h0"].stderr is None
    assert result["h0"].identifiable is False
    assert has(result.notes, Code.NOT_DETERMINED)


def test_a_bound_reached_is_named(piezo):
    result = hf.fit(hf.BoucWenForce(), piezo)  # n = 1 generated these data, at the edge of n >= 1
    assert result["n"].at_bound == "lower"
    assert result["n"].stderr is None
    assert has(result.notes, Code.AT_BOUND)


def test_a_model_that_cannot_make_the_loop_is_poor():
    u = sweep()
    pinched = hf.Record(u=u, y=np.sign(u) * u**2 * np.sign(np.gradient(u)), t=T)
    result = hf.fit(hf.BoucWen(), pinched)
    assert result.status == "poor"
    assert not result.usable


def test_a_record_that_never_turns_back_is_no_loop():
    u = np.linspace(0, 10, T.size)
    assert hf.fit(hf.BoucWen(), hf.Record(u=u, y=u + 0.1 * np.sin(u))).status == "no-loop"


def test_a_fixed_parameter_keeps_the_value_of_the_model_given(piezo):
    value = lambda found, name: next(p.value for p in found.parameters if p.name == name)
    assert value(hf.fit(hf.BoucWen(mu=0.37), piezo, fix=["mu"], starts=1), "mu") == pytest.approx(0.37, rel=1e-12)
    assert value(hf.fit(hf.BoucWen(mu=0.37), piezo, fix={"mu": 0.2}, starts=1), "mu") == pytest.approx(0.2, rel=1e-12)


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (dict(fix=["gain"]), ParameterError, "the parameters are: c, mu"),
        (dict(fix={"mu": 1.5}), ParameterError, "outside its bounds"),
        (dict(fix=["c"], free=["c"]), ParameterError, "fixed and free"),
        (dict(fix=["c", "mu", "tau", "rho", "offset"]), ParameterError, "nothing to fit"),
        (dict(method="newton"), ParameterError, "method must be one of"),
        (dict(loss="l1"), ParameterError, "loss must be one of"),
        (dict(starts=0), ParameterError, "at least one start"),
        (dict(method="convex", fix=["offset"]), ModelError, "no linear weights"),
    ],
)
def test_bad_settings_are_refused(piezo, change, error, words):
    with pytest.raises(error, match=words):
        hf.fit(hf.BoucWen(), piezo, **change)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (lambda: hf.Record(u=np.ones(50), y=np.arange(50.0)), "input is constant"),
        (lambda: hf.Record(u=sweep(), y=np.ones(600)), "output is constant"),
        (lambda: hf.Record(u=np.array([1.0]), y=np.array([2.0])), "at least two"),
        (lambda: hf.Record(u=np.array([1.0, 2.0, 1.0]), y=np.array([2.0, 3.0, 1.0])), "cannot determine"),
        (lambda: hf.Record(u=np.array([1.0, np.nan, 2.0]), y=np.array([1.0, 1.0, 2.0])), "not finite"),
        (lambda: hf.Record(u=np.array([1.0, 2.0]), y=np.array([1.0, 2.0, 3.0])), "differ in length"),
        (lambda: [], "no records"),
    ],
)
def test_bad_data_are_refused(data, words):
    with pytest.raises(DataError, match=words):
        hf.fit(hf.BoucWen(), data())


def test_time_is_asked_for_where_a_model_needs_it():
    with pytest.raises(ModelError, match="no time column"):
        hf.fit(hf.BoucWenOscillator(), hf.Record(u=sweep(), y=sweep()))


@pytest.fixture
def compiled():
    """Compilations since the test began or cleared it, counted by JAX itself."""
    events = []

    def listen(event, seconds, **_):
        if event == "/jax/core/compile/backend_compile_duration":
            events.append(event)

    jax.monitoring.register_event_duration_secs_listener(listen)
    jax.jit(lambda x: x + len(events))(1.0)
    assert events  # a new program is counted
    events.clear()
    return events


def test_a_second_record_of_the_same_shape_compiles_nothing(piezo, fitted, compiled):
    hf.fit(hf.BoucWen(), piezo)
    compiled.clear()
    u = 0.9 * sweep()
    fresh = record(hf.BoucWen(**TRUTH), u=u, seed=5, name="another name").segment(0, 560)
    hf.fit(hf.BoucWen(), fresh)
    assert not compiled


@pytest.mark.parametrize(
    "case",
    [case if case == "oscillator" else pytest.param(case, marks=pytest.mark.slow) for case in test_recovery.CASES],
)
def test_fitting_a_record_again_compiles_nothing(case, compiled):
    """A conditional outside compiled code is compiled by each call; a batch then ends where memory maps do, after 700 records."""
    (truth, u), t = test_recovery.CASES[case], test_recovery.T
    record = hf.Record(u=u, y=np.asarray(hf.simulate(truth, u, t[1] - t[0])[0]), t=t)
    start = "model" if case in ("prandtl-ishlinskii", "preisach") else "data"
    hf.fit(truth, record, start=start, starts=1)
    compiled.clear()
    hf.fit(truth, record, start=start, starts=1)
    assert not compiled


def test_refits_without_a_block_use_the_programs_of_the_fit(fitted, compiled):
    error = left_out_error(fitted)
    assert not compiled
    assert fitted.train.rmse < error < 2 * fitted.train.rmse


def test_starts_stay_inside_the_bounds_and_repeat(piezo):
    problem = hf.Problem(hf.BoucWen().start([piezo]), piezo)
    center = problem.space.unconstrained(problem.space.vector(problem.model))
    starts = spread_starts(problem, center, 16, seed=3)
    assert np.array_equal(starts, spread_starts(problem, center, 16, seed=3))
    assert np.array_equal(starts[0], center)
    x = np.array([problem.space.physical(z) for z in starts])
    c = problem.space.coordinates
    assert (x > np.asarray(c.lower)).all()
    assert (x < np.asarray(c.upper)).all()
    assert np.ptp(x[:, 1]) > 0.5  # mu covers most of its range


def test_jaxopt_lives_in_one_file():
    """No longer maintained by its authors: one file to mend when a newer JAX breaks it."""
    from .conftest import ROOT

    users = [p.name for p in (ROOT / "hystfit").rglob("*.py") if "import jaxopt" in p.read_text(encoding="utf-8")]
    assert users == ["bounded.py"]


def test_a_loop_that_loses_stiffness_is_refused():
    u = np.concatenate([a * np.sin(np.linspace(0, 6 * np.pi, 600)) for a in (0.4, 0.7, 1.0, 0.4)])
    force = np.asarray(hf.simulate(hf.BoucWenForce(kappa_x=0.3, kappa_w=1.0, rho=4.0, sigma=0.8, n=2.0), u)[0])
    worn = force * np.exp(-np.cumsum(np.abs(np.diff(u, prepend=0.0))) / 60)
    assert hf.fit("bouc-wen-force", hf.Record(u=u, y=force), starts=1).usable
    fit = hf.fit("bouc-wen-force", hf.Record(u=u, y=worn), starts=1)
    assert fit.status == "poor"
    assert has(fit.notes, Code.MODEL_MISMATCH)


def test_damage_outside_the_window_is_not_held_against_the_fit():
    """Cycles of three sizes, repeated; the stiffness falls by half in the last six."""
    u = np.concatenate([a * np.sin(np.linspace(0, 6 * np.pi, 600, endpoint=False)) for a in (0.4, 0.7, 1.0) * 4])
    part = 1 - 0.5 * np.clip((np.arange(u.size) - 5400) / 900, 0, 1)
    model = hf.BoucWenForce(kappa_x=0.3, kappa_w=1.0, rho=4.0, sigma=0.8, n=2.0)
    y = np.asarray(hf.simulate(model, u)[0]) * part + 0.3 * u**3  # of which the model knows nothing: 1.3 % of the range
    record = hf.Record(u, y)
    for fitted, damaged in ((record, True), (record.window(stop=5000.0), False)):
        assert has(hf.fit("bouc-wen-force", fitted, starts=1).notes, Code.MODEL_MISMATCH) == damaged


def test_white_noise_as_large_as_the_loop_is_no_fault_of_the_model():
    """Neither is noise without a loop described by one, nor a loop that the model cannot make."""
    rng, truth = np.random.default_rng(0), hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    u = 0.1 * np.sin(2 * np.pi * 3 * np.arange(600) / 600)
    y = np.asarray(hf.simulate(truth, u)[0])
    noisy = hf.fit("bouc-wen", hf.Record(u=u, y=y + 0.01 * rng.normal(size=600)), starts=2)
    assert noisy.train.nrmse_percent > 3
    assert noisy.status == "ok"
    assert has(noisy.notes, Code.MEASUREMENT_NOISE)
    buried = 0.15 * np.sin(2 * np.pi * 8 * np.arange(400) / 400)  # noise alone looks like stiffness lost here
    y2 = np.asarray(hf.simulate(truth, buried)[0]) + 0.02 * np.random.default_rng(3).normal(size=400)
    assert hf.fit(truth, hf.Record(u=buried, y=y2), start="model", starts=1).status == "ok"
    empty = hf.fit("bouc-wen", hf.Record(u=u, y=rng.normal(size=600)), starts=2)
    assert empty.status == "no-loop"
    bent = hf.fit("bouc-wen", hf.Record(u=u, y=y + 0.01 * np.sin(90 * u) + 0.001 * rng.normal(size=600)), starts=2)
    assert bent.status == "poor"


class Rooted(AbstractHysteresis):
    """A line whose slope has an infinite derivative where its parameter is zero."""

    rate_independent = True
    k: jax.Array = hf.param(0.0, unit="1", doc="squared slope")
    offset: jax.Array = hf.param(0.0, unit="y", doc="output at zero input")

    def init(self, u0):
        return jnp.zeros(1)

    def step(self, state, u0, u1, dt):
        return state, jnp.sqrt(jnp.abs(self.k)) * u1 + self.offset


class Steep(Rooted):
    """A model whose derivative with respect to k is finite, and its square is not."""

    def step(self, state, u0, u1, dt):
        return state, jnp.sin(1e200 * self.k) * 1e-3 * u1 + self.offset


@pytest.mark.parametrize("model", [Rooted(), Steep()])
def test_the_bounded_solver_survives_derivatives_without_finite_squares(model):
    u = sweep()
    data = hf.Record(u=u, y=0.3 * u + 2.0, t=T)
    fitted = hf.fit(model, data, method="trf", start="model")
    if type(model) is Rooted:
        np.testing.assert_allclose([fitted["k"].value, fitted["offset"].value], [0.09, 2.0], rtol=1e-6)
    else:  # no derivative shows where k should go
        assert not fitted.usable
        assert np.isfinite(fitted.x).all()


def test_a_start_from_which_no_step_is_finite_ends_in_silence():
    """The steps shrink until powers of their inverse overflow; warnings are errors here."""
    start, low, high = np.array([1.0, 2.0]), np.zeros(2), np.full(2, np.inf)
    problem = Mock(
        idle=np.zeros(2, dtype=bool),
        spec=Problem,
        space=SimpleNamespace(
            scale=np.ones(2), lower=low, upper=high, physical=lambda z: z, clip=lambda x: np.clip(x, low, high)
        ),
        misfit=Mock(side_effect=itertools.chain([np.ones(3)], itertools.repeat(np.full(3, np.nan)))),
        linearize_misfit=lambda x: (None, np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])),
    )
    found = TrustRegion().estimate(problem, start[None])
    np.testing.assert_array_equal(found.x, start)
    assert not found.converged
