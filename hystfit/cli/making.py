"""`hystfit simulate`: records made by the simulated stage, by a model, or by a fit."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from hystfit.cli.listing import write_csv
from hystfit.cli.options import held
from hystfit.cli.output import show
from hystfit.errors import DataError, ParameterError

if TYPE_CHECKING:
    from hystfit.data.record import Record


def simulate(
    what: str,
    /,
    *,
    signal: str = "sine",
    set: list[str] | None = None,
    noise: float | None = None,
    seed: int = 0,
    out: Path | None = None,
    json: Annotated[bool, Parameter(name="--json")] = False,
    **shape: str,
) -> int:
    """Make a record: the simulated piezo stage, a model, or a fit, driven by a signal.

    Args:
        what: stage, a model's name, or a folder that `hystfit fit --out` wrote.
        signal: sine, triangle, decaying-sine, multisine, amplitude-sweep, staircase, step, random-reversals or chirp.
        set: parameter of the model, NAME=VALUE; repeatable.
        noise: standard deviation added to the output; the stage's own sensor where not given, else none.
        seed: of the noise, and of random signals.
        out: data.csv (any file name), or a folder for data.csv and result.json.
        json: print result.json alone.
        shape: parameter of the signal, such as --frequency 2 --low -20 --high 100 --duration 5 --rate 200.
    """
    from hystfit.data.record import Dataset
    from hystfit.results import provenance

    if out is None and not json:
        raise DataError("say where to write the record: --out data.csv")
    t, u, used = _drive(signal, shape, what, seed)
    record = _respond(what, t, u, held(set or []), noise, seed, signal)
    data = Dataset.of(record)
    content: dict[str, Any] = {
        "schema": "hystfit.simulate/1",
        "model": what,
        "status": "ok",
        "signal": {"name": signal, **used},
        "samples": len(record),
        "range": {
            "u": [float(record.u.min()), float(record.u.max())],
            "y": [float(record.y.min()), float(record.y.max())],
        },
        "notes": list(record.notes),
        "provenance": provenance(data, seed),
    }
    reach = lambda values, unit: f"{values.min():.4g} to {values.max():.4g} {unit}".rstrip()
    text = f"{what}, {signal}: {len(record)} samples, input {reach(record.u, record.u_unit)}"
    text += f", output {reach(record.y, record.y_unit)}"
    if out is not None:
        text += f"\nWritten to {write_csv(out, data, 'data.csv', content)}"
    show(text, content, json)
    return 0


def _drive(name: str, shape: dict[str, str], what: str, seed: int) -> tuple[Any, Any, dict[str, Any]]:
    """Time and input of a signal, and its parameters as used; the stage's voltage range where no limits are given."""
    from hystfit import signals

    entry = signals.signal(name)
    if not entry.timed:
        raise DataError(f"signal {entry.name!r} has no time, so it cannot drive a simulation over time; choose another")
    values = {}
    for key, text in shape.items():
        known = entry.parameters.get(name := key.replace("-", "_"))
        values[name] = _value(name, text)
        if isinstance(known, (int, float)) and isinstance(values[name], (str, tuple)):
            raise DataError(f"--{key} is one number, got {text!r}")
    if "seed" in entry.parameters:
        values.setdefault("seed", seed)
    if what == "stage" and {"low", "high"} <= set(entry.parameters):
        values = {"low": -20.0, "high": 100.0, **values}
    t, u = signals.make(entry.name, **values)
    defaults = {k: v for k, v in entry.parameters.items() if v is not inspect.Parameter.empty}
    return t, u, {k: list(v) if isinstance(v, tuple) else v for k, v in {**defaults, **values}.items()}


def _value(name: str, text: str) -> Any:
    """A number, several numbers with commas between them, or a word."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return text
    if len(numbers) > 1:
        return tuple(numbers)
    return int(numbers[0]) if name == "seed" else numbers[0]


def _respond(
    what: str, t: Any, u: Any, values: dict[str, float | None], noise: float | None, seed: int, signal: str
) -> Record:
    from hystfit.stage.actuator import Actuator, Sensor

    if noise is not None and not noise >= 0:
        raise ParameterError(f"--noise must not be negative, got {noise}")
    if what == "stage":
        actuator = Actuator() if noise is None else Actuator(sensor=Sensor(noise=noise))
        if values:
            actuator = Actuator(model=_changed(actuator.model, values), sensor=actuator.sensor)
        return actuator.record(t, u, seed=seed, name=f"stage-{signal}")
    return _model_record(what, t, u, values, noise or 0.0, seed, signal)


def _changed(model: Any, values: dict[str, float | None]) -> Any:
    from hystfit.params import ParameterSpace

    missing = [name for name, value in values.items() if value is None]
    if missing:
        raise ParameterError(f"--set {missing[0]} needs a value: --set {missing[0]}=1")
    return ParameterSpace.of(model, fix=values).template


def _model_record(
    what: str, t: Any, u: Any, values: dict[str, float | None], noise: float, seed: int, signal: str
) -> Record:
    import numpy as np

    from hystfit.data.record import Record
    from hystfit.models.free_run import free_run
    from hystfit.models.registry import make_model
    from hystfit.saved import load_fit

    units: dict[str, Any] = {}
    if Path(what).is_dir():
        result = load_fit(what)
        model, units = result.model, {f"{k}_unit": v for k, v in result.data.units.items()}
    else:
        model = make_model(what)
    if values:
        model = _changed(model, values)
    blank = Record(u=u, y=np.zeros_like(u), t=t, name=f"{what}-{signal}", source="simulated", **units)
    y = free_run(model, u, blank.dt)
    if not np.isfinite(y).all():
        raise DataError(f"{what} is not finite on this signal: sample it faster (--rate) or change --set")
    return blank.replace(y=y + noise * np.random.default_rng(seed).standard_normal(y.size))
