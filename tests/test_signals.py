"""Excitations: limits, shapes, turning points and errors."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystfit import signals
from hystfit.errors import DataError


def turning_values(u):
    """Values at strict sign changes of the difference, by a plain loop."""
    values, last = [], 0.0
    for before, after in itertools.pairwise(u):
        move = after - before
        if move * last < 0:
            values.append(before)
        if move != 0:
            last = move
    return np.array(values)


@pytest.mark.parametrize("name", sorted(signals.SIGNALS))
@settings(max_examples=20)
@given(low=st.floats(-50, 50), span=st.floats(0.1, 100))
def test_every_signal_stays_within_its_limits(name, low, span):
    first, second = signals.make(name, low=low, high=low + span)
    u = second if signals.signal(name).timed else first
    assert first.shape == second.shape
    assert np.isfinite(u).all()
    slack = 1e-9 * (abs(low) + span)
    assert u.min() >= low - slack
    assert u.max() <= low + span + slack


@pytest.mark.parametrize("name", [n for n, s in signals.SIGNALS.items() if s.timed])
def test_time_starts_at_zero_and_steps_by_the_rate(name):
    rate = signals.signal(name).parameters["rate"]
    t, _ = signals.make(name)
    assert t[0] == 0.0
    np.testing.assert_allclose(np.diff(t), 1 / rate, rtol=1e-9)


def test_sine_has_the_period_and_extremes_asked_for():
    t, u = signals.sine(2.0, 400, frequency=2.0, low=-20, high=100, phase=-np.pi / 2)
    assert u[0] == pytest.approx(-20)
    assert u[t == 0.25] == pytest.approx(100)
    np.testing.assert_allclose(u[:600], u[200:], atol=1e-9)


def test_triangle_moves_at_constant_speed():
    _, u = signals.triangle(3.0, 100, frequency=1.0, low=0, high=5)
    np.testing.assert_allclose(np.abs(np.diff(u)), 2 * 5 * 1.0 / 100, rtol=1e-9)
    np.testing.assert_allclose(turning_values(u), [5, 0, 5, 0, 5])


def test_decaying_sine_peaks_follow_the_exponential():
    t, u = signals.decaying_sine(6.0, 1000, frequency=1.0, low=0, high=2, decay=0.5)
    for cycle in range(6):
        at = np.isclose(t, cycle + 0.25)
        assert u[at] == pytest.approx(1 + np.exp(-0.5 * (cycle + 0.25)))


def test_multisine_is_seeded_has_its_lines_alone_and_a_lower_crest_than_one_draw():
    _, u = signals.multisine(10, 100, frequencies=(1, 3, 7), seed=4)
    np.testing.assert_array_equal(u, signals.multisine(10, 100, frequencies=(1, 3, 7), seed=4)[1])
    assert not np.array_equal(u, signals.multisine(10, 100, frequencies=(1, 3, 7), seed=5)[1])
    spectrum = np.abs(np.fft.rfft(u)) / u.size
    lines = np.fft.rfftfreq(u.size, 0.01)
    strong = lines[spectrum > 1e-6]
    np.testing.assert_allclose(strong, [1, 3, 7])
    assert np.ptp(spectrum[spectrum > 1e-6]) < 1e-9
    one = signals.multisine(10, 100, frequencies=(1, 3, 7), seed=4, tries=1)[1]
    assert signals.crest_factor(u) <= signals.crest_factor(one)
    assert np.max(np.abs(u)) == pytest.approx(1)


def test_crest_factor_of_a_sine_is_root_two():
    assert signals.crest_factor(signals.sine(10, 1000)[1] + 3) == pytest.approx(np.sqrt(2), rel=1e-4)


@pytest.mark.parametrize(("start", "stop", "order"), [(1.0, 0.2, -1), (0.2, 1.0, 1)])
def test_amplitude_sweep_grows_or_decays(start, stop, order):
    _, u = signals.amplitude_sweep(400, cycles=5, start=start, stop=stop)
    top = turning_values(u)[::2]
    np.testing.assert_allclose(top, np.linspace(start, stop, 5), rtol=1e-9)
    assert (np.diff(top) * order > 0).all()


def test_counts_may_be_floating_numbers():
    """The command line reads every number as one."""
    for name, values in (("amplitude-sweep", {"cycles": 4}), ("staircase", {"levels": 3}), ("multisine", {"tries": 2})):
        floating = signals.make(name, **{key: float(value) for key, value in values.items()})
        np.testing.assert_array_equal(floating[1], signals.make(name, **values)[1])


@pytest.mark.parametrize(("anchor", "shared"), [("low", -1.0), ("high", 3.0)])
def test_amplitude_sweep_loops_share_the_anchor(anchor, shared):
    _, u = signals.amplitude_sweep(400, cycles=4, low=-1, high=3, start=1, stop=0.25, anchor=anchor)
    turns = turning_values(u)
    np.testing.assert_allclose(turns[1::2], shared)
    np.testing.assert_allclose(np.abs(turns[::2] - shared), [4, 3, 2, 1])


def test_staircase_rests_on_every_level_up_and_down():
    t, u = signals.staircase(100, levels=3, hold=1.0, ramp=0.5, low=0, high=2)
    for number, level in enumerate([0, 1, 2, 1, 0]):
        rest = (t >= number * 1.5 + 1e-9) & (t <= number * 1.5 + 1 - 1e-9)
        np.testing.assert_allclose(u[rest], level, atol=1e-12)
    _, jumps = signals.staircase(100, levels=3, hold=1.0, ramp=0.0, low=0, high=2)
    np.testing.assert_array_equal(jumps, np.repeat([0, 1, 2, 1, 0], 100))


def test_step_jumps_once_at_the_time():
    t, u = signals.step(2.0, 100, at=0.7, low=-20, high=100)
    np.testing.assert_array_equal(u, np.where(np.arange(t.size) < 70, -20, 100))


def test_forc_protocol_returns_to_saturation_from_every_level():
    u, curve = signals.forc_protocol(curves=4, points=40, low=-2, high=2)
    assert u[0] == 2
    assert u[-1] == 2
    for number, level in enumerate([1, 0, -1, -2], start=1):
        branch = u[curve == number]
        assert branch[0] == pytest.approx(level)
        assert branch[-1] == 2
        assert (np.diff(branch) > 0).all()
        np.testing.assert_allclose(np.diff(branch), 0.1)
    np.testing.assert_allclose(turning_values(u), [1, 2, 0, 2, -1, 2, -2])


def test_random_reversals_are_seeded_turn_often_and_keep_their_speed():
    _, u = signals.random_reversals(30, 200, speed=2, seed=3)
    np.testing.assert_array_equal(u, signals.random_reversals(30, 200, speed=2, seed=3)[1])
    assert not np.array_equal(u, signals.random_reversals(30, 200, speed=2, seed=4)[1])
    assert np.abs(np.diff(u)).max() <= 2 / 200 + 1e-12
    turns = turning_values(u)
    assert turns.size > 15
    assert np.unique(np.round(turns, 3)).size > 12


def test_random_reversals_cross_a_wide_range_as_often_as_a_narrow_one():
    _, narrow = signals.random_reversals(20, 100, seed=1)
    _, wide = signals.random_reversals(20, 100, low=-20, high=100, seed=1)
    np.testing.assert_allclose((wide - 40) / 60, narrow, atol=1e-9)


@pytest.mark.parametrize("spacing", ["log", "linear"])
def test_chirp_runs_between_its_frequencies(spacing):
    t, u = signals.chirp(20, 2000, start=1, stop=20, spacing=spacing)
    crossings = t[1:][(u[:-1] < 0) & (u[1:] >= 0)]
    middle = 0.5 * (crossings[1:] + crossings[:-1])
    law = 20 ** (middle / 20) if spacing == "log" else 1 + 19 * middle / 20
    np.testing.assert_allclose(1 / np.diff(crossings), law, rtol=0.02)
    assert law[0] < 2.5
    assert law[-1] > 19


BAD = [
    ("sine", {"frequency": 0.0}, "frequency"),
    ("sine", {"frequency": -1.0}, "frequency"),
    ("sine", {"frequency": float("nan")}, "frequency"),
    ("sine", {"frequency": 150.0}, "half the rate"),
    ("sine", {"duration": 0.005, "rate": 200.0}, "at least 2"),
    ("sine", {"duration": -1.0}, "duration"),
    ("triangle", {"low": 1.0, "high": 1.0}, "low must be less than high"),
    ("decaying-sine", {"decay": 0.0}, "decay"),
    ("multisine", {"frequencies": ()}, "empty"),
    ("multisine", {"frequencies": (1.0, -2.0)}, "frequency"),
    ("amplitude-sweep", {"cycles": 0}, "cycles"),
    ("amplitude-sweep", {"start": 2.0}, "fractions"),
    ("amplitude-sweep", {"anchor": "top"}, "anchor"),
    ("staircase", {"levels": 1}, "levels"),
    ("staircase", {"ramp": -0.1}, "ramp"),
    ("step", {"at": 20.0}, "inside"),
    ("forc-protocol", {"curves": 0}, "curves"),
    ("random-reversals", {"start": 5.0}, "between low and high"),
    ("chirp", {"spacing": "cubic"}, "spacing"),
    ("sine", {"phase": float("nan")}, "phase"),
    ("sine", {"rate": 1e9, "duration": 1e6}, "1e\\+15 samples"),
    ("amplitude-sweep", {"cycles": float("inf")}, "cycles"),
    ("staircase", {"levels": float("nan")}, "levels"),
    ("staircase", {"ramp": float("nan")}, "ramp"),
    ("multisine", {"seed": -1}, "seed"),
    ("random-reversals", {"seed": -1}, "seed"),
    ("sine", {"freq": 1.0}, "frequency"),
    ("sawtooth", {}, "triangle"),
]


@pytest.mark.parametrize(("name", "parameters", "told"), BAD)
def test_bad_arguments_are_refused_by_name(name, parameters, told):
    with pytest.raises(DataError, match=told):
        signals.make(name, **parameters)


@pytest.mark.usefixtures("as_users_run")
def test_words_for_numbers_are_refused():
    with pytest.raises(DataError, match="numbers in Hz"):
        signals.make("multisine", frequencies="low")


def test_registry_names_defaults_and_description():
    entry = signals.signal("decaying_sine")
    assert entry.name == "decaying-sine"
    assert entry.make is signals.decaying_sine
    assert entry.parameters["decay"] == 0.3
    assert entry.doc.startswith("Sine about the middle")
