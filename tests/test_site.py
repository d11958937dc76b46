"""The front page and the documentation: what they show runs, what they list is complete, and the built pages are sound.

The site is built once, in its quick form (notebooks and gallery without outputs), for the tests of its pages.
"""

from __future__ import annotations

import ast
import functools
import http.server
import importlib
import itertools
import re
import shlex
import socketserver
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import ClassVar
from urllib.parse import unquote, urldefrag, urljoin, urlsplit

import pytest

import hystfit as hf
from hystfit.cli import app
from hystfit.cli.verbs import VERBS
from hystfit.fitting.solvers.registry import ESTIMATORS
from hystfit.identify.registry import IDENTIFIERS
from hystfit.inference.noise.registry import NOISES
from hystfit.models.registry import MODELS
from hystfit.outcome import Code, Status
from hystfit.reading.registry import FORMATS
from hystfit.sampling.registry import SAMPLERS

from .conftest import ROOT

DOCS = ROOT / "docs"
SOURCES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md")), ROOT / "paper" / "paper.md"]
OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*)")
OTHERS = {"std", "quick", "kinds"}  # options of a C compiler, and of programs beside the command line


def known_options() -> set[str]:
    """Every option of the command line."""
    return set(OPTION.findall(app.generate_docs(output_format="markdown")))


def code_blocks(path: Path, *languages: str) -> list[str]:
    """Fenced blocks of a Markdown file in these languages; "" is a block without one."""
    text = path.read_text(encoding="utf-8")
    fences = re.findall(r"^```([^\n]*)\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    return [block for language, block in fences if language.strip() in languages]


def shell_lines() -> list[tuple[str, str]]:
    """Every `hystfit` command of the documents, with the name of its file."""
    blocks = ((path, block) for path in SOURCES for block in code_blocks(path, "console", ""))
    lines = ((path, line.removeprefix("$ ").strip()) for path, block in blocks for line in block.splitlines())
    return sorted({(path.name, line.partition("#")[0].strip()) for path, line in lines if line.startswith("hystfit ")})


def python_blocks() -> list[tuple[str, str]]:
    """Every Python block of the documents, with the name of its file."""
    return [(path.name, block) for path in SOURCES for block in code_blocks(path, "python")]


@pytest.mark.parametrize(("name", "line"), shell_lines())
def test_shell_commands_parse(name, line):
    app.parse_args(shlex.split(line)[1:], exit_on_error=False, print_error=False)


def test_the_documents_have_commands_of_most_verbs():
    shown = {shlex.split(line)[1] for _, line in shell_lines()}
    assert shown >= {
        "fit",
        "check",
        "compare",
        "predict",
        "invert",
        "export",
        "sample",
        "profile",
        "design",
        "simulate",
        "run",
    }


@pytest.mark.parametrize(("name", "block"), python_blocks())
def test_python_blocks_compile_and_their_names_exist(name, block):
    tree = ast.parse(block)
    used = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    for node in used:
        if isinstance(node.value, ast.Name) and node.value.id == "hf":
            assert hasattr(hf, node.attr), f"{name}: hf.{node.attr}"
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "hystfit":
            missing = [one.name for one in node.names if not hasattr(importlib.import_module(node.module), one.name)]
            assert not missing, f"{name}: {node.module} has no {missing}"


def test_the_readme_runs(tmp_path):
    """Its Python lines and its first shell command, on a bundled record."""
    (block,) = code_blocks(ROOT / "README.md", "python")
    record = hf.datasets.load("stage-sine").window(0.0, 2.0)
    rows = "\n".join(f"{t:.4f},{u:.5f},{y:.4f}" for t, u, y in zip(record.t, record.u, record.y, strict=True))
    (tmp_path / "loop.csv").write_text(f"t_s,u_V,y_um\n{rows}\n")
    code = block.replace('"loop.csv"', repr(str(tmp_path / "loop.csv")))
    code = code.replace('hf.fit("auto", data)', 'hf.fit("bouc-wen", data, starts=1)')
    space: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), space)
    assert isinstance(space["result"], hf.FitResult)


def test_the_readme_is_a_front_page():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) < 120
    assert "make test" in text
    assert "docs/loops.light.svg" in text


def test_tables_of_accuracy_agree_with_the_experiments():
    """Numbers of the README are those of the results, rounded; rows of the paper are those of the results, times left out."""
    results = (ROOT / "experiments" / "measured" / "RESULTS.md").read_text(encoding="utf-8")
    measured = [float(cell) for cell in re.findall(r"\| (\d+(?:\.\d+)?) (?=\|)", results)]
    readme = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Accuracy")[2].partition("\n## ")[0]
    rows = re.findall(r"\| (\d[\d.]*) % \| (\d[\d.]*) % \|$", readme, flags=re.MULTILINE)
    assert len(rows) >= 6
    for cell in itertools.chain(*rows):
        digits = len(cell.replace(".", "").lstrip("0"))
        assert any(f"{value:.{digits}g}" == f"{float(cell):.{digits}g}" for value in measured), cell
    paper = (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")
    known = {line for path in (ROOT / "experiments").glob("*/RESULTS.md") for line in path.read_text().splitlines()}
    quoted = [line for line in paper.splitlines() if line.startswith("| ") and re.search(r"\d\.\d", line)]
    assert quoted
    assert [line for line in quoted if not any(row.startswith(line) for row in known)] == []


@pytest.mark.parametrize("name", ["control", "creep", "papers"])
def test_tables_of_the_guide_agree_with_the_experiments(name):
    """Every number with a decimal point in a table of these pages is a number of the results."""
    known = {n for path in (ROOT / "experiments").glob("*/RESULTS.md") for n in numbers(path.read_text())}
    page = (ROOT / "docs" / "guide" / f"{name}.md").read_text(encoding="utf-8")
    quoted = numbers("\n".join(line for line in page.splitlines() if line.startswith("| ")))
    assert quoted
    assert quoted <= known


def numbers(text: str) -> set[str]:
    return set(re.findall(r"(?<![\w.])\d+\.\d+(?![\w.])", text))


def links(path: Path) -> Iterator[str]:
    """Links and pictures of a Markdown file that lead to another file of the repository."""
    text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)\s]+)\)|(?:src|srcset)=\"([^\"]+)\"", text):
        link = target[0] or target[1]
        if not urlsplit(link).scheme and not link.startswith("#"):
            yield urldefrag(link)[0]


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "paper/paper.md"])
def test_links_of_the_repository_resolve(name):
    path = ROOT / name
    assert [link for link in links(path) if not (path.parent / link).exists()] == []


def test_remedies_use_options_that_exist():
    known, about = known_options(), tomllib.loads((DOCS / "codes.toml").read_text(encoding="utf-8"))
    assert list(about) == [str(code) for code in Code]
    for one in about.values():
        assert one["meaning"]
        assert [option for option in OPTION.findall(one["remedy"]) if option not in known] == []
        assert one["remedy"]


def test_options_in_the_documents_exist():
    known = known_options() | OTHERS
    for path in SOURCES:
        prose = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        assert [option for option in OPTION.findall(prose) if option not in known] == [], path


def test_a_model_without_an_entry_is_drawn_within_its_bounds(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    model_facts = importlib.import_module("generate.model_facts")
    known = model_facts._completed("bouc-wen", {})
    assert known.vary == {"c": [0.5, 1.0, 2.0], "mu": [0.2, 0.4, 0.8], "tau": [0.5, 1.0, 2.0], "rho": [0.25, 0.5, 1.0]}
    for name, values in known.vary.items():
        for value in values:
            known.model().replace(**{name: value})


def test_docstrings_become_restructured_text(monkeypatch):
    """Marks of restructured text in formulas are escaped; code, and indented equations, are literal."""
    monkeypatch.syspath_prepend(str(DOCS))
    escape_marks = importlib.import_module("generate.docstrings").escape_marks
    lines = ["The law |h| <= 2 * x_.", "", "    y = |u| * w_", "", "Call `f(*x)`_step.", "", "Args:", "    w_: of |x|."]
    escape_marks(None, "", "", None, None, lines)
    core, nodes = (pytest.importorskip(f"docutils.{name}") for name in ("core", "nodes"))
    document = core.publish_doctree("\n".join(lines).replace(".. code-block:: text", "::"))
    text = document.astext()
    assert not list(document.findall(nodes.system_message))
    for piece in ("|h| <= 2 * x_.", "y = |u| * w_", "f(*x)", "w_: of |x|."):
        assert piece in text


# -- the built site ----------------------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """Links, pictures, identifiers and title of a page."""

    VOID: ClassVar[dict[str, str]] = {"a": "href", "img": "src", "link": "href", "script": "src"}

    def __init__(self, path: Path):
        super().__init__()
        self.links: list[str] = []
        self.files: list[str] = []
        self.ids: set[str] = set()
        self.title = ""
        self._in_title = False
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.ids |= {found[key] or "" for key in ("id", "name") if key in found}
        target = found.get(self.VOID.get(tag, ""))
        if target and not urlsplit(target).scheme and not target.startswith("//"):
            (self.links if tag == "a" else self.files).append(target)
        self._in_title = tag == "title"

    def handle_data(self, data: str) -> None:
        self.title += data if self._in_title else ""


@pytest.fixture(scope="module")
def site() -> Path:
    """The folder of the built site."""
    pytest.importorskip("sphinx")
    out = ROOT / "build" / "docs-quick"
    command = [sys.executable, str(DOCS / "build.py"), "--quick", "--out", str(out)]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    return out / "site"


@pytest.fixture(scope="module")
def pages(site) -> dict[str, Page]:
    """Every page by its path from the site's root, without those of Sphinx itself."""
    skip = {"genindex.html", "search.html", "py-modindex.html"}
    paths = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts and path.name not in skip]
    return {path.relative_to(site).as_posix(): Page(path) for path in paths}


def test_every_part_has_its_page_or_section(pages):
    assert [name for name in MODELS if f"models/{name}.html" not in pages] == []
    text = lambda name: pages[name].text
    assert [code for code in Code if code.value not in pages["guide/verdict.html"].ids] == []
    assert [status for status in Status if f">{status}<" not in text("guide/verdict.html")] == []
    assert [name for name in NOISES if f'id="{name}"' not in text("guide/errors.html")] == []
    assert [name for name in SAMPLERS if f'id="{name}"' not in text("guide/samplers.html")] == []
    assert [name for name in (*ESTIMATORS, *IDENTIFIERS) if f">{name}<" not in text("guide/samplers.html")] == []
    assert [suffix for one in FORMATS for suffix in one.suffixes if f">{suffix}<" not in text("guide/files.html")] == []
    assert [verb for verb in VERBS if f'id="verb-{verb}"' not in text("reference/commands.html")] == []
    assert known_options() <= set(OPTION.findall(text("reference/commands.html")))
    reference = "".join(page.text for name, page in pages.items() if name.startswith("reference/api/"))
    public = [name for name in hf.__all__ if not name.startswith("_")]
    assert [name for name in public if f"hystfit.{name}" not in reference] == []


def test_every_notebook_can_be_opened_elsewhere(pages, site):
    for path in sorted((ROOT / "notebooks").glob("[0-9]*.py")):
        page = pages[f"notebooks/{path.stem}.html"]
        found = {Path(link).name: site / "notebooks" / link for link in page.links if "_downloads" in link}
        assert found[path.name].read_text(encoding="utf-8") == path.read_text(encoding="utf-8")
        assert '"cells"' in found[f"{path.stem}.ipynb"].read_text(encoding="utf-8")
        assert "Open in" not in found[f"{path.stem}.ipynb"].read_text(encoding="utf-8")


def test_every_page_has_a_title_and_resolving_links(pages, site):
    for name, page in pages.items():
        assert page.title.replace("hystfit", "").strip(" -—") or name == "index.html", name
        for link in page.links + page.files:
            target, anchor = urldefrag(urljoin(f"/{name}", link))
            path = site / unquote(urlsplit(target).path).lstrip("/")
            path = path / "index.html" if path.is_dir() else path
            assert path.exists(), f"{name}: {link}"
            known = pages.get(path.relative_to(site).as_posix())
            assert not anchor or known is None or unquote(anchor) in known.ids, f"{name}: {link}"


def test_every_page_is_two_clicks_from_the_front_page(pages):
    near = {"index.html"}
    for _ in range(2):
        found = (urldefrag(urljoin(f"/{name}", link))[0].lstrip("/") for name in near for link in pages[name].links)
        near = near | {name for name in found if name in pages}
    assert sorted(set(pages) - near) == []


def test_the_search_index_holds_the_pages(site):
    index = (site / "searchindex.js").read_text(encoding="utf-8")
    for name in ("models/bouc-wen", "guide/verdict", "reference/commands", "start"):
        assert f'"{name}"' in index


@pytest.fixture(scope="module")
def server(site) -> Iterator[str]:
    """Address of the site, served from this process."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args: object) -> None:
            pass

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads = True

    with Server(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site))) as served:
        threading.Thread(target=served.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{served.server_address[1]}"
        served.shutdown()


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (390, "light"), (390, "dark")])
def test_pages_in_a_browser(browser, server, pages, width, scheme):
    context = browser.new_context(viewport={"width": width, "height": 850}, color_scheme=scheme)
    page = context.new_page()
    page.set_default_timeout(20_000)
    faults: list[str] = []
    page.on("console", lambda message: message.type == "error" and faults.append(f"{page.url}: {message.text}"))
    page.on("pageerror", lambda error: faults.append(f"{page.url}: {error}"))
    page.on("response", lambda response: response.status >= 400 and faults.append(f"{response.url}: {response.status}"))
    shown = pages if width == 390 and scheme == "light" else dict(list(pages.items())[::5]) | {"index.html": None}
    for name in shown:
        page.goto(f"{server}/{name}", wait_until="load")
        seen = page.evaluate(
            """() => ({
                theme: document.documentElement.dataset.theme,
                wide: document.documentElement.scrollWidth - window.innerWidth,
                broken: [...document.images].filter(i => i.getClientRects().length && i.complete && !i.naturalWidth).map(i => i.src),
            })"""
        )
        faults += [f"{name}: no picture {source}" for source in seen["broken"]]
        if seen["wide"] > 0:
            faults.append(f"{name}: {seen['wide']} px wider than the window")
        if seen["theme"] != scheme:
            faults.append(f"{name}: shown in {seen['theme']}")
    context.close()
    assert faults == []
