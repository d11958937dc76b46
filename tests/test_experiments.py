"""Experiments without their measured data: skipped, with a status of its own, and neither ok nor missed."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hystfit.outcome import Status

from .conftest import ROOT

EXPERIMENTS = ROOT / "experiments"


def offline(folder: Path) -> dict[str, str]:
    """Environment of a machine with no measured data, an empty cache and no network."""
    (folder / "data").mkdir()
    nowhere = "http://127.0.0.1:9"  # the discard port: connections are refused
    return {
        **{name: value for name, value in os.environ.items() if name.lower() != "no_proxy"},
        **dict.fromkeys(("http_proxy", "https_proxy", "HTTP_PROXY", "HTTPS_PROXY"), nowhere),
        "HYSTFIT_DATA": str(folder / "data"),
        "XDG_CACHE_HOME": str(folder / "cache"),
        "PYTHONPATH": str(ROOT),
    }


@pytest.mark.parametrize("form", [["--quick"], pytest.param([], marks=pytest.mark.slow)], ids=["quick", "full"])
def test_an_experiment_without_its_data_is_skipped(tmp_path: Path, form: list[str]) -> None:
    page = EXPERIMENTS / "measured" / "RESULTS.md"
    before = page.read_bytes()
    start = [sys.executable, *(["-m", "tests.fast"] if form else [])]  # as `make` starts them
    command = [*start, str(EXPERIMENTS / "measured" / "run.py"), *form, "--out", str(tmp_path / "out")]
    ended = subprocess.run(command, env=offline(tmp_path), capture_output=True, text=True, timeout=300)
    assert ended.returncode == 77, ended.stdout + ended.stderr
    content = json.loads((tmp_path / "out" / "results.json").read_text())
    assert (content["status"], content["numbers"], content["failed"]) == (Status.SKIPPED, {}, [])
    expected = json.loads((EXPERIMENTS / "measured" / "expected.json").read_text())
    assert all(
        name.startswith(tuple(content["skipped"])) for name in expected if form == [] or "quick" not in expected[name]
    )
    assert ended.stdout.splitlines()[-len(content["skipped"]) - 1].startswith("skipped: 0 numbers")
    assert page.read_bytes() == before  # the page of a complete run stays


PART = """
import json, sys
sys.path[:0] = ["", sys.argv[1]]
from common import Results
from pathlib import Path
from importlib import import_module
no_longer_due = {}
for part in sys.argv[3:]:
    name, module, function = part.split(":")
    sys.path[0] = folder = str(Path(sys.argv[1], name))
    results = Results(Path(folder), quick=False, out=Path(sys.argv[2]))
    due = results.failures()
    assert not hasattr(getattr(import_module(module), function)(results), "curves")
    no_longer_due[part] = [key for key in results.expected if key in due and key not in results.failures()]
    for own in [key for key, made in sys.modules.items() if (getattr(made, "__file__", None) or "").startswith(folder)]:
        del sys.modules[own]  # experiments have modules of one name
print(json.dumps(no_longer_due))
"""
MEASURED = {
    "duhem:run:measured": ("piezo", "steel 1"),
    "preisach:measured:measured": ("measured reversal curves", "measured minor loops"),
    "uncertainty:bands:run": ("piezo", "damper", "magnetic"),
    "ukf:measured:measured": ("measured",),
    "structures:run:coupons": ("coupon",),
    "magnetics:run:families": ("MnZn_ferrite: all", "MnZn_ferrite: interior"),
}


def test_the_measured_part_of_an_experiment_is_skipped(tmp_path: Path) -> None:
    """Its numbers, and no others, are no longer due."""
    command = [sys.executable, "-c", PART, str(EXPERIMENTS), str(tmp_path / "out"), *MEASURED]
    ended = subprocess.run(command, env=offline(tmp_path), capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    for part, no_longer_due in json.loads(ended.stdout.splitlines()[-1]).items():
        expected = json.loads((EXPERIMENTS / part.partition(":")[0] / "expected.json").read_text())
        assert set(no_longer_due) == {key for key in expected if key.startswith(MEASURED[part])} != set()


@pytest.fixture
def common(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    import common

    return common


@pytest.mark.parametrize(
    ("numbers", "skipped", "status", "code"),
    [
        ({"a": 1.0, "b: x": 0.5}, (), Status.OK, 0),
        ({"a": 1.0}, ("b",), Status.SKIPPED, 77),
        ({"a": 1.0}, (), Status.MISSED, 1),  # b: x was not computed
        ({"a": 1.3}, ("b",), Status.MISSED, 1),  # a missed number counts more than a skipped part
        ({"a": float("nan"), "b: x": 0.5}, (), Status.MISSED, 1),
    ],
)
def test_status_of_an_experiment(common, tmp_path: Path, numbers, skipped, status, code) -> None:
    limits = {"a": {"value": 1.1, "tolerance": 0.15}, "b: x": {"bar": 0.6}}
    (tmp_path / "expected.json").write_text(json.dumps(limits))
    results = common.Results(tmp_path, quick=True)
    for name, value in numbers.items():
        results.add(name, value)
    results.skipped = dict.fromkeys(skipped, "no data")
    assert results.status is status
    with pytest.raises(SystemExit) as ended:
        results.finish()
    assert ended.value.code == code
    assert json.loads((tmp_path / "out" / "results.json").read_text())["status"] == status


def test_damaged_data_are_no_missing_data(common, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hystfit.errors import DataError

    (tmp_path / "expected.json").write_text("{}")
    results = common.Results(tmp_path, quick=True)
    monkeypatch.setenv("HYSTFIT_DATA", str(tmp_path))
    assert results.load("piezo", "piezo_dbo/model") is None
    (tmp_path / "piezo_dbo").mkdir()
    with pytest.raises(DataError):
        results.load("piezo", "piezo_dbo/model")


def test_a_page_has_all_stored_sections_and_names_the_others(common, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.syspath_prepend(str(EXPERIMENTS / "uncertainty"))
    from sections import Page

    sections = {name: lambda results, name=name: {name: "words"} for name in ("x", "y", "z")}
    (tmp_path / "expected.json").write_text("{}")
    for name, missing in (("z", "x, y"), ("x", "y"), ("y", "")):
        page = Page(common.Results(tmp_path, quick=False), sections)
        page.add(name)
        page.write(tmp_path)
        text = (tmp_path / "RESULTS.md").read_text()
        assert (f"not computed: {missing}." in text) == bool(missing)
    assert [line for line in text.splitlines() if line.startswith("## ")] == ["## x", "## y", "## z"]


@pytest.mark.parametrize("name", ["duhem", "preisach"])
def test_limits_are_near_their_values_or_name_what_they_guard(name: str) -> None:
    expected = json.loads((EXPERIMENTS / name / "expected.json").read_text())
    for key, entry in expected.items():
        assert entry["data"] in ("simulated", "measured"), key
        if "bar" in entry and "guards" not in entry:
            assert 0.5 <= entry["bar"] / entry["value"] <= 2, key
        elif "tolerance" in entry:
            assert entry["tolerance"] <= 0.5 * abs(entry["value"]), key


FAKE = """
from common import Mutation, substitute

def double(x):
    return 2 * x

def part(results):
    results.add("a", double(1.0))

def fault():
    substitute(double, lambda x: 3 * x)

def neutral():
    substitute(double, lambda x: x + x)

MUTATIONS = (Mutation("triple, fake", "all", fault, part), Mutation("sum, fake", "nothing", neutral, part))
"""


def mutated(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXPERIMENTS / "mutations.py"), *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)


def test_a_mutation_that_no_expectation_notices_survives(tmp_path: Path) -> None:
    (tmp_path / "mutations.py").write_text(FAKE)
    (tmp_path / "expected.json").write_text(json.dumps({"a": {"value": 2.0, "tolerance": 0.1}}))
    before = (EXPERIMENTS / "MUTATIONS.md").read_bytes()
    ended = mutated(str(tmp_path), "--only", "fake")
    assert ended.returncode == 1, ended.stderr
    noticed, survived = (line for line in ended.stdout.splitlines() if line.startswith(("noticed", "SURVIVED")))
    assert noticed.endswith("triple, fake: a: 3")
    assert survived.startswith("SURVIVED")
    assert "sum" in survived
    assert (EXPERIMENTS / "MUTATIONS.md").read_bytes() == before


@pytest.mark.slow
def test_an_experiment_notices_a_fault_in_the_library() -> None:
    ended = mutated("duhem", "--only", "RLS steps against the error")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.startswith("noticed: duhem: RLS steps against the error: noise free: RLS free-run maximum")


FIELD = """
import sys
sys.path[:0] = [sys.argv[1], sys.argv[2]]
from pathlib import Path
import numpy as np
import hystfit as hf
from tasks import Task

u, y = np.arange(8.0), np.array([0.0, 1, 2, 3, 4, 5, 6, np.nan])
records = hf.Record(u, y, name="a"), hf.Record(u, y + 10, name="b")
given = np.arange(8) < 3, np.zeros(8, bool)
asked = tuple(record.used & ~mask for record, mask in zip(records, given))
path = Path(sys.argv[3])
for free in (False, True):
    task = Task("task", "", records, given, asked, free, "")
    task.write(path)
    lines = path.read_text().splitlines()
    assert [line.split(",")[3] for line in lines[1:5]] == ["0.0", "1.0", "2.0", ""], lines
    assert not any(line.split(",")[3] for line in lines[5:])
    filled = [f"{line},{value}" for line, value in zip(lines[1:], [0] * 3 + [4, 5, 6, 7, 0] + [10, 12, 12, 14, 14, 16, 16, 0])]
    path.write_text("record,t,u,,y\\n" + "\\n".join(filled))
    print(task.score(task.read(path)))
    assert len(task.training) == 1 and task.training[0].used.sum() == 3
try:
    path.write_text("record,t,u,y\\n" + "\\n".join(lines[1:]))
    task.read(path)
except ValueError as error:
    print("lacks numbers" in str(error))
"""


def test_tasks_of_the_field_are_written_and_scored(tmp_path: Path) -> None:
    """Against the errors of that prediction by hand: 1 in four of four samples of a, by turns 0 and 1 in b; the range is 3 to 16."""
    command = [sys.executable, "-c", FIELD, str(EXPERIMENTS), str(EXPERIMENTS / "field"), str(tmp_path / "task.csv")]
    ended = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert ended.returncode == 0, ended.stderr
    plain, free, refused = ended.stdout.split()
    assert float(plain) == pytest.approx(100 * (7 / 11) ** 0.5 / 13)
    assert float(free) == pytest.approx(100 * (7 * (3 / 7 * 4 / 7) / 11) ** 0.5 / 13)
    assert refused == "True"
