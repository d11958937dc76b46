"""`hystfit check --preisach` and fits of Preisach models at the shell."""

import json
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.models.preisach.properties import CONGRUENCY, HIGHER_ORDER, through


def device() -> hf.Preisach:
    """Twelve cells of equal density along each axis, empty at 0 V."""
    return hf.Preisach(w=np.full(78, 1.0), levels=np.linspace(0, 180, 13), initial="negative")


@pytest.fixture
def nested(tmp_path: Path) -> Path:
    u = through((*CONGRUENCY, *HIGHER_ORDER), 60)
    y = np.asarray(hf.simulate(device(), u)[0]) + np.random.default_rng(0).normal(0, 0.1, u.size)
    np.savetxt(tmp_path / "nested.csv", np.column_stack([u, y]), delimiter=",", header="u_V,y_um", comments="")
    return tmp_path / "nested.csv"


@pytest.mark.usefixtures("findings_alone")
def test_check_measures_preisach_properties(nested: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", str(nested), "--preisach", "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "check.txt").read_text().strip() in capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "result.json").read_text())["preisach"]
    assert content["status"] == "holds"
    found = content["records"]["nested"]
    assert found["wiping_out"]["max_percent"] < 2
    assert len(found["wiping_out"]["at"]) == len(found["wiping_out"]["gap"]) > 5
    assert any(loop["low"] < 81 and loop["high"] < 121 for loop in found["congruency"])
    assert found["higher_order"]["errors"]["3"]["rms_percent"] < 1


@pytest.mark.usefixtures("findings_alone")
def test_check_says_where_nothing_can_be_tested(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    u = np.sin(np.linspace(0, 20, 500))
    np.savetxt(tmp_path / "sine.csv", np.column_stack([u, u - 0.1 * np.cos(np.linspace(0, 20, 500))]), delimiter=",")
    assert run(["check", str(tmp_path / "sine.csv"), "--preisach", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["preisach"]["status"] == "untested"


def test_preisach_is_fitted_and_simulated_at_the_shell(nested: Path, tmp_path: Path) -> None:
    fit = tmp_path / "fit"
    command = ["fit", str(nested), "--model", "preisach:n=12", "--method", "preisach", "--out", str(fit)]
    assert run(command) == 0
    content = json.loads((fit / "result.json").read_text())
    assert content["method"]["name"] == "preisach"
    assert content["metrics"]["train"]["nrmse_percent"] < 1
    assert run(["predict", str(fit), str(nested), "--out", str(tmp_path / "again")]) == 0
    made = ["simulate", str(fit), "--signal", "triangle", "--low", "0", "--high", "150", "--out"]
    assert run([*made, str(tmp_path / "made.csv")]) == 0
    rows = np.genfromtxt(tmp_path / "made.csv", delimiter=",", skip_header=1)
    expected = np.asarray(hf.simulate(hf.load_fit(fit).model, rows[:, 1])[0])
    np.testing.assert_allclose(rows[:, 2], expected, atol=1e-9)


def reversal_file(folder: Path, name: str, change: dict[int, float] | None = None, drift: float = 0.0) -> str:
    """Twelve rising curves of a device, one of them turned back or moved, or each a little above the one before."""
    model = hf.Preisach(w=device().w, levels=device().levels, initial="positive")
    lines = ["curve,u_V,y_um"]
    for k, start in enumerate(np.linspace(165, 0, 12)):
        u = np.linspace(start, 180, 40)
        y = np.asarray(hf.simulate(model, np.append(180.0, u))[0])[1:] + (change or {}).get(k, 0.0) + drift * k
        lines += [f"{k},{float(a)!r},{float(b)!r}" for a, b in zip(u, y, strict=True)]
    (folder / name).write_text("\n".join(lines) + "\n")
    return str(folder / name)


@pytest.mark.slow
@pytest.mark.usefixtures("findings_alone")
def test_families_of_reversal_curves_at_the_shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = reversal_file(tmp_path, "good.csv")
    assert run(["check", good, "--by", "curve", "--preisach", "--out", str(tmp_path / "check")]) == 0
    assert "12 first-order reversal curves" in capsys.readouterr().out
    assert json.loads((tmp_path / "check" / "result.json").read_text())["preisach"]["status"] == "holds"
    assert run(["fit", good, "--by", "curve", "--model", "preisach"]) == 1
    assert "preisach-forc" in capsys.readouterr().out
    assert run(["fit", good, "--by", "curve", "--model", "preisach-forc", "--out", str(tmp_path / "fit")]) == 0
    content = json.loads((tmp_path / "fit" / "result.json").read_text())
    assert content["model"] == "preisach-forc"
    assert content["metrics"]["train"]["nrmse_percent"] < 0.2
    assert hf.load_fit(tmp_path / "fit").model.initial == "positive"


@pytest.mark.usefixtures("findings_alone")
def test_bad_families_of_reversal_curves_at_the_shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, options, words, status in (
        (
            "cross.csv",
            {"change": {5: 30.0}},
            ("curve=4", "curve=5", "cross"),
            1,
        ),  # no weights >= 0 describe the curve that crosses
        ("open.csv", {"drift": -2.0}, ("close",), 0),
    ):
        file = reversal_file(tmp_path, name, **options)
        assert run(["check", file, "--by", "curve", "--preisach", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["preisach"]["status"] == "fails"
        assert all(word in str(found["findings"]) for word in words)
        assert run(["fit", file, "--by", "curve", "--model", "preisach-forc:n=10", "--json"]) == status
        notes = str(json.loads(capsys.readouterr().out)["notes"])
        assert all(word in notes for word in words)
    lines = Path(reversal_file(tmp_path, "turned.csv")).read_text().splitlines()
    back = [f"3,{u!r},0.0" for u in np.linspace(179, 150, 30).tolist()]
    at = max(k for k, line in enumerate(lines) if line.startswith("3,")) + 1
    (tmp_path / "turned.csv").write_text("\n".join([*lines[:at], *back, *lines[at:]]) + "\n")
    assert run(["fit", str(tmp_path / "turned.csv"), "--by", "curve", "--model", "preisach-forc"]) == 2
    assert "'curve=3'" in capsys.readouterr().err
    single = reversal_file(tmp_path, "single.csv")
    assert run(["fit", single, "--by", "curve", "--only", "1", "--model", "preisach-forc"]) == 2
    assert "--by" in capsys.readouterr().err
