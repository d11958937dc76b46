"""Fitted materials as `uniaxialMaterial` lines of OpenSees, for Tcl and for openseespy, with standard errors as comments."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from hystfit.errors import ModelError
from hystfit.models.registry import model_name
from hystfit.outcome.table import write_rows
from hystfit.version import __version__

if TYPE_CHECKING:
    from hystfit.results.result import FitResult


def export_opensees(result: FitResult, folder: str | Path, *, name: str = "material", tag: int = 1) -> tuple[Path, ...]:
    """Write a fit as a material of OpenSees: `name`.tcl, `name`.py for openseespy, and `name`_covariance.csv.

    The numbers are in the units of the data, which the comments state, with eight digits. Comments list the standard errors, the error of
    the fit, and what the material lacks: a constant force, a state before the record. A term that changes the loop is never dropped.

    Args:
        result: a fit of `steel-02`, `voce-chaboche`, `bouc-wen-force` or `bouc-wen-baber-noori`.
        folder: made where it does not exist.
        name: of the files, a word.
        tag: of the material, a positive whole number.

    Returns:
        The files.

    Raises:
        ModelError: a model without such a material, one with a term that the material lacks, or a bad name or tag.
    """
    if not re.fullmatch(r"[A-Za-z]\w*", name):
        raise ModelError(f"name must be a word of letters, digits and underscores, got {name!r}")
    if tag < 1:
        raise ModelError(f"the tag of a material is a positive whole number, got {tag}")
    material = result.device.uniaxial_material()
    words = material.words(tag)
    comments = [f"# {line}" for line in _comments(result, (*material.lost, *material.notes))]
    kind, *numbers = words[1:]
    call = f'ops.uniaxialMaterial("{kind}", {", ".join(numbers)})'
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    files = tuple(place / file for file in (f"{name}.tcl", f"{name}.py", f"{name}_covariance.csv"))
    files[0].write_text("\n".join([*comments, " ".join(words), ""]), encoding="utf-8")
    files[1].write_text("\n".join([*comments, "import openseespy.opensees as ops", "", call, ""]), encoding="utf-8")
    rows = ([label, *row] for label, row in zip(result.free_names, result.covariance, strict=True))
    write_rows(files[2], ["", *result.free_names], rows)
    return files


def _comments(result: FitResult, remarks: tuple[str, ...]) -> list[str]:
    """What a reader of the line needs to know."""
    units = result.data.units
    shown = ", ".join(f"{role} in {units[of] or 'unknown units'}" for role, of in (("input", "u"), ("output", "y")))
    lines = [f"hystfit {__version__}, model {model_name(result.model)}: {shown}"]
    lines.append(f"rms error of the fit {result.train.nrmse_percent:.3g} % of the range, status {result.status}")
    lines.append("estimates and standard errors (1 sd), covariance in the CSV file:")
    for row in result.parameters:
        error = "fixed" if row.fixed else "not determined" if row.stderr is None else f"+- {row.stderr:.2g}"
        lines.append(f"  {row.name} = {row.value:.8g} {row.unit}".rstrip() + f", {error}")
    return [*lines, *remarks]
