"""The first answer: `check` advises what `fit` chooses, and neither takes a cause for sure that the record cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.comparison.candidates import candidates
from hystfit.fitting.comparison.contender import Candidate, First, leader
from hystfit.fitting.data_check import check
from hystfit.fitting.judgment.fit_warnings import drift_note
from hystfit.fitting.judgment.verdict import residuals_are_white
from hystfit.fitting.structure.structure_search import search_structure
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
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


def ramp():
    """Resistance of a film on one ramp of temperature: at one pace a lag before a curve leaves noise too."""
    t = np.arange(800) * 2.0
    warm = np.interp(np.arange(800), [0, 400, 799], [20.0, 100.0, 20.0])
    part = 1 / (1 + np.exp((warm - np.where(np.arange(800) < 400, 68, 60)) / 3))
    return hf.Record(warm, 1e5 * part + np.random.default_rng(1).normal(0, 200, 800), t)


def isotherm():
    p, amount = sorption()
    return hf.Record(p, amount + np.random.default_rng(91028).normal(0, 0.6, p.size))


@pytest.mark.parametrize(
    ("record", "family"), [pytest.param(ramp, "negate+preisach", marks=pytest.mark.slow), (isotherm, "preisach")]
)
def test_check_advises_the_model_that_a_fit_takes(record, family):
    """One comparison serves both; advice of its own ended where a lag left noise, or with fewer choices of cells."""
    advice, taken = check(record()).advice, hf.fit("auto", record())
    assert advice is not None
    assert advice.model == taken.name
    assert advice.model.partition(":")[0] == family
    assert any(advice.reason == note.text for note in taken.notes)
    assert "not tested" in advice.reason


def viscous_spring():
    """A force of friction and of the rate at one pace, from the middle of a stroke: early samples look stiffer."""
    t = np.arange(0, 5, 0.005)
    v = 10 * np.pi * np.cos(2 * np.pi * t)
    force = 0.8 * v + 6 * np.tanh(v) + np.random.default_rng(1).normal(0, 0.2, t.size)
    return hf.Record(
        5 * np.sin(2 * np.pi * t), force, t, u_unit="mm", y_unit="N", u_name="Displacement", y_name="Force"
    )


@pytest.mark.slow
def test_a_model_without_damage_that_leaves_noise_refutes_damage():
    report = check(viscous_spring())
    assert report.advice is not None
    assert report.advice.model == "damper"
    assert not has(report.findings, Code.DEGRADING)


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
    of = lambda y_unit: hf.fit("prandtl-ishlinskii-stop:plays=10", hf.Record(u, y, t, u_unit="V", y_unit=y_unit))
    assert has(of("mA").notes, Code.RATE)
    assert not has(of("N").notes, Code.RATE)


def test_a_damper_is_tried_on_no_output_of_another_quantity() -> None:
    """A discharge that leads the stage of a river, as floods rise and fall, is no force; an output without a unit may be one."""
    time = np.arange(200.0)
    stage = 2 + np.exp(-(((time - 70) / 20) ** 2)) + 0.6 * np.exp(-(((time - 140) / 25) ** 2))
    flow = stage**1.6 * np.sqrt(1 + 2 * np.gradient(stage))
    tried = lambda **units: candidates(hf.Dataset.of(hf.Record(stage, flow, 3600 * time, **units))).names
    is_damper = lambda names: any("damper" in name for name in names)
    assert not is_damper(tried(u_unit="m", y_unit="m3/s", y_name="Discharge"))
    assert is_damper(tried(u_unit="mm", y_unit="N"))
    assert is_damper(tried())


def test_of_several_rates_the_answer_names_that_of_its_loop() -> None:
    """Plays behind a lag of 4 ms: a loop of 25 % of the stroke at 2 Hz, and of twice as much at 20 Hz."""
    pieces = [np.arange(round(500 * n / f)) * 2 * np.pi * f / 500 for f, n in ((2.0, 3), (20.0, 6))]
    phase = np.concatenate(pieces)
    u, y = 75 - 75 * np.cos(phase), np.zeros(phase.size)
    p = 0.0
    for k in range(1, u.size):
        p = max(u[k] - 15, min(u[k] + 15, p))
        y[k] = y[k - 1] + (0.1 * p + 0.05 * u[k] - y[k - 1]) * -np.expm1(-0.5)
    record = hf.Record(u, y + 0.01 * np.random.default_rng(0).standard_normal(u.size), t=np.arange(u.size) / 500)
    labels = dict(hf.fit("lag+prandtl-ishlinskii:plays=5", record.replace(u_unit="V", y_unit="um")).answer)
    assert any("at 20 Hz" in label for label in labels)
    static = dict(hf.fit("prandtl-ishlinskii:plays=5", record.replace(u_unit="V", y_unit="um")).answer)
    assert not any("Hz" in label for label in static)
