"""`hystfit sample`, `hystfit profile`, `hystfit errors`, `hystfit calibrate` and `hystfit design`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from hystfit.cli.interrupts import INTERRUPTED, interrupts_alone
from hystfit.cli.output import progress, refuse_unwritable, show

if TYPE_CHECKING:
    from hystfit.inference.noise import AbstractNoise
    from hystfit.results.result import FitResult

Json = Annotated[bool, Parameter(name="--json")]
Noise = Literal["auto", "iid", "ou", "ar1", "student-t", "discrepancy"]


def sample(
    fitdir: Path,
    /,
    *,
    sampler: Literal["nuts", "emcee", "nested"] = "nuts",
    noise: Noise = "auto",
    prior: list[str] | None = None,
    draws: int | None = None,
    chains: int | None = None,
    warmup: int | None = None,
    target_accept: float | None = None,
    walkers: int | None = None,
    live: int | None = None,
    seed: int = 0,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Draw from the posterior of a saved fit. Exit status 1: the chains have not converged, or the fit is not usable.

    With --out the run is kept while it goes: the same command again goes on after an interrupt or a kill, and
    with more --draws it goes on from where it ended.

    Args:
        fitdir: what `hystfit fit --out` wrote.
        sampler: nuts, emcee for up to ten parameters, or nested for several modes and the evidence.
        noise: noise model; auto decides by the residuals and says why.
        prior: NAME=KIND(A,B), such as tau=log-normal(0.5,0.3), c=normal(0.15,0.01), rho=uniform(0,1); repeatable.
        draws: draws of each chain of nuts (1000) or run of nested (2000), or steps of the ensemble at most (5000).
        chains: of nuts (4); runs of nested (2).
        warmup: steps of nuts that adapt it (300).
        target_accept: acceptance to which nuts tunes its steps (0.65); higher takes smaller ones.
        walkers: of emcee, even (64).
        live: points of nested (400).
        seed: of the draws.
        out: folder for result.json, posterior.nc, the fit and pictures; the running chains are in its folder run.
        json: print result.json alone.
    """
    from hystfit.results.saved import load_fit
    from hystfit.sampling.sample import sample as draw

    result = load_fit(fitdir)
    refuse_unwritable(out)
    asked = {"draws": draws, "chains": chains, "warmup": warmup, "walkers": walkers, "live": live}
    given = {k: v for k, v in (asked | {"target_accept": target_accept}).items() if v is not None}
    run = None if out is None else out / "run"
    priors = _priors(prior or [])
    try:
        with progress("sampling") as say, interrupts_alone():
            found = draw(result, sampler, noise=noise, priors=priors, seed=seed, folder=run, progress=say, **given)
    except KeyboardInterrupt:
        if run is None:
            raise
        print(f"hystfit: interrupted; the same command goes on from {run}", file=sys.stderr)
        return INTERRUPTED
    text = str(found)
    if out is not None:
        with progress("drawing"):
            found.save(out)
            kinds = ("corner", "trace", "rank", "bands")
            _pictures(out, {f"{kind}.png": lambda kind=kind: found.plot(kind) for kind in kinds})
        text += (
            f"\nWritten to {out}: posterior.nc, result.json, corner.png, trace.png, rank.png, bands.png, the fit in fit"
        )
    show(text, found.to_dict(), json)
    return 0 if found.usable else 1


def _priors(given: list[str]) -> dict[str, Any]:
    from hystfit.errors import ParameterError
    from hystfit.inference.priors import parse

    chosen = {}
    for item in given:
        name, mark, words = item.rpartition("=")  # records are called field=3, and parameters offset@field=3
        if not mark:
            raise ParameterError(f"--prior is NAME=KIND(A,B), got {item!r}")
        chosen[name] = parse(words)
    return chosen


def profile(
    fitdir: Path,
    /,
    *,
    parameter: list[str] | None = None,
    noise: Literal["auto", "iid", "ou", "ar1", "discrepancy"] = "auto",
    level: float = 0.95,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Profile the likelihood of a saved fit: limits of each parameter, or on which side it has none (exit status 1).

    Args:
        fitdir: what `hystfit fit --out` wrote.
        parameter: which; all free ones where not given; repeatable.
        noise: how misfit counts; auto as in the fit.
        level: of the limits.
        out: folder for result.json and profiles.png.
        json: print result.json alone.
    """
    from hystfit.results.saved import load_fit
    from hystfit.uncertainty.profiles import profile as follow

    result = load_fit(fitdir)
    refuse_unwritable(out)
    with progress("profiling"):
        found = follow(result, parameter, noise=noise, level=level)
    _write(out, found.to_dict(), {"profiles.png": found.plot})
    show(_told(found, out, "profiles.png"), found.to_dict(), json)
    return 0 if found.usable else 1


def errors(
    fitdir: Path,
    /,
    *,
    block: int | None = None,
    seed: int = 0,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Standard errors of a saved fit by every rule: its own, independent residuals, sandwich, block bootstrap.

    Args:
        fitdir: what `hystfit fit --out` wrote, by least squares.
        block: samples of a lag window or block; one cycle of the input, or five correlation times, where not given.
        seed: of the bootstrap.
        out: folder for result.json and errors.txt.
        json: print result.json alone.
    """
    from hystfit.results.saved import load_fit
    from hystfit.uncertainty.robust_errors import standard_errors

    result = load_fit(fitdir)
    refuse_unwritable(out)
    found = standard_errors(result, block=block, seed=seed)
    _write(out, found.to_dict(), {}, {"errors.txt": f"{found}\n"})
    show(_told(found, out, "errors.txt"), found.to_dict(), json)
    return 0 if result.usable else 1


def calibrate(
    fitdir: Path,
    /,
    *,
    noise: Literal["iid", "ou", "ar1", "student-t", "discrepancy"] = "ou",
    assumed: Literal["iid", "ou", "ar1", "student-t", "discrepancy"] | None = None,
    method: Literal["laplace", "nuts", "emcee"] = "laplace",
    replicates: int = 200,
    spread: float = 0.2,
    seed: int = 0,
    workers: int = 1,
    scheduler: str | None = None,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Calibrate the set-up of a saved fit by simulation: do its error bars hold? Exit status 1: they do not, or too few replicates tell.

    Args:
        fitdir: what `hystfit fit --out` wrote: its model, input and residuals set the scene.
        noise: that simulates the data, as large as the fit's residuals.
        assumed: noise model of the inference; the same where not given.
        method: laplace (least squares), nuts or emcee.
        replicates: simulated data sets.
        spread: relative width of the priors about the fitted values.
        seed: of everything.
        workers: processes on this machine.
        scheduler: address of a Dask scheduler to use instead.
        out: folder for result.json, calibration.png and the chunks from which the same command goes on.
        json: print result.json alone.
    """
    from hystfit.fitting.again import held_and_free
    from hystfit.results.result import provenance
    from hystfit.results.saved import load_fit
    from hystfit.uncertainty.calibration import calibrate as study

    result = load_fit(fitdir)
    refuse_unwritable(out)
    fixed, free = held_and_free(result)
    with progress("calibrating") as say:
        found = study(
            result.model,
            result.data,
            noise=_noise_like(result, noise),
            assumed=assumed,
            method=method,
            replicates=replicates,
            spread=spread,
            fix=fixed,
            free=free,
            seed=seed,
            folder=None if out is None else out / "run",
            workers=workers,
            scheduler=scheduler,
            progress=say,
        )
    origin = {"fit": {"folder": str(fitdir), "status": result.status, "provenance": result.provenance}}
    content = found.to_dict() | origin | {"provenance": provenance(result.data, seed)}
    _write(out, content, {"calibration.png": found.plot})
    show(_told(found, out, "calibration.png"), content, json)
    return 0 if found.status == "ok" else 1


def _noise_like(result: FitResult, name: str) -> AbstractNoise:
    """A noise model as large and slow as the fit's residuals."""
    from hystfit.inference.noise import starting_noise

    rows = [(result.predict(record) - record.y)[record.used] for record in result.data]
    return starting_noise(name, rows, result.correlation_time)


def design(
    fitdir: Path,
    /,
    *,
    low: float | None = None,
    high: float | None = None,
    samples: int = 1000,
    aim: list[str] | None = None,
    method: Literal["families", "gradient"] = "gradient",
    seed: int = 0,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Propose the next excitation: the input within the actuator's limits that shrinks the errors most.

    Exit status 1: the fit saw no loop.

    Args:
        fitdir: what `hystfit fit --out` wrote.
        low: limit of the actuator; the fitted range where not given.
        high: limit of the actuator.
        samples: length of the input, at the fit's sampling interval.
        aim: parameter whose error counts; repeatable; all where not given.
        method: families compares signals, gradient optimizes turning points too.
        seed: of random signals.
        out: folder for result.json and input.csv.
        json: print result.json alone.
    """
    from hystfit.results.saved import load_fit
    from hystfit.uncertainty.input_design import design as propose

    result = load_fit(fitdir)
    refuse_unwritable(out)
    with progress("designing"):
        found = propose(result, low=low, high=high, samples=samples, aim=aim, method=method, seed=seed)
    record = result.data[0]
    own = f"_{record.u_unit}"
    head = record.u_name if not record.u_unit or record.u_name.endswith(own) else record.u_name + own
    step = found.dt
    rows = [head if step is None else f"t_{record.t_unit},{head}"]
    rows += [f"{v:.9g}" if step is None else f"{k * step:.9g},{v:.9g}" for k, v in enumerate(found.best.u)]
    _write(out, found.to_dict(), {}, {"input.csv": "\n".join(rows) + "\n"})
    show(_told(found, out, "input.csv"), found.to_dict(), json)
    return 0 if found.usable else 1


def _told(found: Any, out: Path | None, files: str) -> str:
    return str(found) if out is None else f"{found}\nWritten to {out}: result.json, {files}"


def _write(
    out: Path | None,
    content: dict[str, Any],
    pictures: dict[str, Callable[[], Any]],
    texts: dict[str, str] | None = None,
) -> None:
    if out is None:
        return
    from hystfit.results.saved import dump_json, writing

    with writing(out) as scratch:
        dump_json(scratch / "result.json", content)
        for name, text in (texts or {}).items():
            (scratch / name).write_text(text, encoding="utf-8")
    _pictures(out, pictures)


def _pictures(out: Path, pictures: dict[str, Callable[[], Any]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from hystfit.results.saved import writing

    with writing(out) as scratch:
        for name, make in pictures.items():
            figure = make()
            figure.savefig(scratch / name, dpi=120)
            plt.close(figure)
