"""Covariates: constants of a record, such as its temperature, on which parameters of a model may depend."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.params.units import parse_unit

_NUMBER = r"([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)"


def covariate(record: Record, name: str) -> float:
    """Value of a covariate of a record: from its metadata, else from its name or that of its file ("loop_T25", "25degC").

    Columns that are constant are metadata once a file is read. A unit behind the last underscore, as in "T_degC", is recognized in names.
    """
    plain = lambda text: re.sub(r"\W+", "_", text).strip("_").lower()
    stated = [value for key, value in record.metadata.items() if plain(key) == plain(name)]
    texts, patterns = (stated, (_NUMBER,)) if stated else ((record.name, Path(record.source).stem), _patterns(name))
    for text in texts:
        for pattern in patterns:
            values = set(map(float, re.findall(pattern, text, flags=re.IGNORECASE)[: 1 if stated else None]))
            if len(values) > 1:
                raise DataError(f"record {record.name!r}: {text!r} holds several values of {name}: {sorted(values)}")
            if values:
                return values.pop()
    raise DataError(
        f"record {record.name!r} has no value of {name}: give it as a constant column of the file, in its name ({name}=25), or by "
        f"record.replace(metadata={{{name!r}: '25'}})"
    )


def common_covariate(records: Iterable[Record], name: str) -> float:
    """Value of a covariate that all records of a device share."""
    values = {covariate(record, name) for record in records}
    if len(values) > 1:
        raise DataError(f"covariate {name!r} has several values: {sorted(values)}")
    return values.pop()


def _patterns(name: str) -> list[str]:
    """Where a value stands in a name, the most explicit form first; each with one group."""
    symbol, _, unit = name.rpartition("_")
    found = [rf"(?<![A-Za-z]){re.escape(name)}[ =_:]*{_NUMBER}"]
    if symbol and parse_unit(unit) is not None:
        spellings = "|".join(map(re.escape, {unit, unit.removeprefix("deg")}))
        found += [rf"(?<![\d.])(?:(?<=[ _])|(?<![-+])){_NUMBER} ?(?:{spellings})(?![A-Za-z])"]
        found += [rf"(?<![A-Za-z]){re.escape(symbol)}[ =_:]*{_NUMBER}"]
    return found


def covariate_unit(name: str) -> str:
    """Unit of a covariate as printed: what follows the last underscore where that is a unit, else the name."""
    unit = name.rpartition("_")[2]
    return unit if unit != name and parse_unit(unit) is not None else name


def dependences(given: Mapping[str, str | Sequence[str]] | Sequence[str] | str) -> tuple[tuple[str, str], ...]:
    """(covariate, parameter) pairs from {"T_degC": ["kappa_x", "c"]} or from "T_degC:kappa_x,c", one or several."""
    if isinstance(given, Mapping):
        listed = [(name, [one] if isinstance(one, str) else list(one)) for name, one in given.items()]
    else:
        parts = [text.partition(":") for text in ([given] if isinstance(given, str) else given)]
        listed = [(name.strip(), names.split(",")) for name, _, names in parts]
    pairs = [(name, one.strip()) for name, names in listed for one in names]
    for name, one in pairs:
        if not one or not re.fullmatch(r"\w+", name):
            raise ParameterError(
                f"write a dependence as COVARIATE:PARAMETER, such as T_degC:c, got {f'{name}:{one}'!r}; the name of a covariate consists "
                "of letters, digits and underscores"
            )
        if pairs.count((name, one)) > 1:
            raise ParameterError(f"the dependence of {one} on {name} is given twice")
    return tuple(pairs)
