"""Single precision: every public verb that computes refuses it with the remedy, the others do not depend on it."""

import json
import os
import re
import subprocess
import sys
import textwrap

import pytest

import hystfit as hf

from .conftest import ROOT

# What is called with the arguments of PRELUDE below in single precision. Every public name is in exactly one of the two lists.
REFUSED = {
    "compare": "hf.compare(record)",
    "fit": "hf.fit('bouc-wen', record)",
    "Problem": "hf.Problem(model, record)",
    "simulate": "hf.simulate(model, u)",
    "sample": "hf.sample(result)",
    "profile": "hf.profile(result)",
    "calibrate": "hf.calibrate(model, record)",
    "check": "hf.check(record)",
    "design": "hf.design(result)",
    "covariance": "hf.covariance(result, 'sandwich')",
    "standard_errors": "hf.standard_errors(result)",
    "explain_drift": "hf.explain_drift(result)",
    "explore": "hf.explore(record)",
    "FitResult": "result.predict(u)",
    "Posterior": "posterior.predict(record)",
    "load_fit": "hf.load_fit(folder)",
    "load_posterior": "hf.load_posterior(draws)",
    "plots": "hf.plots.fit(result, 'loop')",
    "fit_many": "hf.fit_many('bouc-wen', [record])",
    "fit_map": "hf.fit_map('bouc-wen', u, [y])",
    "fit_population": "hf.fit_population('bouc-wen', [record, record])",
    "design_population": "hf.design_population(None)",  # no population can be fitted to begin with
    "invert": "hf.invert(model, y, limits=(-1, 1))",
    "InverseStep": "hf.InverseStep.of(model, limits=(-1, 1))",
    "inverse_bands": "hf.inverse_bands(posterior, y)",
    "control.export_c": "control.export_c(result, folder)",
    "control.run_loop": "control.run_loop(model, y, 100.0)",
    "control.Controller": "control.Controller.of(control.second_order(10.0, 0.5), 100.0)",
    "identify.AbstractIdentifier": "identify.Ukf.of(model, record)",
    "identify.DuhemRegressor": "identify.DuhemRegressor.of(hf.Duhem(), [record])",
    "identify.GradientCorrection": "identify.GradientCorrection.of(hf.Duhem(), record)",
    "identify.Rls": "identify.Rls.of(hf.Duhem(), record)",
    "identify.Ukf": "identify.Ukf.of(model, record)",
    "identify.VectorHysteresis": "identify.VectorHysteresis.fit([])",
    "identify.bias_compensated": "identify.bias_compensated(hf.Duhem(), record)",
    "identify.integrated_regression": "identify.integrated_regression(hf.Duhem(), record)",
    "identify.identify": "identify.identify(record)",
    "identify.identify_in_stages": "identify.identify_in_stages(model, [identify.Phase(record, ('c',))])",
    "identify.identify_online": "identify.identify_online(ukf, record, block=50)",
    "stage.Actuator": "stage.Actuator(model).record(t, u, seed=0)",
    "stage.Stage": "stage.Stage.of().simulate(three, 0.01)",
    "stage.StageMeasurement": "stage.Stage.of().measure(t, three, seed=0)",
    "stage.StageInverse": "stage.StageInverse.of([model] * 3, np.eye(3), limits=(-1, 1))",
    "stage.track_adaptively": "stage.track_adaptively(ukf, model, y, 0.1, block=50, limits=(-1, 1), sensor=stage.Sensor(), seed=0)",
    "stage.Population": "stage.population(model, 2, spread={'c': 0.1}, seed=0)",
    "stage.population": "stage.population(model, 3, spread={'c': 0.1}, seed=0)",
}
# Numbers of the host in double precision throughout, descriptions, or parts that the verbs above are given.
INDEPENDENT = {
    *(
        "__version__",
        "Explorer",
        "Fits",
        "signals",
        "enable_x64",
        "use_device",
        "LoopMap",
        "PopulationFit",
        "PopulationDesign",
        "Dataset",
        "Record",
        "HystfitError",
        "priors",
        "CorrelatedPriors",
        "control.export_field_programs",
        "control.export_opensees",
        "identify.FieldFromInduction",
        "identify.FluxSequence",
        "identify.VectorRecord",
        "force_loops",
        "quantities",
        "datasets",
        "read",
        "read_csv",
    ),
    *(
        "AsymmetricBoucWen",
        "BoucWen",
        "BoucWenBaberNoori",
        "BoucWenForce",
        "BoucWenOscillator",
        "Dahl",
        "Damper",
        "LuGre",
        "MaxwellSlip",
        "RateDependentPlays",
        "RateShift",
        "SelfSimilarStops",
        "Springpot",
        "Steel02",
        "Viscoelastic",
        "VoceChaboche",
        "Delay",
        "Duhem",
        "JilesAtherton",
        "Lag",
        "LinearCreep",
        "LogCreep",
    ),
    *(
        "Negate",
        "Linear",
        "Offset",
        "ParametricPreisach",
        "PrandtlIshlinskii",
        "Preisach",
        "SignedPreisach",
        "TabulatedPreisach",
        "Relaxation",
        "Relay",
        "SaturatingRate",
        "SecondOrder",
        "Series",
    ),
    *("Sum", "Viscous", "param", "ParameterSpace", "Inverse"),
    *("control.AbstractController", "control.AbstractRunningInverse", "identify.BlockVerdict"),
    *("stage.AdaptiveTracking", "stage.Decoupled"),
    *(f"control.{name}" for name in ("Design", "LoopResult", "Status", "LinearPlant", "Margins", "TransferFunction")),
    *(
        f"control.{name}"
        for name in ("assess", "design", "pd_lead_lag", "lead", "margins", "root_locus", "second_order")
    ),
    *(
        f"identify.{name}"
        for name in ("Info", "Judgment", "Run", "Sample", "NoiseBias", "Identification", "IDENTIFIERS", "Phase")
    ),
    # update and run_stream are for controllers, in the precision of the state that they are given
    *("identify.run_stream", "identify.as_fit", "identify.noise_bias", "control.identify_plant", "identify.decimate"),
    *(
        f"stage.{name}"
        for name in ("Amplifier", "Sensor", "piezo", "JacobianEstimate", "Kinematics", "identify_jacobian")
    ),
    *(f"stage.{name}" for name in ("axis_plant", "drive_in_turn", "perturbed", "upsample")),
}
# Names of a room that the package itself gives too.
SHARED = {"control.invert", "control.Inverse", "control.InverseStep"}

PRELUDE = """
import json, sys
import jax, numpy as np
import hystfit as hf
from hystfit import control, identify, stage
from hystfit.errors import PrecisionError
from hystfit.outcome import Status
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import Posterior

t = np.linspace(0.0, 2.0, 100)
u = 3 * np.sin(2 * np.pi * t) * np.exp(-0.2 * t)
early = hf.BoucWen(c=0.25, tau=0.5)  # made in single precision, used in double
hf.enable_x64()
model = hf.BoucWen()
again = early.replace(c=0.25, mu=0.5, tau=0.5, rho=0.5)
for kept in (early, again):
    assert np.asarray(hf.simulate(kept, u)[0]).dtype == float
assert {leaf.dtype for leaf in jax.tree_util.tree_leaves(again)} == {np.dtype(float)}
y = np.asarray(hf.simulate(model, u)[0])
record = hf.Record(u, y + 1e-3 * np.random.default_rng(0).normal(size=u.size), t=t)
three = np.stack([u, u, u], axis=1)
result = hf.fit(early, record, start="model", starts=1)
row = np.append(result.x, 1e-3)
nothing = Convergence(*(np.ones(row.size) for _ in range(3)))
posterior = Posterior(
    result, "nuts", "iid", (*result.free_names, "noise_white"), ("",) * row.size, np.tile(row, (1, 50, 1)), np.zeros((1, 50)), {},
    nothing, Status.OK, (), {}, 0.0, 0, {},
)
folder = result.save(sys.argv[1] + "/fit", report=False)
draws = posterior.save(sys.argv[1] + "/draws")
ukf = identify.Ukf.of(model, record)
jax.config.update("jax_enable_x64", False)
jax.clear_caches()
answers = {}
for name, call in json.loads(sys.stdin.read()).items():
    try:
        eval(call)
        answers[name] = "computed"
    except PrecisionError as error:
        answers[name] = "refused" if "enable_x64()" in str(error) else str(error)
    except Exception as error:
        answers[name] = f"{type(error).__name__}: {error}"
print(json.dumps(answers))
"""


def public() -> set[str]:
    """The names that the stub of the package and the lists of its rooms offer."""
    names = set(hf.__all__)
    for room in ("control", "identify", "stage"):
        folder = ROOT / "hystfit" / room
        source = next(path for path in (folder / "__init__.pyi", folder / "__init__.py") if path.exists())
        names |= {f"{room}.{name}" for name in re.findall(r"import (\w+) as \1", source.read_text(encoding="utf-8"))}
    return names - SHARED


def test_every_public_name_is_judged() -> None:
    assert set(REFUSED) | INDEPENDENT == public()
    assert not set(REFUSED) & INDEPENDENT


@pytest.fixture(scope="module")
def answers(tmp_path_factory) -> dict[str, str]:
    plain = {key: value for key, value in os.environ.items() if key != "JAX_ENABLE_X64"}
    folder = str(tmp_path_factory.mktemp("single"))
    program = [sys.executable, "-W", "ignore", "-c", textwrap.dedent(PRELUDE), folder]
    done = subprocess.run(program, input=json.dumps(REFUSED), capture_output=True, text=True, env=plain)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("name", REFUSED)
def test_a_verb_refuses_single_precision_with_the_remedy(name: str, answers: dict[str, str]) -> None:
    assert answers[name] == "refused"
