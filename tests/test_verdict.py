"""Statuses of fits of records whose kind is known: nothing is called usable that is not."""

import dataclasses
import shlex

import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.data.dataset import Dataset
from hystfit.fitting.judgment.fit_warnings import _repeats, disturbance_note
from hystfit.fitting.solvers.bounded import TrustRegion
from hystfit.fitting.trial import with_left_out, with_test
from hystfit.outcome import Code, Severity, Status
from hystfit.outcome.note import has
from hystfit.quality import baselines
from hystfit.quality.baselines import Baselines
from hystfit.quality.held_out import held_out
from hystfit.quality.host_operators import play_positions
from hystfit.quality.loops import clear_reversals
from hystfit.results.accuracy import Limits, persistent_error
from hystfit.results.report.answer import Wording, next_commands
from hystfit.results.report.text_report import verdict

N = 600
T = np.arange(N) / 100
GROWING = (20 + 8 * T) * np.sin(2 * np.pi * T)
TRUTH = {"c": 0.15, "mu": 0.45, "tau": 0.05, "rho": 0.6, "offset": 3.0}
RNG = np.random.default_rng(0)
WHITE = RNG.normal(size=N)


def slow_noise(time=60.0):
    a = np.exp(-1 / time)
    noise = np.zeros(N)
    for k in range(1, N):
        noise[k] = a * noise[k - 1] + np.sqrt(1 - a * a) * RNG.normal()
    return noise


def output(u=GROWING, **changes):
    return np.asarray(hf.simulate(hf.BoucWen(**(TRUTH | changes)), jnp.asarray(u))[0])


def made(y, u=GROWING, **labels):
    return hf.Record(u=u, y=y, t=T[: u.size], **labels)


SINE = 60 * np.sin(2 * np.pi * T)
HEAVY = np.sign(GROWING) * np.abs(GROWING / 60) ** 3 + 0.3 * np.sign(np.gradient(GROWING))
KINDS = {
    # name: (record, statuses allowed)
    "good model": (made(output() + 0.02 * WHITE), {Status.OK}),
    "good model, white noise of a tenth of the range": (made(output() + 1.2 * WHITE), {Status.OK}),
    "good model, slow noise": (made(output() + 0.05 * slow_noise()), {Status.OK}),
    "good model, one amplitude": (made(output(SINE) + 0.02 * WHITE, SINE), {Status.OK}),
    "wrong family: friction on a cubic": (made(HEAVY), {Status.POOR, Status.ROUGH}),
    "wrong family: pinched": (made(np.sign(GROWING) * GROWING**2 * np.sign(np.gradient(GROWING))), {Status.POOR}),
    "line and noise": (made(0.15 * GROWING + 0.05 * WHITE), {Status.NO_LOOP}),
    "line": (made(0.15 * GROWING), {Status.NO_LOOP}),
    "curve and noise": (made(np.tanh(GROWING / 40) + 0.01 * WHITE), {Status.NO_LOOP}),
    "line and slow noise": (made(0.15 * GROWING + 0.1 * slow_noise()), {Status.NO_LOOP, Status.POOR, Status.ROUGH}),
    "noise": (made(WHITE), {Status.POOR, Status.NO_LOOP}),
    "never turns back": (made(np.linspace(0, 3, N) ** 2, np.linspace(0, 3, N)), {Status.NO_LOOP}),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_the_status_is_that_of_the_kind(kind):
    record, allowed = KINDS[kind]
    fit = hf.fit("bouc-wen", record, starts=2)
    assert fit.status in allowed, [str(note) for note in fit.notes]
    assert has(fit.notes, Code.ACCURACY)
    assert has(fit.notes, Code.MINOR_LOOPS) == (kind == "good model, one amplitude")


def test_parameters_of_a_loop_have_no_influence_on_a_line():
    assert has(hf.fit("bouc-wen", KINDS["line"][0], starts=2).notes, Code.NO_INFLUENCE)


def test_a_solver_that_did_not_converge_is_named_and_the_model_is_not_blamed():
    fit = hf.fit("bouc-wen", KINDS["wrong family: pinched"][0], method=TrustRegion(max_evaluations=2), starts=1)
    assert fit.status is Status.NOT_CONVERGED
    assert [note.text.startswith("trf") for note in fit.notes if note.code is Code.SOLVER] == [True]


def test_an_erratic_output_is_no_noise_where_its_samples_follow_each_other():
    """A simulation that is unstable at its step: it jumps now and then, and between the jumps it is a line without noise."""
    u, y, state = 7.24 * (4 * np.abs(np.linspace(0, 1, 151) - 0.5) - 1), [], 0.0
    for step in np.diff(u, prepend=u[0]):
        state += step / 0.05 * (1 - (0.5 * np.sign(step * state) + 0.5) * abs(state) ** 1.5)
        y.append(state)
    record = hf.Record(u=u + 0.002 * WHITE[:151], y=np.array(y) + 0.003 * WHITE[-151:])
    fit = hf.fit("preisach-magnetic:degree=1", record)
    assert fit.baselines.noise < 0.01 * fit.train.rmse
    assert fit.status is Status.POOR


def test_as_many_parameters_as_samples_are_never_usable():
    few = made(output()[:300:60] + 0.02 * WHITE[:5], GROWING[:300:60])
    fit = hf.fit("bouc-wen", few, starts=1)
    assert fit.status is Status.UNDETERMINED
    assert has(verdict(fit), Code.NOT_DETERMINED)  # the reason, and no word that nothing is undetermined
    assert "Not determined" not in dict(fit.answer)
    u = np.array([0.0, 1.0, 0.2])
    assert hf.fit("preisach:n=6", hf.Record(u=u, y=u + 0.1 * u**2)).status is Status.UNDETERMINED


def test_records_that_were_not_fitted_decide_too():
    fit = hf.fit("bouc-wen", made(output() + 0.02 * WHITE), starts=2)
    tried = {gain: with_test(fit, made(gain * (output() - 3.0) + 3.0, name="other")) for gain in (1.0, 1.2, 2.5)}
    assert [tried[gain].status for gain in tried] == [Status.OK, Status.ROUGH, Status.POOR]
    assert 3 < tried[1.2].test.nrmse_percent < 9.9
    assert [has(tried[gain].notes, Code.TEST_ERROR) for gain in tried] == [False, True, True]
    stored = tried[1.2].to_dict()["verdict"]["test"]
    assert stored["error_over"]["noise"] is None or stored["error_over"]["noise"] > 10
    assert stored["limits_percent"]["error"] <= 3.0
    # A prediction that is no better than a straight line is not usable, however small its error.
    small = made(0.15 * GROWING[:200] / 20, GROWING[:200] / 20, name="small")
    assert with_test(fit, small).status is not Status.OK


def test_an_offset_that_was_not_fitted_is_named():
    fit = hf.fit("bouc-wen", made(output() + 0.02 * WHITE), starts=2)
    shifted = made(output(offset=9.0), name="shifted")
    without, refitted = with_test(fit, shifted), with_test(fit, shifted, refit_offset=True)
    assert without.status is Status.POOR
    severities = [note.severity for note in without.notes if note.code is Code.RECORD_PARAMETERS]
    assert severities == [Severity.INFO, Severity.WARNING]
    assert refitted.status is Status.OK
    assert has(refitted.notes, Code.OFFSET_REFITTED)
    assert not has(refitted.notes, Code.RECORD_PARAMETERS)
    same = with_test(fit, made(output()))  # the record that was fitted has its own offset
    assert not has(same.notes, Code.RECORD_PARAMETERS)


def test_a_large_cross_validation_error_is_not_usable():
    fit = hf.fit("bouc-wen", made(output() + 0.02 * WHITE), starts=2)
    judged = with_left_out(fit, 0.45 * fit.baselines.span)
    assert judged.status is Status.ROUGH
    assert has(judged.notes, Code.LEFT_OUT_ERROR)
    assert judged.to_dict()["verdict"]["left_out"] == pytest.approx(0.45 * fit.baselines.span)
    assert with_left_out(fit, 0.02 * fit.baselines.span).status is Status.OK


def test_more_weights_than_samples_are_judged_by_the_cross_validation_error():
    """Drying and wetting curves of a soil: the fit of 68 samples has 231 weights."""
    drying, wetting, scanning = np.linspace(0, 200, 30), np.linspace(193, 20, 24), np.linspace(25, 120, 14)
    water = lambda head, scale: (1 + (scale * head) ** 2.6) ** -0.6
    u = np.concatenate([drying, wetting, scanning])
    y = np.concatenate([water(drying, 0.015), water(wetting, 0.035), np.linspace(0.75, 0.45, 14)])
    record = hf.Record(u, y, u_unit="cm")
    result = hf.fit("negate+preisach:n=20", record)
    assert has(result.notes, Code.MANY_WEIGHTS)
    fold = held_out([record]).folds[0]
    squares = []
    for k in range(fold.max() + 1):
        rest = record.replace(weight=np.where(fold == k, 0.0, 1.0))
        error = (np.asarray(hf.fit("negate+preisach:n=20", rest).predict(record)) - y)[fold == k]
        squares.append(error**2)
    # The refits choose their own smoothness, so that the two errors agree roughly.
    assert result.left_out == pytest.approx(np.sqrt(np.mean(np.concatenate(squares))), rel=0.5)


@pytest.mark.parametrize("failed", [False, True])
def test_an_error_in_the_last_half_cycle_alone_is_said(failed):
    y = output()
    y = y + failed * 0.3 * np.ptp(y) * np.clip(T - T[575], 0, None) / 0.25  # from the last turning point on
    fit = hf.fit("bouc-wen", made(y + 0.01 * WHITE), starts=1)
    assert has(fit.notes, Code.LAST_HALF_CYCLE) == failed
    assert not has(fit.notes, Code.INITIAL_STATE)


MODELS = {
    "bouc-wen": (hf.BoucWen(c=0.15, mu=0.45, tau=0.05, rho=0.6, offset=3.0, h0=-0.9), "h0", -0.9),
    "bouc-wen-asymmetric": (hf.AsymmetricBoucWen(c=0.15, mu=0.45, tau=0.05, rho=0.6, h0=0.8, n=1.0, skew=0.2), "h0", 0.8),
    "bouc-wen-force": (hf.BoucWenForce(kappa_x=0.02, kappa_w=3.0, rho=0.1, w0=0.9), "w0", 0.9),
}  # fmt: skip


@pytest.mark.parametrize(
    "name",
    ["bouc-wen", *(pytest.param(name, marks=pytest.mark.slow) for name in ("bouc-wen-asymmetric", "bouc-wen-force"))],
)
def test_a_record_that_starts_in_mid_loop_asks_for_its_initial_state(name):
    model, state, value = MODELS[name]
    u = 50 * np.cos(2 * np.pi * T) * (0.5 + T / 12)
    y = np.asarray(hf.simulate(model, jnp.asarray(u))[0])
    record = made(y + 1e-3 * np.ptp(y) * WHITE, u)
    held = hf.fit(name, record, starts=2)
    assert has(held.notes, Code.INITIAL_STATE)
    free = hf.fit(name, record, free=[state], starts=4)
    assert free.status is Status.OK
    assert not has(free.notes, Code.INITIAL_STATE)
    assert free[state].value == pytest.approx(value, abs=0.05)
    assert abs(free[state].value) <= 1


@pytest.mark.parametrize("count", [1, 3])
def test_a_window_is_proposed_only_where_it_leaves_a_loop(count):
    u = 50 * np.cos(2 * np.pi * count * np.arange(N) / N)
    y = np.asarray(
        hf.simulate(hf.PrandtlIshlinskii(w=[[0.1, 0.05]], r=(0.1, 0.2), low=-50.0, high=50.0, b=(5.0,)), u)[0]
    )
    bump = np.exp(-(((np.arange(N) * count / N - 0.25) / 0.03) ** 2))
    fit = hf.fit("prandtl-ishlinskii", hf.Record(u=u, y=y + 0.04 * np.ptp(y) * bump))
    assert has(fit.notes, Code.INITIAL_STATE) == (count == 3)


@pytest.mark.parametrize(("place", "status"), [(0.2, Status.OK), (3.2, Status.ROUGH)])
def test_a_start_from_elsewhere_does_not_make_a_fit_rough(place, status):
    """An error of a fifth of the range in the first half cycle is that of the unknown initial state, elsewhere that of the model."""
    cycles = 10 * np.arange(N) / N
    u, loop = (
        50 * np.cos(2 * np.pi * cycles),
        hf.PrandtlIshlinskii(w=[[2, 1]], r=(0.1, 0.2), low=-50.0, high=50.0, b=(2.0,)),
    )
    y = np.asarray(hf.simulate(loop, u)[0])
    fit = hf.fit(
        "prandtl-ishlinskii", hf.Record(u=u, y=y + 0.2 * np.ptp(y) * np.exp(-(((cycles - place) / 0.04) ** 2)))
    )
    assert fit.status is status
    assert has(fit.notes, Code.INITIAL_STATE) == (status is Status.OK)


# -- yardsticks ------------------------------------------------------------------------------------------------------------


def test_plays_equal_a_plain_loop():
    u, radii = np.round(5 * np.random.default_rng(1).normal(size=300)), np.array([0.0, 0.5, 3.0])
    p, rows = np.full(3, u[0]), []
    for value in u:
        p = np.maximum(value - radii, np.minimum(value + radii, p))
        rows.append(p)
    np.testing.assert_array_equal(play_positions(u, radii), rows)


@pytest.mark.parametrize("refit_offset", [False, True])
def test_yardsticks_do_not_depend_on_the_blocks_of_samples(monkeypatch, refit_offset):
    rng = np.random.default_rng(2)
    u = np.cumsum(rng.normal(size=(3, 400)), axis=1)
    y = [0.3 * play_positions(row, np.array([2.0]))[:, 0] + rng.normal(size=400) + k for k, row in enumerate(u)]
    weight = np.where(np.arange(400) % 7 == 3, 0.0, 1.0)
    records = [hf.Record(u=a, y=b, weight=weight, name=str(k)) for k, (a, b) in enumerate(zip(u, y, strict=True))]
    train, test = Dataset(tuple(records[:2])), records[2:]
    of = lambda: [Baselines.of(train), Baselines.of(train, test, refit_offset=refit_offset)]
    at_once = of()
    monkeypatch.setattr(baselines, "BLOCK", 37)
    for blocks, whole in zip(of(), at_once, strict=True):
        for name in ("line", "curve", "plays"):
            assert getattr(blocks, name) == pytest.approx(getattr(whole, name), rel=1e-9)


def test_baselines_are_those_of_plain_regressions():
    y = output() + 0.02 * WHITE
    found = Baselines.of(Dataset.of(made(y)))
    line = np.polynomial.Polynomial.fit(GROWING, y, 1)(GROWING)
    assert found.line == pytest.approx(np.sqrt(np.mean((y - line) ** 2)), rel=1e-9)
    assert found.noise == pytest.approx(0.02, rel=0.1)
    assert found.plays < found.curve < found.line
    # Another record is judged by what was fitted to the first.
    other = made(y + 1.0, name="other")
    assert Baselines.of(Dataset.of(made(y)), [other]).line == pytest.approx(np.hypot(found.line, 1.0), rel=1e-9)
    assert Baselines.of(Dataset.of(made(y)), [other], refit_offset=True).line == pytest.approx(found.line, rel=1e-9)


def test_limits_follow_what_the_data_admit():
    of = lambda noise, plays: Limits.of(Baselines(span=100.0, noise=noise, line=20.0, curve=20.0, plays=plays))
    assert of(None, None) == (3.0, 10.0)
    assert of(0.01, 0.3) == (1.5, 10.0)  # five times the plays
    assert of(0.01, 0.01) == (1.0, 10.0)
    assert of(4.0, 4.1) == (8.0, 24.0)  # twice the noise, six times the noise


def test_an_error_of_one_sample_does_not_last():
    errors = np.array([0.0, 9.0, 0.0, 2.0, -3.0, 4.0, 0.0])
    assert persistent_error(errors).max() == 2.0


def test_a_sequential_result_is_judged_by_the_same_limits():
    truth = hf.BoucWen(c=1.0, mu=0.5, tau=0.05, rho=0.5)
    record = made(np.asarray(hf.simulate(truth, jnp.asarray(GROWING))[0]) + 0.05 * WHITE)
    fit = hf.fit("bouc-wen", record, method="ukf")
    assert has(fit.notes, Code.ACCURACY)
    assert fit.baselines.noise == pytest.approx(0.05, rel=0.1)
    assert dataclasses.replace(fit, status=Status.ROUGH).usable is False


def test_a_disturbance_has_the_numbers_of_the_measured_samples():
    """A cycle before the record, through which it is driven to be steady, does not count."""
    u = np.sin(2 * np.pi * np.arange(200) / 200)
    record = hf.Record(u, u, name="loop")
    row = 1e-3 * np.sign(np.cos(7.0 * np.arange(200)))
    row[50:53] = 1.0
    for one in (record, record.repeating()):
        note = disturbance_note([row], hf.Dataset.of(one))
        assert note is not None
        assert "samples 50 to 52 of 200" in note.text


@pytest.mark.parametrize("shape", ["noise", "shift"])
def test_a_disturbed_stretch_is_named_and_the_robust_loss_restores_the_parameters(shape):
    clean = output() + 0.01 * WHITE
    first, count = 310, 16
    disturbed = clean.copy()
    step = np.random.default_rng(4).normal(size=count) if shape == "noise" else np.ones(count)
    disturbed[first : first + count] += 0.1 * np.ptp(clean) * step
    named = lambda result: [note for note in result.notes if note.code is Code.SPIKES and "samples" in note.text]
    assert not named(hf.fit("bouc-wen", made(clean), starts=2))
    plain = hf.fit("bouc-wen", made(disturbed), starts=2)
    text = named(plain)[-1].text
    start, end = (int(word) for word in text.split("samples ")[1].split(" of ")[0].split(" to "))
    assert first <= start < end < first + count
    if shape == "shift":
        assert end - start >= count - 4
    robust = hf.fit("bouc-wen", made(disturbed), starts=2, loss="huber")
    proposals = lambda result: [note.option for note in result.notes if "loss='huber'" in note.text]
    assert set(proposals(plain)) == {("loss", "huber")}
    assert not proposals(robust)
    # A comparison of models takes no loss, and a fit of many weights by descents takes minutes.
    commands = next_commands(dataclasses.replace(plain, status=Status.ROUGH), Wording())
    assert [one for one in commands if "--loss=huber" in one and "--model bouc-wen" in one]
    weights = hf.fit("preisach:n=12", made(disturbed))
    assert named(weights)
    assert not proposals(weights)
    for row in robust.parameters:
        if row.stderr:
            assert abs(row.value - TRUTH[row.name]) < 3 * row.stderr


@pytest.mark.parametrize("clock", [True, False])
def test_the_next_command_leaves_out_the_half_cycle_that_failed(clock, tmp_path):
    """The window is in the record's time, or in samples where there is none; its command runs and finds the model usable."""
    y = output()
    failed = y + 0.15 * np.ptp(y) * np.clip(T - T[575], 0, None) / 0.25 + 0.01 * WHITE
    columns = [T, GROWING, failed] if clock else [GROWING, failed]
    rows = (",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True))
    file = tmp_path / "loop.csv"
    file.write_text("\n".join(["t_s,u_V,y_um"[0 if clock else 4 :], *rows]) + "\n")
    fit = hf.fit("bouc-wen", hf.read(file), starts=1)
    assert fit.status is Status.ROUGH
    commands = next_commands(fit, Wording(fit=str(tmp_path / "fit")))
    command = shlex.split(commands[0])
    assert command[:3] == ["hystfit", "fit", str(file)]
    assert run([*command[1:], "--model", "bouc-wen", "--out", str(tmp_path / "fit")]) == 0
    assert any(line.startswith("hystfit predict") for line in commands)  # a rough fit has its uses


@pytest.mark.parametrize("row", [np.zeros(50), np.empty(0), np.full(50, np.nan)])
def test_residuals_without_a_disturbance_to_name(row):
    record = made(output())
    assert disturbance_note([row], hf.Dataset.of(record)) is None


def test_a_fit_to_an_input_that_noise_reverses_proposes_its_smoothing():
    u = np.interp(np.arange(N), 100 * np.arange(7), [0, 1, 0, 1, 0, 1, 0])
    y = np.zeros(N)
    for k in range(1, N):
        y[k] = min(max(y[k - 1], u[k] - 0.2), u[k] + 0.2)
    record = hf.Record(u + 0.015 * WHITE, y)
    result = hf.fit("prandtl-ishlinskii:plays=4", record)
    name, length = next(note.option for note in result.notes if note.code is Code.CHATTER)
    assert name == "smooth"
    assert f"--smooth={length}" in " ".join(next_commands(dataclasses.replace(result, status=Status.ROUGH), Wording()))
    assert hf.fit("prandtl-ishlinskii:plays=4", record.smoothed(int(length))).train.rmse < result.train.rmse


def test_no_failure_is_blamed_where_the_last_half_cycle_repeats_an_earlier_one():
    """A smooth model of a switch errs at its jumps, and most in the last half cycle by chance."""
    u = 6 * np.sin(2 * np.pi * np.arange(600) / 150)
    y, state = [], 1.0
    for x in u:
        state = 0.0 if x > 3 else 1.0 if x < -3 else state
        y.append(state)
    record = made(np.array(y), u)
    turns = clear_reversals(u)
    assert _repeats(record, turns, 0.1)
    broken = record.replace(y=np.where(np.arange(600) >= turns[-1], 0.5 * record.y, record.y))
    assert not _repeats(broken, turns, 0.1)
