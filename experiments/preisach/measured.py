"""Measured records: every fourth reversal curve fitted and the others predicted; minor loops of a piezo stack predicted from major ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from common import Results, times

import hystfit as hf
from hystfit.models.preisach import forc_diagram
from hystfit.models.preisach.forc_diagram import ForcDiagram

CLOSE = 0.5  # s after which the piezo, at rest at 0 V before, follows the input


@dataclasses.dataclass(frozen=True)
class Measured:
    """Data of the figure of measured records.

    Attributes:
        curves, predicted: held-out reversal curves and their predicted outputs.
        fit: of the other curves.
        diagram: FORC diagram of all curves.
        loops: the piezo's record of minor loops.
        runs: its outputs as predicted by each model.
    """

    curves: list[hf.Record]
    predicted: list[np.ndarray]
    fit: hf.FitResult
    diagram: ForcDiagram
    loops: hf.Record
    runs: dict[str, np.ndarray]


def measured(results: Results) -> Measured | None:
    """Reversal curves and minor loops; None where a data set is not found."""
    loaded = results.load("measured", "mag_forc_pyforc/FeCo", "piezo_dbo/model", "piezo_dbo/test")
    if loaded is None:
        return None
    curves, model, test = loaded
    wires = [_counting(record) for record in curves]
    held, predicted, fit = reversal_curves(results, wires)
    runs = minor_loops(results, model, test)
    return Measured(held, predicted, fit, forc_diagram(wires), test, runs)


def _counting(record: hf.Record) -> hf.Record:
    return record.replace(u=record.u[record.used], y=record.y[record.used], weight=record.weight[record.used])


def reversal_curves(results: Results, wires: list[hf.Record]) -> tuple[list[hf.Record], list[np.ndarray], hf.FitResult]:
    """Every fourth of 152 reversal curves fitted, the others predicted, in percent of the range of all."""
    train, held = wires[::4], [r for k, r in enumerate(wires) if k % 4]
    span = float(np.ptp(np.concatenate([r.y for r in wires])))

    def judge(name: str, predict: Callable[[hf.Record], np.ndarray]) -> list[np.ndarray]:
        found = [predict(r) for r in held]
        error = np.concatenate([y - r.y for y, r in zip(found, held, strict=True)])
        results.add(f"measured reversal curves: {name}, RMS %", 100 * float(np.sqrt(np.mean(error**2))) / span)
        results.add(f"measured reversal curves: {name}, max %", 100 * float(np.abs(error).max()) / span)
        return found

    fit = hf.fit("preisach-forc:n=60", train)
    predicted = judge("cells, weights >= 0", fit.predict)
    judge("cells, signed weights", hf.fit("preisach-forc-signed:n=60", train).predict)
    relays = "preisach-forc:n=60:elements=relays"
    judge("relays, thresholds from the data", hf.fit(relays, train).predict)
    other = hf.fit(relays, [r for k, r in enumerate(wires) if k % 4 == 2])
    rest = [r for k, r in enumerate(wires) if k % 4 != 2]
    error = np.concatenate([other.predict(r) - r.y for r in rest])
    percent = 100 * float(np.sqrt(np.mean(error**2))) / span
    results.add("measured reversal curves: the same on curves 3, 7, ... fitted, RMS %", percent)
    # Each curve returns to saturation, so that all of them are one record, with one constant.
    u, y = (np.concatenate([getattr(r, name) for r in train]) for name in ("u", "y"))
    coarse = hf.fit(hf.Preisach.of(50, elements="relays", spacing="uniform", initial="positive"), hf.Record(u, y))
    judge("relays, 50 uniform thresholds", lambda r: coarse.model.free_run(r.u))
    judge("straight line between the curves fitted next to it", lambda r: _between(r, train))
    return held, predicted, fit


def _between(record: hf.Record, curves: list[hf.Record]) -> np.ndarray:
    """Linear interpolation between the curves with neighboring reversals, at the same fraction of the way from reversal to end."""
    starts = np.array([r.u[0] for r in curves])
    order = np.argsort(starts)
    k = int(np.clip(np.searchsorted(starts[order], record.u[0]) - 1, 0, starts.size - 2))
    low, high = curves[order[k]], curves[order[k + 1]]
    part = np.clip((record.u[0] - low.u[0]) / (high.u[0] - low.u[0]), 0.0, 1.0)
    along = lambda r: np.interp(record.u - record.u[0] + r.u[0], r.u, r.y)
    at = lambda r: np.interp(record.u, r.u, r.y)
    # Near the reversal along the distance from it, far from it at the same field.
    far = np.clip((record.u - record.u[0]) / max(high.u[0] - low.u[0], 1e-300), 0.0, 1.0)
    return (1 - far) * ((1 - part) * along(low) + part * along(high)) + far * ((1 - part) * at(low) + part * at(high))


def minor_loops(results: Results, model: hf.Record, test: hf.Record) -> dict[str, np.ndarray]:
    """Loops of all sizes predicted from 40 cycles of one size: cells after a lag (as `check` estimates it), and the winner of `compare`."""
    lag = hf.check(model).records[0].lag
    if lag is None or lag.seconds is None:
        raise RuntimeError("no lag was found in the major loop")
    passed = lambda r: r.replace(u=np.asarray(hf.simulate(hf.Lag(tau=lag.seconds), r.u, r.dt)[0]))
    fit = hf.fit(hf.Preisach.of(24, initial="negative"), passed(model))
    winner = hf.compare(model).winner
    results.add("measured minor loops: lag of the major loop, ms", 1e3 * lag.seconds)
    runs = {"cells": fit.predict(passed(test)), "compare's choice": winner.predict(test)}
    size = _local_size(test)
    late = times(test) >= times(test)[0] + CLOSE
    parts = {"whole": np.ones(len(test), bool), f"after {CLOSE:g} s": late}
    parts["loops of less than half the range"] = late & (size < 0.5 * size.max())
    span = float(np.ptp(test.y))
    for name, y in runs.items():
        shifted = y - np.mean(y - test.y)  # the zero of the sensor differs between records
        runs[name] = shifted
        for part, at in parts.items():
            error = (shifted - test.y)[at]
            results.add(f"measured minor loops: {name}, {part}, RMS %", 100 * float(np.sqrt(np.mean(error**2))) / span)
            results.add(f"measured minor loops: {name}, {part}, max %", 100 * float(np.abs(error).max()) / span)
    return runs


def _local_size(record: hf.Record) -> np.ndarray:
    """Peak to peak of the input over the second about each sample."""
    width = round(1.0 / float(np.median(record.dt))) | 1
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(record.u, width // 2, mode="edge"), width)
    return np.ptp(windows, axis=1)
