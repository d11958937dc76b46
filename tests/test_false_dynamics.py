"""Loops without dynamics whose shape looks like it: steep branches are no resonance, and a rest after a turn is no lag."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.models.registry import judged
from hystfit.outcome import Code
from hystfit.quality.check import examine
from hystfit.quality.lag import estimate_lag
from hystfit.quality.loops import reversals
from hystfit.quality.summary import dynamics_of


def codes(record: hf.Record) -> set[Code]:
    return {note.code for note in examine(hf.Dataset((record,)), judged()).findings}


def sweep(middle: float, width: float, steep: float, samples: int) -> hf.Record:
    """A transition that is passed upward later than downward, as of a shape-memory wire, in one slow sweep."""
    t = np.linspace(0, 120, samples)
    u = np.interp(t, [0, 60, 120], [20, 90, 20])
    at = np.where(t < 60, middle + width, middle - width)
    y = 4 / (1 + np.exp(-(u - at) / steep)) + 0.01 * np.random.default_rng(4).normal(size=samples)
    return hf.Record(u=u, y=y, t=t, u_unit="degC", y_unit="%")


@pytest.mark.parametrize(("steep", "samples"), [(1.2, 300), (2.5, 800), (5.0, 2000)])
@pytest.mark.parametrize("width", [2.0, 10.0])
def test_a_steep_transition_is_no_resonance(width: float, steep: float, samples: int) -> None:
    assert Code.DYNAMICS not in codes(sweep(55.0, width, steep, samples))


def test_one_wave_is_no_resonance() -> None:
    """The concentration in a river passes its largest value before the discharge does, once in a year."""
    day = np.arange(366.0)
    flow = 740 + 900 * np.exp(-(((day - 190) / 45) ** 2)) + 60 * np.sin(day / 9)
    load = (0.9 * np.exp(-(((day - 170) / 40) ** 2)) + 0.05) * flow / 1000
    assert Code.DYNAMICS not in codes(hf.Record(load, flow, t=86400 * day))


def behind_two_lags(values: np.ndarray, time: float) -> np.ndarray:
    """Two first-order lags of this time constant [samples], by a plain loop."""
    first = second = values[0]
    out = []
    for value in values:
        first += (value - first) * -np.expm1(-1 / time)
        second += (first - second) * -np.expm1(-1 / time)
        out.append(second)
    return np.array(out)


@pytest.mark.parametrize("what", ["a delay", "two lags", "a delayed viscous force"])
def test_a_line_behind_a_delay_or_a_lag_or_beside_a_viscous_force_is_no_resonance(what: str) -> None:
    """All change gain or phase with frequency as a resonance does: nothing but their own description tells them apart from one."""
    index = np.arange(1500.0)
    t = index / 500
    chirp, two = (
        lambda rate: np.sin(2 * np.pi * (0.5 * t + rate * t**2)),
        np.sin(2 * np.pi * t * np.where(t < 1.5, 5, 25)),
    )
    if what == "a delay":
        u = two
        y = np.interp(index - 16, index, u)
    elif what == "two lags":
        u = chirp(6)
        y = behind_two_lags(u, 16.0)
    else:
        u = chirp(3)
        rate = np.gradient(u)
        y = np.interp(index - 3, index, u + 1.2 * rate / np.abs(rate).max())
    y = y + 1e-3 * np.ptp(y) * np.random.default_rng(0).normal(size=t.size)
    found = dynamics_of(hf.Record(u=u, y=y, t=t))
    assert found is None or not found.resonant


def test_a_resonance_behind_a_play_is_one() -> None:
    """A chirp through the natural frequency, by a plain loop of small steps."""
    t = np.linspace(0, 10, 4000)
    u = np.sin(2 * np.pi * (0.5 * t + 0.55 * t**2))
    omega, zeta, step = 2 * np.pi * 6, 0.05, t[1]
    play, position, speed, y = 0.0, 0.0, 0.0, []
    for drive in u:
        play = max(drive - 0.2, min(drive + 0.2, play))
        speed += step * (omega**2 * (play - position) - 2 * zeta * omega * speed)
        position += step * speed
        y.append(position)
    assert Code.DYNAMICS in codes(hf.Record(u=u, y=np.array(y), t=t))


def test_a_resonance_far_above_a_triangle_wave_rings_after_its_turns() -> None:
    """Four plays driven at 8 Hz, then 180 Hz with little damping, by a plain loop: what hysteresis leaves is the ringing."""
    step = 2e-4
    t = step * np.arange(6000)
    u = (2 * np.abs((8 * t + 0.25) % 1 - 0.5) - 0.5) * np.linspace(2.0, 0.6, t.size)
    radii, weights, omega, zeta = np.array([0.1, 0.25, 0.4, 0.6]), np.array([0.4, 0.3, 0.2, 0.2]), 2 * np.pi * 180, 0.02
    plays, position, speed, y = np.zeros(4), 0.0, 0.0, []
    for drive in u:
        plays = np.clip(plays, drive - radii, drive + radii)
        for _ in range(4):
            speed += step / 4 * (omega**2 * (drive + weights @ plays - position) - 2 * zeta * omega * speed)
            position += step / 4 * speed
        y.append(position)
    found = dynamics_of(hf.Record(u=u, y=np.array(y) + 2e-4 * np.random.default_rng(0).normal(size=t.size), t=t))
    assert found is not None
    assert found.resonant
    assert found.natural_frequency == pytest.approx(180, rel=0.03)


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_a_valve_that_sticks_does_not_lag(seed: int) -> None:
    """The stem rests until the signal has changed by 4 %, then follows at a distance of 1.5 %: no output after the turns."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 400, 800)
    u = 50 + 40 * np.sin(2 * np.pi * t / 100) * np.linspace(0.2, 1, t.size)
    x = np.full(t.size, u[0])
    for k in range(1, t.size):
        moved = u[k] - x[k - 1]
        x[k] = x[k - 1] if abs(moved) < 4 else u[k] - np.sign(moved) * 1.5
    record = hf.Record(u=u, y=x + 0.1 * rng.normal(size=t.size), t=t, u_unit="%", y_unit="%")
    assert not codes(record) & {Code.LAG, Code.SPEED_DEPENDENT}


@pytest.mark.parametrize("wave", [np.sin, lambda phase: 2 / np.pi * np.arcsin(np.sin(phase))])
@pytest.mark.parametrize("lag", [2.0, 8.0, 15.0])
def test_a_delayed_play_lags(wave, lag: float) -> None:
    index = np.arange(2000.0)
    u = wave(2 * np.pi * index / 400)
    play, y = 0.0, []
    for drive in u:
        play = max(drive - 0.2, min(drive + 0.2, play))
        y.append(play + 0.5 * drive)
    noisy = np.interp(index - lag, index, y) + 0.005 * np.random.default_rng(3).normal(size=index.size)
    found = estimate_lag(u, noisy, 1.0, reversals(u, 0.05))
    assert found is not None
    assert abs(found.samples - lag) < 3 * found.stderr


@pytest.mark.parametrize("per_cycle", [3000, 30000])
def test_finely_sampled_plays_neither_lead_nor_lag(per_cycle: int) -> None:
    """Fifteen plays at a converter that samples fast: a tenth of a thousandth of the cycle is a sample or more."""
    t = np.arange(3 * per_cycle) / per_cycle
    u = 5 * np.sin(2 * np.pi * t)
    widths, plays, y = np.linspace(0, 1, 15), np.zeros(15), []
    for drive in u:
        plays = np.clip(plays, drive - widths, drive + widths)
        y.append(20 * plays.mean())
    noisy = np.array(y) + 0.005 * np.random.default_rng(0).normal(size=t.size)
    record = hf.Record(u=u, y=noisy, t=t, u_unit="V", y_unit="um")
    assert not codes(record) & {Code.LAG, Code.SPEED_DEPENDENT}


@pytest.mark.parametrize("amplitude", [0.7, 1.0])
def test_a_saturated_output_neither_leads_nor_lags(amplitude: float) -> None:
    """Relays that have all switched before the input turns: the output rests there, and tells nothing of a delay."""
    rng = np.random.default_rng(5)
    middle, half = rng.normal(0, 0.2, 1500), np.abs(rng.normal(0.12, 0.04, 1500))
    u = amplitude * np.sin(2 * np.pi * np.arange(1000) / 500)
    state, y = np.where(middle < 0, 1.0, -1.0), []
    for drive in u:
        state = np.where(drive > middle + half, 1.0, np.where(drive < middle - half, -1.0, state))
        y.append(0.36 * state.mean())
    assert estimate_lag(u, np.array(y), 4e-5, reversals(u, 0.05)) is None
