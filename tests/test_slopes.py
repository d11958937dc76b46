"""Slopes of fitted models, and the obstacle to an inverse that they are, against differences of simulated outputs."""

from itertools import pairwise

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.fit_model import fit_model
from hystfit.fitting.fit_options import FitOptions
from hystfit.models import Delay, Lag, LinearCreep, Negate, Relaxation, SaturatingRate, Viscous
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.slopes import Slopes

LOW, HIGH, FINE = -1.0, 1.0, 1000


def curves() -> np.ndarray:
    """Three major loops, then reversal curves from both sides, in small steps."""
    ends = [LOW, HIGH, LOW, HIGH, LOW, HIGH]
    for inner in np.linspace(LOW, HIGH, 18)[1:-1]:
        ends += [inner, HIGH, LOW, inner, LOW, HIGH]
    parts = [np.linspace(a, b, max(2, round(FINE * abs(b - a) / 2)))[1:] for a, b in pairwise(ends)]
    return np.concatenate([[LOW], *parts])


def simulated_slopes(model: AbstractHysteresis) -> Slopes:
    """Least and largest difference quotient over the reversal curves."""
    u = curves()
    y, du = np.asarray(hf.simulate(model, u)[0]), np.diff(u)
    later = np.arange(du.size) > (2 * FINE if isinstance(model, hf.Duhem) else 0)  # after its initial state has faded
    return Slopes.of((np.diff(y) / np.where(du == 0, 1.0, du))[later & (du != 0)])


PLAYS = {"low": LOW, "high": HIGH, "level": LOW, "r": np.array([0.05, 0.2, 0.4])}
MODELS = {
    "bouc-wen": (hf.BoucWen(c=1.0, mu=0.4, tau=2.0, rho=0.5, scheme="exact"), False),
    "bouc-wen, falling": (hf.BoucWen(c=1.0, mu=0.8, tau=2.0, rho=0.2, scheme="exact"), True),
    "bouc-wen, short": (hf.BoucWen(c=1.0, mu=0.8, tau=0.05, rho=0.2, scheme="exact"), False),
    "bouc-wen-force": (hf.BoucWenForce(kappa_x=0.5, kappa_w=1.0, rho=3.0, sigma=0.8, n=1.5, substeps=4), False),
    "bouc-wen-force, softening": (
        hf.BoucWenForce(kappa_x=-0.2, kappa_w=1.0, rho=3.0, sigma=0.8, n=1.5, substeps=4),
        True,
    ),
    "duhem": (hf.Duhem(alpha=2.0, f=(0.0, 1.0, 0.0, 0.0), g=(0.5, 0.0, 0.0)), False),
    "duhem, falling": (hf.Duhem(alpha=2.0, f=(0.0, 1.0, 0.0, 0.0), g=(0.05, 0.0, 0.0)), True),
    "plays": (hf.PrandtlIshlinskii(**PLAYS, w=[[0.3, 0.2, 0.1]], rise=[0.5, 0.1, 0.4]), False),
    "plays, falling": (hf.PrandtlIshlinskii(**PLAYS, w=[[0.3, 0.2, 0.1]], b=[0.4, 0.0, 0.3]), True),
    "plays, negative weight": (hf.PrandtlIshlinskii(**PLAYS, w=[[0.3, -0.9, 0.7]], rise=[0.5]), True),
    "envelopes": (
        hf.PrandtlIshlinskii(
            **PLAYS,
            w=[[0.3, -0.2, 0.1], [0.1, 0.2, 0.3], [0.3, -0.6, 0.2]],
            rise=[0.1],
            envelopes=("identity", "square", "mirror"),
        ),
        True,
    ),
    "stops": (hf.PrandtlIshlinskii(**PLAYS, w=[[0.3, 0.2, 0.1]], b=[-0.1], operator="stop"), True),
}


@pytest.mark.parametrize("name", MODELS)
def test_slopes_are_those_of_simulated_reversal_curves(name):
    model, falls = MODELS[name]
    found, seen = model.slope_range(LOW, HIGH, None), simulated_slopes(model)
    size = max(abs(seen.least), abs(seen.most))
    assert found is not None
    assert abs(found.least - seen.least) < 0.02 * size
    assert abs(found.most - seen.most) < 0.03 * size
    assert found.mixed == falls


def test_slopes_of_preisach_cells_are_those_of_reversal_curves():
    rng = np.random.default_rng(3)
    levels = np.linspace(LOW, HIGH, 7)
    for weights, falls in ((rng.uniform(0, 1, 21), False), (rng.normal(size=21), True)):
        model = hf.Preisach(w=weights, levels=levels, slopes=np.full(6, 0.05), center=0.0, half=1.0, initial="negative")
        found, seen = model.slope_range(LOW, HIGH, None), simulated_slopes(model)
        assert found is not None
        assert abs(found.least - seen.least) < 0.05 * seen.most
        assert abs(found.most - seen.most) < 0.05 * seen.most
        assert found.mixed == falls


def test_filters_and_forces_of_the_rate_count_over_one_sample():
    plays = hf.PrandtlIshlinskii(**PLAYS, w=[[0.3, 0.2, 0.1]], rise=[1.0])
    dt, inside = 0.01, plays.slope_range(LOW, HIGH, None)
    force = hf.Sum(plays, Viscous(c=-0.002)).slope_range(LOW, HIGH, dt)
    assert force == pytest.approx((inside.least - 0.2, inside.most - 0.2))
    both = hf.Sum(plays, SaturatingRate(F=0.01, v0=2.0)).slope_range(LOW, HIGH, dt)
    assert both == pytest.approx((inside.least, inside.most + 0.5))
    passed = 2 * dt / 0.03
    gain = 1 - np.exp(-passed) * (1 + passed)
    late = hf.Series(Lag(tau=0.03), plays, Relaxation(a=(0.1,), tau=(0.05,))).slope_range(LOW, HIGH, dt)
    after = 1 - 0.1 * np.exp(-dt / 0.05)
    assert late == pytest.approx((gain * inside.least * after, gain * inside.most * after))
    mirrored = hf.Series(Negate(), plays).slope_range(LOW, HIGH, dt)
    assert mirrored == pytest.approx((-inside.most, -inside.least))
    assert hf.Sum(plays, LinearCreep(a=(0.1,), low=LOW, high=HIGH)).slope_range(LOW, HIGH, None) is None
    assert hf.Series(plays, Delay(), plays).slope_range(LOW, HIGH, dt) is None


def test_a_fit_whose_output_falls_states_the_obstacle_to_its_inverse():
    t = np.linspace(0, 10, 1500)
    u = (1 - 0.08 * t) * np.sin(2 * np.pi * 0.8 * t)
    results = {}
    for mu in (0.3, 0.85):
        truth = hf.BoucWen(c=1.0, mu=mu, tau=2.0, rho=0.2)
        y = np.asarray(hf.simulate(truth, u)[0]) + 1e-3 * np.random.default_rng(1).standard_normal(t.size)
        record = hf.Record(u, y, t, u_unit="V", y_unit="um")
        results[mu] = fit_model("bouc-wen", hf.Dataset.of(record), FitOptions(starts=2))
    assert results[0.3].obstacle("inverse") is None
    falling = results[0.85]
    text = falling.obstacle("inverse")
    assert text is not None
    least = falling.model.slope_range(*falling.input_range, None).least
    assert f"{least:.3g}" in text
    assert falling.model.obstacle("inverse") is None  # of the class
    assert text in hf.invert(falling, 0.5 * np.sin(t)).notes()[0]
    assert not hf.invert(results[0.3], 0.2 * np.sin(t)).notes()
    assert "Inverse" in dict(falling.answer)
    assert "hystfit invert" not in falling.report()
    rows = hf.compare(falling.data, ["bouc-wen"]).rows
    assert rows[0].obstacles["inverse"].startswith(text[:40])
