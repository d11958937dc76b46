"""`hystfit sample`, `hystfit profile`, `hystfit errors`, `hystfit calibrate` and `hystfit design`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hystfit.cli.interrupts import resumable
from hystfit.cli.options import STDOUT, FitFolder, Output, Trust, lists
from hystfit.cli.records import chosen_covariates, open_fit
from hystfit.cli.verbs import as_options
from hystfit.cli.write import finish, progress, terminal_width, write_input
from hystfit.errors import DataError, ParameterError, optional
from hystfit.inference.noise.registry import NOISES
from hystfit.sampling.registry import SAMPLERS

if TYPE_CHECKING:
    from hystfit.inference.noise import AbstractNoise
    from hystfit.results.result import FitResult


@lists(samplers=SAMPLERS, noises=NOISES)
def sample(
    fitdir: FitFolder,
    /,
    *,
    sampler: str = "auto",
    noise: str = "auto",
    prior: list[str] | None = None,
    prior_from: Path | None = None,
    covariate: list[str] | None = None,
    draws: int | None = None,
    chains: int | None = None,
    warmup: int | None = None,
    target_accept: float | None = None,
    walkers: int | None = None,
    live: int | None = None,
    seed: int = 0,
    trust: Trust = False,
    output: Output = STDOUT,
) -> int:
    """Sample the posterior of a saved fit.

    Exit status 1: the chains have not converged, the fit is not usable, or the residuals show an error of its model (drift, a misfit
    that recurs every loop). With --out, the folder holds posterior.nc, the fit, a page (report.html), pictures and the running
    chains (run/): the same command resumes after an interruption, and continues a finished run with more --draws.

    Args:
        sampler: auto (weights if most parameters are weights of cells or plays, otherwise independence; nuts if one of its settings is
            given), {samplers}, or my_file.py:MySampler. If independence cannot cover the posterior, nuts takes over; emcee is for up to ten
            parameters; nested is also for several modes.
        noise: auto (chosen from the residuals), {noises}, or my_file.py:MyNoise.
        prior: NAME=KIND(A,B), such as tau=log-normal(0.5,0.3), c=normal(0.15,0.01), rho=uniform(0,1); repeatable.
        prior_from: folder written by `hystfit population --out`: its distribution of a new device is the prior, with correlations (not for
            nested and weights); --prior replaces single ones.
        covariate: of the population behind --prior-from, as NAME=VALUE, by default what the file of the fit states; repeatable.
        draws: draws per chain of independence and nuts (500, up to 16 times as many until the chains have converged) or weights (300, up
            to 8 times); per run of nested (2000); largest number of steps of emcee (5000).
        chains: chains of independence, nuts or weights (4); runs of nested (2).
        warmup: warm-up steps of nuts (300) or weights (50).
        target_accept: target acceptance rate of nuts (0.9); a higher rate takes smaller steps.
        walkers: walkers of emcee, an even number (64).
        live: live points of nested (400).
        seed: random seed.
    """
    from hystfit.cli.pages import sample_page
    from hystfit.sampling.sample import sample as draw

    result = open_fit(fitdir, output, trust, "hystfit.sample")
    if output.out is not None:  # before hours of sampling
        for package in ("h5netcdf", "xarray", "corner", "arviz"):
            optional(package, "bayes", "--out of hystfit sample")
    settings = {"draws": draws, "chains": chains, "warmup": warmup, "walkers": walkers, "live": live}
    settings = {k: v for k, v in {**settings, "target_accept": target_accept}.items() if v is not None}
    priors = _priors_of(prior_from, result, covariate or []) | parse_priors(prior or [])
    with progress("sampling") as update, resumable(output.run):
        posterior = draw(
            result, sampler, noise=noise, priors=priors, seed=seed, folder=output.run, progress=update, **settings
        )

    page = lambda folder: sample_page(posterior, folder)
    return finish(str(posterior), posterior.to_dict(), output, posterior.save, page=page)


def _priors_of(folder: Path | None, result: FitResult, covariates: list[str]) -> Any:
    """Priors of the fit's free parameters from a population, at the covariates that are given or that its records state."""
    if folder is None:
        if covariates:
            raise ParameterError("--covariate is for --prior-from: it is a covariate of that population")
        return {}
    from hystfit.population.population_files import load_next_device

    device, free = load_next_device(folder), {name.partition("@")[0] for name in result.free_names}
    given = chosen_covariates(covariates)
    stated = {name: _stated(result, name) for name in device.means if name not in given}
    priors = device.priors(given | stated).of(free)
    if not priors:
        raise ParameterError(f"the population in {folder} has none of the fit's parameters: {', '.join(sorted(free))}")
    return priors


def _stated(result: FitResult, name: str) -> float:
    """A covariate of the population in the records of a fit."""
    from hystfit.data.covariates import common_covariate

    try:
        return common_covariate(result.data, name)
    except DataError as error:
        raise DataError(f"{error}; the population depends on it: give it by --covariate {name}=VALUE") from error


def parse_priors(options: list[str]) -> dict[str, Any]:
    """Priors by parameter, from NAME=KIND(A,B)."""
    from hystfit.inference.priors import parse

    priors = {}
    for option in options:
        name, mark, description = option.rpartition("=")  # names may hold "=" themselves: offset@field=3
        if not mark:
            raise ParameterError(f"--prior is NAME=KIND(A,B), got {option!r}")
        priors[name] = parse(description)
    return priors


@lists(noises=[name for name in NOISES if name != "student-t"])
def profile(
    fitdir: FitFolder,
    /,
    *,
    parameter: list[str] | None = None,
    noise: str = "auto",
    level: float = 0.95,
    trust: Trust = False,
    output: Output = STDOUT,
) -> int:
    """Confidence limits of the parameters of a saved fit by profile likelihood.

    Exit status 1: a parameter has no limit on at least one side. With --out, the folder holds profiles.png and a page (report.html).

    Args:
        parameter: which parameter, or array of weights such as w; repeatable; default: all free ones but weights.
        noise: auto (as in the fit), or a Gaussian noise model: {noises}, or my_file.py:MyNoise.
        level: confidence level of the limits.
    """
    from hystfit.cli.pages import profile_page
    from hystfit.uncertainty.profiles import profile as follow

    result = open_fit(fitdir, output, trust)
    with progress("profiling"):
        profiles = follow(result, parameter, noise=noise, level=level)
    return finish(str(profiles), profiles.to_dict(), output, page=lambda _: profile_page(profiles, fitdir))


def errors(
    fitdir: FitFolder,
    /,
    *,
    parameter: list[str] | None = None,
    block: int | None = None,
    seed: int = 0,
    trust: Trust = False,
    output: Output = STDOUT,
) -> int:
    """Standard errors of a saved least-squares fit by several methods: its own, i.i.d. residuals, sandwich, block bootstrap.

    If most parameters are weights of cells or plays, also the standard deviations of their posterior, as drawn by `hystfit sample`.

    With --out, the folder holds errors.txt. result.json has every parameter.

    Args:
        parameter: which parameter, or array of weights such as w, to print row by row; repeatable; default: all, and each array of more
            than 12 weights in one row.
        block: samples in a block; default: one cycle of the input, or five correlation times where those are longer.
        seed: random seed of the bootstrap.
    """
    from hystfit.uncertainty.robust_errors import standard_errors

    result = open_fit(fitdir, output, trust)
    with progress("estimating errors") as update:
        found = standard_errors(result, block=block, seed=seed, progress=update)
    text = as_options(found.text(parameter))
    save = lambda folder: (folder / "errors.txt").write_text(f"{text}\n", encoding="utf-8")
    return finish(text, found.to_dict(), output, save)


@lists(noises=NOISES, samplers=[name for name in SAMPLERS if name != "nested"])
def calibrate(
    fitdir: FitFolder,
    /,
    *,
    noise: str = "ou",
    assumed: str | None = None,
    method: str = "laplace",
    replicates: int = 200,
    spread: float = 0.2,
    seed: int = 0,
    workers: int = 1,
    scheduler: str | None = None,
    trust: Trust = False,
    output: Output = STDOUT,
) -> int:
    """Check by simulation whether the error bars of a saved fit are calibrated.

    The model, the input and the residuals of the fit define the simulated data. Exit status 1: the error bars are not calibrated, or
    there are too few replicates. With --out, the folder holds calibration.png, a page (report.html) and the finished replicates (run/),
    from which the same command resumes.

    Args:
        noise: noise model of the simulated data, scaled to the residuals of the fit: {noises}.
        assumed: noise model of the inference; default: that of the simulation.
        method: laplace (least squares), {samplers}.
        replicates: number of simulated data sets.
        spread: relative width of the priors about the fitted values.
        seed: random seed.
        workers: processes on this machine.
        scheduler: address of a Dask scheduler to use instead.
    """
    from hystfit.cli.pages import calibrate_page
    from hystfit.results.provenance import provenance
    from hystfit.uncertainty.calibration import calibrate as study

    result = open_fit(fitdir, output, trust)
    with progress("calibrating") as update, resumable(output.run):
        calibration = study(
            result.model,
            result.data,
            noise=_noise_like(result, noise),
            assumed=assumed,
            method=method,  # type: ignore[arg-type]
            replicates=replicates,
            spread=spread,
            **result.problem.free_and_fixed,  # type: ignore[arg-type]
            seed=seed,
            folder=output.run,
            workers=workers,
            scheduler=scheduler,
            progress=update,
        )
    origin = {"fit": {"folder": str(fitdir), "status": result.status, "provenance": result.provenance}}
    content = calibration.to_dict() | origin | {"provenance": provenance(result.data, seed)}
    return finish(str(calibration), content, output, page=lambda _: calibrate_page(calibration))


def _noise_like(result: FitResult, name: str) -> AbstractNoise:
    """A noise model with the size and correlation time of the residuals of a fit."""
    from hystfit.inference.noise import NOISES, ResidualScales

    residuals = [(result.predict(record) - record.y)[record.used] for record in result.data]
    return NOISES.find(name).start(ResidualScales.of(residuals, result.correlation_time))  # type: ignore[attr-defined]


def design(
    fitdir: FitFolder,
    /,
    *,
    low: float | None = None,
    high: float | None = None,
    samples: int = 1000,
    parameter: list[str] | None = None,
    method: Literal["families", "gradient"] = "gradient",
    seed: int = 0,
    trust: Trust = False,
    output: Output = STDOUT,
) -> int:
    """Propose the next input, within the limits of the actuator, that reduces the standard errors most.

    Exit status 1: the fitted record has no loop. With --out, the folder holds input.csv and a page (report.html).

    Args:
        low: lowest input; default: that of the fit.
        high: highest input; default: that of the fit.
        samples: length of the input, at the sampling interval of the fit.
        parameter: parameter whose error is to be reduced; repeatable; default: all free ones.
        method: families compares families of signals, gradient also optimizes the turning points.
        seed: random seed of the signals.
    """
    from hystfit.cli.pages import design_page
    from hystfit.uncertainty.input_design import design as propose

    result = open_fit(fitdir, output, trust)
    with progress("designing"):
        proposal = propose(result, low=low, high=high, samples=samples, aim=parameter, method=method, seed=seed)
    save = lambda folder: write_input(folder / "input.csv", result.data[0], proposal.best.u, proposal.dt)
    page = lambda folder: design_page(proposal, folder)
    return finish(proposal.text(terminal_width()), proposal.to_dict(), output, save, page=page)
