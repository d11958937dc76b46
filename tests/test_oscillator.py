"""The oscillator against an independent simulation of the same law, and its force between samples against closed forms."""

import dataclasses
import functools
import math
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import firwin

import hystfit as hf
from hystfit.cli import run
from hystfit.control import export_c
from hystfit.errors import ModelError
from hystfit.models.oscillator_start import upsample
from hystfit.outcome import Code
from hystfit.outcome.note import has

# m y'' + c y' + k y + z = u,  z' = kz y' - (b1 |y'| sgn z + b2 y') |z|: a spring that hardens on loading.
M, C, K, KZ, B1, B2 = 2.0, 10.0, 5e4, 5e4, 800.0, -1100.0
RATE, FINE = 750.0, 20  # samples and, in each, steps of the simulation


@functools.cache
def multisine(seed: int, samples: int) -> hf.Record:
    """Displacement under a multisine of 5 to 150 Hz and 50 N rms that begins and ends at zero.

    Simulated by a plain loop of Runge-Kutta with 20 steps a sample, the force exact at its stages; low-pass filtered and decimated.
    """
    count = 2 * FINE * samples
    f = np.fft.rfftfreq(samples, 1 / RATE)
    lines = np.where((f >= 5) & (f <= 150), np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=f.size)), 0)
    force = np.fft.irfft(np.pad(lines, (0, count // 2 + 1 - f.size)), count)
    force *= 50 / force.std()
    rise = np.sin(np.linspace(0, np.pi / 2, 200 * 2 * FINE)) ** 2  # 200 samples, below 2 Hz
    force[: rise.size] *= rise
    force[-rise.size :] *= rise[::-1]
    y = np.array(plain_loop(force.tolist(), 1 / RATE / FINE))
    taps = firwin(40 * FINE + 1, 0.9 * RATE / 2, window=("kaiser", 10.0), fs=RATE * FINE)
    smooth = np.convolve(np.pad(y, 20 * FINE, mode="edge"), taps, mode="valid")
    return hf.Record(u=force[:: 2 * FINE], y=smooth[::FINE], t=np.arange(samples) / RATE, u_unit="N", y_unit="m")


def plain_loop(force: list[float], h: float) -> list[float]:
    """Displacement at each step of length h, from rest; the force is given at every half step."""

    def slope(y: float, v: float, z: float, u: float) -> tuple[float, float, float]:
        return v, (u - C * v - K * y - z) / M, KZ * v - B1 * abs(v) * z - B2 * v * abs(z)

    y = v = z = 0.0
    out = [y]
    for k in range(0, len(force) - 2, 2):
        a, b, c = force[k : k + 3]
        p = slope(y, v, z, a)
        q = slope(y + h / 2 * p[0], v + h / 2 * p[1], z + h / 2 * p[2], b)
        r = slope(y + h / 2 * q[0], v + h / 2 * q[1], z + h / 2 * q[2], b)
        s = slope(y + h * r[0], v + h * r[1], z + h * r[2], c)
        y, v, z = (at + h * (e + 2 * f + 2 * g + i) / 6 for at, e, f, g, i in zip((y, v, z), p, q, r, s, strict=True))
        out.append(y)
    return out


def true_model(**settings: Any) -> hf.BoucWenOscillator:
    """The scaled form of the law above."""
    Z = 60.0
    return hf.BoucWenOscillator(
        m=M, c=C, K=K + KZ, a=K / (K + KZ), r_load=(B1 + B2) * Z / KZ, r_unl=(B1 - B2) * Z / KZ, Z=Z, **settings
    )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# -- the law ---------------------------------------------------------------------------------------------------------------

SOFT = dict(m=0.5, c=0.2, K=3.0, a=0.3, r_load=1.3, r_unl=0.4, n=1.7, Z=0.9, offset=0.05)


def law(force: Any) -> Any:
    """The differential equation in the constants of the literature, from the scaled ones."""
    p = SOFT
    k, kz = p["a"] * p["K"], (1 - p["a"]) * p["K"]
    b1, b2 = (0.5 * kz * (p["r_load"] + sign * p["r_unl"]) / p["Z"] ** p["n"] for sign in (1, -1))

    def rates(t: float, s: np.ndarray) -> list[float]:
        y, v, z = s
        return [
            v,
            (force(t) - p["c"] * v - k * y - z) / p["m"],
            kz * v - (b1 * abs(v) * np.sign(z) + b2 * v) * abs(z) ** p["n"],
        ]

    return rates


@pytest.mark.parametrize("between", ["linear", "hold"])
def test_it_solves_its_differential_equation(between: str) -> None:
    """From rest at the first sample, whose force need not be zero."""
    t = np.linspace(0.0, 4.0, 401)
    u = 2.0 * np.cos(2.0 * t)
    state, expected = np.zeros(3), [0.0]
    for k in range(400):
        force = lambda x, k=k: u[k] if between == "hold" else np.interp(x, t, u)
        run = solve_ivp(law(force), (t[k], t[k + 1]), state, method="DOP853", rtol=1e-10, atol=1e-12)
        state = run.y[:, -1]
        expected.append(state[0])
    found = hf.BoucWenOscillator(**SOFT, between=between).free_run(u, 0.01)
    np.testing.assert_allclose(found, 0.05 + np.array(expected), atol=2e-6 * np.ptp(found))


def test_it_is_of_fourth_order_where_nothing_switches() -> None:
    """A force that only grows: neither the velocity nor z changes sign."""
    exact = solve_ivp(law(lambda x: 4.0 * x), (0.0, 1.5), [0.0, 0.1, 0.1], method="DOP853", rtol=1e-12, atol=1e-14)
    model = hf.BoucWenOscillator(**SOFT, substeps=1, between="linear")

    def error(steps: int) -> float:
        u = np.linspace(0.0, 6.0, steps + 1)
        state, y = jnp.array([0.0, 0.1, 0.1, 1.0]), 0.0
        for a, b in pairwise(u):
            state, y = STEP(model, state, jnp.asarray(a), jnp.asarray(b), jnp.asarray(1.5 / steps))
        return abs(float(y) - 0.05 - exact.y[0, -1])

    assert 3.7 < math.log2(error(32) / error(128)) / 2 < 4.3


STEP = eqx.filter_jit(lambda model, *args: model.step(*args))


def test_a_held_force_moves_a_linear_oscillator_as_in_closed_form() -> None:
    """a = 1: no hysteretic spring; the exact discretization for a held input is a matrix exponential."""
    u = np.random.default_rng(0).normal(size=60)
    model = hf.BoucWenOscillator(m=0.5, c=0.2, K=3.0, a=1.0, between="hold", substeps=8)
    moved = expm(0.05 * np.array([[0.0, 1.0, 0.0], [-6.0, -0.4, 2.0], [0.0, 0.0, 0.0]]))  # of (y, v, u)
    state, expected = np.zeros(2), [0.0]
    for force in u[:-1]:
        state = (moved @ [*state, force])[:2]
        expected.append(state[0])
    np.testing.assert_allclose(model.free_run(u, 0.05), expected, atol=1e-7 * np.ptp(expected))


def test_the_softening_spring_is_bounded_and_differentiable_at_rest() -> None:
    t = np.linspace(0.0, 10.0, 501)
    model = hf.BoucWenOscillator(**SOFT, between="linear")
    state, forces = model.init(jnp.zeros(())), []
    for before, now in pairwise(30.0 * np.sin(t)):
        state, _ = STEP(model, state, jnp.asarray(before), jnp.asarray(now), jnp.asarray(0.02))
        forces.append(float(state[2]))
    bound = SOFT["Z"] * SOFT["r_load"] ** (-1 / SOFT["n"])
    assert np.max(forces) == pytest.approx(bound, rel=1e-3)
    assert np.min(forces) == pytest.approx(-bound, rel=1e-3)
    for n in (1.0, 1.7):
        at_rest = eqx.tree_at(lambda m: m.n, model, jnp.asarray(n))
        gradient = eqx.filter_grad(lambda m: jnp.sum(hf.simulate(m, jnp.zeros(5), 0.1)[0]))(at_rest)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree_util.tree_leaves(gradient))


@pytest.mark.usefixtures("as_users_run")
def test_bad_settings_are_refused() -> None:
    with pytest.raises(ModelError):
        hf.BoucWenOscillator(substeps=0)
    with pytest.raises(ModelError):
        hf.BoucWenOscillator(between="cubic")  # type: ignore[arg-type]


# -- the force between samples ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [2, 17, 200])
def test_a_constant_stays_constant_and_samples_are_kept(samples: int) -> None:
    np.testing.assert_allclose(upsample(jnp.full(samples, 3.0), 8), 3.0, rtol=1e-14)
    x = np.random.default_rng(0).normal(size=samples)
    fine = np.asarray(upsample(jnp.asarray(x), 6))
    assert fine.shape == (samples - 1, 7)
    np.testing.assert_array_equal(fine[:, 0], x[:-1])
    np.testing.assert_array_equal(fine[:, -1], x[1:])


@pytest.mark.parametrize("part", [0.05, 0.5, 0.8])
def test_a_sine_below_half_the_sampling_rate_is_exact_between_samples(part: float) -> None:
    k = np.arange(300)
    fine = np.asarray(upsample(jnp.asarray(np.sin(np.pi * part * k + 0.3)), 8))
    expected = np.sin(np.pi * part * (k[:-1, None] + np.arange(9) / 8) + 0.3)
    assert np.abs(fine - expected)[24:-24].max() < 2e-4


def test_a_band_limited_force_is_not_causal() -> None:
    record, model = multisine(1, 512), true_model()
    assert not model.causal
    assert true_model(between="hold").causal
    y, end = hf.simulate(model, record.u, record.dt)
    with pytest.raises(ModelError):
        hf.simulate(model, record.u, record.dt, resume=end)
    with pytest.raises(ModelError):
        model.step(model.init(jnp.zeros(())), jnp.zeros(()), jnp.ones(()), jnp.ones(()))
    with pytest.raises(ModelError):
        hf.fit(model, record, method="ukf")
    chain = hf.models.Series(model, hf.SecondOrder(omega=1e5, zeta=0.7))
    assert not chain.causal
    np.testing.assert_allclose(hf.simulate(chain, record.u, record.dt)[0], y, atol=1e-5)


def test_it_is_neither_exported_nor_inverted(tmp_path: Any) -> None:
    with pytest.raises(ModelError):
        export_c(true_model(), tmp_path)
    with pytest.raises(ModelError):
        hf.invert(true_model(between="linear"), np.zeros(5), 0.01)


def test_a_band_limited_force_needs_even_sampling() -> None:
    record = multisine(1, 512)
    t = record.dt.cumsum() + 0.3 / RATE * (np.arange(512) % 2)
    uneven = record.replace(t=t)
    for attempt in (lambda: hf.fit("oscillator", uneven), lambda: true_model().free_run(record.u, uneven.dt)):
        with pytest.raises(ModelError):
            attempt()
    assert np.isfinite(true_model(between="linear").free_run(record.u, uneven.dt)).all()


def test_samples_at_the_ends_do_not_count() -> None:
    record = multisine(1, 512)
    prepared = true_model().prepared(record)
    assert prepared.weight.sum() == 512 - 48
    assert not prepared.weight[:24].any()
    assert not prepared.weight[-24:].any()
    assert has(prepared.notes, Code.PREPARED)
    assert true_model().prepared(prepared) is prepared
    assert true_model(between="linear").prepared(record) is record


@pytest.mark.parametrize(
    ("between", "substeps", "most"), [("bandlimited", 4, 4e-7), ("bandlimited", 8, 1.5e-7), ("linear", 4, 1e-5)]
)
def test_the_simulation_is_as_accurate_as_stated(between: str, substeps: int, most: float) -> None:
    record = multisine(1, 2048)
    found = true_model(between=between, substeps=substeps).free_run(record.u, record.dt)
    assert rms((found - record.y)[24:-24]) < most


# -- advice ----------------------------------------------------------------------------------------------------------------


def test_advice_on_stability_dissipation_and_the_force() -> None:
    record = multisine(1, 512)
    good = true_model()
    assert good.advice(record.u, record.dt) == ()
    # From the stable step 2.8 / omega: 6 ms at 314 rad/s and stiffer on unloading.
    assert good.advice(record.u, 10 * record.dt) == ()
    assert len(good.advice(record.u, 40 * record.dt)) == 1
    at = lambda **values: eqx.tree_at(
        lambda m: [getattr(m, k) for k in values], good, [jnp.asarray(v) for v in values.values()]
    )
    assert len(at(r_load=-0.4, r_unl=0.3).advice(record.u, record.dt)) == 1
    assert len(at(n=1.5).advice(record.u, record.dt)) == 1
    steps = np.random.default_rng(0).choice([-50.0, 50.0], 512)
    assert len(good.advice(steps, record.dt)) == 1
    assert true_model(between="hold").advice(steps, record.dt) == ()


# -- fits ------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted() -> hf.FitResult:
    return hf.fit("oscillator", multisine(1, 2048), noise="iid")


def check_fit(result: hf.FitResult, unseen: hf.Record) -> None:
    """The limits on an unseen multisine, on mass and shape, and one minimum from all starts."""
    assert result.usable
    assert (result.in_best_basin, result.starts) == (3, 3)
    assert result.metrics(unseen).rmse < 6e-7
    derived = {p.name: p for p in result.derived}
    assert result["m"].value == pytest.approx(M, rel=2e-3)
    assert derived["b1"].value == pytest.approx(B1, rel=2e-3)
    assert derived["b2"].value == pytest.approx(B2, rel=2e-3)
    assert derived["k"].value == pytest.approx(K, rel=2e-3)
    assert derived["kz"].value == pytest.approx(KZ, rel=2e-3)


def test_a_hardening_spring_is_found_without_starting_values(fitted: hf.FitResult) -> None:
    check_fit(fitted, multisine(2, 2048))
    assert fitted.train.n == 2048 - 48
    assert fitted["r_load"].value < 0


def test_derived_constants_have_errors_of_their_formulas(fitted: hf.FitResult) -> None:
    """Delta method by hand: numerical gradients of k = a K and b1 = (1 - a) K (r_load + r_unl) / (2 Z)."""
    names, Z = fitted.free_names, float(fitted.model.Z)
    value = {
        "k": lambda p: p["a"] * p["K"],
        "b1": lambda p: (1 - p["a"]) * p["K"] * (p["r_load"] + p["r_unl"]) / (2 * Z),
    }
    for p in fitted.derived:
        if p.name not in value:
            continue
        slope = []
        for k in range(len(names)):
            h = 1e-6 * abs(fitted.x[k])
            up, down = fitted.x.copy(), fitted.x.copy()
            up[k], down[k] = up[k] + h, down[k] - h
            of = lambda x, name=p.name: value[name](dict(zip(names, x, strict=True)))
            slope.append((of(up) - of(down)) / (2 * h))
        assert p.value == pytest.approx(of(fitted.x), rel=1e-12)
        assert p.stderr == pytest.approx(np.sqrt(slope @ fitted.covariance @ np.array(slope)), rel=1e-5)
    assert {p.name: p.unit for p in fitted.derived} == {"k": "N/m", "kz": "N/m", "b1": "1/m", "b2": "1/m"}
    assert set(fitted.to_dict()["derived"]) == {"k", "kz", "b1", "b2"}


def test_derived_constants_have_no_error_where_a_parameter_behind_them_has_none(fitted: hf.FitResult) -> None:
    covariance = fitted.covariance.copy()
    at = fitted.free_names.index("r_load")
    covariance[at] = covariance[:, at] = np.nan
    unknown = dataclasses.replace(fitted, covariance=covariance)
    assert [p.name for p in unknown.derived if p.stderr is None] == ["b1", "b2"]


@pytest.mark.slow
def test_softening_on_its_bound_has_no_error_and_neither_have_its_constants() -> None:
    """The same yielding spring with Z = 4, where r_load = 40 is inside its bounds, and with Z = 6, where 60 is beyond 50."""
    t = np.arange(300) / 100
    u = 5 * np.sin(2 * np.pi * 0.7 * t) + 2 * np.sin(2 * np.pi * 2.9 * t)
    spring = functools.partial(hf.BoucWenOscillator, m=0.02, c=0.15, K=10.0, a=0.2, between="linear", substeps=8)
    y = np.asarray(hf.simulate(spring(r_load=1.0, r_unl=0.2, Z=0.1), u, 0.01)[0])
    record = hf.Record(u=u, y=y + 1e-3 * np.ptp(y) * np.random.default_rng(0).normal(size=t.size), t=t)
    inside, beyond = (
        hf.fit(spring(r_load=40.0, r_unl=2 * Z, Z=Z), record, start="model", starts=1, noise="iid") for Z in (4.0, 6.0)
    )
    assert inside["r_load"].at_bound is None
    assert inside["r_load"].value == pytest.approx(40.0, abs=4 * inside["r_load"].stderr)
    assert (beyond["r_load"].value, beyond["r_load"].at_bound, beyond["r_load"].stderr) == (
        pytest.approx(50.0),
        "upper",
        None,
    )
    assert {p.name: p.stderr is None for p in beyond.derived} == {"k": False, "kz": False, "b1": True, "b2": True}
    assert any(note.text.startswith("r_load is at its upper bound") for note in beyond.notes)


def test_the_command_line_fits_it_by_name(tmp_path: Any) -> None:
    record, file = multisine(1, 2048), tmp_path / "multisine.csv"
    rows = np.column_stack([record.t, record.u, record.y])
    np.savetxt(file, rows, delimiter=",", header="t_s,u_N,y_m", comments="")
    assert run(["fit", str(file), "--model", "oscillator"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_the_limits_hold_on_a_longer_record(noise: float) -> None:
    record = multisine(1, 4096)
    noisy = record.replace(y=record.y + noise * np.random.default_rng(0).normal(size=4096))
    result = hf.fit("oscillator", noisy, free=["n"])
    assert result.usable
    assert (result.in_best_basin, result.starts) == (3, 3)
    assert result["n"].value == pytest.approx(1.0, abs=1e-3 if noise == 0 else 0.01)
    assert result.metrics(multisine(2, 4096)).rmse < (6e-7 if noise == 0 else 1e-6)
