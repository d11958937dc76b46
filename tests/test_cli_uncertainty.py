"""The verbs about uncertainty: what they print and write, their exit statuses, bad input."""

import json

import numpy as np
import pytest

import hystfit as hf
from hystfit import priors
from hystfit.cli import run
from hystfit.cli.uncertainty import parse_priors
from hystfit.errors import ParameterError
from hystfit.uncertainty.calibration import RANKS, Calibration


@pytest.fixture(scope="module")
def fitdir(tmp_path_factory):
    T = 200
    u = np.sin(2 * np.pi * 3 * np.arange(T) / T) * (0.4 + 0.6 * np.arange(T) / T)
    truth = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
    y = np.asarray(hf.simulate(truth, u)[0]) + 0.01 * np.random.default_rng(0).normal(size=T)
    folder = tmp_path_factory.mktemp("fits") / "fit"
    hf.fit(truth, hf.Record(u=u, y=y, t=np.arange(T) * 0.01), fix={"rho": 0.5}, starts=1).save(folder)
    return folder


def test_sample_writes_a_posterior_and_says_that_a_short_run_is_not_enough(fitdir, tmp_path, capsys):
    """Its folder predicts with bands."""
    out = tmp_path / "p"
    short = ["--sampler", "emcee", "--walkers", "16", "--draws", "60"]
    words = ["sample", str(fitdir), "--noise", "iid", *short, "--prior", "tau=log-normal(2,0.5)"]
    assert run([*words, "--out", str(out), "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((out / "result.json").read_text())
    assert printed["schema"] == "hystfit.sample/4"
    assert printed["status"] == "not-converged"
    assert printed["priors"]["tau"].startswith("log-normal, median 2")
    assert {"posterior.nc", "corner.png", "bands.png"} <= {file.name for file in out.iterdir()}
    assert {"model.json", "records.npz"} <= {file.name for file in (out / "fit").iterdir()}
    assert "hystfit-new" not in (out / "report.html").read_text()

    posterior, record = hf.load_posterior(out), hf.load_fit(fitdir).data[0]
    assert posterior.draws.shape[0] == 16
    low, _, high = posterior.bands(hf.Record(u=record.u, y=record.y + 0.1, t=record.t, name="loop"))
    loop, columns = tmp_path / "loop.csv", np.column_stack([record.t, record.u, record.y + 0.1])
    np.savetxt(loop, columns, delimiter=",", header="t_s,u_V,y_um", comments="")
    for shifted, option in ((False, []), (True, ["--refit-offset"])):
        place = tmp_path / f"predicted-{shifted}"
        assert run(["predict", str(out), str(loop), *option, "--out", str(place)]) in (0, 1)
        table = np.genfromtxt(place / "prediction.csv", delimiter=",", names=True)
        shift = 0.1 if shifted else 0.0
        np.testing.assert_allclose(table["lower"], low + shift, atol=0.005 * shifted + 1e-9)
        np.testing.assert_allclose(table["upper"], high + shift, atol=0.005 * shifted + 1e-9)
        content = json.loads((place / "result.json").read_text())["bands"]
        measured = record.y + 0.1
        assert content["inside"] == pytest.approx(np.mean((table["lower"] <= measured) & (measured <= table["upper"])))
        assert content["width"] == pytest.approx(np.max(table["upper"] - table["lower"]))
        assert (content["inside"] > 0.8) == shifted


def test_profile_writes_limits(fitdir, tmp_path, capsys):
    assert run(["profile", str(fitdir), "--parameter", "tau", "--out", str(tmp_path / "q"), "--json"]) == 0
    row = json.loads(capsys.readouterr().out)["profiles"]["tau"]
    tau = hf.load_fit(fitdir)["tau"]
    assert row["lower"] < 2.0 < row["upper"]
    # the likelihood is nearly symmetric here: 1.96 standard errors to either side
    assert [row["lower"], row["upper"]] == pytest.approx(
        tau.value + 1.96 * tau.stderr * np.array([-1, 1]), abs=0.3 * tau.stderr
    )
    assert (tmp_path / "q" / "profiles.png").stat().st_size > 0


def test_errors_by_every_rule(fitdir, tmp_path, capsys):
    assert run(["errors", str(fitdir), "--block", "20", "--out", str(tmp_path / "e")]) == 0
    text = capsys.readouterr().out
    assert (tmp_path / "e" / "errors.txt").read_text().strip() in text
    content = json.loads((tmp_path / "e" / "result.json").read_text())
    assert content["schema"] == "hystfit.errors/1"
    sandwich = hf.covariance(hf.load_fit(fitdir), "sandwich", block=20)
    at = sandwich.names.index("tau")
    assert content["parameters"]["tau"]["stderr"]["sandwich"] == pytest.approx(sandwich.stderr[at], rel=1e-6)
    assert content["parameters"]["tau"]["ratio"]["sandwich"] == pytest.approx(sandwich.ratio[at], rel=1e-6)
    assert run(["errors", str(fitdir), "--block", "20", "--parameter", "tau"]) == 0
    printed = capsys.readouterr().out
    assert "\ntau " in printed
    assert "\nmu " in text
    assert "\nmu " not in printed
    assert run(["errors", str(fitdir), "--block", "0"]) == 2
    assert "block" in capsys.readouterr().err


@pytest.mark.parametrize("simulated", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_calibrate_writes_its_result(fitdir, tmp_path, monkeypatch, simulated):
    out = tmp_path / "c"
    if not simulated:
        ranks, asked = np.random.default_rng(0).integers(0, RANKS + 1, (10, 2)), {}
        study = Calibration(("c", "mu"), ranks, RANKS, np.zeros((10, 2)), (), "laplace", "iid", "iid", "BoucWen")
        monkeypatch.setattr(
            "hystfit.uncertainty.calibration.calibrate", lambda model, data, **options: asked.update(options) or study
        )
    # ten replicates are too few for a conclusion
    assert run(["calibrate", str(fitdir), "--noise", "iid", "--replicates", "10", "--out", str(out)]) == 1
    content = json.loads((out / "result.json").read_text())
    assert (content["schema"], content["status"], content["replicates"]) == ("hystfit.calibrate/1", "too-few", 10)
    assert (out / "calibration.png").stat().st_size > 0
    if not simulated:
        assert (asked["noise"].name, asked["replicates"], asked["fix"]) == ("iid", 10, ["rho", "h0"])


def test_design_writes_its_result(fitdir, tmp_path):
    words = ["design", str(fitdir), "--low", "-1", "--high", "1", "--method", "families", "--samples", "200"]
    assert run([*words, "--out", str(tmp_path / "d")]) == 0
    table = np.loadtxt(tmp_path / "d" / "input.csv", delimiter=",", skiprows=1)
    assert table.shape == (200, 2)
    proposal = hf.design(hf.load_fit(fitdir), low=-1.0, high=1.0, method="families", samples=200)
    np.testing.assert_allclose(table[:, 1], proposal.best.u, atol=1e-8)
    assert 1.5 < np.ptp(table[:, 1]) <= 2.0
    assert json.loads((tmp_path / "d" / "result.json").read_text())["schema"] == "hystfit.design/1"


def test_bad_words_exit_with_two(fitdir, tmp_path, capsys):
    for words in (
        ["sample", str(tmp_path)],
        ["sample", str(fitdir), "--prior", "tau"],
        ["sample", str(fitdir), "--prior", "tau=flat(0)"],
        ["profile", str(fitdir), "--parameter", "nu"],
        ["design", str(fitdir), "--low", "3", "--high", "1"],
    ):
        assert run(words) == 2, words
        assert capsys.readouterr().err.startswith("hystfit: ")


def test_priors_are_read_from_words():
    assert str(priors.parse("normal(1, 0.5)")) == str(priors.Normal(1.0, 0.5))
    assert str(priors.parse("half-normal(2)")) == str(priors.HalfNormal(2.0))
    for words in ("normal", "normal(1)", "cauchy(0,1)", "normal(a,b)"):
        with pytest.raises(ParameterError, match="a prior is one of"):
            priors.parse(words)


@pytest.mark.parametrize(
    "words",
    [
        ["profile"],
        ["errors"],
        ["sample"],
        ["calibrate"],
        ["design"],
        ["predict", "stage-sweep"],
        ["invert", "stage-sweep"],
    ],
)
def test_no_result_takes_the_place_of_a_fit(fitdir, capsys, words):
    before = (fitdir / "result.json").read_bytes()
    assert run([words[0], str(fitdir), *words[1:], "--out", str(fitdir)]) == 2
    assert "holds a fit" in capsys.readouterr().err
    assert (fitdir / "result.json").read_bytes() == before
    assert run(["report", str(fitdir)]) == 0


def test_priors_of_parameters_of_records_called_by_a_value():
    assert str(parse_priors(["offset@field=3=normal(0,1)"])["offset@field=3"]) == "normal, mean 0, sd 1"
    with pytest.raises(ParameterError, match="NAME=KIND"):
        parse_priors(["offset"])


def test_a_seed_that_no_generator_takes_is_bad_input(fitdir, capsys):
    assert run(["sample", str(fitdir), "--sampler", "nested", "--seed", "-1"]) == 2
    assert "a seed is a whole number" in capsys.readouterr().err
