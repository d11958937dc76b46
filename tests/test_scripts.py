"""The scripts to copy run as they are."""

import json
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


@pytest.mark.usefixtures("as_users_run")
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
