"""Fits at the edge: reference problems with certified values, and records far from zero."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.outcome import Status

from .hard import devices, maps, strd

# -- NIST's reference problems (`python -m tests.hard.strd` runs all, from both starts, alone and with seven others) ------------------

QUICK = ["Thurber", "Hahn1", "MGH17"]


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in strd.LAWS]
)
def test_usable_fits_have_the_certified_values_and_errors(name: str) -> None:
    outcomes = []
    for starts in (1, 8):
        outcome, fit, of_values, of_errors = strd.judged(name, 1, starts)
        assert outcome != "wrong", (fit.status, of_values, of_errors)
        outcomes.append(outcome)
    if name in QUICK:
        assert outcomes == ["right", "right"]


def test_wrong_values_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    true = strd.reference_of("DanWood")
    assert strd.digits(true.values * (1 + 1e-5), true.values) == pytest.approx(5.0, abs=0.01)
    fit = strd.attempt("Eckerle4", 1, 1)
    assert fit.status is Status.OK
    monkeypatch.setattr(strd, "attempt", lambda *_: fit)
    shifted = strd.reference_of("Eckerle4")._replace(values=1.00001 * strd.reference_of("Eckerle4").values)
    monkeypatch.setattr(strd, "reference_of", lambda name: shifted)
    assert strd.judged("Eckerle4", 1, 1)[0] == "wrong"


# -- records far from zero -------------------------------------------------------------------------------------------------------

N = 400
T = np.arange(N) / 100
U = (20 + 8 * T) * np.sin(2 * np.pi * T)
Y = np.asarray(hf.simulate(hf.BoucWen(c=0.15, mu=0.45, tau=0.05, rho=0.6, offset=3.0), jnp.asarray(U))[0])
Y = Y + 0.02 * np.random.default_rng(0).normal(size=N)
SHIFTS = [(1e9, 0.0), (1e6, -1e9)]
MODELS = [hf.BoucWen(), hf.PrandtlIshlinskii.of(4), hf.Preisach.of(8), hf.Duhem()]
LEVELS = ("offset", "f[0]", "w0")  # parameters that a shift of the output moves


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_an_origin_far_away_changes_no_value_error_or_status(model) -> None:
    fit = lambda du, dy: hf.fit(model, hf.Record(u=U + du, y=Y + dy, t=T), starts=2)
    near = fit(0.0, 0.0)
    known = [k for k, name in enumerate(near.problem.space.names) if near.parameters[k].stderr and name not in LEVELS]
    assert len(known) >= 4
    for shift in SHIFTS:
        far = fit(*shift)
        assert (far.status, far.rank) == (near.status, near.rank), shift
        assert far.train.rmse == pytest.approx(near.train.rmse, rel=1e-4), shift
        for k in known:
            one, other = near.parameters[k], far.parameters[k]
            assert one.stderr is not None
            assert other.stderr == pytest.approx(one.stderr, rel=0.01), (shift, one.name)
            # At 1e9 numbers have a resolution of 1e-7, a hundred-thousandth of the noise.
            assert abs(other.value - one.value) < 0.01 * one.stderr, (shift, one.name)
        if isinstance(model, hf.BoucWen):  # whose offset is the output at zero input
            slope = near["c"].stderr
            assert slope is not None
            assert far["offset"].stderr == pytest.approx(shift[0] * slope, rel=0.01)


def test_more_weights_than_samples_of_which_most_are_at_zero_are_reported_as_poor():
    t = np.linspace(0, 4, 60)
    u = np.sin(2 * np.pi * t) * (0.2 + 0.2 * t)
    y = np.asarray(
        hf.simulate(hf.BoucWenForce(kappa_x=1.0, kappa_w=3.0, rho=6.0), u)[0]
    )  # clockwise: no Preisach model
    result = hf.fit(hf.Preisach.of(12), hf.Record(u=u, y=y, t=t))
    assert len(result.x) > 60
    assert sum(p.at_bound is not None for p in result.parameters) > 60
    assert result.status is Status.POOR


# -- random devices (`python -m tests.hard.devices` runs 1000 of every model) ----------------------------------------------------


def test_a_saturating_oscillator_is_found_from_its_own_start(tmp_path: Path) -> None:
    """Every start with a mild spring ends in another minimum, at 6.4 times the noise."""
    assert devices.run("oscillator", range(7, 8), tmp_path)[0] == {"right": 1}


def test_random_devices_are_found_or_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counts, bad = devices.run("prandtl-ishlinskii", range(3), tmp_path)
    assert (counts, bad) == ({"right": 3}, [])
    monkeypatch.setattr(devices, "SLACK", {"prandtl-ishlinskii": 0.5})
    assert devices.run("prandtl-ishlinskii", range(3), tmp_path)[0] == {
        "wrong": 3
    }  # read from the folder, and judged again


def test_the_ridge_of_plays_leaves_the_residuals_at_the_noise():
    """A device with which the best whole decade of the ridge leaves residuals 4 % above the noise; a penalty may cost 2 %."""
    counts, wrong = devices.run("prandtl-ishlinskii", range(56, 57))
    assert counts == {"right": 1}, wrong


def test_a_penalty_that_fits_worse_wins_no_tie_between_left_out_errors():
    """A device of relays with equal left-out errors (0.03 % apart) with and without smoothing, which puts residuals 11 % above."""
    counts, wrong = devices.run("preisach", range(825, 826))
    assert counts == {"right": 1}, wrong


@pytest.mark.parametrize(
    "common", [pytest.param(True, marks=pytest.mark.slow), False], ids=["one input", "inputs of their own"]
)
def test_loops_fitted_together_are_those_of_fit(common: bool) -> None:
    for row in maps.compared("bouc-wen", 5, 1, common=common):
        assert row.same
        assert row.estimates < maps.SAME
        assert row.errors < maps.ERRORS
