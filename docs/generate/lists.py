"""Lists of choices: note codes and statuses, noise models, samplers, methods, signals, file formats, benchmarks."""

from __future__ import annotations

import ast
import inspect
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path

from generate.markdown import docstring, plain, table
from hystfit.cli.verbs import as_options
from hystfit.fitting.solvers.registry import ESTIMATORS
from hystfit.identify.registry import IDENTIFIERS
from hystfit.inference.noise.registry import NOISES
from hystfit.outcome import Code, Status
from hystfit.params.param import leaves_of
from hystfit.params.units import Scales
from hystfit.reading.registry import ARRANGEMENTS, FORMATS, REPLACING, TEXTS
from hystfit.registry import Registry
from hystfit.results.measured.quantities import QUANTITIES
from hystfit.sampling.registry import SAMPLERS
from hystfit.signals.registry import SIGNALS

ROOT = Path(__file__).resolve().parents[2]


def quantities() -> str:
    """Every engineering quantity with its definition and unit."""
    units = {"u": "[u]", "y": "[y]", "stiffness": "[force]/[displacement]", "energy": "energy, or [u] [y]"}
    rows = [(f"`{name}`", one.label, plain(one.doc), one.unit.format(**units)) for name, one in QUANTITIES.items()]
    return table(["name", "in a report", "definition", "unit"], rows)


def statuses() -> str:
    """Every status with its advice, in the words of the shell."""
    rows = [(f"`{status}`", "0" if status.usable else "1", plain(as_options(status.advice()))) for status in Status]
    return table(["status", "exit status", "what to do"], rows)


def codes() -> str:
    """Every note code, in the groups of its enumeration."""
    return "\n\n".join(f"### {heading}\n\n{_codes(members)}" for heading, members in _code_groups().items())


def code_meanings() -> dict[str, dict[str, str]]:
    """Meaning and remedy of each note code, from `docs/codes.toml`."""
    return tomllib.loads((ROOT / "docs" / "codes.toml").read_text(encoding="utf-8"))


def _codes(members: Iterable[Code]) -> str:
    """Each code under an anchor of its own, so that a report can link to it."""
    about = code_meanings()
    rows = [
        (f'<a id="{code}"></a>`{code}`', plain(about[code]["meaning"]), plain(about[code]["remedy"]))
        for code in members
    ]
    return table(["code", "meaning", "what to do"], rows)


def _code_groups() -> dict[str, list[Code]]:
    """The codes by the comments that divide the source of the enumeration."""
    groups: dict[str, list[Code]] = {}
    heading = "Other"
    for line in inspect.getsource(Code).splitlines():
        if comment := re.match(r"    # (.+)", line):
            heading = comment[1][0].upper() + comment[1][1:]
        elif member := re.match(r"    ([A-Z][A-Z_]+) = ", line):
            groups.setdefault(heading, []).append(Code[member[1]])
    return groups


def noises() -> str:
    """Every noise model with its description and parameters."""
    label = Scales(u_unit="[u]", y_unit="[y]").label
    parts = []
    for name in NOISES:
        kind = NOISES[name]
        rows = [
            (f"`{leaf.path[-1]}`", plain(label(leaf.info.unit)) or "1", plain(leaf.info.doc))
            for leaf in leaves_of(kind())
        ]
        parts.append(f"### {name}\n\n{_described(kind)}\n\n{table(['parameter', 'unit', 'meaning'], rows)}")
    return "\n\n".join(parts)


def samplers() -> str:
    """Every sampler with its settings."""
    return "\n\n".join(
        f"### {name}\n\n{_described(SAMPLERS[name])}\n\n{_attributes(SAMPLERS[name])}" for name in SAMPLERS
    )


def methods() -> str:
    """Every estimator and identifier."""
    batch, sequential = (
        table(["`--method`", "what it does"], [(f"`{name}`", _first(registry, name)) for name in registry])
        for registry in (ESTIMATORS, IDENTIFIERS)
    )
    return f"### On whole records\n\n{batch}\n\n### Sample by sample\n\n{sequential}"


def signals() -> str:
    """Every excitation of `hystfit simulate` and `hystfit.signals`."""
    rows = [
        (f"`{name}`", plain(entry.doc), ", ".join(f"`{p}`" for p in entry.parameters))
        for name, entry in SIGNALS.items()
    ]
    return table(["signal", "what it is", "parameters"], rows)


def formats() -> str:
    """Every kind of file that can be read."""
    about = "any ending; delimiter, decimal mark, header, units and encoding are recognized"
    rows = [("text", about), *(("", plain(inspect.getdoc(read) or "")) for read in TEXTS[:-1])]
    rows += [(" ".join(f"`{suffix}`" for suffix in one.suffixes), plain(one.about)) for one in FORMATS]
    rows += [
        ("columns of any file", plain((inspect.getdoc(one) or "").split(";")[0])) for one in (*ARRANGEMENTS, *REPLACING)
    ]
    return table(["file", "what is read"], rows)


def benchmarks() -> str:
    """The page of the benchmarks where the checkout has one; else what each of them measures."""
    page = ROOT / "benchmarks" / "README.md"
    if page.exists():
        return re.sub(r"^# .*\n", "", page.read_text(encoding="utf-8"), count=1)
    scripts = sorted(page.parent.glob("*.py"))
    about = {path.name: ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "" for path in scripts}
    rows = [(f"`benchmarks/{name}`", plain(text.splitlines()[0])) for name, text in about.items() if text]
    return table(["program", "what it measures"], rows)


def _first(registry: Registry, name: str) -> str:
    """First sentence of what a part does."""
    return plain((inspect.getdoc(registry[name]) or "").partition("\n\n")[0].replace("\n", " "))


def _described(kind: object) -> str:
    return docstring(inspect.getdoc(kind) or "")


def _attributes(kind: object) -> str:
    """The Attributes section of a docstring as a table."""
    _, _, section = (inspect.getdoc(kind) or "").partition("Attributes:\n")
    items = re.findall(r"^    (\w[\w, ]*): (.+(?:\n {8}.+)*)", section, flags=re.MULTILINE)
    rows = [(f"`{name}`", plain(re.sub(r"\s+", " ", text))) for name, text in items]
    return table(["setting", "meaning"], rows)
