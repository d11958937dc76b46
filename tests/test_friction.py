"""Friction models beside ordinary differential equations and plain loops, their laws, and parameters found again."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import hystfit as hf
from hystfit.data.dataset import Dataset
from hystfit.errors import ModelError
from hystfit.fitting.comparison.candidates import candidates

LUGRE = hf.LuGre(sigma0=200.0, sigma1=0.3, sigma2=0.4, Fc=1.0, dFs=0.6, vs=0.5, k=0.3, offset=0.1)
SLIP = hf.MaxwellSlip(
    w=(3.0, 2.0, 1.0),
    r=(0.01, 0.05, 0.3),
    k=0.4,
    viscous=0.2,
    excess=0.5,
    vs=2.0,
    center=0.2,
    half=1.5,
    speed=5.0,
    offset=0.1,
)
DAHL = hf.Dahl(Fc=(0.5, 0.3), d=(0.02, 0.3), k=0.2, offset=0.1)


def driven(frequency: float, samples: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of two growing cycles, and the time steps."""
    t = np.arange(samples) * 2 / samples / frequency
    return np.sin(2 * np.pi * frequency * t) * (0.5 + 0.25 * t * frequency), np.diff(t, prepend=0.0)


def at_constant_velocity(z: float, v: float, time: float) -> float:
    """dz/dt = v - sigma0 |v| z / g(v) of `LUGRE` by a general solver."""
    g = float(LUGRE.Fc) + float(LUGRE.dFs) * math.exp(-((v / float(LUGRE.vs)) ** 2))
    slope = lambda _, z: v - float(LUGRE.sigma0) * abs(v) * z / g
    return float(solve_ivp(slope, (0.0, time), [z], method="LSODA", rtol=1e-10, atol=1e-13).y[0, -1])


def test_lugre_follows_its_equation() -> None:
    """Sample by sample at constant velocity, with a hold and a repeated time stamp."""
    u, dt = driven(0.5, 60)
    u[30:33], dt[32] = u[30], 0.0
    z, v, expected = 0.0, 0.0, []
    for k, now in enumerate(u):
        before, bending = z, 0.0
        if k and dt[k] > 0:
            v = (now - u[k - 1]) / dt[k]
            z = at_constant_velocity(z, v, dt[k])
            bending = (z - before) / dt[k]
        expected.append(0.1 + 0.3 * now + 200.0 * z + 0.3 * bending + 0.4 * v)
    np.testing.assert_allclose(np.asarray(hf.simulate(LUGRE, u, dt)[0]), expected, rtol=1e-7, atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=20), st.floats(1e-4, 1.0))
def test_lugre_is_stable_at_any_sampling(u: list[float], dt: float) -> None:
    """The bristle never exceeds static friction, where an explicit step would grow without limit."""
    bare = dataclasses.replace(LUGRE, sigma0=1e4, sigma1=0.0, sigma2=0.0, k=0.0, offset=0.0)
    y = np.asarray(hf.simulate(bare, np.array(u), dt)[0])
    assert np.abs(y).max() <= 1.6 + 1e-9


def test_dahl_follows_its_equation() -> None:
    """dq = (sgn(du) - q) |du| / d by fine Euler steps, and by its columns."""
    u, _ = driven(1.0, 80)
    q, expected, fine = np.zeros(2), [], 20_000
    for before, now in zip(np.append(u[0], u), u, strict=False):
        way, s = abs(now - before), np.sign(now - before)
        left = (1 - way / fine / np.asarray(DAHL.d)) ** fine  # of `fine` Euler steps
        q = s + (q - s) * left if way else q
        expected.append(0.1 + 0.2 * now + np.dot(DAHL.Fc, q))
    np.testing.assert_allclose(np.asarray(hf.simulate(DAHL, u)[0]), expected, atol=1e-5)
    np.testing.assert_allclose(DAHL.free_run(u), np.asarray(hf.simulate(DAHL, u)[0]), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=8))
def test_bristles_dissipate_over_closed_cycles(corners: list[float]) -> None:
    once = np.interp(np.linspace(0, len(corners), 401), np.arange(len(corners) + 1), [*corners, corners[0]])
    y = DAHL.free_run(np.concatenate([once, once[1:], once[1:]]))[-401:]
    assert np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(once)) >= -1e-4


def test_maxwell_slip_follows_its_definition() -> None:
    """A plain loop, with a repeated time stamp; limits of an element that slips fall as the velocity grows."""
    u, dt = driven(1.0, 200)
    u[50], dt[50] = u[49], 0.0
    e, v, expected = np.zeros(3), 0.0, []
    for k, now in enumerate(u):
        before = u[max(k - 1, 0)]
        v = (now - before) / dt[k] if dt[k] > 0 else v
        limit = np.array([0.01, 0.05, 0.3]) * (1 + 0.5 * math.exp(-((v / 2.0) ** 2)))
        e = np.array([min(max(old + (now - before) / 1.5, -at), at) for old, at in zip(e, limit, strict=True)])
        expected.append(0.1 + 0.4 * (now - 0.2) / 1.5 + 0.2 * v / 5.0 + np.dot([3.0, 2.0, 1.0], e))
    np.testing.assert_allclose(np.asarray(hf.simulate(SLIP, u, dt)[0]), expected, atol=1e-12)
    design = SLIP.design_matrix(u, dt)
    columns = np.hstack([block.columns for block in design.blocks])
    np.testing.assert_allclose(columns @ [3.0, 2.0, 1.0, 0.4, 0.2, 0.1], expected, atol=1e-12)


def records(
    model: hf.LuGre | hf.MaxwellSlip, frequencies: tuple[float, ...], noise: float, samples: int = 400
) -> list[hf.Record]:
    rng, made = np.random.default_rng(0), []
    for f in frequencies:
        u, dt = driven(f, samples)
        y = np.asarray(hf.simulate(model, u, dt)[0])
        y = y + noise * rng.normal(size=u.size)
        made.append(hf.Record(u=u, y=y, t=np.cumsum(dt), u_unit="mm", y_unit="N", name=f"{f:g} Hz"))
    return made


def test_lugre_is_found_at_three_rates_and_predicts_a_fourth() -> None:
    measured = records(LUGRE, (0.02, 0.2, 2.0), 0.01)
    fit = hf.fit("lugre", measured, starts=1)
    assert fit.usable
    for name in ("sigma0", "sigma2", "Fc", "dFs", "vs", "k"):
        assert abs(fit[name].value - float(getattr(LUGRE, name))) < 4 * fit[name].stderr, name
    assert {row.name for row in fit.derived} >= {"Fs", "z_c"}
    unseen = records(LUGRE, (0.6,), 0.0)[0]
    assert fit.metrics(unseen).rmse < 0.005


def test_maxwell_slip_is_found_where_static_friction_exceeds_that_of_stops() -> None:
    measured = records(SLIP, (0.05, 0.5, 2.0), 0.005, samples=200)
    template = dataclasses.replace(SLIP, excess=0.1, vs=0.5, w=(1.0, 1.0, 1.0))
    fit = hf.fit(template, measured, start="model")
    assert fit["excess"].value == pytest.approx(0.5, abs=0.05)
    assert fit["vs"].value == pytest.approx(2.0, rel=0.1)
    stops = hf.fit("prandtl-ishlinskii-stop+viscous", measured)
    assert stops.train.rmse > 2 * fit.train.rmse


def test_what_friction_models_refuse() -> None:
    u, _ = driven(1.0)
    with pytest.raises(ModelError, match="time"):
        hf.fit("lugre", hf.Record(u=u, y=u))
    for model in (hf.LuGre(), hf.MaxwellSlip()):
        with pytest.raises(ModelError, match="inverse"):
            model.step_inverse()
    with pytest.raises(ModelError, match="bristle"):
        hf.Dahl(Fc=(1.0, 2.0), d=(1.0,))
    with pytest.raises(ModelError, match="at least"):
        hf.MaxwellSlip.of(1)


def test_laws_of_the_rate_are_tried_where_there_are_several_rates() -> None:
    """Of amplitudes that change at one frequency they are tried last, and not where the speed is a function of the place."""
    tried = lambda *frequencies: candidates(Dataset.of(records(LUGRE, frequencies, 0.01)))
    assert {"lugre", "maxwell-slip", "dahl", "dahl+viscous"} <= {*tried(0.02, 0.2).names} - {*tried(0.02, 0.2).late}
    assert {"lugre", "maxwell-slip"} <= {*tried(0.2).late}
    t = np.linspace(0, 20, 400)
    steady = hf.Record(np.sin(t), np.sign(np.cos(t)) + np.sin(t), t, u_unit="mm", y_unit="N")
    assert not {"lugre", "maxwell-slip"} & {*candidates(Dataset.of(steady)).names}
