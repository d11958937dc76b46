"""Error on data left out of refits, and BIC, against plain refits and a dense likelihood."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import hystfit as hf
from hystfit.errors import ModelError, ParameterError
from hystfit.fitting.comparison.left_out import bic, inner_error, left_out_error
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.quality.held_out import held_out

T = np.arange(600) / 100
U = np.sin(2 * np.pi * T) * (0.4 + 0.1 * T)


def record(model, noise=0.01, seed=0, u=U, name="made"):
    y = np.asarray(hf.simulate(model, jnp.asarray(u), 0.01)[0])
    return hf.Record(t=T[: u.size], u=u, y=y + noise * np.random.default_rng(seed).normal(size=u.size), name=name)


def bouc_wen():
    return hf.BoucWen(c=1.0, mu=0.5, tau=3.0, rho=0.5, scheme="exact")  # the cost of the other scheme has small steps


def fifths(size):
    return np.array_split(np.arange(size), 5)


def test_the_future_is_predicted_from_plain_refits_to_the_past():
    made = record(bouc_wen())
    fit = hf.fit(hf.BoucWen(scheme="exact"), made)
    squares = []
    for k in (2, 3, 4):
        part = fifths(U.size)[k]
        weight = np.where(np.arange(U.size) < part[0], 1.0, 0.0)
        y = hf.fit(hf.BoucWen(scheme="exact"), made.replace(weight=weight)).predict(made)
        squares.append((np.asarray(y)[part] - made.y[part]) ** 2)
    assert left_out_error(fit, "future") == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-4)


@pytest.mark.parametrize(
    "weights", [np.ones(U.size), np.where(np.arange(U.size) % 3, 0.5, 4.0)], ids=["equal", "unequal"]
)
def test_groups_are_predicted_from_plain_refits_to_the_others(weights):
    made = record(bouc_wen()).replace(weight=weights)
    fit = hf.fit(hf.BoucWen(scheme="exact"), made)
    squares, folds = np.zeros(U.size), held_out([made]).folds[0]
    for k in range(folds.max() + 1):
        y = hf.fit(hf.BoucWen(scheme="exact"), made.replace(weight=np.where(folds == k, 0.0, weights))).predict(made)
        squares[folds == k] = (np.asarray(y)[folds == k] - made.y[folds == k]) ** 2
    held = weights * (folds >= 0)
    assert folds.max() > 0
    error = left_out_error(fit)
    assert error == pytest.approx(np.sqrt(np.average(squares, weights=held)), rel=1e-4)
    assert error > np.sqrt(np.average((np.asarray(fit.predict(made)) - made.y) ** 2, weights=held))
    assert left_out_error(fit, most=1.01 * error) == error
    assert np.isposinf(left_out_error(fit, most=0.8 * error))


@pytest.mark.parametrize("model", [hf.Preisach.of(8), hf.PrandtlIshlinskii.of(6), hf.BoucWen(scheme="exact")])
def test_nothing_of_what_is_predicted_enters_its_fit(model):
    """The last fifth moved by D: its errors move by D, and all others stay as they are."""
    made = record(bouc_wen(), noise=0.003)
    fit = hf.fit(model, made)
    last, D = fifths(U.size)[4], 0.05
    moved = made.replace(y=np.where(np.arange(U.size) >= last[0], made.y + D, made.y))
    weight = np.where(np.arange(U.size) < last[0], 1.0, 0.0)
    past = hf.fit(model, made.replace(weight=weight))
    e = (np.asarray(past.predict(made)) - made.y)[last]
    count = sum(part.size for part in fifths(U.size)[2:])
    extra = np.sum((e - D) ** 2 - e**2) / count
    other = dataclasses.replace(fit, problem=hf.Problem(fit.model, moved))
    before, after = left_out_error(fit, "future"), left_out_error(other, "future")
    assert after**2 - before**2 == pytest.approx(extra, rel=0.01)


PLAYS = hf.PrandtlIshlinskii.of(6).replace(w=np.array([0.5, 0.1, 0.3, 0.0, 0.4, 0.2]))
CELLS = hf.Preisach.of(8).replace(w=np.full(36, 0.05))


@pytest.mark.parametrize("truth", [bouc_wen(), PLAYS, CELLS], ids=["bouc-wen", "plays", "preisach"])
def test_the_offset_of_a_left_out_record_is_fitted_to_it(truth):
    """Any constant may be added to the outputs of a record; nothing else of it enters the fit of the others."""
    errors = []
    for offsets in ((0.0, 0.0, 0.0, 0.0), (3.0, -2.0, 40.0, 1.0)):
        data = [
            (one := record(truth, 0.01, k, a * np.sin(2 * np.pi * T), str(k))).replace(y=one.y + shift)
            for k, (a, shift) in enumerate(zip((0.5, 0.7, 0.85, 1.0), offsets, strict=True))
        ]
        errors.append(left_out_error(hf.fit(truth, data)))
    assert errors[0] == pytest.approx(0.01, rel=0.15)
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)


def dense_deviance(r):
    """-2 log likelihood of residuals under slow and independent noise, its three parameters at their best, by dense algebra."""
    lag = np.abs(np.subtract.outer(np.arange(r.size), np.arange(r.size)))

    def value(at):
        white, slow, time = np.exp(at)
        cover = slow**2 * np.exp(-lag / time) + white**2 * np.eye(r.size)
        return r @ np.linalg.solve(cover, r) + np.linalg.slogdet(cover)[1] + r.size * np.log(2 * np.pi)

    size = np.std(r)
    starts = [np.log([a * size, b * size, c]) for a, b, c in ((0.7, 0.7, 3.0), (0.2, 1.0, 20.0))]
    options = {"xatol": 1e-2, "fatol": 1e-3}
    return min(scipy.optimize.minimize(value, start, method="Nelder-Mead", options=options).fun for start in starts)


def test_bic_is_that_of_a_dense_likelihood():
    u = U[:300]
    made = record(bouc_wen(), noise=0.01, u=u)
    rng, slow = np.random.default_rng(4), np.zeros(u.size)
    for k in range(1, u.size):
        slow[k] = np.exp(-1 / 8) * slow[k - 1] + 0.01 * rng.normal()
    made = made.replace(y=made.y + slow)
    fit = hf.fit("bouc-wen", made)
    r = made.y - np.asarray(fit.predict(made))
    expected = dense_deviance(r) + (len(fit.free_names) + 3) * np.log(u.size)
    assert bic(fit) == pytest.approx(expected, abs=0.1)


def test_bic_counts_neither_correlated_samples_as_news_nor_needless_parameters_as_gain():
    made = record(bouc_wen(), noise=0.005)
    rows = hf.compare(made, ["bouc-wen", "bouc-wen+log-creep"]).rows
    found = {row.name: row.bic for row in rows}
    assert found["bouc-wen"] == min(found.values())
    # A parameter more costs log n, less what it fits of the noise: chi-squared of one degree.
    assert 0 < found["bouc-wen+log-creep"] - found["bouc-wen"] < np.log(U.size) + 1


def test_compare_ranks_by_the_future_in_which_missing_creep_shows_and_says_so():
    made = record(hf.Series(bouc_wen(), hf.LogCreep(gamma=0.08)), noise=0.002)
    found = hf.compare(made, ["bouc-wen", "bouc-wen+log-creep"], left_out="future")
    assert found.rows[0].name == "bouc-wen+log-creep"
    assert found.rows[0].score_percent == pytest.approx(100 * 0.002 / np.ptp(made.y), rel=0.1)
    assert found.rows[1].score_percent > 2 * found.rows[0].score_percent
    assert found.to_dict()["left_out"] == found.scheme == "future"
    assert found.text() == repr(found)


@pytest.mark.usefixtures("as_users_run")
def test_an_unknown_scheme_and_the_future_of_reversal_curves_are_refused():
    made = record(bouc_wen())
    with pytest.raises(ParameterError):
        hf.compare(made, ["bouc-wen"], left_out="points")
    with pytest.raises(ParameterError):
        left_out_error(hf.fit(hf.BoucWen(), made), "points")
    curves = []
    for start in np.linspace(0.9, -1, 8):
        u = np.linspace(start, 1.0, 60)
        curves.append(hf.Record(u=u, y=u + 0.1 * start * (1 - u), name=f"from {start:.2f}"))
    with pytest.raises(ModelError):
        hf.compare(hf.Dataset(tuple(curves)), left_out="future")


def test_a_refit_keeps_an_initial_state_that_its_samples_have_forgotten():
    """The samples of later cycles say nothing of the state before the first, and any value would fit them."""
    u = np.cos(np.linspace(0, 20 * np.pi, 1201))
    y, state = np.empty_like(u), 0.3
    for k, (before, now) in enumerate(zip(np.r_[u[0], u[:-1]], u, strict=True)):
        for _ in range(50):  # dy = 3 |du| (u + 0.4 u^3 - y) + 0.2 du, by short steps
            du = (now - before) / 50
            state += 3 * abs(du) * (now + 0.4 * now**3 - state) + 0.2 * du
        y[k] = state
    noise = 0.01
    y += noise * np.random.default_rng(0).normal(size=y.size)
    fit = hf.fit("duhem", hf.Record(u, y), starts=2)
    assert fit.train.rmse == pytest.approx(noise, rel=0.1)
    assert left_out_error(fit) < 1.5 * noise


@pytest.mark.slow  # of simulated loops, those above are compared with plain fits, which have converged
def test_refits_go_on_until_they_have_converged(measured, monkeypatch):
    """Refits that stop early stay near the values that the held-out samples had helped to find, and err too little."""
    coupon = hf.Dataset.of(hf.datasets.load("steel_resspylab/example_1", folder=measured))[0]
    fit = hf.fit("steel-02", coupon.window(None, round(0.6 * len(coupon))), starts=1)
    linearize, at = hf.Problem.linearization, []
    monkeypatch.setattr(hf.Problem, "linearization", lambda problem, x: at.append(x) or linearize(problem, x))
    found, taken = left_out_error(fit), len(at)
    monkeypatch.setattr("hystfit.fitting.comparison.left_out.STEPS", 1000)
    monkeypatch.setattr("hystfit.fitting.comparison.left_out._WITHIN", 1e-3)
    assert found == pytest.approx(left_out_error(fit), rel=1e-3)
    assert taken < 0.4 * len(at)  # both together: that near to the minimum, most steps change nothing that is ranked


def two_loops(seed=0):
    """Two loops of two hundred relays, by a plain loop over them, and one between them without noise."""
    rng = np.random.default_rng(seed)
    coercivity, bias = 0.1 + 0.4 * rng.random(200), 0.15 * rng.normal(size=200)
    made = []
    for amplitude, noise in ((1.0, 2e-3), (0.3, 2e-3), (0.6, 0.0)):
        u = amplitude * np.cos(2 * np.pi * np.arange(401) / 200)
        state, y = np.where(bias > 0, -1.0, 1.0), np.empty(u.size)
        for k, value in enumerate([*np.linspace(0, amplitude, 50), *u][-u.size - 50 :]):
            state = np.where(value >= bias + coercivity, 1.0, np.where(value <= bias - coercivity, -1.0, state))
            if k >= 50:
                y[k - 50] = state.mean() + 0.3 * value
        made.append(hf.Record(u, y + noise * rng.normal(size=u.size), name=f"{amplitude}").segment(200, 401))
    return made


def test_the_error_by_which_models_are_ranked_is_that_of_a_plain_fit_to_the_outer_loop_too():
    outer, inner, _ = two_loops()
    fit = hf.fit("bouc-wen", [outer, inner])
    error, alone = left_out_error(fit), hf.fit("bouc-wen", outer).predict(inner, refit_offset=True)
    expected = np.sqrt(np.mean((alone - inner.y) ** 2))
    both = np.sqrt(error * expected)
    assert both < 0.8 * error
    assert inner_error(fit, error) == pytest.approx(expected, rel=0.02)
    assert inner_error(fit, error, most=0.9 * both) == np.inf
    (row,) = hf.compare([outer, inner], ["bouc-wen"]).rows
    assert row.score_percent == pytest.approx(100 * both / fit.baselines.span, rel=0.01)


def test_loops_of_one_size_are_ranked_by_scattered_samples():
    outer, *_ = two_loops()
    fit = hf.fit("preisach:n=8", outer)
    assert inner_error(fit, left_out_error(fit)) is None


def superelastic(strain):
    """Stress of a shape memory alloy: 40 GPa, plateaus of 0.4 GPa loading and 0.2 GPa unloading, transformed over a strain of 4 %."""
    stress, part = np.empty(strain.size), 0.0
    for k, e in enumerate(strain):
        upper, lower = 0.4 + 0.5 * e, 0.2 + 0.5 * e
        elastic = 40 * (e - 0.04 * part)
        if elastic > upper:
            part = min(1.0, (e - upper / 40) / 0.04)
        elif elastic < lower:
            part = min(part, max(0.0, (e - lower / 40) / 0.04))
        stress[k] = 1000 * (40 * (e - 0.04 * part))
    return stress


def test_a_model_that_does_not_predict_the_smaller_loops_is_not_said_to():
    strain = np.interp(np.arange(301), 50 * np.arange(7), [0, 0.02, 0, 0.035, 0, 0.045, 0])
    noise = 4 * np.random.default_rng(26).standard_normal(strain.size)
    record = hf.Record(strain, superelastic(strain) + noise, u_unit="mm/mm", y_unit="MPa")
    found = hf.compare(record, ["preisach-signed"])
    fit = found.winner
    assert fit.train.nrmse_percent < 3
    alone = hf.fit("preisach-signed", record.segment(200, 301))
    loops = record.segment(0, 201)
    assert np.sqrt(np.mean((alone.predict(loops, refit_offset=True) - loops.y) ** 2)) > 0.1 * np.ptp(record.y)
    assert has(fit.notes, Code.LEFT_OUT_ERROR)
    assert found.scheme.tested not in found.reason
