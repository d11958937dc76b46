"""The command line: every verb with good and bad input, exit statuses, and what is (not) left on disk."""

import csv
import dataclasses
import errno
import html
import inspect
import itertools
import json
import os
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import app, run
from hystfit.cli.options import Reading, bounds_of, named_values
from hystfit.cli.verbs import EXAMPLES, VERBS, as_options
from hystfit.cli.write import show
from hystfit.errors import HystfitError, optional
from hystfit.outcome import Status
from hystfit.results.report import Wording, html_report, text_report
from hystfit.results.saved import load_fit

PARAMETER_KEYS = {"value", "stderr", "unit", "lower", "upper", "fixed", "at_bound", "identifiable", "tie"}
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


def test_branches_without_names_in_a_file_each_are_one_loop(tmp_path, capsys):
    """The field rises in even steps in one file, as a time does, and falls in the other."""
    field = np.linspace(-20, 20, 60)
    noise = 0.01 * np.random.default_rng(1).normal(size=(2, 60))
    for name, sign, rough in (("up", 1, noise[0]), ("down", -1, noise[1])):
        branch = np.column_stack([sign * field, np.tanh((sign * field - sign * 3) / 5) + rough])
        np.savetxt(tmp_path / f"{name}.txt", branch, fmt="%.4f", delimiter="\t")
    assert run(["check", str(tmp_path / "up.txt")]) == 2
    assert "INPUT_FILE+" in capsys.readouterr().err
    assert run(["check", str(tmp_path / "up.txt"), str(tmp_path / "down.txt"), "--json"]) == 0
    (record,) = json.loads(capsys.readouterr().out)["records"]
    assert record["sampling"]["n"] == 120


# -- fit -----------------------------------------------------------------------------------------------------------------


def test_fit_finds_the_truth_and_writes_the_contract(fitted):
    result = strict((fitted / "result.json").read_text())
    assert result["schema"] == "hystfit.fit/3"
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
    names = {"report.html", "report.txt", "model.json", "records.npz", "manifest.json"}
    names |= {
        f"{k}.{e}"
        for k in (
            "loop",
            "series",
            "residuals",
            "residuals-input",
            "autocorrelation",
            "parameters",
            "test",
            "test-series",
        )
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


def test_auto_fits_the_winner_and_notes_the_choice(loop, capsys, monkeypatch):
    from hystfit.fitting import fit as fit_module

    everything = fit_module.compare
    monkeypatch.setattr(fit_module, "compare", lambda data, models=None, **k: everything(data, ["bouc-wen"], **k))
    assert run(["fit", str(loop), "--test-window", "2:"]) == 0
    assert "bouc-wen fitted to loop: usable" in capsys.readouterr().out
    assert run(["fit", str(loop), "--test-window", "2:", "--json"]) == 0
    note = strict(capsys.readouterr().out)["notes"][0]
    assert (note["code"], note["severity"]) == ("choice", "info")


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


@pytest.mark.parametrize(
    ("method", "options", "settings"),
    [
        ("rls", ["--forgetting", "0.999", "--prior", "1e4"], {"forgetting": 0.999, "prior": 1e4}),
        (
            "gradient-correction",
            ["--basis", "powers", "--weights", "1,1e-3,1e-6,1e-9,1,1,1e-3,1e-6", "--mu", "0.5", "--floor", "0"],
            {"basis": "powers", "weights": [1, 1e-3, 1e-6, 1e-9, 1, 1, 1e-3, 1e-6], "mu": 0.5, "floor": 0.0},
        ),
        ("gradient-correction", ["--step", "1e-3", "--passes", "2"], {"step": 1e-3, "passes": 2}),
    ],
)
def test_settings_of_a_sequential_method_at_the_shell(method, options, settings, capsys):
    run(["fit", "stage-sine", "--method", method, *options, "--json"])
    shown = strict(capsys.readouterr().out)["parameters"]
    model = hf.identify.identify(hf.datasets.load("stage-sine"), method, **settings).model
    assert shown["alpha"]["value"] == pytest.approx(float(model.alpha), rel=1e-12)
    default = hf.identify.identify(hf.datasets.load("stage-sine"), method).model
    assert shown["alpha"]["value"] != pytest.approx(float(default.alpha), rel=1e-9)


def test_every_setting_of_the_linear_identifiers_has_an_option():
    from hystfit.cli.options import SequentialSettings

    options = {field.name for field in dataclasses.fields(SequentialSettings)}
    names = {
        name
        for kind in (hf.identify.Rls, hf.identify.GradientCorrection)
        for name in inspect.signature(kind.of).parameters
    }
    assert options - {"passes"} == names - {"model", "data", "start", "form"}


def test_own_model_in_a_file(folder, loop, monkeypatch, capsys):
    (folder / "mine.py").write_text('from hystfit import BoucWen\n\n\nclass Mine(BoucWen):\n    """Own."""\n')
    monkeypatch.chdir(folder)
    out = folder / "own"
    assert run(["fit", str(loop), "--model", "mine.py:Mine", "--starts", "1", "--out", str(out)]) == 0
    monkeypatch.chdir(folder.parent)
    assert load_fit(out).name == "Mine"
    assert run(["fit", str(loop), "--model", str(folder / "mine.py:Yours")]) == 2
    assert "Mine" in capsys.readouterr().err  # the message lists the classes of the file


# -- compare, check, predict, report -------------------------------------------------------------------------------------


def test_compare_ranks_and_saves_the_winner(folder, loop, capsys):
    out = folder / "compared"
    assert run(["compare", str(loop), "--models", "bouc-wen", "--test-window", "2:", "--out", str(out)]) == 0
    assert (out / "comparison.txt").read_text().strip() in capsys.readouterr().out
    result = strict((out / "result.json").read_text())
    assert result["schema"] == "hystfit.compare/1"
    assert result["rows"][0]["name"] == "bouc-wen"
    assert set(result["test"]) == METRIC_KEYS
    assert load_fit(out / "winner").name == "bouc-wen"


def test_compare_by_the_future(folder, loop, capsys):
    out = folder / "future"
    assert run(["compare", str(loop), "--models", "bouc-wen", "--left-out", "future", "--out", str(out)]) == 0
    capsys.readouterr()
    result = strict((out / "result.json").read_text())
    assert result["left_out"] == "future"
    assert np.isfinite(result["rows"][0]["bic"])
    assert run(["compare", str(loop), "--left-out", "points"]) == 2
    assert "--left-out" in capsys.readouterr().err


@pytest.mark.usefixtures("findings_alone")
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
    same = lambda written: [note for note in written["notes"] if note["code"] == "same-file"]
    assert same(content)
    other = folder / "other.csv"
    other.write_text(loop.read_text() + "\n")
    assert run(["predict", str(fitted), str(other), "--out", str(out)]) == 0
    assert not same(strict((out / "result.json").read_text()))


def test_predict_reads_the_columns_that_were_fitted(folder, loop, capsys):
    """The voltage over the displacement, which no file tells by itself; of a file with other columns it says what it does without a fit."""
    swapped, columns = folder / "swapped", ["--input", "y_um", "--output", "u_V"]
    assert run(["fit", str(loop), "--model", "prandtl-ishlinskii-stop", *columns, "--out", str(swapped)]) in (0, 1)
    capsys.readouterr()
    for options in (columns, []):
        assert run(["predict", str(swapped), str(loop), *options, "--json"]) == 0
        assert strict(capsys.readouterr().out)["metrics"]["test"]["nrmse_percent"] < 10
    renamed = folder / "renamed.csv"
    renamed.write_text(loop.read_text().replace("t_s,u_V,y_um", "t_s,voltage_V,displacement_um"))
    assert run(["predict", str(swapped), str(renamed)]) == 2
    assert "unit" in capsys.readouterr().err


def test_predict_from_an_input_alone_warns_beyond_the_fitted_range(folder, fitted, capsys):
    path = folder / "input.csv"
    path.write_text("t_s,u_V\n" + "\n".join(f"{k / 800},{60 * np.sin(k / 90) ** 2}" for k in range(600)))
    arguments = ["predict", str(fitted), str(path), "--input-only", "--time", "t_s", "--input", "u_V", "--json"]
    assert run(arguments) == 0
    content = strict(capsys.readouterr().out)
    assert content["metrics"]["test"] is None
    assert [note["code"] for note in content["notes"]] == ["extrapolation", "record-parameters"]


def test_refit_offset_takes_the_mean_error_out(folder, loop, fitted, capsys):
    shifted = folder / "shifted.csv"
    rows = loop.read_text().splitlines()
    shifted.write_text(
        "\n".join([rows[0]] + [f"{r.rpartition(',')[0]},{float(r.rpartition(',')[2]) + 5}" for r in rows[1:]])
    )
    errors = []
    for extra in ([], ["--refit-offset"]):
        assert run(["predict", str(fitted), str(shifted), "--json", *extra]) == (0 if extra else 1)
        content = strict(capsys.readouterr().out)
        codes = [note["code"] for note in content["notes"]]
        assert ("offset-refitted" in codes, "record-parameters" in codes) == (bool(extra), not extra)
        assert content["status"] == ("ok" if extra else "poor")
        errors.append(content["metrics"]["test"]["rmse"])
    assert errors[0] == pytest.approx(5, abs=0.05)
    assert errors[1] < 0.02


@pytest.mark.parametrize(
    ("words", "package", "extra"),
    [
        (["sample", "FIT", "--sampler", "nuts"], "blackjax", "bayes"),
        (["sample", "FIT", "--sampler", "nested"], "blackjax", "bayes"),
        (["sample", "FIT", "--sampler", "emcee", "--out", "NEW"], "h5netcdf", "bayes"),
        (["sample", "FIT", "--sampler", "emcee", "--out", "NEW"], "xarray", "bayes"),
        (["sample", "FIT", "--sampler", "emcee", "--out", "NEW"], "corner", "bayes"),
        (["calibrate", "FIT", "--scheduler", "tcp://127.0.0.1:1"], "distributed", "batch"),
        (["batch", "LOOP", "--model", "bouc-wen", "--table", "parquet"], "pyarrow", "frames"),
        (["batch", "LOOP", "--model", "bouc-wen", "--table", "netcdf"], "xarray", "frames"),
        (["simulate", "bouc-wen", "--out", "NEW.nc"], "h5netcdf", "frames"),
        (["fit", "BOOK"], "openpyxl", "files"),
        (["fit", "TABLE"], "h5py", "files"),
    ],
)
def test_a_verb_names_the_extra_that_it_lacks_and_leaves_nothing(
    words, package, extra, loop, fitted, tmp_path, monkeypatch, capsys
):
    """Before any work: a package that is not installed is found at once."""
    (tmp_path / "a.xlsx").write_bytes(b"PK\x03\x04")
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    names = {"FIT": fitted, "LOOP": loop, "NEW": tmp_path / "new", "NEW.nc": tmp_path / "new.nc"}
    names |= {"BOOK": tmp_path / "a.xlsx", "TABLE": tmp_path / "a.h5"}
    monkeypatch.setitem(sys.modules, package, None)
    assert run([str(names.get(word, word)) for word in words]) == 2
    assert f"{package!r}: pip install 'hystfit-jax[{extra}]'" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.h5", "a.xlsx"]


def test_a_missing_module_is_named_by_its_package():
    with pytest.raises(HystfitError, match="package 'absent': pip install"):
        optional("absent.part", "frames", "reading")


def test_the_report_names_the_user_own_files(folder, loop, fitted, tmp_path, capsys):
    """The commands at its top can be pasted into a shell, wherever the fit and the loop are; without --out there is no fit to name."""
    out = tmp_path / "my fit"
    assert run(["fit", str(loop), "--time=0", "--model", "bouc-wen", "--out", str(out), "--starts", "1"]) == 0
    predict = f"hystfit predict '{out}' NEW_LOOP --time=0"
    assert f"      {predict}\n" in (out / "report.txt").read_text()
    assert run([str(loop) if word == "NEW_LOOP" else word for word in shlex.split(predict)[1:]]) == 0
    rows = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", (out / "report.html").read_text(), re.DOTALL))
    assert html.unescape(rows["Next"]).splitlines()[1] == f"hystfit invert '{out}' REFERENCE"
    capsys.readouterr()
    assert run(["fit", str(loop), "--time=0", "--model", "bouc-wen", "--starts", "1"]) == 0
    assert "repeat the command with --out fit to save this fit" in " ".join(capsys.readouterr().out.split())
    saved = load_fit(out)
    (tmp_path / "again").mkdir()
    saved.save(tmp_path / "again" / "x")
    assert (
        f"hystfit export {tmp_path / 'again' / 'x'} --c code" in (tmp_path / "again" / "x" / "report.html").read_text()
    )
    poor = dataclasses.replace(saved, status=Status.NOT_CONVERGED)
    assert f"hystfit check {loop}" in " ".join(text_report(poor).split())
    text = text_report(poor, Wording(split="--window=:2", translate=as_options))
    assert f"      hystfit compare {loop} --time=0 --window=:2\n" in text
    page = html_report(poor, wording=Wording(translate=as_options))
    assert "--method trf" in page
    assert "method=" not in page


def test_every_part_of_the_page_of_a_fit_names_options_as_at_the_shell(tmp_path):
    u = 3 * np.sin(np.linspace(0, 20, 300))
    y = np.asarray(hf.simulate(hf.BoucWen(c=1.0, mu=0.5, tau=1.0, rho=0.5), u)[0])
    loop, out = tmp_path / "loop.csv", tmp_path / "fit"
    np.savetxt(loop, np.column_stack([u, y]), delimiter=",")
    assert run(["fit", str(loop), "--model", "bouc-wen", "--starts", "1", "--out", str(out)]) == 0
    page = html.unescape(re.sub("<[^>]*>", "", (out / "report.html").read_text()))
    assert "--units V,um names both" in page
    assert "set --input 1 and --output 0" in page
    assert not re.search(r"\b(input|output|units)='", page)


@pytest.mark.usefixtures("few_families")
def test_check_proposes_to_read_each_curve_as_a_record(tmp_path, capsys):
    """Loops of one stroke may be cycles of one experiment; those of different strokes are read as records by themselves."""
    u = 5 * np.sin(np.linspace(0, 2 * np.pi, 60))
    rows = [f"{k},{a:.4f},{bouc:.4f}" for k in (1, 2) for a, bouc in zip(u, bouc_wen(u), strict=True)]
    (tmp_path / "two.txt").write_text("loop;H_A_per_m;B_T\n" + "\n".join(rows).replace(",", ";") + "\n")
    assert run(["check", str(tmp_path / "two.txt"), "--delimiter=;"]) == 0
    *above, command = capsys.readouterr().out.strip().splitlines()
    assert shlex.split(command)[2:5] == [str(tmp_path / "two.txt"), "--by=loop", "--delimiter=;"]
    (advised,) = (line for line in above if line.startswith("hystfit fit "))
    assert "--model" in advised
    assert "--by" not in advised  # the model was compared on the cycles as one record


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
BAD = [  # arguments, and what the message must name: the file, option, parameter or value that is wrong, or the remedy
    (["fit", "missing.csv"], "missing.csv"),
    (["fit", "stage-sin"], "stage-sine"),
    (["fit", "."], "'.'"),
    (["fit", "empty.csv"], "empty.csv"),
    (["fit", "one.csv"], "one.csv"),
    (["fit", "flat.csv"], "flat.csv"),
    (["fit", "flat.csv", "--input", "u_V", "--output", "y_um", "--model", "bouc-wen"], "flat"),
    (["fit", "gap.csv"], "--gaps split"),
    (["fit", "words.csv"], "words.csv"),
    (["fit", "LOOP", "--model", "buc-wen"], "duhem, bouc-wen"),
    (["fit", "LOOP", "--model", "lag"], "'lag'"),
    (["fit", "LOOP", "--model", "nofile.py:Mine"], "no file 'nofile.py' with the class 'Mine'"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "A=1"], "c, mu, tau"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu=7"], "[0, 1]"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu=nan"], "mu"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu=half"], "'half'"),
    (["fit", "LOOP", "--model", "bouc-wen", "--free", "zz"], "'zz'"),
    (["fit", "LOOP", "--model", "bouc-wen", "--fix", "mu", "--free", "mu"], "mu"),
    (["fit", "LOOP", "--fix", "mu=0.5"], "--model bouc-wen"),
    (["fit", "LOOP", "--start", "magic"], "--start"),
    (["fit", "LOOP", "--method", "rls", "--fix", "alpha=1"], "--fix"),
    (["fit", "LOOP", "--model", "bouc-wen", "--starts", "0"], "got 0"),
    (["fit", "LOOP", "--input", "Volt"], "0: 't_s'; 1: 'u_V'; 2: 'y_um'"),
    (["fit", "LOOP", "--output", "9"], "9"),
    (["fit", "LOOP", "--time", "none", "--model", "bouc-wen+viscous"], "--time"),
    (["fit", "LOOP", "--only", "3"], "--by"),
    (["fit", "LOOP", "--window", "90:99"], "from 0 to"),
    (["fit", "LOOP", "--window", "5"], "start:stop"),
    (["fit", "LOOP", "--window", "3:2"], "'3:2'"),
    (["fit", "LOOP", "--test-window", "0:3"], "'loop'"),
    (["fit", "LOOP", "--window", "0:2", "--test-window", "1:3"], "--test-window"),
    (["fit", "LOOP", "--test", "LOOP"], "--test-window"),
    (["fit", "LOOP", "--test", "missing.csv"], "missing.csv"),
    (["fit", "LOOP", "--refit-offset"], "--test"),
    (["fit", "stage-sine", "--input", "1"], "--input"),
    (["fit", "stage-sine", "--only", "1"], "--only 1"),
    (["fit", "LOOP", "--out", "plain/x"], "'plain/x'"),
    (["fit", "LOOP", "--out", "plain"], "'plain'"),
    (["fit", "LOOP", "--out", "no/such"], "the folder 'no' does not exist"),
    (["fit"], "LOOP"),
    (["fot"], "fit"),
    (["fit", "LOOP", "--modle", "duhem"], "--model"),
    (["compare", "LOOP", "--models", "duhem", "bouc-wen"], "'bouc-wen'"),
    (["fit", "LOOP", "--method", "ukf", "--noise", "ou"], "--noise"),
    (["fit", "LOOP", "--method", "rls", "--starts", "3"], "--starts"),
    (["fit", "LOOP", "--method", "rls", "--floor", "1"], "'floor'"),
    (["fit", "LOOP", "--forgetting", "0.9"], "--method rls"),
    (["fit", "LOOP", "--method", "gradient-correction", "--weights", "1;2"], "--weights"),
    (["fit", "LOOP", "--method", "rls", "--basis", "chebyshev"], "legendre"),
    (["compare", "LOOP", "--models", "bouc-wen,foo"], "'foo'"),
    (["compare", "LOOP", "--out", "plain/x"], "'plain/x'"),
    (["check", "one.csv"], "one.csv"),
    (["predict", "nofit", "LOOP"], "nofit"),
    (["predict", "FIT", "missing.csv"], "missing.csv"),
    (["predict", "FIT", "LOOP", "--window", "50:"], "50"),
    (["predict", "FIT", "LOOP", "--input-only", "--output", "y_um"], "--output does not apply"),
    (["report", "nofit"], "nofit"),
    (["simulate", "stage", "--signal", "saw", "--out", "x.csv"], "sine, triangle"),
    (["simulate", "stage", "--frequence", "2", "--out", "x.csv"], "duration, rate, frequency"),
    (["simulate", "stage", "--frequency", "fast", "--out", "x.csv"], "--frequency"),
    (["simulate", "bouc-wen", "--set", "mu", "--out", "x.csv"], "--set mu=1"),
    (["simulate", "bouc-wen", "--set", "mu=3", "--out", "x.csv"], "[0, 1]"),
    (["simulate", "stage"], "--out data.csv"),
    (["simulate", "stage", "--out", "no/x.csv"], "the folder 'no' does not exist"),
    (["models", "foo"], "'foo'"),
    (["datasets", "foo"], "'foo'"),
    (["datasets", "--out", "x.csv"], "hystfit datasets NAME"),
]


@pytest.fixture(scope="module")
def bad_folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("bad")
    for name, text in BAD_FILES.items():
        (place / name).write_text(text)
    (place / "plain").write_text("a regular file")
    return place


@pytest.mark.parametrize(("arguments", "name"), BAD, ids=[" ".join(arguments) for arguments, _ in BAD])
def test_bad_input_is_one_message_and_status_2(arguments, name, bad_folder, loop, fitted, monkeypatch, capsys):
    monkeypatch.chdir(bad_folder)
    before = {path: path.stat().st_mtime_ns for path in bad_folder.rglob("*")}
    places = {"LOOP": str(loop), "FIT": str(fitted)}
    assert run([places.get(word, word) for word in arguments]) == 2
    printed = capsys.readouterr()
    assert name in printed.err
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
    for content in (
        "{",
        '{"schema": "other/1"}',
        '{"schema": "hystfit.fit/1"}',
        '{"schema": "hystfit.fit/3"}',
        "[]",
        *by_hand,
    ):
        (damaged / "result.json").write_text(content)
        assert run(["report", str(damaged)]) == 2
        assert str(damaged) in capsys.readouterr().err


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


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize("option", ["--method", "--noise", "--loss"])
def test_help_lists_the_choices_that_the_library_accepts(option, loop, capsys):
    assert run(["fit", str(loop), "--model", "bouc-wen", option, "magic"]) == 2
    message = capsys.readouterr().err
    assert "'magic'" in message
    names = (
        message.partition("one of ")[2].partition(", or ")[0].partition(", got")[0].partition("; got")[0].split(", ")
    )
    assert len(names) > 3
    assert run(["fit", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert all(name in text for name in names)


@pytest.mark.parametrize("verb", list(VERBS))
def test_help_of_a_verb_ends_with_commands_that_can_be_typed(verb, monkeypatch, capsys):
    """Each example parses and takes one line of 80 columns; no description is broken in mid-sentence but at the margin."""
    monkeypatch.setenv("COLUMNS", "80")
    assert run([verb, "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    shown = [line.strip() for line in lines if line.startswith("  hystfit ")]
    assert shown == list(EXAMPLES[verb])
    for line in shown:
        assert shlex.split(line)[1] == verb
        app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)
    assert max(map(len, lines)) <= 80


def test_the_help_of_invert_names_both_folders_that_it_takes(capsys):
    assert run(["invert", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "`hystfit fit --out`" in text
    assert "`hystfit sample --out`" in text


def test_descriptions_in_help_are_broken_at_the_margin_only(monkeypatch, capsys):
    """A line that goes on below is filled: its text and the first word below would not fit."""
    monkeypatch.setenv("COLUMNS", "80")
    assert run(["fit", "--help"]) == 0
    rows = [line[1:-1].rstrip() for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    pairs = [(above, below.split()[0]) for above, below in itertools.pairwise(rows) if below.startswith(" " * 8)]
    assert len(pairs) > 20
    assert [pair for pair in pairs if len(pair[0]) + 1 + len(pair[1]) <= 77] == []


def test_the_list_of_verbs_begins_with_those_of_a_first_session(capsys):
    assert run(["--help"]) == 0
    listed = re.findall(r"^│ ([a-z]+) ", capsys.readouterr().out, flags=re.MULTILINE)
    assert listed == list(VERBS)
    assert listed[:2] == ["check", "fit"]


def test_windows_and_held_parameters_are_read():
    assert bounds_of("5:25") == (5.0, 25.0)
    assert bounds_of(":27") == (None, 27.0)
    assert bounds_of("25:") == (25.0, None)
    assert bounds_of(None) is None
    assert named_values(["c=0.1", "w[2]", "mu = 3"]) == {"c": 0.1, "w[2]": None, "mu": 3.0}
    for wrong in (["c=1", "c=2"], ["=1"], [""]):
        with pytest.raises(HystfitError):
            named_values(wrong)


def test_messages_name_options_as_the_shell_does(capsys):
    assert (
        as_options("gaps='split' makes a record; give by= or output=")
        == "--gaps split makes a record; give --by or --output"
    )
    assert as_options("set --input and --output (input=, output=) to be sure") == "set --input and --output to be sure"
    assert as_options("reads again: --smooth 9 (smooth='9')") == "reads again: --smooth 9"
    assert as_options("leave it out (window=)") == "leave it out (--window)"
    assert as_options("time=False reads without time") == "--time none reads without time"
    assert as_options("use left_out='blocks'; scheduler= needs") == "use --left-out blocks; --scheduler needs"
    assert as_options("give limits=(low, high)") == "give limits=(low, high)"
    show("use noise='discrepancy'", {}, as_json=False)
    assert capsys.readouterr().out == "use --noise discrepancy\n"
    for name in ("record 'level=3'", "offset@level=3", "resolution='fine'", "--fix mu=0.5"):  # not options of any verb
        assert as_options(name) == name


def test_curves_of_one_file_are_split_into_fit_and_test(folder, loop):
    from hystfit.cli.options import Split
    from hystfit.cli.records import train_and_test

    rows = [line.split(",")[1:] for line in loop.read_text().splitlines()[1:]]
    path = folder / "curves.csv"
    path.write_text("loop,u_V,y_um\n" + "\n".join(f"{k // 80 + 3},{u},{y}" for k, (u, y) in enumerate(rows)))
    train, test = train_and_test([str(path)], Reading(by="loop"), Split(test_only="5"))
    assert [record.name for record in train] == ["loop=3", "loop=4"]
    assert [record.name for record in test] == ["loop=5"]
    train, test = train_and_test([str(path)], Reading(by="loop", only="0:1"), Split(test_only="1::1"))
    assert [[record.name for record in part] for part in (train, test)] == [["loop=3"], ["loop=4", "loop=5"]]
    train, test = train_and_test([str(path)], Reading(by="loop", only="3"), Split(window="10:50"))
    assert (int(train[0].used.sum()), test) == (40, None)


def test_public_names_are_all_there():
    import hystfit

    for name in hystfit.__all__:
        assert getattr(hystfit, name) is not None
    with pytest.raises(AttributeError):
        _ = hystfit.nothing
    assert dataclasses.is_dataclass(hystfit.FitResult)
