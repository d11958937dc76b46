"""Models by name: "bouc-wen", "lag+prandtl-ishlinskii:plays=8+creep", or "my_model.py:MyModel"."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import inspect
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen import BoucWen
from hystfit.models.bouc_wen_asymmetric import AsymmetricBoucWen
from hystfit.models.bouc_wen_force import BoucWenForce
from hystfit.models.compose import Offset, Series, Sum
from hystfit.models.creep import LinearCreep, LogCreep
from hystfit.models.duhem import Duhem
from hystfit.models.dynamics import Delay, Lag, SecondOrder
from hystfit.models.oscillator import BoucWenOscillator
from hystfit.models.prandtl_ishlinskii import PrandtlIshlinskii
from hystfit.models.preisach.model import Preisach
from hystfit.models.rate import SaturatingRate, Viscous
from hystfit.models.relaxation import Relaxation
from hystfit.quality.needs import Needs


@dataclasses.dataclass(frozen=True)
class Entry:
    """A model that the command line knows.

    Attributes:
        make: builds it with its defaults, or with settings by name.
        place: "core" (a hysteresis), "before" or "after" (filters in series), "beside" (added to the output).
        doc: what it is for, one line.
        variant: tells this model from others of its class that stand before it.
    """

    make: Callable[..., AbstractHysteresis]
    place: str
    doc: str
    variant: Callable[[Any], bool] = lambda model: True

    def settings(self) -> dict[str, int | bool | str]:
        """What can be chosen beside values of parameters, with what it is where nothing is said."""
        given = inspect.signature(self.make).parameters.values()
        return {p.name: p.default for p in given if isinstance(p.default, (int, str))}

    def shown(self) -> str:
        """The settings as `make_model` takes them."""
        said = lambda value: ("no", "yes")[value] if isinstance(value, bool) else value
        return ":".join(f"{name}={said(value)}" for name, value in self.settings().items())


MODELS: dict[str, Entry] = {
    "duhem": Entry(Duhem.of_order, "core", "polynomial Duhem (Coleman-Hodgdon); local memory, 9 parameters"),
    "bouc-wen": Entry(BoucWen, "core", "normalized Bouc-Wen y = c v - h; symmetric loops, 5 parameters"),
    "bouc-wen-asymmetric": Entry(
        AsymmetricBoucWen, "core", "generalized Bouc-Wen: exponent, skew, bent backbone; 9 parameters"
    ),
    "bouc-wen-force": Entry(
        BoucWenForce,
        "core",
        "Bouc-Wen of a yielding element, force against displacement (dampers, steel); 6 parameters",
    ),
    "bouc-wen-oscillator": Entry(
        BoucWenOscillator, "core", "mass, damper and Bouc-Wen spring; force in, displacement out; needs time"
    ),
    "preisach": Entry(
        partial(Preisach.of, n=30, spacing="quantile"),
        "core",
        "Preisach with cells; weights >= 0 and smooth by a convex solve",
    ),
    "preisach-magnetic": Entry(
        partial(Preisach.of, n=40, symmetric=True, spacing="square"),
        "core",
        "Preisach of a material without remembered sign: mirror cells are tied",
        lambda model: model.symmetric,
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
        PrandtlIshlinskii.generalized,
        "core",
        "weighted plays with envelopes: asymmetric loops; convex solve",
        lambda model: model.operator == "play" and len(model.envelopes) > 1,
    ),
    "prandtl-ishlinskii-hardening": Entry(
        partial(PrandtlIshlinskii.of, degree=3, operator="stop", hardening=True),
        "core",
        "weighted stops that fade with the path: cyclic hardening",
        lambda model: model.hardening.size > 0,
    ),
    "delay": Entry(Delay, "before", "pure delay of the input, in samples"),
    "lag": Entry(Lag, "before", "two first-order lags of the input (amplifier, sensor); needs time"),
    "creep": Entry(LinearCreep, "beside", "logarithmic creep of the input, added to the output; needs time"),
    "log-creep": Entry(
        LogCreep, "after", "logarithmic creep of the displacement, L(t) = L0 (1 + gamma log10 t); needs time"
    ),
    "viscous": Entry(Viscous, "beside", "force in proportion to the input's rate; needs time"),
    "saturating-rate": Entry(SaturatingRate, "beside", "force that saturates in the input's rate; needs time"),
    "offset": Entry(Offset, "beside", "a constant for each record"),
    "relaxation": Entry(Relaxation, "after", "a part of the output follows slowly (curved actuators); needs time"),
    "second-order": Entry(SecondOrder, "after", "a resonance; needs time"),
}


def make_model(expression: str) -> AbstractHysteresis:
    """The model that an expression names: names joined by "+", or a file of the user's and a class in it.

    Filters named "before" precede, those "after" follow the sum of the others, in the order in which they are written. Settings
    follow a name: "preisach:n=60:reversible=no".

    Raises:
        ModelError: an unknown name or setting (the message lists what there is), a filter without a hysteresis, a file without
            such a class.
    """
    if ".py:" in expression:
        return _from_file(expression)
    places: dict[str, list[AbstractHysteresis]] = {"before": [], "core": [], "beside": [], "after": []}
    for part in expression.split("+"):
        name, mark, given = (text.strip() for text in part.partition(":"))
        if name not in MODELS:
            raise ModelError(f"no model {name!r}; the models are: {', '.join(MODELS)} (join several by +)")
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


def _from_file(expression: str) -> AbstractHysteresis:
    path, _, name = expression.rpartition(":")
    kind = load_class(path, name)
    try:
        return kind()
    except TypeError as error:
        raise ModelError(
            f"{name} of {path} cannot be made without arguments: {error}; give its parameters defaults"
        ) from error


def load_class(path: str, name: str) -> type[AbstractHysteresis]:
    """A model class from a file of the user's.

    Raises:
        ModelError: the file cannot be read or run, or holds no such model.
    """
    file = Path(path)
    if not file.is_file():
        raise ModelError(f"no file {path!r} with a model")
    spec = importlib.util.spec_from_file_location(f"model_file_{file.stem}", file.resolve())
    if spec is None or spec.loader is None:
        raise ModelError(f"{path!r} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses and the saved description look up the module of a class there
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[spec.name]
        raise ModelError(f"{path} does not run: {type(error).__name__}: {error}") from error
    kind = getattr(module, name, None)
    if not (isinstance(kind, type) and issubclass(kind, AbstractHysteresis)):
        found = [k for k, v in vars(module).items() if isinstance(v, type) and issubclass(v, AbstractHysteresis)]
        raise ModelError(f"{path} has no model {name!r}; it has {found}")
    return kind


def model_name(model: AbstractHysteresis) -> str:
    """Names as `make_model` takes them, joined by "+" in the order of the signal; the class's own for a model of the user's.

    Arguments that are no choice of a model, such as the number of plays, are not in the name.
    """
    if isinstance(model, (Sum, Series)):
        return "+".join(model_name(part) for part in model.parts)
    fitting = [name for name, kind in _kinds().items() if type(model) is kind and MODELS[name].variant(model)]
    return fitting[-1] if fitting else type(model).__name__


@functools.cache
def _kinds() -> dict[str, type[AbstractHysteresis]]:
    return {name: type(entry.make()) for name, entry in MODELS.items()}


def judged() -> dict[str, Needs]:
    """What models need from data, by name."""
    return {
        "duhem": Needs(amplitudes=2, too_few="f and g are seen along one pair of branches, and trade off within it"),
        "bouc-wen": Needs(
            amplitudes=2,
            symmetry="symmetric",
            too_few="the classic parameters (A, beta, gamma, n) are nearly redundant; fix A = 1",
        ),
        "bouc-wen-asymmetric": Needs(
            amplitudes=2, symmetry="asymmetric", too_few="the shape parameters are nearly redundant"
        ),
        "bouc-wen-oscillator": Needs(
            time=True,
            frequencies=2,
            too_few="mass, damping and stiffness trade off; it needs several, or a resonance",
        ),
        "preisach": Needs(
            turning_pairs=(3, 10), too_few="it gives about 2 n numbers for the n (n + 1) / 2 weights of n levels"
        ),
        "prandtl-ishlinskii": Needs(amplitudes=2, symmetry="generalized", direction="counter-clockwise"),
        "creep": Needs(loop=False, time=True, creep=True),
    }
