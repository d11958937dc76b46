"""Models that lose strength and stiffness and pinch, beside the published equations, their laws, and records of measured walls."""

from __future__ import annotations

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hystfit as hf
from hystfit.errors import ModelError
from hystfit.outcome import Code, Severity, Status
from hystfit.outcome.note import has
from hystfit.results.report.text_report import verdict

WALL = {"kappa_x": 0.4, "kappa_w": 8.0, "zy": 1.5, "beta": 0.7, "n": 1.3, "dnu": 0.004, "deta": 0.02}
PINCH = {"zs": 0.9, "p": 0.05, "q": 0.1, "psi": 0.25}


def cycles(amplitudes: tuple[float, ...], samples: int) -> np.ndarray:
    return np.concatenate([a * np.sin(2 * np.pi * np.arange(samples) / samples) for a in amplitudes])


def published(u: np.ndarray, parts: int) -> np.ndarray:
    """Force by the equations of Foliente (1995), with the force and energy of the literature, by explicit midpoint steps.

    z' = h (A - nu (beta sgn(z u') + gamma) |z|^n) / eta of the displacement z, with the energy (1 - alpha) k integral of z du.
    """
    zy, n = WALL["zy"], WALL["n"]
    k = WALL["kappa_x"] + WALL["kappa_w"] / zy
    alpha = WALL["kappa_x"] / k
    unit = (1 - alpha) * k * zy**2
    beta, gamma = WALL["beta"] * zy**-n, (1 - WALL["beta"]) * zy**-n
    dnu, deta, p = WALL["dnu"] / unit, WALL["deta"] / unit, PINCH["p"] / unit
    psi, lam, q, zs = zy * PINCH["psi"], 0.2, PINCH["q"], PINCH["zs"]

    def slope(z: float, energy: float, s: float) -> float:
        nu, eta = 1 + dnu * energy, 1 + deta * energy
        ultimate = (1 / (nu * (beta + gamma))) ** (1 / n)
        zeta1 = zs * (1 - np.exp(-p * energy))
        zeta2 = psi * (lam + zeta1)
        h = 1 - zeta1 * np.exp(-(((z * s - q * ultimate) / zeta2) ** 2))
        return h * (1 - nu * (beta * np.sign(z * s) + gamma) * abs(z) ** n) / eta

    z, energy, force = 0.0, 0.0, [0.0]
    for before, after in itertools.pairwise(u):
        du = (after - before) / parts
        for _ in range(parts):
            middle = z + 0.5 * du * slope(z, energy, np.sign(du))
            new = z + du * slope(middle, energy + 0.5 * (1 - alpha) * k * z * du, np.sign(du))
            energy += (1 - alpha) * k * 0.5 * (z + new) * du
            z = new
        force.append(alpha * k * after + (1 - alpha) * k * z)
    return np.array(force)


def test_baber_noori_follows_the_published_equations() -> None:
    u = cycles((1.0, 3.0, 6.0, 6.0, 4.0), 100)
    expected = published(u, 20)
    model = hf.BoucWenBaberNoori(**WALL, **PINCH)
    error = lambda substeps: (
        np.abs(np.asarray(hf.simulate(hf.BoucWenBaberNoori(**WALL, **PINCH, substeps=substeps), u)[0]) - expected).max()
        / np.ptp(expected)
    )
    assert error(2) < 4e-3
    assert error(8) < 0.12 * error(2)  # second order
    assert model.advice(10 * u)
    assert not model.advice(np.linspace(0, 1, 10))


def test_without_damage_it_is_bouc_wen() -> None:
    """sigma = beta in the normalized form of `BoucWenForce`."""
    u = cycles((1.0, 3.0, 6.0), 200)
    plain = {**WALL, "dnu": 0.0, "deta": 0.0}
    found = hf.simulate(hf.BoucWenBaberNoori(**plain, zs=0.0, substeps=16), u)[0]
    force = hf.BoucWenForce(kappa_x=0.4, kappa_w=8.0, rho=1 / 1.5, sigma=0.7, n=1.3, substeps=16)
    np.testing.assert_allclose(np.asarray(found), np.asarray(hf.simulate(force, u)[0]), atol=1e-4 * 8)


@pytest.mark.parametrize("n", [0.5, 0.9])
@pytest.mark.parametrize("kind", [hf.BoucWenBaberNoori, hf.AsymmetricBoucWen])
def test_steps_through_zero_are_smooth_below_a_linear_knee(kind: type, n: float) -> None:
    """Of the equation, the output after a reversal changes by less than the input at which it was; a power below zero had poles there."""
    own = (
        {"kappa_x": 0.0, "zy": 1.0, "substeps": 1}
        if kind is hf.BoucWenBaberNoori
        else {"c": 1.0, "mu": 1.0, "tau": 1.0}
    )
    model = kind(**own, n=n)

    def after_reversal(turn: jax.Array) -> jax.Array:
        state, _ = model.step(model.init(0.0 * turn), 0.0 * turn, -turn, 1.0 + 0.0 * turn)
        return model.step(state, -turn, 0.3 - turn, 1.0 + 0.0 * turn)[1]

    turns = jnp.linspace(0.05, 0.29, 2401)
    change = np.diff(np.asarray(jax.vmap(after_reversal)(turns))) / np.diff(np.asarray(turns))
    assert -1.2 < change.min() < change.max() < 0


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.floats(-6.0, 6.0), min_size=8, max_size=8), st.floats(0.5, 4.0), st.floats(0.4, 5.0), st.floats(0, 0.99)
)
def test_energy_is_never_given_back_and_pinching_is_symmetric(
    corners: list[float], beta: float, n: float, zs: float
) -> None:
    """beta >= 1/2: the hysteretic force does work at every step; and a mirrored input gives the mirrored force."""
    u = np.interp(np.linspace(0, 8, 161), np.arange(9), np.append(0.0, corners))
    model = hf.BoucWenBaberNoori(**{**WALL, "kappa_x": 0.0, "beta": beta, "n": n}, **{**PINCH, "zs": zs})
    y = np.asarray(hf.simulate(model, u)[0])
    work = np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(u))
    assert (work >= -1e-9).all()
    np.testing.assert_allclose(np.asarray(hf.simulate(model, -u)[0]), -y, atol=1e-12)


def test_baber_noori_finds_its_parameters() -> None:
    """11 free parameters at noise of 1 % of the range, from starting values that the loops show."""
    u = cycles((1.0, 1.0, 3.0, 3.0, 6.0, 6.0, 9.0, 9.0, 9.0), 100)
    clean = np.asarray(hf.simulate(hf.BoucWenBaberNoori(**WALL, **PINCH), u)[0])
    y = clean + np.random.default_rng(0).normal(0, 0.01 * np.ptp(clean), u.size)
    result = hf.fit("bouc-wen-baber-noori", hf.Record(u=u, y=y), starts=1)
    assert result.train.rmse < 1.02 * 0.01 * np.ptp(clean)
    rows = {row.name: row for row in result.parameters}
    for name, true in {**WALL, **PINCH}.items():
        assert abs(rows[name].value - true) < 3.5 * rows[name].stderr, name
    derived = {row.name: row for row in result.derived}
    assert derived["k"].value == pytest.approx(0.4 + 8.0 / 1.5, rel=0.03)


def test_a_steady_loop_that_a_damaged_device_has_no_more_is_no_error_of_the_model() -> None:
    """The model has the loops of these cycles, and a higher one of a device without damage."""
    u = cycles((3.0, 6.0, 9.0, 9.0, 9.0, 9.0), 60)
    model = hf.BoucWenBaberNoori(**{**WALL, "dnu": 0.01, "deta": 0.04}, **PINCH)
    y = np.asarray(hf.simulate(model, u)[0])
    result = hf.fit(
        model, hf.Record(u=u, y=y + 0.002 * np.ptp(y) * np.random.default_rng(2).normal(size=y.size)), starts=1
    )
    differing = {one.name for one in result.quantities if one.differs}
    assert "stroke" in differing
    told = [note for note in verdict(result) if note.code is Code.QUANTITY_DIFFERS]
    assert len(told) == len(differing)
    assert {note.severity for note in told} == {Severity.INFO}


def test_behind_a_mirrored_input_it_starts_from_the_same_points() -> None:
    u = cycles((1.0, 2.0, 3.0), 40)
    y = np.asarray(hf.simulate(hf.BoucWenBaberNoori(**WALL, **PINCH), u)[0])
    alone = hf.BoucWenBaberNoori().starting_points([hf.Record(u=u, y=y)])
    behind = hf.Series(hf.Negate(), hf.BoucWenBaberNoori()).starting_points([hf.Record(u=-u, y=y)])
    assert len(behind) == len(alone) == 2
    for one, other in zip(behind, alone, strict=True):
        assert isinstance(one.parts[0], hf.Negate)
        for name in ("kappa_w", "kappa_x", "zy", "zs", "dnu", "deta"):
            assert float(getattr(one.parts[1], name)) == pytest.approx(float(getattr(other, name)))


def test_at_least_one_substep() -> None:
    with pytest.raises(ModelError):
        hf.BoucWenBaberNoori(substeps=0)


# -- self-similar stops ------------------------------------------------------------------------------------------------------


def weighted(peaks: int) -> hf.SelfSimilarStops:
    rng, model = np.random.default_rng(peaks), hf.SelfSimilarStops.of(peaks)
    values = {name: rng.normal(size=getattr(model, name).shape) for name in ("w", "c", "fading")}
    return dataclasses.replace(model, **values, peaks=np.geomspace(1.0, 6.0, peaks), floor=0.1, offset=0.2)


def scaled_stops(model: hf.SelfSimilarStops, u: np.ndarray) -> np.ndarray:
    """The definition, sample by sample."""
    knots, r = np.log(np.asarray(model.peaks)), np.asarray(model.r)
    w, c, fading = np.asarray(model.w), np.asarray(model.c), np.asarray(model.fading)
    plays, peak, path, before, out = np.zeros(r.size), float(model.floor), 0.0, 0.0, []
    for now in u:
        old, peak = peak, max(peak, abs(now))
        v = now / peak
        path = path * (old / peak) ** 8 + abs(now - before) / peak
        for j in range(r.size):
            if plays[j] < v - r[j]:
                plays[j] = v - r[j]
            if plays[j] > v + r[j]:
                plays[j] = v + r[j]
        y = float(model.offset)
        for b in range(knots.size):  # a function that is 1 at its own knot and 0 at the others, between them linear
            share = np.interp(np.log(peak), knots, np.eye(knots.size)[b])
            y += share * (np.dot(w[b], v - plays) + c[b] @ [v, v**3, v**5])
        left = peak / np.exp(knots[-1]) * np.exp(-path / float(model.decay))
        y += left * (np.dot(fading[: r.size], v - plays) + fading[r.size :] @ [v, v**3, v**5])
        before = now
        out.append(y)
    return np.array(out)


@pytest.mark.parametrize("peaks", [2, 4])
def test_self_similar_stops_follow_their_definition(peaks: int) -> None:
    u = np.append(cycles((0.05, 1.0, 3.0, 6.0, 6.0, 4.0), 50), [7.0, 7.0, -2.0])
    model = weighted(peaks)
    expected = scaled_stops(model, u)
    np.testing.assert_allclose(np.asarray(hf.simulate(model, u)[0]), expected, atol=1e-11)
    np.testing.assert_allclose(model.free_run(u), expected, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-6.0, 6.0), min_size=8, max_size=8), st.floats(0.01, 100.0))
def test_a_scaled_history_gives_the_same_loop(corners: list[float], factor: float) -> None:
    """One peak and no fading: input, peaks and floor times a factor leave the output as it was; a mirrored input mirrors it."""
    u = np.interp(np.linspace(0, 8, 121), np.arange(9), np.append(0.0, corners))
    plain = dataclasses.replace(weighted(1), offset=0.0, fading=np.zeros(10))
    larger = dataclasses.replace(plain, peaks=factor * np.asarray(plain.peaks), floor=factor * 0.1)
    y = np.asarray(hf.simulate(plain, u)[0])
    np.testing.assert_allclose(np.asarray(hf.simulate(larger, factor * u)[0]), y, atol=1e-9)
    np.testing.assert_allclose(np.asarray(hf.simulate(plain, -u)[0]), -y, atol=1e-12)


def test_self_similar_stops_describe_peak_oriented_damage_where_plain_stops_cannot() -> None:
    """A degrading, pinched element of another law: fitted on the first cycles and on all, beside stops that do not scale."""
    u = cycles((1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.5, 4.5, 6.0, 6.0), 80)
    y = np.asarray(hf.simulate(hf.BoucWenBaberNoori(**{**WALL, "deta": 0.1}, **PINCH), u)[0])
    record = hf.Record(u=u, y=y)
    scaled, plain = hf.fit("self-similar-stops", record), hf.fit("prandtl-ishlinskii-stop", record)
    assert scaled.train.nrmse_percent < 0.5 * plain.train.nrmse_percent
    assert scaled.usable
    broken = hf.fit("self-similar-stops", record.replace(y=np.where(np.arange(y.size) > 0.9 * y.size, 0.05 * y, y)))
    assert broken.status is Status.ROUGH
    assert has(broken.notes, Code.MODEL_MISMATCH)  # degrading terms do not describe a joint that breaks


def test_weights_of_self_similar_stops_are_found() -> None:
    truth = weighted(2)
    u = np.append(cycles((0.5, 1.0, 1.5, 2.0, 3.0, 3.0, 4.5, 5.0, 6.0, 4.0), 100), [6.0])
    clean = np.asarray(hf.simulate(truth, u)[0])
    y = clean + np.random.default_rng(0).normal(0, 0.002 * np.ptp(clean), u.size)
    empty = {name: np.zeros(getattr(truth, name).shape) for name in ("w", "c", "fading", "offset")}
    model = hf.fit(dataclasses.replace(truth, **empty), hf.Record(u=u, y=y), start="model").model
    unseen = cycles((0.7, 2.5, 5.5, 3.5), 60)
    expected = np.asarray(hf.simulate(truth, unseen)[0])
    error = np.asarray(hf.simulate(model, unseen)[0]) - expected
    assert np.std(error) < 0.01 * np.ptp(expected)


def test_bad_shapes_of_self_similar_stops() -> None:
    with pytest.raises(ModelError):
        hf.SelfSimilarStops.of(0)
    with pytest.raises(ModelError):
        hf.SelfSimilarStops(w=np.ones((2, 7)), c=np.ones((1, 3)))
    with pytest.raises(ModelError):
        hf.SelfSimilarStops(w=np.ones((1, 7)), c=np.ones((1, 3)), fading=np.ones(3))
