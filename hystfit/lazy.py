"""Public names that are imported when they are first used."""

import ast
import pkgutil
from collections.abc import Callable
from typing import Any

import lazy_loader


def public_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package that is being imported, by its `__init__.pyi`, also inside a zip archive."""
    submodules, names = set[str](), dict[str, list[str]]()
    for node in ast.parse(pkgutil.get_data(package, "__init__.pyi") or b"").body:
        if isinstance(node, ast.ImportFrom) and node.module:
            names.setdefault(node.module, []).extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            submodules |= {alias.name for alias in node.names}
    return lazy_loader.attach(package, submodules, names)
