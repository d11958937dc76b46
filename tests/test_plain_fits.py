"""Loops over one input, fitted and judged together, beside `hystfit.fit` of each."""

import functools

import numpy as np
import pytest
from scipy.signal import lfilter

import hystfit as hf
from hystfit.batch import plain_fits, plain_judge, row_accuracy, simulated_rows, work
from hystfit.batch.alike import Common, Group, Loops
from hystfit.batch.row import row_of
from hystfit.data.dataset import Dataset
from hystfit.fitting.fit_setup import set_up_fit
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Status
from hystfit.params.space import ParameterSpace

SAMPLES, LOOPS = 480, 12
T = np.arange(SAMPLES) / 100
U = 3 * np.sin(2 * np.pi * T) * (0.4 + 0.6 * T / T[-1])


@functools.cache
def outputs() -> np.ndarray:
    """Loops of devices that differ, in size and level too, with white noise."""
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(LOOPS):
        c, tau = np.exp(rng.normal()), 0.5 * np.exp(0.2 * rng.normal())
        model = hf.BoucWen(c=c, mu=rng.uniform(0.3, 0.6), tau=tau, rho=rng.uniform(0.2, 0.6), offset=10 * rng.normal())
        y = np.asarray(hf.simulate(model, U)[0])
        rows.append(y + 0.003 * np.ptp(y) * rng.normal(size=SAMPLES))
    return np.array(rows)


def record(y: np.ndarray, name: str = "loop") -> hf.Record:
    return hf.Record(u=U, y=y, t=T, u_unit="V", y_unit="um", name=name)


@functools.cache
def alone(k: int) -> object:
    one = record(outputs()[k])
    return row_of("", "", one, hf.fit("bouc-wen", one))


def same(row: object, wanted: object) -> None:
    """Estimates to 1e-6 of their errors, errors to 1e-3, everything else."""
    for name, value in wanted.values.items():
        assert abs(row.values[name] - value) < 1e-5 * wanted.stderr[name]
        assert row.stderr[name] == pytest.approx(wanted.stderr[name], rel=1e-3)
    assert (row.status, row.codes, row.reason) == (wanted.status, wanted.codes, wanted.reason)
    assert (row.units, row.samples, row.model) == (wanted.units, wanted.samples, wanted.model)
    for name, value in wanted.quantities.items():
        assert row.quantities[name] == pytest.approx(value, rel=1e-6)
    for name in ("rmse", "error_percent", "max_error_percent"):
        assert getattr(row, name) == pytest.approx(getattr(wanted, name), rel=1e-6)


def test_rows_are_those_of_fit() -> None:
    fits = plain_fits.fit_plain(hf.BoucWen(), [Group(record(outputs()[0]), outputs())], work.FitOptions(), held=False)
    assert fits.judged.plain.mean() > 0.9
    for k in (0, 5, 11):
        assert fits.judged.plain[k]
        same(fits.row(k, "", "", record(outputs()[k])), alone(k))


def spoiled() -> dict[str, np.ndarray]:
    """Outputs with something that needs a closer look."""
    y = outputs()[0]
    at, span, rng = np.arange(SAMPLES), np.ptp(y), np.random.default_rng(2)
    level = lambda part: np.quantile(y, part)
    return {
        "a missing sample": np.where(at == 50, np.nan, y),
        "nothing": np.full(SAMPLES, np.nan),
        "a constant": np.full(SAMPLES, 1.0),
        "an outlier": np.where(at == 50, y + span, y),
        "a saturated sensor": np.clip(y, None, level(0.9)),
        "a rounded output": np.round(y / span, 2) * span,
        "slow noise": y + 0.01 * span * np.convolve(rng.normal(size=SAMPLES), np.ones(30) / 5, "same"),
        "heavy tails": y + 0.003 * span * rng.standard_t(1.5, SAMPLES),
        "a disturbance": y + np.where((at > 200) & (at < 206), 0.02 * span * rng.normal(size=SAMPLES), 0.0),
        "another device": np.where(at > SAMPLES // 2, 1.3 * y, y),
        "no hysteresis": U + 0.003 * rng.normal(size=SAMPLES),
        "no loop": rng.normal(size=SAMPLES),
        "one more exponent": y + 0.3 * span * (U / 3) ** 3,
        "a virgin half cycle": np.where(at < 12, y + 0.03 * span, y),
    }


@pytest.mark.parametrize("kind", spoiled())
def test_a_loop_that_needs_a_closer_look_is_not_plain_and_the_others_are_unharmed(kind: str) -> None:
    y = np.concatenate([outputs(), spoiled()[kind][None]])
    fits = plain_fits.fit_plain(hf.BoucWen(), [Group(record(outputs()[0]), y)], work.FitOptions(), held=False)
    assert not fits.judged.plain[-1]
    assert fits.judged.plain.sum() >= LOOPS - 1


def test_information_that_is_singular_spares_the_errors_of_the_others() -> None:
    """Two parameters of equal effect; `inv` raises for all loops where one matrix is singular."""
    rng = np.random.default_rng(0)
    options = work.FitOptions(starts=1)
    setup = set_up_fit(hf.BoucWen(), Dataset.of(record(outputs()[0])), options)
    common = Common(setup, np.zeros((0, 5)), np.zeros(0), np.zeros((3, 5)))
    J = rng.normal(size=(3, 50, 5))
    J[1, :, 2] = J[1, :, 3] = np.round(J[1, :, 2])
    gram, x = J.swapaxes(1, 2) @ J, np.tile(setup.problem.space.vector(setup.points[0]), (3, 1))
    stderr, _, regular = plain_judge._errors(common, x, np.ones((3, 5)), gram, np.full(3, 1e-8))
    assert not regular[1]
    for k in (0, 2):
        np.testing.assert_allclose(stderr[k], 1e-4 * np.sqrt(np.diag(np.linalg.inv(gram[k]))), rtol=1e-9)


def test_sound_outputs_of_white_noise_are_most() -> None:
    rng = np.random.default_rng(3)
    y = 100 + np.sin(T)[None] * rng.uniform(0.5, 2, (200, 1)) + 0.01 * rng.normal(size=(200, SAMPLES))
    assert row_accuracy.soundness(Loops((Group(record(y[0]), y),))).sound.mean() > 0.9


class Side:
    """Stands for a GPU."""

    platform = "gpu"


def test_a_gpu_judges_as_the_cpu_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """In several calls, of which the last has fewer loops; some samples do not count."""
    weighed = record(outputs()[0]).replace(weight=(np.arange(SAMPLES) > 9).astype(float))
    y = np.stack([*outputs(), *(rows for rows in spoiled().values() if np.isfinite(rows).all())])
    fit = lambda: plain_fits.fit_plain(hf.BoucWen(), [Group(weighed, y)], work.FitOptions(starts=1), held=False)
    expected = fit()
    monkeypatch.setattr(simulated_rows, "_NUMBERS", 5 * SAMPLES)
    monkeypatch.setattr(row_accuracy, "device_for", lambda count: Side())
    monkeypatch.setattr(row_accuracy, "placed", lambda tree, device: tree)
    found = fit()
    assert 5 < expected.judged.plain.sum() < len(y)
    for name, rows in expected.judged._asdict().items():
        np.testing.assert_allclose(getattr(found.judged, name), rows, rtol=1e-9, err_msg=name)


def test_a_batch_takes_its_plain_loops_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows in the order given; two loops that are not plain are fitted alone, and one over another input is not."""
    records = [record(y, f"loop {k}") for k, y in enumerate(outputs())]
    others = [record(spoiled()["an outlier"], "outlier"), record(spoiled()["a constant"], "constant")]
    others.append(hf.Record(u=2 * U, y=outputs()[1], t=T, u_unit="V", y_unit="um", name="other input"))
    posed, pose = [], work._pose
    monkeypatch.setattr(work, "_pose", lambda task, loop: posed.append(loop.name) or pose(task, loop))
    fits = hf.fit_many("bouc-wen", [*records[:6], *others, *records[6:]], starts=2)
    assert [row.name for row in fits][5:10] == ["loop 5", "outlier", "constant", "other input", "loop 6"]
    assert {"outlier", "constant"} <= set(posed)
    assert "other input" not in posed
    same(fits["other input"], row_of("", "", others[-1], hf.fit("bouc-wen", others[-1])))
    assert len(posed) < 6
    assert fits["constant"].status is Status.FAILED
    same(fits["loop 5"], alone(5))


def slow_noise(rng: np.random.Generator, samples: int) -> np.ndarray:
    """White noise of standard deviation 1, and a slower part of 0.7 on top."""
    return rng.normal(size=samples) + 0.3 * lfilter([1.0], [1.0, -0.9], rng.normal(size=samples))


def test_slow_noise_is_judged_with_the_others() -> None:
    """Standard errors under slow noise, and the notes, of loops with inputs and lengths of their own."""
    rng, records = np.random.default_rng(5), []
    for k in range(10):
        count = 440 + 5 * k
        t = np.arange(count) / 100
        u = (2 + 0.1 * k) * np.sin(2 * np.pi * t + 0.1 * k) * (0.4 + 0.6 * t / t[-1])
        y = np.asarray(hf.simulate(hf.BoucWen(c=1 + 0.1 * k, mu=0.4, tau=0.5, rho=0.4, offset=k), u)[0])
        noise = slow_noise(rng, count) if k % 2 else rng.normal(size=count)
        record = hf.Record(u=u, y=y + 0.004 * np.ptp(y) * noise, t=t, u_unit="V", y_unit="um", name=f"loop {k}")
        records.append(record)
    fits = plain_fits.fit_plain(
        hf.BoucWen(), [Group(record, record.y[None]) for record in records], work.FitOptions(), held=False
    )
    assert fits.judged.plain.sum() >= 9
    assert fits.judged.slow.sum() >= 3
    for k in (4, int(np.argmax(fits.judged.slow))):
        wanted = row_of("", "", records[k], hf.fit("bouc-wen", records[k]))
        assert ("error-ratio" in wanted.codes) is bool(fits.judged.slow[k])
        same(fits.row(k, "", "", records[k]), wanted)


def test_a_loop_that_is_described_but_not_plain_is_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slow noise twice as large as the white: the estimate stays, and the judgment is that of a fit alone."""
    noise = lfilter([0.31], [1.0, -0.95], np.random.default_rng(11).normal(size=SAMPLES))
    noisy = outputs()[3] + 0.005 * np.ptp(outputs()[3]) * noise
    records, judged, judge = [record(y, f"loop {k}") for k, y in enumerate([*outputs(), noisy])], [], work._judge
    monkeypatch.setattr(work, "_judge", lambda task, loop: judged.append(loop.name) or judge(task, loop))
    monkeypatch.setattr(work, "solve", None)
    row = hf.fit_many("bouc-wen", records)["loop 12"]
    assert "loop 12" in judged
    same(row, row_of("", "", records[-1], hf.fit("bouc-wen", records[-1])))


RATES = {hf.BoucWen: "tau", hf.AsymmetricBoucWen: "tau", hf.Duhem: "alpha"}


@pytest.mark.parametrize("model", [hf.BoucWen(), hf.AsymmetricBoucWen(n=2.0), hf.Duhem(), hf.Duhem(scheme="explicit")])
def test_the_size_of_a_step_says_where_a_model_has_advice(model: AbstractHysteresis) -> None:
    """Of many models at once, beside the sentences of each."""
    space = ParameterSpace.of(model)
    x = space.vector(model) * np.geomspace(0.01, 20, 24)[:, None] ** (np.array(space.names) == RATES[type(model)])
    ratio = space.coordinates.assemble_stacked(x).step_ratio(np.abs(np.diff(U)).max())
    told = [bool(one.advice(U)) for one in space.coordinates.assemble_rows(x)]
    assert 0 < sum(told) < len(told)
    assert (ratio > 1).tolist() == told
