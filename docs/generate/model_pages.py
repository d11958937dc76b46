"""One page for each registered model, and their index."""

from __future__ import annotations

import functools
import inspect
import shutil
from pathlib import Path

import jax
import numpy as np

from generate.effects import draw_effects, varied
from generate.markdown import docstring, interval, plain, table, write
from generate.model_facts import Facts, facts
from generate.style import SCHEMES, both
from hystfit.cli.catalog import PLACES
from hystfit.models.base import AbstractHysteresis, Use
from hystfit.models.entries import MODELS, Entry
from hystfit.params.param import leaves_of
from hystfit.params.units import Scales

_DIRECTIONS = {
    "any": "either direction",
    "counter-clockwise": "counter-clockwise: the output lags",
    "clockwise": "clockwise: the output leads",
}


def draw_pictures(folder: Path, quick: bool) -> None:
    """Draw what the parameters of every model do.

    Args:
        folder: of the pictures.
        quick: give every model the values to be drawn, and draw only the picture of the first one, which stands for the others.
    """
    folder.mkdir(parents=True)
    drawn: Path | None = None
    for name, known in facts().items():
        if not (models := varied(known)):
            continue
        if quick and drawn is not None:
            for color in SCHEMES:
                shutil.copy2(f"{drawn}.{color}.svg", folder / f"{name}.{color}.svg")
            continue
        drawn = folder / name
        draw_effects(known, models, drawn)


def write_model_pages(folder: Path) -> None:
    """Write the page of every model and the index, beside the pictures."""
    known = facts()
    for name, entry in MODELS.items():
        write(folder / f"{name}.md", model_page(name, entry, known[name]))
    write(folder / "index.md", index_page())


def index_page() -> str:
    """The list of models in the groups of the command line, with what each can do."""
    parts = [
        "# Models",
        'Each name works in `hystfit fit --model NAME` and in `hf.fit("NAME", data)`; join several by `+`, and write settings '
        "after a colon (`preisach:n=60`). [Choosing a model](../guide/choosing.md) helps to decide.",
    ]
    for place, heading in PLACES.items():
        rows = [
            (f"[`{name}`]({name}.md)", plain(entry.doc), _yes(name, "inverse"), _yes(name, "export"))
            for name, entry in MODELS.items()
            if entry.place == place
        ]
        parts += [f"## {heading}", table(["name", "for", "inverse", "C code"], rows)]
    names = "\n".join(MODELS)
    return "\n\n".join([*parts, f"```{{toctree}}\n:hidden:\n:maxdepth: 1\n\n{names}\n```"])


def model_page(name: str, entry: Entry, known: Facts) -> str:
    """The page of a model.

    Args:
        name: of the model.
        entry: in the registry.
        known: its facts.
    """
    model = entry.make()
    parts = [f"# {name}", plain(entry.doc[0].upper() + entry.doc[1:]) + "."]
    if known.equation:
        lines = known.equation.replace(r"\qquad", r"\\[0.5ex]")  # one below the other, for narrow windows
        parts.append(f"$$\n\\begin{{gathered}}\n{lines}\n\\end{{gathered}}\n$$")
    if known.makes:
        parts.append(f"## What it describes\n\n**Suited for:** {known.makes}\n\n**Not suited for:** {known.cannot}")
    parts.append(f"## Parameters\n\n{_parameters(model)}")
    if settings := entry.settings():
        rows = [(f"`{key}`", f"`{value}`") for key, value in settings.items()]
        parts.append(f"### Settings\n\n`{name}:{entry.shown()}`\n\n{table(['setting', 'default'], rows)}")
    if known.vary:
        drawn = f" Drawn with `{known.example}`." if known.example != name else ""
        picture = both(name, f"Effect of the parameters of {name}")
        parts.append(
            f"## What each parameter does\n\nEach plot varies one parameter and keeps the others fixed.{drawn}\n\n{picture}"
        )
    parts.append(f"## Details\n\n{docstring(inspect.getdoc(type(model)) or '')}")
    parts.append(f"## Data and cost\n\n{_needs(name, model)}")
    parts.append(f"## Use\n\n```console\n$ hystfit fit LOOP --model {_expression(name, entry)}\n```")
    if known.source:
        parts.append("## Source\n\n" + "\n".join(f"- {line}" for line in known.source))
    return "\n\n".join(parts)


def _expression(name: str, entry: Entry) -> str:
    """An expression that fits: a filter needs a hysteresis."""
    if entry.place == "core":
        return name
    return f"{name}+bouc-wen" if entry.place == "before" else f"bouc-wen+{name}"


def _parameters(model: AbstractHysteresis) -> str:
    """Name, meaning, unit, default and bounds of every parameter."""
    label = Scales(u_unit="[u]", y_unit="[y]").label
    rows = []
    for leaf in leaves_of(model):
        name = leaf.path[-1]
        count = f" ({leaf.size})" if leaf.shape else ""
        marks = [word for word in ("fixed", "per_record", "linear") if getattr(leaf.info, word)]
        unit = label(leaf.info.unit)
        about = plain(leaf.info.doc) + (f" *({', '.join(marks).replace('_', ' ')})*" if marks else "")
        rows.append((f"`{name}`{count}", about, plain(unit) or "1", _default(model, name), interval(leaf.info.bounds)))
    note = (
        "`[u]` and `[y]` are the units of the data. *Fixed*: the parameter keeps its default value unless `--free` is given. *Per "
        "record*: each record has its own value. *Linear*: the output is linear in it. A fit estimates starting values from the data."
    )
    return f"{table(['name', 'meaning', 'unit', 'default', 'bounds'], rows)}\n\n{note}"


def _default(model: AbstractHysteresis, name: str) -> str:
    """The default value of a parameter; that of the elements of an array where they are few or equal."""
    values = np.unique(np.asarray(getattr(model, name)))
    if values.size == 0:
        return "none"
    return ", ".join(f"{v:.4g}" for v in values) if values.size <= 3 else f"{values[0]:.4g} to {values[-1]:.4g}"


def _needs(name: str, model: AbstractHysteresis) -> str:
    """What the registry declares about data, estimator, inverse and C code."""
    free = sum(leaf.size for leaf in leaves_of(model) if not leaf.info.fixed)
    states = jax.eval_shape(model.init, jax.ShapeDtypeStruct((), float)).size
    estimator = model.estimator or ("convex, for its bounded weights" if _has_weights(model) else "lm")
    rows = [
        ("time", "not needed: rate independent" if model.rate_independent else "needed (a clock, `--rate` or `--dt`)"),
        ("free parameters", str(free)),
        ("states per sample", f"{states}; the cost of a simulation is proportional to samples times states"),
        ("estimator (`--method auto`)", plain(estimator)),
    ]
    needs = model.needs
    if needs is not None:
        some, enough = needs.turning_pairs
        rows += [("different amplitudes", f"at least {needs.amplitudes}")] if needs.amplitudes > 1 else []
        rows += (
            [("pairs of turning points", f"{some} for a major loop, {enough} or more for all weights")]
            if enough
            else []
        )
        rows += (
            [("loops with default bounds", f"{needs.symmetry}; {_DIRECTIONS[needs.direction]}")] if needs.loop else []
        )
        rows += [("with fewer", plain(needs.too_few))] if needs.too_few else []
    uses: dict[Use, str] = {"inverse": "inverse", "export": "C code"}
    for use, label in uses.items():
        obstacle = _obstacle(name, use)
        rows.append((label, "yes" if obstacle is None else f"no: {plain(obstacle)}"))
    return table(["", ""], rows)


def _has_weights(model: AbstractHysteresis) -> bool:
    return any(leaf.shape and leaf.info.linear and leaf.info.bounds[0] == 0 for leaf in leaves_of(model))


def _yes(name: str, use: Use) -> str:
    return "yes" if _obstacle(name, use) is None else "–"


@functools.cache
def _obstacle(name: str, use: Use) -> str | None:
    """Why a model has no inverse, or no C code; its page and the index say so."""
    return MODELS[name].make().obstacle(use)
