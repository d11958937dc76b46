"""Jiles-Atherton with eddy currents and excess loss beside an ODE solver, a first-order lag, the static law and its inverse; its fit."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hystfit as hf
from hystfit.fitting.comparison.candidates import candidates
from hystfit.models import jiles_atherton_dynamic
from hystfit.models.jiles_atherton_dynamic import JilesAthertonDynamic
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.rate import Excess, Viscous
from hystfit.params.units import MU0

SHEET = {"Ms": 1.3, "a": 0.2, "coupling": 0.6, "k": 0.15, "c": 0.3, "slope": 0.05}
LOSSES = {"eddy": 2e-3, "excess": 0.01, "e": 1e-3}
PERIOD = 0.05


def sine(samples: int, peak: float = 1.0, period: float = PERIOD, size: int = 1001) -> tuple[np.ndarray, np.ndarray]:
    """Field and time steps with a number of samples a cycle, from zero field; of one size, so that tests share programs."""
    t = np.arange(size) * period / samples
    return peak * np.sin(2 * np.pi * t / period), np.diff(t, prepend=0.0)


def integrated(times: np.ndarray) -> np.ndarray:
    """B by an ODE solver in time, with He and Mirr / Ms as states and the rate of B from the equation of the fields."""
    p, eddy, excess = SHEET, LOSSES["eddy"], LOSSES["excess"]
    field = 3 * p["a"] * p["coupling"]  # alpha Ms
    curve = lambda x: 1 / math.tanh(x) - 1 / x if abs(x) > 1e-3 else x / 3
    bend = lambda x: 1 / x**2 - 1 / math.sinh(x) ** 2 if abs(x) > 1e-2 else 1 / 3 - x**2 / 15

    def law(t, state):
        he, irreversible = state
        man = curve(he / p["a"])
        inside = he - field * (p["c"] * man + (1 - p["c"]) * irreversible)
        lag = math.sin(2 * math.pi * t / PERIOD) - inside
        root = (math.sqrt(excess**2 + 4 * eddy * abs(lag)) - excess) / (2 * eddy)
        rate = math.copysign(root**2, lag)
        behind = max(math.copysign(1.0, lag) * (man - irreversible), 0.0) / p["k"]
        chi = p["c"] * bend(he / p["a"]) / p["a"] + (1 - p["c"]) * behind
        moves = rate / (p["slope"] * (1 - field * chi) + p["Ms"] * chi)  # dHe/dt
        return [moves, behind * moves]

    found = solve_ivp(law, (0.0, times[-1]), [0.0, 0.0], t_eval=times, method="LSODA", rtol=1e-9, atol=1e-11)
    he, irreversible = found.y
    total = p["c"] * np.array([curve(x / p["a"]) for x in he]) + (1 - p["c"]) * irreversible
    return p["slope"] * (he - field * total) + p["Ms"] * total


def test_steps_converge_to_an_ode_solver() -> None:
    """First order in the time step: the error halves with it, and two steps extrapolate to the solution."""
    model = JilesAthertonDynamic(**SHEET, **{**LOSSES, "e": 1e-9})
    found = [np.asarray(hf.simulate(model, *sine(samples))[0])[:: samples // 40][:51] for samples in (400, 800)]
    u, dt = sine(40, size=51)
    expected = integrated(np.cumsum(dt))
    coarse, fine = (np.max(np.abs(b - expected)) for b in found)
    assert 1.8 < coarse / fine < 2.2
    np.testing.assert_allclose(2 * found[1] - found[0], expected, atol=1e-3)
    static = np.asarray(hf.simulate(hf.JilesAtherton(**SHEET), u)[0])
    assert np.max(np.abs(static - expected)) > 0.2  # the dynamic fields are no small part of this loop


def test_slow_fields_give_the_static_loop() -> None:
    """The difference falls with the frequency: as f by eddy currents, as the root of f by excess loss."""
    u, dt = sine(800)
    static = np.asarray(hf.simulate(hf.JilesAtherton(**SHEET), u)[0])
    for losses, factor in (({"eddy": 2e-3, "excess": 0.0}, 100.0), ({"eddy": 0.0, "excess": 0.01}, 10.0)):
        model = JilesAthertonDynamic(**SHEET, **losses, e=1e-9)
        away = [np.max(np.abs(np.asarray(hf.simulate(model, u, s * dt)[0]) - static)) for s in (1e5, 1e7)]
        assert away[0] / away[1] == pytest.approx(factor, rel=0.1)
        assert away[1] < 1e-3
    none = JilesAthertonDynamic(**SHEET, eddy=0.0, excess=0.0)
    np.testing.assert_allclose(hf.simulate(none, u, dt)[0], static, atol=1e-12)


def test_small_fields_follow_the_classical_law() -> None:
    """Without pinning a small field meets a permeability mu: B lags as mu H / (1 + i w mu c), and loses 2 pi^2 c B^2 f a cycle.

    With c = sigma d^2 / 12 that loss is the classical pi^2 sigma d^2 B^2 f / 6.
    """
    shape, eddy, frequency, peak = {**SHEET, "c": 1.0}, 2e-3, 20.0, 1e-3
    mu = shape["Ms"] / (3 * shape["a"]) / (1 - shape["coupling"]) + shape["slope"]
    u, dt = sine(250, peak=peak, period=1 / frequency)
    b = np.asarray(hf.simulate(JilesAthertonDynamic(**shape, eddy=eddy, excess=0.0), u, dt)[0])
    last, w = slice(-251, None), 2j * np.pi * frequency
    gain = mu / (1 + mu * eddy * (1 - np.exp(-w * dt[-1])) / dt[-1])  # of differences over the samples
    assert gain == pytest.approx(mu / (1 + w * mu * eddy), rel=0.02)
    assert abs(gain.imag / gain.real) > 0.5
    np.testing.assert_allclose(
        b[last], np.imag(gain * peak * np.exp(w * np.cumsum(dt)[last])), atol=1e-4 * abs(gain) * peak
    )
    loss = float(np.sum(0.5 * (u[last][1:] + u[last][:-1]) * np.diff(b[last])))
    assert loss == pytest.approx(2 * np.pi**2 * eddy * (abs(gain) * peak) ** 2 * frequency, rel=1e-3)


TURNS = [0.0, 1.0, -0.8, 0.4, -0.2, 1.0, -1.0, 0.1]
MINOR = np.interp(np.arange(1001), np.linspace(0, 1000, len(TURNS)), TURNS)


def test_driven_by_its_output_the_sum_of_fields_gives_the_input_again() -> None:
    """`jiles-atherton-b+viscous+excess`, another search with other states, on minor loops too."""
    b = np.asarray(hf.simulate(JilesAthertonDynamic(**SHEET, **LOSSES), MINOR, 2e-4)[0])
    fields = hf.Sum(JilesAthertonField(**SHEET), Viscous(c=LOSSES["eddy"]), Excess(g=LOSSES["excess"], e=LOSSES["e"]))
    np.testing.assert_allclose(np.asarray(hf.simulate(fields, b, 2e-4)[0]), MINOR, atol=1e-8)


def test_a_comparison_tries_it_on_magnetic_loops_of_several_rates() -> None:
    u, dt = sine(100, size=401)
    loop = lambda rate: hf.Record(u, np.tanh(3 * u), np.cumsum(dt) / rate, u_unit="A/m", y_unit="T", name=f"{rate:g}")
    of = lambda *rates: candidates(hf.Dataset(tuple(map(loop, rates)))).names
    assert "jiles-atherton-dynamic" in of(1.0, 10.0)
    assert "jiles-atherton-dynamic" not in of(1.0)


@pytest.mark.slow
def test_the_inverse_gives_the_input_again() -> None:
    model = JilesAthertonDynamic(**SHEET, **LOSSES, offset=0.2)
    b = np.asarray(hf.simulate(model, MINOR, 2e-4)[0])
    np.testing.assert_allclose(hf.invert(model, b, dt=2e-4, limits=(-1.2, 1.2)).u, MINOR, atol=1e-8)


@pytest.mark.slow
def test_a_fit_of_three_frequencies_separates_the_losses_from_the_pinning() -> None:
    truth = {"Ms": 1.6, "a": 30.0, "coupling": 0.7, "k": 25.0, "c": 0.3, "eddy": 0.02, "excess": 0.3}
    model, rng, records = JilesAthertonDynamic(**truth, slope=MU0, e=0.1), np.random.default_rng(0), []
    for frequency in (5.0, 50.0, 200.0):
        h, dt = sine(120, peak=150.0, period=1 / frequency, size=241)
        b = np.asarray(hf.simulate(model, h, dt)[0]) + rng.normal(0, 0.005, h.size)
        records.append(hf.Record(h, b, np.cumsum(dt), u_unit="A/m", y_unit="T", name=f"{frequency:.0f} Hz"))
    started = JilesAthertonDynamic().start(records)
    assert all(abs(float(getattr(started, name)) / true - 1) > 0.05 for name, true in truth.items())
    result = hf.fit("jiles-atherton-dynamic", hf.Dataset(tuple(records)), starts=1)
    assert float(result.model.slope) == MU0
    for name, true in truth.items():
        row = next(p for p in result.parameters if p.name == name)
        assert abs(row.value - true) < 4 * row.stderr < 0.2 * true, name


def test_records_of_any_length_start_by_one_program(monkeypatch):
    """Each length was compiled anew, 2 s for each of 53 records; then the padding up to that of a program for all was simulated too."""
    shapes, counts = set[tuple[int, ...]](), []
    shifted = jiles_atherton_dynamic._shifted
    monkeypatch.setattr(
        jiles_atherton_dynamic,
        "_shifted",
        lambda plain, grid, u, rate, count: (
            shapes.add(u.shape) or counts.append(int(count)) or shifted(plain, grid, u, rate, count)
        ),
    )
    records = []
    for number, samples in enumerate((150, 170, 190)):
        t = np.linspace(0.0, 1.0, samples)
        u = np.sin(4 * np.pi * t)
        records.append(hf.Record(u=u, y=np.tanh(2 * u), t=t, name=f"run {number}"))
    JilesAthertonDynamic().start(records)
    assert len(shapes) == 1
    assert counts == [150, 170, 190]
