"""Lines for OpenSees: read back, integrated by the equations of its materials, run by OpenSees itself where it is installed."""

from __future__ import annotations

import csv
import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import hystfit as hf
from hystfit.cli import run
from hystfit.control import export_opensees
from hystfit.errors import ModelError

FORCE = hf.BoucWenForce(kappa_x=0.5, kappa_w=8.0, rho=0.6, sigma=0.7, n=1.4)
DAMAGED = hf.BoucWenBaberNoori(kappa_x=0.5, kappa_w=8.0, zy=1.5, beta=0.6, n=1.3, dnu=0.01, deta=0.03, zs=0.0)
PINCHED = hf.BoucWenBaberNoori(
    kappa_x=0.5, kappa_w=8.0, zy=1.5, beta=0.6, n=1.3, dnu=0.0, deta=0.0, zs=0.9, p=0.05, q=0.1, psi=0.3, dpsi=0.01
)
STEEL = hf.Steel02(fy=500.0, E=2e5, b=0.02, cR1=0.9, cR2=0.15, a1=0.02, a3=0.03)
UVC = hf.VoceChaboche(E=2e5, sy0=330.0, Q=80.0, b=6.0, D=60.0, a=200.0, S=(60.0, 150.0), g=(200.0, 15.0))


def cycles(*amplitudes: float, samples: int) -> np.ndarray:
    return np.concatenate([a * np.sin(2 * np.pi * np.arange(samples) / samples) for a in amplitudes])


def line(model: hf.models.AbstractHysteresis) -> list[str]:
    return list(model.uniaxial_material().words(7))


def bouc_wen(words: list[str], strain: np.ndarray) -> np.ndarray:
    """`BoucWen` and `BWBN` by backward Euler, as OpenSees integrates them: one step a sample, the residual to rounding."""
    kind, numbers = words[1], [float(word) for word in words[3:]]
    alpha, k, n, gamma, beta, A = numbers[:6]
    if kind == "BoucWen":
        dA, dnu, deta = numbers[6:9]
        pinch = lambda z, energy, s: 1.0
    else:
        (q, zs, p, psi, dpsi, lam), (dA, dnu, deta) = numbers[6:12], (0.0, 0.0, 0.0)

        def pinch(z: float, energy: float, s: float) -> float:
            depth = zs * (1 - math.exp(-p * energy))
            width = (psi + dpsi * energy) * (lam + depth)
            return 1 - depth * math.exp(-(((z * s - q * (1 / (beta + gamma)) ** (1 / n)) / width) ** 2))

    z, energy, force = 0.0, 0.0, [alpha * k * strain[0]]
    for before, after in itertools.pairwise(strain):
        du = after - before

        def residual(new: float, z=z, energy=energy, du=du) -> float:
            absorbed = energy + (1 - alpha) * k * du * new
            loss = abs(new) ** n * (gamma + beta * np.sign(du * new)) * (1 + dnu * absorbed)
            return new - z - pinch(new, absorbed, np.sign(du)) * (A - dA * absorbed - loss) / (1 + deta * absorbed) * du

        z = brentq(residual, z - 2 * abs(du), z + 2 * abs(du), xtol=1e-14) if du else z
        energy += (1 - alpha) * k * du * z
        force.append(alpha * k * after + (1 - alpha) * k * z)
    return np.array(force)


@pytest.mark.parametrize("model", [FORCE, DAMAGED, PINCHED], ids=["plain", "degrading", "pinched"])
def test_the_line_gives_the_loops_of_the_model(model: hf.models.AbstractHysteresis) -> None:
    """Backward Euler is of first order: 800 steps a cycle and twice as many extrapolate to the model within 0.05 % of the range."""
    loops = []
    for samples in (800, 1600):
        u = cycles(1.0, 4.0, 6.0, 6.0, samples=samples)
        loops.append(bouc_wen(line(model), u)[:: samples // 800])
    expected = np.asarray(hf.simulate(model, cycles(1.0, 4.0, 6.0, 6.0, samples=800))[0])
    assert np.abs(2 * loops[1] - loops[0] - expected).max() < 5e-4 * np.ptp(expected)
    assert np.abs(loops[1] - expected).max() < 5e-3 * np.ptp(expected)


def test_arguments_are_in_the_order_of_opensees() -> None:
    assert line(STEEL) == "uniaxialMaterial Steel02 7 500 200000 0.02 20 0.9 0.15 0.02 1 0.03 1 0".split()
    assert line(UVC) == "uniaxialMaterial UVCuniaxial 7 200000 330 80 6 60 200 2 2250 15 12000 200".split()


def test_no_term_is_dropped() -> None:
    both = hf.BoucWenBaberNoori(dnu=0.01, zs=0.5)
    with pytest.raises(ModelError, match="degrades and pinches"):
        both.uniaxial_material()
    with pytest.raises(ModelError, match="8 backstresses"):
        hf.VoceChaboche.of(9).uniaxial_material()
    with pytest.raises(ModelError, match="positive"):
        hf.BoucWenForce(kappa_w=-1.0).uniaxial_material()
    with pytest.raises(ModelError, match="BoucWen"):
        hf.BoucWen().uniaxial_material()
    with pytest.raises(ModelError, match="Sum"):
        hf.models.Sum(FORCE, hf.Viscous(c=0.1)).uniaxial_material()
    assert hf.BoucWenForce(offset=0.3, n=2.0).uniaxial_material().lost
    assert any("Newton" in note for note in hf.BoucWenBaberNoori(n=0.8, zs=0.0).uniaxial_material().notes)


@pytest.fixture(scope="module")
def fitted() -> hf.FitResult:
    u = cycles(1.0, 4.0, 6.0, 6.0, samples=100)
    y = np.asarray(hf.simulate(FORCE, u)[0]) + np.random.default_rng(0).normal(0, 0.05, u.size)
    return hf.fit("bouc-wen-force", hf.Record(u=u, y=y, u_unit="mm", y_unit="kN"), starts=1)


def test_files_hold_the_line_the_errors_and_the_covariance(fitted: hf.FitResult, tmp_path: Path) -> None:
    tcl, script, covariance = export_opensees(fitted, tmp_path, name="brace", tag=3)
    *comments, command = tcl.read_text().splitlines()
    assert all(text.startswith("# ") for text in comments)
    assert command.split() == list(fitted.model.uniaxial_material().words(3))
    call = script.read_text().splitlines()[-1]
    arguments = re.fullmatch(r"ops\.uniaxialMaterial\((.*)\)", call)[1].split(", ")
    assert [word.strip('"') for word in arguments] == command.split()[1:]
    text = tcl.read_text()
    assert "mm" in text
    assert "kN" in text
    for row in fitted.parameters:
        stated = next(part for part in comments if f" {row.name} = " in part)
        if row.stderr is not None:
            assert float(stated.split("+-")[1]) == pytest.approx(row.stderr, rel=0.06)
    rows = list(csv.reader(covariance.read_text().splitlines()))
    assert rows[0][1:] == list(fitted.free_names)
    found = np.array([[float(cell or "nan") for cell in row[1:]] for row in rows[1:]])
    np.testing.assert_array_equal(found, fitted.covariance)
    for bad in ({"name": "two words"}, {"tag": 0}):
        with pytest.raises(ModelError):
            export_opensees(fitted, tmp_path, **bad)


def test_the_shell_writes_the_same(fitted: hf.FitResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fitted.save(tmp_path / "fit")
    assert run(["export", str(tmp_path / "fit"), "--opensees", str(tmp_path / "out"), "--tag", "5"]) == 0
    shown = capsys.readouterr().out
    assert " ".join(fitted.model.uniaxial_material().words(5)) in shown
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == [
        "hysteresis.py", "hysteresis.tcl", "hysteresis_covariance.csv"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("model", "scale", "tolerance"),
    [(STEEL, 0.003, 1e-7), (UVC, 0.003, 1e-5), (FORCE, 1.0, 5e-3), (DAMAGED, 1.0, 5e-3), (PINCHED, 1.0, 5e-3)],
    ids=["Steel02", "UVCuniaxial", "BoucWen", "BoucWen, degrading", "BWBN"],
)
def test_opensees_gives_the_loops_of_the_model(
    model: hf.models.AbstractHysteresis, scale: float, tolerance: float
) -> None:
    try:
        import openseespy.opensees as ops
    except (ImportError, RuntimeError) as error:
        pytest.skip(f"openseespy is not installed or does not run here: {error}")
    u = scale * cycles(1.0, 4.0, 6.0, 6.0, 3.0, samples=1600)
    kinds = [type(value) for value in model.uniaxial_material().arguments]  # whole numbers are read as such
    numbers = [of(word) for of, word in zip(kinds, line(model)[3:], strict=True)]
    ops.wipe()
    ops.uniaxialMaterial(line(model)[1], 7, *numbers)
    ops.testUniaxialMaterial(7)
    stress = []
    for strain in u:
        ops.setStrain(float(strain))
        stress.append(ops.getStress())
    expected = np.asarray(hf.simulate(model, u)[0])
    assert np.abs(np.array(stress) - expected).max() < tolerance * np.ptp(expected)
