"""The scripts to copy run as they are."""

import json
import re
import runpy
import sys

import numpy as np
import pytest

from hystfit.cli import run

from .conftest import ROOT

SCRIPTS = ROOT / "experiments" / "scripts"
LONG = ("folder_of_loops", "posterior_study")  # of test_batch and test_sampling in small
CASES = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in LONG else [])
    for path in sorted(SCRIPTS.glob("*.py"))
]


@pytest.mark.usefixtures("as_users_run", "findings_alone")
@pytest.mark.parametrize("script", CASES)
def test_a_script_runs(script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(script), str(tmp_path / "out")])
    monkeypatch.chdir(tmp_path)
    found = runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out
    if "result" in found:
        assert abs(found["result"]["c"].value - 0.1542) < 0.008  # the actuator that made the records, which creeps
    if script.stem == "inverse_for_trajectory":
        assert np.abs(found["error"][5:]).max() < 1e-6


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.slow
def test_a_copied_script_runs_on_a_loop_that_does_not_determine_all_parameters(tmp_path, monkeypatch, capsys):
    t = np.arange(0, 12, 0.02)
    u = 3 * np.sin(t)
    np.savetxt(tmp_path / "loop.csv", np.column_stack([t, u, 2 * u]), delimiter=",", header="t_s,u_V,y_um", comments="")
    text = re.sub(
        r"^FILE = .*$", 'FILE = "loop.csv"', (SCRIPTS / "one_loop.py").read_text(encoding="utf-8"), flags=re.MULTILINE
    )
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["mine.py", "out"])
    monkeypatch.chdir(tmp_path)
    result = runpy.run_path("mine.py", run_name="__main__")["result"]
    unknown = [name for name in result.free_names if result[name].stderr is None]
    assert unknown
    rows = {
        line.split()[0]: line.split()[3]
        for line in capsys.readouterr().out.splitlines()
        if re.match(r"\w+ +\S+ \+- ", line)
    }
    assert [name for name in result.free_names if rows[name] == "-"] == unknown


@pytest.mark.usefixtures("findings_alone")
def test_the_run_file_runs(tmp_path):
    text = (SCRIPTS / "study.toml").read_text(encoding="utf-8").replace("../../data", (ROOT / "data").as_posix())
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    assert run(["run", str(tmp_path / "study.toml")]) == 0
    steps = json.loads((tmp_path / "out" / "run.json").read_text())["steps"]
    assert [(row["step"], row["exit_status"]) for row in steps] == [
        ("check", 0),
        ("fit", 0),
        ("held-out", 0),
        ("export", 0),
    ]
