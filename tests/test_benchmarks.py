"""What makes a benchmark run fail; the benchmarks themselves run in `make smoke`."""

import sys
from collections.abc import Iterator
from types import ModuleType

import pytest

from .conftest import ROOT


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """benchmarks/run.py, imported as its command line imports it."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import run

    yield run
    for name in ("run", "rows"):
        sys.modules.pop(name, None)


def test_a_ratio_below_its_floor_fails(run: ModuleType) -> None:
    """Peer over hystfit: 2 s beside 1 s is a ratio of 2; a row without a peer is not judged."""
    rows = [run.Row("forward / numba", 1.0, 2.0), run.Row("fit / lmfit", 1.0, None, "not installed")]
    floor = lambda value: {"forward / numba": {"value": 2.5, "floor": value}}
    assert run.below(rows, floor(1.9)) == []
    assert len(run.below(rows, floor(2.1))) == 1
    assert run.below(rows, {}) == []
    assert run.unguarded(rows, {}) == ["forward / numba"]


def test_the_table_has_a_line_for_each_row_and_the_reason_of_a_skipped_one(run: ModuleType) -> None:
    rows = [run.Row("forward / numba", 3e-3, 1.5e-3), run.Row("fit / lmfit", 1.0, None, "not installed")]
    table = run.markdown(rows, {"forward / numba": {"value": 0.5, "floor": 0.35}})
    assert "| forward / numba | 3 ms | 1.5 ms | 0.50 | 0.35 |" in table
    assert "| fit / lmfit | 1 s | - | not installed | - |" in table
