"""`hystfit invert` and `hystfit export`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystfit.cli.options import (
    DEFAULT_READING,
    STDOUT,
    Covariates,
    FitFolder,
    FitOrDraws,
    Limits,
    Output,
    Reading,
    Trust,
    input_limits,
)
from hystfit.cli.records import fit_folder, load_one_sided, open_fit, open_posterior
from hystfit.cli.write import finish, items, named, progress, prose_width, write_csv, written
from hystfit.errors import DataError
from hystfit.outcome import Code, Status, Table
from hystfit.outcome.note import warn
from hystfit.outcome.wrapping import within

if TYPE_CHECKING:
    from hystfit.control.bands import InverseBands
    from hystfit.control.inverse import Inverse
    from hystfit.data.record import Record
    from hystfit.results.result import FitResult
    from hystfit.results.webpage import Page
    from hystfit.sampling.posterior import Posterior

_ABOUT_READING = (Code.COLUMN_CHOICE, Code.LEFT_OUT, Code.UNITS)  # notes of a reference that are printed


def invert(
    fitdir: FitOrDraws,
    reference: str,
    /,
    *,
    limits: Limits = None,
    rest: float | None = None,
    covariates: Covariates = None,
    trust: Trust = False,
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Compute the input that makes a fitted model follow a reference, with a status for every sample.

    From a folder of `hystfit sample --out`, it also computes 90 % bands over the posterior draws: of the input, and of the
    tracking error of the input computed for the fit. With --out, the folder holds inverse.csv and a page
    (report.html).

    Args:
        reference: file with the desired output (--output names its column) and, where the model needs it, the time.
        rest: input at which the device was in equilibrium before the reference, such as 0. Default: the input at which the model in
            equilibrium gives the first sample.
    """
    from hystfit.control.inverse import invert as solve

    result = open_fit(fitdir, output, trust, covariates=covariates)
    posterior = open_posterior(fitdir, trust, covariates)
    target = result.in_fitted_units(_target(reference, reading, result.data[0]).replace(u_unit=result.data.units["u"]))
    span = input_limits(limits)
    dt = target.dt if target.t is not None else None
    bands = None if posterior is None else _bands(posterior, target.y, dt, span, rest)
    inverse = solve(result, target.y, dt, limits=span, rest=rest) if bands is None else bands.given
    missed = [warn(Code.MISSED, note) for note in inverse.notes()]
    content = _content(fitdir, result, target, inverse, bands, span)
    content |= {"notes": [note.to_dict() for note in missed], "rest": rest}
    title, units = f"{result.name} inverted for {target.name}", content["units"]
    notes = [*missed, *(note for note in target.notes if note.code in _ABOUT_READING)]
    remarks = [_limits_line(result, span)]
    if rest is not None:
        level = f"{rest:g} {units['input'] or ''}".rstrip()
        remarks.append(f"in equilibrium at an input of {level} before the reference begins")
    remarks += map(str, notes)
    remarks += [] if bands is None else [_band_words(content)]
    counts = [[name, count] for name, count in inverse.counts().items() if count or name == "ok"]
    reach = f"{inverse.u.min():.4g} to {inverse.u.max():.4g} {units['input'] or ''}".rstrip()
    lines = [
        f"{title}: input {reach}",
        f"  {remarks[0]}",
        *Table(["", "samples"], counts).lines("  "),
        *items(remarks[1:]),
    ]
    save = lambda folder: _write_inverse(folder / "inverse.csv", target, inverse, bands, units)

    def page(_: Path) -> Page:
        from hystfit.cli.figures import inverse_figure
        from hystfit.cli.pages import invert_page
        from hystfit.results.report.answer import opened

        figure = inverse_figure(target, inverse, bands, units["input"] or "")
        same_limits = f" --limits={limits}" if limits else ""
        following = f"hystfit export {opened(result, shlex.quote(str(fit_folder(fitdir))))} --c code{same_limits}"
        return invert_page(title, content, remarks, figure, following)

    return finish("\n".join(lines), content, output, save, page=page)


def _content(
    fitdir: Path,
    result: FitResult,
    target: Record,
    inverse: Inverse,
    bands: InverseBands | None,
    given: tuple[float, float] | None,
) -> dict[str, Any]:
    from hystfit.data.dataset import Dataset
    from hystfit.results.provenance import provenance

    low, high = given or result.input_range
    return {
        "schema": "hystfit.invert/1",
        "model": result.name,
        "status": str(Status.OK if inverse.ok else Status.MISSED),
        "reading": [note.to_dict() for note in target.notes],
        "counts": inverse.counts(),
        "input": {"lowest": float(inverse.u.min()), "highest": float(inverse.u.max())},
        "limits": {"lowest": low, "highest": high, "given": given is not None},
        "units": {"input": result.data.units["u"] or None, "output": result.data.units["y"] or None},
        "bands": None if bands is None else _summary(bands),
        "fit": {"folder": str(fitdir), "status": result.status, "provenance": result.provenance},
        "provenance": provenance(Dataset.of(target), None),
    }


def _limits_line(result: FitResult, given: tuple[float, float] | None) -> str:
    """Limits of the input, and where they come from."""
    low, high = given or result.input_range
    source = "--limits" if given else "range of the fitted input; --limits sets others"
    return f"input limited to {low:.6g} to {high:.6g} {result.data.units['u']}".rstrip() + f" ({source})"


def _target(path: str, reading: Reading, fitted: Record) -> Record:
    import numpy as np

    data = load_one_sided([path], reading, "input", fitted)
    if len(data) != 1:
        raise DataError(f"{path!r} holds {len(data)} curves: choose one with --only")
    record, missing = data[0], int(np.isnan(data[0].y).sum())
    if not missing:
        return record
    text = f"rows without a value of the reference are left out: {missing} of {len(record)}"
    return record.take(np.isfinite(record.y)).noted(Code.LEFT_OUT, text)


def _bands(
    posterior: Posterior, reference: Any, dt: Any, limits: tuple[float, float] | None, rest: float | None
) -> InverseBands:
    from hystfit.control.bands import inverse_bands

    with progress("inverting by draws"):
        return inverse_bands(posterior, reference, dt, limits=limits, rest=rest)


def _summary(bands: InverseBands) -> dict[str, Any]:
    import numpy as np

    low, _, high = bands.band("u")
    return {
        "draws": len(bands.u),
        "level": 0.9,
        "input_width": float(np.max(high - low)),
        "rms_error": {"median": float(np.median(bands.rms)), "upper": float(np.quantile(bands.rms, 0.95))},
        "draws_that_missed": int(np.count_nonzero(bands.missed)),
    }


def _band_words(content: dict[str, Any]) -> str:
    u_unit, y_unit = (f" {unit}" if unit else "" for unit in content["units"].values())
    bands, error = content["bands"], content["bands"]["rms_error"]
    return (
        f"over {bands['draws']} posterior draws: 90 % band of the input at most {bands['input_width']:.3g}{u_unit} wide; rms tracking "
        f"error {error['median']:.3g}{y_unit} (median), {error['upper']:.3g}{y_unit} (95th percentile)"
    )


def _write_inverse(
    path: Path, target: Record, inverse: Inverse, bands: InverseBands | None, units: dict[str, str | None]
) -> None:
    u, y = (unit or "" for unit in units.values())
    columns: dict[str, Any] = {} if target.t is None else {named("t", target.t_unit): target.t}
    columns |= {named("reference", y): target.y, named("u", u): inverse.u, named("y", y): inverse.y}
    columns["status"] = inverse.status
    if bands is not None:
        for of, unit in (("u", u), ("error", y)):
            lower, _, upper = bands.band(of)
            columns |= {named(f"{of}_lower", unit): lower, named(f"{of}_upper", unit): upper}
    write_csv(path, columns)


def export(
    fitdir: FitFolder,
    /,
    *,
    c: Path | None = None,
    s_function: bool = False,
    mat: Path | None = None,
    opensees: Path | None = None,
    magnetic: Path | None = None,
    tag: int = 1,
    name: str = "hysteresis",
    limits: Limits = None,
    covariates: Covariates = None,
    trust: Trust = False,
) -> int:
    """Write a fitted model and its inverse as C99 code with a test program, or the fit for MATLAB, OpenSees, field or circuit programs.

    Args:
        c: folder for the C files.
        s_function: with --c, also a level-2 C MEX S-function of the model for Simulink.
        mat: .mat file for parameters, errors and predictions.
        opensees: folder for the uniaxialMaterial line (Tcl and openseespy) and the covariance.
        magnetic: folder for files of field and circuit programs (COMSOL, Flux, Ansys, JMAG, ngspice, LTspice, SPICE, Modelica).
        tag: tag of the OpenSees material.
        name: prefix of files and functions.
    """
    from hystfit.control.export import export_c
    from hystfit.control.field_programs import export_field_programs
    from hystfit.control.opensees import export_opensees

    if c is None and ((mat is None and opensees is None and magnetic is None) or s_function):
        other = "" if s_function else ", a MATLAB file: --mat FILE, or a folder for OpenSees: --opensees FOLDER"
        raise DataError(f"name the folder for the C code: --c FOLDER{other}")
    span = input_limits(limits)
    result = open_fit(fitdir, Output(out=c), trust, covariates=covariates)
    if mat is not None:
        print(f"Written to {result.save_mat(mat)}")
    if opensees is not None:
        files = export_opensees(result, opensees, name=name, tag=tag)
        print(written(opensees, [file.name for file in files]).lstrip())
        print(files[0].read_text(encoding="utf-8").splitlines()[-1])
    if magnetic is not None:
        for program, file in export_field_programs(result, magnetic, name=name).items():
            print(f"{program}: {file}" if isinstance(file, Path) else f"{program}: no file; {file}")
    if c is None:
        return 0
    files = export_c(result, c, name=name, limits=span, s_function=s_function)
    print(written(c, [file.name for file in files]).lstrip())
    print(_limits_line(result, span))
    low, high = span or result.input_range
    step = result.data.sampling_interval or 1.0
    values = shlex.join([f"{low:.6g}", *(f"{u:.6g} {step:.6g}" for u in (0.5 * (low + high), high))])
    what = (
        "To try it, give the first input, then an input and a time step in each line; the program prints the outputs."
    )
    if result.obstacle("inverse") is None:
        what += (
            " With i in place of f it reads desired outputs, and prints the input, the output and the status (0: ok)."
        )
    print(within(what, prose_width()))
    print(f"  cc -std=c99 -O2 {shlex.join(map(str, files[1:3]))} -lm -o {name}")
    print(f"  printf '%s\\n' {values} | ./{name} f")
    if s_function:
        print(f"In MATLAB: mex {name}_sfun.c {name}.c")
    return 0
