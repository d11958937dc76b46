"""The sampling interval that the lines above the numbers state, for files without a column of time: "SAMPLE_TIME = 0.0002", "Delta_X"."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence

from hystfit.params.units import conversion, quantity
from hystfit.reading.names.names_with_units import split_unit

_OF_SAMPLES = r"(?:sampl(?:e|es|ing)|scan|acquisition|acq|daq|logging|abtast\w*|mess\w*)"
_RATE = rf"{_OF_SAMPLES}[ _.-]*(?:rate|freq\w*|frequenz)|abtastrate|messrate|abtastfrequenz|fs|采样频率|采样率"
_INTERVAL = (
    rf"{_OF_SAMPLES}[ _.-]*(?:interval|period|increment|step|intervall)|sampl(?:e|ing)[ _.-]*time|time[ _.-]*(?:increment|step|interval)"
    r"|abtastintervall|delta[ _]?[xt]|dt|wf_increment|[tx][ _]?incr?(?:ement)?|horizontal interval|采样间隔|采样周期"
)
_NUMBER = r"[+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?"
_LINE = re.compile(
    rf"\W*(?:(?P<rate>{_RATE})|(?:{_INTERVAL}))\s*(?:[\[(](?P<unit>[^\])]+)[\])]|_(?P<behind>k?hz|[mu]?s|sec))?"
    rf"\"?\s*[:=,;\t ]\s*\"?(?P<numbers>{_NUMBER}(?:[\s,;]+{_NUMBER})*)"
    r"\s*(?P<after>[A-Za-zµμ/]*)\W*",
    re.IGNORECASE,
)
# The step and the rate of a potential: "Sample Interval (V) = 0.001", "Scan Rate (V/s) = 0.05".
_SWEEP = re.compile(
    rf"(?P<key>sample interval|scan rate)\s*\((?P<unit>m?V)(?:/s)?\)\s*[=:]\s*(?P<number>{_NUMBER})", re.IGNORECASE
)
_HERTZ = re.compile(r"([km]?)(?:hz|sa?/s|samples/s|1/s|sps|)", re.IGNORECASE)
# Names of a sampling time [s] in control, where it is shorter than this; beside a sample, Ts is its temperature.
_SAMPLING_TIME, _LONGEST_SAMPLING = ("Ts", "T_s"), 1.0
_AGREE = 0.01  # part of an interval within which a clock has it: its stamps are rounded


def stated_interval(above: Sequence[str]) -> float | None:
    """The time between two rows [s]; None where the lines above the numbers state none, or several."""
    found = {interval for line in above if len(line) < 200 and (interval := _interval(line)) is not None}
    for names, values in itertools.pairwise(line.split(",") for line in above[-2:]):
        below = (value for name, value in zip(names, values, strict=False) if name.strip().lower() == "increment")
        found |= {float(value) for value in below if re.fullmatch(_NUMBER, value.strip())}
    return found.pop() if len(found) == 1 else _of_sweep(above) if not found else None


def _of_sweep(above: Sequence[str]) -> float | None:
    """The time between two rows of a sweep of voltage [s], by its step and its rate; None where the header states none."""
    found: dict[str, float] = {}
    for match in filter(None, (_SWEEP.fullmatch(line.strip()) for line in above if len(line) < 200)):
        found[match["key"].lower()] = float(match["number"]) * (conversion(match["unit"], "V") or 1.0)
    step, rate = found.get("sample interval"), found.get("scan rate")
    return step / rate if step and rate else None


def interval_of(settings: Mapping[str, object]) -> float | None:
    """The same from scalars beside arrays, by their names: {"Ts": 0.001}, {"sampling_rate_Hz": 1000}."""
    named = ((*split_unit(re.split(r"[./]", name)[-1]), value) for name, value in settings.items())
    lines = (
        f"{'dt' if name in _SAMPLING_TIME and value < _LONGEST_SAMPLING else name}{unit and f' [{unit}]'}: {value}"
        for name, unit, value in named
        if isinstance(value, int | float)
    )
    return stated_interval([*lines])


def _interval(line: str) -> float | None:
    """The interval in one line [s]; None for other lines, and where its numbers differ."""
    line = line.strip()
    if title := re.split(r"[;,\t]", line)[0]:  # which may stand before the number of every channel
        line = title + " ".join(line.split(title)[1:])
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    pieces = (piece.split(",") for piece in re.split(r"[\s;]+", match["numbers"]))
    # Equal numbers between commas are those of several channels; another comma is a decimal mark
    parts = {",".join(piece if len({*piece}) > 1 else piece[:1]) for piece in pieces}
    values = {float(part.replace(",", ".")) if re.fullmatch(_NUMBER, part) else math.nan for part in parts}
    unit = (match["unit"] or match["behind"] or match["after"] or "").strip()
    if len(values) != 1 or not (value := values.pop()) > 0:
        return None
    if match["rate"]:
        hertz = _HERTZ.fullmatch(unit)
        return hertz and 1.0 / (value * {"": 1.0, "k": 1e3, "m": 1e6}[hertz[1].lower()])
    if unit and quantity(unit) != "time":  # "Sample Interval (V) = 0.001": a step of a sweep
        return None
    factor = conversion(unit, "s") if unit else 1.0
    return None if factor is None else factor * value


def unit_of_interval(step: float | None, interval: float | None) -> str:
    """The unit in which the steps of a clock are the interval that the header states [s]; "" for none."""
    if step is None or interval is None:
        return ""
    factors = {unit: conversion(unit, "s") or 1.0 for unit in ("s", "ms", "us", "min", "h")}
    return next((unit for unit, factor in factors.items() if abs(factor * step - interval) < _AGREE * interval), "")
