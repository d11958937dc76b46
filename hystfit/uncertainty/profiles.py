"""Profile likelihoods: each parameter held along a path, all others refitted; limits, or on which side there are none.

Curvature at the optimum sees no further than the optimum; a profile says where the data stop objecting (Raue et al. 2009;
Wieland et al. 2021).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.stats import chi2

from hystfit.config import require_x64
from hystfit.errors import ParameterError
from hystfit.fitting.again import problem_of
from hystfit.fitting.covariance import error_ratios, near_bound
from hystfit.fitting.estimate import Estimate
from hystfit.fitting.generalized import Whitened, linearize, refine
from hystfit.inference.noise import Setting, White
from hystfit.inference.problem import Objective
from hystfit.params.coordinates import BOTH, LOWER, UPPER
from hystfit.params.units import axis_label
from hystfit.results.result import FitResult
from hystfit.sampling.setup import trimmed
from hystfit.uncertainty.profile_paths import crossing, follow_all

SCHEMA = "hystfit.profile/1"


@dataclasses.dataclass(frozen=True)
class Profile:
    """The profile of one parameter.

    Attributes:
        name, unit: of the parameter.
        value: at the optimum.
        x: values along the path, rising, shape (n,).
        statistic: twice the loss of log likelihood there, shape (n,).
        lower, upper: confidence limits; None where that side is open.
        open_lower, open_upper: where an open side leads, in words; None where there is a limit.
    """

    name: str
    unit: str
    value: float
    x: np.ndarray
    statistic: np.ndarray
    lower: float | None
    upper: float | None
    open_lower: str | None
    open_upper: str | None

    @property
    def closed(self) -> bool:
        """Both limits exist."""
        return self.lower is not None and self.upper is not None

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        side = lambda limit, words: words if limit is None else f"{limit:.5g}"
        ends = f"{side(self.lower, self.open_lower)} to {side(self.upper, self.open_upper)}"
        return f"{self.name} = {self.value:.5g} {self.unit}: {ends}".replace(" :", ":")


@dataclasses.dataclass(frozen=True)
class Profiles:
    """Profiles of a fit.

    Attributes:
        result: the fit.
        profiles: by parameter.
        level: of the limits.
        noise: how misfit was counted.
        notes: parameters left out and open sides, one sentence each.
    """

    result: FitResult
    profiles: dict[str, Profile]
    level: float
    noise: str
    notes: tuple[str, ...]

    @property
    def usable(self) -> bool:
        """Every profile has both limits."""
        return all(profile.closed for profile in self.profiles.values())

    def __getitem__(self, name: str) -> Profile:
        return self.profiles[name]

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        lines = [f"{self.result.name}: {self.level:.0%} limits by profile likelihood, noise {self.noise}"]
        return "\n".join(lines + [str(p) for p in self.profiles.values()] + [f"note: {note}" for note in self.notes])

    def to_dict(self) -> dict[str, Any]:
        """The contents of `result.json`."""
        rows = {}
        for name, p in self.profiles.items():
            rows[name] = {k: getattr(p, k) for k in ("value", "unit", "lower", "upper", "open_lower", "open_upper")}
            rows[name] |= {"x": p.x.tolist(), "statistic": p.statistic.tolist()}
        return {
            "schema": SCHEMA,
            "model": self.result.name,
            "status": "ok" if self.usable else "open",
            "notes": list(self.notes),
            "level": self.level,
            "noise": self.noise,
            "profiles": rows,
            "provenance": self.result.provenance,
        }

    def plot(self) -> Any:
        """One panel a parameter; returns the matplotlib figure."""
        import matplotlib.pyplot as plt

        columns = min(3, len(self.profiles))
        rows = -(-len(self.profiles) // columns)
        figure, axes = plt.subplots(
            rows, columns, figsize=(3.2 * columns, 2.6 * rows), layout="constrained", squeeze=False
        )
        for ax in axes.ravel()[len(self.profiles) :]:
            ax.axis("off")
        for ax, p in zip(axes.ravel(), self.profiles.values(), strict=False):
            ax.plot(p.x, p.statistic, ".-", color="#0072b2")
            ax.axhline(chi2.ppf(self.level, 1), color="#a6a6a6", lw=0.8, label=f"{self.level:.0%}")
            ax.locator_params(axis="x", nbins=4)
            ax.set(xlabel=axis_label(p.name, p.unit), ylim=(0, 2.5 * chi2.ppf(self.level, 1)))
        for row in axes:
            row[0].set_ylabel("twice the loss of log likelihood", fontsize=8)
        axes[0, 0].legend(fontsize=8, frameon=False)
        return figure


def profile(
    result: FitResult,
    names: Sequence[str] | None = None,
    *,
    noise: Literal["auto", "iid", "ou", "ar1", "discrepancy"] = "auto",
    level: float = 0.95,
) -> Profiles:
    """Profile likelihoods of a fit's parameters.

    Args:
        result: the fit.
        names: parameters; all free ones by default.
        noise: "auto" counts misfit as the fit's errors do: with its noise model if it had one, else by the sum of squares, which for
            correlated residuals counts less by the square of each parameter's honest over its plain error (Kent 1982); or a noise
            model by name, whose values are taken at the optimum.
        level: of the limits, by chi squared with one degree of freedom.

    Raises:
        ParameterError: an unknown name, level or noise model.
    """
    require_x64()
    if not 0 < level < 1:
        raise ParameterError(f"level must lie between 0 and 1, got {level}")
    problem, x = problem_of(result)
    chosen = list(names) if names else list(problem.space.names)
    unknown = [name for name in chosen if name not in problem.space.names]
    if unknown:
        raise ParameterError(f"no free parameter {unknown}; those are: {', '.join(problem.space.names)}")
    sides = near_bound(problem, x)
    moving = np.array([side is None for side in sides])
    described, x, whitened, wider = _whitened(result, problem, x, moving, noise)
    at = np.array([problem.space.names.index(name) for name in chosen], dtype=int)
    limit = float(chi2.ppf(level, 1))
    traced = [
        np.asarray(v)
        for v in follow_all(
            whitened, jnp.asarray(x), jnp.asarray(moving), jnp.asarray(at), jnp.asarray(wider[at]), limit
        )
    ]
    profiles: dict[str, Profile] = {}
    notes = []
    for k, name in enumerate(chosen):
        made = _collect(problem.space, int(at[k]), [v[2 * k : 2 * k + 2] for v in traced], limit)
        profiles[name] = made
        for words in (made.open_lower, made.open_upper):
            if words:
                notes.append(
                    f"{name} is {words}: the data do not bound it on that side, and no error bar for it means anything"
                )
    notes += [
        f"{name} lies on its {side} bound in the fit"
        for name, side in zip(problem.space.names, sides, strict=True)
        if side
    ]
    notes += _elsewhere(result, profiles)
    return Profiles(result, profiles, level, described, tuple(notes))


def _elsewhere(result: FitResult, profiles: dict[str, Profile]) -> list[str]:
    """Where the likelihood is best more than an error away from what was fitted: a ridge held the fit back, or it lies in a valley."""
    moved = []
    for name, p in profiles.items():
        fitted = result[name]
        apart = abs(p.value - fitted.value)
        if apart > (0.01 * abs(fitted.value) if fitted.stderr is None else fitted.stderr):
            moved.append(f"{name} {p.value:.4g} (fitted {fitted.value:.4g})")
    if not moved:
        return []
    shown = ", ".join(moved[:6]) + (f" and {len(moved) - 6} more" if len(moved) > 6 else "")
    return [f"the likelihood, which knows of no ridge, is best elsewhere than the fit: {shown}"]


def _whitened(
    result: FitResult, problem: Any, x: np.ndarray, moving: np.ndarray, noise: str
) -> tuple[str, np.ndarray, Whitened, np.ndarray]:
    """How misfit is counted, where the optimum is, the whitened problem, and by how much each parameter's error is wider than there."""
    batch = trimmed(problem.objective.batch)
    objective: Objective = eqx.tree_at(lambda o: o.batch, problem.objective, batch)
    whole = np.asarray(problem.objective.batch.u)
    setting = Setting.of(
        batch, (float(whole.min()), float(whole.max()))
    )  # lengths of a kernel are in parts of that range
    if noise == "auto":
        noise = str((result.provenance.get("noise") or {}).get("name", "auto"))
    if noise == "student-t":
        raise ParameterError("profiles need Gaussian noise: use noise='ou', or sample the posterior")
    if noise not in ("auto", "iid"):
        refined = refine(problem, Estimate(x, 0.0, True, "", 0, np.zeros(1)), noise, moving)
        return noise, refined.x, Whitened(objective, refined.noise, setting), np.ones(x.size)
    r = np.asarray(_residuals(objective, jnp.asarray(x))) * np.sqrt(np.asarray(batch.weight))
    used = np.asarray(batch.weight) > 0
    wider = error_ratios(problem, x) if noise == "auto" else np.ones(x.size)
    sd = float(np.sqrt(np.sum(r[used] ** 2) / max(int(used.sum()) - int(moving.sum()), 1)))
    words = f"independent, errors times {wider.min():.3g} to {wider.max():.3g}" if np.any(wider != 1) else "independent"
    return words, x, Whitened(objective, White(noise_white=jnp.asarray(sd)), setting), wider


@eqx.filter_jit
def _residuals(objective: Objective, x: Array) -> Array:
    return linearize(objective, x)[0]


def _collect(space: Any, k: int, traced: list[np.ndarray], limit: float) -> Profile:
    """A profile from the paths down and up in z."""
    c = space.coordinates
    z0 = traced[3][0]

    def physical(values: np.ndarray) -> np.ndarray:
        rows = np.tile(z0, (len(values), 1))
        rows[:, k] = values
        return np.array([np.asarray(c.physical(jnp.asarray(row)))[k] for row in rows])

    kind, lower, upper = c.kinds[k], float(c.lower[k]), float(c.upper[k])
    paths = [(z[on], s[on]) for z, s, on in zip(*traced[:3], strict=True)]
    limits = [crossing(z0[k], *path, limit) for path in paths]
    down_is_up = kind == UPPER  # with an upper bound alone, x falls as z rises
    ends = [None if limit_z is None else float(physical(np.array([limit_z]))[0]) for limit_z in limits]
    z = np.concatenate([paths[0][0][::-1], [z0[k]], paths[1][0]])
    s = np.concatenate([paths[0][1][::-1], [0.0], paths[1][1]])
    values = physical(z)
    words = [
        f"open to {lower:g}, its bound" if kind in (LOWER, BOTH) else "open to -infinity",
        f"open to {upper:g}, its bound" if kind in (UPPER, BOTH) else "open to +infinity",
    ]
    if down_is_up:
        ends, values, s = ends[::-1], values[::-1], s[::-1]
    told = [None if end is not None else word for end, word in zip(ends, words, strict=True)]
    return Profile(
        space.names[k],
        space.units[k],
        float(c.physical(jnp.asarray(z0))[k]),
        values,
        s,
        ends[0],
        ends[1],
        told[0],
        told[1],
    )
