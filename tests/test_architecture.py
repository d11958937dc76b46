"""The rooms: contracts on imports, no cycle of modules, one meaning for each module name."""

from collections import defaultdict
from pathlib import Path

import grimp
import pytest
from importlinter.cli import lint_imports

from .conftest import ROOT

# Names that mean the same thing in every room: a base class, a registry.
SHARED = {"__init__", "base", "registry", "check", "fit"}  # the verbs `check` and `fit`, and the functions behind them


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """All imports of the library, those in functions and for type checkers included."""
    return grimp.build_graph("hystfit", cache_dir=None)


def cycles(graph: grimp.ImportGraph) -> list[list[str]]:
    """Modules that import each other, directly or through others: strongly connected components (Tarjan 1972)."""
    index: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    components = []

    def visit(module: str) -> None:
        index[module] = lowest[module] = len(index)
        stack.append(module)
        for imported in sorted(graph.find_modules_directly_imported_by(module)):
            if imported not in index:
                visit(imported)
                lowest[module] = min(lowest[module], lowest[imported])
            elif imported in stack:
                lowest[module] = min(lowest[module], index[imported])
        if lowest[module] == index[module]:
            component = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(component) > 1:
                components.append(sorted(component))

    for module in sorted(graph.modules):
        if module not in index:
            visit(module)
    return components


def test_the_search_for_cycles_finds_them() -> None:
    graph = grimp.ImportGraph()
    for name in "abcde":
        graph.add_module(name)
    for importer, imported in ("ab", "bc", "ca", "cd", "de"):
        graph.add_import(importer=importer, imported=imported)
    assert cycles(graph) == [["a", "b", "c"]]


def test_no_modules_import_each_other(graph: grimp.ImportGraph) -> None:
    assert cycles(graph) == []


def test_rooms_import_only_rooms_below_them() -> None:
    """The contracts of pyproject.toml; `lint-imports` prints which imports break them."""
    assert lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True) == 0


def test_module_names_are_unique() -> None:
    places = defaultdict(list)
    for path in sorted((ROOT / "hystfit").rglob("*.py")):
        places[path.stem].append(path.relative_to(ROOT).as_posix())
    assert {name: paths for name, paths in places.items() if len(paths) > 1 and name not in SHARED} == {}


def test_importing_the_library_imports_none_of_its_rooms(graph: grimp.ImportGraph) -> None:
    """The public names come from the stub when they are first used."""
    assert graph.find_modules_directly_imported_by("hystfit") == {"hystfit.lazy"}
    assert Path(ROOT / "hystfit" / "__init__.pyi").is_file()
