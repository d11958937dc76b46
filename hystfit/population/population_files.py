"""The folder of a population: result.json and devices.csv, and the priors that it has for the next device."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hystfit.config import verb
from hystfit.errors import DataError, ParameterError
from hystfit.inference import priors as known_priors
from hystfit.inference.correlated_priors import CorrelatedPriors
from hystfit.inference.priors import AbstractPrior
from hystfit.outcome.table import write_rows
from hystfit.population.next_device import NextDevice
from hystfit.population.population_fit import SCHEMA, PopulationFit
from hystfit.results.saved import check_target, refuse_other_schema
from hystfit.results.saving.folders import dump_json, writing
from hystfit.results.saving.stored_values import parse


def save(population: PopulationFit, folder: str | Path) -> Path:
    """Write result.json and devices.csv: see `PopulationFit.save`."""
    target = Path(folder)
    check_target(target, SCHEMA.partition("/")[0])
    with writing(target) as scratch:
        dump_json(scratch / "result.json", population.to_dict())
        write_devices(population, scratch / "devices.csv")
    return target


def write_devices(population: PopulationFit, file: Path) -> None:
    """One row per device: fitted and better values."""
    rows = population.device_rows()
    write_rows(file, rows[0], (row.values() for row in rows))


@verb
def load_next_device(folder: str | Path) -> NextDevice:
    """`PopulationFit.next_device` from a folder that `hystfit population` or `PopulationFit.save` wrote."""
    folder = Path(folder)
    refuse_other_schema(folder, SCHEMA, "no population as hystfit population --out writes it", "fit it again")
    place = str(folder / "result.json")
    stored = parse((folder / "result.json").read_text(encoding="utf-8"), place).part("next_device")
    array = lambda key: np.array(stored.listed(key), dtype=float)
    found: dict[str, AbstractPrior] = {}
    try:
        for name, part in stored.part("priors").parts():
            kind, *values = part.listed("prior")
            found[name] = getattr(known_priors, kind)(*values)
        means, count = stored.mapping("covariates", float), len(found)
        return NextDevice(
            CorrelatedPriors(found, array("correlation")),
            means,
            array("effects").reshape(len(means), count),
            array("covariance").reshape(1 + len(means), count, 1 + len(means), count),
        )
    except (AttributeError, ParameterError, TypeError, ValueError) as error:
        raise DataError(f"{place} is damaged ({error}): restore it, or fit the population again") from error
