"""Models by name: "bouc-wen", "lag+prandtl-ishlinskii:plays=8+creep", or "my_model.py:MyModel"."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any, Literal

from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen import BoucWen
from hystfit.models.bouc_wen_asymmetric import AsymmetricBoucWen
from hystfit.models.bouc_wen_force import BoucWenForce
from hystfit.models.compose import AbstractComposition, Offset, Series, Sum
from hystfit.models.creep import LinearCreep, LogCreep
from hystfit.models.duhem import Duhem
from hystfit.models.dynamics import Delay, Lag, SecondOrder
from hystfit.models.oscillator import BoucWenOscillator
from hystfit.models.prandtl_ishlinskii import PrandtlIshlinskii
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.signed import SignedPreisach
from hystfit.models.preisach.tabulated import TabulatedPreisach
from hystfit.models.rate import SaturatingRate, Viscous
from hystfit.models.relaxation import Relaxation
from hystfit.params.param import leaves_of
from hystfit.quality.needs import Needs
from hystfit.registry import class_from_file, file_of, near, refuse_unfinished

# What `check` finds about records decides which models are compared on them: output that lags (counter-clockwise loops) with time
# (piezo actuators) or without, loops that are symmetric about zero input (magnetic materials), force that leads, force that depends
# on the rate, resonances, and first-order reversal curves.
DataKind = Literal[
    "lagging-timed", "lagging-untimed", "point-symmetric", "leading", "leading-with-rate", "dynamic", "reversal-curves"
]
_LAGGING: tuple[DataKind, ...] = ("lagging-timed", "lagging-untimed")
SEARCH = "prandtl-ishlinskii-search"  # no model of its own: a fit searches that family for its terms on the data


def _word(value: int | bool | str) -> int | str:
    return ("no", "yes")[value] if isinstance(value, bool) else value


@dataclasses.dataclass(frozen=True)
class Entry:
    """A model that users choose by name.

    Attributes:
        make: builds it with its defaults, or with settings by name.
        place: "core" (a hysteresis), "before" or "after" (filters in series), "beside" (added to the output).
        doc: what it is for, one line.
        variant: whether a model of this class is this variant; the last entry that fits gives its name.
        compared_on: kinds of data on which `compare` tries it by default.
        compared_as: the expressions that are tried; the name by default.
    """

    make: Callable[..., AbstractHysteresis]
    place: str
    doc: str
    variant: Callable[[Any], bool] = lambda model: True
    compared_on: tuple[DataKind, ...] = ()
    compared_as: tuple[str, ...] = ()

    def settings(self) -> dict[str, int | bool | str]:
        """Settings besides the values of parameters, with their defaults."""
        given = inspect.signature(self.make).parameters.values()
        return {p.name: p.default for p in given if isinstance(p.default, (int, str))}

    def shown(self) -> str:
        """The settings as `make_model` takes them."""
        return ":".join(f"{name}={_word(value)}" for name, value in self.settings().items())

    def changed(self, model: AbstractHysteresis) -> list[str]:
        """Settings of a model that differ from the defaults, as `make_model` takes them."""
        chosen = model.settings()
        return [f"{name}={_word(chosen[name])}" for name, value in self.settings().items() if chosen[name] != value]


MODELS: dict[str, Entry] = {
    "duhem": Entry(
        Duhem.of_order,
        "core",
        "polynomial Duhem (Coleman-Hodgdon); local memory, 9 parameters",
        compared_on=(*_LAGGING, "leading"),
    ),
    "bouc-wen": Entry(
        BoucWen, "core", "normalized Bouc-Wen y = c v - h; symmetric loops, 5 parameters", compared_on=_LAGGING
    ),
    "bouc-wen-asymmetric": Entry(
        AsymmetricBoucWen,
        "core",
        "generalized Bouc-Wen: exponent, skew, bent backbone; 9 parameters",
        compared_on=("lagging-timed",),
    ),
    "bouc-wen-force": Entry(
        BoucWenForce,
        "core",
        "Bouc-Wen of a yielding element, force against displacement (dampers, steel); 6 parameters",
        compared_on=("leading",),
    ),
    "oscillator": Entry(
        BoucWenOscillator,
        "core",
        "mass, damper and Bouc-Wen spring that softens or hardens; force in, displacement out; needs time",
        compared_on=("dynamic",),
    ),
    "preisach": Entry(
        partial(Preisach.of, n=30, spacing="quantile"),
        "core",
        "Preisach with cells; weights >= 0 and smooth by a convex solve",
        compared_on=_LAGGING,
    ),
    "preisach-magnetic": Entry(
        partial(Preisach.of, n=40, symmetric=True, spacing="square"),
        "core",
        "Preisach of a material without remembered sign: mirror cells are tied",
        lambda model: model.symmetric,
        compared_on=("point-symmetric",),
    ),
    "preisach-relays": Entry(
        partial(Preisach.of, n=20, elements="relays", spacing="quantile"),
        "core",
        "Preisach with the classical point relays",
        lambda model: model.elements == "relays",
    ),
    "preisach-forc": Entry(
        partial(Preisach.of, n=40, spacing="reversal-curves"),
        "core",
        "Preisach with cells from first-order reversal curves, each a record that starts from saturation",
        lambda model: model.spacing == "reversal-curves",
        compared_on=("reversal-curves",),
    ),
    "preisach-forc-signed": Entry(
        partial(SignedPreisach.of, n=40, spacing="reversal-curves"),
        "core",
        "the same with masses of either sign: closer to the curves, no inverse",
        compared_on=("reversal-curves",),
    ),
    "everett-table": Entry(
        TabulatedPreisach.of,
        "core",
        "Preisach table read off curves that rise to peaks and fall back, without a solve (Song et al. 2005)",
    ),
    "prandtl-ishlinskii": Entry(
        PrandtlIshlinskii.of, "core", "weighted plays; output lags (piezo, magnetics); convex solve"
    ),
    "prandtl-ishlinskii-stop": Entry(
        partial(PrandtlIshlinskii.of, operator="stop"),
        "core",
        "weighted stops; force against displacement (dampers, steel); convex solve",
        lambda model: model.operator == "stop",
    ),
    "prandtl-ishlinskii-generalized": Entry(
        partial(PrandtlIshlinskii.of, degree=5, envelopes=3),
        "core",
        "weighted plays with envelopes: asymmetric loops; convex solve",
        lambda model: model.operator == "play" and len(model.envelopes) > 1,
    ),
    "prandtl-ishlinskii-hardening": Entry(
        partial(PrandtlIshlinskii.of, degree=3, operator="stop", hardening=3),
        "core",
        "weighted stops that fade with the path: cyclic hardening",
        lambda model: model.hardening.size > 0,
    ),
    "delay": Entry(Delay, "before", "pure delay of the input, in samples"),
    "lag": Entry(Lag, "before", "two first-order lags of the input (amplifier, sensor); needs time"),
    "creep": Entry(LinearCreep, "beside", "logarithmic creep of the input, added to the output; needs time"),
    "log-creep": Entry(
        LogCreep,
        "after",
        "logarithmic creep of the displacement, L(t) = L0 (1 + gamma log10 t); needs time",
        compared_on=("lagging-timed",),
        compared_as=("bouc-wen+log-creep",),
    ),
    "viscous": Entry(
        Viscous,
        "beside",
        "force in proportion to the input's rate; needs time",
        compared_on=("leading-with-rate",),
        compared_as=("bouc-wen-force+viscous",),
    ),
    "saturating-rate": Entry(SaturatingRate, "beside", "force that saturates in the input's rate; needs time"),
    "offset": Entry(Offset, "beside", "a constant for each record"),
    "relaxation": Entry(
        Relaxation,
        "after",
        "a part of the output follows slowly (curved actuators); needs time",
        compared_on=("lagging-timed",),
        compared_as=("bouc-wen+relaxation",),
    ),
    "second-order": Entry(
        SecondOrder,
        "after",
        "a resonance; needs time",
        compared_on=("dynamic",),
        compared_as=("bouc-wen+second-order", "prandtl-ishlinskii+second-order"),
    ),
}


def make_model(choice: str | type[AbstractHysteresis] | AbstractHysteresis) -> AbstractHysteresis:
    """The model that is meant by names joined by "+", by a file of the user's and a class in it, or by a class; a model itself.

    Filters named "before" precede, those "after" follow the sum of the others, in the order in which they are written. Settings
    follow a name: "preisach:n=60:reversible=no". A class of hystfit stands for its first name.

    Raises:
        ModelError: an unknown name or setting (the message lists what there is), a filter without a hysteresis, a file without
            such a class, a class that is not finished, a search, or something else than a model.
    """
    if isinstance(choice, AbstractHysteresis):
        return choice
    if isinstance(choice, type) and issubclass(choice, AbstractHysteresis):
        named = [name for name, kind in _kinds().items() if kind is choice]
        return MODELS[named[0]].make() if named else _made(choice)
    if not isinstance(choice, str):
        raise ModelError(
            f"expected a model, its class or its name, got {getattr(choice, '__name__', type(choice).__name__)}"
        )
    return _composed(choice)


def _composed(expression: str) -> AbstractHysteresis:
    """The model of an expression."""
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
        places[MODELS[name].place].append(MODELS[name].make(**(_chosen(name, given) if mark else {})))
    added = places["core"] + places["beside"]
    if not added:
        raise ModelError(f"{expression!r} has no hysteresis model: add one, such as bouc-wen")
    inner = added[0] if len(added) == 1 else Sum(*added)
    chain = [*places["before"], inner, *places["after"]]
    return inner if len(chain) == 1 else Series(*chain)


_SWITCH = {"yes": True, "true": True, "no": False, "false": False}


def _chosen(name: str, given: str) -> dict[str, int | bool | str]:
    """Settings of a model from "name=value:name=value".

    Raises:
        ModelError: not of that form, an unknown setting, or a value of another kind.
    """
    known, chosen = MODELS[name].settings(), {}
    for pair in given.split(":"):
        key, mark, text = (part.strip() for part in pair.partition("="))
        if not mark or key not in known or key in chosen:
            has = MODELS[name].shown() or "no settings"
            raise ModelError(
                f"{name}: settings are NAME=VALUE, each once, joined by colons; got {pair!r}, where it has {has}"
            )
        kind = type(known[key])
        try:
            chosen[key] = text if kind is str else _SWITCH[text.lower()] if kind is bool else int(text)
        except (KeyError, ValueError):
            needed = "yes or no" if kind is bool else "a whole number"
            raise ModelError(f"{name}: {key} is {needed}, got {text!r}") from None
    return chosen


def _made(kind: type[AbstractHysteresis]) -> AbstractHysteresis:
    """A model of a class of the user's, with its default values.

    Raises:
        ModelError: the class lacks a method, or a parameter has no default.
    """
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
    fitting = [name for name, kind in _kinds().items() if type(model) is kind and MODELS[name].variant(model)]
    return ":".join([fitting[-1], *MODELS[fitting[-1]].changed(model)]) if fitting else type(model).__name__


@functools.cache
def _kinds() -> dict[str, type[AbstractHysteresis]]:
    return {name: type(entry.make()) for name, entry in MODELS.items()}


def compared(*kinds: DataKind) -> tuple[str, ...]:
    """Models that a comparison tries on data of these kinds unless others are named."""
    chosen = (item for item in MODELS.items() if set(kinds) & set(item[1].compared_on))
    return tuple(expression for name, entry in chosen for expression in entry.compared_as or (name,))


def judged() -> dict[str, Needs]:
    """The data that models need, by the first name of each class with these needs; `check` reports on these."""
    first: dict[tuple[type[AbstractHysteresis], Needs], str] = {}
    counts: dict[str, int] = {}
    for name, entry in MODELS.items():
        model = entry.make()
        if model.needs is not None:
            if not any(issubclass(type(model), kind) and model.needs == needs for kind, needs in first):
                first[type(model), model.needs] = name
            counts[name] = sum(leaf.size for leaf in leaves_of(model) if not leaf.info.fixed)
    return {name: dataclasses.replace(needs, parameters=counts[name]) for (_, needs), name in first.items()}


def judged_as(name: str) -> str | None:
    """Name under which `judged` has the needs of a model; None where it declares none."""
    model = MODELS[name].make()
    same = lambda row, needs: (
        isinstance(model, _kinds()[row]) and dataclasses.replace(needs, parameters=0) == model.needs
    )
    return next((row for row, needs in judged().items() if same(row, needs)), None)
