"""Signals by name, for the command line."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import Any

from hystfit.errors import DataError
from hystfit.signals.checks import Series
from hystfit.signals.turning_points import amplitude_sweep, forc_protocol, random_reversals, staircase, step
from hystfit.signals.waves import chirp, decaying_sine, multisine, sine, triangle


@dataclasses.dataclass(frozen=True)
class Signal:
    """One excitation.

    Attributes:
        name: on the command line.
        make: the function.
        doc: the first line of its description.
        parameters: default value of every parameter, by name.
        timed: True where it returns (t, u), False where it returns (u, curve).
    """

    name: str
    make: Callable[..., Series]
    doc: str
    parameters: Mapping[str, Any]
    timed: bool = True


def _register(*functions: Callable[..., Series]) -> dict[str, Signal]:
    table = {}
    for function in functions:
        name = function.__name__.replace("_", "-")
        parameters = {key: item.default for key, item in inspect.signature(function).parameters.items()}
        doc = (inspect.getdoc(function) or "").splitlines()[0]
        table[name] = Signal(name, function, doc, parameters, timed=function is not forc_protocol)
    return table


SIGNALS: Mapping[str, Signal] = _register(
    sine, triangle, decaying_sine, multisine, amplitude_sweep, staircase, step, forc_protocol, random_reversals, chirp
)


def signal(name: str) -> Signal:
    """The excitation of this name (dashes and underscores are the same).

    Raises:
        DataError: there is none; the message lists the names.
    """
    entry = SIGNALS.get(name.replace("_", "-"))
    if entry is None:
        raise DataError(f"no signal {name!r}; there are {', '.join(SIGNALS)}")
    return entry


def make(name: str, **parameters: Any) -> Series:
    """An excitation by name, such as `make("sine", frequency=2.0)`.

    Raises:
        DataError: unknown name or parameter (the message lists them), or a value out of range.
    """
    entry = signal(name)
    unknown = sorted(set(parameters) - set(entry.parameters))
    if unknown:
        raise DataError(f"signal {entry.name!r} has no parameter {unknown}; it takes {', '.join(entry.parameters)}")
    return entry.make(**parameters)
