"""`hystfit quantities`."""

from __future__ import annotations

import csv
from pathlib import Path

from hystfit.cli.options import DEFAULT_READING, STDOUT, Loop, Output, Reading
from hystfit.cli.records import load
from hystfit.cli.write import finish
from hystfit.outcome import Status


def quantities(*loops: Loop, reading: Reading = DEFAULT_READING, output: Output = STDOUT) -> int:
    """Read coercivity, remanence, loss, stiffness or (BH)max off measured loops, with standard errors and without a model.

    With --out, the folder holds result.json and quantities.csv. Exit status 1: no record has a loop or a demagnetization curve.
    """
    from hystfit.results.loop_values import quantities as of_loops
    from hystfit.results.provenance import provenance

    output.check()
    data = load(loops, reading)
    values = of_loops(data)
    status = Status.OK if any(values.rows.values()) else Status.NO_LOOP
    content = {"schema": "hystfit.quantities/1", "status": str(status), "quantities": values.to_dict()}
    content["provenance"] = provenance(data, None)

    def save(folder: Path) -> None:
        with (folder / "quantities.csv").open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(["record", "quantity", "value", "stderr", "unit", "instrument", "read_from"])
            for record, found in values.rows.items():
                rows.writerows([record, q.name, q.value, q.stderr, q.unit, q.stated, q.count] for q in found)

    return finish(repr(values), content, output, save, status=status)
