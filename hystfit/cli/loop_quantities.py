"""`hystfit quantities`."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystfit.cli.options import DEFAULT_READING, STDOUT, Loop, Output, Reading
from hystfit.cli.records import load
from hystfit.cli.write import finish
from hystfit.outcome import Status

if TYPE_CHECKING:
    from hystfit.results.force_loops import ForceLoops


def quantities(*loops: Loop, reading: Reading = DEFAULT_READING, output: Output = STDOUT) -> int:
    """Read coercivity, remanence, loss, stiffness or (BH)max off measured loops, with standard errors and without a model.

    Of a force and a displacement also energy, stiffness and damping of each cycle, the backbone and the failure. With --out, the folder
    holds result.json and quantities.csv, and of forces cycles.csv, backbone.csv and backbone.png. Exit status 1: no record has a loop or
    a demagnetization curve.
    """
    from hystfit.results.force_loops import force_loops
    from hystfit.results.loop_values import quantities as of_loops
    from hystfit.results.provenance import provenance

    output.check()
    data = load(loops, reading)
    values, forces = of_loops(data), force_loops(data)
    status = Status.OK if any(values.rows.values()) or forces else Status.NO_LOOP
    content = {"schema": "hystfit.quantities/1", "status": str(status), "quantities": values.to_dict()}
    if forces:
        content["force_loops"] = {name: one.to_dict() for name, one in forces.items()}
    content["provenance"] = provenance(data, None)

    def save(folder: Path) -> None:
        with (folder / "quantities.csv").open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(["record", "quantity", "value", "stderr", "unit", "instrument", "read_from"])
            for record, found in values.rows.items():
                rows.writerows([record, q.name, q.value, q.stderr, q.unit, q.stated, q.count] for q in found)
        if forces:
            _save_forces(folder, forces)

    texts = [f"{name}\n{one.text()}" if len(forces) > 1 else one.text() for name, one in forces.items()]
    shown = texts if forces and not any(values.rows.values()) else [repr(values), *texts]
    return finish("\n\n".join(shown), content, output, save, status=status)


def _save_forces(folder: Path, forces: dict[str, ForceLoops]) -> None:
    """Tables of the cycles and of the backbone, and a picture of the backbone."""
    from hystfit.cli.figures import sheet

    for file, parts in (
        ("cycles.csv", [(name, one.cycles) for name, one in forces.items()]),
        ("backbone.csv", [(name, side) for name, one in forces.items() for side in one.backbone.values()]),
    ):
        with (folder / file).open("w", newline="", encoding="utf-8") as target:
            rows = csv.writer(target)
            heads = [field.name for field in dataclasses.fields(next(part[0] for _, part in parts if part))]
            rows.writerow(["record", *heads])
            rows.writerows([name, *(getattr(one, head) for head in heads)] for name, part in parts for one in part)
    figure = sheet(5.6, 4.0 * len(forces))
    for ax, one in zip(np.ravel(figure.subplots(len(forces))), forces.values(), strict=True):
        one.plot(ax)
    figure.savefig(folder / "backbone.png", dpi=150)
