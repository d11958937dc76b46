"""Data-quality reports of records whose loops, noise, drift, lag and damage are known."""

import functools
import itertools
import json
import math
import os
import pathlib

import numpy as np
import pytest
import scipy.ndimage
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from hystfit import BoucWen, BoucWenForce, check, compare, datasets, fit, signals, simulate
from hystfit.cli import run
from hystfit.data.circulation import circulation
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.models.registry import judged, judged_as, make_model
from hystfit.outcome.note import Code, Severity, has
from hystfit.quality import drift as drifting
from hystfit.quality import faults as small
from hystfit.quality import lag as lagging
from hystfit.quality import loops as geometry
from hystfit.quality.check import examine
from hystfit.quality.coverage import coverage_notes, covered_strokes
from hystfit.quality.degradation import strength_left
from hystfit.quality.delay import estimate_delay
from hystfit.quality.determination import Verdict
from hystfit.quality.held_out import held_out
from hystfit.quality.needs import Needs
from hystfit.quality.resonance import _filtered, lagged
from hystfit.quality.shape import loop_shape
from hystfit.quality.summary import outliers_of, summarize
from hystfit.results.measured.loop_values import quantities as loop_quantities

from .conftest import examined

SHARED = pathlib.Path(os.environ.get("HYSTFIT_DATA", pathlib.Path(__file__).parents[1] / ".." / "shared" / "data"))
needs_data = pytest.mark.skipif(not (SHARED / "piezo_dbo").is_dir(), reason="no measured data: set HYSTFIT_DATA")


def backlash(u, radius):
    """Play operator by a plain loop."""
    out, state = [], u[0]
    for value in u:
        state = min(max(state, value - radius), value + radius)
        out.append(state)
    return np.array(out)


def piezo(u):
    """Counter-clockwise loop of eight plays."""
    return u + sum(0.15 * backlash(u, radius) for radius in np.linspace(0.05, 0.75, 8))


def steel(u, yield_at=0.25):
    """Clockwise loop of a Bouc-Wen spring, by explicit small steps."""
    out, z = [], 0.0  # y = z + 0.1 u
    for step in np.diff(u, prepend=u[0]):
        z += step * (1 - (abs(z) / yield_at) * (0.6 + 0.4 * np.sign(step * z)))
        out.append(z)
    return np.array(out) + 0.1 * u


FINE = 20  # steps of the model per sample, so that fractional delays are exact


@functools.cache
def fine_output(wave, model, count):
    """Times in samples and the model's output there, on the fine grid from ten samples early."""
    early = np.arange(-10 * FINE, count * FINE) / FINE
    return early, model(wave(early))


def delayed(wave, model, lag, count):
    """Record of `count` samples: input `wave(k)`, output of the model delayed by `lag` samples."""
    k = np.arange(count)
    return wave(k), np.interp(k - lag, *fine_output(wave, model, count))


# --- turning points and loops -------------------------------------------------------------------------------------


def test_reversals_of_a_zigzag_are_its_corners():
    corners = [0.0, 3.0, 1.0, 2.0, -2.0, 4.0]
    u = np.interp(np.arange(51) / 10, np.arange(6), corners)
    np.testing.assert_array_equal(geometry.reversals(u), [10, 20, 30, 40])
    np.testing.assert_array_equal(geometry.reversals(u, 1.5), [10, 40])
    np.testing.assert_array_equal(geometry.branches(u, 1.5), [[0, 10], [10, 40], [40, 50]])
    u.flags.writeable = False
    corners = geometry._corners(u)
    assert geometry._corners(u[0 : u.size]) is corners  # found once
    np.testing.assert_array_equal(geometry.reversals(u[::-1]), [10, 20, 30, 40])
    np.testing.assert_array_equal(geometry.reversals(u[1:]), [9, 19, 29, 39])


@settings(max_examples=60)
@given(
    values=st.lists(st.integers(-8, 8), min_size=2, max_size=60), threshold=st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.5])
)
def test_reversals_alternate_and_stand_out(values, threshold):
    u = np.array(values, dtype=float)
    turns = geometry.reversals(u, threshold)
    assert (np.diff(turns) > 0).all()
    steps = np.diff(u[turns])
    assert (np.abs(steps) > threshold).all()
    assert (steps[1:] * steps[:-1] < 0).all()
    for start, stop in geometry.branches(u, threshold)[1:-1]:
        assert {u[start], u[stop]} == {u[start : stop + 1].min(), u[start : stop + 1].max()}


@settings(max_examples=40)
@given(values=st.lists(st.integers(-8, 8), min_size=3, max_size=60))
def test_closed_loops_return_to_their_level(values):
    u = np.array(values, dtype=float)
    for loop in geometry.closed_loops(u):
        assert loop.start < loop.turn < loop.stop
        inside = u[loop.start : loop.stop]
        assert {inside.min(), inside.max()} == {u[loop.start], u[loop.turn]} == {loop.low, loop.high}
        toward = np.sign(u[loop.start] - u[loop.turn])
        assert toward * (u[loop.stop] - u[loop.start]) >= 0


def test_loops_are_counted_with_the_nested_ones():
    levels = [0, 10, 2, 8, 4, 6, 3, 9, 0, 10]  # one large loop (10-0) with nested ones inside its way down
    u = np.interp(np.arange(0, 9.001, 0.05), np.arange(10), levels)
    loops = geometry.closed_loops(u)
    assert {(loop.low, loop.high, loop.depth) for loop in loops} == {(0, 10, 0), (2, 9, 1), (3, 8, 2), (4, 6, 3)}


def test_a_repeated_cycle_counts_once_each_time():
    _, u = signals.sine(7, 100, phase=-np.pi / 2)
    assert len(geometry.closed_loops(u, 0.01)) == 7  # the last one closes within the threshold
    assert len(geometry.cycles(u, 0.01)) == 6
    np.testing.assert_allclose(np.diff(geometry.cycles(u, 0.01)[:, 0]), 100, atol=1)


def test_reversals_follow_an_array_that_changes_and_are_forgotten_with_one_that_cannot():
    u = np.array([0.0, 2.0, 1.0, 3.0, 0.0])
    view = u[:]
    view.flags.writeable = False
    assert geometry.reversals(view).tolist() == [1, 2, 3]
    u[:] = [0.0, 1.0, 2.0, 1.0, 0.0]
    assert geometry.reversals(view).tolist() == geometry.reversals(u).tolist() == [2]
    record = Record(u=u, y=u)
    key = id(record.u)
    assert [geometry.reversals(record.u).tolist() for _ in range(2)] == [[2], [2]]
    assert key in geometry._known
    del record
    assert key not in geometry._known


def test_chatter_is_not_counted_as_reversals():
    _, u = signals.sine(7, 100)
    noisy = u + 0.02 * np.random.default_rng(1).normal(size=u.size)
    report = examined(Record(noisy, piezo(u), t=np.arange(u.size) / 100))
    assert report.records[0].motion.reversals == 14
    assert report.records[0].motion.chatter_percent > 5
    assert has(report.findings, Code.CHATTER)
    assert not has(examined(Record(u, piezo(u))).findings, Code.CHATTER)


def test_area_width_and_direction_of_a_play_are_known():
    _, u = signals.triangle(4, 400, low=-1, high=1)
    y = backlash(u, 0.3)
    loop = geometry.closed_loops(u, 0.01)[1]
    part = slice(loop.start, loop.stop + 1)
    assert geometry.loop_area(u[part], y[part]) == pytest.approx(2 * 0.3 * (2 - 2 * 0.3), rel=0.01)
    shape = examined(Record(u, y)).records[0].shape
    assert shape.width == pytest.approx(0.6, rel=0.03)
    assert shape.circulation == "counter-clockwise"
    assert examined(Record(u, u - y)).records[0].shape.circulation == "clockwise"
    assert examined(Record(u, u**3)).records[0].shape.circulation is None
    assert shape.closure_percent == pytest.approx(0, abs=0.2)


# --- small faults -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cycles", [0.2, 5, 40])
@pytest.mark.parametrize("size", [1e-4, 1e-2])
def test_noise_is_found_on_slow_and_fast_signals(cycles, size):
    k = np.arange(8000)
    y = np.sin(2 * np.pi * cycles * k / k.size) + size * np.random.default_rng(2).normal(size=k.size)
    found, bound = small.noise_rms(y)
    assert found == pytest.approx(size, rel=0.06)
    assert not bound


def test_noise_of_a_rounded_slow_signal_is_its_rounding():
    y = np.round(np.sin(np.linspace(0, 1, 5000)) / 0.01) * 0.01
    found, _ = small.noise_rms(y)
    assert found == pytest.approx(0.01 / math.sqrt(12))
    assert small.resolution(y) == pytest.approx(0.01)


def test_noise_of_printed_numbers_is_that_of_the_sensor_and_not_of_the_digits():
    """A rounded signal in steps that six digits do not hold, and an even ramp in seven digits."""
    step = 12.4023 / 200
    for radians in (15, 60):
        levels = np.round(6 * np.sin(np.linspace(0, radians, 2000)) / step)
        y = np.array([float(f"{level * step:.6g}") for level in levels])
        assert small.noise_rms(y)[0] == pytest.approx(step / math.sqrt(12), rel=0.2)
        assert small.rounding_rms(y) == pytest.approx(step / math.sqrt(12), rel=1e-3)
    ramp = np.array([float(f"{value:.7g}") for value in np.linspace(0, 100, 300)])
    assert small.noise_rms(ramp)[0] < 1e-5
    noisy = y + 0.5 * step * np.random.default_rng(1).normal(size=y.size)
    assert small.rounding_rms(ramp) == small.rounding_rms(noisy) == 0.0


def test_jumps_are_not_noise():
    for name in ("staircase", "step"):
        found, _ = small.noise_rms(signals.make(name)[1])
        assert found < 1e-12


def test_noise_of_sparse_samples_is_an_upper_bound_and_of_few_unknown():
    _, bound = small.noise_rms(np.sin(np.arange(300) * 0.9))
    assert bound
    ramp = np.round(0.7 + 0.0577 * np.arange(26), 6)
    assert small.noise_rms(ramp) == (0.0, False)  # the arithmetic of the computer is no noise of a sensor
    assert small.noise_rms(np.arange(10.0)) == (None, False)


def test_spikes_missing_samples_and_clipping_are_counted():
    t, u = signals.sine(5, 200)
    y = piezo(u)
    y = y + 0.002 * np.random.default_rng(3).normal(size=y.size)
    y[[130, 420, 777]] += [1.0, -1.2, 0.9]
    y[600:610] = np.nan
    report = examined(Record(u, y, t=t))
    record = report.records[0]
    assert (record.spikes, record.sampling.missing) == (3, 10)
    assert has(report.findings, Code.SPIKES)
    assert has(report.findings, Code.MISSING_VALUES)
    assert not has(report.findings, Code.CLIPPED)
    assert record.clipped == 0
    top = np.minimum(piezo(u), 1.2)
    clipped = examined(Record(u, top, t=t))
    assert clipped.records[0].clipped == (piezo(u) >= 1.2).sum()
    assert has(clipped.findings, Code.CLIPPED)


def test_an_outlier_beside_a_reversal_is_one_and_a_sharp_peak_of_the_output_there_is_not():
    phase = np.arange(600) / 50
    u = 2 * np.abs(2 * (phase % 1) - 1) - 1  # triangular: the output has a corner at each reversal
    y = u + 0.2 * np.sign(np.gradient(u)) * (1 - u**2) + 1e-3 * np.random.default_rng(2).standard_normal(600)
    assert not outliers_of(Record(u, y)).size
    for beside in (-1, 0, 1):
        faulty = y.copy()
        faulty[250 + beside] += 0.6
        assert outliers_of(Record(u, faulty)).tolist() == [250 + beside]
    peaks = y.copy()
    peaks[::50] += 0.1  # no farther beyond its neighbors than twice their steps
    assert not outliers_of(Record(u, peaks)).size
    jump = np.eye(1, 600, 250)[0] * 0.6  # of the input, which the output follows
    assert not outliers_of(Record(u + jump, y + jump)).size


def test_sampling_tells_uneven_repeated_and_missing_time():
    t, u = signals.sine(5, 100)
    gap = np.delete(np.arange(t.size), np.arange(200, 205))
    report = examined(Record(u[gap], u[gap], t=t[gap]))
    assert has(report.findings, Code.TIME_STEPS)
    assert not has(examined(Record(u, u, t=t)).findings, Code.TIME_STEPS)
    found = report.records[0].sampling
    assert (found.uniform, found.gaps, found.repeated_stamps) == (False, 1, 0)
    assert found.rate == pytest.approx(100)
    doubled = t.copy()
    doubled[50] = doubled[49]
    assert examined(Record(u, u, t=doubled)).records[0].sampling.repeated_stamps == 1
    untimed = examined(Record(u, u))
    assert untimed.records[0].sampling.rate is None
    assert has(untimed.findings, Code.NO_TIME)


@pytest.mark.parametrize("noise", [0.0, 0.004, 0.02])
def test_holds_are_those_of_a_scan_of_all_samples(noise):
    """Only parts at rest are scanned; the plain scan grows each stretch sample by sample from its first one."""
    rng = np.random.default_rng(3)
    for _ in range(15):
        lengths = rng.integers(1, 40, 20)
        u = np.repeat(np.where(rng.random(20) < 0.3, rng.normal(size=20), rng.normal(0, 0.01, 20)), lengths)
        u += noise * rng.normal(size=u.size)
        for tolerance in (0.01, 0.05, 0.2):
            start, expected = 0, []
            now = 0
            while now <= u.size:
                if now < u.size and np.ptp(u[start : now + 1]) <= tolerance:
                    now += 1
                elif now - start >= 10 and small._is_rest(u.tolist(), start, now, tolerance):
                    stop = small._end_of_rest(u.tolist(), start, now, tolerance)
                    expected.append((start, stop))
                    start = now = stop
                elif now == u.size:
                    break
                else:
                    start = next(k for k in range(start + 1, now + 1) if np.ptp(u[k : now + 1]) <= tolerance)
            np.testing.assert_array_equal(small.holds(u, tolerance), np.reshape(expected, (-1, 2)))


def test_holds_are_rests_and_not_the_tops_of_a_slow_sine():
    _, u = signals.staircase(100, levels=4, hold=2.0, ramp=0.5)
    motion = examined(Record(u, u)).records[0].motion
    assert motion.holds == 7
    assert motion.longest_hold == pytest.approx(200, abs=2)
    for rate in (50, 500, 5000):
        assert examined(Record(*(2 * [signals.sine(3, rate)[1]]))).records[0].motion.holds == 0


@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_holds_are_found_behind_settling_and_noise(noise):
    """Levels that the input approaches exponentially within 60 of 300 samples."""
    levels, u = np.repeat([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0], 300), []
    for level in levels:
        u.append(level if not u else u[-1] + (level - u[-1]) / 12)
    u = np.array(u) + noise * np.random.default_rng(4).normal(size=levels.size)
    spans = small.holds(u, 6e-4 + 10 * noise)
    assert len(spans) == 7
    assert (spans % 300)[1:, 0].max() < 130
    np.testing.assert_array_less(np.abs(spans[:-1, 1] - 300 * np.arange(1, 7)), 3)
    motion = examined(Record(u, u)).records[0].motion
    assert motion.holds == 7
    assert motion.longest_hold >= 300


@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_slow_waves_have_no_holds(noise):
    for rate in (50, 500, 5000):
        for wave in (signals.sine, signals.triangle, signals.decaying_sine):
            _, u = wave(3, rate)
            noisy = u + noise * np.random.default_rng(5).normal(size=u.size)
            assert len(small.holds(noisy, 4e-4 + 10 * noise)) == 0


# --- drift --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [0.02, -0.005])
def test_linear_drift_per_cycle_is_recovered(slope):
    t, u = signals.sine(20, 200)
    y = piezo(u) + slope * t + 0.002 * np.random.default_rng(4).normal(size=t.size)
    report = examined(Record(u, y, t=t))
    found = report.records[0].drift
    assert found.law == "linear"
    assert " per cycle (linear)" in report.text()
    assert found.per_cycle == pytest.approx(slope, rel=0.02)
    assert found.r2_linear > 0.99


@pytest.mark.parametrize("gamma", [0.05, -0.2])
def test_logarithmic_drift_per_decade_is_recovered_and_preferred(gamma):
    t, u = signals.sine(60, 200)
    y = piezo(u) + gamma * np.log10(np.maximum(t, 0.05)) + 0.002 * np.random.default_rng(5).normal(size=t.size)
    report = examined(Record(u, y, t=t))
    found = report.records[0].drift
    assert found.law == "logarithmic"
    assert " per decade of time (logarithmic)" in report.text()
    assert found.per_decade == pytest.approx(gamma, rel=0.03)


def test_linear_drift_without_time_is_reported():
    t, u = signals.sine(20, 200)
    report = examined(Record(u, piezo(u) + 0.02 * t))
    found = report.records[0].drift
    assert (found.law, found.per_decade) == ("linear", None)
    assert found.per_cycle == pytest.approx(0.02, rel=0.02)
    assert has(report.findings, Code.DRIFT)


def test_no_drift_is_reported_and_unlike_cycles_are_not_compared():
    t, u = signals.sine(30, 200)
    report = examined(Record(u, piezo(u) + 0.01 * np.random.default_rng(6).normal(size=t.size), t=t))
    quiet = report.records[0].drift
    assert quiet.law == "none"
    assert "none in the means of 29 similar cycles" in report.text()
    assert abs(quiet.per_cycle) < 2e-4
    _, sweep = signals.amplitude_sweep(200, cycles=8)
    assert examined(Record(sweep, piezo(sweep))).records[0].drift is None
    levels = drifting.like_cycles(u, geometry.cycles(u, 0.01))
    assert len(levels) == len(geometry.cycles(u, 0.01))


# --- lag ----------------------------------------------------------------------------------------------------------

WAVES = {
    "sine": lambda k: np.sin(2 * np.pi * k / 200 + 0.3),
    "sweep": lambda k: np.sin(2 * np.pi * k / 200) * np.clip(1.05 - k / 3000, 0, 1),
    "triangle": lambda k: 1 - 2 * np.abs(1 - 2 * np.mod(k / 200 + 0.0013, 1)),
}


@pytest.mark.parametrize("wave", sorted(WAVES))
@pytest.mark.parametrize("model", [piezo, steel, np.tanh])
@pytest.mark.parametrize("lag", [0.0, 0.5, 1.3, 2.0, 4.0])
def test_lag_is_recovered_whatever_the_hysteresis(wave, model, lag):
    u, y = delayed(WAVES[wave], model, lag, 3000)
    y = y + 0.002 * np.ptp(y) * np.random.default_rng(7).normal(size=y.size)
    found = lagging.estimate_lag(u, y, 1 / 200, geometry.reversals(u, 0.02))
    assert found is not None
    assert found.samples == pytest.approx(lag, abs=0.45)
    assert abs(found.samples - lag) < 4 * found.stderr
    assert found.stderr < 0.7
    assert found.seconds == pytest.approx(found.samples / 200)


@pytest.mark.parametrize("period", [50, 200, 500, 2000])
@pytest.mark.parametrize("lag", [0.0, 0.02])
def test_a_saturating_loop_neither_lags_nor_leads_where_its_turns_do_not_show_it(period, lag):
    """Behind a saturation the branches bend close to their turns, which the polynomials there take for a lead at any rate."""
    t = np.arange(0, 8 * period) / period
    u = 1.5 * np.sin(2 * np.pi * t) * (0.6 + 0.4 * np.cos(2 * np.pi * t / 8) ** 2)
    plays = sum(0.1 * np.exp(-2 * r) * _play(u, r) for r in np.linspace(0.05, 1.0, 15))
    y = np.interp(t - lag, t, np.tanh(5 * plays / np.abs(plays).max()))
    for seed in range(3):
        noisy = y + 0.004 * np.random.default_rng(seed).standard_normal(t.size)
        found = examined(Record(u, noisy, t=t)).records[0]
        assert not found.leads
        assert not (found.lags and lag == 0)


def _play(u, half_width):
    """Position of one play, in a plain loop."""
    place, places = 0.0, np.empty_like(u)
    for k, now in enumerate(u):
        places[k] = place = min(max(place, now - half_width), now + half_width)
    return places


def test_lag_is_unknown_without_turns_or_time():
    t, u = signals.sine(0.4, 200, frequency=0.5)
    assert examined(Record(u, u, t=t)).records[0].lag is None
    _, u = signals.sine(5, 200)
    assert examined(Record(u, piezo(u))).records[0].lag is None


def test_one_loop_before_samples_without_output_shows_no_delay():
    """As of a record whose second half was measured in another mode: the turns there tell nothing of the output."""
    h = np.tile(np.interp(np.arange(400), [0, 200, 399], [10.0, -10.0, 10.0]), 2)
    m = np.tanh(h + 1.5 * np.where(np.arange(800) % 400 < 200, 1.0, -1.0))
    m = np.where(np.arange(800) < 400, m + np.random.default_rng(0).normal(0, 1e-3, 800), np.nan)
    assert estimate_delay(h, m, 1.0, geometry.reversals(h, 0.02)) is None


@pytest.mark.slow
def test_speed_dependence_is_distinguished_from_a_lag():
    t, u = signals.sine(10, 200)
    y = steel(u)
    plain = examined(Record(u, y, t=t))
    assert not has(plain.findings, Code.SPEED_DEPENDENT, Code.LAG)
    viscous = check(Record(u, y + 0.1 * np.tanh(np.gradient(u, t) / 3), t=t))
    assert viscous.records[0].lag.samples < 0
    assert has(viscous.findings, Code.SPEED_DEPENDENT)
    assert viscous.verdict("bouc-wen-force").verdict == "partly"
    assert "+viscous" in viscous.advice.model
    late = examined(Record(u[4:], piezo(u)[:-4], t=t[4:]))
    assert late.records[0].lag.samples == pytest.approx(4, abs=0.4)
    assert not has(late.findings, Code.SPEED_DEPENDENT)
    assert has(late.findings, Code.LAG)


def test_the_turns_of_a_triangle_read_with_little_noise_are_no_lead_of_the_output():
    """As machines write a commanded ramp: rounded or read back; smoothing it would bend its turns, and the force seem to lead."""
    u = np.interp(np.arange(961), np.arange(0, 961, 60), np.array([0, *([1, -1, 2, -2, 3, -3, 4] * 2), -4, 0])[:17])
    rng = np.random.default_rng(0)
    for read in (np.round(u, 4), u + rng.normal(0, 2e-3, u.size)):
        found = examined(Record(read, steel(u) + rng.normal(0, 1e-2, u.size), t=0.1 * np.arange(u.size)))
        assert not has(found.findings, Code.SPEED_DEPENDENT, Code.LAG)


def test_loops_that_widen_with_frequency_depend_on_rate():
    slow, fast = signals.sine(8, 200, frequency=0.5)[1], signals.sine(4, 200, frequency=2.0)[1]
    u = np.concatenate([slow, fast])
    t = np.arange(u.size) / 200
    assert examined(Record(u, piezo(u), t=t)).records[0].rate_effect == pytest.approx(0, abs=0.03)
    assert examined(Record(u, piezo(u) - 0.02 * np.gradient(u, t), t=t)).records[0].rate_effect > 0.1


# --- dynamics -----------------------------------------------------------------------------------------------------


def second_order(x, dt, frequency, damping):
    """Second-order filter by Runge-Kutta steps, its input linear between samples."""
    omega, state, out = 2 * np.pi * frequency, np.array([x[0], 0.0]), [x[0]]
    slope = lambda s, force: np.array([s[1], omega**2 * (force - s[0]) - 2 * damping * omega * s[1]])
    for a, b in itertools.pairwise(x):
        for part in (0.0, 0.5):
            f0, f1, f2 = (a + (b - a) * (part + step) for step in (0.0, 0.25, 0.5))
            k1 = slope(state, f0)
            k2 = slope(state + 0.25 * dt * k1, f1)
            k3 = slope(state + 0.25 * dt * k2, f1)
            k4 = slope(state + 0.5 * dt * k3, f2)
            state = state + dt / 12 * (k1 + 2 * k2 + 2 * k3 + k4)
        out.append(state[0])
    return np.array(out)


def oscillator(force, dt):
    """Displacement of a mass on a Bouc-Wen spring (2 kg, 10 N s/m, 1e5 N/m before yielding), by Runge-Kutta steps."""

    def slope(s, f):
        y, v, z = s
        return np.array([v, (f - 10 * v - 5e4 * y - z) / 2, 5e4 * v - (800 * abs(v) * np.sign(z) - 1100 * v) * abs(z)])

    state, out, h = np.zeros(3), [0.0], dt / 4
    for a, b in itertools.pairwise(force):
        for k in range(4):
            f0, f1, f2 = (a + (b - a) * (k + part) / 4 for part in (0.0, 0.5, 1.0))
            k1 = slope(state, f0)
            k2 = slope(state + h / 2 * k1, f1)
            k3 = slope(state + h / 2 * k2, f1)
            k4 = slope(state + h * k3, f2)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        out.append(state[0])
    return np.array(out)


@functools.cache
def resonant(kind):
    """Records whose response changes with frequency."""
    noise = np.random.default_rng(11).normal
    if kind == "oscillator":
        t, force = signals.multisine(2, 1000, frequencies=(*range(6, 150, 6),), low=-150, high=150)
        y = oscillator(force, t[1])
        return Record(force, y + 1e-3 * np.ptp(y) * noise(size=t.size), t=t, u_unit="N", y_unit="m")
    t, u = (
        signals.chirp(4, 500, stop=40)
        if kind == "chirp"
        else signals.multisine(4, 500, frequencies=(0.5, 2, 7, 12, 17, 23))
    )
    y = second_order(piezo(u), t[1], 15.0, 0.1)
    return Record(u, y + 1e-3 * np.ptp(y) * noise(size=t.size), t=t, u_unit="V", y_unit="um")


@pytest.mark.parametrize(("kind", "frequency"), [("chirp", 15.0), ("multisine", 15.0), ("oscillator", None)])
def test_a_resonance_is_dynamics_and_not_damage(kind, frequency):
    report = examined(resonant(kind))
    record = report.records[0]
    assert record.dynamic
    assert not record.degrading
    assert has(report.findings, Code.DYNAMICS)
    assert not has(report.findings, Code.DEGRADING, Code.LAG, Code.SPEED_DEPENDENT)
    if frequency:
        assert record.dynamics.natural_frequency == pytest.approx(frequency, rel=0.02)
        assert record.dynamics.damping_ratio == pytest.approx(0.1, rel=0.1)
        assert record.dynamics.phase_high < -140


@pytest.mark.parametrize("time", [0.3, 7.0, 400.0])
def test_lag_of_the_search_is_that_of_scipy(time):
    x, keep = np.random.default_rng(0).normal(size=(3000, 4)), np.exp(-1 / time)
    expected = x[0] + scipy.signal.lfilter([1 - keep], [1, -keep], x - x[0], axis=0)
    np.testing.assert_allclose(lagged(x, time), expected, atol=1e-12)


def test_spline_through_the_input_is_that_of_scipy():
    u = np.cumsum(np.random.default_rng(0).normal(size=300))
    at = np.random.default_rng(1).uniform(0, 299, (7, 5))
    at[0] = 0, 299, 17, 298.5, 0.5
    expected = scipy.ndimage.map_coordinates(u, at[None], mode="mirror")
    np.testing.assert_allclose(lagging._cubic_spline(u)(at), expected, atol=1e-12)


@pytest.mark.parametrize(("frequency", "damping"), [(0.02, 0.1), (0.3, 0.02), (0.001, 1.5)])
def test_resonance_of_the_search_is_that_of_scipy(frequency, damping):
    x, omega = np.random.default_rng(0).normal(size=(3000, 4)), 2 * np.tan(np.pi * frequency)
    numerator, denominator = scipy.signal.bilinear([omega**2], [1, 2 * damping * omega, omega**2])
    expected = x[0] + scipy.signal.lfilter(numerator, denominator, x - x[0], axis=0)
    np.testing.assert_allclose(_filtered(x, frequency, damping), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("after", "model"),
    [
        ("nothing", steel),
        ("delay", piezo),
        ("two lags", steel),
        ("velocity", piezo),
        *(
            pytest.param(after, model, marks=pytest.mark.slow)
            for after, model in (("nothing", piezo), ("delay", steel), ("two lags", piezo), ("velocity", steel))
        ),
    ],
)
def test_delay_lag_velocity_and_minor_loops_are_no_resonance(model, after):
    """The gain changes with frequency in all of these: small fast loops are stiffer or softer than large slow ones."""
    for t, u in (signals.chirp(2, 500, stop=40), signals.multisine(2, 500), signals.random_reversals(8, 200, speed=4)):
        y = model(u)
        if after == "delay":
            y = np.interp(np.arange(y.size) - 3, np.arange(y.size), y)
        elif after == "two lags":
            y = second_order(y, t[1], 10.0, 1.2)
        elif after == "velocity":
            y = y + 0.3 * np.ptp(y) * np.gradient(u) / np.abs(np.gradient(u)).max()
        assert not summarize(Record(u, y, t=t)).dynamic


def test_one_frequency_shows_no_dynamics():
    t, u = signals.sine(5, 200)
    record = examined(Record(u, second_order(piezo(u), t[1], 5.0, 0.1), t=t)).records[0]
    assert not record.dynamic


# --- verdicts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "listed", "left_out"),
    [
        ({"u_name": "Displacement", "u_unit": "mm", "y_name": "Force", "y_unit": "N"}, "damper", "jiles-atherton"),
        ({"u_name": "Field", "u_unit": "A/m", "y_name": "B", "y_unit": "T"}, "jiles-atherton", "damper"),
    ],
)
def test_no_law_of_magnetization_is_listed_for_forces_and_no_law_of_forces_for_inductions(names, listed, left_out):
    t = np.linspace(0, 4, 800)
    u = 50 * np.sin(2 * np.pi * t)
    models = {
        item.model
        for item in check(
            Record(u, np.tanh((u - 5 * np.sign(np.cos(2 * np.pi * t))) / 30), t, **names), data_only=True
        ).determines
    }
    assert listed in models
    assert left_out not in models


def test_a_monotonic_record_determines_no_hysteresis_model():
    u = np.linspace(0, 1, 200)
    report = examined(Record(u, u**2, t=u))
    assert report.records[0].motion.monotonic
    assert {item.verdict for item in report.determines} == {"no"}
    assert has(report.findings, Code.NO_LOOP)


@pytest.mark.parametrize(("unit", "perhaps_time"), [("", True), ("s", True), ("mT", False)])
def test_a_monotonic_input_may_be_a_time_unless_its_unit_is_another(unit, perhaps_time):
    u = np.linspace(0, 1, 200)
    (found,) = (note for note in examined(Record(u, u**2, u_unit=unit)).findings if note.code is Code.NO_LOOP)
    assert ("if it is a time" in found.text) == perhaps_time


def test_one_branch_alone_is_asked_for_the_others():
    """Laboratory courses write a file for each branch; reversal curves are branches of one measurement."""
    branches = [
        Record(u, u**2, u_unit="A", y_unit="mT", name=f"branch_{k}") for k, u in enumerate(np.mgrid[0:3, 0:1:200j][1])
    ]
    text = lambda data: [note.text for note in examined(data).findings if note.code is Code.NO_LOOP]
    assert "give the files of all branches together" in text(branches[0])[0]
    assert not any("together" in one for one in text(Dataset(tuple(branches))))


def test_a_current_without_a_time_is_not_to_be_integrated():
    u = 3 * np.sin(np.linspace(0, 12, 400))
    record = Record(u, np.gradient(u) + 0.1 * u**3, u_unit="V", y_unit="A", u_name="U", y_name="I")
    assert not has(examined(record).findings, Code.RATE)
    timed = Record(u, record.y, np.linspace(0, 12, 400), u_unit="V", y_unit="A", u_name="U", y_name="I")
    assert has(examined(timed).findings, Code.RATE)


def test_one_amplitude_leaves_preisach_and_bouc_wen_open():
    t, u = signals.sine(10, 200)
    report = examined(Record(u, piezo(u), t=t))
    assert report.verdict("preisach").verdict == "partly"
    assert report.verdict("bouc-wen").verdict == "partly"
    assert report.verdict("duhem").verdict == "partly"
    assert report.verdict("creep").verdict == "no"


def test_many_reversal_levels_determine_preisach():
    t, u = signals.random_reversals(40, 200, speed=4)
    assert examined(Record(u, piezo(u), t=t)).verdict("preisach").verdict == "yes"
    forc, curve = signals.forc_protocol(curves=12)
    ends = np.flatnonzero(np.diff((curve > 0).astype(int)) < 0) + 1
    records = [
        Record(forc[a:b], piezo(forc[a:b]), name=f"curve-{n}")
        for n, (a, b) in enumerate(zip([0, *ends[:-1]], ends, strict=True))
    ]
    assert examined(Dataset(tuple(records))).verdict("preisach").verdict == "yes"


def test_creep_needs_a_rest_with_motion_or_a_drift():
    t, u = signals.staircase(100, levels=4, hold=5)
    still = examined(Record(u, piezo(u) + 1e-3 * np.random.default_rng(8).normal(size=t.size), t=t))
    assert still.verdict("creep").verdict == "no"
    creeping, state = [], 0.0
    for value in u:
        state += 0.005 * (value - state)
        creeping.append(state)
    assert examined(Record(u, piezo(u) + 0.1 * np.array(creeping), t=t)).verdict("creep").verdict == "yes"
    assert examined(Record(u, piezo(u))).verdict("creep").verdict == "no"


def test_the_advice_is_the_best_model_of_a_comparison(monkeypatch):
    kinds = ("preisach", "duhem", "dahl", "bouc-wen-force", "bouc-wen-baber-noori")
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: kinds)
    t, u = signals.sine(4, 200)
    measured = piezo(u) + 1e-3 * np.ptp(piezo(u)) * np.random.default_rng(0).normal(size=t.size)
    cases = [
        (Record(u, measured, t=t), "prandtl-ishlinskii"),
        (Record(u, steel(u)), "bouc-wen"),
    ]
    for data, model in cases:
        report = check(data)
        assert report.advice.model.startswith(model)
        assert make_model(report.advice.model) is not None
        parts = [judged_as(part.partition(":")[0]) for part in report.advice.model.split("+")]
        assert report.determines[0].model in parts


@pytest.mark.usefixtures("few_families")
def test_a_few_samples_of_a_curve_are_said_to_show_no_loop():
    """An isotherm of 46 samples up and down: `check` named no model and no reason."""
    x = np.append(np.linspace(0, 1, 30) ** 3, np.linspace(0.98, 0.1, 16))
    report = check(Record(x, 4 + 3 * np.tanh(40 * x) + 5 * x**3))
    assert report.advice is None
    assert any("better than a single-valued curve" in note.text for note in report.findings)


def test_no_model_is_advised_for_a_record_without_a_loop():
    """Half a cycle with a hold in which the output relaxes, as a battery's discharge: a model of loops was said to predict the loop."""
    t = np.arange(1200.0)
    u = np.interp(t, [0, 100, 600, 700, 1200], [0, 0, 0.5, 0.5, 1.0])
    relaxed = (
        0.05 * np.where(t > 600, 1 - np.exp(-np.minimum(t - 600, 100) / 20), 0) * np.exp(-np.maximum(t - 700, 0) / 20)
    )
    y = np.tanh(3 * u) + 0.3 * u**3 - relaxed + 1e-4 * np.random.default_rng(0).normal(size=t.size)
    report = check(Record(u, y, t))
    assert has(report.findings, Code.NO_LOOP)
    assert report.advice is None


@pytest.mark.parametrize("noise", [pytest.param(0.0, marks=pytest.mark.slow), 3e-4])
def test_the_advice_for_one_loop_of_plays_predicts_a_loop_of_half_the_size(noise):
    """Scattered samples do not test other amplitudes, where a Preisach density errs by half a percent."""
    rng = np.random.default_rng(5)
    radii, weights = np.append(0.0, np.sort(rng.uniform(0, 0.9, 12))), rng.exponential(1.0, 13)

    def device(u):
        position, y = np.zeros(13), []
        for value in u:
            position = np.clip(position, value - radii, value + radii)
            y.append(weights @ position)
        return np.array(y)

    u = np.cos(np.linspace(0, 4 * np.pi, 315))
    y = device(u)
    record = Record(u, y + noise * np.ptp(y) * rng.normal(size=u.size))
    half = np.concatenate([u[:158], 0.5 * u])

    def error(model):
        found = fit(model, record, starts=1)
        miss = found.predict(Record(half, np.zeros(half.size))) - device(half)
        return np.sqrt(np.mean(miss[-158:] ** 2))

    assert error(check(record).advice.model) < 0.5 * error("preisach-magnetic:spacing=steep")


def damaged(u):
    """Bouc-Wen force times a strength that falls with the farthest excursion so far."""
    return steel(u) * np.exp(-np.cumsum(np.abs(np.diff(u, prepend=u[0]))) / 60)


def slipping(period: float, lead: float, lost: float) -> Record:
    """Ten strokes of a spring and of friction, by a plain loop between the samples; the force is taken `lead` samples later.

    The friction of the last strokes is less by the part `lost`.
    """
    finer, count = 50, int(10 * period)
    t = np.arange((count + 2) * finer) / finer
    position = 37.5 * (1 - np.abs(2 * ((t / period) % 1) - 1))
    friction, forces = 0.0, []
    for step, now in zip(np.diff(position, prepend=position[0]), t, strict=True):
        limit = 6.0 * (1 - lost * now / t[-1])
        friction = min(max(friction + 12.0 * step, -limit), limit)
        forces.append(friction)
    force = 50.0 + 0.2 * position + np.array(forces)
    samples = np.arange(count) * finer
    return Record(position[samples], force[samples + int(lead * finer)])


@pytest.mark.parametrize(("period", "lead"), [(60.0, 0.0), (60.3, 0.0), (60.3, 0.3), (61.13, 0.9), (301.3, 0.6)])
def test_friction_that_changes_its_sign_between_samples_is_no_lost_stiffness(period, lead):
    assert not examined(slipping(period, lead, 0.0)).records[0].degrading
    assert examined(slipping(period, lead, 0.8)).records[0].degrading


def test_lost_stiffness_is_reported_for_damaged_loops_only():
    repeats = [signals.sine(3, 200, low=-a, high=a)[1] for a in (0.4, 0.7, 1.0)]
    u = np.concatenate([*repeats, repeats[0]])
    for model in (steel, piezo):
        sound = examined(Record(u, model(u)))
        assert sound.records[0].stiffness_left > 0.95
        assert not has(sound.findings, Code.DEGRADING)
        assert sound.verdict("prandtl-ishlinskii-stop" if model is steel else "prandtl-ishlinskii").verdict == "yes"
    broken = examined(Record(u, damaged(u)))
    assert broken.records[0].stiffness_left < 0.85
    assert broken.verdict("bouc-wen").verdict == "no"
    assert has(broken.findings, Code.DEGRADING)


@pytest.mark.usefixtures("findings_alone")
@pytest.mark.slow
def test_the_part_before_the_damage_is_proposed_for_a_fit(tmp_path, capsys):
    """Eighteen whole cycles of 50 samples, of three sizes; then every branch is softer than the one before."""
    u = np.concatenate([signals.sine(3, 50, low=-a, high=a)[1] for a in (0.4, 0.7, 1.0) * 4])
    part = np.exp(-0.008 * np.maximum(np.arange(u.size) - 900, 0))
    record = Record(u, steel(u) * part, 0.04 * np.arange(u.size))
    report = examined(record)
    fast = examined(record.replace(t=1e-6 * record.t)).records[0].whole_until
    assert fast == pytest.approx(1e-6 * report.records[0].whole_until)
    assert 34.0 < report.records[0].whole_until < 40.0  # the median of four branches shows the loss
    assert not has(examined(record.segment(0, 900)).findings, Code.DEGRADING)
    np.savetxt(tmp_path / "wall.csv", np.column_stack([record.t, u, record.y]), delimiter=",", header="t_s,u,y")
    assert report.verdict("bouc-wen").verdict == "no"
    assert report.verdict("bouc-wen-baber-noori").verdict != "no"  # has terms for damage
    assert run(["check", str(tmp_path / "wall.csv")]) == 0
    end = report.records[0].whole_until
    assert capsys.readouterr().out.rstrip().endswith(f"hystfit fit {tmp_path}/wall.csv --window=:{end:.10g}")


@pytest.mark.usefixtures("findings_alone")
def test_failure_is_where_later_strokes_stay_below_80_percent_of_the_largest_force(tmp_path, capsys):
    """Twelve growing cycles of 100 samples; on its way to the ninth upper peak the device breaks."""
    t = np.arange(1200) / 100
    u = (0.2 + 0.1 * t) * np.sin(2 * np.pi * t)
    record = Record(u, steel(u) * np.where(np.arange(t.size) < 810, 1.0, 0.2))
    assert examined(record).records[0].fails_at == 810
    assert has(examined(record).findings, Code.FAILURE)
    for end in (810, 825):  # the rest of the branch on which it breaks tests no later stroke
        assert not has(examined(record.segment(0, end)).findings, Code.FAILURE)
    assert not has(examined(Record(u, steel(u))).findings, Code.FAILURE)
    note = next(note for note in fit("self-similar-stops", record).notes if note.code is Code.FAILURE)
    assert note.option == ("window", ":810")
    np.savetxt(tmp_path / "joint.csv", np.column_stack([u, record.y]), delimiter=",", header="u,y")
    run(["check", str(tmp_path / "joint.csv")])
    assert "part before the failure" in capsys.readouterr().out


@pytest.mark.slow
def test_lost_strength_is_reported_where_no_two_cycles_have_one_stroke():
    t = np.linspace(0, 8, 1200)
    u = (0.2 + 0.1 * t) * np.sin(2 * np.pi * t)
    softening = steel(u) - 0.9 * np.ptp(steel(u)) / np.ptp(u) * u  # falls past its peak, on every branch alike
    for sound in (steel(u), softening):
        assert not has(examined(Record(u, sound)).findings, Code.DEGRADING)
    broken = check(Record(u, steel(u) * np.exp(-np.cumsum(np.abs(np.diff(u, prepend=0.0))) / 8)))
    assert broken.records[0].stiffness_left is None
    assert has(broken.findings, Code.DEGRADING)
    assert make_model(broken.advice.model).degrades


def test_a_falling_amplitude_is_not_taken_as_lost_stiffness(monkeypatch):
    """Secants of any hysteresis are softer at small strokes, and every stroke of a decaying sine is smaller than those before."""
    t = np.linspace(0, 10, 500)
    u = 50 + (1 - 0.09 * t) * 47 * np.sin(2 * np.pi * 0.8 * t)
    y = np.asarray(simulate(BoucWen(c=0.15, mu=0.5, tau=0.03, rho=0.4), u)[0])
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: ("preisach",))
    report = check(Record(u, y + np.random.default_rng(0).normal(0, 0.01, t.size), t))
    assert report.records[0].stiffness_left is None
    assert not has(report.findings, Code.DEGRADING)
    assert report.advice is not None


LONG_COMPARISONS = (0, 1, 3, 4, 5, 7, 12, 13, 15)  # seeds of records that many models are fitted to


@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=pytest.mark.slow if k in LONG_COMPARISONS else ()) for k in range(16)]
)
def test_any_record_gets_a_report_that_json_can_hold(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.choice([2, 3, 7, 25, 60]))
    kinds = (
        lambda: rng.uniform(-1e3, 1e3, count),
        lambda: rng.integers(-2, 3, count).astype(float),  # ties, and pieces that are constant
        lambda: np.full(count, rng.normal()),
        lambda: rng.normal(size=count) * 10.0 ** rng.integers(-200, 3, count),
    )
    u, y = kinds[seed % 4](), kinds[seed // 4 % 4]()
    if seed % 3 == 0:
        y[1 + np.flatnonzero(rng.uniform(size=count - 1) < rng.uniform())] = math.nan
    report = check(Record(u, y, t=None if seed % 2 else np.arange(count) / 10))
    stored = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert stored["records"][0]["sampling"]["n"] == count
    assert [(note["code"], note["text"]) for note in stored["findings"]] == [(n.code, n.text) for n in report.findings]
    assert all(item.model in report.text() for item in report.determines)


def test_an_output_that_is_constant_at_first_has_a_shape_and_no_division_by_zero():
    t = np.linspace(0, 8, 801)
    u = (1 + t) * np.sin(2 * np.pi * t)
    stuck = piezo(u) * (t > 3.0)
    left = strength_left(u, stuck, geometry.cycles(u))
    assert left is not None
    assert left == pytest.approx(strength_left(u, piezo(u), geometry.cycles(u)))  # the median of the last four
    assert strength_left(u, np.zeros_like(u), geometry.cycles(u)) is None


def test_a_damper_whose_current_varies_is_not_damaged():
    """White noise moves it, and another one sets its current: what is lost at a low current comes back."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noise = lambda width, rng=rng: np.convolve(rng.normal(size=8000), np.hanning(width), "same")[1000:-1000]
        u, level = noise(61), noise(301)
        current = np.clip(1.1 + 0.8 * level / level.std(), 0.0, 2.25)
        speed = np.gradient(u) / np.gradient(u).std()
        force = (90 + 300 * current) * np.tanh(2 * speed) + 40 * speed + rng.normal(0, 10, u.size)
        found = summarize(Record(u=u, y=force, u_unit="cm", y_unit="N"))
        assert not found.degrading
        assert not found.weakens


def test_a_last_loop_of_constant_output_has_no_closure():
    u = np.tile(np.concatenate([np.linspace(0, 1, 20), np.linspace(1, 0, 20)[1:-1]]), 4)
    u = np.append(u, 0.0)
    y = piezo(u) * (np.arange(u.size) < 2.9 * 38)
    loops = [loop for loop in geometry.closed_loops(u) if loop.stop <= 4 * 38]
    found = loop_shape(u, y, loops, geometry.cycles(u))
    assert found is not None
    assert found.closure_percent is None


NOISE = np.random.default_rng(3).normal(size=260)
MOTIONS = {
    "one amplitude": lambda x: np.sin(2 * np.pi * 5 * x),
    "growing": lambda x: x * np.sin(2 * np.pi * 6 * x),
    "stepped": lambda x: np.round(3 * np.sin(2 * np.pi * 2 * x)) / 3,
    "chirp": lambda x: np.sin(2 * np.pi * (2 + 8 * x) * x),
    "one reversal": lambda x: 1 - np.abs(1 - 2 * x),
    "ramp": lambda x: x,
    "constant": lambda x: np.ones_like(x),
}
DEVICES = {"plays": piezo, "steel": steel, "line": lambda u: 2 * u, "constant": np.zeros_like}
DRIFTS = {
    "none": np.zeros_like,
    "linear": lambda x: 2 * x,
    "logarithmic": lambda x: 0.1 * np.log10(x + 1e-3),
    "exponential": lambda x: -np.exp(-5 * x),
}


def kinds_of_records(sizes=(3, 4, 17, 60, 260), noises=(0.0, 1e-3, 0.3)):
    """Arguments of `made`."""
    choices = (sizes, MOTIONS, DEVICES, DRIFTS, noises, (None, 1, 20), ("none", "even", "uneven", "whole seconds"))
    return st.tuples(*(st.sampled_from(list(choice)) for choice in choices))


def made(count, motion, device, drift, noise, gap, clock):
    """A record: with or without time, drifting, holding, clockwise, constant, sparse, with `gap` missing outputs."""
    x = np.linspace(0, 1, count)
    u = MOTIONS[motion](x)
    y = DEVICES[device](u) + DRIFTS[drift](x) + noise * NOISE[:count]
    if gap:
        y[1 : 1 + min(gap, count - 2)] = np.nan
    return Record(
        u, y, t={"none": None, "even": 10 * x, "uneven": 10 * x**1.3, "whole seconds": np.floor(10 * x)}[clock]
    )


def codes(report):
    """What a report decides: verdicts, codes and severities, and the recommended model."""
    verdicts = {item.model: item.verdict for item in report.determines}
    return (
        verdicts,
        sorted((note.code, note.severity) for note in report.findings),
        report.advice and report.advice.model,
    )


@settings(max_examples=80)
@given(
    kinds_of_records(),
    st.sampled_from([(1.0, 0.0), (1e-12, 0.0), (1e9, -1e12), (1.0, 1e7)]),
    st.sampled_from([1e-9, 1.0, 1e12]),
)
def test_check_never_fails_on_records_of_any_kind(kind, output, scale):
    """Neither with huge offsets and tiny scales, where rounding may change what is found."""
    record, (factor, offset) = made(*kind), output
    report = examine(Dataset((record.replace(u=scale * record.u, y=factor * record.y + offset),)), judged())
    stored = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert len(stored["findings"]) == len(report.findings)
    assert all(item.model in report.text() for item in report.determines)
    if len(record) < 16:
        assert {item.verdict for item in report.determines} == {"no"}
        few = [note for note in report.findings if note.code is Code.TOO_FEW_SAMPLES]
        assert [note.severity for note in few] == [Severity.ERROR]


def test_too_few_samples_for_any_model_have_no_advice():
    u = np.concatenate([np.arange(0.0, 6.0), np.arange(4.0, -1.0, -1.0)])
    report = check(Record(u, np.maximum.accumulate(u) * 0.3 + u))
    assert any(note.code is Code.TOO_FEW_SAMPLES for note in report.findings)
    assert report.advice is None


@settings(max_examples=30)
@given(kinds_of_records((17, 60, 260), (1e-3, 0.1)), st.sampled_from([-9, -3, 2, 6]), st.sampled_from([-6, 3, 9]))
def test_units_and_origins_change_no_finding(kind, u_power, y_power):
    record = made(*kind)
    moved = record.replace(
        u=10.0**u_power * (record.u + 3.0),
        y=10.0**y_power * (record.y - 5.0),
        t=None if record.t is None else 1e3 * (record.t + 2.0),
    )
    # The findings alone: the advice depends on where zero is, as magnetic loops are centered there.
    verdicts, notes, _ = codes(examine(Dataset((record,)), judged()))
    assert codes(examine(Dataset((moved,)), judged()))[:2] == (verdicts, notes)


@pytest.mark.parametrize(
    "kind",
    [
        (60, "one amplitude", "plays", "none", 0.0, 20, "even"),
        pytest.param((60, "stepped", "steel", "linear", 1e-3, 20, "none"), marks=pytest.mark.slow),
        (17, "ramp", "line", "exponential", 0.0, 20, "whole seconds"),
        (17, "one amplitude", "plays", "none", 1e-3, 20, "none"),
        pytest.param((60, "chirp", "steel", "logarithmic", 1e-3, None, "uneven"), marks=pytest.mark.slow),
        pytest.param((60, "one reversal", "plays", "none", 0.3, 1, "even"), marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    ("factor", "offset", "scale"), [pytest.param(1.0, 0.0, 1.0, marks=pytest.mark.slow), (1e9, -1e12, 1e-9)]
)
def test_advice_never_fails_on_few_samples_with_gaps(kind, factor, offset, scale):
    record = made(*kind)
    report = check(record.replace(u=scale * record.u, y=factor * record.y + offset))
    assert report.advice is None or make_model(report.advice.model) is not None


def test_a_fifth_without_an_output_holds_out_nothing():
    u = np.sin(np.linspace(0, 60, 400))
    held = held_out([Record(u, np.where(np.arange(400) < 100, np.nan, u))])
    for fold in held.folds:
        assert (fold[:100] == -1).all()
        assert (fold[100:] >= 0).any()


@settings(max_examples=10)
@given(kinds_of_records((60,)), kinds_of_records((60,)))
def test_the_order_of_records_changes_no_finding(first, second):
    records = made(*first).replace(name="a"), made(*second).replace(name="b")
    assert codes(examine(Dataset(records), judged())) == codes(examine(Dataset(records[::-1]), judged()))


def test_one_amplitude_alone_covers_no_minor_loops():
    t, u = signals.sine(4, 100)
    one, half = Record(u, piezo(u), t=t), Record(0.5 * u, piezo(0.5 * u), t=t)
    many = Record(*(2 * [signals.decaying_sine(6, 100)[1]]))
    assert [note.code for note in coverage_notes([one])] == [Code.MINOR_LOOPS]
    assert coverage_notes([many]) == coverage_notes([one, half]) == ()
    np.testing.assert_allclose(covered_strokes([one]), [2.0], rtol=1e-3)
    assert has(examined(one).findings, Code.MINOR_LOOPS)
    assert not has(examined(many).findings, Code.MINOR_LOOPS)


def test_the_ends_of_a_record_are_strokes_where_they_are_the_largest():
    """From the top down, a small reversal at the bottom, and up again: no loop of the small reversal alone."""
    u = np.interp(np.arange(161), [0, 60, 70, 80, 160], [1.0, -1.0, -0.8, -1.0, 1.0])
    np.testing.assert_allclose(covered_strokes([Record(u, piezo(u))]), [2.0, 0.2])
    first = np.interp(np.arange(161), [0, 40, 100, 160], [0.0, 1.0, -1.0, 0.5])  # the first magnetization is no stroke
    np.testing.assert_allclose(covered_strokes([Record(first, piezo(first))]), [2.0])


def test_constant_columns_are_reported_and_do_not_break():
    report = examined(Record(np.ones(50), np.arange(50.0), t=np.arange(50.0)))
    assert report.records[0].motion.monotonic
    report = examined(Record(np.sin(np.arange(500) / 10), np.ones(500), t=np.arange(500.0)))
    assert report.records[0].drift.law == "none"


def test_a_declared_need_decides_the_verdict():
    """Each need alone, on data that meet it and on data that do not."""
    t, one = signals.sine(10, 200)
    many = signals.random_reversals(40, 200, speed=4)
    slow, fast = signals.sine(8, 200, frequency=0.5)[1], signals.sine(4, 200, frequency=2.0)[1]
    swept = np.concatenate([slow, fast])
    loops = {
        "one": Record(one, piezo(one), t=t),
        "untimed": Record(one, piezo(one)),
        "many": Record(many[1], piezo(many[1]), t=many[0]),
        "swept": Record(swept, piezo(swept), t=np.arange(swept.size) / 200),
        "skewed": Record(one, piezo(one) + 0.5 * one**2, t=t),
        "clockwise": Record(one, steel(one), t=t),
        "resonant": resonant("chirp"),
        "sparse": Record(one[::12], piezo(one)[::12]),
        "coarse": Record(one[::25], piezo(one)[::25]),
        "three": Record(one[:3], piezo(one)[:3]),
        "ramp": Record(t, t**2, t=t),
        "ramp and hold": Record(np.minimum(t, 1.0), np.minimum(t, 1.0), t=t),
    }
    expected = [
        (Needs(), "one", Verdict.YES),
        (Needs(), "ramp", Verdict.NO),
        (Needs(loop=False), "ramp", Verdict.YES),
        (Needs(time=True), "one", Verdict.YES),
        (Needs(time=True), "untimed", Verdict.NO),
        (Needs(amplitudes=2), "one", Verdict.PARTLY),
        (Needs(amplitudes=2), "many", Verdict.YES),
        (Needs(dynamics=True), "swept", Verdict.PARTLY),
        (Needs(dynamics=True), "resonant", Verdict.YES),
        (Needs(), "resonant", Verdict.PARTLY),
        (Needs(parameters=200), "sparse", Verdict.NO),
        (Needs(parameters=80), "sparse", Verdict.PARTLY),
        (Needs(parameters=50), "sparse", Verdict.YES),
        (Needs(parameters=200, regularized=True), "sparse", Verdict.PARTLY),
        (Needs(), "three", Verdict.NO),
        (Needs(regularized=True), "coarse", Verdict.PARTLY),
        (Needs(turning_pairs=(3, 10)), "one", Verdict.PARTLY),
        (Needs(turning_pairs=(3, 10)), "many", Verdict.YES),
        (Needs(symmetry="symmetric"), "one", Verdict.YES),
        (Needs(symmetry="symmetric"), "skewed", Verdict.PARTLY),
        (Needs(symmetry="asymmetric"), "one", Verdict.PARTLY),
        (Needs(symmetry="asymmetric"), "skewed", Verdict.YES),
        (Needs(amplitudes=2, symmetry="generalized"), "one", Verdict.YES),
        (Needs(amplitudes=2, symmetry="generalized"), "skewed", Verdict.PARTLY),
        (Needs(direction="counter-clockwise"), "clockwise", Verdict.NO),
        (Needs(direction="clockwise"), "clockwise", Verdict.YES),
        (Needs(direction="clockwise"), "one", Verdict.NO),
        (Needs(loop=False, creep=True), "ramp and hold", Verdict.NO),
    ]
    found = {
        name: examine(record, {str(k): need for k, (need, *_) in enumerate(expected)}) for name, record in loops.items()
    }
    for k, (need, name, verdict) in enumerate(expected):
        assert found[name].verdict(str(k)).verdict is verdict, (need, name)


def test_findings_name_their_record_where_there_are_several():
    t, u = signals.sine(5, 100)
    records = [Record(u, piezo(u), t=t, name="first"), Record(u, piezo(u), name="second")]
    notes = [note for note in examined(Dataset(tuple(records))).findings if note.code is Code.NO_TIME]
    assert [note.text.split(":")[0] for note in notes] == ["second"]
    assert notes[0].severity is Severity.WARNING


# --- measured data ------------------------------------------------------------------------------------------------


@needs_data
def test_piezo_model_has_its_known_noise_drift_and_lag():
    record = examined(datasets.load("piezo_dbo/model", folder=SHARED)).records[0]
    assert record.y.noise_rms == pytest.approx(0.07, rel=0.05)
    assert record.motion.cycles == 39
    assert record.drift.law == "logarithmic"
    assert record.drift.per_decade == pytest.approx(0.42, abs=0.03)
    assert record.drift.r2_log > 0.97
    assert record.lag.samples == pytest.approx(4, abs=3 * record.lag.stderr)
    assert record.shape.circulation == "counter-clockwise"


@needs_data
def test_piezo_test_has_nested_loops_and_two_holds():
    report = examined(datasets.load("piezo_dbo/test", folder=SHARED))
    motion = report.records[0].motion
    assert motion.holds == 2
    assert motion.nested > 10
    assert report.verdict("preisach").verdict == "yes"
    assert report.verdict("creep").verdict == "yes"


@needs_data
def test_the_monotonic_coupon_has_no_loop():
    report = examined(datasets.load("steel_resspylab/example_3", folder=SHARED))
    assert {item.verdict for item in report.determines} == {"no"}


@needs_data
@pytest.mark.parametrize("name", ["trial2", "spc1"])
def test_damaged_structures_are_out_of_reach(name):
    report = examined(datasets.load(f"struct_slotboom/{name}", folder=SHARED))
    assert report.verdict("bouc-wen").verdict == "no"
    assert has(report.findings, Code.DEGRADING)


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["struct_slotboom/u-damper", "steel_resspylab/example_1", "steel_resspylab/example_2"])
def test_sound_steel_is_within_reach(name):
    report = check(datasets.load(name, folder=SHARED))
    assert report.verdict("bouc-wen-force").verdict == "yes"
    assert report.verdict("prandtl-ishlinskii").verdict == "no"
    assert report.records[0].shape.circulation == "clockwise"
    assert judged_as(report.advice.model.partition(":")[0]) == report.determines[0].model
    assert (
        compare(datasets.load(name, folder=SHARED), [report.advice.model, "bouc-wen-force"]).rows[0].name
        == report.advice.model
    )


@needs_data
@pytest.mark.parametrize("name", ["M130_27s", "MnZn_ferrite"])
def test_magnetic_loops_close_and_have_no_time(name):
    report = examined(datasets.load(f"mag_ja_bh/{name}", folder=SHARED))
    for record in report.records:
        assert abs(record.shape.closure_percent) < 0.5
        assert record.shape.circulation == "counter-clockwise"
        assert record.lag is None
    assert report.verdict("preisach").verdict == "partly"
    assert report.verdict("creep").verdict == "no"


@needs_data
def test_the_damper_needs_a_velocity_term():
    report = examined(datasets.load("mr_labcontrol/4.1", folder=SHARED))
    assert has(report.findings, Code.SPEED_DEPENDENT)
    assert has(report.findings, Code.SPIKES) == (report.records[0].spikes > 0)


@pytest.mark.parametrize("begin", [0.0, 0.7, 2.0, 4.5])
def test_a_cycle_that_begins_in_the_middle_of_its_loop_has_the_shape_of_the_ellipse(begin):
    """One closed cycle, as magnetometers record it: area pi sin(phi), width sin(phi) of the stroke, symmetric about its center."""
    phase, lag = begin + np.linspace(0.0, 2 * np.pi, 400), 0.4
    [record] = examined(Record(np.cos(phase), np.cos(phase - lag))).records
    assert record.shape is not None
    assert record.shape.circulation == "counter-clockwise"
    assert record.shape.area == pytest.approx(np.pi * np.sin(lag), rel=0.01)
    assert record.shape.width_percent == pytest.approx(100 * np.sin(lag), rel=0.01)
    assert record.shape.asymmetry_percent < 0.5


@pytest.mark.usefixtures("few_families")
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_noise_is_no_loop_and_a_faint_loop_in_noise_is_one(seed):
    rng, t = np.random.default_rng(seed), np.linspace(0, 10, 1000)
    u = 50 + (1 - 0.09 * t) * 50 * np.sin(2 * np.pi * 0.8 * t)
    unrelated = check(Record(u=u, y=rng.normal(size=t.size), t=t))
    assert (unrelated.records[0].shape.circulation, unrelated.advice) == (None, None)
    assert has(unrelated.findings, Code.SINGLE_VALUED)
    y = np.asarray(simulate(BoucWen(c=0.15, mu=0.1, tau=0.1, rho=0.5), u)[0])
    faint = examined(Record(u=u, y=y + 0.1 * rng.normal(size=t.size), t=t))
    assert faint.records[0].shape.circulation == "counter-clockwise"


def test_a_calibration_point_is_no_branch_of_a_loop():
    """Reversal curves of a magnet, each after one sample at saturation: they show no direction of a loop."""
    fields = [np.concatenate([[6.0], np.linspace(low, 6.0, 60)]) for low in (-1.0, -2.0, -3.0)]
    weight = np.append(0.0, np.ones(60))
    labels = {"u_unit": "Oe", "y_unit": "emu"}
    curves = [
        Record(u, np.tanh(u - 0.2 * u[1]), weight=weight, name=f"curve={k}", **labels) for k, u in enumerate(fields)
    ]
    report = examined(Dataset(tuple(curves)))
    assert [record.shape for record in report.records] == [None] * 3
    assert not any("clockwise" in reason for item in report.determines for reason in item.reasons)


@pytest.mark.parametrize(("loss", "expected"), [pytest.param(0.0, False, marks=pytest.mark.slow), (0.5, True)])
def test_stiffness_lost_at_growing_strokes_is_damage(loss, expected, monkeypatch):
    """No two cycles of one stroke: a yielding element whose stiffness falls with the dissipated energy, by a plain loop."""
    kinds = ("preisach-signed", "bouc-wen-force", "bouc-wen-baber-noori", "self-similar-stops")
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: kinds)
    part = np.linspace(0, 1, 900)
    x = (0.1 + 0.9 * part) * np.sin(16 * np.pi * part)
    z, energy, force = 0.0, 0.0, np.zeros(x.size)
    for k in range(1, x.size):
        dx = x[k] - x[k - 1]
        rate = (1 - abs(z) ** 2 * (0.5 + 0.5 * np.sign(dx * z))) / (1 + loss * energy)
        z = np.clip(z + 8 * rate * dx, -1, 1)
        energy += abs(z * dx)
        force[k] = 0.1 * x[k] + z
    report = check(Record(x, force + 0.005 * np.random.default_rng(1).normal(size=x.size)))
    assert has(report.findings, Code.DEGRADING) == expected
    assert report.advice is None or make_model(report.advice.model).degrades == expected


def test_many_findings_that_differ_in_numbers_are_one():
    """Loops that do not close, each by another amount: one finding, which counts the records."""
    t, u = signals.sine(4, 100)
    records = [Record(u, steel(u) + 0.02 * k * t / t[-1], t=t, name=f"{k}") for k in range(8, 20)]
    found = [note for note in examined(Dataset(tuple(records))).findings if note.code in (Code.DRIFT, Code.NOT_CLOSED)]
    assert found
    assert len(found) == len({note.code for note in found})
    alone = [note for note in examined(Dataset(tuple(records[:2]))).findings if note.code is found[0].code]
    assert len(alone) == 2


def test_the_drift_of_one_record_of_many_is_no_creep_of_all():
    t, u = signals.sine(8, 100)
    clean = lambda k: Record(u, piezo((1 + 0.01 * k) * u), t=t, name=f"{k}")
    drifting = Record(u, piezo(u) + 0.3 * np.log10(1 + 10 * t), t=t, name="drifts")
    assert examined(drifting).verdict("creep").verdict == "yes"
    many = examined(Dataset((drifting, *(clean(k) for k in range(1, 15)))))
    assert many.verdict("creep").verdict == "no"
    assert sum(note.code is Code.DRIFT for note in many.findings) == 1


def capacitor(sign):
    """A capacitor with hysteresis: its charging current, and a current in phase with its charge."""
    t, u = signals.sine(5, 100, low=-3, high=3)
    u = u * np.linspace(0.3, 1.0, u.size)
    charge = 0.2 * u + piezo(u)
    record = Record(u, sign * np.gradient(charge, t), t=t, u_unit="V", y_unit="A")
    return record, record.replace(y=charge)


def test_a_current_in_phase_with_the_voltage_is_a_loop_of_its_own():
    conducting = check(capacitor(1.0)[1])
    assert next(note for note in conducting.findings if note.code is Code.RATE).option is None
    assert conducting.advice is not None


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_current_of_a_capacitor_is_integrated_and_not_damaged(sign, tmp_path, capsys, monkeypatch):
    """A charging current is no loop of its own, whichever way it is counted."""
    record, _ = capacitor(sign)
    report = check(record)
    found = next(note for note in report.findings if note.code is Code.RATE)
    assert found.option == ("integrate", "true")
    assert report.advice is None
    assert not has(report.findings, Code.DEGRADING)
    monkeypatch.setattr("hystfit.fitting.data_check._compared", lambda _: None)
    rows = (f"{a:.9g},{b:.9g},{c:.9g}" for a, b, c in zip(record.t, record.u, record.y, strict=True))
    (tmp_path / "pulse.csv").write_text("\n".join(["t_s,U_V,I_A", *rows]) + "\n")
    run(["check", str(tmp_path / "pulse.csv")])
    command = capsys.readouterr().out.strip().splitlines()[-1]
    assert run(command.split()[1:]) == 0  # integrated: a loop of charge


def calorimetry(sign, *, timed):
    """A heat flow in a cycle of temperature: a heat capacity, and a transition that absorbs 12 J/g at 72 degC and releases it at 48."""
    t = np.arange(0.0, 1200.0, 1.0)
    temperature = 20 + np.minimum(t, 1200 - t) / 6
    rising, peak = t < 600, 12 / (3 * np.sqrt(2 * np.pi))
    enthalpy_rate = (
        np.where(rising, 1.0, -1.0)
        / 6
        * (0.7 + peak * np.exp(-0.5 * ((temperature - np.where(rising, 72, 48)) / 3) ** 2))
    )
    noise = 0.003 * np.random.default_rng(0).standard_normal(t.size)
    return Record(temperature, sign * enthalpy_rate + noise, t if timed else None, u_unit="°C", y_unit="W/g")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_heat_flow_of_a_calorimeter_is_integrated(sign):
    """Heat flows of heating and cooling differ in sign, and between them lies no loop; that of the enthalpy has the height of the heat."""
    record = calorimetry(sign, timed=True)
    report = check(record)
    found = next(note for note in report.findings if note.code is Code.RATE)
    assert found.option == ("integrate", "true")
    assert report.advice is None
    loop = record.integrated()
    assert loop.y_unit == "J/g"
    at_60 = lambda rows: np.interp(60, loop.u[rows], sign * loop.y[rows])
    np.testing.assert_allclose(at_60(slice(None, 600)) - at_60(slice(None, 600, -1)), -12, atol=1)


def test_a_heat_flow_without_a_time_asks_for_it():
    record = calorimetry(-1.0, timed=False)
    report = check(record)
    found = next(note for note in report.findings if note.code is Code.RATE)
    assert (found.severity, found.option) == ("warning", None)
    assert report.advice is None


def cooled(*, returns):
    """A magnetization over a temperature that rises and falls: of particles cooled without and with a field, or of a transition."""
    temperature = np.concatenate([np.linspace(5, 300, 120), np.linspace(300, 5, 120)])
    rising = np.arange(240) < 120
    in_field = 1 / np.sqrt(1 + (temperature / 60) ** 2)
    blocked = 1 / (1 + np.exp((60 - temperature) / 8))
    transition = 0.5 - 0.5 * np.tanh((temperature - np.where(rising, 160, 140)) / 10)
    moment = transition if returns else np.where(rising, blocked, 1.0) * in_field
    return temperature, moment + 0.003 * np.random.default_rng(0).standard_normal(240)


THERMAL = {"u_unit": "K", "y_unit": "emu", "u_name": "Temperature", "y_name": "Moment"}


def test_field_cooled_curves_are_no_loop_and_a_transition_is_one():
    """The first sweep begins in another state than that in which the second one ends."""
    temperature, moment = cooled(returns=False)
    both = Record(temperature, moment, **THERMAL)
    up = [
        Record(temperature[rows], moment[rows], name=name, **THERMAL)
        for name, rows in (("zfc", slice(120)), ("fc", slice(239, 119, -1)))
    ]
    for data in (both, Dataset(tuple(up))):
        report = check(data)
        assert [note.code for note in report.findings].count(Code.NO_LOOP) == 1
        assert not has(report.findings, Code.NOT_CLOSED)
        assert report.advice is None
    transition = examined(Record(*cooled(returns=True), **THERMAL))
    assert not has(transition.findings, Code.NO_LOOP)


def remanences(*, back_to):
    """Remanences after fields that grow, and then after fields back to `back_to` that grow in the other direction, and forth again."""
    acquired = np.geomspace(1e-3, 1, 40)
    switched = lambda field: 0.5 * (1 + np.tanh(np.log(field / 0.04) / 0.6))
    back = acquired[acquired <= back_to]
    field = [acquired, -back, *([acquired] if back_to == 1 else [])]
    moment = [switched(acquired), 1 - 2 * switched(back), *([2 * switched(acquired) - 1] if back_to == 1 else [])]
    noise = 1e-3 * np.random.default_rng(0).standard_normal(sum(map(len, field)))
    return np.concatenate(field), np.concatenate(moment) + noise


@pytest.mark.parametrize("names", [("Field", "Remanence"), ("treat_dc_field", "magn_moment")])
def test_remanences_after_fields_are_no_loop_unless_they_return(names):
    """IRM and DCD curves of one file; the zero of the latter is the field at which half of the moments have switched."""
    units = {"u_unit": "T", "y_unit": "Am2", "u_name": names[0], "y_name": names[1], "name": "specimen"}
    curves = Record(*remanences(back_to=0.9), **units)
    report = check(curves)
    assert has(report.findings, Code.NO_LOOP)
    assert report.advice is None
    (found,) = (one for one in loop_quantities(curves).rows["specimen"] if one.name == "coercive_input")
    assert found.label == "coercivity of remanence"
    assert abs(found.value - 0.04) < 3 * found.stderr < 1e-3
    assert not has(examined(Record(*remanences(back_to=1.0), **units)).findings, Code.NO_LOOP)


def test_a_loop_is_open_on_a_steep_line_and_with_points_far_in_saturation():
    """A film on a magnetic substrate, and a table whose last points are a thousand coercivities away; neither is a butterfly."""
    branch = lambda u, sign: np.tanh((u - sign * 160.0) / 300.0)
    steps = np.linspace(-9e4, 9e4, 3001)
    field = np.concatenate([steps, steps[-2::-1]])
    moment = np.concatenate([branch(steps, 1.0), branch(steps[-2::-1], -1.0)])
    film = examined(Record(field, moment + 1e-4 * field + 1e-3 * np.random.default_rng(0).normal(size=field.size)))
    assert film.records[0].shape.circulation == "counter-clockwise"
    far = np.concatenate([[-1e7], np.linspace(-1000, 1000, 41), [1e7]])
    table = np.round(np.concatenate([branch(far, 1.0), branch(far[-2::-1], -1.0)]), 4)
    shape = examined(Record(np.concatenate([far, far[-2::-1]]), table)).records[0].shape
    assert shape.circulation == "counter-clockwise"
    assert not shape.crossing
    assert shape.width == pytest.approx(2 * np.tanh(160 / 300), rel=0.05)


def test_an_initial_curve_does_not_turn_the_way_of_a_narrow_loop():
    """The chord from the end of the loop to the begin of the initial curve encloses more than the loop, and the other way round."""
    share = np.concatenate([np.linspace(0, 1, 60), np.linspace(1, -1, 120)[1:], np.linspace(-1, 1, 120)[1:]])
    way = np.where(np.arange(share.size) < 60, 0.0, np.sign(np.gradient(share)))
    y = np.tanh(17 * share - 0.2 * way)
    assert circulation(share, y) > 0
    assert circulation(share[::-1], y[::-1]) < 0
    assert circulation(share, y) == pytest.approx(circulation(share[59:], y[59:]), rel=0.01)


def test_an_initial_curve_does_not_turn_the_way_of_a_loop_much_narrower_than_the_curve_it_stands_on():
    """A hundredth of the moment has a coercivity: the loop has a ten-thousandth of the box, its samples show it nevertheless."""
    share = np.concatenate([np.linspace(0, 1, 900), np.linspace(1, -1, 1800)[1:], np.linspace(-1, 1, 1800)[1:]])
    way = np.where(np.arange(share.size) < 900, 0.0, np.sign(np.gradient(share)))
    y = np.tanh(3 * share) + 0.03 * np.tanh((share - 0.003 * way) / 0.005)
    assert 0 < circulation(share, y) < 3e-4
    assert circulation(share, -y) == circulation(share, y)
    assert circulation(share[::-1], y[::-1]) < 0


def test_small_cycles_of_a_quiet_input_are_no_chatter():
    """Tests of soils begin with cycles of a hundredth of the last ones."""
    sizes = (0.01, 0.03, 0.1, 0.3, 1.0)
    u = np.concatenate([size * np.sin(np.linspace(0, 2 * np.pi, 101)[:-1]) for size in sizes])
    assert not has(examined(Record(u, steel(u))).findings, Code.CHATTER)


def test_a_clipped_sensor_shows_no_lag():
    """An elastic-plastic damper, whose force turns with the displacement, with a load cell that ends at 22 kN."""
    t = np.arange(0, 10, 0.01)
    u = 10 * np.sin(2 * np.pi * 0.3 * t)
    force, plastic = [], 0.0
    for x in u:
        size = 4 * (x - plastic) - 0.6 * plastic
        if abs(size) > 20:
            plastic += np.sign(size) * (abs(size) - 20) / 4.6
        force.append(4 * (x - plastic))
    y = np.clip(force + 0.1 * np.random.default_rng(30).normal(size=t.size), -22, 22)
    report = examined(Record(u, y, t, u_unit="mm", y_unit="kN", t_unit="s"))
    assert has(report.findings, Code.CLIPPED)
    assert not has(report.findings, Code.LAG)


def test_a_square_loop_is_no_delay():
    """Kerr rotation of a film: it switches at 28 mT within 6 mT, and rests where the field turns."""
    edge = np.linspace(-150, 150, 151)
    u = np.append(np.tile(np.concatenate([edge[:-1], edge[:0:-1]]), 3), -150)
    y = 1.3 * np.tanh((u - 28 * np.sign(np.gradient(u))) / 6) + 0.03 * np.random.default_rng(11).normal(size=u.size)
    assert summarize(Record(u, y, 0.05 * np.arange(u.size))).delay is None


@pytest.mark.parametrize("start", [0.0, 0.3, 0.6])
def test_a_stored_cycle_that_ends_a_sample_before_it_would_begin_again_is_a_closed_loop(start: float) -> None:
    """An ellipse of known area, from any point of it on: the return of the input to its start is no end of a loop."""
    phase = 2 * np.pi * (np.arange(50) / 50 + start)
    record = Record(u=np.sin(phase), y=np.sin(phase) + 0.6 * np.cos(phase), t=0.002 * np.arange(50))
    report = examined(record)
    (shape,) = (one.shape for one in report.records)
    assert shape is not None
    assert shape.circulation == "clockwise"
    assert shape.area == pytest.approx(-0.6 * np.pi, rel=0.01)
    assert not has(report.findings, Code.NOT_CLOSED)


def test_a_spike_is_no_strength_that_is_lost_later():
    """One sample of a logger is off by three times the largest force: no damage, no failure there, and no range of the output."""
    sizes = (5.0, 5.0, 10.0, 10.0, 20.0, 20.0, 40.0, 40.0, 60.0, 60.0)
    u = np.concatenate([[0.0], *(size * np.sin(2 * np.pi * np.arange(1, 81) / 80) for size in sizes)])
    force = np.asarray(simulate(BoucWenForce(kappa_x=0.4, kappa_w=61.0, rho=0.125, n=2.0), u)[0])
    record = Record(u=u, y=np.round(force, 2), u_unit="mm", y_unit="kN")
    spoiled = record.replace(y=record.y + np.where(np.arange(u.size) == 222, 300.0, 0.0))
    report = examined(spoiled)
    assert has(report.findings, Code.SPIKES)
    assert not has(report.findings, Code.DEGRADING, Code.FAILURE)
    clean, off = ({one.name: one.value for one in loop_quantities(one).rows["record"]} for one in (record, spoiled))
    assert off["stroke"] == clean["stroke"]
    assert off["loop_area"] == pytest.approx(clean["loop_area"], rel=0.01)


@pytest.mark.parametrize("gap", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("rest", [0, 60])
def test_a_cycle_from_rest_is_a_loop_with_the_gap_between_its_ends(gap: float, rest: int) -> None:
    """An ellipse driven from the middle of its input to both ends and back, and a charge that leaks over the cycle.

    Its first quarter, on which the input comes back to where it began, is no loop that does not close.
    """
    phase = np.concatenate([np.zeros(rest), 2 * np.pi * np.linspace(0, 1, 401), np.full(rest, 2 * np.pi)])
    leak = -2.2 * gap * phase / (2 * np.pi)
    noise = 0.0004 * np.random.default_rng(2).normal(size=(2, phase.size))
    u = 3 * np.sin(phase) + noise[0]
    y = np.sin(phase - 0.4) + leak + noise[1]
    report = examined(Record(u=u, y=y))
    (shape,) = (one.shape for one in report.records)
    assert shape is not None
    assert shape.circulation == "counter-clockwise"
    assert shape.width_percent == pytest.approx(100 * np.sin(0.4), abs=2 + 50 * gap)
    assert shape.closure_percent == pytest.approx(-100 * 2.2 * gap / np.ptp(y), abs=1)
    assert has(report.findings, Code.NOT_CLOSED) == (gap > 0)


def test_the_noise_of_one_reversal_curve_does_not_make_the_output_fall():
    """The first curves of a family begin near saturation, where they rise by less than their noise."""
    rng, grid = np.random.default_rng(11), np.random.default_rng(12)
    up, down = np.abs(grid.normal(300, 80, 300)), np.abs(grid.normal(300, 80, 300))
    records = []
    for start in np.arange(800.0, -1001.0, -60.0):
        u = np.arange(start, 1201.0, 60.0)
        state = np.where(start < -down, -1.0, 1.0)
        y = np.array([np.where(value > up, 1.0, state).mean() for value in u])
        records.append(Record(u, y + rng.normal(0, 1e-3, u.size), u_unit="Oe", y_unit="emu", name=f"curve={start:g}"))
    report = examine(Dataset(tuple(records)))
    assert any(record.falls for record in report.records)
    assert has(report.findings, Code.REVERSAL_CURVES)
    assert not has(report.findings, Code.FALLING)
