"""`hystfit models`, `hystfit datasets` and `hystfit completion`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from hystfit.cli.options import NO_TABLE, TableOutput
from hystfit.cli.write import finish, finish_table, record_columns, show
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

    if name is None:
        text = "\n\n".join([*map(_group, PLACES), _EXAMPLE])
        known = MODELS if json else {}  # settings import the models
        about = {k: {"place": one.place, "about": one.doc, "settings": one.settings()} for k, one in known.items()}
        content: dict[str, Any] = {"models": about}
    else:
        from hystfit.models.registry import make_model

        entry = MODELS.get(name)
        table = _parameters(entry.make() if entry else make_model(name))
        settings = entry.settings() if entry else {}
        count = len(table.rows)
        text = f"{name}: {count} parameter{'s' * (count != 1)}\n{table.text('  ')}"
        if entry and settings:
            text += f"\nsettings and their defaults: {name}:{entry.shown()}"
        content = {"model": name, "parameters": table.to_list(), "settings": settings}
    show(text, {"schema": "hystfit.models/1", **content}, json)
    return 0


def _group(place: str) -> str:
    from hystfit.models.entries import MODELS

    width = max(map(len, MODELS))
    rows = [[f"{name:<{width}}", entry.doc] for name, entry in MODELS.items() if entry.place == place]
    return "\n".join([PLACES[place], *Table(["", Column("", left=True)], rows).lines("  ")])


def _parameters(model: Any) -> Table:
    """Each field with parameters in one row: name, number of elements, unit, bounds, whether it is fixed, meaning."""
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
    from hystfit.data.dataset import Dataset

    table = record_columns(Dataset.of(known.load(name)))
    return finish_table(text, content, output, name.replace("/", "_"), table)


def completion(shell: Literal["bash", "zsh", "fish"], /, *, install: bool = False) -> int:
    """Print the script that completes verbs and options in a shell, or install it for this user.

    Args:
        shell: bash, zsh or fish.
        install: write the script where the shell looks for it, and load it at the start of the shell.
    """
    from hystfit.cli import app

    if not install:
        print(app.generate_completion(shell=shell))
        return 0
    place = app.install_completion(shell=shell)
    shown = f"~/{place.relative_to(Path.home())}" if place.is_relative_to(Path.home()) else str(place)
    print(f"Written to {shown}; open a new shell")
    return 0
