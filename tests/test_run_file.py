"""`hystfit run`: the steps of a run file, what is run again, what stops, and what is refused before the first step."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hystfit.cli import run
from hystfit.cli.run_file import Study

from .test_docs import blocks

STEPS = """
[steps.device]
verb = "simulate"
what = "bouc-wen"
duration = 2
rate = 20

[steps.look]
verb = "check"
loops = ["{device}/data.csv", "loop.csv"]
"""


def write_loop(folder: Path, gain: float = 1.0) -> None:
    t = np.arange(40) / 20
    u = np.sin(2 * np.pi * t)
    table = np.column_stack([t, u, gain * np.sin(2 * np.pi * t - 0.2)])
    np.savetxt(folder / "loop.csv", table, delimiter=",", header="t_s,u,y", comments="")


@pytest.fixture
def study(tmp_path):
    write_loop(tmp_path)
    file = tmp_path / "study.toml"
    file.write_text(STEPS, encoding="utf-8")
    return file


def outcomes(study: Path) -> dict[str, tuple[int | None, str]]:
    rows = json.loads((study.parent / "study" / "run.json").read_text())["steps"]
    return {row["step"]: (row["exit_status"], row.get("outcome", "")) for row in rows}


@pytest.mark.usefixtures("findings_alone")
def test_steps_run_once_and_again_where_their_inputs_change(study, capsys):
    out = study.parent / "study"
    assert run(["run", str(study)]) == 0
    assert outcomes(study) == {"device": (0, "run"), "look": (0, "run")}
    first = (out / "look" / "result.json").read_bytes()
    assert len(json.loads(first)["provenance"]["records"]) == 2

    assert run(["run", str(study)]) == 0
    assert outcomes(study) == {"device": (0, "unchanged"), "look": (0, "unchanged")}
    assert (out / "look" / "result.json").read_bytes() == first

    (out / "look" / "check.txt").unlink()
    assert run(["run", str(study)]) == 0
    assert outcomes(study) == {"device": (0, "unchanged"), "look": (0, "run")}

    (out / "look" / "stale.txt").touch()
    write_loop(study.parent, gain=2.0)
    capsys.readouterr()
    assert run(["run", str(study), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)  # the text of the verbs is not among the JSON
    assert [row["outcome"] for row in content["steps"]] == ["unchanged", "run"]
    assert not (out / "look" / "stale.txt").exists()  # a result of other inputs is replaced as a whole

    study.write_text(STEPS.replace("rate = 20", "rate = 21"), encoding="utf-8")
    assert run(["run", str(study)]) == 0
    assert outcomes(study) == {"device": (0, "run"), "look": (0, "run")}


@pytest.mark.usefixtures("findings_alone")
def test_the_worst_status_counts_and_what_needs_a_failed_step_is_not_run(study):
    last = '\n[steps.last]\nverb = "check"\nloops = "up.csv"\n'
    np.savetxt(study.parent / "up.csv", np.arange(80.0).reshape(40, 2), delimiter=",", header="u,y", comments="")
    study.write_text(STEPS.replace("rate = 20", "rate = -1") + last, encoding="utf-8")
    assert run(["run", str(study)]) == 2
    assert outcomes(study) == {"device": (2, "run"), "look": (None, "needs device"), "last": (1, "run")}
    study.write_text(STEPS + last, encoding="utf-8")
    assert run(["run", str(study)]) == 1
    assert outcomes(study) == {"device": (0, "run"), "look": (0, "run"), "last": (1, "unchanged")}


def test_steps_run_after_those_that_they_need_with_the_seed_of_the_study(study, capsys):
    text = 'seed = 7\n[steps.fit]\nloops = "{device}/data.csv"\nstarts = 2\nmodel = "bouc-wen"\n'
    text += '[steps.device]\nverb = "simulate"\nwhat = "stage"\nfrequency = 2\nset = ["gamma=0"]\n'
    study.write_text(text, encoding="utf-8")
    assert run(["run", str(study), "--dry-run"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "hystfit simulate stage --frequency=2 --set=gamma=0 --seed=7 --out=study/device",
        "hystfit fit study/device/data.csv --starts=2 --model=bouc-wen --seed=7 --out=study/fit",
    ]
    assert not (study.parent / "study").exists()


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "no steps"),
        ("steps = 3", "steps must be a table"),
        ("[steps.fit\nloops = 1", "line 1"),
        ('sed = 1\n[steps.check]\nloops = "loop.csv"', "did you mean 'seed'"),
        ('seed = "a"\n[steps.check]\nloops = "loop.csv"', "seed must be a whole number"),
        ('[steps.fit]\nloops = "loop.csv"\nmodle = "duhem"', "did you mean 'model'"),
        ('[steps.fitt]\nloops = "loop.csv"', "did you mean 'fit'"),
        ('[steps.fit]\nloops = "loop.csv"\nstarts = "many"', "starts"),
        ('[steps.fit]\nloops = "loop.csv"\nstarts = true', "starts"),
        ('[steps.fit]\nloops = "loop.csv"\nintegrate = "yes"', "integrate must be true or false"),
        ('[steps.fit]\nloops = "loop.csv"\nstart = "guess"', "start"),
        ('[steps.fit]\nloops = "loop.csv"\nmodel = ["duhem", "bouc-wen"]', "model"),
        ('[steps.fit]\nloops = "loop.csv"\nout = "x"', "out"),
        ('[steps.models]\nname = "duhem"', "writes no folder"),
        ("[steps.sample]\ndraws = 10", "FITDIR"),
        ('[steps.fit]\nloops = "loop.csv"\n[steps.sample]\nfitdir = "{fitt}"', "did you mean 'fit'"),
        ('[steps.a]\nverb = "sample"\nfitdir = "{b}"\n[steps.b]\nverb = "errors"\nfitdir = "{a}"', "in a cycle"),
        ('[sha256]\n"loop.csv" = "00"\n[steps.check]\nloops = "loop.csv"', "has SHA-256"),
        ('[sha256]\n"gone.csv" = "00"\n[steps.check]\nloops = "loop.csv"', "'gone.csv'"),
        ('[steps."a/b"]\nverb = "check"\nloops = "loop.csv"', "letters"),
    ],
)
@pytest.mark.usefixtures("as_users_run")
def test_bad_files_are_refused_before_the_first_step(study, text, named, capsys):
    study.write_text(text, encoding="utf-8")
    assert run(["run", str(study)]) == 2
    assert named in capsys.readouterr().err
    assert not (study.parent / "study").exists()


@pytest.mark.usefixtures("findings_alone")
def test_what_is_not_of_the_study_is_left_alone(study, capsys):
    kept = study.parent / "study" / "device" / "notes.txt"
    kept.parent.mkdir(parents=True)
    kept.write_text("mine")
    assert run(["run", str(study)]) == 2
    assert "move it away" in capsys.readouterr().err
    assert kept.read_text() == "mine"
    assert run(["run", str(study.parent / "gone.toml")]) == 2
    assert "gone.toml" in capsys.readouterr().err


def test_a_process_from_another_folder_with_pinned_data_resumes_after_a_kill(study):
    digest = hashlib.sha256((study.parent / "loop.csv").read_bytes()).hexdigest()
    study.write_text(f'[sha256]\n"loop.csv" = "{digest}"\n{STEPS}', encoding="utf-8")
    command = [sys.executable, "-m", "hystfit", "run", str(study)]
    first = subprocess.Popen(command, cwd="/", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    state, patience = study.parent / "study" / "run.json", time.monotonic() + 60
    while not state.exists() and time.monotonic() < patience:
        time.sleep(0.02)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    assert outcomes(study)["device"] == (130, "started")
    second = subprocess.run(command, cwd="/", capture_output=True, text=True, timeout=120)
    assert (second.returncode, second.stderr) == (0, "")
    assert "it did not finish" in second.stdout
    assert outcomes(study) == {"device": (0, "run"), "look": (0, "run")}


def test_the_run_file_of_the_guide_is_valid(tmp_path):
    (text,) = blocks("docs/guide/run-file.md", "toml")
    file = tmp_path / "study.toml"
    file.write_text(text, encoding="utf-8")
    steps = {step.name: step for step in Study.read(file).steps}
    assert steps["sample"].arguments[:2] == ("sample", "study/fit")
    assert steps["other"].needs == ("fit",)


def test_a_dry_run_refuses_a_step_without_its_loop(tmp_path, capsys):
    (tmp_path / "study.toml").write_text('[steps.fit]\nmodel = "bouc-wen"\n')
    assert run(["run", str(tmp_path / "study.toml"), "--dry-run"]) == 2
    assert "LOOP is missing" in capsys.readouterr().err


def test_a_misspelled_loop_is_an_unknown_key(tmp_path, capsys):
    (tmp_path / "study.toml").write_text('[steps.fit]\nlops = "loop.csv"\n')
    assert run(["run", str(tmp_path / "study.toml"), "--dry-run"]) == 2
    assert "unknown key 'lops' (did you mean 'loops'" in capsys.readouterr().err
