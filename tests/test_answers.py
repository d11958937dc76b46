"""The first answer: `check` advises what `fit` chooses, and neither takes a cause for sure that the record cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.contender import Candidate, First, leader
from hystfit.fitting.convex import search_nonlinear
from hystfit.fitting.data_check import check
from hystfit.fitting.fit_warnings import drift_note
from hystfit.fitting.screening import screen
from hystfit.fitting.structure_search import search_structure
from hystfit.fitting.verdict import residuals_are_white
from hystfit.inference.problem import Problem
from hystfit.models.registry import SEARCH
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
from hystfit.quality.held_out import Scheme, held_out
from hystfit.quality.summary import paces

NOISE = np.random.default_rng(3)


def stops(u, limits, weights):
    """Weighted elastoplastic elements from rest, independent of the library's."""
    force = np.zeros(u.size)
    for limit, weight in zip(limits, weights, strict=True):
        state = 0.0
        for k in range(1, u.size):
            state = min(limit, max(-limit, state + u[k] - u[k - 1]))
            force[k] += weight * state
    return force


def superelastic(strain):
    """Stress of a superelastic wire [MPa]: plateaus of loading and of unloading, none at zero strain."""
    part, stress = 0.0, np.empty(strain.size)
    for k, e in enumerate(strain):
        trial = 400 * (e - 3.5 * part)
        if trial > 480 + 60 * part:
            part = min(1.0, (400 * e - 480) / 1460)
        elif trial < 210 + 60 * part:
            part = max(0.0, (400 * e - 210) / 1460)
        stress[k] = 400 * (e - 3.5 * part)
    return stress


def test_check_tries_the_last_candidates_where_the_others_describe_the_loops_roughly():
    rise = np.linspace(0, 1, 75)
    strain = np.concatenate([a * np.append(rise, rise[-2::-1]) for a in (1.0, 2.0, 3.0, 4.0, 5.0, 5.0)])
    noise = NOISE.normal(0, 2.5, strain.size)
    record = hf.Record(strain, superelastic(strain) + noise, u_unit="%", y_unit="MPa", u_name="strain", y_name="stress")
    screened = {one.asked: one for one in screen(hf.Dataset.of(record))}
    assert screened["preisach-signed"].error < 0.7 * screened[SEARCH].error
    advice = check(record).advice
    assert advice is not None
    assert advice.model.startswith("preisach-signed")
    assert "duhem" in advice.searched


def test_smaller_loops_rank_in_check_as_in_a_comparison():
    """Scattered samples alone prefer cells with a third of the parameters' worth of noise in small loops."""
    t = np.arange(600) / 10
    u = 600 + 500 * np.sin(np.pi * t / 10 - np.pi / 2) * np.select([t < 20, t < 40], [1, 0.6], 0.3)
    record = hf.Record(u, 0.012 * (u - stops(u, [25], [1])) + NOISE.normal(0, 0.05, t.size))
    data = hf.Dataset.of(record)
    assert held_out(list(data)).scheme is Scheme.SCATTERED
    searched = next(one for one in screen(data) if one.asked == SEARCH)
    row = next(row for row in hf.compare(data, [SEARCH]).rows)
    assert 100 * searched.error / float(np.ptp(record.y)) == pytest.approx(row.score_percent, rel=0.1)


def test_a_model_without_an_inverse_goes_first_only_where_it_errs_clearly_less():
    """Weights of either sign describe relays with weights >= 0 about as well, and end the comparison once they leave noise."""
    plain = Candidate("preisach", first=First(0.49, 496))
    signed = lambda error: Candidate("preisach-signed", first=First(error, 496, handicap=1.5))
    assert leader([signed(0.45), plain]) is plain
    assert leader([plain, better := signed(0.3)]) is better


def sorption():
    """Amount adsorbed in 32 steps of pressure, up to condensation and down to where the branches meet."""
    p = np.array([2, 5, *range(10, 50, 10), *range(50, 100, 5), 98, *range(95, 35, -5), 30, 20, 10], dtype=float) / 100
    rises = np.arange(p.size) <= p.argmax()
    return p, 60 + 40 * p + 150 / (1 + np.exp(-(p - np.where(rises, 0.78, 0.62)) / 0.04))


def test_check_advises_what_a_fit_takes_where_both_try_the_same():
    """A choice of cells that one bound ended early was the best of what remained, in check alone."""
    p, amount = sorption()
    record = hf.Record(p, amount + np.random.default_rng(91028).normal(0, 0.6, p.size))
    advice, winner = check(record).advice, hf.compare(record).rows[0]
    assert advice is not None
    assert advice.model.partition(":")[0] == winner.asked == "preisach"


def test_check_names_the_closed_forms_whose_other_parameters_a_fit_searches_for():
    """A valve behind a lag of 30 ms, at two rates: plays whose width depends on the rate err by their starting values alone."""
    t = np.arange(0, 12, 0.01)
    u = 5 * np.sin(2 * np.pi * np.cumsum(np.where(t < 6, 0.25, 1.0)) * 0.01)
    opening = u - stops(u, [0.3], [1.0])
    flow = 8 * np.sign(opening) * np.maximum(np.abs(opening) - 0.4, 0)
    for k in range(1, t.size):
        flow[k] = flow[k - 1] + (1 - np.exp(-0.01 / 0.03)) * (flow[k] - flow[k - 1])
    report = check(hf.Record(u, flow + np.random.default_rng(7).normal(0, 0.15, t.size), t))
    assert report.advice is not None
    assert "rate-dependent-plays" in report.advice.searched
    assert "predicts held-out samples best" in report.text()


def static_and_viscous():
    """A yielding element in ten equal cycles of a sine, and the same with a dashpot."""
    t = np.arange(0, 20, 0.02)
    u = 10 * np.sin(2 * np.pi * 0.3 * t)
    force = stops(u, [5.0, 2.0], [4.0, 2.0]) + 0.6 * u
    noise = NOISE.normal(0, 0.1, t.size)
    return [hf.Record(u, force + c * np.gradient(u, t) + noise, t) for c in (0.0, 1.5)]


def test_at_one_pace_a_force_of_the_rate_needs_clear_evidence():
    still, viscous = static_and_viscous()
    assert paces([still]) == 1
    assert not search_structure(hf.Dataset.of(still)).structure.timed
    assert search_structure(hf.Dataset.of(viscous)).structure.rate
    assert still.t is not None
    other = hf.Record(still.u, still.y, 5 * still.t)
    assert paces([still, other]) == 2


def test_a_drift_below_the_noise_of_single_samples_is_seen():
    """3 % of the range over three cycles: a quarter of the squared error, and twenty standard errors."""
    t = np.linspace(0, 45, 901)
    u = 150 * np.sin(2 * np.pi * t / 15)
    record = hf.Record(u, 0 * t, t)
    noise = NOISE.normal(0, 0.035, t.size)
    drifting = noise - 0.078 * t / t[-1]  # prediction less measurement
    assert drift_note([noise], hf.Dataset.of(record), 2.7) is None
    assert has([drift_note([drifting], hf.Dataset.of(record), 2.7)], Code.DRIFT)
    slow = np.repeat(NOISE.normal(0, 0.05, 10), 91)[: t.size]  # few independent errors
    assert drift_note([slow - slow.mean()], hf.Dataset.of(record), 2.7) is None


def test_a_simplex_on_a_level_valley_has_converged():
    u = np.linspace(0, 1, 50)
    problem = Problem(hf.BoucWen(), hf.Dataset.of(hf.Record(u, u)))
    z, others = np.zeros(len(problem.space)), np.array([1, 2, 3])
    limits = {"maxfev": 60, "xatol": 1e-2, "fatol": 1e-4}
    level = lambda x: 1e-9 * float(x[1] - x[2])
    steep = lambda x: -float(np.log(np.abs(x[1:4]) + 1e-9).sum())  # falls without end
    assert search_nonlinear(problem, level, z, others, **limits)[2]
    assert not search_nonlinear(problem, steep, z, others, **limits)[2]


@pytest.mark.parametrize(("every", "status"), [(1, Status.OK), (20, Status.ROUGH)])
def test_white_residuals_of_sparse_samples_are_no_noise(every, status):
    """Errors of 6 % of the range at three samples a branch: nobody knows whether they are noise."""
    t = np.arange(0, 360, 0.05 * every)
    u = np.sin(2 * np.pi * t / 6)
    y = stops(u, [0.3], [1.0]) + 0.2 * u
    record = hf.Record(u, y + np.random.default_rng(0).normal(0, 0.06 * np.ptp(y), t.size), t)
    fit = hf.fit("prandtl-ishlinskii-stop:plays=10", record)
    rows = [np.asarray(fit.predict(record)) - record.y]
    assert residuals_are_white(rows, fit.baselines.curve, len(fit.free_names))
    assert fit.status is status


def test_a_current_against_a_voltage_at_one_rate_holds_for_it_alone():
    t = np.arange(0, 60, 0.2)
    u = 0.5 + 0.5 * np.sin(2 * np.pi * t / 20)
    y = 20 * np.gradient(u, t) + 3 * u + NOISE.normal(0, 0.02, t.size)
    of = lambda y_unit: hf.fit("bouc-wen-force", hf.Record(u, y, t, u_unit="V", y_unit=y_unit), starts=1)
    assert has(of("mA").notes, Code.RATE)
    assert not has(of("N").notes, Code.RATE)
