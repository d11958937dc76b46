"""The verbs that use a fit on a device: invert and export."""

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import scipy.io

import hystfit as hf
from hystfit.cli import run
from hystfit.results.saved import load_fit


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("control") / "fit"
    assert run(["fit", "stage-sine", "--model", "bouc-wen", "--out", str(folder)]) == 0
    return folder


def test_invert_writes_an_input_that_the_model_follows(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(200) * 0.01
    wanted = 5 - 3 * np.cos(2 * np.pi * 0.5 * t)
    lines = ["t_s,wanted_um", *(f"{a!r},{b!r}" for a, b in zip(t.tolist(), wanted.tolist(), strict=True))]
    (tmp_path / "reference.csv").write_text("\n".join(lines) + "\n")
    command = ["invert", str(fitted), str(tmp_path / "reference.csv"), "--output", "wanted_um", "--time", "t_s"]
    assert run([*command, "--out", str(tmp_path / "out")]) == 0
    head, *lines_found = (tmp_path / "out" / "inverse.csv").read_text().splitlines()
    assert head == "t_s,reference_um,u_V,y_um,status"
    rows = [line.split(",") for line in lines_found]
    u = np.array([float(row[2]) for row in rows])
    y = np.asarray(hf.simulate(load_fit(fitted).model, u)[0])
    np.testing.assert_allclose(y, wanted, atol=1e-9)
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    fitted_input = hf.datasets.load(
        "stage-sine"
    ).u  # 0 to 60 V or so: no voltage below 0, which a unipolar stack does not bear
    assert content["limits"] == {"lowest": fitted_input.min(), "highest": fitted_input.max(), "given": False}
    # A reference beyond the limits is finished, but missed.
    assert run([*command, "--limits", "0:20", "--out", str(tmp_path / "held")]) == 1
    content = json.loads((tmp_path / "held" / "result.json").read_text())
    assert content["status"] == "missed"
    assert [note["code"] for note in content["notes"]] == ["missed"]
    assert content["counts"]["saturated"] > 0
    assert content["input"]["highest"] == 20.0
    # From a device that rested at 0 V.
    run([*command, "--rest", "0", "--out", str(tmp_path / "rested")])
    assert json.loads((tmp_path / "rested" / "result.json").read_text())["rest"] == 0.0
    table = np.genfromtxt(tmp_path / "rested" / "inverse.csv", delimiter=",", skip_header=1, usecols=(2, 3))
    simulated = np.asarray(hf.simulate(load_fit(fitted).model, np.concatenate([[0.0], table[:, 0]]))[0])[1:]
    np.testing.assert_allclose(table[:, 1], simulated, atol=1e-9)
    assert np.abs(table[:, 0] - u).max() > 0.1
    # A reference has no input, and no option for one.
    for option in ("--input", "--smooth", "--sigma"):
        assert run([*command, option, "1"]) == 2
    capsys.readouterr()
    for bad in ("0:", "5:1", "a:b", "nan:3"):
        assert run([*command, "--limits", bad]) == 2
        assert f"got {bad!r}" in capsys.readouterr().err
    # Rows without a value of the reference are reported.
    lines[5] = f"{t[4].item()!r},"
    (tmp_path / "reference.csv").write_text("\n".join(lines) + "\n")
    assert run([*command, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert sum(content["counts"].values()) == 199
    assert "left-out" in [note["code"] for note in content["reading"]]


@pytest.mark.parametrize("name", ["", "wanted_um"])
def test_the_reference_is_the_column_like_the_fitted_output(name: str, fitted: Path, tmp_path: Path) -> None:
    """By its name, or by its quantity; without the fit, a magnetic moment is the likelier output."""
    record = hf.load_fit(fitted).data[0].segment(0, 120)
    header = f"{name or record.y_name},M_emu"
    rows = [f"{b!r},{a!r}" for a, b in zip(record.u.tolist(), record.y.tolist(), strict=True)]
    (tmp_path / "reference.csv").write_text("\n".join([header, *rows]) + "\n")
    run(["invert", str(fitted), str(tmp_path / "reference.csv"), "--out", str(tmp_path / "out")])
    head, *lines = (tmp_path / "out" / "inverse.csv").read_text().splitlines()
    at = head.split(",").index("reference_um")
    np.testing.assert_array_equal([float(line.split(",")[at]) for line in lines], record.y)
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    assert any("of the fit" in note["text"] for note in content["reading"] if note["code"] == "column-choice")


def test_export_writes_for_matlab_and_simulink(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = hf.load_fit(fitted)
    assert run(["export", str(fitted), "--mat", str(tmp_path / "fit.mat")]) == 0
    fit = scipy.io.loadmat(tmp_path / "fit.mat", simplify_cells=True)["fit"]
    assert (fit["model"], fit["status"], fit["units"]["y"]) == (result.name, str(result.status), "um")
    for k, name in enumerate(fit["parameters"]["name"]):
        estimate = result[str(name)]
        assert fit["parameters"]["value"][k] == estimate.value
        assert fit["parameters"]["stderr"][k] == pytest.approx(estimate.stderr or np.nan, nan_ok=True)
    np.testing.assert_array_equal(fit["covariance"], result.covariance)
    record = fit["records"]
    np.testing.assert_array_equal(record["y"], result.data[0].y)
    np.testing.assert_allclose(record["y"] - record["predicted"], result.residuals, atol=1e-12)
    assert run(["export", str(fitted), "--c", str(tmp_path / "c"), "--s-function"]) == 0
    assert (tmp_path / "c" / "hysteresis_sfun.c").is_file()
    for bad in ([], ["--s-function", "--mat", "x.mat"], ["--mat", str(tmp_path / "no" / "fit.mat")]):
        assert run(["export", str(fitted), *bad]) == 2
    assert "--c FOLDER" in capsys.readouterr().err


def test_a_fit_as_an_xarray_data_set(fitted: Path) -> None:
    result = hf.load_fit(fitted)
    data = result.to_xarray()
    assert float(data["value"].sel(parameter="c")) == result["c"].value
    assert float(data["covariance"].sel(free="c", free_too="c")) == pytest.approx(result["c"].stderr ** 2)  # type: ignore[operator]
    np.testing.assert_allclose((data["y"] - data["predicted"]).values, result.residuals, atol=1e-12)
    assert (data["u"].attrs["units"], data["t"].attrs["units"], set(data["record"].values)) == (
        "V",
        "s",
        {"stage-sine"},
    )


def test_export_writes_c(fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", str(fitted), "--c", str(tmp_path / "c"), "--name", "stack"]) == 0
    assert sorted(file.name for file in (tmp_path / "c").iterdir()) == ["stack.c", "stack.h", "stack_main.c"]
    *_, compile_it, run_it = capsys.readouterr().out.splitlines()
    if shutil.which("cc"):
        shell = f"{compile_it}\n{run_it}".replace("-o stack", f"-o {tmp_path}/stack").replace(
            "./stack", f"{tmp_path}/stack"
        )
        outputs = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, check=True).stdout.split()
        low, middle, high = (float(word.split()[0]) for word in shlex.split(run_it.replace("|", " "))[2:5])
        result = hf.load_fit(fitted)
        expected = hf.simulate(result.model, np.array([low, middle, high]), result.data.sampling_interval)[0][1:]
        np.testing.assert_allclose([float(value) for value in outputs], expected, rtol=1e-9)
    header = (tmp_path / "c" / "stack.h").read_text()
    edges = [float(re.search(rf"#define STACK_{edge} \(?([^\s)]+)", header)[1]) for edge in ("LOW", "HIGH")]  # type: ignore[index]
    fitted_input = hf.datasets.load("stage-sine").u
    assert edges == [fitted_input.min(), fitted_input.max()]
    assert run(["export", str(fitted), "--c", str(tmp_path / "c"), "--name", "2nd"]) == 2
