"""The answer at the top of a report: error beside noise, engineering quantities, lag, what is not determined, and what to do next."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has
from hystfit.outcome.table import number, with_error
from hystfit.outcome.wrapping import NAMED
from hystfit.params.units import conversion, is_energy
from hystfit.quality.faults import CLEAR
from hystfit.quality.lag import estimate_lag
from hystfit.quality.loops import SAME_LEVEL, clear_reversals, closed_loops
from hystfit.quality.summary import paces
from hystfit.reading import datasets
from hystfit.results.accuracy import Limits, two_digits
from hystfit.results.measured.loop_kinds import REMANENT, STRUCTURAL, LoopKind, turns_light
from hystfit.results.measured.measured_value import LoopValue
from hystfit.results.measured.quantities import QUANTITIES, QuantityEstimate, Unknown
from hystfit.results.measured.steady_branches import pace_words
from hystfit.results.measured.steady_loops import Excitation
from hystfit.results.result import FitResult
from hystfit.results.saving.user_code import checksums

# Of the input's range, which a loop must cover for the quantities of one over all of it to be no extrapolation.
_HALF = 0.5
# Measured quantities that a model has not, which come first for dampers and for the strain of a piezoelectric or magnetostrictive device.
_OF_NO_MODEL = ("damping_coefficient", "turning_input_rising", "turning_input_falling")
_SAMPLED = 40  # most parameters for which `sample` is proposed, and not `errors`
# Notes that may propose another fit: of the integral, of a window, or with a robust loss.
_REMEDIED = (
    Code.CONDITIONS,
    Code.RATE,
    Code.FAILURE,
    Code.RECORDS_DIFFER,
    Code.LAST_HALF_CYCLE,
    Code.INITIAL_STATE,
    Code.CHATTER,
    Code.MODEL_MISMATCH,
    Code.SPIKES,
    Code.HEAVY_TAILS,
)


@dataclasses.dataclass(frozen=True)
class Wording:
    """Names of files and options in the commands and the advice of a report."""

    fit: str = "FIT"  # folder of the fit, quoted for a shell
    loop: str = ""  # the file that was fitted, with the options for reading it, quoted; default: see `loops_of`
    # options of the fit that choose its samples, quoted; for a comparison of models on the same samples
    split: str = ""
    saved: bool = True  # whether `fit` exists, or will once the report is written
    translate: Callable[[str], str] = str  # from settings as in Python to the options of the reader

    def at(self, folder: str | Path) -> Wording:
        """The same for a fit saved in this folder."""
        return dataclasses.replace(self, fit=shlex.quote(str(folder)), saved=True)


def loops_of(data: Dataset) -> str:
    """Names of data sets and paths of files that records came from, with the options for reading them, quoted for a shell.

    LOOP stands for records from neither.
    """
    known = datasets.names()
    places = [one.name if one.name in known else one.source if Path(one.source).is_file() else "LOOP" for one in data]
    return shlex.join([*dict.fromkeys(places), *option_words(data[0].reading)])


def option_words(options: Mapping[str, object]) -> list[str]:
    """Options by name as words of a command line; a flag is true."""
    return [
        f"--{k.replace('_', '-')}" if v is True or v == "true" else f"--{k.replace('_', '-')}={v}"
        for k, v in options.items()
    ]


def opened(result: FitResult, folder: str) -> str:
    """The folder of a fit as an argument, with --trust where opening it runs a file of the user's or accepts an edited one."""
    own = checksums(result.models, result.noise.name) or has(result.notes, Code.CHANGED_FILES)
    return f"{folder} --trust" if own else folder


def answer(result: FitResult, wording: Wording | None = None) -> list[tuple[str, str]]:
    """Names and values, the most important first, and the next commands."""
    return [*result.answer, ("Next", "\n".join(next_commands(result, wording or Wording())))]


def numbers_of(result: FitResult) -> tuple[tuple[str, str], ...]:
    """Names and values without commands; `result.answer` keeps them."""
    rows = [("Error", _error(result)), *_numbers(result)]
    if (lag := _lag(result.data[0])) is not None:
        rows.append(lag)
    if result.usable and (why := result.obstacle("inverse")) and result.model.obstacle("inverse") is None:
        rows.append(("Inverse", f"none: {why}"))
    if result.status is Status.UNDETERMINED:  # the samples are too few to tell
        return tuple(rows)
    return (*rows, ("Not determined", _undetermined(result)))


def _error(result: FitResult) -> str:
    unit = result.data.units["y"]
    size = f"{number(result.train.rmse, '.3g')} {unit}".rstrip()
    limit = two_digits(Limits.of(result.baselines).error)
    text = f"{number(result.train.nrmse_percent, '.3g')} % of the range ({size} rms); limit {limit} %"
    noise = result.baselines.noise
    if noise:
        text += f"; noise of the output {noise:.2g} {unit}".rstrip()
    if result.test is not None:
        text += f"; on the test data {number(result.test.nrmse_percent, '.3g')} %"
    return text


def _numbers(result: FitResult) -> list[tuple[str, str]]:
    first = next(iter(result.measured.rows.values()), ())
    if result.status in (Status.NO_LOOP, Status.UNDETERMINED):  # nothing tests the loop of the model
        return [(_capital(one.label), with_error(one.value, one.stderr, one.unit)) for one in first]
    kind, rows, pace = LoopKind.of(result.data), [], _pace(result)
    measured = {one.name: one for one in first} if len(result.data) == 1 else {}
    unseen = not first and len(result.data) == 1 and _never_returns(result.data[0])
    for q in result.quantities:
        one = QUANTITIES[q.name]
        if kind not in one.leads or not _tells(
            q, measured, no_energy=kind is LoopKind.OTHER or turns_light(result.data[0])
        ):
            continue
        read = measured.get(q.name)
        text = "unknown" if q.reason is None else q.reason.text
        if q.value is not None:
            text = with_error(q.value, q.stderr, q.unit) + unseen * " by the model; no measured loop covers the range"
        if q.differs or (q.measured is not None and q.vaguer_than(None)):
            text = f"{f'{number(q.measured)} {q.unit}'.rstrip()} in the measured loop; {text} by the model"
        elif q.value is None and read is not None and read.unit == q.unit:
            text = f"{with_error(read.value, read.stderr, q.unit)} in the measured loops; by the model: {text}"
        elif q.value is not None and read is not None and read.unit == q.unit:
            seen = with_error(read.value, read.stderr, q.unit)
            differs = kind in REMANENT and q.beside(read.value, read.stderr).differs  # both at zero
            without = q.value == 0 and read.value != 0  # a curve, which has no loop
            if differs or without or q.vaguer_than(read.stderr):
                text = f"{seen} in the measured loops; {text} by the model"
        elif q.value == 0 and not unseen:
            text = f"{text} by the model"
        rows.append((_capital(one.label_on(result.data)) + pace * (one.of_loops is not None), text))
    alone = (one for one in measured.values() if one.name in _OF_NO_MODEL)
    return [*rows, *((_capital(one.label), with_error(one.value, one.stderr, one.unit)) for one in alone)]


def _pace(result: FitResult) -> str:
    """The pace of the loops to which the quantities belong, of records at several paces and a model that depends on time."""
    first = result.data[0]
    second = conversion(first.t_unit, "s")
    if result.model.rate_independent or first.t is None or not second or paces(result.data) < 2:
        return ""
    loop = Excitation.of(result.data)
    return pace_words(second * loop.points * loop.interval)


def _tells(q: QuantityEstimate, measured: Mapping[str, LoopValue], *, no_energy: bool) -> bool:
    """Whether a quantity means something on this loop: no ratio beside the coefficient of a damper, no area that is no energy."""
    if q.reason in (Unknown.NO_CROSSING, Unknown.LOBES, Unknown.OVERDAMPED):
        return False
    if q.name == "loop_area":
        return not no_energy or is_energy(q.unit)
    return q.name != "equivalent_damping_percent" or "damping_coefficient" not in measured


def _never_returns(record: Record) -> bool:
    """Whether the input closes no loop over half of its range, as in a tensile test with short unloadings."""
    span = float(np.ptp(record.u))
    return max((loop.stroke for loop in closed_loops(record.u, SAME_LEVEL * span)), default=0.0) < _HALF * span


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _lag(record: Record) -> tuple[str, str] | None:
    """The measured lag or lead, where it is significant."""
    if not record.used.all() or record.t is None:
        return None
    turns = clear_reversals(record.u)
    found = estimate_lag(record.u, record.y, record.sampling_interval, turns)
    if found is None or abs(found.samples) < CLEAR * found.stderr:
        return None
    clock = "" if found.seconds is None else f" ({abs(found.seconds):.3g} {record.t_unit})"
    what = "Lag" if found.samples > 0 else "Lead"
    return f"{what} of the output at reversals", f"{abs(found.samples):.1f} +- {found.stderr:.1f} samples{clock}"


def _undetermined(result: FitResult) -> str:
    names = [p.name for p in result.parameters if p.identifiable is False and p.at_bound is None]
    bounded = [p for p in result.parameters if p.at_bound is not None]
    space = result.problem.space
    of_elements = {name for name, is_weight in zip(space.names, space.weights, strict=True) if is_weight}
    weights = sum(p.name in of_elements and p.value == 0 for p in bounded)
    text = "nothing" if not names else ", ".join(names[:NAMED])
    if len(names) > NAMED:
        count = f"{len(names)} of {len(result.free_names)} parameters"
        text = f"{count}, such as {names[0]}; predictions within the fitted range do not need them"
    counts = {"at a bound": len(bounded) - weights, f"weight{'s are' * (weights > 1) or ' is'} zero": weights}
    return "; ".join([text, *(f"{count} {what}" for what, count in counts.items() if count)])


def next_commands(result: FitResult, wording: Wording) -> list[str]:
    """Commands that make sense now; NEW_LOOP and REFERENCE are files that the user has."""
    fit, loop = opened(result, wording.fit), wording.loop or loops_of(result.data)
    if result.status is Status.NO_LOOP:
        return [f"hystfit check {loop}"]
    apart = any(
        note.code is Code.RECORDS_DIFFER and note.option is None for note in result.notes
    )  # records of several files
    each = _joined("hystfit batch", loop, shlex.join(["--model", result.name]))
    improve = [] if result.usable else [each if apart else _joined("hystfit compare", loop, wording.split)]
    if not result.usable or any(note.code is Code.RATE and note.option is not None for note in result.notes):
        improve = [*_changed_fit(result, wording, loop), *improve]
    if not result.usable and result.status is not Status.ROUGH:
        return [*improve, f"hystfit check {loop}"]
    like = option_words({k: v for k, v in result.data[0].reading.items() if k != "only"})  # the choice among curves
    commands = [f"hystfit predict {fit} {shlex.join(['NEW_LOOP', *like])}"]
    if result.obstacle("inverse") is None:
        commands.append(f"hystfit invert {fit} REFERENCE")
    if result.obstacle("export") is None:
        commands.append(f"hystfit export {fit} --c code")
    if not result.problem.space.stepwise_names:
        commands.append(f"hystfit {'sample' if len(result.x) <= _SAMPLED else 'errors'} {fit}")
    if LoopKind.of(result.data) in STRUCTURAL:  # each of its cycles, and the backbone
        commands.append(f"hystfit quantities {loop}")
    keep = [] if wording.saved else [f"repeat the command with --out {wording.fit} to save this fit; then"]
    return [*improve, *keep, *commands]


def _changed_fit(result: FitResult, wording: Wording, loop: str) -> list[str]:
    """The command of another fit that notes propose: without a half cycle at an end or, where none is wrong, with a robust loss."""
    for code in _REMEDIED:
        for name, value in (note.option for note in result.notes if note.code is code and note.option is not None):
            # A comparison of models takes no loss.
            model = shlex.join(["--model", result.name]) if name == "loss" else ""
            command = _joined("hystfit fit", loop, model, wording.split, shlex.join(option_words({name: value})))
            return [] if f"--{name}" in wording.split else [command]
    return []


def _joined(*words: str) -> str:
    return " ".join(word for word in words if word)
