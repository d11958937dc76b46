"""`hystfit models` and `hystfit datasets`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hystfit.cli.options import NO_TABLE, Output, TableOutput
from hystfit.cli.write import finish, record_columns, show, write_csv, write_netcdf
from hystfit.errors import DataError
from hystfit.outcome import Column, Table

PLACES = {
    "core": "Hysteresis",
    "beside": "Added to the output (join by +)",
    "before": "Before the hysteresis (join by +)",
    "after": "After the hysteresis (join by +)",
}
_EXAMPLE = """Example: hystfit fit LOOP --model lag+prandtl-ishlinskii-generalized:plays=8+creep; or my_model.py:MyModel
Settings follow a name (preisach:n=60:reversible=no); hystfit models NAME lists them
prandtl-ishlinskii-search chooses the terms and sizes of that family by cross-validation (fit --model, compare --models)"""


def models(name: str | None = None, /, *, json: bool = False) -> int:
    """List the models, or the parameters of one.

    Args:
        name: a model, or several joined by +, or my_model.py:MyModel.
        json: print JSON.
    """
    from hystfit.models.entries import MODELS

    entry = MODELS.get(name or "")
    if name is None:
        width = max(map(len, MODELS))
        places = {place: [item for item in MODELS.items() if item[1].place == place] for place in PLACES}
        groups = {
            place: Table(["", Column("", left=True)], [[f"{key:<{width}}", item.doc] for key, item in listed])
            for place, listed in places.items()
        }
        blocks = ["\n".join([heading, *groups[place].lines("  ")]) for place, heading in PLACES.items()]
        text = "\n\n".join([*blocks, _EXAMPLE])
        known = MODELS if json else {}  # settings import the models
        about = {k: {"place": one.place, "about": one.doc, "settings": one.settings()} for k, one in known.items()}
        content: dict[str, Any] = {"models": about}
    else:
        from hystfit.models.registry import make_model

        table = _parameters(entry.make() if entry else make_model(name))
        settings = entry.settings() if entry else {}
        count = len(table.rows)
        text = f"{name}: {count} parameter{'s' * (count != 1)}\n{table.text('  ')}"
        if entry and settings:
            text += f"\nsettings and their defaults: {name}:{entry.shown()}"
        content = {"model": name, "parameters": table.to_list(), "settings": settings}
    show(text, {"schema": "hystfit.models/1", **content}, json)
    return 0


def _parameters(model: Any) -> Table:
    """Each field with parameters in one row: name, number of elements, unit, bounds, whether it is held, meaning."""
    from hystfit.params.space import ParameterSpace
    from hystfit.params.units import Scales

    space = ParameterSpace.of(model)
    label = Scales(u_unit="[u]", y_unit="[y]").label
    elements = [(name, info, False) for name, info in zip(space.names, space.infos, strict=True)]
    elements += [(name, info, True) for name, _, info in space.fixed()]
    rows: dict[str, list[Any]] = {}
    for name, info, fixed in elements:
        base = name.partition("[")[0]
        rows.setdefault(base, [base, 0, label(info.unit), *map(float, info.bounds), fixed, info.doc])[1] += 1
    columns = ["name", "count", Column("unit", left=True), "lower", "upper", "fixed", Column("about", left=True)]
    return Table(columns, list(rows.values()))


def datasets(name: str | None = None, /, *, output: TableOutput = NO_TABLE) -> int:
    """List the data sets known by name, describe one, or write one as CSV (downloading it where necessary).

    Args:
        name: a data set.
    """
    from hystfit.reading import datasets as known

    content: dict[str, Any] = {"schema": "hystfit.datasets/1"}
    if name is None:
        if output.out is not None:
            raise DataError("name the data set to write: hystfit datasets NAME --out FILE")
        about = {key: known.describe(key).splitlines()[0].partition(": ")[2] for key in known.names()}
        show(Table(["", Column("", left=True)], [*about.items()]).text(), content | {"datasets": about}, output.json)
        return 0
    text = known.describe(name)
    content |= {"name": name, "about": text}
    if output.out is None:
        return finish(text, content, output)
    from hystfit.data.record import Dataset

    table = record_columns(Dataset.of(known.load(name)))
    return finish_table(text, content, output, name.replace("/", "_"), table)


def finish_table(
    text: str,
    content: dict[str, Any],
    output: Output,
    name: str,
    columns: Mapping[str, Any],
    truth: Mapping[str, Any] | None = None,
) -> int:
    """Write columns as CSV with ten significant digits (or as netCDF), print the text or JSON, and return exit status 0.

    Args:
        text: the result for people.
        content: of result.json, which is written where `out` is a folder.
        output: `out` is the file itself where it ends in a suffix, .nc for netCDF, else a folder.
        name: of the CSV file in a folder, without suffix.
        columns: equally long columns by heading.
        truth: columns of a second CSV file: truth.csv in a folder, NAME.truth.csv beside a file.

    Raises:
        HystfitError: it cannot be written.
    """
    out = output.out
    if out is None or out.is_dir() or not out.suffix:

        def save(folder: Path) -> None:
            write_csv(folder / f"{name}.csv", columns, ".10g")
            if truth is not None:
                write_csv(folder / "truth.csv", truth, ".10g")

        return finish(text, content, output, save)
    from hystfit.results.folders import writing

    if not out.parent.is_dir():
        raise DataError(f"cannot write {str(out)!r}: the folder {str(out.parent)!r} does not exist; make it first")
    with writing(out.parent) as scratch:
        if out.suffix == ".nc":
            write_netcdf(scratch / out.name, columns)
        else:
            write_csv(scratch / out.name, columns, ".10g")
        if truth is not None:
            write_csv(scratch / f"{out.stem}.truth.csv", truth, ".10g")
            text += f"\nTrue parameters in {out.with_suffix('.truth.csv')}"
    return finish(f"{text}\nWritten to {out}", content, Output(json=output.json))
