"""Standard errors of a fit by several methods, side by side."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from hystfit.config import verb
from hystfit.errors import ParameterError
from hystfit.inference.fittable import check_smooth
from hystfit.outcome import Code, Column, Note, Status, Table
from hystfit.outcome.note import warn
from hystfit.outcome.table import or_none
from hystfit.outcome.wrapping import listed
from hystfit.quality.determination import count
from hystfit.results.estimates import differences, grouped
from hystfit.results.result import FitResult
from hystfit.sampling.base import Progress
from hystfit.sampling.sample import sample, suited_sampler
from hystfit.uncertainty.block_covariance import covariance


@dataclasses.dataclass(frozen=True)
class StandardErrors:
    """Standard errors of a fit by every method, side by side.

    Attributes:
        result: the fit.
        errors: of each free parameter by method, shape (p,): "fit", as the report prints them, "iid", "sandwich", "bootstrap", and
            for weights "posterior" (`hystfit.sampling.weight_sampler`); NaN where the data do not determine the parameter.
        factors: half a 95 % interval over the error, by method except "fit", shape (p,).
        block: samples of a block; None where the records hold too few of them.
        notes: what is missing and why.
    """

    result: FitResult
    errors: dict[str, np.ndarray]
    factors: dict[str, np.ndarray]
    block: int | None
    notes: tuple[Note, ...]

    @property
    def ratios(self) -> dict[str, np.ndarray]:
        """Errors by method over those for independent residuals."""
        return {rule: error / self.errors["iid"] for rule, error in self.errors.items() if rule != "iid"}

    def table(self, parameter: str | Sequence[str] | None = None) -> Table:
        """Errors by method, of parameters that have one, and at the end their typical ratio to those for independent residuals.

        Args:
            parameter: parameters, or arrays of them ("w" for all its weights), which alone are listed, each in its own row; by default
                all, and arrays of more than 12 weights in one row with the smallest and the largest value and error.

        Raises:
            ParameterError: no free parameter has that name.
        """
        heads = {"fit": "fit", "iid": "independent"}
        rules = [Column(heads.get(rule, rule), key=rule, form=".3g") for rule in self.errors]
        rows = [self._row(name, family) for name, family in self._families(parameter)]
        typical = [1.0 if rule == "iid" else _typical(self.ratios[rule]) for rule in self.errors]
        rows.append(["times independent", "", *typical, ""])
        return Table(["parameter", "value", *rules, Column("", key="remark", left=True)], rows)

    def _families(self, parameter: str | Sequence[str] | None = None) -> list[tuple[str, list[int]]]:
        """Name and positions of the parameters of each row, of which at least one has an error; see `table`."""
        names, space = self.result.free_names, self.result.problem.space
        known = np.any([np.isfinite(error) for error in self.errors.values()], axis=0)
        if parameter is not None:
            return [(names[k], [k]) for k in space.positions(parameter) if known[k]]
        rows = grouped(range(len(names)), names.__getitem__)
        return [(name, places) for name, places in rows if known[places].any()]

    def _row(self, name: str, places: list[int]) -> list[Any]:
        """Value and errors of one parameter, or their ranges over an array, and how many of its elements have an error."""
        members = [self.result[self.result.free_names[k]] for k in places]
        if len(places) == 1:
            value = f"{members[0].value:.5g} {members[0].unit}".strip()
            return [name, value, *(float(error[places[0]]) for error in self.errors.values()), ""]
        value = f"{_span([p.value for p in members])} {members[0].unit}".strip()
        without = len(places) - int(np.isfinite(self.errors["fit"][places]).sum())
        remark = f"{len(places)} values" + (f", {without} without an error" if without else "")
        return [f"{name}[{len(places)}]", value, *(_span(error[places]) for error in self.errors.values()), remark]

    def text(self, parameter: str | Sequence[str] | None = None) -> str:
        """The table, see there, and the notes."""
        lines = [f"Standard errors of {self.result.name} by several methods", *self.table(parameter).lines()]
        if arrays := [(name, len(places)) for name, places in self._families(parameter) if len(places) > 1]:
            name, many = arrays[0]
            lines.append(f"{name}[{many}]: smallest and largest of {many} values; parameter={name!r} lists each")
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def __str__(self) -> str:
        return self.text()

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`; unknown is null."""
        by_rule = lambda table, k: {rule: or_none(values[k]) for rule, values in table.items()}
        rows = {}
        for k, name in enumerate(self.result.free_names):
            rows[name] = {
                "value": self.result[name].value,
                "unit": self.result[name].unit,
                "stderr": by_rule(self.errors, k),
                "ratio": by_rule(self.ratios, k),
                "factor": by_rule(self.factors, k),
            }
        return {
            "schema": "hystfit.errors/1",
            "model": self.result.name,
            "status": str(self.result.status),
            "notes": [note.to_dict() for note in self.notes],
            "block": self.block,
            "parameters": rows,
            "provenance": self.result.provenance,
        }


def _span(values: Sequence[float] | np.ndarray) -> str | None:
    """The smallest and the largest of the values that are known; None where none is."""
    known = np.asarray(values)[np.isfinite(values)]
    return f"{known.min():.3g} to {known.max():.3g}" if known.size else None


def _typical(ratio: np.ndarray) -> float:
    known = ratio[np.isfinite(ratio) & (ratio > 0)]
    return float(np.exp(np.mean(np.log(known)))) if known.size else float("nan")


def _of_draws(result: FitResult, seed: int, progress: Progress | None) -> tuple[np.ndarray, np.ndarray, list[Note]]:
    """Standard deviations over the posterior of weights, half a 95 % interval over each, and notes.

    Weights without any influence on the data have none: their posterior is the smoothness prior.
    """
    posterior = sample(result, "weights", seed=seed, progress=progress)
    p = len(result.free_names)
    draws = posterior.draws[:, :, :p].reshape(-1, p)
    norms = np.linalg.norm(result.problem.linearize(result.x)[1], axis=(0, 1))
    spread = np.where(norms > 1e-9 * norms.max(), draws.std(axis=0, ddof=1), np.nan)
    half = 0.5 * np.subtract(*np.quantile(draws, [0.975, 0.025], axis=0))
    text = "the posterior includes smoothness and the bounds as prior information, and has an error for weights at their bound"
    notes = [Note(Code.NOISE_MODEL, f"{text}; noise model {posterior.noise}")]
    if posterior.status is Status.NOT_CONVERGED:
        notes += [note for note in posterior.notes if note.code is Code.CHAINS]
    return spread, half / spread, notes


@verb
def standard_errors(
    result: FitResult, *, block: int | None = None, seed: int = 0, progress: Progress | None = None
) -> StandardErrors:
    """Standard errors of a least-squares fit by every method: as reported, for independent residuals, sandwich, block bootstrap.

    For weights with few other parameters, also the standard deviations of their posterior.

    Args:
        result: a least-squares fit.
        block: samples, see `covariance`.
        seed: of the bootstrap.
        progress: called repeatedly with a line of text and the fraction that is done, while weights are sampled.

    Raises:
        ParameterError: a fit under a noise model; its own likelihood gives its errors.
    """
    check_smooth(result.problem.space, "a comparison of standard errors")
    reported = [np.nan if (e := result[name].stderr) is None else e for name in result.free_names]
    fit = np.array(reported, dtype=float)
    plain = covariance(result, "iid", block=block)
    known = lambda values: np.where(np.isfinite(fit), values, np.nan)
    errors, factors = {"fit": fit, "iid": known(plain.stderr)}, {"iid": known(plain.factor)}
    notes, span = [], None
    for kind in ("sandwich", "bootstrap"):
        try:
            other = covariance(result, kind, block=block, seed=seed)
        except ParameterError as error:
            notes.append(warn(Code.BLOCKS, f"no {kind}: {error}"))
            continue
        errors[kind], factors[kind] = known(other.stderr), known(other.factor)
        span, widest = other.block, float(np.nanmax(factors[kind], initial=0.0))
        text = (
            f"the {kind} uses {other.blocks} blocks of {span} samples, so that a 95 % interval reaches up to {widest:.2g} of its standard "
            "errors to either side; it does not include errors that recur every loop"
        )
        notes.append(Note(Code.BLOCKS, text))
        if alone := int(np.count_nonzero(np.isfinite(fit) & ~np.isfinite(errors[kind]))):
            text = f"no {kind} for {count(alone, 'parameter')} that one block determines alone, such as the offset of a record"
            notes.append(Note(Code.BLOCKS, text))
        reason = f"from {other.blocks} blocks, a standard error is accurate to {100 / np.sqrt(2 * other.blocks):.0f} % at best"
        by_name = dict(zip(result.free_names, map(float, np.nan_to_num(errors[kind])), strict=True))
        notes += differences(result.parameters, by_name, f"the {kind}", reason)
    if suited_sampler(result) == "weights":
        errors["posterior"], factors["posterior"], remarks = _of_draws(result, seed, progress)
        notes += remarks
    nowhere = ~np.any([np.isfinite(error) for error in errors.values()], axis=0)
    unknown = [name for name, missing in zip(result.free_names, nowhere, strict=True) if missing]
    if unknown:
        text = f"no method gives a standard error for parameters at a bound or not determined by the data: {listed(unknown)}"
        notes.append(warn(Code.NOT_DETERMINED, text))
    return StandardErrors(result, errors, factors, span, tuple(notes))
