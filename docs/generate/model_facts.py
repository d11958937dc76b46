"""What is written about models beside the registry: `docs/models.toml`, by name, with inherited entries filled in."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Any, Literal

from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import MODELS, make_model
from hystfit.params.space import ParameterSpace

SOURCE = Path(__file__).resolve().parents[1] / "models.toml"
DRAWN = 5  # parameters in the pictures of a model without an entry


@dataclasses.dataclass(frozen=True)
class Facts:
    """One entry of `models.toml`; the keys are explained there."""

    equation: str = ""
    makes: str = ""
    cannot: str = ""
    source: tuple[str, ...] = ()
    example: str = ""
    values: dict[str, float] = dataclasses.field(default_factory=dict)
    vary: dict[str, list[float]] = dataclasses.field(default_factory=dict)
    view: Literal["loop", "step"] = "loop"

    def model(self) -> AbstractHysteresis:
        """The model of the pictures."""
        made = (
            MODELS[self.example].make() if self.example in MODELS else make_model(self.example)
        )  # a filter alone, too
        return made.replace(**self.values)


def facts() -> dict[str, Facts]:
    """The facts of every registered model, by name."""
    with SOURCE.open("rb") as file:
        written: dict[str, dict[str, Any]] = tomllib.load(file)
    if unknown := set(written) - set(MODELS):
        raise ValueError(f"{SOURCE.name}: no model {', '.join(sorted(unknown))}")
    return {name: _completed(name, written) for name in MODELS}


def _completed(name: str, written: dict[str, dict[str, Any]]) -> Facts:
    """The entry of a model, with what it inherits, and with default values varied where it has no entry."""
    own = dict(written.get(name, {}))
    entry = {**written.get(own.pop("like", ""), {}), "example": name, **own}
    entry["source"] = tuple(entry.get("source", ()))
    if name not in written:
        entry["vary"] = _default_variation(name)
    return Facts(**entry)


def _default_variation(name: str) -> dict[str, list[float]]:
    """The first free parameters of a model at half, one and two times their default, within the bounds."""
    space = ParameterSpace.of(make_model(name))
    shown = list(zip(space.names, space.vector(space.template), space.infos, strict=True))[:DRAWN]
    inside = lambda value, bounds: min(max(value, bounds[0]), bounds[1])
    return {
        parameter: [inside(factor * float(value), info.bounds) for factor in (0.5, 1.0, 2.0)]
        for parameter, value, info in shown
        if value
    }
