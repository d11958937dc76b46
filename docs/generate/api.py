"""The API reference: one page for each part of the public names, read from the stub of the package."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from collections.abc import Sequence
from pathlib import Path

import hystfit as hf

# Pages, each with the rooms whose public names it holds, by the first part of their modules.
PAGES = {
    "data": ("Data", ("data", "reading", "quality", "signals", "fitting.data_check")),
    "models": ("Models and parameters", ("models", "params")),
    "fitting": ("Fits", ("fitting", "results", "inference", "config", "errors")),
    "uncertainty": ("Uncertainty", ("sampling", "uncertainty")),
    "control": ("Inverse and control", ("control",)),
}
# Modules that are public as a whole, and parts of the library beside its front page.
MODULES = {
    "data": ("hystfit.signals",),
    "models": ("hystfit.testing",),
    "fitting": ("hystfit.identify", "hystfit.outcome"),
    "control": ("hystfit.control", "hystfit.stage"),
}


def public_names() -> dict[str, str]:
    """Module of every public name, as in `__init__.pyi`, relative to the package."""
    stub = ast.parse(Path(hf.__file__ or "").with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    found = {alias.name: node.module or "" for node in imports for alias in node.names}
    return {name: module for name, module in found.items() if not name.startswith("_")}


def page_of(module: str) -> str:
    """The page of a module: the longest prefix counts."""
    matches = [
        (len(room), page) for page, (_, rooms) in PAGES.items() for room in rooms if f"{module}.".startswith(f"{room}.")
    ]
    return max(matches)[1] if matches else "fitting"


def api_page(page: str) -> str:
    """The page of some rooms: its public names, then modules that are public as a whole."""
    title, _ = PAGES[page]
    names = [name for name, module in public_names().items() if module and page_of(module) == page]
    parts = [f"# {title}", *(_entry(f"hystfit.{name}", name) for name in sorted(names, key=str.lower))]
    for module in MODULES.get(page, ()):
        parts.append(_module(module))
    return "\n\n".join(parts)


def index_page() -> str:
    """Every public name with the first line of its description, by page."""
    rows = []
    for page, (title, _) in PAGES.items():
        names = sorted((n for n, module in public_names().items() if module and page_of(module) == page), key=str.lower)
        rows.append(
            f"## {title}\n\n"
            + "\n".join(f"- {{py:obj}}`hystfit.{name}`: {_first(getattr(hf, name))}" for name in names)
        )
    tree = "\n".join(PAGES)
    intro = (
        "`import hystfit as hf` gives these names; each is imported when it is first used. Fits need double precision: call "
        "`hf.enable_x64()` first."
    )
    return "\n\n".join(["# Python reference", intro, *rows, f"```{{toctree}}\n:hidden:\n\n{tree}\n```"])


def _first(member: object) -> str:
    """First line of a description, as plain text."""
    line = (inspect.getdoc(member) or "").partition("\n")[0]
    return re.sub(r"([*_<|\[])", r"\\\1", line)


def _directive(path: str, member: object) -> str:
    if inspect.ismodule(member):
        return f".. automodule:: {path}"
    if inspect.isclass(member):
        return f".. autoclass:: {path}\n   :members:\n   :no-undoc-members:{_of_parts(member)}"
    return f".. autofunction:: {path}" if callable(member) else f".. autodata:: {path}"


def _of_parts(member: type) -> str:
    """An option that documents what a class takes from parts of it in the same room, which are no public names."""
    room = member.__module__.split(".")[:2]
    bases = member.__mro__[1:]
    shown = [b for b in bases if b.__module__.split(".")[:2] == room and not b.__name__.startswith("Abstract")]
    parts = [b for b in shown if b.__name__ not in public_names()]
    others = ", ".join(b.__name__ for b in bases if b not in parts)
    return f"\n   :inherited-members: {others}" if parts else ""


def _entry(path: str, name: str) -> str:
    """A public name; of a module, its functions and classes."""
    member = getattr(hf, name)
    if inspect.ismodule(member):
        return _module(member.__name__, f"hystfit.{name}")
    return f"## {name}\n\n```{{eval-rst}}\n{_directive(path, member)}\n```"


def _module(path: str, title: str | None = None) -> str:
    """The functions and classes of a module that are not public names of the package too.

    Args:
        path: where it is.
        title: its public name, if another.
    """
    module = importlib.import_module(path)
    elsewhere = {id(getattr(hf, name)) for name in public_names()}
    names: Sequence[str] = getattr(module, "__all__", None) or [
        name for name in dir(module) if not name.startswith("_")
    ]
    members = {name: getattr(module, name) for name in names}
    shown = {name: m for name, m in members.items() if _belongs(m, path) and id(m) not in elsewhere}
    entries = (f"### {name}\n\n```{{eval-rst}}\n{_directive(f'{path}.{name}', m)}\n```" for name, m in shown.items())
    return "\n\n".join([f"## {title or path}", _first(module), *entries])


def _belongs(member: object, path: str) -> bool:
    """Whether a member is a documented function or class of this module or of one below it."""
    kind = inspect.isfunction(member) or inspect.isclass(member)
    return kind and getattr(member, "__module__", "").startswith(path) and bool(member.__doc__)
