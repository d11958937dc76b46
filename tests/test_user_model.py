"""A model of the user's own in one file: fitted, inverted by its closed form, exported as C and compared, here and at the shell."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.control import InverseStep, export_c
from hystfit.errors import ModelError
from hystfit.models.registry import make_model
from hystfit.testing import check_model

SOURCE = '''
import jax.numpy as jnp
import numpy as np
import equinox as eqx
from typing import ClassVar

from hystfit.models import AbstractHysteresis
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.c_code import CPart
from hystfit.params.param import param

SOLVED = []  # one entry each time the closed form is traced


class Backlash(AbstractHysteresis):
    """y = offset + k u + w p, p a play of half width r."""

    rate_independent: ClassVar[bool] = True
    k: jnp.ndarray = param(1.0, bounds=(0.0, np.inf), unit="y/u")
    w: jnp.ndarray = param(0.5, bounds=(0.0, np.inf), unit="y/u")
    r: jnp.ndarray = param(0.3, bounds=(0.0, np.inf), unit="u")
    offset: jnp.ndarray = param(0.0, unit="y", per_record=True, linear=True)

    def init(self, u0):
        return u0[None]

    def step(self, state, u0, u1, dt):
        p = jnp.clip(state[0], u1 - self.r, u1 + self.r)
        return p[None], self.offset + self.k * u1 + self.w * p

    def start(self, records):
        span = max(float(np.ptp(r.u)) for r in records)
        return eqx.tree_at(lambda m: m.r, self, jnp.asarray(0.1 * span))

    def reach(self):
        return -10.0, 10.0

    def step_inverse(self, sign=1.0):
        return BacklashStep(self)

    def c_part(self):
        return CPart(C, 1, {"K": self.k, "W": self.w, "R": self.r, "OFFSET": self.offset})


class BacklashStep(AbstractStepInverse):
    model: Backlash
    needs_limits: ClassVar[bool] = False

    def solve(self, state, u0, target, dt, low, high):
        SOLVED.append(1)
        m = self.model
        now = m.step(state, u0, u0, dt)[1]
        s, way = jnp.where(target < now, -1.0, 1.0), jnp.abs(target - now)
        dead = s * (state[0] - u0) + m.r
        x = jnp.where(way <= m.k * dead, way / m.k, (way + m.w * dead) / (m.k + m.w))
        return Root(u0 + s * x, m.k > 0)


C = """/* Backlash */
static void @f@_init(double *s, double u0)
{
    s[0] = u0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double p = fmax(u1 - @M@_R, fmin(u1 + @M@_R, s[0]));
    (void)u0;
    (void)dt;
    if (next)
        next[0] = p;
    return @M@_OFFSET + @M@_K * u1 + @M@_W * p;
}
"""
'''
T = np.linspace(0.0, 4.0, 240)
U = 3 * np.sin(2 * np.pi * T) * np.exp(-0.2 * T)


@pytest.fixture
def expression(tmp_path: Path) -> str:
    (tmp_path / "backlash.py").write_text(SOURCE)
    return f"{tmp_path / 'backlash.py'}:Backlash"


def loop() -> np.ndarray:
    """Output by a plain loop, with k = 2, w = 0.7, r = 0.4, and noise."""
    p, out = U[0], []
    for u in U:
        p = min(max(p, u - 0.4), u + 0.4)
        out.append(2 * u + 0.7 * p)
    return np.array(out) + 0.002 * np.random.default_rng(0).normal(size=U.size)


def test_in_python(expression: str, tmp_path: Path) -> None:
    record = hf.Record(U, loop(), t=T)
    result = hf.fit(expression, record, starts=2)
    assert result.usable
    assert {p.name: round(p.value, 2) for p in result.parameters} == {"k": 2.0, "w": 0.7, "r": 0.4, "offset": 0.0}
    solved = sys.modules[type(result.model).__module__].SOLVED
    before = len(solved)
    y = np.asarray(hf.simulate(result.model, U)[0])
    inverse = hf.invert(result, y)
    assert len(solved) > before  # the closed form, not a search
    assert inverse.ok
    np.testing.assert_allclose(inverse.y, y, atol=1e-12)
    comparison = hf.compare(record, [expression, "bouc-wen"])
    assert comparison.rows[0].name == expression
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: install gcc to test the exported code")
    # Beside another model as well: its prefix must not clash.
    model = hf.Sum(result.model, hf.Offset(value=0.25))
    _, source, harness = export_c(model, tmp_path / "c")
    flags = ["-Wall", "-Wextra", "-Werror", "-std=c99", "-pedantic"]
    subprocess.run([compiler, *flags, str(source), str(harness), "-o", str(tmp_path / "program"), "-lm"], check=True)
    lines = "\n".join([repr(float(U[0])), *(f"{float(u)!r} 0.0" for u in U)])
    done = subprocess.run([str(tmp_path / "program"), "f"], input=lines, capture_output=True, text=True, check=True)
    np.testing.assert_allclose([float(x) for x in done.stdout.split()], hf.simulate(model, U)[0], atol=1e-13)
    step = InverseStep.of(model)
    _, answer = step.run(step.init(U[0]), jnp.asarray(y + 0.25), jnp.zeros(U.size))
    lines = "\n".join([repr(float(U[0])), *(f"{float(v)!r} 0.0" for v in y + 0.25)])
    done = subprocess.run([str(tmp_path / "program"), "i"], input=lines, capture_output=True, text=True, check=True)
    found = np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])
    np.testing.assert_allclose(found[:, 0], answer.u, atol=1e-10)


def test_at_the_shell(expression: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "\n".join(f"{a!r},{b!r},{c!r}" for a, b, c in zip(T.tolist(), U.tolist(), loop().tolist(), strict=True))
    (tmp_path / "loop.csv").write_text("t_s,u_V,y_um\n" + rows + "\n")
    out = str(tmp_path / "fit")
    assert run(["fit", str(tmp_path / "loop.csv"), "--model", expression, "--starts", "2", "--out", out]) == 0
    target = ["--output", "y_um", "--time", "t_s", "--out", str(tmp_path / "inverse"), "--limits=-3:3"]
    assert run(["invert", out, str(tmp_path / "loop.csv"), *target]) == 0
    assert json.loads((tmp_path / "inverse" / "result.json").read_text())["status"] == "ok"
    assert run(["export", out, "--c", str(tmp_path / "c"), "--name", "backlash"]) == 0
    assert "Backlash" in (tmp_path / "c" / "backlash.c").read_text()
    capsys.readouterr()
    models = ["--models", f"{expression},bouc-wen"]
    assert run(["compare", str(tmp_path / "loop.csv"), *models, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["winner"] == expression


def test_it_keeps_the_laws(expression: str) -> None:
    check_model(make_model(expression), samples=24, kinked=["r"])


START = SOURCE[SOURCE.index("    def start(") : SOURCE.index("    def reach(")]


@pytest.mark.parametrize(("height", "width"), [pytest.param(1.0, 1.0, marks=pytest.mark.slow), (1e-6, 1e4)])
def test_starting_values_are_found_for_a_model_without_start(height: float, width: float, tmp_path: Path) -> None:
    """In every unit: outputs of micrometers in meters, inputs in tens of kilovolts."""
    (tmp_path / "plain.py").write_text(SOURCE.replace(START, ""))
    model = f"{tmp_path / 'plain.py'}:Backlash"
    record = hf.Record(width * U, height * loop(), t=T)
    started = make_model(model).start([record])
    error = float(np.sqrt(np.mean((record.y - hf.simulate(started, record.u)[0]) ** 2)))
    assert error < 0.1 * np.ptp(record.y)
    result = hf.fit(model, record)
    assert result.usable
    slope = height / width
    for name, truth in (("k", 2.0 * slope), ("w", 0.7 * slope), ("r", 0.4 * width)):
        assert abs(result[name].value / truth - 1) < 0.01


def test_default_starting_values_keep_bounds_fixed_values_and_linear_weights(tmp_path: Path) -> None:
    (tmp_path / "plain.py").write_text(SOURCE.replace(START, ""))
    model = make_model(f"{tmp_path / 'plain.py'}:Backlash")
    check_model(model, samples=24, kinked=["r"])
    result = hf.fit(model, hf.Record(U, loop(), t=T), fix={"r": 0.4}, starts=1)
    assert result["r"].value == 0.4
    other = hf.Record(U, loop() + 5.0, t=T, name="other")
    both = hf.fit(model, [hf.Record(U, loop(), t=T), other], starts=1)
    assert abs(both["offset@other"].value - 5.0) < 0.01
    raised = model.start([other])
    np.testing.assert_allclose(
        float(raised.offset), np.mean(other.y - hf.simulate(raised.replace(offset=0.0), U)[0]), atol=1e-6
    )


def test_a_model_without_step_is_refused_by_name_and_file(tmp_path: Path) -> None:
    (tmp_path / "half.py").write_text(SOURCE.replace("def step(self, state, u0", "def stride(self, state, u0"))
    with pytest.raises(ModelError) as caught:
        hf.fit(f"{tmp_path / 'half.py'}:Backlash", hf.Record(U, loop(), t=T))
    with pytest.raises(ModelError) as checked:
        check_model(f"{tmp_path / 'half.py'}:Backlash")
    for word in ("Backlash", "step", "half.py"):
        assert word in str(caught.value)
        assert word in str(checked.value)
