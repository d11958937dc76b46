"""What the documents promise works: the skeleton of a model, the README's six lines, the lazy import."""

import ast
import inspect
import os
import pkgutil
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.models.registry import make_model
from hystfit.reading import registry
from hystfit.reading.files.text_file import TextFile
from hystfit.reading.layouts.array_table import table_of_arrays
from hystfit.reading.table.raw_table import Table
from hystfit.testing import check_model

from .conftest import ROOT


def blocks(name: str, language: str) -> list[str]:
    """Code blocks of a Markdown file."""
    text = (ROOT / name).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


@pytest.mark.parametrize("few", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_commands_of_the_start_page_print_what_it_shows(few, tmp_path, monkeypatch, capsys, request):
    """In order, from the example file to the inverse; only the sampler and the C compiler are left out."""
    if few:  # models: the page shows findings of `check`, and the winner of `fit`
        request.getfixturevalue("findings_alone")
        kinds = ("preisach", "bouc-wen", "bouc-wen+log-creep")
        monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: kinds)
    monkeypatch.chdir(tmp_path)
    page, shown, ran = (ROOT / "docs" / "start.md").read_text(encoding="utf-8"), 0, []
    for language, body in re.findall(r"```(console|text|python)\n(.*?)```", page, flags=re.DOTALL):
        if language == "python" and "savetxt" in body:
            exec(body, {})
        elif language == "console":
            ran = [line.split()[2:] for line in body.splitlines() if line.startswith("$ hystfit")]
            for words in ran:
                if words[0] not in ("completion", "sample"):
                    assert run(words) == 0
        elif language == "text":
            printed = " ".join(capsys.readouterr().out.split())
            for part in body.split("..."):
                assert " ".join(part.split()) in printed, (ran, part)
            shown += 1
    assert shown == 5


@pytest.fixture
def skeleton(tmp_path):
    (source,) = [block for block in blocks("CONTRIBUTING.md", "python") if "class Backlash" in block]
    path = tmp_path / "my_model.py"
    path.write_text(source, encoding="utf-8")
    return path


def test_skeleton_keeps_the_laws_and_fits(skeleton):
    model = make_model(f"{skeleton}:Backlash")
    check_model(model, kinked=("gap",))
    t = np.linspace(0, 4, 400)
    u = 5 * np.sin(2 * np.pi * t) * (0.3 + 0.7 * t / 4)
    p, y = 0.0, []
    for value in u:
        p = max(value - 0.8, min(value + 0.8, p))
        y.append(2.0 * p + 1.0)
    record = hf.Record(u=u, y=np.array(y) + np.random.default_rng(0).normal(0, 0.01, u.size), t=t)
    result = hf.fit(model, record)
    assert result.usable
    for name, truth in (("gain", 2.0), ("gap", 0.8), ("offset", 1.0)):
        assert abs(result[name].value - truth) < 4 * result[name].stderr < 0.05


def test_layout_of_the_example_reads_its_files(tmp_path, monkeypatch):
    (source,) = [block for block in blocks("CONTRIBUTING.md", "python") if "read_hash_loop" in block]
    names = {"np": np, "TextFile": TextFile, "Table": Table, "table_of_arrays": table_of_arrays}
    exec(source, names)
    monkeypatch.setattr(registry, "TEXTS", (names["read_hash_loop"], *registry.TEXTS))
    phase = np.linspace(0, 8, 300)
    u, y = np.sin(phase), np.sin(phase - 0.2)
    path = tmp_path / "loop.dat"
    path.write_text("\n".join(["#LOOP V um", *(f"{value:.6f}" for pair in zip(u, y, strict=True) for value in pair)]))
    record = hf.read(path)
    np.testing.assert_allclose([record.u, record.y], [u, y], atol=1e-6)
    assert (record.u_unit, record.y_unit) == ("V", "um")


def by_itself(code: str) -> subprocess.CompletedProcess:
    """Run a program in a process of its own, with JAX' own precision."""
    plain = {k: v for k, v in os.environ.items() if k != "JAX_ENABLE_X64"}
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=plain)


def test_import_starts_no_backend_and_brings_no_optional_package_and_single_precision_is_refused_with_the_remedy():
    code = (
        "import sys, hystfit, hystfit.cli\n"
        "assert 'jax' not in sys.modules, 'jax'\n"
        "import hystfit.fitting.fit, jax\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge._backends, 'backend'\n"
        "assert not jax.config.jax_enable_x64\n"
        "found = {'matplotlib', 'arviz', 'blackjax', 'emcee', 'h5py', 'jaxopt', 'openpyxl'} & set(sys.modules)\n"
        "assert not found, found\n"
        "import hystfit as hf, numpy as np\n"
        "t = np.arange(100.0)\n"
        "try:\n"
        "    hf.fit(hf.BoucWen(), hf.Record(u=np.sin(t), y=np.sin(t), t=t))\n"
        "except hf.HystfitError as error:\n"
        "    assert 'enable_x64' in str(error)\n"
        "else:\n"
        "    raise SystemExit('no refusal')\n"
    )
    run = by_itself(code)
    assert run.returncode == 0, run.stderr + run.stdout


def undocumented(kind: type) -> list[str]:
    """Public methods of a class with three or more arguments and no Args section; overrides of documented methods need none."""
    missing = []
    for name, member in vars(kind).items():
        function = getattr(member, "__func__", member)
        above = any(getattr(base, name, None).__doc__ for base in kind.__mro__[1:] if hasattr(base, name))
        if name.startswith("_") or not inspect.isfunction(function) or above:
            continue
        arguments = [p for p in inspect.signature(function).parameters if p not in ("self", "cls")]
        if len(arguments) >= 3 and "Args:" not in (function.__doc__ or ""):
            missing.append(f"{kind.__name__}.{name}")
    return missing


@pytest.mark.parametrize("name", [name for name in hf.__all__ if not name.startswith("_")])
def test_public_names_say_what_they_take(name):
    member = getattr(hf, name)
    assert (member.__doc__ or "").strip()
    if inspect.isclass(member):
        assert undocumented(member) == []
    elif inspect.isfunction(member) and len(inspect.signature(member).parameters) >= 3:
        assert "Args:" in member.__doc__


def test_a_method_without_description_takes_the_place_of_one_with():
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "hystfit").rglob("*.py"))
    kinds = [node for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)]
    methods = [(kind, one) for kind in kinds for one in kind.body if isinstance(one, ast.FunctionDef)]
    described = {one.name for _, one in methods if ast.get_docstring(one)}
    silent = [(kind, one) for kind, one in methods if not ast.get_docstring(one) and one.name[0] != "_" != kind.name[0]]
    assert len(described) > 500
    assert [f"{kind.name}.{one.name}" for kind, one in silent if not kind.bases or one.name not in described] == []


@pytest.mark.parametrize("page", ["SECURITY.md", "docs/guide/hard-use.md"])
def test_commands_of_promises_name_tests_that_exist(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    modules = re.findall(r"`python -m (tests[.\w]+)", text)
    commands = re.findall(r"`pytest (tests/\w+\.py)(?: -k (\"[^\"]+\"|\w+))?`", text)
    assert len(modules) + len(commands) == text.count("`python -m ") + text.count("`pytest ")
    assert all((ROOT / f"{module.replace('.', '/')}.py").is_file() for module in modules)
    for path, chosen in commands:
        names = re.findall(r"def (test_\w+)", (ROOT / path).read_text(encoding="utf-8"))
        for word in re.findall(r"\w+", chosen):
            assert word in ("or", "and", "not") or any(word in name for name in names), f"{path} -k {word}"


@pytest.mark.slow
def test_samplers_by_hand_agree_with_the_errors_of_the_fit():
    """The guide on `Problem.density`: every block runs, and NUTS and emcee by hand have the standard errors of least squares."""
    names: dict[str, Any] = {}
    for block in blocks("docs/guide/density.md", "python"):
        exec(block, names)
    errors = [names["fit"][name].stderr for name in names["fit"].free_names]
    for draws in ("by_nuts", "by_emcee"):
        np.testing.assert_allclose(names[draws].std(axis=0)[: len(errors)], errors, rtol=0.3)
    assert (
        abs(names["by_laplace"][:, -1].mean() - 0.02 * np.sqrt(2 / np.pi)) < 0.003
    )  # mean absolute value of the normal noise


def test_the_way_of_a_fit_names_what_there_is():
    """Each name in that table of CONTRIBUTING is a module, or something in one."""
    table = (
        (ROOT / "CONTRIBUTING.md")
        .read_text(encoding="utf-8")
        .partition("### The way of a fit")[2]
        .partition("\nThe `__init__")[0]
    )
    names = re.findall(r"`(hystfit\.[\w.]+)`", table)
    assert len(names) > 8
    for name in names:
        assert pkgutil.resolve_name(name) is not None, name
