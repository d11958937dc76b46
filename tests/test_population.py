"""Populations: the second stage against a grid and closed forms, device fits, bad input, priors for the next device, and the verb."""

import dataclasses
import functools
import json

import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.cli.uncertainty import _priors_of
from hystfit.errors import DataError, ParameterError
from hystfit.outcome import Code, Status
from hystfit.outcome.note import warn
from hystfit.population import devices as devices_module
from hystfit.population.fit_population import _status
from hystfit.population.hierarchy import Pool, draw_hierarchy
from hystfit.population.population_files import load_next_device

FIX = {"rho": 0.5, "mu": 0.5}
COUNT = 8
U = np.sin(2 * np.pi * 4 * np.linspace(0, 1, 160)) * np.linspace(0.4, 1.0, 160)


def test_the_second_stage_has_the_posterior_of_a_grid():
    """One parameter: mean and standard deviation on a grid, with a half-t prior of two degrees of freedom and scale one."""
    rng = np.random.default_rng(1)
    means, error = 0.3 * rng.normal(size=8), 0.4
    sd, mu = np.meshgrid(np.exp(np.linspace(-7, 2, 300)), np.linspace(-2, 2, 301), indexing="ij")
    variance = sd**2 + error**2
    log_p = -0.5 * len(means) * np.log(variance) - sum(0.5 * (m - mu) ** 2 / variance for m in means)
    log_p += -1.5 * np.log(1 + sd**2 / 2) + np.log(sd)  # the grid is even in log sd
    p = np.exp(log_p - log_p.max()).sum(axis=1)
    expected = np.interp([0.25, 0.5, 0.75, 0.95], np.cumsum(p) / p.sum(), sd[:, 0])
    drawn = draw_hierarchy(means[:, None], np.full((8, 1, 1), error**-2), np.ones((8, 1)), chains=4, draws=1500)
    found = np.quantile(np.sqrt(drawn.covariance), [0.25, 0.5, 0.75, 0.95])
    np.testing.assert_allclose(found, expected, rtol=0.12)


def test_a_pool_of_draws_stands_for_the_likelihood_it_comes_from():
    rng = np.random.default_rng(2)
    means, error = 0.3 * rng.normal(size=(6, 1)), 0.2
    prior_mean, prior_sd = 0.1, 1.0
    # The posterior of device 0 alone: its normal likelihood times a normal prior.
    precision = error**-2 + prior_sd**-2
    middle = (means[0, 0] / error**2 + prior_mean / prior_sd**2) / precision
    z = middle + rng.normal(size=(3000, 1)) / np.sqrt(precision)
    pool = Pool(z, -0.5 * ((z[:, 0] - prior_mean) / prior_sd) ** 2)
    precisions, ones = np.full((6, 1, 1), error**-2), np.ones((6, 1))
    plain = draw_hierarchy(means, precisions, ones, draws=1500)
    means[0], precisions[0] = 9.0, 1.0  # not used
    pooled = draw_hierarchy(means, precisions, ones, pools={0: pool}, draws=1500)
    for a, b in ((plain.z[:, :, 0], pooled.z[:, :, 0]), (np.log(plain.covariance), np.log(pooled.covariance))):
        assert abs(np.median(a) - np.median(b)) < 0.12 * a.std()
        np.testing.assert_allclose(np.quantile(b, [0.25, 0.75]), np.quantile(a, [0.25, 0.75]), atol=0.12 * a.std())


def test_a_covariate_moves_the_mean():
    rng, t = np.random.default_rng(3), np.linspace(-1, 1, 40)
    z = 0.5 + 0.8 * t + 0.1 * rng.normal(size=40)
    drawn = draw_hierarchy(z[:, None], np.full((40, 1, 1), 1e6), np.stack([np.ones(40), t], axis=1), draws=400)
    slope, intercept = np.polyfit(t, z, 1)
    effects = drawn.effects.reshape(-1, 2)
    np.testing.assert_allclose(effects.mean(axis=0), [intercept, slope], atol=0.01)
    residual = z - intercept - slope * t
    error = np.sqrt(residual @ residual / 38 / np.sum(t**2))
    assert effects[:, 1].std() == pytest.approx(error, rel=0.15)


def devices() -> tuple[list[hf.Record], np.ndarray]:
    rng = np.random.default_rng(0)
    scatter = rng.normal(size=(COUNT, 2)) * [0.05, 0.1]
    x = np.exp(scatter) * [1.0, 2.0]
    records = []
    for k, (c, tau) in enumerate(x):
        y = np.asarray(hf.simulate(hf.BoucWen(c=c, tau=tau, **FIX), U)[0])
        records.append(hf.Record(u=U, y=y + (0.08 if k % 2 else 0.02) * rng.normal(size=U.size), name=f"device {k}"))
    return records, x


def unsettled(sample, *args, **options):
    """Draws by a sampler that says that its chains have not converged."""
    note = warn(Code.CHAINS, "the chains disagree")
    return dataclasses.replace(sample(*args, **options), status=Status.NOT_CONVERGED, notes=(note,))


@pytest.fixture(scope="module")
def population() -> tuple[hf.PopulationFit, np.ndarray]:
    records, x = devices()
    # Half as many draws converge later, of steps that are thinned more.
    options = {"fix": {**FIX, "offset": 0.0}, "noise": "iid", "starts": 1, "draws": 1000}
    return hf.fit_population("bouc-wen", records, **options), x


def test_mean_scatter_and_devices_are_those_of_the_simulation(population):
    fit, x = population
    assert fit.status is Status.OK
    assert fit.names == ("c", "tau")
    rows = fit.table()
    for k, row in enumerate(rows):
        assert row["mean_lower"] < x[:, k].mean() < row["mean_upper"]
        assert row["sd_lower"] < [0.05, 0.2][k] < row["sd_upper"]
    true = x[:, 1].std(ddof=1)  # of tau, whose errors are as large as its scatter
    assert abs(rows[1]["sd_here"] - true) < 0.5 * abs(rows[1]["sd_of_fits"] - true)
    fitted, (better, sd) = fit.fitted, fit.shrunken
    assert np.sum(((better - x) / x) ** 2) < np.sum(((fitted - x) / x) ** 2)
    assert np.mean(np.abs(better - x) < 3 * sd) > 0.9
    assert (fit.effective > 0.8).all()
    assert not fit.outlying


def test_draws_of_a_device_have_the_posterior_of_a_grid(population):
    """Sums over a grid of both parameters; the noise is integrated out."""
    fit, _ = population
    device, sd = fit.devices[1], np.array([0.1, 0.2])
    center = device.mean - [0.05, 0.3]
    pool = device.pool(center, sd, fit.common, seed=0)
    width = np.sqrt(np.diag(np.linalg.inv(device.precision)))
    steps = np.linspace(-5, 5, 25)
    grid = device.mean + np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2) * width
    y = device.result.data[0].y
    rss = np.array([np.sum((y - device.problem.predict(x)[0]) ** 2) for x in fit.common.x_of(grid)])
    log_p = -0.5 * y.size * np.log(rss) - 0.5 * np.sum(((grid - center) / (3 * sd)) ** 2, axis=1)
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    mean = p @ grid
    spread = np.sqrt(p @ (grid - mean) ** 2)
    np.testing.assert_allclose(pool.z.mean(axis=0), mean, atol=0.15 * spread.min(), rtol=0)
    np.testing.assert_allclose(pool.z.std(axis=0), spread, rtol=0.1)


def test_draws_of_a_device_that_have_not_converged_are_the_status_of_the_population(population, monkeypatch):
    fit, _ = population
    monkeypatch.setattr(devices_module, "sample", functools.partial(unsettled, devices_module.sample))
    device = fit.devices[1]
    pool = device.pool(device.mean, np.array([0.1, 0.2]), fit.common, seed=0)
    status, problems = _status(fit.drawn, {1: pool}, fit.common, {})
    assert status is Status.NOT_CONVERGED
    assert all(note.text.startswith("device 1: ") for note in problems)


def test_the_next_device_and_its_band(population):
    fit, _ = population
    further = fit.next_devices(4000)
    np.testing.assert_allclose(np.median(further, axis=0), [1.0, 2.0], rtol=0.1)
    record = hf.Record(u=U, y=0 * U)
    low, middle, high = fit.bands(record, count=60)
    typical = np.asarray(hf.simulate(hf.BoucWen(c=1.0, tau=2.0, **FIX), U)[0])
    assert np.mean((low <= typical) & (typical <= high)) > 0.9
    assert np.abs(middle - typical).max() < 0.2
    with pytest.raises(ParameterError, match="level"):
        fit.bands(record, level=2)
    with pytest.raises(ParameterError, match="no covariate"):
        fit.next_devices(3, temperature=20)


def test_saved_population_is_the_prior_of_the_next_fit(population, tmp_path):
    fit, _ = population
    fit.save(tmp_path / "pop")
    priors = load_next_device(tmp_path / "pop").priors({})
    assert set(priors) == {"c", "tau"}
    z = np.log(np.asarray(fit.next_devices(4000)))
    assert priors.correlation[0, 1] == pytest.approx(np.corrcoef(z.T)[0, 1], abs=0.1)
    inside = np.log(np.asarray(fit.next_devices(4000))).std(axis=0)
    for prior, spread in zip(priors.values(), inside, strict=True):
        assert float(prior.spread) == pytest.approx(spread, rel=0.1)
    assert (tmp_path / "pop" / "devices.csv").read_text().count("\n") == COUNT + 1
    (tmp_path / "pop" / "result.json").write_text("{}")
    with pytest.raises(DataError):
        load_next_device(tmp_path / "pop")


def test_the_prior_of_the_next_fit_follows_the_covariates_that_its_record_states(population, tmp_path):
    """Devices at several temperatures, whose mean changes with it by 0.02 and -0.01 in the logarithms of both parameters."""
    fit, _ = population
    degrees = np.arange(20.0, 20.0 + 5 * COUNT, 5.0)
    design = np.stack([np.ones(COUNT), degrees - degrees.mean()], axis=1)
    rng = np.random.default_rng(0)
    means = np.array([0.0, np.log(2.0)]) + design[:, 1:] * [0.02, -0.01] + 0.1 * rng.normal(size=(COUNT, 2))
    drawn = draw_hierarchy(means, np.tile(np.eye(2) * 0.02**-2, (COUNT, 1, 1)), design, chains=2, draws=1500)
    warm = dataclasses.replace(fit, drawn=drawn, design=design, covariates={"temperature": degrees.mean()})
    warm.save(tmp_path / "pop")
    device = load_next_device(tmp_path / "pop")
    for temperature in (degrees.mean(), 60.0):
        z = np.log(np.asarray(warm.next_devices(20_000, temperature=temperature)))
        for priors in (warm.priors(temperature=temperature), device.priors({"temperature": temperature})):
            for prior, column in zip(priors.values(), z.T, strict=True):
                assert float(jnp.log(prior.median)) == pytest.approx(column.mean(), abs=0.1 * column.std())
                assert float(prior.spread) == pytest.approx(column.std(), rel=0.1)
            assert priors.correlation[0, 1] == pytest.approx(np.corrcoef(z.T)[0, 1], abs=0.08)
    with pytest.raises(ParameterError, match="no covariate"):
        device.priors({"field": 1.0})
    assert [one.plot("forest").get_suptitle().endswith("at the mean temperature") for one in (warm, fit)] == [
        True,
        False,
    ]
    record = hf.Record(u=U, y=fit.devices[0].result.data[0].y)
    own = hf.fit(hf.BoucWen(**FIX), record, fix=FIX, starts=1)
    with pytest.raises(DataError, match="--covariate temperature=VALUE"):
        _priors_of(tmp_path / "pop", own, [])
    given = _priors_of(tmp_path / "pop", own, ["temperature=60"])
    stating = record.replace(metadata={"temperature": "60"})
    stated = _priors_of(tmp_path / "pop", hf.fit(hf.BoucWen(**FIX), stating, fix=FIX, starts=1), [])
    expected = device.priors({"temperature": 60.0})
    for name in ("c", "tau"):
        assert given[name].exact() == stated[name].exact() == expected[name].exact()


@pytest.mark.slow
def test_the_change_with_a_covariate_that_the_files_state_is_that_of_least_squares(tmp_path, capsys):
    """c at temperatures in headers and names: its slope is that of a line through the values that simulated the devices."""
    degrees, c = np.arange(20.0, 50.0, 5.0), []
    rng = np.random.default_rng(4)
    for k, value in enumerate(degrees):
        c.append(1.0 + 0.01 * (value - 30) + 0.01 * rng.normal())
        y = np.asarray(hf.simulate(hf.BoucWen(c=c[-1], tau=2.0, **FIX), U)[0]) + 0.005 * rng.normal(size=U.size)
        head, name = (f"# temperature: {value} degC\n", "device") if k % 2 else ("", f"temperature={value:.0f}")
        rows = "\n".join(f"{a:.6f},{b:.6f}" for a, b in zip(U, y, strict=True))
        (tmp_path / f"{name}_{k}.csv").write_text(f"{head}u_V,y_um\n{rows}\n")
    words = ["--fix", "rho=0.5", "--fix", "mu=0.5", "--fix", "tau=2", "--fix", "offset=0", "--noise", "iid"]
    options = [*words, "--covariate", "temperature", "--starts", "1", "--out", str(tmp_path / "pop")]
    assert run(["population", f"{tmp_path}/*.csv", "--model", "bouc-wen", *options]) == 0
    assert "per unit of" in capsys.readouterr().out
    content = json.loads((tmp_path / "pop" / "result.json").read_text())["covariates"]["temperature"]
    (slope, _), covariance = np.polyfit(degrees, c, 1, cov=True)
    assert content["mean"] == degrees.mean()
    assert content["effects"]["c"]["median"] == pytest.approx(slope, abs=0.5 * np.sqrt(covariance[0, 0]))
    assert content["effects"]["c"]["lower"] < slope < content["effects"]["c"]["upper"]
    assert "per unit of" in (tmp_path / "pop" / "report.html").read_text()


def test_views(population):
    fit, _ = population
    for kind in ("forest", "correlation", "shrinkage"):
        assert fit.plot(kind).axes
    with pytest.raises(ParameterError, match="no picture"):
        fit.plot("pie")
    assert fit.to_arviz().posterior["z"].shape[2:] == (COUNT, 2)
    assert "sd of fits" in str(fit)


def test_a_device_apart_is_outlying(population):
    fit, _ = population
    odd = dataclasses.replace(fit.devices[0], name="odd", mean=fit.devices[0].mean + jnp.asarray([2.0, 0.0]))
    drawn = dataclasses.replace(fit, devices=(*fit.devices[1:], odd))
    assert drawn.outlying == ("odd",)


def test_the_precision_predicted_for_the_measured_input_is_that_of_the_fit(population):
    """From derivatives of the model, beside the curvature at the maximum of the likelihood."""
    fit, _ = population
    proposal = hf.design_population(fit, {"the same": U})
    for device in fit.devices[:2]:
        same, measured = (
            next(c for c in proposal.candidates if (c.device, c.name) == (device.name, name))
            for name in ("the same", "as measured")
        )
        assert same.errors == pytest.approx(measured.errors, rel=1e-3)


def test_the_next_measurement_is_the_one_that_tells_most(population):
    """Small strokes tell little about tau, for a new device and for every one measured again."""
    fit, _ = population
    proposal = hf.design_population(fit, {"full": U, "small": 0.1 * U}, aim=["tau"])
    falls = {(c.device, c.name): c.fall for c in proposal.candidates}
    assert falls[None, "full"] > 3 * falls[None, "small"]
    assert all(falls[f"device {k}", "full"] > falls[f"device {k}", "small"] for k in range(COUNT))
    assert proposal.best.fall == max(falls.values())
    assert proposal.counted == ("sd of tau",)
    assert proposal.best.errors["sd of tau"] == pytest.approx(
        proposal.present["sd of tau"] * np.sqrt(1 - proposal.best.fall)
    )
    assert proposal.best.label in str(proposal)
    of_mean = hf.design_population(fit, {"full": U}, goal="mean")
    assert of_mean.best.device is None  # another device tells more about the mean than any one known better
    for change, words in (
        ({"aim": ["rho"]}, "those are: c, tau"),
        ({"goal": "sd"}, "scatter or mean"),
        ({"low": 1.0, "high": 0.0}, "low < high"),
        ({"inputs": {"two": np.zeros((2, 3))}}, "'two'"),
    ):
        with pytest.raises(ParameterError, match=words):
            hf.design_population(fit, **change)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"records": slice(0, 1)}, "a population needs several devices, and 1 has"),
        ({"records": slice(0, 2)}, "2 devices do not determine the scatter of 2 parameters"),
        ({"covariates": {"temperature": {"device 0": 20.0}}}, "device 'device 1' has no number"),
        ({"covariates": ["temperature"]}, "has no value of temperature"),
        ({"by": {"device 0": "a"}}, "names no device for the loop 'device 1'"),
        ({"flat": True}, "device 0: "),
        ({"poor": True}, "device 0: poor (the error is"),
        ({"unit": "V"}, "record 'device 2': the output has another unit"),
        ({"draws": 3}, "at least 100"),
    ],
)
def test_bad_input_is_named(change, words):
    records, _ = devices()
    records = records[change.pop("records", slice(0, 3))]
    if change.pop("flat", False):  # a device without a loop
        records = [records[0].replace(y=2 * U), *records[1:]]
    if change.pop("poor", False):  # two devices, of which the model describes one
        records = [records[0].replace(y=np.sin(9 * U) + 0.1 * np.cumsum(U)), records[1]]
    if unit := change.pop("unit", ""):
        records = [record.replace(y_unit="N") for record in records[:-1]] + [records[-1].replace(y_unit=unit)]
    options = {"fix": {**FIX, "offset": 0.0}, "noise": "iid", "starts": 1} | change
    with pytest.raises((DataError, ParameterError)) as caught:
        hf.fit_population("bouc-wen", records, **options)
    assert words in str(caught.value)
    assert len(str(caught.value)) < 400  # not all notes on each device


def test_the_verb_proposes_the_next_measurement(tmp_path, capsys):
    """`--next-measurement`: in the text, in result.json, on the page, and as an input to apply."""
    for k, record in enumerate(devices()[0][:4]):
        rows = np.column_stack([record.u, record.y])
        np.savetxt(tmp_path / f"device{k}.csv", rows, "%.9g", ",", header="u [V],y [um]", comments="")
    words = ["population", str(tmp_path / "device*.csv"), "--model", "bouc-wen", "--noise", "iid", "--draws", "150"]
    for name, value in ({**FIX, "offset": 0.0}).items():
        words += ["--fix", f"{name}={value}"]
    assert run([*words, "--next-measurement", "--out", str(tmp_path / "pop")]) in (0, 1)  # 1: few draws
    printed = capsys.readouterr().out
    proposal = json.loads((tmp_path / "pop" / "result.json").read_text())["next_measurement"]
    best = proposal["candidates"][0]
    falls = [row["fall"] for row in proposal["candidates"]]
    assert falls == sorted(falls, reverse=True)
    label = f"{best['device'] or 'a new device'}, {best['input']}"
    assert f"proposed: {label}" in printed
    assert label in (tmp_path / "pop" / "report.html").read_text()
    rows = (tmp_path / "pop" / "next.csv").read_text().splitlines()
    assert rows[0] == "u_V"
    u = np.array([float(row) for row in rows[1:]])
    assert np.abs(u).max() <= 1.001 * np.abs(U).max()  # within the measured range
