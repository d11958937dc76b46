"""The kinds of generated files: each a function of random choices, by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from .drawing import Draw
from .truth import Layout

KINDS: dict[str, Callable[[Draw], Layout]] = {}


def kind(name: str) -> Callable[[Callable[[Draw], Layout]], Callable[[Draw], Layout]]:
    """Register a function that makes files of a kind."""

    def register(make: Callable[[Draw], Layout]) -> Callable[[Draw], Layout]:
        if name in KINDS:
            raise ValueError(f"two kinds are called {name!r}")
        KINDS[name] = make
        return make

    return register


def layout_of(seed: int) -> Layout:
    """The file of a seed; consecutive seeds go through all kinds."""
    name = sorted(KINDS)[seed % len(KINDS)]
    return dataclasses.replace(KINDS[name](Draw(seed)), kind=name)
