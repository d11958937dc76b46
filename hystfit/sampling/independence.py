"""Independence chains (Tierney 1994, Ann. Stat. 22): Metropolis steps to draws of a mixture that is fitted to the posterior.

Importance weights tell whether the mixture covers the posterior. Where it does not, NUTS draws.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import operator
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import jax
import numpy as np
from jaxtyping import Float

from hystfit.outcome import Code, Note
from hystfit.runs.chunks import Chunks, stored
from hystfit.runs.threads import Workers
from hystfit.sampling.base import AbstractChains, Progress, Raw
from hystfit.sampling.nuts import Nuts
from hystfit.sampling.proposals import Batch, Mixture, adapted, efficiency, tail_shape
from hystfit.sampling.setup import Setup, given_others
from hystfit.sampling.target import Target

_CHUNK = 100  # draws of a chain between two writes to disk
# Effective fraction of the offers, and shape of their largest weights (Vehtari et al. 2024), of a mixture that covers a posterior. Those
# of measured records had 0.27 to 0.75, and shapes of 0.03 to 0.58. Of 120 funnels (Neal 2003) of 3 to 10 dimensions, 20 of each, one
# of three dimensions was covered; with a shape of 0.7 others were, up to 2.5 % of whose draws were missing at the narrow end.
_COVERED, _TAIL = 0.25, 0.6
_HOPELESS = 0.02  # effective fraction below which no other mixture follows; ten that led to one that covers a piezo record had 0.09 to 0.41
_ATTEMPTS = 5  # to draw, each by a mixture fitted to all offers before
_TRIES = 2.0  # effective draws of the mixture for each draw of a chain


@dataclasses.dataclass(frozen=True)
class Independence(AbstractChains):
    """Settings of independence chains, see `AbstractChains`."""

    name: ClassVar[str] = "independence"

    def run(self, setup: Setup, seed: int, folder: Path | None, report: Progress) -> Raw:
        """Draw, chains in parallel on the processor's cores; by NUTS where no mixture covers the posterior."""
        report("compilation and fit of the proposals", 0.0)
        straight = given_others(setup, jax.random.key(seed)).target
        drawn = self._drawn(straight.sheared(straight.factor), seed, folder, report)
        if drawn is not None:
            z = drawn.pop("z")
            return Raw(z, setup.log_density(z), drawn | {"diverging": np.zeros(z.shape[:-1], bool)})
        nuts = Nuts(chains=self.chains, draws=self.draws, extend=self.extend)
        raw = nuts.run(nuts.straightened(setup), seed, folder, report)
        note = Note(Code.CHAINS, "no mixture of t distributions covers the posterior: NUTS draws")
        return dataclasses.replace(raw, notes=(note, *raw.notes), sampler=nuts.name)

    def _drawn(self, target: Target, seed: int, folder: Path | None, report: Progress) -> dict[str, np.ndarray] | None:
        """Draws in the coordinates of a target; None where no mixture covers it.

        Where the offers of the chains show that it does not, the mixture is fitted to them too, and all draws are made anew.
        """
        make = lambda: _arrays_of(adapted(target, np.random.default_rng([seed, 0])))
        begin = stored(folder, f"{self.name}-fit.npz", make)
        if not begin:
            return None
        mixture: Mixture | None = Mixture(begin["share"], begin["center"], begin["root"])
        places = Batch(*(begin[field.name] for field in dataclasses.fields(Batch)))
        for attempt in range(1, _ATTEMPTS + 1):
            if mixture is None:
                break
            chains = self._chains(target, mixture, places, (seed, attempt), folder)
            # A chunk of each chain shows most mixtures that cover too little.
            for draws in (min(_CHUNK, self.draws), self.draws):
                self._joined(chains, draws, report)
                offers = Batch.joined([chain.offers for chain in chains])
                if not covers(offers):
                    break
            else:
                joined = lambda draws, chains=chains: self._joined(chains, draws, report)
                return self.until_converged(joined, operator.itemgetter("z"))[0]
            places = Batch.joined([places, offers.balanced])
            mixture = mixture.refitted(places)
        return None

    def _chains(
        self, target: Target, mixture: Mixture, places: Batch, seed: tuple[int, int], folder: Path | None
    ) -> list[_Chain]:
        """Chains of one attempt, which begin at weighted places."""
        at = np.random.default_rng([*seed, 0]).choice(len(places.q), self.chains, p=places.weights)
        scores = (places.log_density[at] - mixture.log_density(places.q[at])).tolist()
        tries = 2 * math.ceil(0.5 * _TRIES / max(efficiency(places.score), _COVERED))  # even
        return [
            _Chain(target, mixture, tries, start, (*seed, k), Chunks(folder, f"{self.name}-{seed[1]}-{k}"))
            for k, start in enumerate(zip(places.z[at], scores, strict=True))
        ]

    def _joined(self, chains: list[_Chain], draws: int, report: Progress) -> dict[str, np.ndarray]:
        workers, begun, total = Workers(), itertools.count(), len(chains) * -(-draws // _CHUNK)

        def tick() -> None:
            workers.check()
            share = next(begun) / total
            report(f"{share * self.chains * draws:.0f} of {self.chains * draws} draws", share)

        parts = workers.run([functools.partial(chain.draw, draws, tick) for chain in chains])
        return {name: np.stack([part[name] for part in parts]) for name in parts[0]}


def covers(offers: Batch) -> bool:
    """Whether offers show that their mixture covers the posterior."""
    return efficiency(offers.score) >= _COVERED and tail_shape(offers.score) <= _TAIL


def _arrays_of(found: tuple[Mixture, Batch] | None) -> dict[str, np.ndarray]:
    """Arrays of a mixture and of the places it was fitted to; empty where none is found that may lead to one that covers the posterior."""
    if found is None or efficiency(found[1].score) < _HOPELESS:
        return {}
    return {field.name: getattr(part, field.name) for part in found for field in dataclasses.fields(part)}


_DRAWN = ("z", "acceptance")  # of each draw of a chunk


@dataclasses.dataclass(frozen=True)
class _Chain:
    """One chain, which continues from the chunks that are known."""

    target: Target
    mixture: Mixture
    tries: int
    start: tuple[Float[np.ndarray, " d"], float]
    seed: tuple[int, ...]
    chunks: Chunks

    def draw(self, count: int, tick: Callable[[], None]) -> dict[str, np.ndarray]:
        """The first `count` draws; `tick` is called before each chunk, and ends the chain after an interrupt."""
        for number in range(-(-count // _CHUNK)):
            tick()
            self.chunks.part(number, self._chunk)
        return self.chunks.joined(_DRAWN, count)

    @property
    def offers(self) -> Batch:
        """All draws of the mixture so far."""
        names = [field.name for field in dataclasses.fields(Batch)]
        return Batch.joined([Batch(*(chunk[f"offered_{name}"] for name in names)) for chunk in self.chunks.parts])

    def _chunk(self, number: int) -> dict[str, np.ndarray]:
        """Chunk number `number`: every draw is the end of `tries` Metropolis steps."""
        rng = np.random.default_rng([*self.seed, number])
        offered = Batch.of(self.target, self.mixture, rng, _CHUNK * self.tries)
        before, score = self.start
        if number:
            last = self.chunks.parts[-1]
            before, score = last["z"][-1], float(last["score"])
        levels = np.log(rng.uniform(size=len(offered.q)))
        at, places = -1, np.empty(len(offered.q), int)  # -1: where the chunk begins
        for k, (offer, level) in enumerate(zip(offered.score.tolist(), levels.tolist(), strict=True)):
            if level < offer - score:
                at, score = k, offer
            places[k] = at
        moved = np.diff(places, prepend=-1) != 0
        places = places[self.tries - 1 :: self.tries]
        stay = places < 0
        return {f"offered_{field.name}": getattr(offered, field.name) for field in dataclasses.fields(Batch)} | {
            "z": np.where(stay[:, None], before, offered.z[places]),
            "score": np.asarray(score),
            "acceptance": moved.reshape(_CHUNK, self.tries).mean(axis=1),
        }
