"""The command line: every verb with good and bad input, exit statuses, and what is (not) left on disk."""

import csv
import dataclasses
import errno
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from hystfit import cli
from hystfit.cli import as_options, run
from hystfit.cli.options import held, limits
from hystfit.errors import HystfitError
from hystfit.results.saved import load_fit

PARAMETER_KEYS = {"value", "stderr", "unit", "lower", "upper", "fixed", "at_bound", "identifiable"}
METRIC_KEYS = {"rmse", "nrmse_percent", "max_error", "max_error_percent", "r2", "n"}
TRUTH = {"c": 0.2, "mu": 0.5, "tau": 0.05, "rho": 0.4}


def bouc_wen(u: np.ndarray) -> np.ndarray:
    """y = c v - h, h' = mu c v' - tau |v'| h - delta v' |h|, by small Euler steps between samples: independent of the models."""
    c, mu, tau, delta = TRUTH["c"], TRUTH["mu"], TRUTH["tau"], TRUTH["tau"] * TRUTH["rho"]
    h, out, small = 0.0, [c * u[0]], 400
    for before, after in itertools.pairwise(u):
        dv = (after - before) / small
        for _ in range(small):
            h += mu * c * dv - tau * abs(dv) * h - delta * dv * abs(h)
        out.append(c * after - h)
    return np.array(out)


def strict(text: str) -> dict:
    def refuse(word: str) -> None:
        raise AssertionError(f"not JSON: {word}")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cli")


@pytest.fixture(scope="module")
def loop(folder) -> Path:
    """A noisy Bouc-Wen loop of falling amplitude, 0..40 V, three seconds."""
    t = np.arange(240) / 80
    u = 20 * (1 - np.cos(2 * np.pi * t)) * (1 - 0.2 * np.floor(t))
    y = bouc_wen(u) + 0.01 * np.random.default_rng(3).standard_normal(t.size)
    path = folder / "loop.csv"
    rows = "\n".join(f"{a:.6f},{b:.8f},{c:.8f}" for a, b, c in zip(t, u, y, strict=True))
    path.write_text("t_s,u_V,y_um\n" + rows + "\n")
    return path


@pytest.fixture(scope="module")
def fitted(folder, loop) -> Path:
    out = folder / "fit"
    split = ["--window", ":2", "--test-window", "2:"]
    status = run(["fit", str(loop), "--model", "bouc-wen", "--starts", "2", *split, "--out", str(out)])
    assert status == 0
    return out


# -- fit -----------------------------------------------------------------------------------------------------------------


def test_fit_finds_the_truth_and_writes_the_contract(fitted):
    result = strict((fitted / "result.json").read_text())
    assert result["schema"] == "hystfit.fit/1"
    assert result["status"] == "ok"
    for name, truth in TRUTH.items():
        found = result["parameters"][name]
        assert set(found) == PARAMETER_KEYS
        assert abs(found["value"] - truth) < 5 * found["stderr"]
        assert found["stderr"] < 0.2 * truth
    assert result["parameters"]["h0"]["fixed"] is True
    assert result["parameters"]["h0"]["stderr"] is None
    for part in ("train", "test"):
        assert set(result["metrics"][part]) == METRIC_KEYS
        assert 0.008 < result["metrics"][part]["rmse"] < 0.013  # the noise
    assert (result["metrics"]["train"]["n"], result["metrics"]["test"]["n"]) == (160, 80)
    assert set(result["timing"]) == {"compile_s", "run_s"}
    assert result["provenance"]["records"][0]["file_sha256"]
    names = {"report.html", "report.txt", "model.json", "records.npz"}
    names |= {
        f"{k}.{e}"
        for k in ("loop", "series", "residuals", "autocorrelation", "parameters", "test")
        for e in ("png", "svg")
    }
    assert {path.name for path in fitted.iterdir()} == names | {"result.json"}


def test_fit_prints_json_alone(loop, fitted, capsys):
    assert (
        run(["fit", str(loop), "--model", "bouc-wen", "--starts", "1", "--fix", "mu=0.5", "--fix", "rho", "--json"])
        == 0
    )
    result = strict(capsys.readouterr().out)
    assert result["parameters"]["mu"]["value"] == 0.5
    assert result["parameters"]["mu"]["fixed"]
    assert result["parameters"]["rho"]["fixed"]
    assert result["metrics"]["test"] is None


def test_auto_takes_the_winner_and_says_so(loop, capsys, monkeypatch):
    from hystfit.fitting import compare

    everything = compare.compare
    monkeypatch.setattr(compare, "compare", lambda data, models=None, **k: everything(data, ["bouc-wen"], **k))
    assert run(["fit", str(loop), "--test-window", "2:"]) == 0
    text = capsys.readouterr().out
    assert "bouc-wen fitted to loop: usable" in text
    assert "bouc-wen was chosen among 1 models" in " ".join(text.split())
    assert "hystfit compare shows them all" in " ".join(text.split())


def test_a_monotonic_record_is_fitted_and_not_usable(folder, capsys):
    path = folder / "up.csv"
    path.write_text("u,y\n" + "\n".join(f"{k},{k**0.5}" for k in range(40)))
    assert run(["fit", str(path), "--model", "bouc-wen", "--starts", "1", "--json"]) == 1
    assert strict(capsys.readouterr().out)["status"] == "no-loop"


def test_sequential_methods_give_a_result_without_standard_errors(folder, capsys):
    out = folder / "rls"
    assert run(["fit", "stage-sine", "--method", "rls", "--out", str(out)]) == 0
    result = load_fit(out)
    assert (result.method, result.name) == ("rls", "duhem")
    assert all(p.stderr is None for p in result.parameters)
    assert result.train.nrmse_percent < 1


def test_own_model_in_a_file(folder, loop, monkeypatch, capsys):
    (folder / "mine.py").write_text('from hystfit import BoucWen\n\n\nclass Mine(BoucWen):\n    """Own."""\n')
    monkeypatch.chdir(folder)
    out = folder / "own"
    assert run(["fit", str(loop), "--model", "mine.py:Mine", "--starts", "1", "--out", str(out)]) == 0
    monkeypatch.chdir(folder.parent)
    assert load_fit(out).name == "Mine"
    assert run(["fit", str(loop), "--model", str(folder / "mine.py:Yours")]) == 2
    assert "it has" in capsys.readouterr().err


# -- compare, check, predict, report -------------------------------------------------------------------------------------


def test_compare_ranks_and_saves_the_winner(folder, loop, capsys):
    out = folder / "compared"
    assert run(["compare", str(loop), "--models", "bouc-wen", "--test-window", "2:", "--out", str(out)]) == 0
    assert "winner" in capsys.readouterr().out
    result = strict((out / "result.json").read_text())
    assert result["schema"] == "hystfit.compare/1"
    assert result["rows"][0]["name"] == "bouc-wen"
    assert set(result["test"]) == METRIC_KEYS
    assert load_fit(out / "winner").name == "bouc-wen"


def test_compare_by_the_future(folder, loop, capsys):
    out = folder / "future"
    assert run(["compare", str(loop), "--models", "bouc-wen", "--left-out", "future", "--out", str(out)]) == 0
    assert "what came before" in capsys.readouterr().out
    result = strict((out / "result.json").read_text())
    assert result["left_out"] == "future"
    assert np.isfinite(result["rows"][0]["bic"])
    assert run(["compare", str(loop), "--left-out", "points"]) == 2
    assert "--left-out" in capsys.readouterr().err


def test_check(folder, loop, capsys):
    assert run(["check", str(loop), "--out", str(folder / "checked")]) == 0
    assert "loops" in capsys.readouterr().out
    result = strict((folder / "checked" / "result.json").read_text())
    assert result["schema"] == "hystfit.check/1"
    assert result["records"][0]["motion"]["reversals"] == 5  # three cycles from a minimum to a minimum
    monotonic = folder / "up2.csv"
    monotonic.write_text("u,y\n" + "\n".join(f"{k},{2 * k + 1}" for k in range(40)))
    assert run(["check", str(monotonic), "--json"]) == 1
    assert strict(capsys.readouterr().out)["status"] == "no-model"


def test_predict_writes_what_the_model_says(folder, loop, fitted, capsys):
    out = folder / "predicted"
    assert run(["predict", str(fitted), str(loop), "--out", str(out)]) == 0
    with (out / "prediction.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["t_s", "u_V", "measured_um", "predicted_um"]
    result = load_fit(fitted)
    parameters = {name: result[name].value for name in (*TRUTH, "offset")}
    u = np.array([float(row["u_V"]) for row in rows])
    h, expected = 0.0, [parameters["c"] * u[0] + parameters["offset"]]
    for before, after in itertools.pairwise(u):
        dv = (after - before) / 400
        for _ in range(400):
            h += parameters["mu"] * parameters["c"] * dv - parameters["tau"] * (
                abs(dv) * h + parameters["rho"] * dv * abs(h)
            )
        expected.append(parameters["c"] * after + parameters["offset"] - h)
    predicted = np.array([float(row["predicted_um"]) for row in rows])
    assert np.max(np.abs(predicted - expected)) < 2e-3  # Euler steps of the oracle against the model's own steps
    content = strict((out / "result.json").read_text())
    assert content["schema"] == "hystfit.predict/1"
    assert content["metrics"]["test"]["n"] == 240


def test_predict_from_an_input_alone_warns_beyond_the_fitted_range(folder, fitted, capsys):
    path = folder / "input.csv"
    path.write_text("t_s,u_V\n" + "\n".join(f"{k / 80},{60 * np.sin(k / 9) ** 2}" for k in range(60)))
    arguments = ["predict", str(fitted), str(path), "--input-only", "--time", "t_s", "--input", "u_V", "--json"]
    assert run(arguments) == 0
    content = strict(capsys.readouterr().out)
    assert content["metrics"]["test"] is None
    assert "extrapolation" in content["notes"][0]


def test_refit_offset_takes_the_mean_error_out(folder, loop, fitted, capsys):
    shifted = folder / "shifted.csv"
    rows = loop.read_text().splitlines()
    shifted.write_text(
        "\n".join([rows[0]] + [f"{r.rpartition(',')[0]},{float(r.rpartition(',')[2]) + 5}" for r in rows[1:]])
    )
    errors = []
    for extra in ([], ["--refit-offset"]):
        run(["predict", str(fitted), str(shifted), "--json", *extra])
        errors.append(strict(capsys.readouterr().out)["metrics"]["test"]["rmse"])
    assert errors[0] == pytest.approx(5, abs=0.05)
    assert errors[1] < 0.02


def test_report_again(fitted, folder, capsys):
    assert run(["report", str(fitted), "--out", str(folder / "again")]) == 0
    assert "bouc-wen fitted to loop: usable" in capsys.readouterr().out
    assert (folder / "again" / "report.html").is_file()
    assert run(["report", str(fitted), "--out", str(folder / "again"), "--json"]) == 0
    assert strict(capsys.readouterr().out) == strict((fitted / "result.json").read_text())


def test_saved_fit_predicts_the_same(fitted, loop):
    result = load_fit(fitted)
    result.save(fitted.parent / "copy")
    again = load_fit(fitted.parent / "copy")
    record = result.data[0]
    assert np.array_equal(again.predict(record), result.predict(record))
    assert again.to_dict() == result.to_dict()
    for one, other in zip(again.parameters, result.parameters, strict=True):
        assert one == other
        assert one.doc


# -- simulate, models, datasets ------------------------------------------------------------------------------------------


def test_simulate_a_model_the_stage_and_a_fit(folder, fitted, capsys):
    out = folder / "made.csv"
    values = [item for name, value in TRUTH.items() for item in ("--set", f"{name}={value}")]
    drive = ["--signal", "triangle", "--low", "0", "--high", "40", "--duration", "2", "--rate", "400", "--out"]
    assert run(["simulate", "bouc-wen", *values, *drive, str(out)]) == 0
    table = np.loadtxt(out, delimiter=",", skiprows=1)
    assert table.shape == (800, 3)
    assert np.max(np.abs(table[:, 2] - bouc_wen(table[:, 1]))) < 2e-3
    for what in ("stage", str(fitted)):
        assert run(["simulate", what, *drive, str(folder / "made")]) == 0
        content = strict((folder / "made" / "result.json").read_text())
        assert content["schema"] == "hystfit.simulate/1"
        assert content["signal"]["high"] == 40
    assert run(["simulate", "bouc-wen", *drive, str(out), "--noise", "0.5", "--seed", "4"]) == 0
    noisy = np.loadtxt(out, delimiter=",", skiprows=1)
    assert run(["simulate", "bouc-wen", *drive, str(out)]) == 0
    clean = np.loadtxt(out, delimiter=",", skiprows=1)
    assert 0.45 < np.std(noisy[:, 2] - clean[:, 2]) < 0.55


def test_models_and_datasets_list_what_there_is(folder, capsys):
    from hystfit.models.registry import MODELS

    assert run(["models"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in MODELS)
    assert run(["models", "bouc-wen", "--json"]) == 0
    rows = {row["name"]: row for row in strict(capsys.readouterr().out)["parameters"]}
    assert (rows["mu"]["lower"], rows["mu"]["upper"], rows["h0"]["fixed"]) == (0.0, 1.0, True)
    assert run(["models", "lag"]) == 0
    assert "lag:rest=level" in capsys.readouterr().out
    assert run(["datasets"]) == 0
    assert "stage-sine" in capsys.readouterr().out
    assert run(["datasets", "stage-step", "--out", str(folder / "step.csv")]) == 0
    from hystfit.reading import datasets

    record = datasets.load("stage-step")
    table = np.loadtxt(folder / "step.csv", delimiter=",", skiprows=1)
    assert np.allclose(table, np.stack([record.t, record.u, record.y], axis=1), rtol=1e-9, atol=0)


# -- what cannot be served -----------------------------------------------------------------------------------------------

BAD_FILES = {
    "empty.csv": "",
    "one.csv": "t,u,y\n0,1,2\n",
    "flat.csv": "u_V,y_um\n" + "1,2\n" * 5 + "1,3\n" * 5,
    "gap.csv": "u_V,y_um\n1,2\n,3\n3,4\n4,5\n3,4\n2,3\n1,2\n",
    "words.csv": "the quick\nbrown fox\n",
}
BAD = [
    (["fit", "missing.csv"], "no file 'missing.csv'"),
    (["fit", "stage-sin"], "did you mean stage-sine"),
    (["fit", "."], "is a folder"),
    (["fit", "empty.csv"], "empty"),
    (["fit", "one.csv"], "at least two"),
    (["fit", "flat.csv"], "constant"),
    (["fit", "flat.csv", "--input", "u_V", "--output", "y_um", "--model", "bouc-wen"], "input is constant"),
    (["fit", "gap.csv"], "--gaps split"),
    (["fit", "words.csv"], "words.csv"),
    (["fit", "LOOP", "--model", "buc-wen"], "the models are: duhem, bouc-wen"),
    (["fit", "LOOP", "--model", "lag"], "has no hysteresis model"),
    (["fit", "LOOP", "--model", "nofile.py:Mine"], "no file 'nofile.py'"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "A=1"], "the parameters are: c, mu, tau"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu=7"], "outside its bounds [0, 1]"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu=nan"], "mu"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu=half"], "not a number"),
    (["fit", "LOOP", "--model", "bouc-wen", "--free", "zz"], "no parameter 'zz'"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu", "--free", "mu"], "fixed and free at once"),
    (["fit", "LOOP", "--fix", "mu=0.5"], "--model NAME"),
    (["fit", "LOOP", "--method", "magic"], "Choose from"),
    (["fit", "LOOP", "--method", "rls", "--fix", "alpha=1"], "no meaning for --method rls"),
    (["fit", "LOOP", "--model", "bouc-wen", "--starts", "0"], "at least one start"),
    (["fit", "LOOP", "--input", "Volt"], "the columns are 0: 't_s'; 1: 'u_V'; 2: 'y_um'"),
    (["fit", "LOOP", "--output", "9"], "there are 3"),
    (["fit", "LOOP", "--time", "none", "--model", "bouc-wen+viscous"], "depends on time"),
    (["fit", "LOOP", "--only", "3"], "--by"),
    (["fit", "LOOP", "--window", "90:99"], "the record runs from 0 to"),
    (["fit", "LOOP", "--window", "5"], "start:stop"),
    (["fit", "LOOP", "--window", "3:2"], "start must lie before"),
    (["fit", "LOOP", "--test-window", "0:3"], "leaves no sample to fit"),
    (["fit", "LOOP", "--window", "0:2", "--test-window", "1:3"], "fitted and tested at once"),
    (["fit", "LOOP", "--test", "LOOP"], "fitted and tested at once"),
    (["fit", "LOOP", "--test", "missing.csv"], "no file 'missing.csv'"),
    (["fit", "LOOP", "--refit-offset"], "give --test"),
    (["fit", "stage-sine", "--input", "1"], "leave out --input"),
    (["fit", "stage-sine", "--only", "1"], "nothing to choose from"),
    (["fit", "LOOP", "--out", "plain/x"], "cannot write to 'plain/x'"),
    (["fit", "LOOP", "--out", "plain"], "it is a file"),
    (["fit", "LOOP", "--out", "no/such"], "the folder 'no' does not exist"),
    (["fit"], "requires an argument"),
    (["fot"], "Did you mean"),
    (["fit", "LOOP", "--modle", "duhem"], "Did you mean --model"),
    (
        ["compare", "LOOP", "--models", "duhem", "bouc-wen"],
        "'bouc-wen' belongs to no option: to give several values, repeat",
    ),
    (["fit", "LOOP", "--method", "ukf", "--noise", "ou"], "--noise has no meaning for --method ukf"),
    (["fit", "LOOP", "--method", "rls", "--starts", "3"], "--starts has no meaning for --method rls"),
    (["compare", "LOOP", "--models", "bouc-wen,foo"], "no model 'foo'"),
    (["compare", "LOOP", "--out", "plain/x"], "cannot write"),
    (["check", "one.csv"], "at least two"),
    (["predict", "nofit", "LOOP"], "holds no fit"),
    (["predict", "FIT", "missing.csv"], "no file"),
    (["predict", "FIT", "LOOP", "--window", "50:"], "no sample counts"),
    (["predict", "FIT", "LOOP", "--input-only", "--output", "y_um"], "exclude each other"),
    (["report", "nofit"], "holds no fit"),
    (["simulate", "stage", "--signal", "saw", "--out", "x.csv"], "there are sine, triangle"),
    (["simulate", "stage", "--frequence", "2", "--out", "x.csv"], "it takes duration, rate, frequency"),
    (["simulate", "stage", "--frequency", "fast", "--out", "x.csv"], "--frequency is one number"),
    (["simulate", "bouc-wen", "--set", "mu", "--out", "x.csv"], "needs a value"),
    (["simulate", "bouc-wen", "--set", "mu=3", "--out", "x.csv"], "outside its bounds"),
    (["simulate", "stage"], "--out data.csv"),
    (["simulate", "stage", "--out", "no/x.csv"], "does not exist"),
    (["models", "foo"], "no model 'foo'"),
    (["datasets", "foo"], "no data set 'foo'"),
    (["datasets", "--out", "x.csv"], "say which"),
]


@pytest.fixture(scope="module")
def bad_folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("bad")
    for name, text in BAD_FILES.items():
        (place / name).write_text(text)
    (place / "plain").write_text("a regular file")
    return place


@pytest.mark.parametrize(("arguments", "told"), BAD, ids=[" ".join(arguments) for arguments, _ in BAD])
def test_bad_input_is_one_message_and_status_2(arguments, told, bad_folder, loop, fitted, monkeypatch, capsys):
    monkeypatch.chdir(bad_folder)
    before = {path: path.stat().st_mtime_ns for path in bad_folder.rglob("*")}
    places = {"LOOP": str(loop), "FIT": str(fitted)}
    assert run([places.get(word, word) for word in arguments]) == 2
    printed = capsys.readouterr()
    assert told in printed.err
    assert printed.err.startswith("hystfit: ")
    assert printed.err.count("\n") == 1
    assert printed.out == ""
    assert {path: path.stat().st_mtime_ns for path in bad_folder.rglob("*")} == before


def test_a_damaged_fit_is_refused(fitted, folder, capsys):
    damaged = folder / "damaged"
    damaged.mkdir()
    for name in ("model.json", "records.npz"):
        (damaged / name).write_bytes((fitted / name).read_bytes())
    whole = strict((fitted / "result.json").read_text())
    changed = [{"metrics": None}, {"covariance": [[1.0]]}, {"parameters": 3}]
    by_hand = [json.dumps({**whole, **change}) for change in changed]
    for content in ("{", '{"schema": "other/1"}', '{"schema": "hystfit.fit/1"}', "[]", *by_hand):
        (damaged / "result.json").write_text(content)
        assert run(["report", str(damaged)]) == 2
        assert "damaged" in (words := capsys.readouterr().err) or "schema" in words


def test_a_full_disk_leaves_nothing(folder, loop, monkeypatch, capsys):
    from hystfit.results import report

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(report, "write_into", full)
    out = folder / "full"
    assert run(["fit", str(loop), "--model", "bouc-wen", "--starts", "1", "--out", str(out)]) == 2
    assert "No space left" in capsys.readouterr().err
    assert not out.exists()


def test_an_interrupted_fit_leaves_nothing_and_an_old_one_alone(folder, loop, fitted, monkeypatch, capsys):
    from hystfit.results import report

    def stop(*_, **__):
        raise KeyboardInterrupt

    before = {path.name: path.read_bytes() for path in fitted.iterdir()}
    monkeypatch.setattr(report, "write_into", stop)
    for out in (folder / "stopped", fitted):
        assert run(["fit", str(loop), "--model", "bouc-wen", "--starts", "1", "--out", str(out)]) == 130
        assert "interrupted" in capsys.readouterr().err
    assert not (folder / "stopped").exists()
    assert {path.name: path.read_bytes() for path in fitted.iterdir()} == before


def test_choices_are_those_of_the_library():
    from hystfit.cli import fitting as shell
    from hystfit.fitting import fit as library

    assert set(get_args(shell.Method)) == {*get_args(library.Method), *shell.Sequential}
    assert get_args(shell.Loss) == get_args(library.Loss)
    assert get_args(shell.Noise) == get_args(get_type_hints(library.fit)["noise"])


def test_windows_and_held_parameters_are_read():
    assert limits("5:25") == (5.0, 25.0)
    assert limits(":27") == (None, 27.0)
    assert limits("25:") == (25.0, None)
    assert limits(None) is None
    assert held(["c=0.1", "w[2]", "mu = 3"]) == {"c": 0.1, "w[2]": None, "mu": 3.0}
    for wrong in (["c=1", "c=2"], ["=1"], [""]):
        with pytest.raises(HystfitError):
            held(wrong)


def test_messages_speak_the_shell():
    assert (
        as_options("gaps='split' makes a record; give by= or output=")
        == "--gaps split makes a record; give --by or --output"
    )
    assert as_options("time=False reads without time") == "--time none reads without time"
    assert as_options("use left_out='blocks'; scheduler= needs") == "use --left-out blocks; --scheduler needs"


def test_curves_of_one_file_are_split_into_fit_and_test(folder, loop):
    from hystfit.cli.loading import train_and_test
    from hystfit.cli.options import Reading, Split

    rows = [line.split(",")[1:] for line in loop.read_text().splitlines()[1:]]
    path = folder / "curves.csv"
    path.write_text("loop,u_V,y_um\n" + "\n".join(f"{k // 80 + 3},{u},{y}" for k, (u, y) in enumerate(rows)))
    train, test = train_and_test(str(path), Reading(by="loop"), Split(test_only="5"))
    assert [record.name for record in train] == ["loop=3", "loop=4"]
    assert [record.name for record in test] == ["loop=5"]
    train, test = train_and_test(str(path), Reading(by="loop", only="0:1"), Split(test_only="1::1"))
    assert [[record.name for record in part] for part in (train, test)] == [["loop=3"], ["loop=4", "loop=5"]]
    train, test = train_and_test(str(path), Reading(by="loop", only="3"), Split(window="10:50"))
    assert (int(train[0].used.sum()), test) == (40, None)


# -- as a process --------------------------------------------------------------------------------------------------------

MAIN = [sys.executable, "-c", "from hystfit.cli import main; main()"]


def process(*arguments: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run([*MAIN, *arguments], capture_output=True, text=True, timeout=120, **options)


def test_help_starts_without_the_numerical_libraries():
    code = (
        "import sys, hystfit\nfrom hystfit.cli import run\nassert run(['--help']) == 0\n"
        "heavy = {'jax', 'numpy', 'scipy', 'matplotlib', 'equinox'} & set(sys.modules)\nassert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    for verb in ("fit", "compare", "check", "predict", "simulate", "models", "datasets", "report"):
        assert verb in done.stdout


def test_public_names_are_all_there():
    import hystfit

    for name in hystfit.__all__:
        assert getattr(hystfit, name) is not None
    with pytest.raises(AttributeError):
        _ = hystfit.nothing
    assert dataclasses.is_dataclass(hystfit.FitResult)


def test_a_process_is_silent_but_for_the_result(loop, tmp_path):
    done = process("fit", str(loop), "--model", "bouc-wen", "--starts", "1", "--json", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stderr == ""
    assert strict(done.stdout)["status"] == "ok"
    assert process("fit", "nofile.csv", cwd=tmp_path).returncode == 2


def test_a_reader_that_stops_early_changes_no_status(tmp_path):
    (tmp_path / "up.csv").write_text("u,y\n" + "\n".join(f"{k},{2 * k + 1}" for k in range(40)))
    reader, writer = os.pipe()
    os.close(reader)
    for arguments, status in ((["check", "up.csv"], 1), (["models"], 0)):
        done = subprocess.run(
            [*MAIN, *arguments], stdout=writer, stderr=subprocess.PIPE, text=True, cwd=tmp_path, timeout=60
        )
        assert (done.returncode, done.stderr) == (status, "")
    os.close(writer)


def test_interrupt_from_the_keyboard(loop, tmp_path):
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a shell's background jobs ignore it, and pass that on
    try:
        running = subprocess.Popen(
            [*MAIN, "fit", str(loop), "--model", "duhem", "--starts", "64", "--out", "out"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
        )
    finally:
        signal.signal(signal.SIGINT, before)
    time.sleep(2.5)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert running.returncode == 130, err
    assert "interrupted" in err
    assert "Traceback" not in err
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_compiled_programs_are_kept_for_the_next_command(tmp_path, monkeypatch):
    monkeypatch.setattr(cli.platformdirs, "user_cache_path", lambda name: tmp_path / name)
    for name in ("DIR", "MAX_SIZE"):
        monkeypatch.delenv(f"JAX_COMPILATION_CACHE_{name}", raising=False)
    cli.keep_programs()
    folder = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
    assert folder.is_dir()
    assert folder.is_relative_to(tmp_path)
    assert int(os.environ["JAX_COMPILATION_CACHE_MAX_SIZE"]) > 0
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "elsewhere")
    cli.keep_programs()
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == "elsewhere"


def test_a_cache_that_cannot_be_made_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(cli.platformdirs, "user_cache_path", lambda name: tmp_path / "file" / name)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    cli.keep_programs()
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ
