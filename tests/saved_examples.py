"""A fit, a posterior and ways to change their files, for the tests of saved fits."""

import hashlib
import json
from pathlib import Path

import numpy as np

import hystfit as hf
from hystfit.outcome import Status
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import Posterior

MINE = """
from pathlib import Path

from hystfit import BoucWen

with Path({marks!r}).open("a") as file:
    file.write("run ")


class Mine(BoucWen):
    \"\"\"Own.\"\"\"
"""


def loop(offset: float = 0.0) -> hf.Record:
    """Two cycles of a Bouc-Wen loop with noise."""
    u = 20 * (1 - np.cos(np.linspace(0, 4 * np.pi, 160)))
    y = np.asarray(hf.simulate(hf.BoucWen(c=0.2, mu=0.5, tau=0.05, rho=0.4, offset=offset), u)[0])
    return hf.Record(
        u=u, y=y + 0.01 * np.random.default_rng(1).normal(size=u.size), u_unit="V", y_unit="um", name="loop"
    )


def fitted(offset: float = 0.0) -> hf.FitResult:
    """A fit of that loop; another offset makes another fit."""
    return hf.fit("bouc-wen", loop(offset), starts=1)


def posterior_of(result: hf.FitResult) -> Posterior:
    """Draws about a fit with independent noise, not from a sampler."""
    center = np.append(result.x, 0.01)
    draws = center + 1e-4 * np.random.default_rng(2).normal(size=(2, 40, center.size))
    names = (*result.free_names, "noise_white")
    return Posterior(
        result=result,
        sampler="nuts",
        noise="iid",
        names=names,
        units=tuple("" for _ in names),
        draws=draws,
        log_density=-np.sum((draws - center) ** 2, axis=-1),
        stats={"diverging": np.zeros((2, 40))},
        convergence=Convergence.of(draws),
        status=Status.OK,
        notes=(),
        priors={name: "flat" for name in names},
        seconds=1.0,
        seed=0,
        provenance={"date": "2026-01-01"},
    )


def reseal(folder: Path) -> None:
    """Give a folder a manifest that fits its files, as somebody would who changes them with intent."""
    file = folder / "manifest.json"
    stored = json.loads(file.read_text())
    stored["files"] = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in stored["files"]}
    file.write_text(json.dumps(stored))


def change(folder: Path, name: str, old: str, new: str) -> None:
    """Replace text in a file of a fit."""
    content = (folder / name).read_text()
    assert old in content
    (folder / name).write_text(content.replace(old, new))
