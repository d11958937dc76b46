"""`fit_population`: devices by one model each, then how they scatter."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.batch.fits import Fits
from hystfit.batch.many import fit_many
from hystfit.batch.row import Row
from hystfit.config import require_seed, verb
from hystfit.data.covariates import common_covariate
from hystfit.data.record import Record
from hystfit.errors import DataError, HystfitError, ParameterError
from hystfit.fitting.fit import fit
from hystfit.inference.fittable import check_smooth
from hystfit.models.base import AbstractHysteresis
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import warn
from hystfit.outcome.wrapping import begun, listed
from hystfit.population.devices import Common, Device, effects_of
from hystfit.population.hierarchy import Hierarchy, Pool, draw_hierarchy
from hystfit.population.population_fit import PopulationFit
from hystfit.results.provenance import provenance
from hystfit.results.result import FitResult
from hystfit.sampling.diagnostics import Convergence

Progress = Callable[[str, float], object]
_FIT = (Status.OK, Status.ROUGH)  # statuses of devices that take part
_CURVED = 0.3  # effective fraction of draws below which the likelihood of a device is not normal enough
_THINNED = (1, 4, 8)  # steps for each draw, tried in turn


@verb
def fit_population(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    records: Iterable[str | Path | Record] | str | Path,
    *,
    by: Callable[[str], str] | Mapping[str, str] | None = None,
    covariates: Mapping[str, Mapping[str, float]] | Sequence[str] = (),
    draws: int = 1000,
    chains: int = 4,
    seed: int = 0,
    folder: str | Path | None = None,
    workers: int = 1,
    reading: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> PopulationFit:
    """Fit one model to the loops of many devices, and find how its parameters scatter between them.

    The parameters of a device, in unconstrained coordinates, are normal about the mean device. Each device is fitted, and the errors of
    the fits are taken out of the scatter; they would add to it. Standard deviations have half-t priors, correlations uniform ones
    (Huang and Wand 2013). A device whose likelihood is not normal is sampled.

    Args:
        model: a model, its class or its name.
        records: files, patterns such as "loops/*.csv", and records.
        by: the device of each loop, by the loop's name, where a device has several; by default each loop is a device.
        covariates: numbers on which the mean depends linearly: by covariate and device, or names of properties that files or
            their names state (`hystfit.data.covariates`).
        draws, chains: of the population.
        seed: of the starting points and the draws.
        folder: keeps finished fits, from which the same call resumes.
        workers: processes that fit.
        reading: arguments of `hystfit.read`, for files.
        progress: called with a line of text and the fraction done.
        **options: of `hystfit.fit`: method, fix, free, tie, start, starts, loss, noise.

    Returns:
        Mean device, standard deviations, correlations, better values of each device, and the next device.

    Raises:
        HystfitError: settings that cannot be used, a covariate that a device lacks, fewer devices with usable fits than the parameters
            need.
    """
    require_seed(seed)
    if draws < 100 or chains < 1:
        raise ParameterError(f"draws must be at least 100 and chains at least 1, got {draws} and {chains}")
    report = progress or (lambda text, fraction: None)
    began = time.perf_counter()
    of_fit = {**options, "seed": seed}
    fits = fit_many(model, records, folder=folder, workers=workers, reading=reading, progress=report, **of_fit)
    results, left_out = _fitted(fits, by, report, of_fit)
    for result in results.values():
        check_smooth(result.problem.space, "a population")
    common = _common(results, left_out)
    names = tuple(results)
    design, centers = effects_of(_covariates(covariates, results), names)
    devices = []
    for k, (name, result) in enumerate(results.items()):
        report(f"noise of {name}", k / len(results))
        devices.append(Device.of(name, result, common))
    means, precisions = np.stack([d.mean for d in devices]), np.stack([d.precision for d in devices])
    report("population", 0.0)
    settings = {"chains": chains, "draws": draws, "seed": seed}
    draw = lambda pools: _converged(means, precisions, design, pools, settings)
    drawn = draw({})
    effective = np.array([d.effective(drawn.joined.z[:, k], common) for k, d in enumerate(devices)])
    pools = _pools(devices, np.flatnonzero(effective < _CURVED), drawn, design, common, seed, report)
    if pools:
        drawn = draw(pools)
    notes = _notes(left_out, [devices[k].name for k in pools])
    status, problems = _status(drawn, pools, common, left_out)
    return PopulationFit(
        devices=tuple(devices),
        common=common,
        drawn=drawn,
        design=design,
        covariates=centers,
        effective=effective,
        sampled=tuple(sorted(pools)),
        status=status,
        notes=(*notes, *problems),
        seed=seed,
        seconds=time.perf_counter() - began,
        provenance=provenance(devices[0].result.data, seed),
    )


def _fitted(
    fits: Fits, by: Any, report: Progress, options: dict[str, Any]
) -> tuple[dict[str, FitResult], dict[str, str]]:
    """Fits by device, and the reasons of those without one."""
    groups: dict[str, list[Row]] = {}
    for row in fits.rows:
        groups.setdefault(_device(row.name, by), []).append(row)
    results: dict[str, FitResult] = {}
    left_out: dict[str, str] = {}
    for k, (name, rows) in enumerate(groups.items()):
        report(f"errors of {name}", k / len(groups))
        if bad := [row for row in rows if row.status not in _FIT]:
            left_out[name] = f"{bad[0].status}" + (f" ({begun(bad[0].reason)})" if bad[0].reason else "")
            continue
        try:
            result = _again(fits, rows, options)
        except HystfitError as error:
            left_out[name] = str(error)
            continue
        if result.status in _FIT:
            results[name] = result
        else:
            left_out[name] = str(result.status)
    return results, left_out


def _device(loop: str, by: Any) -> str:
    if by is None:
        return loop
    if isinstance(by, Mapping):
        if loop not in by:
            raise DataError(f"by= names no device for the loop {loop!r}")
        return str(by[loop])
    return str(by(loop))


def _again(fits: Fits, rows: Sequence[Row], options: dict[str, Any]) -> FitResult:
    """The fit of one device in full, from the values of its row, or of all its loops together."""
    if len(rows) == 1 and rows[0].values and options.get("method", "auto") == "auto":
        record = fits.record(rows[0].name)
        return fit(fits.work.model, record, **{**options, "start": dict(rows[0].values), "starts": 1})
    return fit(fits.work.model, [fits.record(row.name) for row in rows], **options)


def _common(results: dict[str, FitResult], left_out: dict[str, str]) -> Common:
    """The parameters that all devices share."""
    without = f"; left out: {_reasons(left_out)}" if left_out else ""
    if len(results) < 2:
        raise DataError(f"a population needs several devices, and {len(results)} has a usable fit{without}")
    first = next(iter(results.values()))
    space = first.problem.space
    several = any(len(result.data) > 1 for result in results.values())
    at = np.flatnonzero(~space.per_record) if several else np.arange(len(space))
    common = Common(space, at)
    for name, result in results.items():
        own = result.problem.space
        shared = [
            own.names[k].partition("@")[0] for k in (np.flatnonzero(~own.per_record) if several else range(len(own)))
        ]
        if tuple(shared) != common.names:
            raise DataError(
                f"the fit of {name} has other parameters ({', '.join(shared)}) than the first ({', '.join(common.names)})"
            )
    if len(results) <= len(common.names):
        raise DataError(
            f"{len(results)} devices do not determine the scatter of {len(common.names)} parameters ({', '.join(common.names)}): measure "
            f"more devices, or hold parameters that hardly differ with fix={without}"
        )
    return common


def _covariates(given: Any, results: dict[str, FitResult]) -> dict[str, dict[str, float]]:
    """Values by covariate and device."""
    if not isinstance(given, Mapping):
        given = {label: {name: _stated(label, name, r) for name, r in results.items()} for label in given}
    table: dict[str, dict[str, float]] = {}
    for label, values in given.items():
        table[label] = {}
        for name in results:
            try:
                table[label][name] = float(values[name])
            except (KeyError, TypeError, ValueError):
                raise DataError(f"covariate {label!r}: device {name!r} has no number ({values.get(name)!r})") from None
        if len(set(table[label].values())) < 2:
            raise DataError(f"covariate {label!r} has the same value for all devices")
    return table


def _stated(label: str, name: str, result: FitResult) -> float:
    """The value of a covariate in the records of a device."""
    try:
        return common_covariate(result.data, label)
    except DataError as error:
        raise DataError(f"device {name!r}: {error}") from error


def _pools(
    devices: list[Device],
    curved: np.ndarray,
    drawn: Hierarchy,
    design: np.ndarray,
    common: Common,
    seed: int,
    report: Progress,
) -> dict[int, Pool]:
    """Draws of their own for the devices whose likelihood is not normal."""
    pools = {}
    sd = np.sqrt(np.median(np.einsum("...ii->...i", drawn.covariance), axis=(0, 1)))
    effects = drawn.effects.mean(axis=(0, 1))
    for number, d in enumerate(curved):
        report(f"sampling {devices[d].name}", number / len(curved))
        pools[int(d)] = devices[d].pool(design[d] @ effects, sd, common, seed)
    return pools


def _notes(left_out: dict[str, str], sampled: list[str]) -> list[Note]:
    notes = []
    if left_out:
        notes.append(warn(Code.LEFT_OUT, f"devices without a usable fit are left out: {_reasons(left_out)}"))
    if sampled:
        notes.append(Note(Code.CHOICE, f"the likelihood is not normal for {listed(sampled)}: sampled"))
    return notes


def _reasons(left_out: dict[str, str]) -> str:
    return listed([f"{name}: {reason}" for name, reason in left_out.items()], "; ")


def _converged(
    means: np.ndarray, precisions: np.ndarray, design: np.ndarray, pools: dict[int, Pool], settings: dict[str, Any]
) -> Hierarchy:
    """Draws of the population, with more steps for each draw until the chains have converged."""
    for thin in _THINNED:
        drawn = draw_hierarchy(means, precisions, design, pools=pools, thin=thin, **settings)
        if convergence_of(drawn).good:
            break
    return drawn


def convergence_of(drawn: Hierarchy) -> Convergence:
    """Of means and standard deviations."""
    sd = np.sqrt(np.einsum("...ii->...i", drawn.covariance))
    return Convergence.of(np.concatenate([drawn.effects[:, :, 0], np.log(sd)], axis=-1))


def _status(
    drawn: Hierarchy, pools: Mapping[int, Pool], common: Common, left_out: dict[str, str]
) -> tuple[Status, list[Note]]:
    """From the convergence of means and standard deviations, and of the draws of single devices."""
    convergence = convergence_of(drawn)
    names = (*(f"mean of {name}" for name in common.names), *(f"sd of {name}" for name in common.names))
    problems = [*convergence.problems(names), *(note for pool in pools.values() for note in pool.problems)]
    if problems:
        return Status.NOT_CONVERGED, problems
    return (Status.PARTIAL if left_out else Status.OK), []
