"""Exported C code: compiles without a warning and gives Python's numbers, forward and inverse."""

import dataclasses
import itertools
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.control import InverseStep, export_c
from hystfit.errors import ModelError
from hystfit.models.curve import Curve
from hystfit.models.jiles_atherton_dynamic import JilesAthertonDynamic
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.rate import Excess

GCC = shutil.which("gcc") or shutil.which("cc")
FLAGS = ["-Wall", "-Wextra", "-Werror", "-std=c99", "-pedantic", "-O2"]


def weighted(model: hf.Preisach, **fields: object) -> hf.Preisach:
    model = eqx.tree_at(lambda m: m.w, model, jnp.asarray(np.random.default_rng(3).uniform(0, 0.01, model.w.size)))
    for name, value in fields.items():
        model = eqx.tree_at(lambda m, name=name: getattr(m, name), model, jnp.asarray(value))
    return model


PIEZO = hf.BoucWen(c=0.1542, mu=0.45, tau=0.01086, rho=0.88, scheme="exact", offset=0.3, h0=0.1)
HARDENING = hf.PrandtlIshlinskii.of(6, degree=3, hardening=3, rest="first")
HARDENING = eqx.tree_at(
    lambda m: (m.hardening, m.b), HARDENING, (0.01 * jnp.arange(6.0), jnp.asarray([1.0, 0.1, 0.02]))
)
SMOOTH = {"alpha": 3.0, "f": (0.0, 1.0, 0.1, 0.02), "g": (0.6, 0.02, 0.01), "w0": 0.05}
KNEE = {
    "c": 0.15, "mu": 0.45, "tau": 0.011, "rho": 0.6, "n": 1.7, "skew": 0.2, "b": (0.3, -0.1), "center": 50.0, "half": 70.0
}  # fmt: skip
CELLS = weighted(hf.Preisach.of(6, depth=16, spacing="uniform", initial="negative"), offset=0.4)
CREEP = hf.LinearCreep(a=(0.02,), tau=(0.01, 0.1, 1.0), low=-1.0, high=1.0, level=-0.5)
PLAYS = hf.Series(
    hf.Lag(tau=0.006, rest="first"),
    hf.Sum(hf.PrandtlIshlinskii.of(5, 3, envelopes=3), CREEP, hf.Viscous(c=1e-3), hf.SaturatingRate(F=0.02, v0=4.0)),
)
CURVE = Curve(rise=0.7, bend=(0.3, -2.0, 4.0, 1.0), knots=(0.0, 0.2, 0.7, 1.0), offset=0.1, low=-0.8, high=0.7)
CASES = {
    "lag_preisach": (hf.Series(hf.Lag(tau=0.004, rest="first"), CELLS), -1.0, 1.0),
    "lag_curve": (hf.Series(hf.Lag(tau=0.004, rest="first", order=1), CURVE), -1.0, 1.0),
    "preisach_creep": (hf.Sum(CELLS, CREEP), -1.0, 1.0),
    "bouc_wen": (hf.BoucWen(c=0.1542, mu=0.45, tau=0.01086, rho=0.88), -20.0, 120.0),
    "bouc_wen_exact": (PIEZO, -20.0, 120.0),
    "bouc_wen_creep": (hf.Series(PIEZO, hf.LogCreep(gamma=(0.0175, 0.004), span=12.0)), -20.0, 120.0),
    "bouc_wen_line": (hf.Sum(PIEZO, hf.Linear(0.05)), -20.0, 120.0),
    "bouc_wen_relaxation_offset": (hf.Sum(hf.Series(PIEZO, hf.Relaxation()), hf.Offset(2.0)), -20.0, 120.0),
    "bouc_wen_asymmetric": (hf.AsymmetricBoucWen(**KNEE), -20.0, 120.0),
    "bouc_wen_asymmetric_exact": (hf.AsymmetricBoucWen(**KNEE, scheme="exact"), -20.0, 120.0),
    "duhem": (hf.Duhem(**SMOOTH), -1.0, 1.0),
    "duhem_explicit": (hf.Duhem(**SMOOTH, scheme="explicit"), -1.0, 1.0),
    "duhem_exact": (hf.Duhem(**SMOOTH, scheme="exact"), -1.0, 1.0),
    "plays": (hf.PrandtlIshlinskii.of(6), -0.2, 1.2),
    "plays_negated": (hf.Series(hf.Negate(), hf.PrandtlIshlinskii.of(6)), -1.2, 0.2),
    "bouc_wen_baber_noori": (hf.BoucWenBaberNoori(kappa_x=0.5, dnu=0.05, deta=0.1, p=0.3, n=1.4, dpsi=0.02), -1.0, 1.0),
    "steel_02": (
        hf.Steel02(fy=1.0, E=4.0, b=0.05, a1=0.03, a3=0.05, sigInit=0.1, deadband=1e-3, offset=0.1),
        -1.0,
        1.0,
    ),
    "voce_chaboche": (hf.VoceChaboche(E=5.0, sy0=0.4, Q=0.2, b=0.5, D=0.1, a=2.0), -1.0, 1.0),
    "viscoelastic": (hf.Sum(PIEZO, hf.Viscoelastic(g=(0.03, 0.02), tau=(0.01, 0.1))), -20.0, 120.0),
    "springpot": (hf.Sum(PIEZO, hf.Springpot(c=0.03, tau=(0.01, 0.1))), -20.0, 120.0),
    "dahl": (hf.Dahl(Fc=(0.4, 0.3), d=(0.05, 0.4), k=0.5, offset=0.1), -1.0, 1.0),
    "rate_plays": (hf.RateDependentPlays.of(6), -0.2, 1.2),
    "stops": (hf.PrandtlIshlinskii.of(6, operator="stop"), 0.0, 1.0),
    "envelopes": (hf.PrandtlIshlinskii.of(4, 3, envelopes=3), -0.2, 1.2),
    "hardening": (HARDENING, 0.0, 1.0),
    "lag_plays_creep_rate": (PLAYS, 0.0, 1.0),
    "preisach_demagnetized": (weighted(hf.Preisach.of(6, depth=16, spacing="uniform"), center=0.23), -1.0, 1.0),
    "everett_table": (hf.TabulatedPreisach.of(5), -1.0, 1.0),
    "preisach_positive": (
        weighted(hf.Preisach.of(6, depth=16, spacing="uniform", initial="positive"), offset=-0.2),
        -1.0,
        1.0,
    ),
    "preisach_symmetric": (
        weighted(hf.Preisach.of(6, depth=16, symmetric=True, degree=3), b=[0.2, 0.0, 0.05]),
        -1.0,
        1.0,
    ),
}


def build(model: hf.models.AbstractHysteresis, folder: Path, flags: Sequence[str] = (), **options: object) -> Path:
    _, source, harness = export_c(model, folder, **options)
    return compiled(source, harness, *flags)


def compiled(source: Path, harness: Path, *flags: str) -> Path:
    if GCC is None:
        pytest.skip("no C compiler: install gcc to test the exported code")
    program = source.with_suffix("")
    subprocess.run([GCC, *FLAGS, *flags, str(source), str(harness), "-o", str(program), "-lm"], check=True)
    return program


def run(program: Path, mode: str, u0: float, values: np.ndarray, dt: float) -> np.ndarray:
    lines = [f"{u0!r}", *(f"{float(value)!r} {dt!r}" for value in values)]
    done = subprocess.run([str(program), mode], input="\n".join(lines), capture_output=True, text=True, check=True)
    return np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])


def path(low: float, high: float, samples: int = 300) -> np.ndarray:
    corners = np.random.default_rng(1).uniform(low, high, 14)
    corners[3] = high
    return np.interp(np.linspace(0, 13, samples), np.arange(14), corners)


# The code of the parts of these is that of others, and their weights are expanded in Python.
SLOW = (
    "preisach_positive",
    "preisach_symmetric",
    "preisach_demagnetized",
    "plays_negated",
    "bouc_wen_line",
    "bouc_wen_asymmetric",
    "bouc_wen_relaxation_offset",
    "lag_preisach",
)


# Inverses that are compared with those of Python in the quick form: with a creep behind the loop, with a search beside others, with
# cells, and with samples of the status not-monotone.
INVERTED = ("bouc_wen_creep", "lag_plays_creep_rate", "preisach_creep", "duhem", "duhem_exact")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in CASES])
def test_c_equals_python_and_its_inverse_gives_the_input_again(name: str, tmp_path: Path) -> None:
    model, low, high = CASES[name]
    limits = (low, high) if model.step_inverse().needs_limits else None
    program, dt, u = build(model, tmp_path, limits=limits), 0.002, path(low, high)
    expected = np.asarray(hf.simulate(model, u, dt)[0])
    found = run(program, "f", float(u[0]), u, dt)[:, 0]
    assert np.abs(found - expected).max() <= 1e-12 * np.ptp(expected)
    u_c, y_c, status = run(program, "i", float(u[0]), expected, dt).T
    assert np.abs(y_c - expected).max() <= 1e-10 * np.ptp(expected)
    assert np.abs(u_c - u).max() <= 1e-8 * (high - low)
    assert name in INVERTED or not status.any()


@pytest.mark.parametrize("name", [n if n in INVERTED else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
def test_the_inverse_in_c_equals_that_of_python(name: str, tmp_path: Path) -> None:
    """Of the same outputs, from the same rest."""
    model, low, high = CASES[name]
    limits = (low, high) if model.step_inverse().needs_limits else None
    program, dt, u = build(model, tmp_path, limits=limits), 0.002, path(low, high)
    expected = np.asarray(hf.simulate(model, u, dt)[0])
    inverse = InverseStep.of(model, limits=limits)
    _, answer = inverse.run(inverse.init(u[0]), jnp.asarray(expected), jnp.full(u.size, dt))
    u_c, y_c, status = run(program, "i", float(u[0]), expected, dt).T
    assert np.abs(u_c - np.asarray(answer.u)).max() <= 1e-12 * (high - low) / _steepness(name)
    assert np.abs(y_c - np.asarray(answer.y)).max() <= 1e-12 * np.ptp(expected)
    np.testing.assert_array_equal(status, np.asarray(answer.status))


def _steepness(name: str) -> float:
    """Least slope over the mean slope, by which rounding of the output grows in the input."""
    return 0.05 if name.startswith(("stops", "steel", "voce")) or name == "hardening" else 0.2


def test_c_inverse_saturates_as_python_does(tmp_path: Path) -> None:
    program = build(PIEZO, tmp_path, limits=(0.0, 90.0), name="stack")
    targets = np.array(hf.simulate(PIEZO, path(-20.0, 120.0))[0])
    targets[40] = np.nan
    inverse = InverseStep.of(PIEZO, limits=(0.0, 90.0))
    _, answer = inverse.run(inverse.init(0.0), jnp.asarray(targets), jnp.zeros(targets.size))
    u, y, status = run(program, "i", 0.0, targets, 0.0).T
    np.testing.assert_allclose(u, answer.u, atol=1e-10)
    np.testing.assert_allclose(y, answer.y, atol=1e-11)
    np.testing.assert_array_equal(status, np.asarray(answer.status))
    assert set(status) == {0.0, 1.0, 3.0}
    assert status[40] == 3.0


def yielding(n: float) -> hf.BoucWenForce:
    return hf.BoucWenForce(kappa_x=0.3, kappa_w=2.0, rho=1.5, sigma=0.9, n=n, w0=-0.4, offset=0.1)


MAGNETIZATION = {"Ms": 1.4, "a": 0.2, "coupling": 0.6, "k": 0.15, "c": 0.3, "slope": 0.05, "offset": 0.1}
EXTREME = np.random.default_rng(0).choice([0.0, 1e-320, -1e30, 1e155, 1e308, -1e308, np.nan], 200)


@pytest.mark.parametrize(
    ("model", "most"),
    [
        (yielding(1.0), 5.0),
        (yielding(1.7), 5.0),
        (hf.JilesAtherton(**MAGNETIZATION, curve="tanh", q=[1.5], p=[0.6], r=[3.0]), 1.0),
    ],
    ids=["force", "smooth force", "magnetization"],
)
def test_c_whose_inverse_searches_equals_python(model: Any, most: float, tmp_path: Path) -> None:
    program, u = build(model, tmp_path, limits=(-most - 1.0, most + 1.0)), path(-most, most)
    expected = np.asarray(hf.simulate(model, u)[0])
    np.testing.assert_allclose(run(program, "f", float(u[0]), u, 0.0)[:, 0], expected, atol=1e-12)
    found = run(program, "i", float(u[0]), expected, 0.0)
    np.testing.assert_allclose(found[:, 1], expected, atol=1e-6)
    assert not found[:, 2].any()
    assert np.isfinite(run(program, "f", 0.0, np.concatenate([EXTREME, u]), 0.0)).all()


def test_c_of_a_magnetization_with_losses_equals_python(tmp_path: Path, sanitizers: None) -> None:
    model = JilesAthertonDynamic(**MAGNETIZATION, eddy=2e-3, excess=0.02, e=0.5)
    program, u = build(model, tmp_path, flags=SANITIZED, limits=(-2.0, 2.0)), path(-1.0, 1.0)
    expected = np.asarray(hf.simulate(model, u, 0.002)[0])
    np.testing.assert_allclose(run(program, "f", float(u[0]), u, 0.002)[:, 0], expected, atol=1e-11)
    np.testing.assert_allclose(run(program, "i", float(u[0]), expected, 0.002)[:, 1], expected, atol=1e-6)
    assert np.isfinite(run(program, "f", 0.0, np.concatenate([EXTREME, u]), 0.002)).all()
    still = run(program, "f", float(u[0]), u, 0.0)[:, 0]
    assert (still == still[0]).all()  # without time no flux changes


@pytest.mark.parametrize("losses", [False, True])
def test_c_of_a_field_equals_python(tmp_path: Path, sanitizers: None, losses: bool) -> None:
    """The field over the flux density; with the losses of eddy currents and domain walls beside another curve."""
    shape = {"Ms": 1.3, "a": 0.2, "coupling": 0.6, "k": 0.15, "c": 0.3, "slope": 0.5, "offset": 0.1}
    model = JilesAthertonField(**shape)
    if losses:
        law = JilesAthertonField(**shape, curve="tanh", q=[1.5])
        model = hf.Sum(law, hf.Viscous(c=0.002), Excess(g=0.3, e=0.5))
    program, u = build(model, tmp_path, flags=SANITIZED, limits=(-2.0, 2.0)), path(-1.6, 1.6)
    expected = np.asarray(hf.simulate(model, u, 0.002)[0])
    assert np.abs(run(program, "f", float(u[0]), u, 0.002)[:, 0] - expected).max() <= 1e-11 * np.ptp(expected)
    if not losses:
        np.testing.assert_allclose(run(program, "i", float(u[0]), expected, 0.002)[:, 1], expected, atol=1e-6)


@pytest.mark.parametrize("falls", [False, True])
def test_c_of_a_relay_equals_python(tmp_path: Path, falls: bool) -> None:
    relay = hf.Relay(up=0.3, down=-0.25, low=-0.7, high=1.9)
    model = hf.Series(hf.Negate(), relay) if falls else relay
    program, u = build(model, tmp_path), path(-1.0, 1.0)
    expected = np.asarray(hf.simulate(model, u)[0])
    assert set(expected) == {-0.7, 1.9}
    np.testing.assert_array_equal(run(program, "f", float(u[0]), u, 0.0)[:, 0], expected)


SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
QUICK = ("bouc_wen_asymmetric", "duhem_explicit", "lag_plays_creep_rate", "preisach_creep")


@pytest.fixture(scope="module")
def sanitizers(tmp_path_factory: pytest.TempPathFactory) -> None:
    if GCC is None:
        pytest.skip("no C compiler: install gcc to test the exported code")
    source = tmp_path_factory.mktemp("probe") / "probe.c"
    source.write_text("int main(void) { return 0; }")
    made = subprocess.run([GCC, *SANITIZED, str(source), "-o", str(source.with_suffix(""))], capture_output=True)
    if made.returncode:
        pytest.skip("the C compiler has no address and undefined-behavior sanitizers")


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES])
def test_inputs_that_are_no_numbers_leave_the_model_as_it_was(name: str, sanitizers: None, tmp_path: Path) -> None:
    """Under address and undefined-behavior sanitizers: NaN, infinite and extreme inputs among ordinary ones."""
    model, low, high = CASES[name]
    limits = (low, high) if model.step_inverse().needs_limits else None
    program, u = build(model, tmp_path, flags=SANITIZED, limits=limits), path(low, high)
    plain = run(program, "f", float(u[0]), u, 0.002)[:, 0]
    assert np.isfinite(plain).all()
    bad = np.insert(u, [3, 150, 290], [np.nan, np.inf, -np.inf])
    kept = np.delete(np.arange(bad.size), [3, 151, 292])
    found = run(program, "f", float(u[0]), bad, 0.002)[:, 0]
    np.testing.assert_array_equal(found[kept], plain)
    assert [found[3], found[151], found[292]] == [found[2], found[150], found[291]]
    assert np.isfinite(run(program, "f", float(u[0]), np.concatenate([EXTREME, u]), 0.002)).all()
    assert np.isfinite(run(program, "i", float(u[0]), np.concatenate([EXTREME, plain[:20]]), 0.002)[:, 1:]).all()


def test_c_flags_an_output_that_does_not_rise(tmp_path: Path) -> None:
    model = hf.Duhem(alpha=2.0, f=(0.0, 1.0), g=(-0.3,))
    found = run(build(model, tmp_path), "i", 0.0, np.sin(np.linspace(0, 12, 200)), 0.0)
    assert np.isfinite(found).all()
    assert (found[:, 2] == 2).any()


def test_exported_file_is_self_contained(tmp_path: Path) -> None:
    files = export_c(CELLS, tmp_path, name="thunder")
    assert [file.name for file in files] == ["thunder.h", "thunder.c", "thunder_main.c"]
    code = files[1].read_text()
    assert {line for line in code.splitlines() if line.startswith("#include")} == {
        "#include <float.h>",
        "#include <math.h>",
        '#include "thunder.h"',
    }
    assert not any(word in code for word in ("malloc", "calloc", "@"))


def test_names_and_models_without_c_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="C identifier"):
        export_c(PIEZO, tmp_path, name="2nd")

    class Unwritten(hf.BoucWenForce):
        c_template = ""

    with pytest.raises(ModelError, match="Unwritten has no C code"):
        export_c(Unwritten(), tmp_path)
    with pytest.raises(ModelError, match="cells"):
        export_c(hf.Preisach.of(4, elements="relays"), tmp_path)
    assert not any(itertools.chain(tmp_path.iterdir()))


@pytest.mark.parametrize(("between", "n"), [("linear", 1.0), ("hold", 1.7)])
def test_an_oscillator_is_exported_forward_only(between: str, n: float, tmp_path: Path) -> None:
    model = hf.BoucWenOscillator(m=0.02, c=0.1, r_load=0.6, r_unl=0.3, n=n, offset=0.2, between=between, substeps=3)
    program, u = build(model, tmp_path), path(-1.0, 1.0)
    expected = np.asarray(hf.simulate(model, u, 0.02)[0])
    found = run(program, "f", float(u[0]), u, 0.02)[:, 0]
    assert np.abs(found - expected).max() <= 1e-12 * np.ptp(expected)
    assert subprocess.run([str(program), "i"], input="0.0", capture_output=True, text=True).returncode == 2


DAMPER = {"spring": (0.5, 0.1, -0.2, 0.1), "bent": (0.1, 0.02, -0.1), "coupling": (0.1, -0.2, 0.3, 0.1)}
OF_VELOCITY = [
    hf.Damper(**DAMPER, tau=0.004, half=1.1, speed=9.0, center=0.2, strain=-0.6, offset=0.3),
    hf.LuGre(sigma0=20.0, sigma1=0.05, vs=3.0, k=0.2, offset=0.1),
    hf.MaxwellSlip(vs=3.0, half=1.1, speed=9.0, center=0.2, offset=0.1),
]


@pytest.mark.parametrize("model", OF_VELOCITY, ids=lambda model: type(model).__name__)
def test_forces_of_the_velocity_are_exported_forward_only(model, sanitizers: None, tmp_path: Path) -> None:
    program, u = build(model, tmp_path, flags=SANITIZED), path(-1.0, 1.0)
    expected = np.asarray(hf.simulate(model, u, 0.002)[0])
    assert np.abs(run(program, "f", float(u[0]), u, 0.002)[:, 0] - expected).max() <= 1e-12 * np.ptp(expected)


@pytest.mark.parametrize("peaks", [1, 3])
def test_self_similar_stops_are_exported_forward_only(peaks: int, sanitizers: None, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    model = hf.SelfSimilarStops.of(peaks, fading=peaks > 1)
    weights = {name: rng.normal(size=getattr(model, name).shape) for name in ("w", "c", "fading")}
    model = dataclasses.replace(model, **weights, offset=0.3)
    program, u = build(model, tmp_path, flags=SANITIZED), path(-1.0, 1.0)
    expected = np.asarray(hf.simulate(model, u)[0])
    assert np.abs(run(program, "f", float(u[0]), u, 0.0)[:, 0] - expected).max() <= 1e-12 * np.ptp(expected)
    with pytest.raises(ModelError, match="no inverse"):
        model.step_inverse()


@pytest.mark.parametrize(
    "model",
    [
        hf.Series(CELLS, hf.SecondOrder(omega=90.0, zeta=0.15)),
        hf.Series(hf.Delay(lag=2.3), CELLS),
        hf.Series(hf.Delay(lag=0.4), CELLS),
        hf.Series(hf.Delay(lag=9.0), CELLS),
        hf.Series(hf.RateShift(c=0.05, q0=2.0), CELLS),
    ],
    ids=["resonance", "delay", "part of a sample", "longest delay", "shift by the rate"],
)
def test_a_late_response_is_exported_forward_only(model: hf.Series, tmp_path: Path) -> None:
    assert model.obstacle("export") is None
    assert (model.obstacle("inverse") is None) == (model.output_resonance() is not None)
    program, u = build(model, tmp_path), path(-1.0, 1.0)
    expected = np.asarray(hf.simulate(model, u, 0.002)[0])
    assert np.abs(run(program, "f", float(u[0]), u, 0.002)[:, 0] - expected).max() <= 1e-12 * np.ptp(expected)
    assert subprocess.run([str(program), "i"], input="0.0", capture_output=True, text=True).returncode == 2
    assert "@" not in "".join(file.read_text() for file in tmp_path.iterdir() if file.suffix in (".c", ".h"))
    with pytest.raises(ModelError):
        InverseStep.of(model)


SIMSTRUC = """
#include <stdio.h>
#include <stdlib.h>
typedef int int_T;
typedef double real_T;
typedef struct { double t, u, y, *dwork[4]; int dworks, widths[4], ports, feed; } SimStruct;
enum { SS_DOUBLE, INHERITED_SAMPLE_TIME, SS_OPTION_EXCEPTION_FREE_CODE };
#define UNUSED_ARG(x) (void)(x)
#define ssSetNumSFcnParams(S, n) (void)(S)
#define ssGetNumSFcnParams(S) 0
#define ssGetSFcnParamsCount(S) 0
#define ssSetNumContStates(S, n) (void)(S)
#define ssSetNumDiscStates(S, n) (void)(S)
#define ssSetNumInputPorts(S, n) ((S)->ports += (n), 1)
#define ssSetNumOutputPorts(S, n) ((S)->ports += (n), 1)
#define ssSetInputPortWidth(S, port, n) (void)(S)
#define ssSetInputPortRequiredContiguous(S, port, n) (void)(S)
#define ssSetInputPortDirectFeedThrough(S, port, n) ((S)->feed = (n))
#define ssSetOutputPortWidth(S, port, n) (void)(S)
#define ssSetNumSampleTimes(S, n) (void)(S)
#define ssSetNumDWork(S, n) ((S)->dworks = (n))
#define ssSetDWorkWidth(S, k, n) ((S)->dwork[k] = calloc((n), sizeof(double)))
#define ssSetDWorkDataType(S, k, kind) (void)(S)
#define ssSetOptions(S, n) (void)(S)
#define ssSetSampleTime(S, k, n) (void)(S)
#define ssSetOffsetTime(S, k, n) (void)(S)
#define ssGetDWork(S, k) ((void *)(S)->dwork[k])
#define ssGetT(S) ((S)->t)
#define ssGetInputPortRealSignal(S, port) (&(S)->u)
#define ssGetOutputPortRealSignal(S, port) (&(S)->y)
"""
SIMULINK = """
static void sample(SimStruct *S, double t, double u)
{
    S->t = t - 0.001;
    S->u = u + 0.3;
    mdlOutputs(S, 0); /* a minor time step on the way, whose output is not kept */
    S->t = t;
    S->u = u;
    mdlOutputs(S, 0);
    mdlUpdate(S, 0);
}

int main(void)
{
    static SimStruct first, other;
    SimStruct *both[2] = {&first, &other};
    double t, u;
    int k, again;
    for (k = 0; k < 2; k++) {
        mdlInitializeSizes(both[k]);
        mdlInitializeSampleTimes(both[k]);
        mdlInitializeConditions(both[k]);
    }
    if (first.ports != 2 || first.dworks != 2 || !first.feed)
        return 3;
    while (scanf("%d %lf %lf", &again, &t, &u) == 3) {
        if (again)
            mdlInitializeConditions(&first);
        sample(&first, t, u);
        sample(&other, t, -u); /* a second block of the model has its own state */
        printf("%.17g\\n", first.y);
    }
    mdlTerminate(&first);
    return 0;
}
"""


def test_an_s_function_gives_the_numbers_of_python(tmp_path: Path) -> None:
    """Against a stub of Simulink: outputs in minor time steps do not advance the state, resets start at rest, blocks are independent."""
    model = hf.Series(PIEZO, hf.LogCreep(gamma=(0.0175,), span=12.0))
    files = export_c(model, tmp_path, name="stack", s_function=True)
    assert [file.name for file in files] == ["stack.h", "stack.c", "stack_main.c", "stack_sfun.c"]
    (tmp_path / "simstruc.h").write_text(SIMSTRUC)
    (tmp_path / "simulink.c").write_text(SIMULINK.replace("\\\\n", "\\n"))
    program = tmp_path / "sfun"
    sources = [str(tmp_path / "stack_sfun.c"), str(tmp_path / "stack.c")]
    subprocess.run(
        [str(GCC), *FLAGS, "-DMATLAB_MEX_FILE", f"-I{tmp_path}", *sources, "-o", str(program), "-lm"], check=True
    )
    u, dt = path(-20.0, 120.0), 0.01
    rows = [(again * (k == 0), k * dt + again, value) for again in (0, 1) for k, value in enumerate(u)]
    words = "\n".join(
        f"{again} {t!r} {value!r}" for again, t, value in [(int(a), float(t), float(v)) for a, t, v in rows]
    )
    done = subprocess.run([str(program)], input=words, capture_output=True, text=True, check=True)
    steps = np.full(u.size, dt)
    steps[0] = 0.0
    expected = np.asarray(hf.simulate(model, u, steps)[0])
    found = np.array(done.stdout.split(), dtype=float).reshape(2, -1)
    assert np.abs(found - expected).max() <= 1e-10 * np.ptp(expected)
