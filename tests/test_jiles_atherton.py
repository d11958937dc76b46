"""The Jiles-Atherton model beside closed forms: initial susceptibility, anhysteretic curve, reversals; B(H); its fit."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import hystfit as hf
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.rate import Excess, Viscous
from hystfit.params.units import MU0

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


@pytest.mark.slow  # the search is that of every model without a closed form
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


VARIANTS = {
    "pinning that falls": {"q": [2.4]},
    "all": {"curve": "tanh", "q": [-1.5], "p": [0.6], "r": [3.0]},
}


@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS)
def test_variants_follow_the_law_of_the_literature(variant) -> None:
    """dM/dH with alpha in H, integrated by another method: anhysteretic curves, pinning, two reversals."""
    shape = {"Ms": 1.0, "a": 0.3, "coupling": 0.8, "k": 0.4, "c": 0.3} | variant
    model = hf.JilesAtherton(**shape)
    turns = [0.0, 3.0, -2.0, 3.0]
    one = np.tanh if variant.get("curve") == "tanh" else lambda x: 1 / np.tanh(x) - 1 / x if abs(x) > 1e-4 else x / 3
    first = 1.0 if variant.get("curve") == "tanh" else 1 / 3
    p, r, q = (variant.get(name, [default])[0] for name, default in (("p", 1.0), ("r", 1.0), ("q", 0.0)))
    curve = lambda x: p * one(x) + (1 - p) * one(x / r)
    field = shape["a"] * shape["coupling"] / (first * (p + (1 - p) / r))  # alpha Ms

    def law(s):
        def slope(h, m):
            he = h + field * m[0]
            ahead = max(s * (curve(he / 0.3) - m[0]), 0.0) / (
                0.4 * np.exp(-q * m[0] ** 2)
            )  # (1 - c)(Man - Mirr) = Man - M
            bend = (curve(he / 0.3 + 1e-6) - curve(he / 0.3 - 1e-6)) / 2e-6 / 0.3
            # Where Mirr rests, c Man' alone; else dMirr/dHe and c Man' together.
            rate = ahead + 0.3 * bend
            return [rate / (1 - field * rate)]

        return slope

    m, expected = 0.0, []
    for begin, end in itertools.pairwise(turns):
        found = solve_ivp(
            law(np.sign(end - begin)),
            (begin, end),
            [m],
            rtol=1e-9,
            atol=1e-11,
            method="LSODA",
            t_eval=np.linspace(begin, end, 6),
        )
        expected.extend(found.y[0][1:])
        m = found.y[0][-1]
    u = np.concatenate([[0.0], *(np.linspace(a, b, 2001)[1:] for a, b in itertools.pairwise(turns))])
    y = np.asarray(hf.simulate(model, u)[0])
    np.testing.assert_allclose(y[400::400], expected, atol=2e-4)


def test_driven_by_the_flux_density_it_gives_the_field_again() -> None:
    shape = {"Ms": 1.6, "a": 30.0, "coupling": 0.9, "k": 25.0, "c": 0.3, "q": [1.5], "slope": MU0}
    h = np.interp(np.arange(400), np.linspace(0, 399, 6), [0.0, 200.0, -150.0, 80.0, -200.0, 200.0])
    b = np.asarray(hf.simulate(hf.JilesAtherton(**shape), h)[0])
    field = JilesAthertonField(**shape, offset=3.0)
    np.testing.assert_allclose(np.asarray(hf.simulate(field, b)[0]), h + 3.0, atol=1e-6)


def test_losses_of_eddy_currents_are_those_of_bertotti() -> None:
    """Over one sine of B: pi^2 sigma d^2 B^2 f / 6, and 8.76 (sigma G V0 S)^(1/2) B^(3/2) f^(1/2), in J/m^3."""
    sigma, thickness, peak, frequency, excess = 2e6, 0.35e-3, 1.2, 50.0, 3.0
    t = np.linspace(0, 1 / frequency, 4001)
    b = peak * np.sin(2 * np.pi * frequency * t)
    area = lambda h: float(np.sum(0.5 * (h[1:] + h[:-1]) * np.diff(b)))
    dt = np.full(t.size, t[1])
    eddy = np.asarray(hf.simulate(Viscous(c=sigma * thickness**2 / 12), b, dt)[0])
    assert area(eddy) == pytest.approx(np.pi**2 * sigma * thickness**2 * peak**2 * frequency / 6, rel=1e-3)
    walls = np.asarray(hf.simulate(Excess(g=excess, e=1e-3), b, dt)[0])
    assert area(walls) == pytest.approx(8.76 * excess * peak**1.5 * frequency**0.5, rel=1e-3)


@pytest.mark.slow
def test_a_fit_driven_by_the_flux_density_separates_the_losses() -> None:
    shape = {"Ms": 1.6, "a": 30.0, "coupling": 0.7, "k": 25.0, "c": 0.3, "slope": MU0}
    rng, records = np.random.default_rng(0), []
    for frequency in (5.0, 200.0):
        t = np.linspace(0, 2 / frequency, 241)
        b = 1.1 * np.sin(2 * np.pi * frequency * t)
        h = np.asarray(hf.simulate(JilesAthertonField(**shape), b)[0]) + 0.02 * np.gradient(b, t)
        records.append(
            hf.Record(b, h + rng.normal(0, 0.3, t.size), t, u_unit="T", y_unit="A/m", name=f"{frequency:.0f} Hz")
        )
    result = hf.fit("jiles-atherton-b+viscous", hf.Dataset(tuple(records)), starts=1)
    found = {one.name.rpartition(".")[2]: one for one in result.parameters}
    eddy = next(one for one in result.parameters if "viscous" in one.name)
    assert abs(eddy.value - 0.02) < 4 * eddy.stderr < 0.2 * 0.02
    assert abs(found["k"].value - 25.0) < 4 * found["k"].stderr
