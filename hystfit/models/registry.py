"""Models by name: "bouc-wen", "lag+prandtl-ishlinskii:plays=8+creep", or "my_model.py:MyModel"."""

from __future__ import annotations

import dataclasses
import functools
import types
from collections.abc import Mapping

from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.composition import AbstractComposition
from hystfit.models.entries import MODELS
from hystfit.models.series import Series
from hystfit.models.sum import Sum
from hystfit.params.param import leaves_of
from hystfit.quality.needs import Needs
from hystfit.registry import class_from_file, file_of, near, refuse_unfinished

SEARCH = "prandtl-ishlinskii-search"  # no model of its own: a fit searches that family for its terms on the data


def make_model(choice: str | type[AbstractHysteresis] | AbstractHysteresis) -> AbstractHysteresis:
    """The model that is meant by names joined by "+", by a file of the user's and a class in it, or by a class; a model itself.

    Filters named "before" precede, those "after" follow the sum of the others, in the order in which they are written. Settings
    follow a name: "preisach:n=60:reversible=no". A class of hystfit stands for its first name.
    """
    if isinstance(choice, AbstractHysteresis):
        return choice
    if isinstance(choice, type) and issubclass(choice, AbstractHysteresis):
        named = [name for name, entry in MODELS.items() if entry.makes(choice)]
        return MODELS[named[0]].default if named else _made(choice)
    if not isinstance(choice, str):
        raise ModelError(
            f"expected a model, its class or its name, got {getattr(choice, '__name__', type(choice).__name__)}"
        )
    return _composed(choice)


def _composed(expression: str) -> AbstractHysteresis:
    if ".py:" in expression:
        path, _, name = expression.rpartition(":")
        return _made(class_from_file(path, name, AbstractHysteresis, ModelError))
    if expression == SEARCH:
        raise ModelError(
            f"{SEARCH} chooses its terms on data: fit or compare it, and use the model that the result names"
        )
    places: dict[str, list[AbstractHysteresis]] = {"before": [], "core": [], "beside": [], "after": []}
    for part in expression.split("+"):
        name, mark, given = (text.strip() for text in part.partition(":"))
        if name not in MODELS:
            hint = near(name, MODELS)
            raise ModelError(f"no model {name!r}{hint}; the models are: {', '.join(MODELS)} (join several by +)")
        entry = MODELS[name]
        places[entry.place].append(entry.make(**_chosen(name, given)) if mark else entry.default)
    added = places["core"] + places["beside"]
    if not added:
        raise ModelError(f"{expression!r} has no hysteresis model: add one, such as bouc-wen")
    inner = added[0] if len(added) == 1 else Sum(*added)
    chain = [*places["before"], inner, *places["after"]]
    return inner if len(chain) == 1 else Series(*chain)


_SWITCH = {"yes": True, "true": True, "no": False, "false": False}


def _chosen(name: str, given: str) -> dict[str, int | bool | str]:
    """Settings of a model from "name=value:name=value"."""
    known, chosen = MODELS[name].settings(), {}
    for pair in given.split(":"):
        key, mark, text = (part.strip() for part in pair.partition("="))
        if not mark or key not in known or key in chosen:
            has = MODELS[name].shown() or "no settings"
            raise ModelError(
                f"{name}: settings are NAME=VALUE, each once, joined by colons; got {pair!r}; it has {has}"
            )
        kind = type(known[key])
        try:
            chosen[key] = text if kind is str else _SWITCH[text.lower()] if kind is bool else int(text)
        except (KeyError, ValueError):
            needed = "yes or no" if kind is bool else "a whole number"
            raise ModelError(f"{name}: {key} is {needed}, got {text!r}") from None
    return chosen


def _made(kind: type[AbstractHysteresis]) -> AbstractHysteresis:
    """A model of a class of the user's, with its default values."""
    refuse_unfinished(kind, ModelError)
    try:
        return kind()
    except TypeError as error:
        raise ModelError(
            f"{kind.__name__} in {file_of(kind)} cannot be made without arguments: {error}; give its parameters defaults"
        ) from error


def model_name(model: AbstractHysteresis) -> str:
    """The expression that makes the model again, with the settings that differ from its name's defaults.

    Parts are in the order of the signal. A model of the user's has the name of its class.
    """
    if isinstance(model, AbstractComposition):
        return "+".join(model_name(part) for part in model.parts)
    fitting = [name for name, entry in MODELS.items() if entry.makes(type(model)) and entry.variant(model)]
    return ":".join([fitting[-1], *MODELS[fitting[-1]].changed(model)]) if fitting else type(model).__name__


def tried() -> tuple[str, ...]:
    """Expressions that a comparison tries unless others are named."""
    return tuple(dict.fromkeys(expression for entry in MODELS.values() for expression in entry.tried))


@functools.cache
def judged() -> Mapping[str, Needs]:
    """The data that models need, by the first name of each class with these needs; `check` reports on these."""
    first: dict[tuple[type[AbstractHysteresis], Needs], str] = {}
    counts: dict[str, int] = {}
    for name, entry in MODELS.items():
        model = entry.default
        if model.needs is not None:
            if not any(issubclass(type(model), kind) and model.needs == needs for kind, needs in first):
                first[type(model), model.needs] = name
            counts[name] = sum(leaf.size for leaf in leaves_of(model) if not leaf.info.fixed)
    found = {name: dataclasses.replace(needs, parameters=counts[name]) for (_, needs), name in first.items()}
    return types.MappingProxyType(found)


def judged_as(name: str) -> str | None:
    """Name under which `judged` has the needs of a model; None where it declares none."""
    model = MODELS[name].default
    same = lambda row, needs: (
        isinstance(model, type(MODELS[row].default)) and dataclasses.replace(needs, parameters=0) == model.needs
    )
    return next((row for row, needs in judged().items() if same(row, needs)), None)
