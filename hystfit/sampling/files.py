"""The file that keeps a posterior: netCDF with groups posterior and sample_stats, as ArviZ has them, beside result.json and the fit."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.config import verb
from hystfit.errors import DataError, HystfitError, optional
from hystfit.inference.noise.registry import NOISES
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import warn
from hystfit.params.space import ParameterSpace
from hystfit.results.result import FitResult
from hystfit.results.saved import check_target, load_fit, refuse_other_schema, write_fit
from hystfit.results.saving.folders import dump_json, writing
from hystfit.results.saving.manifest import MANIFEST, read_files, seal
from hystfit.results.saving.stored_values import Stored, parse
from hystfit.results.saving.user_code import allow, checksums, noise_file
from hystfit.sampling.base import Evidence
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import SCHEMA, Posterior

_PLAIN = ("sampler", "noise", "priors", "prior_quartiles", "seconds", "seed", "provenance")
_LISTS = ("names", "units")
_ENTRY = re.compile(r"([^@]+)\[([^\]]+)\](@.*)?", re.DOTALL)  # w[3], w[0,1]@record
_SLACK = 10_000_000  # bytes of data beyond the size of the file, for what netCDF fills in
_FILES = ("result.json", "posterior.nc", f"fit/{MANIFEST}")


@dataclasses.dataclass(frozen=True)
class Variable:
    """A variable of a netCDF file: a parameter, or the entries of an array of parameters, as ArviZ has them."""

    columns: list[int]  # of the draws
    entries: list[str]  # indices of an array, such as "3" and "0,1"; empty for a parameter that is no array

    @property
    def at(self) -> int | list[int]:
        """The index of the columns."""
        return self.columns if self.entries else self.columns[0]


def variables(names: Sequence[str]) -> dict[str, Variable]:
    """Variables by name for names of parameters; a netCDF name has no slashes (records are called field/7)."""
    found: dict[str, Variable] = {}
    for column, name in enumerate(names):
        entry = _ENTRY.fullmatch(name)
        whole = name if entry is None else entry[1] + (entry[3] or "")
        one = found.setdefault(whole.replace("/", "|"), Variable([], []))
        one.columns.append(column)
        if entry is not None:
            one.entries.append(entry[2])
    return found


def dimensions(posterior: Posterior) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Dimensions beside chain and draw by variable, and their coordinates, as ArviZ takes them."""
    arrays = {name: one.entries for name, one in variables(posterior.names).items() if one.entries}
    return {name: [f"{name}_entry"] for name in arrays}, {f"{name}_entry": entries for name, entries in arrays.items()}


def dataset(posterior: Posterior) -> Any:
    """Draws as an xarray Dataset with dimensions chain and draw; all other fields are JSON in an attribute."""
    xarray = _xarray()
    chains, draws, _ = posterior.draws.shape
    dims, coords = dimensions(posterior)
    table = xarray.Dataset(coords={"chain": np.arange(chains), "draw": np.arange(draws), **coords})
    for name, one in variables(posterior.names).items():
        unit = {"units": posterior.units[one.columns[0]]}
        table[name] = (("chain", "draw", *dims.get(name, ())), posterior.draws[:, :, one.at], unit)
    table.attrs["hystfit"] = json.dumps(_header(posterior))
    return table


def save(posterior: Posterior, folder: str | Path) -> Path:
    """Write posterior.nc, result.json, and the fit in fit/: see `Posterior.save`."""
    xarray = _xarray()
    target = Path(folder)
    check_target(target, SCHEMA.partition("/")[0])
    stats = {"lp": posterior.log_density, **posterior.stats}
    with writing(target) as scratch:
        dump_json(scratch / "result.json", posterior.to_dict())
        file = scratch / "posterior.nc"
        try:
            dataset(posterior).to_netcdf(file, group="posterior", engine="h5netcdf", mode="w")
            columns = {k: (("chain", "draw"), np.asarray(v, float)) for k, v in stats.items()}
            xarray.Dataset(columns).to_netcdf(file, group="sample_stats", engine="h5netcdf", mode="a")
        except RuntimeError as error:  # HDF5 where the disk is full
            raise HystfitError(f"cannot write {str(target / 'posterior.nc')!r}: {error}") from error
        (scratch / "fit").mkdir()
        write_fit(posterior.result, scratch / "fit")
        seal(scratch, _FILES)
    return target


@verb
def load_posterior(folder: str | Path, *, trust: bool = False) -> Posterior:
    """What `Posterior.save` wrote.

    Args:
        folder: of the posterior.
        trust: as in `hystfit.load_fit`.

    Raises:
        DataError: the folder holds no posterior, one of another schema, or one that is incomplete, edited or damaged.
        ModelError: a model file that would have to be run without `trust`.
        MissingExtraError: xarray or h5netcdf is not installed.
    """
    _xarray()
    folder = Path(folder)
    refuse_other_schema(folder, SCHEMA, "no posterior as hystfit sample --out writes it", "sample again")
    files = read_files(folder, _FILES, allow_edits=trust)
    place, content = str(folder / "posterior.nc"), files.contents["posterior.nc"]
    _refuse_outside(content, place)
    try:
        groups = [_group(content, name) for name in ("posterior", "sample_stats")]
    except Exception as error:  # h5py meets a damaged file with errors of many kinds
        raise DataError(f"{place} is damaged ({error}): restore it, or sample again") from error
    (values, attributes), (stats, _) = groups
    header = parse(str(attributes.get("hystfit", "")), f"{place}: header", finite=False)
    if (schema := header.get("schema", str)) != SCHEMA:
        raise DataError(f"{place}: schema {schema!r}, expected {SCHEMA!r}")
    result = load_fit(folder / "fit", trust=trust)
    noise, code = header.get("noise", str), header.part("code")
    named = {file} if (file := noise_file(noise)) else set()
    notes = allow(named, {name: code.get(name, str | None) for name in code.content}, trust)[1]
    notes += [warn(Code.CHANGED_FILES, f"{name} was edited after hystfit saved it") for name in files.edited]
    try:
        return _posterior(header, values, stats, result, notes)
    except (KeyError, ValueError, TypeError, IndexError, OverflowError) as error:
        if isinstance(error, HystfitError):
            raise
        raise DataError(f"{place} is damaged ({error}): restore it, or sample again") from error


def _refuse_outside(content: bytes, place: str) -> None:
    """Refuse an HDF5 file whose data lie outside it (links, external storage, virtual data sets), or that declares more than it holds."""
    import h5py

    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            size = _checked(file, place)
    except DataError:
        raise
    except (OSError, KeyError, ValueError, RuntimeError, TypeError, RecursionError) as error:
        raise DataError(f"{place} is damaged ({error}): restore it, or remove it and sample again") from error
    if size > len(content) + _SLACK:
        raise DataError(
            f"{place} declares {size} bytes of data, and the file has {len(content)}: restore it, or remove it and sample again"
        )


def _checked(group: Any, place: str) -> int:
    """Bytes of the data sets of a group and the groups within it, none of which was read."""
    import h5py

    size = 0
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise DataError(f"{place}: {name!r} is a link to another place, which hystfit does not follow")
        item = group[name]
        if isinstance(item, h5py.Group):
            if item == group.file["/"]:
                raise DataError(f"{place}: {name!r} is a group within itself")
            size += _checked(item, place)
        elif isinstance(item, h5py.Dataset):
            if item.external or item.is_virtual:
                raise DataError(f"{place}: {name!r} has its data in other files, which hystfit does not read")
            size += item.nbytes
    return size


def _group(content: bytes, name: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Data sets and attributes of a group, read by h5py alone, which follows nothing that `_refuse_outside` has not seen."""
    import h5py

    with h5py.File(io.BytesIO(content), "r") as file:
        group: Any = file[name]
        values = {str(k): np.asarray(v[()]) for k, v in group.items() if isinstance(v, h5py.Dataset)}
        return values, dict(group.attrs)


def _posterior(
    header: Stored, values: dict[str, np.ndarray], stats: dict[str, np.ndarray], result: FitResult, notes: list[Note]
) -> Posterior:
    """Draws with all that the header states, each of its type and shape."""
    names, units = header.texts("names"), header.texts("units")
    fitted = len(result.free_names)
    if len(set(names)) != len(names) or names[:fitted] != result.free_names or len(units) != len(names):
        raise ValueError("the parameters are not those of the fit beside it")
    draws = _draws(values, names)
    lists = header.part("convergence")
    convergence = Convergence(**{k: np.array(lists.listed(k), float) for k in ("rhat", "bulk", "tail")})
    if any(getattr(convergence, k).shape != (len(names),) for k in ("rhat", "bulk", "tail")):
        raise ValueError("the convergence is not that of its parameters")
    stats = {name: column for name, column in stats.items() if name not in ("chain", "draw")}
    if any(column.shape != draws.shape[:2] or column.dtype.kind != "f" for column in stats.values()):
        raise ValueError("the statistics are not those of its draws")
    noise = header.get("noise", str)
    if noise not in NOISES and noise_file(noise) is None:
        raise ValueError(f"no noise model {noise!r}")
    space = ParameterSpace.of(NOISES.make(noise))
    if names[fitted:] != space.names:
        raise ValueError(f"the noise model {noise} has the parameters {', '.join(space.names)}")
    evidence = header.content["evidence"]
    if evidence is not None:
        evidence = Evidence(*(Stored({"evidence": v}, header.place).get("evidence", float) for v in evidence))
    provenance = header.part("provenance").content
    return Posterior(
        result=result,
        sampler=header.get("sampler", str),
        noise=noise,
        names=names,
        units=units,
        draws=draws,
        log_density=stats.pop("lp"),
        stats=stats,
        convergence=convergence,
        status=header.member("status", Status),
        notes=(*header.notes("notes"), *notes),
        priors=header.mapping("priors", str),
        seconds=header.get("seconds", float),
        seed=header.get("seed", int),
        provenance=provenance,
        evidence=evidence,
        prior_quartiles=_pairs(header.part("prior_quartiles")),
    )


def _draws(values: dict[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    """Draws in the order of the names, shape (chains, draws, d)."""
    found = variables(names)
    first = values[next(iter(found))]
    draws = np.empty((*first.shape[:2], len(names)))
    for name, one in found.items():
        part = values[name]
        if part.dtype.kind != "f" or part.shape != draws[:, :, one.at].shape or part.size == 0:
            raise ValueError(f"draws of {name} of shape {part.shape} and type {part.dtype}")
        draws[:, :, one.at] = part
    return draws


def _pairs(stored: Stored) -> dict[str, list[float]]:
    pairs = {name: stored.listed(name) for name in stored.content}
    if any(len(pair) != 2 for pair in pairs.values()):
        raise ValueError("quartiles are two numbers")
    return {name: [float(value) for value in pair] for name, pair in pairs.items()}


def _header(posterior: Posterior) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        **{k: getattr(posterior, k) for k in _PLAIN},
        **{k: list(getattr(posterior, k)) for k in _LISTS},
        "status": str(posterior.status),
        "notes": [note.to_dict() for note in posterior.notes],
        "convergence": {k: getattr(posterior.convergence, k).tolist() for k in ("rhat", "bulk", "tail")},
        "evidence": posterior.evidence,
        "code": checksums((), posterior.noise),
    }


def _xarray() -> Any:
    optional("h5netcdf", "bayes", "a posterior file (netCDF)")
    return optional("xarray", "bayes", "a posterior file (netCDF)")
