"""Records of kinds that the bundled data do not have, simulated here: falling loops, butterflies, chirps, counts, sensor calibrations."""

import dataclasses
import itertools
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.batch.sources import sources_of
from hystfit.cli import run
from hystfit.errors import DataError, ParameterError
from hystfit.fitting.judgment.covariance import mean_error_ratio
from hystfit.fitting.structure.structure_search import search_structure
from hystfit.models.registry import judged_as, make_model, model_name
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import has
from hystfit.quality.faults import clipped_samples, saturated_samples
from hystfit.quality.host_operators import play_positions
from hystfit.quality.reversal_curves import reversal_curves
from hystfit.quality.summary import summarize

from .conftest import examined

RNG = np.random.default_rng(5)
NOISE = RNG.normal(0.0, 1.0, 4000)


def plays(u: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Sum of plays at rest on zero."""
    p, out = np.zeros(widths.size), []
    for x in u:
        p = np.clip(p, x - widths, x + widths)
        out.append(p.sum())
    return np.array(out)


def sweep(count: int, cycles: float) -> np.ndarray:
    """Triangles of decaying amplitude, from zero."""
    phase = np.arange(count) / count * cycles
    return 10 * (1 - 0.7 * np.arange(count) / count) * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * phase))


FALLING_INPUT = sweep(400, 4)
FALLING = 3.0 - plays(FALLING_INPUT, np.array([0.3, 1.0, 2.5, 5.0]))


@pytest.fixture(scope="module")
def falling() -> hf.Record:
    """An output that falls as the input rises, and lags: strain of a shape-memory wire against temperature."""
    return hf.Record(FALLING_INPUT, FALLING + 0.01 * NOISE[:400])


def test_falling_loops_that_lag_are_fitted_with_the_input_negated(falling: hf.Record) -> None:
    report = hf.check(falling)
    assert has(report.findings, Code.FALLING)
    assert summarize(falling).circulation == "counter-clockwise"
    assert report.verdict("preisach").verdict != "no"
    assert report.verdict("prandtl-ishlinskii-stop").verdict == "no"
    assert report.advice is not None
    assert report.advice.model.startswith("negate+")
    found = search_structure(hf.Dataset.of(falling), plays=8)
    assert model_name(found.model).startswith("negate+prandtl-ishlinskii")
    assert found.score < 0.02 * np.ptp(falling.y)


def test_force_loops_with_the_sign_of_the_reaction_lead(falling: hf.Record) -> None:
    """A reaction force, negative under a positive displacement, leads as the force does."""
    u = falling.u
    force = -(2.0 * u + 6.0 * u - plays(u, np.array([0.3, 1.0, 2.5])))
    assert summarize(hf.Record(u, force)).circulation == "clockwise"


def _timed(delay: int = 0, lag: float = 0.0, viscosity: float = 0.0) -> hf.Record:
    """Plays of a sweep of falling amplitude at 100 samples/s, late by whole samples, behind a first-order lag, or with viscosity."""
    u = sweep(1200, 8)
    y, behind = plays(u, np.array([0.3, 1.0, 2.5, 5.0])), np.zeros(u.size)
    keep = np.exp(-1 / lag) if lag else 0.0
    for k in range(1, u.size):
        behind[k] = keep * behind[k - 1] + (1 - keep) * y[k]
    y = behind + viscosity * np.gradient(u)
    late = np.concatenate([np.full(delay, y[0]), y[: y.size - delay]])
    return hf.Record(u, late + 0.01 * NOISE[: u.size], np.arange(u.size) / 100)


@pytest.mark.parametrize("delay", [12, pytest.param(35, marks=pytest.mark.slow)])
def test_a_pure_delay_is_found_judged_without_and_put_in_front(delay: int) -> None:
    record = _timed(delay)
    found = summarize(record)
    assert found.delay is not None
    assert found.delay.samples == pytest.approx(delay, abs=1.0)
    assert found.delay.seconds == pytest.approx(found.delay.samples / 100)
    assert not found.lags
    assert not found.speed_dependent
    assert has(examined(record).findings, Code.DELAY)
    started = hf.Delay().start([record])
    assert float(started.lag) == pytest.approx(delay, abs=1.0)
    assert started.longest > delay
    search = search_structure(hf.Dataset.of(record), plays=8)
    assert model_name(search.model).startswith("delay:longest=")
    assert search.score < 0.01 * np.ptp(record.y)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [12, 35])
def test_a_pure_delay_is_in_the_advice(delay: int) -> None:
    report = hf.check(_timed(delay))
    assert has(report.findings, Code.DELAY)
    assert report.advice is not None
    assert report.advice.model.startswith("delay:")


@pytest.mark.parametrize("other", [{"lag": 12.0}, {"lag": 35.0}, {"viscosity": 3.0}, {}])
def test_a_lag_and_viscosity_are_no_delay(other: dict[str, float]) -> None:
    assert not has(examined(_timed(**other)).findings, Code.DELAY)


def test_a_named_model_without_a_delay_gets_a_note_on_it() -> None:
    assert has(hf.fit("prandtl-ishlinskii:plays=6", _timed(35), noise="iid").notes, Code.DELAY)
    assert make_model("delay+prandtl-ishlinskii").delays
    assert not make_model("lag+prandtl-ishlinskii").delays


def _late(samples: float, saturating: bool = True) -> hf.Record:
    """Plays behind two first-order lags, of a slow wave with a fast one on it, and a curve that saturates."""
    t = np.arange(1600) / 200
    u = 100 * np.sin(np.pi / 2 * t) * (1 - 0.03 * t) + 20 * np.sin(1.8 * np.pi * t)
    behind, keep = u.copy(), np.exp(-2 / samples) if samples else 0.0
    for _ in range(2):
        for k in range(1, u.size):
            behind[k] = keep * behind[k - 1] + (1 - keep) * behind[k]
    y = plays(behind, np.linspace(0, 40, 8)) / 300
    y = np.tanh(y) if saturating else y
    return hf.Record(u, y + 0.002 * np.ptp(y) * NOISE[:1600], t)


@pytest.mark.usefixtures("few_families")
@pytest.mark.parametrize("saturating", [True, False])
def test_a_lag_of_many_samples_is_found_and_modeled(saturating: bool) -> None:
    record = _late(14.0, saturating)
    found = summarize(record)
    assert found.slow_lag == pytest.approx(14.0, rel=0.25)
    assert has(examined(record).findings, Code.LAG)
    if not saturating:  # a curve that saturates behind a lag is described as well by weights of either sign
        advice = hf.check(record).advice
        assert advice is not None
        assert advice.model.startswith("lag+")
        assert search_structure(hf.Dataset.of(record), plays=8).structure.lag == pytest.approx(14.0, rel=0.2)


@pytest.mark.parametrize("other", [{"delay": 12}, {"viscosity": 3.0}, {}])
def test_a_delay_viscosity_and_hysteresis_alone_are_no_lag_of_many_samples(other: dict[str, float]) -> None:
    assert summarize(_timed(**other)).slow_lag is None
    assert summarize(_late(0.0)).slow_lag is None


def _beating(count: int = 1500) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plays of a wave whose amplitude beats, so that no cycles are alike: time, input, output with noise."""
    t = np.arange(count) / 50
    u = 30 * np.sin(0.4 * np.pi * t) * (0.6 + 0.4 * np.cos(0.1 * np.pi * t))
    y = plays(u, np.linspace(0, 20, 10))
    return t, u, y + 0.002 * np.ptp(y) * NOISE[:count]


def _drifting() -> tuple[hf.Record, hf.Record, float]:
    """Such a record, the same with a steady drift, and the change by it."""
    t, u, y = _beating()
    drift = 0.05 * np.ptp(y) * t / t[-1]
    return hf.Record(u, y, t), hf.Record(u, y + drift, t), drift[-1]


def _change(notes: Iterable[Note]) -> float:
    """The change that the one note on a drift states."""
    (note,) = (note for note in notes if note.code is Code.DRIFT)
    (change,) = re.findall(r"drifts by (\S+)", note.text)
    return float(change)


def test_a_steady_drift_of_unlike_cycles_is_found_and_named_by_the_fit() -> None:
    steady, drifting, drift = _drifting()
    assert not has(examined(steady).findings, Code.DRIFT)
    assert not has(hf.fit("prandtl-ishlinskii", steady).notes, Code.DRIFT)
    assert _change(hf.fit("prandtl-ishlinskii", drifting).notes) == pytest.approx(drift, rel=0.1)


@pytest.mark.slow
def test_a_steady_drift_of_unlike_cycles_is_found_by_check() -> None:
    _, drifting, drift = _drifting()
    assert _change(hf.check(drifting).findings) == pytest.approx(drift, rel=0.1)


def test_a_drift_that_a_fading_state_follows_is_named_and_no_first_half_cycle_is_blamed() -> None:
    t = np.arange(800) / 20
    u = 4 * np.sin(0.2 * np.pi * t)
    steady = u - 0.4 * (u - plays(u, np.linspace(0.2, 1.5, 6)) / 6) + 0.01 * NOISE[:800]
    warming = hf.Record(u, steady + 0.8 * (1 - np.exp(-t / 15)), t)
    assert has(hf.fit("duhem", warming).notes, Code.DRIFT)
    assert not has(hf.fit("duhem", warming).notes, Code.INITIAL_STATE)
    assert not has(hf.fit("duhem", hf.Record(u, steady, t)).notes, Code.DRIFT)


def test_noise_alone_is_no_butterfly_no_damage_and_no_creep() -> None:
    t = np.arange(1000) / 100
    for seed in range(3):
        noise = np.random.default_rng(24 + seed).normal(size=1000)
        record = hf.Record(10 * np.sin(2 * np.pi * t), noise, t)
        report = examined(record)
        assert has(report.findings, Code.SINGLE_VALUED)
        assert not has(report.findings, Code.CROSSING, Code.DEGRADING, Code.DRIFT, Code.NOT_CLOSED)
        assert report.verdict("creep").verdict != "yes"
    butterfly = hf.Record(
        u := 10 * np.sin(2 * np.pi * t), np.tanh(u - 4 * np.cos(2 * np.pi * t)) ** 2 + 0.01 * noise, t
    )
    assert has(examined(butterfly).findings, Code.CROSSING)


@pytest.mark.slow
def test_no_model_is_advised_for_noise_alone() -> None:
    t = np.arange(1000) / 100
    assert (
        hf.check(hf.Record(10 * np.sin(2 * np.pi * t), np.random.default_rng(26).normal(size=1000), t)).advice is None
    )


def _growing_from_rest() -> np.ndarray:
    """Three cycles from zero to each of four growing strokes."""
    ends = [0.0]
    for stroke in (0.3, 0.6, 0.9, 1.2):
        ends += [stroke, 0.0] * 3
    return np.concatenate([np.linspace(a, b, 60)[:-1] for a, b in itertools.pairwise(ends)])


def test_softening_with_the_largest_stroke_is_found_and_is_no_hysteresis() -> None:
    """Mullins effect (Ogden and Roxburgh 1999): a stiffness that falls with the distance to the largest stretch so far."""
    u = _growing_from_rest()
    elements = 5 * u - plays(u, np.array([0.03, 0.1, 0.2, 0.4, 0.8]))
    softer = 1 - 0.35 * np.tanh(3 * (np.maximum.accumulate(u) - u))
    rubber = hf.Record(u, softer * u + 0.2 * (2 * u - plays(u, np.array([0.03, 0.1]))) + 0.002 * NOISE[: u.size])
    report = examined(rubber)
    assert has(report.findings, Code.DEGRADING)
    assert summarize(rubber).softens_with_stroke
    assert has(hf.fit("prandtl-ishlinskii-stop", rubber).notes, Code.MODEL_MISMATCH)
    for y in (elements, plays(u, np.array([0.03, 0.1, 0.2, 0.4])), -elements, u**3 + elements):
        found = summarize(hf.Record(u, y + 0.002 * NOISE[: u.size]))
        assert found.softening_left == pytest.approx(1.0, abs=0.05)
        assert not found.degrading


def test_a_loop_after_first_magnetization_has_a_shape() -> None:
    """From zero to saturation, then once around: the outer loop closes, and the first curve is none of its branches."""
    u = np.concatenate([np.linspace(0, 5, 60), np.linspace(5, -5, 120)[1:], np.linspace(-5, 5, 120)[1:]])
    found = summarize(hf.Record(u, plays(u, np.array([0.5, 1.5, 3.0]))))
    assert found.motion.closed_loops == 2
    assert found.shape is not None
    assert found.shape.circulation == "counter-clockwise"
    assert found.shape.closure_percent == pytest.approx(0.0, abs=0.5)


def test_the_first_curve_of_decaying_loops_is_no_loop_that_fails_to_close() -> None:
    u = sweep(1200, 6)
    assert not has(examined(hf.Record(u, plays(u, np.array([0.5, 1.5, 3.0])))).findings, Code.NOT_CLOSED)


def test_rounding_noise_of_counts_is_seen_under_motion() -> None:
    counts = np.round(127 + 120 * np.sin(0.03 * np.arange(1000)) + 0.4 * NOISE[:1000])
    assert summarize(hf.Record(np.arange(1000.0), counts)).y.noise_rms == pytest.approx(0.4, abs=0.2)


def test_a_lag_at_rising_frequency_is_no_damage() -> None:
    t = np.arange(0, 16, 0.004)
    u = 4 * np.sin(2 * np.pi * 0.2 * 16 / np.log(50) * (50 ** (t / 16) - 1))
    still = plays(u, np.array([0.2, 1.0, 2.0]))
    y = [0.0]
    for value in still[1:]:
        y.append(y[-1] + (value - y[-1]) * (1 - np.exp(-0.004 / 0.02)))
    record = hf.Record(u, np.array(y) + 0.01 * NOISE[: t.size], t=t)
    assert not has(examined(record).findings, Code.DEGRADING)


def test_a_butterfly_is_neither_single_valued_nor_damaged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: ("preisach", "preisach-signed"))
    u = 5 * np.sin(2 * np.pi * np.arange(200) / 100)
    y = plays(u, np.array([0.5, 1.5, 3.0])) ** 2 + 0.1 * NOISE[:200]
    found = hf.check(hf.Record(u, y))
    assert has(found.findings, Code.CROSSING)
    assert not has(found.findings, Code.SINGLE_VALUED)
    assert not has(found.findings, Code.DEGRADING)
    assert found.advice is not None
    assert found.advice.model.startswith("preisach-signed")


def test_a_hysteresis_of_a_thousandth_is_seen_above_less_noise() -> None:
    u = np.concatenate([np.linspace(0, 600, 61), np.linspace(590, 0, 60)])
    y = 0.04 * u
    y[61:] += 0.05 * np.sin(np.pi * u[61:] / 600)
    noisy = hf.Record(u, y + 0.003 * NOISE[:121])
    assert not has(examined(noisy).findings, Code.SINGLE_VALUED)
    assert has(examined(hf.Record(u, 0.04 * u + 0.003 * NOISE[:121])).findings, Code.SINGLE_VALUED)


def test_check_advises_for_a_loop_as_faint_as_the_noise() -> None:
    """A fit describes it with white residuals; the error on held-out samples tells it from a curve."""
    u = 5 * np.sin(np.linspace(0, 4 * np.pi, 100))
    p = play_positions(u, np.array([1.0]))[:, 0]
    report = hf.check(hf.Record(u, u + 0.02 * (p - 0.8 * u) + 0.015 * NOISE[:100]))
    assert report.advice is not None
    assert not has(report.findings, Code.SINGLE_VALUED)


def test_an_input_that_is_switched_is_named_and_has_no_crossings() -> None:
    """The heater of a thermostat: noise crosses the middle at one value of the input."""
    way = np.arange(240) // 40 % 2
    y = np.convolve(way, np.exp(-np.arange(240) / 30) / 30)[:240] + 0.005 * NOISE[:240]
    record = hf.Record(1500.0 * way, y, t=60.0 * np.arange(240), u_unit="W", y_unit="degC")
    assert "exchange" in next(note.text for note in examined(record).findings if note.code is Code.MINOR_LOOPS)
    assert all(np.isfinite(value.value) for values in hf.quantities(record).rows.values() for value in values)


@pytest.mark.parametrize("wanders", [True, False])
def test_a_load_that_was_controlled_drives(wanders: bool) -> None:
    """Ratcheting under a load of one amplitude; a displacement of one amplitude that wanders loads to levels that wander as well."""
    t = np.arange(1200) / 20
    load = 40 * np.sin(np.pi * t)
    strain = load / 300 + 0.05 * play_positions(load / 40, np.array([0.2]))[:, 0] + 0.01 * t * wanders
    found = examined(hf.Record(strain, load + 0.1 * NOISE[:1200], t=t)).findings
    assert has(found, Code.COLUMN_CHOICE) == wanders
    assert not has(found, Code.DYNAMICS)  # no resonance at two periods of the record
    wandering = examined(
        hf.Record(load + 2 * t, 30 * (load + 2 * t) + play_positions(load + 2 * t, np.array([9.0]))[:, 0], t=t)
    )
    assert not has(wandering.findings, Code.COLUMN_CHOICE)


def test_displacements_that_grow_alike_to_both_sides_were_controlled() -> None:
    """A concrete column: two cycles to each drift, whose force is limited by its strength."""
    levels = np.repeat([10.3, 22.1, 34.4, 46.5, 60.3], 2)
    ends = np.ravel(np.column_stack([levels, -levels])) + 0.03 * NOISE[:20]
    part = np.linspace(0, 1, 20, endpoint=False)
    u = np.concatenate([a + (b - a) * part for a, b in itertools.pairwise([0.0, *ends])])
    strength = np.sign(ends) * (70 + NOISE[20:40])
    y = np.concatenate([a + (b - a) * part**1.3 for a, b in itertools.pairwise([0.0, *strength])])
    assert not summarize(hf.Record(u, y)).output_controlled


def test_points_sorted_along_the_input_are_no_loop() -> None:
    """A digitizing program gives the points of nested loops from left to right, roughly."""
    u = sweep(400, 6)
    y = 5 * u - plays(u, np.array([0.3, 1.0, 2.5, 5.0]))
    order = np.argsort(u + 0.08 * NOISE[:400])
    record = hf.Record(u[order], y[order])
    assert has(examined(record).findings, Code.NO_LOOP)
    assert hf.fit("prandtl-ishlinskii-stop:plays=8", record).status is Status.NO_LOOP


def test_curves_from_one_input_are_of_no_family() -> None:
    """Tensile tests of three specimens: each reversal curve must begin at its own reversal."""
    u = np.linspace(0.0, 1.0, 40)
    tests = [hf.Record(u, size * np.sin(1.4 * u), name=f"specimen {size}") for size in (1.0, 1.3, 1.9)]
    result = hf.fit("auto", hf.Dataset(tests))
    assert result.status is Status.NO_LOOP
    assert not result.model.from_saturation
    with pytest.raises(DataError, match="begin at the same input"):
        reversal_curves(tests)


def test_what_no_sample_tests_is_no_answer() -> None:
    """A table of four objects is described by any model of more parameters."""
    record = hf.Record(np.array([33.3, 36.7, 100.2, 25.7]), np.array([210.0, 184.0, 55.0, 310.0]))
    result = hf.fit("preisach:n=2", record)
    assert result.status is Status.UNDETERMINED
    assert not any("oercivity" in name for name, _ in result.answer)


def test_the_advice_is_a_model_that_the_samples_determine(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sensor calibration of 11 points up and 11 down, and 22 weights of the model for longer records."""
    kinds = ("preisach", "preisach-magnetic", "preisach-signed", "bouc-wen")
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: kinds)
    u = np.concatenate([np.arange(0, 101, 10.0), np.arange(100, -1, -10.0)])
    y = u + np.where(np.arange(22) > 10, 2.5 * np.sin(np.pi * u / 100), 0.0)
    report = hf.check(hf.Record(u, y + 0.1 * NOISE[:22]))
    assert report.advice is not None
    name = report.advice.model.partition(":")[0]
    assert judged_as(name) is None or report.verdict(judged_as(name) or "").verdict != "no"


@pytest.mark.usefixtures("few_families")
def test_check_says_each_reason_once() -> None:
    u = sweep(400, 4)
    text = hf.check(hf.Record(u, 6 * u - plays(u, np.array([0.3, 1.0, 2.5])))).text()
    assert text.count("the model describes loops that lag") == 1


@pytest.mark.parametrize(
    ("header", "time", "columns"),
    [
        ("s,Input/V,Output/um", "s", (1, 2)),
        ("ms,Input/V,Output/um", "ms", (1, 2)),
        ("t_s,ch_a,ch_b", "s", (1, 2)),
        ("time,Channel B,Channel D", "s", (1, 2)),
    ],
)
def test_columns_named_by_a_unit_of_time_or_a_channel(
    header: str, time: str, columns: tuple[int, int], tmp_path: Path
) -> None:
    u = sweep(60, 2)
    table = np.column_stack([0.5 * np.arange(60), u, plays(u, np.array([0.3, 1.0]))])
    path = tmp_path / "loop.csv"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.6f")
    record = hf.read_csv(path)
    assert record.t is not None
    assert record.t_unit == time
    np.testing.assert_allclose(record.u, table[:, columns[0]], atol=1e-6)
    np.testing.assert_allclose(record.y, table[:, columns[1]], atol=1e-6)


def test_clipped_samples_are_named_by_a_fit() -> None:
    u = sweep(300, 3)
    whole = plays(u, np.array([0.3, 1.0, 2.5])) + 0.02 * NOISE[:300]
    result = hf.fit("prandtl-ishlinskii:plays=8", hf.Record(u, np.minimum(whole, 12.0)))
    assert has(result.notes, Code.CLIPPED)
    assert result.status is Status.OK
    assert not result.data[0].used[whole >= 12.0].any()
    assert result.data[0].used[whole < 12.0].all()
    assert np.abs(result.predict(result.data[0]) - whole).max() < 0.15 * np.ptp(whole)


def test_backlash_and_a_device_in_saturation_are_not_clipped() -> None:
    u = 5 * np.sin(np.linspace(0, 6 * np.pi, 400))
    assert not clipped_samples(u, plays(u, np.array([1.0]))).any()
    assert not saturated_samples(u, np.round(np.tanh(u), 3)).any()
    assert not saturated_samples(u, np.clip(plays(u, np.array([1.0])), -0.5, 0.5)).any()


def test_a_plateau_without_noise_is_the_device() -> None:
    """Drop on a surface: the contact angle advances at 110 deg, recedes at 40 deg, and is pinned between them."""
    volume = np.concatenate([np.linspace(5, 15, 61), np.linspace(15, 5, 61)[1:]])
    angle = np.empty_like(volume)
    angle[0] = 60.0
    for k in range(1, volume.size):
        angle[k] = np.clip(angle[k - 1] + 8.0 * (volume[k] - volume[k - 1]), 40.0, 110.0)
    angle = np.round(angle, 3)
    assert clipped_samples(volume, angle).any()
    assert not saturated_samples(volume, angle).any()
    noisy = np.minimum(angle + 0.05 * NOISE[: angle.size], 100.0)
    assert saturated_samples(volume, noisy).sum() == np.count_nonzero(noisy == 100.0)


@pytest.mark.usefixtures("as_users_run")
def test_swapped_arguments_are_named() -> None:
    with pytest.raises(ParameterError, match="the model comes first"):
        hf.fit({"u": FALLING_INPUT, "y": FALLING}, "bouc-wen")  # type: ignore[arg-type]


def test_coarse_sampling_of_a_yielding_element_is_named_where_it_costs_accuracy() -> None:
    """Beside 400 substeps a sample: no advice where the error is small, and the advised substeps make it small."""
    u = np.sin(np.linspace(0, 6 * np.pi, 90))
    error = lambda model, exact: float(np.ptp(hf.simulate(model, u)[0] - exact))
    model = hf.BoucWenForce(kappa_x=0.0, kappa_w=1.0, rho=20.0, sigma=0.8, n=3.0)
    exact = np.asarray(hf.simulate(dataclasses.replace(model, substeps=400), u)[0])
    (advice,) = model.advice(u)
    fine = dataclasses.replace(model, substeps=int(advice.split("substeps=")[1].split(";")[0]))
    assert fine.advice(u) == ()
    assert error(model, exact) > 0.02
    assert error(fine, exact) < 0.004


def test_a_spring_that_dissipates_nothing_shows_no_hysteresis() -> None:
    """r_load = -r_unl is a nonlinear spring without loss; with both positive the loop of z dissipates."""
    force = np.concatenate([0.5 * NOISE[:200], np.zeros(200)])
    dt = np.full(400, 0.1)
    model = hf.BoucWenOscillator(c=0.3, r_load=0.4, r_unl=-0.4, between="linear")
    assert model.hysteretic_share(force, dt) == pytest.approx(0.0, abs=0.02)
    lossy = dataclasses.replace(model, r_load=np.asarray(2.0), r_unl=np.asarray(2.0))
    assert (lossy.hysteretic_share(force, dt) or 0.0) > 0.1


def test_a_batch_takes_data_sets_by_name() -> None:
    (source,) = sources_of(["stage-sweep"])
    assert source.record is not None
    assert source.name == "stage-sweep"


def test_options_that_resemble_none_are_answered_by_those_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sample", "fit", "--quick"]) == 2
    assert "--draws, --chains" in capsys.readouterr().err
    assert run(["sample", "fit", "--drawz", "3"]) == 2
    assert "--draws?" in capsys.readouterr().err


def test_ratios_of_errors_ignore_directions_that_the_data_leave_open() -> None:
    """A column twice: rounding decides the share of each, and must not decide the ratio of errors under noise twice as large."""
    columns = NOISE[:300].reshape(100, 3)
    both = np.column_stack([columns, columns[:, :1]])
    assert mean_error_ratio(both / 2.0, both * (1 + 1e-16 * NOISE[300:700].reshape(100, 4)), 1.0) == pytest.approx(
        2.0, rel=1e-6
    )


@pytest.mark.parametrize("names", ["pressure_kPa,reading_up_kPa,reading_down_kPa", "T (C),loading R,unloading R"])
def test_a_table_of_a_rising_and_a_falling_branch_is_one_loop(tmp_path: Path, names: str) -> None:
    """Input, output on the way up, output on the way down, as on a sheet of a calibration."""
    u = np.linspace(0.0, 10.0, 21)
    path = tmp_path / "calibration.csv"
    np.savetxt(path, np.column_stack([u, u**2, u**2 + u]), delimiter=",", header=names, comments="")
    record = hf.read_csv(path)
    assert isinstance(record, hf.Record)
    np.testing.assert_allclose(record.u, [*u, *u[::-1]])
    np.testing.assert_allclose(record.y, [*u**2, *(u**2 + u)[::-1]])
    assert has(record.notes, Code.CURVES)


def _branch(down: bool) -> list[str]:
    u = np.linspace(-100, 100, 60)[:: -1 if down else 1]
    return [f"{x:.3f} {np.tanh((x + (12 if down else -12)) / 30):.6f}" for x in u]


def test_branches_between_blank_lines_are_one_loop(tmp_path: Path) -> None:
    header, falling, rising = "Field(Oe)  Moment(emu)", _branch(down=True), _branch(down=False)
    (tmp_path / "loop.txt").write_text("\n".join([header, *falling, "", *rising]))
    loop = hf.read(tmp_path / "loop.txt")
    assert isinstance(loop, hf.Record)
    assert len(loop) == 120
    assert not has(examined(loop).findings, Code.NO_LOOP)
    # Branches that run the same way, as reversal curves do, remain curves; and so do those of loops that lie apart.
    (tmp_path / "curves.txt").write_text("\n".join([header, *rising, "", *rising]))
    assert isinstance(hf.read(tmp_path / "curves.txt"), hf.Dataset)
    elsewhere = [line.replace(" ", " 1") for line in rising]
    (tmp_path / "apart.txt").write_text("\n".join([header, *falling, "", *elsewhere]))
    assert isinstance(hf.read(tmp_path / "apart.txt"), hf.Dataset)


@pytest.mark.parametrize("names", ["H1 (A/m),B1 (T),H2 (A/m),B2 (T)", "H (A/m),B (T),H (A/m),B (T)"])
def test_loops_side_by_side_are_curves(tmp_path: Path, names: str) -> None:
    angles = np.linspace(0, 2 * np.pi, 40)
    small, large = (np.stack([size * np.cos(angles), size * np.sin(angles + 0.4)]) for size in (1.0, 3.0))
    rows = [",".join(f"{x:.5f}" for x in row) for row in np.concatenate([small, large]).T]
    rows += [",".join(["", "", *row.split(",")[2:]]) for row in rows[-3:]]
    (tmp_path / "loops.csv").write_text("\n".join([names, *rows]))
    data = hf.read(tmp_path / "loops.csv")
    assert isinstance(data, hf.Dataset)
    assert [len(loop) for loop in data] == [40, 43]
    np.testing.assert_allclose(data[1].u[:40], large[0], atol=1e-5)
    assert (data[1].u_unit, data[1].y_unit) == ("A/m", "T")
    # Channels beside a time are not loops of their own.
    timed = [f"{k},{row}" for k, row in enumerate(rows[:40])]
    (tmp_path / "channels.csv").write_text("\n".join([f"t_s,{names}", *timed]))
    assert isinstance(hf.read(tmp_path / "channels.csv"), hf.Record)


def test_columns_without_names_come_with_the_options_that_swap_them(tmp_path: Path) -> None:
    rows = [f"{np.cos(k / 5):.4f} {np.sin(k / 5):.4f}" for k in range(60)]
    (tmp_path / "loop.dat").write_text("\n".join(rows))
    swaps = lambda record: [note for note in record.notes if "input='1' and output='0'" in note.text]
    assert swaps(hf.read(tmp_path / "loop.dat"))
    assert not swaps(hf.read(tmp_path / "loop.dat", input=0))
    (tmp_path / "named.dat").write_text("\n".join(["a b", *rows]))
    assert not swaps(hf.read(tmp_path / "named.dat"))


def test_the_column_that_separates_curves_in_time_names_them(tmp_path: Path) -> None:
    rows = [f"{run},{time},{np.sin(time)},{np.cos(time)}" for run in "ab" for time in range(20)]
    (tmp_path / "runs.csv").write_text("\n".join(["bench,t_s,u_V,y_um", *rows]))
    data = hf.read(tmp_path / "runs.csv")
    assert [record.name for record in data] == ["bench=a", "bench=b"]
    assert [record.name for record in hf.read(tmp_path / "runs.csv", by="bench")] == ["bench=a", "bench=b"]
    assert not any("not used" in note.text for note in data[0].notes)
    assert any("column 'bench'" in note.text for note in data[0].notes)


def test_a_switch_is_neither_clipped_nor_damaged() -> None:
    t = np.arange(0, 3600, 10.0)
    temperature = 20 + 2.5 * np.sin(2 * np.pi * t / 600) + 0.7 * np.sin(2 * np.pi * t / 171)
    on, states = 1.0, []
    for now in temperature:
        on = 0.0 if now > 21 else 1.0 if now < 19 else on
        states.append(on)
    record = hf.Record(temperature, np.array(states), t)
    report = hf.check(record)
    assert not has(report.findings, Code.CLIPPED, Code.DEGRADING)
    assert report.advice is not None
    assert report.advice.model == "relay"
    result = hf.fit(report.advice.model, record)
    assert result.train.rmse < 1e-12
    for name, true in (("up", 21.0), ("down", 19.0)):
        threshold = next(one for one in result.parameters if one.name == name)
        assert threshold.stderr is not None
        assert abs(threshold.value - true) < 2 * threshold.stderr < 0.2


def test_parquet_files_are_read_as_others_are(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    t = np.arange(50) / 10
    path = tmp_path / "loop.parquet"
    pandas.DataFrame({"t_s": t, "u_V": np.sin(t), "x_um": np.sin(t - 0.2)}).to_parquet(path, engine="pyarrow")
    record = hf.read(path)
    assert isinstance(record, hf.Record)
    np.testing.assert_array_equal(record.u, np.sin(t))
    assert (record.u_unit, record.y_unit) == ("V", "um")


@pytest.mark.parametrize("long", [True, False], ids=["a sample a row", "a loop a row"])
def test_parquet_tables_of_many_loops(tmp_path: Path, long: bool) -> None:
    pandas = pytest.importorskip("pandas")
    path, loops = tmp_path / "loops.parquet", []
    for k, name in enumerate(("b", "a", "c")):
        t = np.arange(50 + k) / 10
        loops.append({"specimen": name, "T_K": 300 + k, "t_s": t, "u_V": np.sin(t), "x_um": np.sin(t - 0.1 * k)})
    table = pandas.concat(map(pandas.DataFrame, loops)) if long else pandas.DataFrame(loops)
    table.to_parquet(path, engine="pyarrow")
    data = hf.read(path, by="specimen") if long else hf.read(path)
    assert [record.name for record in data] == (["specimen=b", "specimen=a", "specimen=c"] if long else ["b", "a", "c"])
    for record, loop in zip(data, loops, strict=True):
        np.testing.assert_array_equal(record.y, loop["x_um"])
        np.testing.assert_array_equal(record.t, loop["t_s"])


def test_lists_of_unequal_lengths_in_a_parquet_row_are_refused(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    rows = [{"u_V": np.arange(5.0), "x_um": np.arange(4.0)}]
    pandas.DataFrame(rows).to_parquet(tmp_path / "loops.parquet", engine="pyarrow")
    with pytest.raises(hf.HystfitError, match="'u_V' and 'x_um' differ in length"):
        hf.read(tmp_path / "loops.parquet")


@pytest.mark.parametrize(
    ("header", "driven"), [("I (A),U (V)", 0), ("I (A),U (V)", 1), ("U_V,I_mA", 0), ("U_V,I_mA", 1)]
)
def test_of_a_voltage_and_a_current_the_plainer_wave_is_the_input(tmp_path: Path, header: str, driven: int) -> None:
    phase = np.linspace(0, 6 * np.pi, 300)
    drive, answer = np.sin(phase), np.tanh(4 * np.sin(phase - 0.4))
    path = tmp_path / "device.csv"
    np.savetxt(path, np.column_stack([drive, answer][:: 1 - 2 * driven]), delimiter=",", header=header, comments="")
    record = hf.read_csv(path)
    assert isinstance(record, hf.Record)
    np.testing.assert_allclose(record.u, drive)


def test_of_a_voltage_and_a_current_of_equal_waves_the_user_chooses(tmp_path: Path) -> None:
    phase = np.linspace(0, 6 * np.pi, 300)
    path = tmp_path / "device.csv"
    np.savetxt(
        path, np.column_stack([np.sin(phase), np.sin(phase - 0.4)]), delimiter=",", header="I (A),U (V)", comments=""
    )
    with pytest.raises(hf.HystfitError, match="--input 'I"):
        hf.read_csv(path)


@pytest.mark.parametrize(
    "header", ["time_s,T_C,strain_pct", "t_ms,DAC_counts,LVDT_counts", "time_s,heater_pct,temp_C", "t_s,pwm,ADC_counts"]
)
def test_drives_of_heaters_counts_and_degrees_are_inputs(tmp_path: Path, header: str) -> None:
    t = np.arange(100.0)
    path = tmp_path / "device.csv"
    np.savetxt(path, np.column_stack([t, np.sin(t), np.sin(t - 0.3)]), delimiter=",", header=header, comments="")
    record = hf.read_csv(path)
    assert isinstance(record, hf.Record)
    np.testing.assert_array_equal(record.u, np.sin(t))


def test_isolated_outliers_are_left_out_of_fits_and_named() -> None:
    """Glitches of a fiftieth of the samples: the weights of the clean record, and an error that is its noise."""
    u = sweep(1000, 5)
    clean = 2 * u + plays(u, np.array([1.0, 3.0])) + 0.02 * NOISE[:1000]
    y = clean.copy()
    glitches = np.arange(25, 1000, 50)
    y[glitches] += np.where(glitches % 100 > 50, 14.0, -9.0)
    model = make_model("prandtl-ishlinskii:plays=10")
    fit, of_clean = hf.fit(model, hf.Record(u, y)), hf.fit(model, hf.Record(u, clean))
    assert has(fit.notes, Code.SPIKES)
    assert not has(of_clean.notes, Code.SPIKES)
    assert fit.train.rmse == pytest.approx(of_clean.train.rmse, rel=0.05)
    assert fit.train.n == 980
    kept = hf.fit("bouc-wen", hf.Record(u, y), loss="huber")
    assert not has(kept.notes, Code.SPIKES)
    assert kept.train.n == 1000
    # Noise whose tails are heavy has its own likelihood; so many glitches, and the peaks of fast waves, belong to the signal.
    assert hf.fit("bouc-wen", hf.Record(u, y), noise="student-t").train.n == 1000
    assert summarize(hf.Record(u, clean + 8 * (NOISE[:1000] > 1.5))).spikes == 0
    t = np.arange(600) / 9
    fast = hf.Record(np.sin(2 * np.pi * t), np.cos(2 * np.pi * t) + 0.001 * NOISE[:600], t)
    assert summarize(fast).spikes == 0
    ringing = np.sin(2 * np.pi * t / 25) + 0.3 * np.exp(-((t - 20) ** 2)) * np.sin(2 * np.pi * 9 * t / 4.3)
    assert summarize(hf.Record(np.sin(2 * np.pi * t / 25), ringing + 0.001 * NOISE[:600], t)).spikes == 0


def test_a_drift_over_three_cycles_without_time_is_named() -> None:
    """Kerr rotation of a film in three sweeps, whose zero moves by a tenth of the range."""
    edge = np.linspace(-150, 150, 151)
    u = np.append(np.tile(np.concatenate([edge[:-1], edge[:0:-1]]), 3), -150)
    steady = 1.3 * np.tanh((u - 28 * np.sign(np.gradient(u))) / 6) + 0.05 * NOISE[: u.size]
    fitted = lambda y: hf.fit("preisach-magnetic:n=20", hf.Record(u, y)).notes
    (note,) = (n for n in fitted(steady + 0.26 * np.arange(u.size) / u.size) if n.code is Code.DRIFT)
    (change,) = re.findall(r"drifts by (\S+)", note.text)
    assert float(change) == pytest.approx(0.26, rel=0.15)
    assert not has(fitted(steady), Code.DRIFT)


def test_a_drift_that_creep_of_the_model_follows_is_named() -> None:
    t = np.arange(0, 12, 0.04)
    u = 50 - 50 * np.cos(np.pi * t)
    steady = 0.1 * u + plays(u, np.linspace(3, 20, 4)) * 0.015 + 0.01 * NOISE[: t.size]
    fitted = lambda y: hf.fit("prandtl-ishlinskii:plays=6+creep", hf.Record(u, y, t)).notes
    assert has(fitted(steady + 0.01 * np.ptp(steady) * t / 12), Code.DRIFT)
    assert not has(fitted(steady), Code.DRIFT)
