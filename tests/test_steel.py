"""Steel02 and Voce-Chaboche beside the published equations in plain loops, their limits, and coupons with known parameters."""

from __future__ import annotations

import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array

import hystfit as hf
from hystfit.errors import ModelError

STEEL = {"fy": 500.0, "E": 2e5, "b": 0.02, "R0": 20.0, "cR1": 0.9, "cR2": 0.15, "a1": 0.02, "a3": 0.03}


def menegotto_pinto(u: np.ndarray, *, fy, E, b, R0, cR1, cR2, a1, a3, sigInit=0.0) -> np.ndarray:
    """The law branch by branch, with a1 and a3 as the amplitudes and a2 = a4 = 1, in the order of the published equations."""
    ey, stress = fy / E, []
    sig, last, way = sigInit, sigInit / E, 0
    eps_max, eps_min = ey, -ey
    for strain in u:
        eps = strain + sigInit / E
        turn = int(np.sign(eps - last))
        if way == 0 and turn:
            way, eps_r, sig_r = turn, 0.0, 0.0
            eps_0, sig_0, eps_pl = turn * ey, turn * fy, turn * ey
        elif turn and turn != way:
            way, eps_r, sig_r = turn, last, sig
            if turn < 0:
                eps_max = max(eps_max, last)
            else:
                eps_min = min(eps_min, last)
            amplitude = (eps_max - eps_min) / (2 * ey)
            yield_stress = fy * (1 + (a3 if turn > 0 else a1) * amplitude**0.8)
            # The line of slope b E through (turn ey, turn yield stress) of the shifted skeleton meets the elastic one here.
            line = lambda e, at=turn * yield_stress, slope=b * E: at + slope * (e - at / E)
            eps_0 = (line(0.0) - sig_r + E * eps_r) / (E - b * E)
            sig_0 = line(eps_0)
            eps_pl = eps_max if turn > 0 else eps_min
        if turn:
            xi = abs((eps_pl - eps_0) / ey)
            R = R0 * (1 - cR1 * xi / (cR2 + xi))
            ratio = (eps - eps_r) / (eps_0 - eps_r)
            normalized = b * ratio + (1 - b) * ratio / (1 + abs(ratio) ** R) ** (1 / R)
            sig = sig_r + normalized * (sig_0 - sig_r)
        last = eps
        stress.append(sig)
    return np.array(stress)


def random_path(seed: int, size: int = 400, amplitude: float = 0.02) -> np.ndarray:
    corners = np.append(0.0, np.random.default_rng(seed).uniform(-amplitude, amplitude, 12))
    return np.interp(np.linspace(0, 12, size), np.arange(13), corners)


@pytest.mark.parametrize("stress", [0.0, 120.0])
def test_steel02_follows_the_published_equations(stress: float) -> None:
    for seed in range(3):
        u = random_path(seed)
        found = np.asarray(hf.simulate(hf.Steel02(**STEEL, sigInit=stress), u)[0])
        np.testing.assert_allclose(found, menegotto_pinto(u, **STEEL, sigInit=stress), atol=1e-9)


def test_the_first_branch_tends_to_the_bilinear_law() -> None:
    """A sharp knee without loss of sharpness: E up to fy, then b E."""
    u = np.linspace(0, 0.02, 50)
    model = hf.Steel02(fy=500.0, E=2e5, b=0.02, R0=60.0, cR1=0.3)
    ey = 500.0 / 2e5
    expected = np.where(u < ey, 2e5 * u, 500.0 + 0.02 * 2e5 * (u - ey))
    away = np.abs(u / ey - 1) > 0.2
    np.testing.assert_allclose(np.asarray(hf.simulate(model, u)[0])[away], expected[away], atol=0.01 * 500.0)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-0.02, 0.02), min_size=6, max_size=6), st.floats(0.001, 0.2), st.floats(0.4, 0.99))
def test_closed_cycles_of_steel02_dissipate(corners: list[float], b: float, cR1: float) -> None:
    """The work over a cycle that is repeated is never negative."""
    once = np.interp(np.linspace(0, 6, 121), np.arange(7), np.append(corners, corners[0]))
    u = np.concatenate([once, once[1:], once[1:]])
    model = hf.Steel02(fy=500.0, E=2e5, b=b, cR1=cR1, a1=0.0, a3=0.0)
    y = np.asarray(hf.simulate(model, u)[0])[-121:]
    work = float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(once)))
    assert work >= -1e-9 * 500.0


def test_steel02_is_the_same_in_tension_and_compression() -> None:
    u = random_path(5)
    swapped = {**STEEL, "a1": STEEL["a3"], "a3": STEEL["a1"]}
    up, down = hf.simulate(hf.Steel02(**STEEL), u)[0], hf.simulate(hf.Steel02(**swapped), -u)[0]
    np.testing.assert_allclose(np.asarray(up), -np.asarray(down), atol=1e-9)


def test_a_deadband_ignores_reversals_within_it() -> None:
    """Small reversals within the deadband leave the stress on the branch; without it each starts a new one."""
    u = random_path(3, 600)
    noisy = u + np.random.default_rng(0).uniform(-2e-5, 2e-5, u.size)
    clean = menegotto_pinto(u, **STEEL)
    error = lambda deadband: np.std(np.asarray(hf.simulate(hf.Steel02(**STEEL, deadband=deadband), noisy)[0]) - clean)
    assert error(5e-5) < 0.5 * error(0.0)


def test_the_overshoot_after_a_partial_unloading_is_noted() -> None:
    model = hf.Steel02(**STEEL)
    unloaded = np.interp(np.arange(300), [0, 100, 110, 299], [0.0, 0.02, 0.019, 0.04])
    assert model.advice(unloaded)
    assert not model.advice(random_path(0))


def test_steel02_finds_its_parameters() -> None:
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(120) / 120) for a in (0.005, 0.01, 0.02, 0.02)])
    y = np.asarray(hf.simulate(hf.Steel02(**STEEL), u)[0]) + np.random.default_rng(1).normal(0, 5.0, u.size)
    result = hf.fit("steel-02", hf.Record(u=u, y=y), starts=1)
    rows = {row.name: row for row in result.parameters}
    for name in ("fy", "E", "b", "cR1", "cR2", "a1", "a3"):
        assert abs(rows[name].value - STEEL[name]) < 4 * rows[name].stderr, name
    (ey,) = result.derived
    assert ey.value == pytest.approx(500.0 / 2e5, rel=0.01)


def coupon(folder: Path, number: int) -> tuple[hf.Record, dict[str, float]]:
    """A record and its true parameters, whose header in the file is wrong."""
    strain, stress = np.loadtxt(folder / f"experiment_{number}.csv").T
    text = (folder / f"experiment_{number}_parinfo.txt").read_text().split("]")[1]
    values = [float(word) for word in text.replace("[", " ").split()]
    names = ("fy", "E", "b", "cR1", "cR2", "a1", "a3", "noise")
    return hf.Record(u=strain, y=stress, u_unit="1", y_unit="MPa"), dict(zip(names, values, strict=True))


def test_coupons_have_white_residuals_of_10_MPa_at_their_true_parameters(measured: Path) -> None:
    for number in range(18):
        record, truth = coupon(measured / "steel_quofem", number)
        assert truth.pop("noise") == 10.0
        rest = record.y - np.asarray(hf.simulate(hf.Steel02(**truth), record.u)[0])
        assert 9.7 < math.sqrt(np.mean(rest**2)) < 10.3
        assert abs(np.mean(rest[1:] * rest[:-1]) / np.mean(rest**2)) <= 0.06


def test_noise_of_the_strain_makes_no_false_reversals(measured: Path) -> None:
    """At 3e-5 of strain, b and a3 are within 5 % of the truth; without the deadband the error is far larger."""
    record, truth = coupon(measured / "steel_quofem", 0)
    noisy = record.replace(u=record.u + np.random.default_rng(0).normal(0, 3e-5, len(record)))
    fit = hf.fit("steel-02", noisy, starts=1)
    found = {row.name: row.value for row in fit.parameters}
    assert found["deadband"] == pytest.approx(8 * 3e-5, rel=0.1)
    assert all(found[name] == pytest.approx(truth[name], rel=0.05) for name in ("fy", "E", "b", "cR1", "a3"))
    raw = {row.name: row.value for row in hf.fit("steel-02", noisy, starts=1, fix={"deadband": 0.0}).parameters}
    assert abs(raw["a3"] / truth["a3"] - 1) > 0.05


# -- Voce-Chaboche -----------------------------------------------------------------------------------------------------------

S355 = {"E": 2e5, "sy0": 330.0, "Q": 80.0, "b": 6.0, "D": 60.0, "a": 200.0, "S": (150.0, 60.0), "g": (15.0, 200.0)}


def voce_chaboche(u: np.ndarray, *, E, sy0, Q, b, D, a, S, g, parts: int) -> np.ndarray:
    """The rate equations by small explicit steps: the plastic multiplier from the consistency condition, and a return to the surface."""
    S, g = np.array(S), np.array(g)
    back, p, sig, stress = np.zeros(S.size), 0.0, 0.0, []
    size = lambda p: sy0 + Q * (1 - math.exp(-b * p)) - D * (1 - math.exp(-a * p))
    for before, after in zip(np.append(0.0, u[:-1]), u, strict=True):
        for _ in range(parts):
            step = (after - before) / parts
            sig += E * step
            s = np.sign(sig - back.sum())
            excess = abs(sig - back.sum()) - size(p)
            if excess > 0:
                hardening = np.sum(g * (S - s * back)) + Q * b * math.exp(-b * p) - D * a * math.exp(-a * p)
                dp = excess / (E + hardening)
                sig, back, p = sig - s * E * dp, back + g * (s * S - back) * dp, p + dp
        stress.append(sig)
    return np.array(stress)


def test_voce_chaboche_is_the_limit_of_small_steps_of_the_rate_equations() -> None:
    """Explicit steps err in proportion to their size: two sizes give the limit (Richardson)."""
    u = random_path(2, 120)
    found = np.asarray(hf.simulate(hf.VoceChaboche(**S355), u)[0])
    coarse, fine = (voce_chaboche(u, **S355, parts=parts) for parts in (100, 200))
    assert np.abs(found - fine).max() < 0.5
    np.testing.assert_allclose(found, 2 * fine - coarse, atol=0.05)


def test_a_step_of_voce_chaboche_is_exact_for_any_increment() -> None:
    u = random_path(4, 121)
    fine = np.interp(np.arange(0, 120.01, 0.05), np.arange(121), u)
    corners = np.linspace(0, 120, 13).astype(int)
    model = hf.VoceChaboche(**S355)
    at_once = np.asarray(hf.simulate(model, u[corners])[0])
    np.testing.assert_allclose(at_once, np.asarray(hf.simulate(model, fine)[0])[20 * corners], atol=1e-8)


@eqx.filter_jit
def states_along(model: hf.VoceChaboche, u: Array) -> Array:
    """Every state of a path, in one program for all parameters."""

    def body(state: Array, u1: Array) -> tuple[Array, Array]:
        new = model.step(state, u1, u1, u1)[0]
        return new, new

    return jax.lax.scan(body, model.init(u[0]), u)[1]


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-0.03, 0.03), min_size=5, max_size=5), st.floats(0.0, 60.0))
def test_voce_chaboche_never_gives_plastic_work_back(corners: list[float], D: float) -> None:
    """Stress less backstress times plastic strain increments: the dissipation of the theory."""
    u = np.interp(np.linspace(0, 5, 101), np.arange(6), np.append(0.0, corners))
    model = hf.VoceChaboche(**{**S355, "D": D})
    y, states = np.asarray(hf.simulate(model, u)[0]), states_along(model, jnp.asarray(u))
    plastic, back = np.asarray(states[:, 0]), np.asarray(states[:, 2:]).sum(axis=1)
    assert ((y - back)[1:] * np.diff(plastic) >= -1e-12).all()
    assert (np.diff(np.asarray(states[:, 1])) >= 0).all()


def test_voce_chaboche_finds_its_parameters() -> None:
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(150) / 150) for a in (0.005, 0.01, 0.02, 0.02, 0.03)])
    truth = hf.VoceChaboche(**{**S355, "S": (150.0,), "g": (30.0,)})
    y = np.asarray(hf.simulate(truth, u)[0]) + np.random.default_rng(1).normal(0, 2.0, u.size)
    result = hf.fit("voce-chaboche:backstresses=1", hf.Record(u=u, y=y), starts=2)
    rows = {row.name: row for row in result.parameters}
    for name, true in {**S355, "S[0]": 150.0, "g[0]": 30.0}.items():
        if name not in ("S", "g"):
            assert abs(rows[name].value - true) < 4 * rows[name].stderr < 0.5 * true, name


def test_backstresses_need_a_value_and_a_rate_each() -> None:
    with pytest.raises(ModelError):
        hf.VoceChaboche(S=(1.0, 2.0), g=(3.0,))
    with pytest.raises(ModelError):
        hf.VoceChaboche.of(0)
