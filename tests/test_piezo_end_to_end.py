"""The way of a piezo actuator from its record to the board, at the shell: fit, sample, invert, export, compile, run."""

import json
from pathlib import Path

import numpy as np
import pytest

from hystfit.cli import run
from tests.test_export import compiled
from tests.test_export import run as through


def columns(path: Path) -> dict[str, np.ndarray]:
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    return {name: table[name] for name in table.dtype.names}


@pytest.mark.slow
def test_the_default_winner_of_a_piezo_record_reaches_the_board(measured: Path, tmp_path: Path, capsys) -> None:
    rows = np.genfromtxt(measured / "piezo_dbo" / "Model_Vi_Do.dat")[
        :1000, [0, 4]
    ]  # with the step from rest that starts the record
    dt, t = 0.005, 0.005 * np.arange(1000)
    loop, fit = tmp_path / "loop.csv", tmp_path / "fit"
    np.savetxt(loop, np.column_stack([t, rows]), delimiter=",", header="t_s,u_V,y_um", comments="", fmt="%.9g")
    assert run(["fit", str(loop), "--out", str(fit)]) == 0
    result = json.loads((fit / "result.json").read_text())
    assert result["metrics"]["train"]["nrmse_percent"] < 0.4
    assert result["model"].startswith("lag")

    # It has 40 plays with three envelopes each, behind a time constant: the weights are sampled exactly, the constant beside them.
    posterior = tmp_path / "posterior"
    quick = ["--draws", "60", "--warmup", "20", "--chains", "2"]
    assert run(["sample", str(fit), *quick, "--out", str(posterior)]) in (
        0,
        1,
    )  # few draws, which may not have converged
    assert json.loads((posterior / "result.json").read_text())["sampler"] == "weights"

    # What the model answers to a slow drive is a reference that the actuator can follow from its first sample on.
    drive = np.interp(t[:300], [0, 0.5, 1.1, 1.5], [rows[0, 0], 3.2, 0.6, 2.0])
    inputs = tmp_path / "drive.csv"
    np.savetxt(inputs, np.column_stack([t[:300], drive]), delimiter=",", header="t_s,u_V", comments="", fmt="%.9g")
    only = ["--input-only", "--input", "u_V", "--time", "t_s"]
    assert run(["predict", str(fit), str(inputs), *only, "--out", str(tmp_path / "answer")]) == 0
    wanted = columns(tmp_path / "answer" / "prediction.csv")["predicted_um"]
    reference = tmp_path / "reference.csv"
    np.savetxt(
        reference, np.column_stack([t[:300], wanted]), delimiter=",", header="t_s,y_um", comments="", fmt="%.15g"
    )
    assert (
        run(["invert", str(fit), str(reference), "--output", "y_um", "--time", "t_s", "--out", str(tmp_path / "u")])
        == 0
    )
    inverse = columns(tmp_path / "u" / "inverse.csv")
    assert set(inverse["status"]) == {"ok"}

    board = tmp_path / "board"
    assert run(["export", str(fit), "--c", str(board), "--name", "stack"]) == 0
    program = compiled(board / "stack.c", board / "stack_main.c")
    assert run(["predict", str(fit), str(loop), "--out", str(tmp_path / "predicted")]) == 0
    predicted = columns(tmp_path / "predicted" / "prediction.csv")["predicted_um"]
    forward = through(program, "f", float(rows[0, 0]), rows[:, 0], dt)[:, 0]
    span = np.ptp(rows[:, 1])
    assert np.abs(forward - predicted).max() <= 1e-9 * span
    u0 = inverse["u_V"][0]
    u, y, status = through(program, "i", float(u0), wanted, dt).T
    assert not status.any()
    assert np.abs(y - wanted).max() <= 1e-5 * span
    assert np.abs(u - inverse["u_V"]).max() <= 1e-4 * np.ptp(rows[:, 0])
