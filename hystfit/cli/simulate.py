"""`hystfit simulate`: records of the simulated stage, of a model, or of a fit."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystfit.cli.options import NO_TABLE, TableOutput, Trust, lists, named_values
from hystfit.cli.write import finish_table, items, record_columns
from hystfit.errors import DataError, ParameterError
from hystfit.outcome import Code, Severity, Table
from hystfit.signals.registry import SIGNALS

if TYPE_CHECKING:
    import numpy as np

    from hystfit.data.record import Record
    from hystfit.stage import Population, Stage

_Measured = tuple[list[Any], dict[str, Any]]  # records, and the columns of the file
_RATE = 100.0  # samples/s of a signal that has no time


@lists(signals=SIGNALS)
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
    population: int | None = None,
    spread: list[str] | None = None,
    trust: Trust = False,
    output: TableOutput = NO_TABLE,
    **shape: str,
) -> int:
    """Simulate a record: the piezo stage, a model, or a fit, driven by a signal.

    The file of a population has a column "device" (read
    it with --by device); the true parameters are beside it (truth.csv, or NAME.truth.csv).

    Args:
        what: stage, the name of a model, or a folder written by `hystfit fit --out`.
        signal: {signals}. forc-protocol (reversal curves) has no time: it is sampled evenly at --rate.
        set: parameter of the model (of every actuator) as NAME=VALUE; repeatable.
        noise: standard deviation of the noise added to the output; default: that of the sensors of the stage, 0 for a model.
        seed: random seed of the noise and of random signals.
        axes: 1 for one actuator of the stage, 3 for the whole stage: three voltages, strain gauges, and the platform's x, y and theta.
        drive: with --axes 3, the actuators that the signal drives: in-turn (one after another, the default), together, or 1, 2 or 3 alone.
        population: number of simulated devices of the stage, with scattered parameters, all driven by the signal.
        spread: relative standard deviation of a parameter over the population, as NAME=VALUE; repeatable, or separated by commas.
        shape: parameter of the signal, such as --frequency 2 --low -20 --high 100 --duration 5 --rate 200.
    """
    _check_options(what, axes, drive, population, spread)
    if output.out is None and not output.json:
        raise DataError("name the file for the record: --out data.csv")
    if noise is not None and not 0 <= noise < math.inf:
        raise ParameterError(f"--noise must be finite and not negative, got {noise}")
    if seed < 0:
        raise ParameterError(f"--seed must not be negative, got {seed}")
    import numpy as np

    from hystfit.results.provenance import provenance

    t, u, curve, used = _drive(signal, shape, what, seed)
    values = named_values(set or [], "--set")
    sizes = named_values([part for item in spread or [] for part in item.split(",")], "--spread")
    extra: dict[str, Any] = {} if axes == 1 else {"axes": 3, "drive": drive or "in-turn"}
    extra |= {} if population is None else {"population": population, "spread": sizes}
    name, truth = f"{what}-{signal}", None
    if what != "stage":
        data, columns = _one(_model_record(what, t, u, values, noise, seed, name, trust))
    else:
        device, measured = _stage_device(t, u, values, noise, drive or "in-turn" if axes == 3 else None)
        if population is None:
            data, columns = measured(device, seed, name)
        else:
            devices = device.population(population, spread=sizes, seed=seed)
            (data, columns), truth = _joined(devices, measured, seed), _truth(devices)
    if curve is not None:
        columns["curve"] = np.tile(curve, population or 1)
    notes = list(dict.fromkeys(note for record in data for note in record.notes))
    content = {
        "schema": "hystfit.simulate/1",
        "model": what,
        "status": "ok",
        "signal": {"name": signal, **used},
        **extra,
        "samples": len(data[0]),
        "range": _ranges(data, columns, axes),
        "notes": [note.to_dict() for note in notes],
        "provenance": provenance(data, seed),
    }
    ranges = Table(["", "lowest", "highest"], [[k, *limits] for k, limits in content["range"].items()])  # type: ignore[attr-defined]
    many = "" if population is None else f"{population} devices of "
    text = "\n".join([f"{what}, {signal}: {many}{len(data[0])} samples", *ranges.lines("  "), *items(notes)])
    return finish_table(text, content, output, "data", columns, truth)


def _truth(devices: Population[Any]) -> dict[str, Any]:
    from hystfit.params.units import with_unit

    numbers = {"device": range(1, len(devices) + 1)}
    return numbers | {with_unit(name, devices.units[name]): values for name, values in devices.truth.items()}


def _ranges(data: list[Record], columns: dict[str, Any], axes: int) -> dict[str, list[float]]:
    """Lowest and highest value of input and output, of every channel where there are several."""
    import numpy as np

    values = {k: v for k, v in columns.items() if k != "device"}
    if axes == 1:
        values = {role: np.concatenate([getattr(record, role) for record in data]) for role in ("u", "y")}
    return {k: [float(np.min(v)), float(np.max(v))] for k, v in values.items()}


def _check_options(what: str, axes: int, drive: str | None, population: int | None, spread: list[str] | None) -> None:
    if axes != 1 and (axes != 3 or what != "stage"):
        raise ParameterError(f"--axes is 1, or 3 for the stage; got {axes} for {what}")
    if axes == 1 and drive is not None:
        raise ParameterError(f"--drive {drive} needs --axes 3: with one axis there is one actuator")
    if population is None and spread:
        raise ParameterError("--spread needs --population N: the number of devices whose parameters scatter")
    if population is not None and what != "stage":
        raise ParameterError(f"--population simulates devices of the stage; got {what}")


def _one(record: Record) -> _Measured:
    from hystfit.data.dataset import Dataset

    return [record], record_columns(Dataset.of(record))


def _stage_device(
    t: np.ndarray, u: np.ndarray, values: dict[str, float | None], noise: float | None, drive: str | None
) -> tuple[Any, Callable[[Any, int, str], _Measured]]:
    """One actuator of the stage, or all three with the platform where `drive` is given, and its measurement by seed and name."""
    from hystfit.stage import Actuator, Sensor, Stage, piezo

    if drive is not None:
        voltages = _voltages(t, u, drive)
        return (
            Stage.of(piezo().replace(**values) if values else None),
            lambda stage, seed, _: _channels(stage, *voltages, noise, seed),
        )
    model = piezo().replace(**values)
    actuator = Actuator(model) if noise is None else Actuator(model, sensor=Sensor(noise=noise))
    return actuator, lambda one, seed, name: _one(one.record(t, u, seed=seed, name=name))


def _channels(stage: Stage, t: np.ndarray, volts: np.ndarray, noise: float | None, seed: int) -> _Measured:
    """Poses as records, and all channels as columns, with one noise [um] for all sensors; None for those of the stage."""
    from hystfit.stage import Sensor

    sensors = None
    if noise is not None:
        arm = float(stage.kinematics.arm)
        length, angle = Sensor(noise), Sensor(noise / arm, 0.001 / arm)  # an angle is measured by lengths on the arm
        sensors = {"x": length, "y": length, "theta": angle, "gauge": length}
    measured = stage.measure(t, volts, seed=seed, sensors=sensors)
    # records of their own: an angle has other units than a displacement
    return [measured.record(axis, 0) for axis in ("x", "y", "theta")], measured.columns()


def _joined(devices: Population[Any], measured: Callable[[Any, int, str], _Measured], seed: int) -> _Measured:
    """Records of all devices, and their columns one device after the other."""
    import numpy as np

    from hystfit.stage.population import seeds_of

    each = zip(devices, seeds_of(seed, len(devices)), devices.names, strict=True)
    runs = [measured(device, own_seed, name) for device, own_seed, name in each]
    tables = [table for _, table in runs]
    numbers = np.repeat(np.arange(1.0, len(devices) + 1), [len(table["t_s"]) for table in tables])
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    return [record for records, _ in runs for record in records], {"device": numbers} | columns


def _voltages(t: np.ndarray, u: np.ndarray, drive: str) -> tuple[np.ndarray, np.ndarray]:
    import numpy as np

    from hystfit.stage import drive_in_turn

    if drive == "in-turn":
        return drive_in_turn(t, u)
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
        parameter = key.replace("-", "_")
        values[parameter] = _value(parameter, text)
        default = entry.parameters.get(parameter)
        scalar = isinstance(default, (int, float)) or (default is None and parameter in entry.parameters)
        if scalar and isinstance(values[parameter], (str, tuple)):
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
    """A number, several numbers separated by commas, or a word."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return text
    if len(numbers) > 1:
        return tuple(numbers)
    return int(numbers[0]) if name == "seed" else numbers[0]


def _model_record(
    what: str,
    t: np.ndarray,
    u: np.ndarray,
    values: dict[str, float | None],
    noise: float | None,
    seed: int,
    name: str,
    trust: bool,
) -> Record:
    import numpy as np

    from hystfit.data.record import Record
    from hystfit.models.registry import make_model
    from hystfit.results.saved import load_fit

    units = {}
    if Path(what).is_dir():
        result = load_fit(what, trust=trust)
        model, units = result.model, {f"{k}_unit": v for k, v in result.data.units.items()}
    else:
        model = make_model(what)
    model = model.replace(**values)
    blank = Record(u=u, y=np.zeros_like(u), t=t, name=name, source="simulated", **units)
    y = model.free_run(u, blank.dt)
    if not np.isfinite(y).all():
        raise DataError(f"{what} is not finite on this signal: sample it faster (--rate) or change --set")
    for line in model.advice(u, blank.dt):
        blank = blank.noted(Code.MODEL_ADVICE, line, Severity.WARNING)
    return blank.replace(y=y + (noise or 0.0) * np.random.default_rng(seed).standard_normal(y.size))
