"""A single relay against a plain loop: its thresholds with their errors, records of all kinds, and the choice between models."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.data.dataset import Dataset
from hystfit.errors import ModelError
from hystfit.models.registry import make_model
from hystfit.models.switching import Thresholds, relay_state
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has

T = np.arange(0, 3600, 10.0)
TEMPERATURE = 20 + 2.5 * np.sin(2 * np.pi * T / 600) + 0.7 * np.sin(2 * np.pi * T / 171)
NOISE = np.random.default_rng(7).normal(size=T.size)


def switched(u: np.ndarray, up: float, down: float, on: bool = False) -> np.ndarray:
    """State of a relay, by a plain loop."""
    out = []
    for value in u:
        on = True if value > up else False if value < down else on
        out.append(float(on))
    return np.array(out)


TRIGGER = hf.Record(TEMPERATURE, 0.2 + 5.0 * switched(TEMPERATURE, 21.0, 18.5), T)
NOISY = hf.Record(TEMPERATURE, TRIGGER.y + 0.1 * NOISE, T)  # 2 % of the jump


def estimate(result: hf.FitResult, name: str) -> tuple[float, float]:
    """Value and standard error of a parameter."""
    one = next(one for one in result.parameters if one.name == name)
    assert one.stderr is not None
    return one.value, one.stderr


@pytest.mark.parametrize("start", [20.4, 19.2, 17.0])
def test_the_model_is_that_of_a_plain_loop(start: float) -> None:
    u = np.append(start, TEMPERATURE)
    expected = 3.0 - 2.0 * switched(u, 20.9, 19.1, on=start > 20.0)
    model = hf.Relay(up=20.9, down=19.1, low=3.0, high=1.0)
    np.testing.assert_array_equal(np.asarray(hf.simulate(model, u)[0]), expected)
    np.testing.assert_array_equal(model.free_run(u), expected)
    np.testing.assert_array_equal(relay_state(u, 20.9, 19.1), expected == 1.0)


def test_thresholds_in_the_wrong_order_and_an_inverse_are_refused() -> None:
    with pytest.raises(ModelError, match="up must not be below down"):
        hf.Relay(up=1.0, down=2.0)
    with pytest.raises(ModelError, match="two levels"):
        hf.Relay().step_inverse()


@pytest.mark.parametrize("name", ["relay", "negate+relay"])
def test_a_record_without_noise_is_fitted_exactly(name: str) -> None:
    result = hf.fit(name, TRIGGER)
    assert result.status is Status.OK
    assert result.train.rmse < 1e-12
    up, down = (21.0, 18.5) if name == "relay" else (-18.5, -21.0)
    for threshold, true in (("up", up), ("down", down)):
        value, error = estimate(result, threshold)
        assert abs(value - true) < 2 * error < 0.25
    levels = [estimate(result, level)[0] for level in ("low", "high")]
    np.testing.assert_allclose(sorted(levels), [0.2, 5.2], rtol=1e-12)
    half = next(one for one in result.quantities if one.name == "coercive_input")
    assert half.stderr is not None
    assert half.value == pytest.approx(1.25, abs=2 * half.stderr)
    assert half.stderr == pytest.approx(0.5 * np.hypot(estimate(result, "up")[1], estimate(result, "down")[1]), rel=0.3)
    assert not has(result.notes, Code.NO_INFLUENCE, Code.NOT_DETERMINED)


def test_the_search_finds_the_smallest_error_of_all_pairs_of_thresholds() -> None:
    u = np.round(TEMPERATURE[:200], 1)  # of few values, so that all pairs can be tried
    y = switched(u + 0.3 * NOISE[:200], 20.8, 19.4) + 0.4 * NOISE[100:300]
    record = hf.Record(u, y)
    places = 0.5 * (np.unique(u)[1:] + np.unique(u)[:-1])
    least = np.inf
    for up in places:
        for down in places[places <= up]:
            state = switched(u, up, down, on=u[0] > 0.5 * (up + down)) > 0
            if 0 < state.sum() < state.size:
                least = min(least, sum(np.sum((part - part.mean()) ** 2) for part in (y[state], y[~state])))
    found = Thresholds.of([record])
    state = relay_state(u, found.up, found.down)
    assert np.sum((y - np.where(state, found.high, found.low)) ** 2) == pytest.approx(least, rel=1e-9)


def _coverage(interval: float, scatter: float, in_sensor: bool, seeds: int) -> float:
    """Part of the thresholds of simulated devices that lie within two standard errors."""
    inside = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        t = np.arange(0, 7200, interval)
        phase = rng.uniform(0, 2 * np.pi, 2)
        u = 2.2 * np.sin(2 * np.pi * t / 600 + phase[0]) + 0.9 * np.sin(2 * np.pi * t / 171 + phase[1])
        up, down = rng.uniform(0.3, 1.5), -rng.uniform(0.3, 1.5)
        on, states = False, []
        late_up, late_down = np.where(in_sensor, 0.0, scatter) * rng.normal(size=(2, t.size))
        for value, more_up, more_down in zip(u, late_up, late_down, strict=True):
            on = value > up + more_up if not on else value >= down + more_down
            states.append(float(on))
        seen = u + np.where(in_sensor, scatter, 0.0) * rng.normal(size=t.size)
        record = hf.Relay().prepared(hf.Record(seen, np.array(states) + 0.02 * rng.normal(size=t.size), t))
        found = Thresholds.of([record])
        errors = found.errors([record])
        inside += [abs(found.up - up) < 2 * errors[0], abs(found.down - down) < 2 * errors[1]]
    return float(np.mean(inside))


QUICK = ((2.0, 0.0), (2.0, 0.1), (10.0, 0.02), (40.0, 0.1))  # the others take as long each


@pytest.mark.parametrize(
    ("interval", "scatter"),
    [
        pair if pair in QUICK else pytest.param(*pair, marks=pytest.mark.slow)
        for pair in itertools.product((2.0, 10.0, 40.0), (0.0, 0.02, 0.1, 0.3))
    ],
)
def test_two_standard_errors_hold_the_thresholds(interval: float, scatter: float) -> None:
    assert (
        _coverage(interval, scatter, in_sensor=True, seeds=30) >= 0.93
    )  # of 95 %, 60 thresholds miss 7 % with less than 1 in 5


def test_errors_are_no_larger_than_the_samples_are_apart() -> None:
    record = hf.Relay().prepared(TRIGGER)
    error = max(Thresholds.of([record]).errors([record]))
    assert error < 0.5 * np.abs(np.diff(TEMPERATURE)).max()


@pytest.mark.parametrize("on", [True, False])
def test_a_record_that_starts_between_the_thresholds_starts_in_the_state_of_its_output(on: bool) -> None:
    u = TEMPERATURE[(TEMPERATURE > 19) & (TEMPERATURE < 20)][:1]
    u = np.concatenate([u, TEMPERATURE])
    for sign in (1.0, -1.0):
        record = hf.Record(u, sign * switched(u, 21.0, 18.5, on=on))
        for name in ("relay", "negate+relay"):
            result = hf.fit(name, record)
            assert result.train.rmse < 1e-12
            np.testing.assert_allclose(result.predict(record), record.y, atol=1e-12)


def test_several_records_share_thresholds_and_levels() -> None:
    parts = [TRIGGER.segment(0, 90), TRIGGER.segment(95, 180), TRIGGER.segment(185, 300)]
    records = [part.replace(name=str(k)) for k, part in enumerate(parts)]
    result = hf.fit("relay", records)
    assert result.train.rmse < 1e-12
    assert len(result.problem.space) == 4
    assert abs(estimate(result, "up")[0] - 21.0) < 2 * estimate(result, "up")[1]


def test_samples_without_an_output_leave_the_thresholds_between_the_others() -> None:
    missing = np.random.default_rng(1).uniform(size=T.size) < 0.4
    record = TRIGGER.replace(y=np.where(missing, np.nan, TRIGGER.y))
    result = hf.fit("relay", record)
    assert result.train.rmse < 1e-12
    for name, true in (("up", 21.0), ("down", 18.5)):
        value, error = estimate(result, name)
        assert abs(value - true) < 2 * error
        assert error >= 0.8 * estimate(hf.fit("relay", TRIGGER), name)[1]


def test_a_threshold_that_the_output_never_passes_has_no_error() -> None:
    u = np.concatenate([np.linspace(0, 1, 40), np.linspace(1, 0.4, 30), np.linspace(0.4, 0.9, 30)])
    result = hf.fit("relay", hf.Record(u, switched(u, 0.71, 0.2)))
    assert abs(estimate(result, "up")[0] - 0.71) < 0.05
    down = next(one for one in result.parameters if one.name == "down")
    assert down.stderr is None
    assert not down.identifiable


def test_levels_and_their_errors_are_means_of_the_outputs() -> None:
    result, state = hf.fit("relay", NOISY, noise="iid"), switched(TEMPERATURE, 21.0, 18.5) > 0
    for name, at in (("low", ~state), ("high", state)):
        value, error = estimate(result, name)
        assert value == pytest.approx(NOISY.y[at].mean(), rel=1e-9)
        assert error == pytest.approx(0.1 / np.sqrt(at.sum()), rel=0.15)


def test_a_robust_loss_keeps_the_thresholds_and_their_errors() -> None:
    result = hf.fit("relay", NOISY, loss="huber", starts=1)
    assert estimate(result, "up") == pytest.approx(estimate(hf.fit("relay", NOISY), "up"))


def test_other_nonlinear_parameters_are_refused() -> None:
    with pytest.raises(ModelError, match=r"tau.* is free"):
        hf.fit("lag+relay", NOISY)


def test_a_line_beside_it_is_fitted_too() -> None:
    result = hf.fit("relay+linear", TRIGGER.replace(y=TRIGGER.y + 0.3 * TEMPERATURE))
    assert result.train.rmse < 1e-10
    assert estimate(result, "k")[0] == pytest.approx(0.3)
    assert abs(estimate(result, "up")[0] - 21.0) < 2 * estimate(result, "up")[1]


@pytest.mark.parametrize("cooler", [False, True])
def test_a_controlled_room_is_as_warm_on_average_while_the_heater_is_on(cooler: bool) -> None:
    """The output drives the input, which turns back at the thresholds: the mean input at both levels tells no direction."""
    sign, room, on = (-1 if cooler else 1), 19.6, 1.0
    rooms, states = [], []
    for _ in range(1200):
        room += 0.02 * ((26 if on != cooler else 14) - room)
        on = 0.0 if sign * (room - 20) > 1 else 1.0 if sign * (room - 20) < -1 else on
        rooms.append(room)
        states.append(on)
    result = hf.fit("relay", hf.Record(np.array(rooms), np.array(states)))
    assert result.train.rmse < 1e-9
    for name, true in (("up", 21.0), ("down", 19.0)):
        value, error = estimate(result, name)
        assert abs(value - true) < 2 * error < 0.4


def test_it_is_saved_and_opened(tmp_path: Path) -> None:
    result = hf.fit("negate+relay", NOISY)
    result.save(tmp_path / "fit")
    again = hf.load_fit(tmp_path / "fit")
    np.testing.assert_array_equal(again.predict(NOISY), result.predict(NOISY))
    assert estimate(again, "up") == pytest.approx(estimate(result, "up"))


@pytest.mark.slow
@pytest.mark.parametrize("record", [TRIGGER, NOISY], ids=["exact", "2 % noise"])
def test_a_trigger_whose_output_rises_is_taken_for_a_relay(record: hf.Record) -> None:
    found = hf.compare(record)
    assert found.rows[0].name == "relay"
    assert found.rows[0].score == pytest.approx(
        100 * 0.1 / np.ptp(NOISY.y) if record is NOISY else 0.0, rel=0.2, abs=1e-5
    )


def test_branches_with_slopes_take_a_line_or_other_models() -> None:
    """A strip that snaps through: its branches bend, and are as steep together as the jump is high."""
    state = switched(TEMPERATURE, 21.0, 18.5)
    x = (TEMPERATURE - 20) / 3.2
    y = np.where(state > 0, 0.6 + 0.5 * x - 0.1 * x**3, -0.6 + 0.3 * x)
    found = hf.compare(hf.Record(TEMPERATURE, y + 0.01 * NOISE, T), ["relay", "relay+linear", "preisach"])
    assert [row.asked for row in found.rows] == ["relay+linear", "preisach", "relay"]
    assert found.rows[0].score < 0.5 * found.rows[1].score


def test_loops_that_do_not_jump_get_no_relay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: ("relay", "preisach"))
    model = make_model("prandtl-ishlinskii")
    u = (TEMPERATURE - 20) / 3.2
    found = hf.compare(hf.Record(u, model.free_run(u) + 0.01 * NOISE))
    relay = next(row for row in found.rows if row.asked == "relay")
    assert relay is not found.rows[0]
    assert relay.score_percent is None  # after the first fit


def test_the_shell_fits_a_file_of_a_thermostat(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "\n".join(
        f"{t:g},{u:.4f},{y:g}" for t, u, y in zip(T, TEMPERATURE, 1 - switched(TEMPERATURE, 21, 19), strict=True)
    )
    path = tmp_path / "thermostat.csv"
    path.write_text(f"time_s,temperature_degC,heater\n{rows}\n")
    assert run(["fit", str(path), "--model", "relay", "--out", str(tmp_path / "fit")]) == 0
    text = capsys.readouterr().out
    assert "relay" in text
    assert run(["predict", str(tmp_path / "fit"), str(path)]) == 0
    assert run(["export", str(tmp_path / "fit"), "--c", str(tmp_path / "code")]) == 0


def test_the_dataset_of_one_level_is_refused() -> None:
    with pytest.raises(hf.errors.DataError):
        hf.fit("relay", Dataset.of(hf.Record(TEMPERATURE, np.ones(T.size))))


def test_methods_that_need_derivatives_are_refused_unless_the_thresholds_are_fixed() -> None:
    for method in (hf.sample, hf.profile, hf.design, hf.standard_errors):
        with pytest.raises(ModelError, match="--fix up --fix down"):
            method(hf.fit("relay", NOISY))
    held = hf.fit("relay", NOISY, fix=["up", "down"])
    assert held.train.rmse == pytest.approx(hf.fit("relay", NOISY).train.rmse)
    high = hf.profile(held).profiles["high"]
    assert high.upper == pytest.approx(estimate(held, "high")[0] + 1.96 * estimate(held, "high")[1], rel=1e-3)


@pytest.mark.parametrize("kind", ["noise", "steps", "late", "other frequency", "comparator"])
def test_any_record_gives_finite_thresholds_in_order(kind: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        n = int(rng.integers(5, 120))
        u = np.cumsum(rng.normal(size=n))
        u = np.round(u) if kind == "steps" else u
        y = {
            "late": np.roll(u, -3),
            "other frequency": np.cos(np.arange(n) * rng.uniform(0.05, 1)),
            "comparator": (u > 0) + 0.01 * np.arange(n),
        }.get(kind, rng.normal(size=n))
        record = hf.Relay().prepared(hf.Record(u, np.where(rng.uniform(size=n) < 0.2, np.nan, y)))
        if record.used.sum() < 3:
            continue
        model = hf.Relay().start([record, record])
        errors = np.array([model.step_errors([record]).up, model.step_errors([record]).down])
        assert float(model.up) >= float(model.down)
        assert np.isfinite([model.low, model.high]).all()
        assert not (errors < 0).any()
