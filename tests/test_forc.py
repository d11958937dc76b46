"""FORC diagrams in numbers and at the shell: against a Preisach model of known density, and a measured family."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.errors import DataError
from hystfit.models.preisach.forc import density_of, fit_forc, forc_diagram, forc_numbers

COERCIVITY, SPREAD = 0.35, 0.1


@pytest.fixture(scope="module")
def truth() -> hf.Preisach:
    """A Gaussian density about coercivity 0.35 and interaction 0.05."""
    levels = np.linspace(-1, 1, 41)
    middle = 0.5 * (levels[1:] + levels[:-1])
    i, j = np.tril_indices(middle.size)
    h, m = 0.5 * (middle[i] - middle[j]), 0.5 * (middle[i] + middle[j])
    density = np.exp(-0.5 * ((h - COERCIVITY) / SPREAD) ** 2 - 0.5 * ((m - 0.05) / SPREAD) ** 2)
    return hf.Preisach(w=density, levels=levels, initial="positive", spacing="given")


@pytest.fixture(scope="module")
def curves(truth: hf.Preisach) -> hf.Dataset:
    """Its curves from 40 reversal fields."""
    records = []
    for number, reversal in enumerate(np.linspace(0.95, -0.99, 40)):
        u = np.concatenate([np.linspace(1.0, reversal, 50)[:-1], np.linspace(reversal, 1.0, 60)])
        y = np.asarray(hf.simulate(truth, u)[0])
        records.append(hf.Record(u=u[49:], y=y[49:], u_unit="kOe", y_unit="emu", name=f"curve={number}"))
    return hf.Dataset(tuple(records))


def test_numbers_are_those_of_the_density(curves, truth):
    numbers = forc_numbers(forc_diagram(curves, smoothing=2))
    assert numbers.peak == pytest.approx((COERCIVITY, 0.05), abs=0.05)
    assert numbers.median_coercivity == pytest.approx(COERCIVITY, abs=0.02)
    assert numbers.width == pytest.approx(2.355 * np.hypot(SPREAD, 0.04), rel=0.2)  # widened by the smoothing
    assert numbers.ridge == pytest.approx(0.05, abs=0.02)
    assert numbers.ridge_width == pytest.approx(SPREAD, rel=0.3)
    assert numbers.total == pytest.approx(float(np.sum(truth.masses())), rel=0.05)
    assert numbers.negative_percent < 5
    assert np.trapezoid(numbers.distribution, numbers.coercivity) == pytest.approx(numbers.total, rel=0.05)


def test_a_fitted_density_gives_the_same_numbers(curves, truth):
    exact = density_of(truth)
    fitted = density_of(fit_forc(curves, 30).model)
    assert exact.mass.sum() == pytest.approx(float(np.sum(truth.masses())), rel=0.05)
    ours, theirs = forc_numbers(fitted), forc_numbers(exact)
    assert ours.median_coercivity == pytest.approx(theirs.median_coercivity, abs=0.04)
    assert ours.ridge == pytest.approx(0.05, abs=0.03)
    assert ours.total == pytest.approx(theirs.total, rel=0.05)


def test_a_density_that_is_nowhere_positive_is_refused(curves):
    diagram = forc_diagram(list(curves)[::4], 2)
    negative = type(diagram)(diagram.reversal, diagram.field, -np.abs(diagram.density))
    with pytest.raises(DataError, match="nowhere positive"):
        forc_numbers(negative)


def write(path: Path, curves: hf.Dataset) -> None:
    rows = [f"{k},{u!r},{y!r}" for k, r in enumerate(curves) for u, y in zip(r.u.tolist(), r.y.tolist(), strict=True)]
    path.write_text("curve,H_Oe,M_emu\n" + "\n".join(rows) + "\n")


def test_the_verb_writes_picture_density_distribution_and_page(curves, tmp_path, capsys):
    write(tmp_path / "forc.csv", curves)
    out = tmp_path / "out"
    assert run(["forc", str(tmp_path / "forc.csv"), "--by", "curve", "--smoothing", "2", "--out", str(out)]) == 0
    assert "smoothing factor 2" in capsys.readouterr().out
    names = {"forc.png", "coercivity.png", "curves.png", "forc.csv", "forc.npz", "coercivity.csv"}
    assert {path.name for path in out.iterdir()} == names | {"report.html", "result.json"}
    stored = json.loads((out / "result.json").read_text())
    assert stored["schema"] == "hystfit.forc/1"
    assert (stored["smoothing"], stored["curves"], stored["units"]["input"]) == (2, 40, "Oe")
    assert stored["numbers"]["peak"]["coercivity"] == pytest.approx(COERCIVITY, abs=0.05)
    grid = np.load(out / "forc.npz")
    assert grid["density"].shape == (grid["reversal"].size, grid["field"].size)
    columns = np.genfromtxt(out / "forc.csv", delimiter=",", names=True)
    assert columns["density"].size == np.isfinite(grid["density"]).sum()
    np.testing.assert_allclose(
        columns["coercivity_Oe"], 0.5 * (columns["field_Oe"] - columns["reversal_Oe"]), atol=1e-8
    )
    page = (out / "report.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 3


def test_a_file_without_reversal_curves_is_refused(tmp_path, capsys):
    u = np.sin(np.arange(200) / 10)
    rows = "\n".join(f"{a},{b}" for a, b in zip(u, u**3, strict=True))
    (tmp_path / "loop.csv").write_text(f"H_Oe,M_emu\n{rows}\n")
    assert run(["forc", str(tmp_path / "loop.csv")]) == 2
    assert "two reversal curves or more are needed, got 1" in capsys.readouterr().err


def test_a_measured_family_has_its_published_coercivity():
    if not os.environ.get("HYSTFIT_DATA"):
        pytest.skip("HYSTFIT_DATA does not name the folder of measured data")
    data = hf.datasets.load("mag_forc_pyforc/FeCo")
    numbers = forc_numbers(forc_diagram(list(data)[::3], smoothing=2))
    last = list(data)[-1]  # from the lowest reversal: nearly the ascending branch of the major loop
    u, y = last.u[last.used], last.y[last.used]
    coercive = float(np.interp(0.0, y[np.argsort(y)], u[np.argsort(y)]))
    assert numbers.median_coercivity == pytest.approx(coercive, rel=0.1)
    assert abs(numbers.ridge) < 0.1 * coercive
