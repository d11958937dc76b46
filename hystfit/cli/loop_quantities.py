"""`hystfit quantities`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from cyclopts import Group, Parameter

from hystfit.cli.options import DEFAULT_READING, STDOUT, Loop, Output, Reading
from hystfit.cli.records import load
from hystfit.cli.write import finish, write_rows
from hystfit.outcome import Status

if TYPE_CHECKING:
    from hystfit.results.force_loops import ForceLoops
    from hystfit.results.measured.magnetic_sample import Sample

SAMPLE = Group("Sample and corrections of magnetic loops", sort_key=4)
Property = Annotated[float | None, Parameter(group=SAMPLE)]
Words = Annotated[str | None, Parameter(group=SAMPLE)]


@Parameter(name="*")
@dataclass(frozen=True)
class SampleOptions:
    """What is known of the sample of a magnetic loop, beside the header of its file.

    Args:
        size: three lengths of a prism in mm, such as 1.98,1.99,2.70; the field is along the last.
        size_error: standard error of each length in mm.
        volume: volume in mm3.
        mass: mass in mg.
        density: density in g/cm3.
        demagnetization: demagnetizing factor, 0 in a closed circuit; default: that of the prism.
        image_factor: divisor of the moment that corrects for its images in the poles of the magnet.
        correct: corrections to apply besides volume, image and demagnetization: drift, offset, slope.
    """

    size: Words = None
    size_error: Property = None
    volume: Property = None
    mass: Property = None
    density: Property = None
    demagnetization: Property = None
    image_factor: Property = None
    correct: Words = None

    def sample(self) -> Sample:
        """The sample in SI units."""
        from hystfit.errors import DataError
        from hystfit.results.measured.magnetic_sample import Sample

        scaled = lambda value, factor: None if value is None else factor * value
        try:
            size = None if self.size is None else tuple(1e-3 * float(part) for part in self.size.split(","))
        except ValueError as error:
            raise DataError(f"--size takes three lengths in mm, such as 1.98,1.99,2.70, got {self.size!r}") from error
        return Sample(
            size=size,  # type: ignore[arg-type]
            size_stderr=scaled(self.size_error, 1e-3),
            volume=scaled(self.volume, 1e-9),
            mass=scaled(self.mass, 1e-6),
            density=scaled(self.density, 1e3),
            demagnetization=self.demagnetization,
            image=self.image_factor,
        )

    @property
    def corrections(self) -> tuple[str, ...]:
        """Names of the corrections to apply."""
        return tuple(part.strip() for part in (self.correct or "").split(",") if part.strip())


NO_SAMPLE = SampleOptions()


def quantities(
    *loops: Loop, reading: Reading = DEFAULT_READING, sample: SampleOptions = NO_SAMPLE, output: Output = STDOUT
) -> int:
    """Read coercivity, remanence, loss, stiffness or (BH)max off measured loops, with standard errors and without a model.

    For magnetic loops, also the quantities of data sheets (HcJ, HcB, Br, Js, (BH)max, permeability), after the corrections that are listed.
    If the output is a moment, give the size or volume of the sample, or its mass and density.

    For a force against a displacement, also energy, stiffness and damping of each cycle, the backbone and the failure. With --out, the
    folder holds result.json and quantities.csv, and for forces cycles.csv, backbone.csv and backbone.png. Exit status 1: no record has a
    loop or a demagnetization curve.
    """
    from hystfit.results.force_loops import force_loops
    from hystfit.results.measured.loop_values import quantities as of_loops
    from hystfit.results.provenance import provenance

    output.check()
    data = load(loops, reading)
    values = of_loops(data, sample.sample(), sample.corrections)
    forces = force_loops(data)
    status = Status.OK if any(values.rows.values()) or forces else Status.NO_LOOP
    content = {"schema": "hystfit.quantities/1", "status": str(status), "quantities": values.to_dict()}
    if remarks := values.remarks():
        content["remarks"] = remarks
    if forces:
        content["force_loops"] = {name: one.to_dict() for name, one in forces.items()}
    content["provenance"] = provenance(data, None)

    def save(folder: Path) -> None:
        heads = ("record", "quantity", "value", "stderr", "size_stderr", "spread", "unit", "instrument", "read_from")
        read = [
            (record, q.name, q.value, q.stderr, q.scale, q.spread, q.unit, q.stated, q.count)
            for record, found in values.rows.items()
            for q in found
        ]
        write_rows(folder / "quantities.csv", heads, read)
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
        heads = [field.name for field in dataclasses.fields(next(part[0] for _, part in parts if part))]
        rows = ([name, *(getattr(one, head) for head in heads)] for name, part in parts for one in part)
        write_rows(folder / file, ["record", *heads], rows)
    figure = sheet(5.6, 4.0 * len(forces))
    for ax, one in zip(np.ravel(figure.subplots(len(forces))), forces.values(), strict=True):
        one.plot(ax)
    figure.savefig(folder / "backbone.png", dpi=150)
