"""The file that keeps a posterior: netCDF with groups posterior and sample_stats, as ArviZ has them, beside result.json and the fit."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.config import require_x64
from hystfit.errors import DataError, MissingExtraError
from hystfit.outcome import Note, Status
from hystfit.results.folders import dump_json, writing
from hystfit.results.saved import load_fit
from hystfit.sampling.base import Evidence
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import SCHEMA, Posterior

_PLAIN = ("sampler", "noise", "priors", "seconds", "seed", "provenance")
_LISTS = ("names", "units")


def variable(name: str) -> str:
    """A parameter's name as a variable of a netCDF file, which takes no slashes (records are called field/7)."""
    return name.replace("/", "|")


def dataset(posterior: Posterior) -> Any:
    """Draws as an xarray Dataset with dimensions chain and draw; all other fields are JSON in an attribute."""
    xarray = _xarray()
    chains, draws, _ = posterior.draws.shape
    place = {"chain": np.arange(chains), "draw": np.arange(draws)}
    variables = {
        variable(name): (("chain", "draw"), posterior.draws[:, :, k]) for k, name in enumerate(posterior.names)
    }
    table = xarray.Dataset(variables, coords=place)
    for name, unit in zip(posterior.names, posterior.units, strict=True):
        table[variable(name)].attrs["units"] = unit
    table.attrs["hystfit"] = json.dumps(_header(posterior))
    return table


def save(posterior: Posterior, folder: str | Path) -> Path:
    """Write posterior.nc, result.json, and the fit in fit/: see `Posterior.save`."""
    xarray = _xarray()
    target = Path(folder)
    stats = {"lp": posterior.log_density, **posterior.stats}
    with writing(target) as scratch:
        dump_json(scratch / "result.json", posterior.to_dict())
        file = scratch / "posterior.nc"
        dataset(posterior).to_netcdf(file, group="posterior", engine="h5netcdf", mode="w")
        columns = {k: (("chain", "draw"), np.asarray(v, float)) for k, v in stats.items()}
        xarray.Dataset(columns).to_netcdf(file, group="sample_stats", engine="h5netcdf", mode="a")
    posterior.result.save(target / "fit")
    return target


def load_posterior(folder: str | Path) -> Posterior:
    """What `Posterior.save` wrote.

    Raises:
        DataError: the folder holds no such file, or one that is damaged.
        MissingExtraError: xarray or h5netcdf is not installed.
    """
    require_x64()
    xarray, place = _xarray(), Path(folder)
    file = place / "posterior.nc"
    try:
        with xarray.open_dataset(file, group="posterior", engine="h5netcdf") as stored:
            header = json.loads(stored.attrs["hystfit"])
            draws = np.stack([stored[variable(name)].values for name in header["names"]], axis=-1)
        with xarray.open_dataset(file, group="sample_stats", engine="h5netcdf") as stored:
            stats = {str(k): stored[k].values for k in stored}
        kept = {k: header[k] for k in _PLAIN} | {k: tuple(header[k]) for k in _LISTS}
        kept["status"] = Status(header["status"])
        kept["notes"] = tuple(Note.of(note) for note in header["notes"])
        kept["convergence"] = Convergence(**{k: np.array(v, float) for k, v in header["convergence"].items()})
        kept["evidence"] = header["evidence"] and Evidence(*header["evidence"])
        kept["log_density"] = stats.pop("lp")
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise DataError(f"{os.fspath(file)!r} is not a posterior that hystfit saved: {error}") from error
    return Posterior(result=load_fit(place / "fit"), draws=draws, stats=stats, **kept)


def _header(posterior: Posterior) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        **{k: getattr(posterior, k) for k in _PLAIN},
        **{k: list(getattr(posterior, k)) for k in _LISTS},
        "status": str(posterior.status),
        "notes": [note.to_dict() for note in posterior.notes],
        "convergence": {k: getattr(posterior.convergence, k).tolist() for k in ("rhat", "bulk", "tail")},
        "evidence": posterior.evidence,
    }


def _xarray() -> Any:
    try:
        import h5netcdf  # noqa: F401
        import xarray
    except ImportError as error:
        raise MissingExtraError("h5netcdf", "bayes", "a posterior file (netCDF)") from error
    return xarray
