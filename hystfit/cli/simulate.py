"""`hystfit simulate`: records made by the simulated stage, by a model, or by a fit."""

from __future__ import annotations

import inspect
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from hystfit.cli.listing import write_columns, write_csv
from hystfit.cli.options import held
from hystfit.cli.output import show
from hystfit.errors import DataError, ParameterError

if TYPE_CHECKING:
    import numpy as np

    from hystfit.data.record import Record

_RATE = 100.0  # samples/s of a signal that has no time of its own


def simulate(
    what: str,
    /,
    *,
    signal: str = "sine",
    set: list[str] | None = None,
    noise: float | None = None,
    seed: int = 0,
    axes: int = 1,
    drive: str | None = None,
    out: Path | None = None,
    json: Annotated[bool, Parameter(name="--json")] = False,
    **shape: str,
) -> int:
    """Make a record: the simulated piezo stage, a model, or a fit, driven by a signal.

    Args:
        what: stage, a model's name, or a folder that `hystfit fit --out` wrote.
        signal: sine, triangle, decaying-sine, multisine, amplitude-sweep, staircase, step, forc-protocol, random-reversals or
            chirp. Reversal curves have no time: they are sampled evenly at --rate.
        set: parameter of the model (of every actuator), NAME=VALUE; repeatable.
        noise: standard deviation added to the output; the stage's own sensors where not given, else none.
        seed: of the noise, and of random signals.
        axes: 1 for one actuator of the stage, 3 for all of it: three voltages, strain gauges, and the platform's x, y and theta.
        drive: with --axes 3, the actuators that the signal drives: in-turn (one after another, the default), together, or 1, 2 or 3 alone.
        out: data.csv (any file name), or a folder for data.csv and result.json.
        json: print result.json alone.
        shape: parameter of the signal, such as --frequency 2 --low -20 --high 100 --duration 5 --rate 200.
    """
    if out is None and not json:
        raise DataError("say where to write the record: --out data.csv")
    if noise is not None and not 0 <= noise < math.inf:
        raise ParameterError(f"--noise must be finite and not negative, got {noise}")
    if seed < 0:
        raise ParameterError(f"--seed must not be negative, got {seed}")
    t, u, curve, used = _drive(signal, shape, what, seed)
    content: dict[str, Any] = {
        "schema": "hystfit.simulate/1",
        "model": what,
        "status": "ok",
        "signal": {"name": signal, **used},
    }
    values = held(set or [])
    if axes == 1:
        if drive is not None:
            raise ParameterError(f"--drive {drive} needs --axes 3: with one axis there is one actuator")
        record = _respond(what, t, u, values, noise, seed, signal)
        return _write_record(record, curve, content, seed, out, json)
    if axes != 3 or what != "stage":
        raise ParameterError(f"--axes is 1, or 3 for the stage; got {axes} for {what}")
    return _write_stage(t, u, drive or "in-turn", values, noise, seed, content, out, json)


def _write_record(record: Record, curve: Any, content: dict[str, Any], seed: int, out: Path | None, json: bool) -> int:
    from hystfit.data.record import Dataset
    from hystfit.results.result import provenance

    data = Dataset.of(record)
    content |= {
        "samples": len(record),
        "range": {name: [float(v.min()), float(v.max())] for name, v in (("u", record.u), ("y", record.y))},
        "notes": [note.to_dict() for note in record.notes],
        "provenance": provenance(data, seed),
    }
    reach = lambda values, unit: f"{values.min():.4g} to {values.max():.4g} {unit}".rstrip()
    text = f"{content['model']}, {content['signal']['name']}: {len(record)} samples"
    text += f", input {reach(record.u, record.u_unit)}, output {reach(record.y, record.y_unit)}"
    text += "".join(f"\n  - {note}" for note in record.notes)
    if out is not None:
        extra = {} if curve is None else {"curve": curve}
        text += f"\nWritten to {write_csv(out, data, 'data.csv', content, extra)}"
    show(text, content, json)
    return 0


def _write_stage(
    t: np.ndarray,
    u: np.ndarray,
    drive: str,
    values: dict[str, float | None],
    noise: float | None,
    seed: int,
    content: dict[str, Any],
    out: Path | None,
    json: bool,
) -> int:
    from hystfit.data.record import Dataset
    from hystfit.results.result import provenance
    from hystfit.stage import Sensor, Stage, piezo

    stage = Stage.of(_changed(piezo(), values) if values else None)
    arm = float(stage.kinematics.arm)
    sensors = None
    if noise is not None:  # that of a length; an angle is read by lengths on the arm
        sensors = {
            "x": Sensor(noise),
            "y": Sensor(noise),
            "theta": Sensor(noise / arm, 0.001 / arm),
            "gauge": Sensor(noise),
        }
    t, volts = _voltages(t, u, drive)
    measured = stage.measure(t, volts, seed=seed, sensors=sensors)
    columns = measured.columns()
    content |= {
        "axes": 3,
        "drive": drive,
        "samples": len(t),
        "range": {name: [float(v.min()), float(v.max())] for name, v in columns.items()},
        "notes": [note.to_dict() for note in measured.notes],
        "provenance": provenance(Dataset.of(measured.record(axis, 0) for axis in ("x", "y", "theta")), seed),
    }
    lines = [f"stage, {content['signal']['name']}, actuators {drive}: {len(t)} samples"]
    lines += [f"  {name:<14}{v.min():>10.4g} to {v.max():.4g}" for name, v in columns.items()]
    lines += [f"  - {note}" for note in measured.notes]
    if out is not None:
        lines.append(f"Written to {write_columns(out, columns, 'data.csv', content)}")
    show("\n".join(lines), content, json)
    return 0


def _voltages(t: np.ndarray, u: np.ndarray, drive: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and voltages (T, 3) of the three actuators."""
    import numpy as np

    from hystfit.stage import in_turn

    if drive == "in-turn":
        return in_turn(t, u)
    if drive == "together":
        return t, np.stack([u] * 3, axis=1)
    if drive not in ("1", "2", "3"):
        raise ParameterError(f"--drive must be in-turn, together, 1, 2 or 3, got {drive!r}")
    volts = np.full((t.size, 3), u[0])
    volts[:, int(drive) - 1] = u
    return t, volts


def _drive(name: str, shape: dict[str, str], what: str, seed: int) -> tuple[Any, Any, Any, dict[str, Any]]:
    """Time and input of a signal, its curve numbers (None where it has none), and its parameters as used.

    The stage gets its voltage range where no limits are given.
    """
    import numpy as np

    from hystfit import signals

    entry = signals.signal(name)
    values = {}
    for key, text in shape.items():
        known = entry.parameters.get(name := key.replace("-", "_"))
        values[name] = _value(name, text)
        number = isinstance(known, (int, float)) or (known is None and name in entry.parameters)
        if number and isinstance(values[name], (str, tuple)):
            raise DataError(f"--{key} is one number, got {text!r}")
    if "seed" in entry.parameters:
        values.setdefault("seed", seed)
    if what == "stage" and {"low", "high"} <= set(entry.parameters):
        values = {"low": -20.0, "high": 100.0, **values}
    rate = None if entry.timed else values.pop("rate", _RATE)
    first, second = signals.make(entry.name, **values)
    defaults = {k: v for k, v in entry.parameters.items() if v is not inspect.Parameter.empty}
    used = {k: list(v) if isinstance(v, tuple) else v for k, v in {**defaults, **values}.items()}
    if rate is None:
        return first, second, None, used
    if not (isinstance(rate, float) and 0 < rate < math.inf):
        raise DataError(f"--rate must be a positive number of samples/s, got {rate!r}")
    return np.arange(first.size) / rate, first, second, {**used, "rate": rate}


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
    from hystfit.stage import Actuator, Sensor

    if what == "stage":
        actuator = Actuator() if noise is None else Actuator(sensor=Sensor(noise=noise))
        if values:
            actuator = Actuator(model=_changed(actuator.model, values), sensor=actuator.sensor)
        return actuator.record(t, u, seed=seed, name=f"stage-{signal}")
    return _model_record(what, t, u, values, noise or 0.0, seed, signal)


def _changed(model: Any, values: dict[str, float | None]) -> Any:
    from hystfit.params.space import ParameterSpace

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
    from hystfit.results.saved import load_fit

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
