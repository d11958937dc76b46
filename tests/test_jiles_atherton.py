"""The Jiles-Atherton model beside closed forms: initial susceptibility, anhysteretic curve, reversals; B(H); its fit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

import hystfit as hf
from hystfit.models.jiles_atherton import MU0

# Of the size of those of iron.
IRON = {"Ms": 1.6e6, "a": 1100.0, "coupling": 1.6e-3 * 1.6e6 / 3300.0, "k": 400.0, "c": 0.2}


def test_initial_susceptibility() -> None:
    """At the demagnetized state only the reversible part moves: c chi0 / (1 - alpha c chi0) with chi0 = Ms / (3 a)."""
    chi0, alpha = IRON["Ms"] / (3 * IRON["a"]), 1.6e-3
    expected = IRON["c"] * chi0 / (1 - alpha * IRON["c"] * chi0)
    y = np.asarray(hf.simulate(hf.JilesAtherton(**IRON), np.array([0.0, 1e-3]))[0])
    assert (y[1] - y[0]) / 1e-3 == pytest.approx(expected, rel=1e-5)


def test_a_reversal_moves_only_the_reversible_part() -> None:
    """Just after a turn dM/dH is c Man' / (1 - alpha c Man') at the effective field of the turn."""
    u = np.concatenate([np.linspace(0, 3000.0, 2001), [3000.0 - 1e-2]])
    y = np.asarray(hf.simulate(hf.JilesAtherton(**IRON), u)[0])
    x = (u[-2] + 1.6e-3 * y[-2]) / IRON["a"]
    bend = IRON["Ms"] / IRON["a"] * (1 / x**2 - 1 / np.sinh(x) ** 2)
    expected = IRON["c"] * bend / (1 - 1.6e-3 * IRON["c"] * bend)
    assert (y[-1] - y[-2]) / (u[-1] - u[-2]) == pytest.approx(expected, rel=1e-4)


def test_without_an_irreversible_part_the_output_is_the_anhysteretic_curve() -> None:
    u = 5000.0 * np.sin(np.arange(100) / 5.0)
    y = np.asarray(hf.simulate(hf.JilesAtherton(**{**IRON, "c": 1.0}), u)[0])

    def curve(field: float) -> float:
        langevin = lambda x: 1 / np.tanh(x) - 1 / x if abs(x) > 1e-4 else x / 3
        miss = lambda m: m - langevin((field + 1.6e-3 * IRON["Ms"] * m) / IRON["a"])
        return IRON["Ms"] * brentq(miss, -1.0, 1.0, xtol=1e-15)

    np.testing.assert_allclose(y, [curve(field) for field in u], atol=1e-9 * IRON["Ms"])


def test_no_susceptibility_is_negative_and_loops_dissipate() -> None:
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(400) / 400) for a in (6000.0, 1500.0, 6000.0)])
    y = np.asarray(hf.simulate(hf.JilesAtherton(**IRON), u)[0])
    assert (np.diff(y) * np.diff(u) >= 0).all()
    last = slice(800, None)
    loss = float(np.sum(0.5 * (u[last][1:] + u[last][:-1]) * np.diff(y[last])))
    assert 4 * IRON["k"] * IRON["Ms"] * (1 - IRON["c"]) > loss > 0  # k bounds the width: pinning takes k |dMirr|


def test_the_inverse_gives_the_input_again() -> None:
    model = hf.JilesAtherton(**IRON, slope=0.7, offset=2e4)
    u = np.interp(
        np.arange(300), np.linspace(0, 299, 8), [0.0, 6000.0, -4000.0, 2000.0, -500.0, 5000.0, -6000.0, 100.0]
    )
    y = np.asarray(hf.simulate(model, u)[0])
    inverse = hf.invert(model, y, limits=(-7000.0, 7000.0))
    np.testing.assert_allclose(inverse.u, u, atol=1e-6)


def test_a_fit_finds_the_parameters_and_takes_mu0_for_a_flux_density() -> None:
    truth = hf.JilesAtherton(Ms=1.9, a=900.0, coupling=0.7, k=350.0, c=0.15, slope=MU0)
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(120) / 120) for a in (5000.0, 1500.0)])
    noise = 0.003 * np.random.default_rng(0).normal(size=u.size)
    y = np.asarray(hf.simulate(truth, u)[0]) + noise
    result = hf.fit("jiles-atherton", hf.Record(u=u, y=y, u_unit="A/m", y_unit="T"), starts=1)
    assert float(result.model.slope) == MU0
    for name, true in {"Ms": 1.9, "a": 900.0, "coupling": 0.7, "k": 350.0, "c": 0.15}.items():
        row = next(p for p in result.parameters if p.name == name)
        assert abs(row.value - true) < 4 * row.stderr < 0.2 * true, name
    (alpha,) = result.derived
    assert abs(alpha.value - 3 * 900.0 * 0.7 / 1.9) < 4 * alpha.stderr
