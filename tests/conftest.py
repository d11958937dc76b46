"""Double precision for the whole session; measured data where they are."""

import functools
import gc
import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jaxtyping
import pytest
from hypothesis import settings

from hystfit.config import enable_x64

from . import compile_fast
from .sparing import Pictures, ShapeChecks

enable_x64()
# The same examples every time; `--hypothesis-profile=default` looks for new ones.
settings.register_profile("constant", derandomize=True, deadline=None)
settings.load_profile("constant")

ROOT = Path(__file__).resolve().parents[1]
MAPS = Path("/proc/self/maps")
# Memory maps of a process at which its compiled programs are dropped: Linux allows 65 530, each program takes about ten, and a
# worker that reaches the limit ends with a segmentation fault.
MOST_MAPS = 15_000
COLLECTION = 100_000  # new objects between garbage collections; a trace makes thousands that stay
PICTURES = Pictures()
LONGEST = (
    "sampling compare quality site export profiles models ukf fit inverse linear_part cli_process unfamiliar_records batch "
    "population noise cli weight_sampling preisach_fits left_out verdict oscillator first_fit preisach_compositions docs lanes quantities"
).split()


def pytest_configure(config: pytest.Config) -> None:
    """The flags are read at the first computation, and the rooms that are checked are imported, after this."""
    if config.option.markexpr == "not slow":
        compile_fast()
        jaxtyping.jaxtyped = ShapeChecks(jaxtyping.jaxtyped)


@functools.cache
def looks_inside(path: Path) -> bool:
    """Whether a test file imports from a room whose functions are traced, so that shapes are checked in its quick form too."""
    return bool(
        re.search(r"^from hystfit\.(identify|inference|models)\b", path.read_text(encoding="utf-8"), re.MULTILINE)
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first: two workers that take whole files then end at about the same time.

    Before them all those that check shapes, as a program that another file has traced is not traced again.
    """
    place = {f"test_{name}": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (not looks_inside(item.path), place.get(item.path.stem, len(place))))


def pytest_collection_finish() -> None:
    """Leave what was imported out of every later garbage collection, and collect as seldom as the command does: 4 % of the time."""
    PICTURES.draw_few()
    gc.freeze()
    gc.set_threshold(COLLECTION, *gc.get_threshold()[1:])


def pytest_runtest_setup() -> None:
    """Each test counts its calls anew."""
    if isinstance(jaxtyping.jaxtyped, ShapeChecks):
        jaxtyping.jaxtyped.test += 1


@pytest.fixture(autouse=True, scope="module")
def _few_programs() -> Iterator[None]:
    """Compiled programs of former files are dropped where they have become many."""
    yield
    if MAPS.is_file() and MAPS.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(autouse=True, scope="module")
def _shapes_checked(request: pytest.FixtureRequest) -> None:
    """In the quick form only files that look inside a traced room check shapes: in all files it takes a ninth of the time."""
    checked = request.config.option.markexpr != "not slow" or looks_inside(request.path)
    jaxtyping.config.update("jaxtyping_disable", not checked)


@pytest.fixture(autouse=True, scope="module")
def _pictures_drawn(request: pytest.FixtureRequest) -> None:
    """Each file draws its own pictures, and all of them where it looks into some or where all tests run."""
    PICTURES.kept.clear()
    looks = re.search(r"<svg|\.axes\b|imread|canvas", request.path.read_text(encoding="utf-8"))
    PICTURES.all_drawn = bool(looks) or request.config.option.markexpr != "not slow"


@pytest.fixture
def as_users_run() -> Iterator[None]:
    """Without the type checks of this session, which refuse bad arguments before the library's own errors can."""
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture(autouse=True)
def _figures_closed() -> Iterator[None]:
    """Each test starts without open figures: a test that counts figures counts only its own."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


@pytest.fixture
def findings_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """`check` without its comparison of models, which takes seconds, where the findings are looked at and not the advice."""
    monkeypatch.setattr("hystfit.fitting.data_check._compared", lambda _: None)


@pytest.fixture
def few_families(monkeypatch: pytest.MonkeyPatch) -> None:
    """A default comparison of a family of each kind: where it ends does not depend on the others, which take 10 s to compile."""
    kinds = (
        "preisach",
        "preisach-signed",
        "duhem",
        "bouc-wen",
        "bouc-wen+log-creep",
        "bouc-wen-force+viscous",
        "oscillator",
    )
    monkeypatch.setattr("hystfit.fitting.comparison.candidates.tried", lambda: kinds)


def examined(data: Any) -> Any:
    """The report of `check` on data without its comparison of models, which takes seconds."""
    # Imported here, as modules that are imported before the tests are collected escape their type checks.
    from hystfit.models.registry import judged
    from hystfit.quality.check import examine
    from hystfit.reading.in_memory import records_of

    return examine(records_of(data), judged())


@pytest.fixture(scope="session")
def measured() -> Path:
    """Folder of the public measured sets, from HYSTFIT_DATA or beside the checkout."""
    folder = Path(os.environ.get("HYSTFIT_DATA") or ROOT.parent / "shared" / "data")
    if not (folder / "piezo_dbo").is_dir():
        pytest.skip(f"no measured data: set HYSTFIT_DATA to their folder (looked in {folder})")
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    """A headless chromium of the system; skipped where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next(
        (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
    )
    if program is None:
        pytest.skip("no chromium on this machine")
    with api.sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield opened
        opened.close()
