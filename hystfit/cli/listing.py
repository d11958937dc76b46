"""`hystfit models` and `hystfit datasets`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from hystfit.cli.output import show
from hystfit.errors import DataError

if TYPE_CHECKING:
    import numpy as np

    from hystfit.data.record import Dataset

Json = Annotated[bool, Parameter(name="--json")]


def models(name: str | None = None, /, *, json: Json = False) -> int:
    """List the models, or the parameters of one.

    Args:
        name: a model, or several joined by +, or my_model.py:MyModel.
        json: print as JSON.
    """
    from hystfit.models.registry import MODELS, make_model

    if name is None:
        places = {
            "core": "Hysteresis",
            "beside": "Added to the output (join by +)",
            "before": "Before the hysteresis (join by +)",
            "after": "After it (join by +)",
        }
        lines = []
        for place, heading in places.items():
            lines += (
                [heading] + [f"  {key:<32}{entry.doc}" for key, entry in MODELS.items() if entry.place == place] + [""]
            )
        lines.append(
            "Example: hystfit fit LOOP --model lag+prandtl-ishlinskii-generalized:plays=8+creep; or my_model.py:MyModel\n"
            "Settings follow a name (preisach:n=60:reversible=no); hystfit models NAME lists them"
        )
        listed = {
            key: {"place": entry.place, "about": entry.doc, "settings": entry.settings()}
            for key, entry in MODELS.items()
        }
        show("\n".join(lines), {"schema": "hystfit.models/1", "models": listed}, json)
        return 0
    entry = MODELS.get(name)
    rows = _parameters_of(entry.make() if entry else make_model(name))
    lines = [f"{name}: {len(rows)} parameter{'s' * (len(rows) != 1)}"]
    for row in rows:
        bounds = f"{'-inf' if row['lower'] is None else row['lower']:>6} to {'inf' if row['upper'] is None else row['upper']:<6}"
        lines.append(
            f"  {row['name']:<16}{row['unit']:<12}{bounds:<18}{'held  ' if row['fixed'] else ''}{row['about']}"
        )
    settings = entry.settings() if entry else {}
    if entry and settings:
        lines.append(f"settings (the model is {name}:{entry.shown()} where nothing is said)")
    show(
        "\n".join(lines), {"schema": "hystfit.models/1", "model": name, "parameters": rows, "settings": settings}, json
    )
    return 0


def _parameters_of(model: Any) -> list[dict[str, Any]]:
    """Each field with parameters once: name, unit, bounds, whether it is held, meaning."""
    import math

    from hystfit.params.space import ParameterSpace
    from hystfit.params.units import Scales

    space = ParameterSpace.of(model)
    label = Scales(u_unit="[u]", y_unit="[y]").label
    elements = [(name, info, False) for name, info in zip(space.names, space.infos, strict=True)]
    elements += [(name, info, True) for name, _, info in space.fixed()]
    rows: dict[str, dict[str, Any]] = {}
    for name, info, fixed in elements:
        base = name.partition("[")[0]
        lower, upper = (float(b) if math.isfinite(b) else None for b in info.bounds)
        row = {"name": base, "count": 0, "unit": label(info.unit), "lower": lower, "upper": upper, "fixed": fixed}
        rows.setdefault(base, {**row, "about": info.doc})["count"] += 1
    return list(rows.values())


def datasets(name: str | None = None, /, *, out: Path | None = None, json: Json = False) -> int:
    """List the data sets known by name, describe one, or write one as CSV (downloading it where it must be).

    Args:
        name: a data set.
        out: file (or folder) to write it to.
        json: print as JSON.
    """
    from hystfit.reading import datasets as known

    if name is None:
        if out is not None:
            raise DataError("say which data set to write: hystfit datasets NAME --out FILE")
        about = {key: known.describe(key).splitlines()[0].partition(": ")[2] for key in known.names()}
        width = max(map(len, about)) + 2
        text = "\n".join(f"{key:<{width}}{words}" for key, words in about.items())
        show(text, {"schema": "hystfit.reading.datasets/1", "datasets": about}, json)
        return 0
    text = known.describe(name)
    content: dict[str, Any] = {"schema": "hystfit.reading.datasets/1", "name": name, "about": text}
    if out is not None:
        from hystfit.data.record import Dataset

        data = Dataset.of(known.load(name))
        target = write_csv(out, data, f"{name.replace('/', '_')}.csv", content)
        text += f"\nWritten to {target}: {sum(len(record) for record in data)} rows"
    show(text, content, json)
    return 0


def write_csv(
    out: Path, data: Dataset, name: str, content: dict[str, Any], extra: Mapping[str, np.ndarray] | None = None
) -> Path:
    """Records as one CSV: `out` itself where it ends in a suffix, else a folder, with result.json beside the file.

    `extra` are further columns, of one record.

    Raises:
        HystfitError: it cannot be written.
    """
    several, timed = len(data) > 1, all(record.t is not None for record in data)
    units = data.units
    unit = lambda symbol: f"{symbol}_{units[symbol]}" if units[symbol] else symbol
    head = ["record"] * several + [unit("t")] * timed + [unit("u"), unit("y"), *(extra or {})]
    rows: list[list[Any]] = []
    for record in data:
        columns = [record.t] * timed + [record.u, record.y, *(extra or {}).values()]
        rows += ([record.name] * several + list(row) for row in zip(*columns, strict=True))
    return _write(out, head, rows, name, content)


def write_columns(out: Path, columns: Mapping[str, np.ndarray], name: str, content: dict[str, Any]) -> Path:
    """Columns of one length as a CSV; see `write_csv`."""
    return _write(out, list(columns), zip(*columns.values(), strict=True), name, content)


def _write(out: Path, head: Sequence[str], rows: Iterable[Sequence[Any]], name: str, content: dict[str, Any]) -> Path:
    """A CSV with ten significant digits, missing values empty."""
    import csv
    import math

    from hystfit.results.saved import dump_json, writing

    is_file = bool(out.suffix) and not out.is_dir()
    folder, target = (out.parent, out) if is_file else (out, out / name)
    if is_file and not folder.is_dir():
        raise DataError(f"cannot write {str(out)!r}: the folder {str(folder)!r} does not exist; make it first")
    text = lambda value: value if isinstance(value, str) else "" if math.isnan(value) else f"{value:.10g}"
    with writing(folder) as scratch:
        with (scratch / target.name).open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(head)
            writer.writerows([text(value) for value in row] for row in rows)
        if not is_file:
            dump_json(scratch / "result.json", content)
    return target
