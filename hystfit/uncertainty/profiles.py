"""Profile likelihoods: each parameter held along a path, all others refitted; confidence limits, or open sides.

The curvature at the optimum is local; a profile follows the likelihood as far as it matters (Raue et al. 2009; Wieland et al. 2021).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.stats import chi2

from hystfit.config import require_x64
from hystfit.errors import ParameterError
from hystfit.fitting.covariance import error_ratios
from hystfit.fitting.noise_refinement import refine_moving
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.noise.white import White
from hystfit.inference.problem import Problem
from hystfit.inference.whitened import Whitened
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import warn
from hystfit.params.coordinates import BOTH, LOWER, UPPER
from hystfit.params.space import ParameterSpace
from hystfit.params.units import axis_label
from hystfit.results.labels import make_legible
from hystfit.results.result import FitResult
from hystfit.uncertainty.profile_paths import crossing, follow_all

SCHEMA = "hystfit.profile/1"


@dataclasses.dataclass(frozen=True)
class Profile:
    """The profile of one parameter.

    Attributes:
        name, unit: of the parameter.
        value: at the optimum.
        x: values along the path, rising, shape (n,).
        statistic: -2 delta log likelihood there, shape (n,).
        lower, upper: confidence limits; None where that side is open.
        open_lower, open_upper: the bound or infinity towards which a side is open, as text; None where there is a limit.
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
        if not self.closed and self.lower is None and self.upper is None:
            limits = "not bounded by the data on either side"
        else:
            side = lambda limit, bound: f"not bounded (open to {bound})" if limit is None else f"{limit:.5g}"
            limits = f"{side(self.lower, self.open_lower)} to {side(self.upper, self.open_upper)}"
        return f"{self.name} = {self.value:.5g} {self.unit}: {limits}".replace(" :", ":")


@dataclasses.dataclass(frozen=True)
class Profiles:
    """Profiles of a fit.

    Attributes:
        result: the fit.
        profiles: by parameter.
        level: of the limits.
        noise: noise model of the likelihood, as text.
        notes: open sides, parameters on a bound, and other optima.
    """

    result: FitResult
    profiles: dict[str, Profile]
    level: float
    noise: str
    notes: tuple[Note, ...]

    @property
    def status(self) -> Status:
        """`Status.OK` where every profile has both limits, else `Status.OPEN`."""
        return Status.OK if all(profile.closed for profile in self.profiles.values()) else Status.OPEN

    @property
    def usable(self) -> bool:
        """Whether every profile has both limits."""
        return self.status.usable

    def __getitem__(self, name: str) -> Profile:
        return self.profiles[name]

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        lines = [f"{self.result.name}: {100 * self.level:.0f} % limits by profile likelihood, noise {self.noise}"]
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
            "status": str(self.status),
            "notes": [note.to_dict() for note in self.notes],
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
            ax.axhline(chi2.ppf(self.level, 1), color="#a6a6a6", lw=0.8, label=f"{100 * self.level:.0f} %")
            ax.locator_params(axis="x", nbins=4)
            ax.set(xlabel=axis_label(p.name, p.unit), ylim=(0, 2.5 * chi2.ppf(self.level, 1)))
        for row in axes:
            row[0].set_ylabel("-2 delta log-likelihood", fontsize=8)
        axes[0, 0].legend(fontsize=8, frameon=False)
        make_legible(figure)
        return figure


def profile(
    result: FitResult,
    names: Sequence[str] | None = None,
    *,
    noise: str | type[AbstractNoise] = "auto",
    level: float = 0.95,
) -> Profiles:
    """Profile likelihoods of a fit's parameters.

    Args:
        result: the fit.
        names: parameters; all free ones by default.
        noise: "auto" uses the noise of the fit: its noise model if it had one, else the sum of squares, which for autocorrelated
            residuals is divided by the square of each parameter's reported over its i.i.d. standard error (Kent 1982); or a noise
            model, whose values are those at the optimum.
        level: of the limits, by chi squared with one degree of freedom.

    Raises:
        ParameterError: an unknown name, level or noise model.
    """
    require_x64()
    if not 0 < level < 1:
        raise ParameterError(f"level must lie between 0 and 1, got {level}")
    problem, x = result.problem.with_loss("linear"), result.x
    chosen = list(names) if names else list(problem.space.names)
    unknown = [name for name in chosen if name not in problem.space.names]
    if unknown:
        raise ParameterError(f"no free parameter {unknown}; those are: {', '.join(problem.space.names)}")
    sides = problem.at_bound(x)
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
        curve = _collect(problem.space, int(at[k]), [v[2 * k : 2 * k + 2] for v in traced], limit)
        profiles[name] = curve
        for bound in (curve.open_lower, curve.open_upper):
            if bound:
                text = f"the data do not bound {name} towards {bound}: a symmetric error bar is meaningless"
                notes.append(warn(Code.OPEN_SIDE, text))
    notes += [
        warn(Code.AT_BOUND, f"{name} lies on its {side} bound in the fit")
        for name, side in zip(problem.space.names, sides, strict=True)
        if side
    ]
    notes += _other_optimum(result, profiles)
    return Profiles(result, profiles, level, described, tuple(notes))


def _other_optimum(result: FitResult, profiles: dict[str, Profile]) -> list[Note]:
    """A note where the likelihood is largest more than a standard error away from the fit: by a ridge penalty, or in a flat valley."""
    moved = []
    for name, p in profiles.items():
        fitted = result[name]
        distance = abs(p.value - fitted.value)
        if distance > (0.01 * abs(fitted.value) if fitted.stderr is None else fitted.stderr):
            moved.append(f"{name} {p.value:.4g} (fitted {fitted.value:.4g})")
    if not moved:
        return []
    shown = ", ".join(moved[:6]) + (f" and {len(moved) - 6} more" if len(moved) > 6 else "")
    text = f"without the regularization of the fit, the likelihood has its maximum elsewhere: {shown}"
    return [warn(Code.OTHER_OPTIMUM, text)]


def _whitened(
    result: FitResult, problem: Problem, x: np.ndarray, moving: np.ndarray, noise: str | type[AbstractNoise]
) -> tuple[str, np.ndarray, Whitened, np.ndarray]:
    """(noise as text, optimum, the whitened problem, reported over i.i.d. standard errors), by which profiles are drawn."""
    trimmed = problem.trimmed()
    choice = result.noise.name if noise == "auto" else noise
    if choice not in ("auto", "iid"):
        if not NOISES.find(choice).gaussian:  # type: ignore[attr-defined]
            raise ParameterError("profiles need Gaussian noise: use noise='ou', or sample the posterior")
        refined = refine_moving(problem, x, choice, moving)
        return NOISES.label(choice), refined.x, trimmed.whitened(refined.noise), np.ones(x.size)
    r = problem.residuals(x) * np.sqrt(np.asarray(problem.objective.batch.weight))
    used = problem.used
    wider = error_ratios(problem, x) if choice == "auto" else np.ones(x.size)
    sd = float(np.sqrt(np.sum(r[used] ** 2) / max(int(used.sum()) - int(moving.sum()), 1)))
    text = "independent"
    if np.any(wider != 1):
        text = (
            f"independent, intervals widened {wider.min():.3g} to {wider.max():.3g} times for autocorrelated residuals"
        )
    return text, x, trimmed.whitened(White(noise_white=sd)), wider


def _collect(space: ParameterSpace, k: int, traced: list[np.ndarray], limit: float) -> Profile:
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
    bounds = [
        f"its bound {lower:g}" if kind in (LOWER, BOTH) else "-infinity",
        f"its bound {upper:g}" if kind in (UPPER, BOTH) else "+infinity",
    ]
    if down_is_up:
        ends, values, s = ends[::-1], values[::-1], s[::-1]
    open_to = [None if end is not None else bound for end, bound in zip(ends, bounds, strict=True)]
    return Profile(
        space.names[k],
        space.units[k],
        float(c.physical(jnp.asarray(z0))[k]),
        values,
        s,
        ends[0],
        ends[1],
        open_to[0],
        open_to[1],
    )
