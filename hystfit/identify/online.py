"""The unscented filter on-line: a verdict after every block of samples, and the end of the run when it has converged."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.config import verb
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify.base import Sample, run_stream
from hystfit.identify.filter_verdict import FOLLOWS, NIS_BAND, excess, loop_count, relative_change
from hystfit.identify.identification import Identification
from hystfit.identify.ukf import Ukf, UkfState
from hystfit.models.shared.simulation import Resume, simulate
from hystfit.outcome import Code, Status
from hystfit.outcome.note import warn

_CHANGE = 0.01  # largest relative change of a parameter over a block of a filter that has converged


class BlockVerdict(NamedTuple):
    """Performance of a filter over one block.

    Attributes:
        change: largest relative change of a parameter.
        innovations: moving average of the normalized innovation squared.
        ahead: simulation error beyond the noise, RMS as a fraction of the output's range, of the model with the parameters from before
            the block: a prediction, because it has not used the block.
    """

    change: float
    innovations: float
    ahead: float

    @property
    def converged(self) -> bool:
        """Whether the parameters have settled, the innovations have their predicted size, and the model predicts the block."""
        consistent = abs(self.innovations - 1) <= NIS_BAND
        return self.change <= _CHANGE and consistent and self.ahead <= FOLLOWS


def judge_block(ukf: Ukf, before: UkfState, after: UkfState, block: Sample, record: Record) -> BlockVerdict:
    """The verdict on a block that the filter has just used, of a record whose range counts."""
    s, measured = ukf.states, np.asarray(block.y)
    old, new = (np.asarray(state.mean[s:]) for state in (before, after))
    x = ukf.physical(np.stack([old, new]))
    resume = None if bool(block.first[0]) else Resume(before.mean[:s], before.u)
    error = np.asarray(simulate(ukf.model(old, record), block.u, block.dt, resume=resume)[0]) - measured
    used = np.isfinite(measured)
    if not used.any():
        return BlockVerdict(np.inf, np.nan, np.inf)
    return BlockVerdict(
        float(np.max(relative_change(x[0], x[1], np.asarray(ukf.coordinates.scale)))),
        float(after.tally[5]),
        excess(float(np.sqrt(np.mean(error[used] ** 2))), float(ukf.noise), float(np.ptp(record.y[record.used]))),
    )


@verb
def identify_online(ukf: Ukf, record: Record, *, block: int) -> Identification:
    """Filter a record block by block, as it arrives, until the filter has converged.

    The filter has converged when the input has run through several amplitudes, and settled parameters with consistent innovations
    have predicted a block before using it (`BlockVerdict`). Later samples are not used.

    Args:
        ukf: the filter; its scales may come from an earlier record.
        record: one run of the experiment.
        block: samples between verdicts, a loop or more (2 s at 1 Hz).

    Returns:
        The identification from the samples up to that block, `counts["total"]` of them; "not-converged" where there is no such block.

    Raises:
        ParameterError: fewer samples than one block.
        PrecisionError: double precision is off.
    """
    if not 1 <= block <= len(record):
        raise ParameterError(f"block must be between 1 and the {len(record)} samples of the record, got {block}")
    stream, state, parts, stop = Sample.stream([record]), ukf.init(), [], 0
    converged = False
    while not converged and stop + block <= len(record):
        samples = jax.tree.map(lambda leaf, stop=stop: leaf[stop : stop + block], stream)
        before, (state, info) = state, run_stream(ukf, state, samples)
        parts.append(info)
        stop += block
        known = record.segment(0, stop)
        converged = judge_block(ukf, before, state, samples, known).converged and loop_count(Dataset.of(known)) > 2
    seen = jax.tree.map(lambda leaf: leaf[:stop], stream)
    result = ukf.conclude(
        Dataset.of(record.segment(0, stop)), seen, state, jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    )
    if converged:
        return result
    note = warn(Code.NOT_SETTLED, f"the filter has not converged after {stop} samples: record longer, or use passes")
    status = Status.NOT_CONVERGED if result.usable else result.status
    return dataclasses.replace(result, status=status, notes=(*result.notes, note))
