"""Profile likelihoods: each parameter fixed along a path, all others refitted; confidence limits, or open sides.

The curvature at the optimum is local; a profile follows the likelihood as far as it matters (Raue et al. 2009; Wieland et al. 2021).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from scipy.stats import chi2

from hystfit.config import verb
from hystfit.errors import ParameterError
from hystfit.fitting.judgment.covariance import error_ratios
from hystfit.fitting.noise_refinement import refine_moving
from hystfit.inference.bounded_newton import BoundedNewton, Point
from hystfit.inference.fittable import check_smooth
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.registry import NOISES
from hystfit.inference.noise.white import White
from hystfit.inference.problem import Problem
from hystfit.inference.whitened import Whitened
from hystfit.outcome import Code, Note, Status, WithStatus
from hystfit.outcome.note import has, warn
from hystfit.outcome.table import rounded
from hystfit.outcome.wrapping import listed
from hystfit.params.coordinates import BOTH, LOWER, UPPER
from hystfit.params.units import axis_label
from hystfit.results.estimates import differences
from hystfit.results.labels import use_available_fonts
from hystfit.results.result import FitResult
from hystfit.uncertainty.profile_paths import LowerOptimum, Path, Walk


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

    @property
    def limits(self) -> str:
        """The confidence limits with their unit, and which sides have none."""
        lower, upper = (
            None if end is None else f"{self._words(end)} {self.unit}".rstrip() for end in (self.lower, self.upper)
        )
        if self.lower is not None and upper is not None:
            return f"{self._words(self.lower)} to {upper}"
        if lower is not None:
            return f"at least {lower}, no upper limit (up to {self.open_upper})"
        if upper is not None:
            return f"at most {upper}, no lower limit (down to {self.open_lower})"
        return "not bounded by the data on either side"

    def _words(self, value: float) -> str:
        """A value with the digits that the width of the interval leaves; five where there is no interval."""
        if self.lower is None or self.upper is None:
            return f"{value:.5g}"
        return rounded(value, (self.upper - self.lower) / 4)[0]

    def __str__(self) -> str:
        return f"{self.name} = {self._words(self.value)} {self.unit}".rstrip() + f": {self.limits}"

    __repr__ = __str__


@dataclasses.dataclass(frozen=True)
class Profiles(WithStatus):
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
    verb: ClassVar[str] = "profile"

    @property
    def status(self) -> Status:
        """`Status.OK` where every profile has both limits, else `Status.OPEN`."""
        return Status.OK if all(profile.closed for profile in self.profiles.values()) else Status.OPEN

    def __getitem__(self, name: str) -> Profile:
        return self.profiles[name]

    def __str__(self) -> str:
        lines = [f"{self.result.name}: {100 * self.level:.0f} % limits by profile likelihood, noise {self.noise}"]
        return "\n".join(lines + [str(p) for p in self.profiles.values()] + [f"note: {note}" for note in self.notes])

    __repr__ = __str__

    def to_dict(self) -> dict[str, Any]:
        rows = {}
        for name, p in self.profiles.items():
            rows[name] = {k: getattr(p, k) for k in ("value", "unit", "lower", "upper", "open_lower", "open_upper")}
            rows[name] |= {"x": p.x.tolist(), "statistic": p.statistic.tolist()}
        return {
            "schema": "hystfit.profile/1",
            "model": self.result.name,
            "status": str(self.status),
            "notes": [note.to_dict() for note in self.notes],
            "level": self.level,
            "noise": self.noise,
            "profiles": rows,
            "provenance": self.result.provenance,
        }

    def plot(self) -> Any:
        """One panel per parameter, with its limits and the quadratic that its standard error implies; returns the matplotlib figure."""
        import matplotlib.pyplot as plt

        columns = min(3, len(self.profiles))
        rows = -(-len(self.profiles) // columns)
        figure, axes = plt.subplots(
            rows, columns, figsize=(3.2 * columns, 2.6 * rows), layout="constrained", squeeze=False
        )
        for ax in axes.ravel()[len(self.profiles) :]:
            ax.axis("off")
        for ax, p in zip(axes.ravel(), self.profiles.values(), strict=False):
            ax.plot(p.x, p.statistic, ".-", color="#0072b2", label="profile")
            ax.axhline(chi2.ppf(self.level, 1), color="#a6a6a6", lw=0.8, label=f"{100 * self.level:.0f} %")
            error = self.result[p.name].stderr
            if error:
                along = np.linspace(p.x[0], p.x[-1], 200)
                ax.plot(along, ((along - p.value) / error) ** 2, "--", lw=0.9, color="#d55e00", label="quadratic")
            for limit in (p.lower, p.upper):
                if limit is not None:
                    ax.axvline(limit, color="#009e73", lw=0.9, label="limits" if limit == p.lower else None)
            if not p.closed:
                sides = {"lower": p.open_lower, "upper": p.open_upper}
                ax.set_title(" and ".join(f"no {side} limit" for side, end in sides.items() if end), fontsize=8)
            ax.locator_params(axis="x", nbins=4)
            ax.set(xlabel=axis_label(p.name, p.unit), ylim=(0, 2.5 * chi2.ppf(self.level, 1)))
        for row in axes:
            row[0].set_ylabel("-2 delta log-likelihood", fontsize=8)
        entries = [ax.get_legend_handles_labels() for ax in axes.ravel()]
        lines = {label: line for pair in entries for line, label in zip(*pair, strict=True)}  # one of each label
        figure.legend(lines.values(), lines.keys(), fontsize=8, frameon=False, ncols=4, loc="outside upper center")
        use_available_fonts(figure)
        return figure


@verb
def profile(
    result: FitResult,
    names: str | Sequence[str] | None = None,
    *,
    noise: str | type[AbstractNoise] = "auto",
    level: float = 0.95,
) -> Profiles:
    """Profile likelihoods of a fit's parameters: at each point all other parameters are refitted within their bounds.

    Args:
        result: the fit.
        names: parameters, or arrays of them ("w" for all its weights); by default all free ones but weights.
        noise: "auto" uses the noise of the fit: its noise model if it had one, else the sum of squares, which for autocorrelated
            residuals is divided by the square of each parameter's reported over its i.i.d. standard error (Kent 1982); or a noise
            model, whose values are those at the optimum.
        level: of the limits, by chi squared with one degree of freedom.

    Raises:
        ParameterError: an unknown name, level or noise model.
    """
    if not 0 < level < 1:
        raise ParameterError(f"level must lie between 0 and 1, got {level}")
    problem = result.problem.with_loss("linear")
    check_smooth(problem.space, "a profile")
    chosen, notes = _chosen(problem, names)
    sides = problem.at_bound(result.x)
    moving = np.array([side is None for side in sides])
    described, x, whitened, wider = _whitened(result, problem, result.x, moving, noise)
    limit = float(chi2.ppf(level, 1))
    newton = BoundedNewton(problem, whitened, x)
    optimum, paths = _follow(newton, x, chosen, wider, limit)
    profiles: dict[str, Profile] = {}
    for k, pair in zip(chosen, paths, strict=True):
        curve = _collect(newton, optimum, int(k), pair, limit)
        profiles[curve.name] = curve
        for bound in (curve.open_lower, curve.open_upper):
            if bound:
                text = f"the data do not bound {curve.name} towards {bound}: a symmetric error bar is meaningless"
                notes.append(warn(Code.OPEN_SIDE, text))
    notes += [
        warn(Code.AT_BOUND, f"{name} is at its {side} bound in the fit")
        for name, side in zip(problem.space.names, sides, strict=True)
        if side and name in profiles
    ]
    notes += _other_optimum(result, profiles)
    halves = {
        name: (p.upper - p.lower) / (2 * np.sqrt(limit)) if p.lower is not None and p.upper is not None else None
        for name, p in profiles.items()
    }
    notes += differences(result.parameters, halves, "half the distance between the limits", _reason(result, noise))
    return Profiles(result, profiles, level, described, tuple(notes))


def _reason(result: FitResult, noise: str | type[AbstractNoise]) -> str:
    """Why limits differ from the standard errors of the fit."""
    if has(result.notes, Code.REGULARIZED):
        return "the fit includes the regularization, the profile does not"
    if noise in ("auto", result.noise.name):
        return "the likelihood is not symmetric about its maximum, which a single standard error cannot express"
    return f"the profile assumes noise {NOISES.label(noise)}, the fit {result.noise.name}"


def _chosen(problem: Problem, names: str | Sequence[str] | None) -> tuple[list[int], list[Note]]:
    """Positions of the parameters to profile, and a note where weights are left out."""
    space, weights = problem.space, problem.space.weights
    if not names:
        chosen = np.flatnonzero(~weights) if not weights.all() else np.arange(len(space))
        arrays = sorted({name.partition("[")[0] for name, on in zip(space.names, weights, strict=True) if on})
        if chosen.size == len(space):
            return list(map(int, chosen)), []
        first = next(name for name, on in zip(space.names, weights, strict=True) if on)
        text = (
            f"{int(weights.sum())} weights are not profiled unless they are chosen by name: {arrays[0]} for all of an array, "
            f"{first} for one"
        )
        return list(map(int, chosen)), [Note(Code.CHOICE, text)]
    return space.positions(names), []


def _follow(
    newton: BoundedNewton, x: np.ndarray, chosen: Sequence[int], wider: np.ndarray, limit: float
) -> tuple[Point, list[tuple[Path, Path]]]:
    """The optimum, and the paths downward and upward in each parameter; from the start again where a path finds a better optimum."""
    start = newton.coordinates(x)
    everything = np.ones(x.size, dtype=bool)
    optimum = newton.best([start], everything)
    while True:
        try:
            walks = [Walk(newton, optimum, k, float(wider[k]), limit) for k in chosen]
            return optimum, [(walk.follow(-1), walk.follow(1)) for walk in walks]
        except LowerOptimum as found:
            optimum = newton.best([found.point.v], everything)


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
    where = "without the regularization of the fit" if has(result.notes, Code.REGULARIZED) else "in a flat valley"
    text = f"the likelihood has its maximum elsewhere, {where}: {listed(moved)}"
    return [warn(Code.OTHER_OPTIMUM, text)]


def _whitened(
    result: FitResult, problem: Problem, x: np.ndarray, moving: np.ndarray, noise: str | type[AbstractNoise]
) -> tuple[str, np.ndarray, Whitened, np.ndarray]:
    """(noise as text, optimum, the whitened problem, reported over i.i.d. standard errors), by which profiles are drawn."""
    choice = result.noise.name if noise == "auto" else noise
    if choice not in ("auto", "iid"):
        if not NOISES.find(choice).gaussian:  # type: ignore[attr-defined]
            raise ParameterError("profiles need Gaussian noise: use noise='ou', or sample the posterior")
        refined = refine_moving(problem, x, choice, moving)
        return NOISES.label(choice), refined.x, problem.whitened(refined.noise), np.ones(x.size)
    r = problem.residuals(x) * np.sqrt(np.asarray(problem.objective.batch.weight))
    used = problem.used
    wider = error_ratios(problem, x) if choice == "auto" else np.ones(x.size)
    sd = float(np.sqrt(np.sum(r[used] ** 2) / max(int(used.sum()) - int(moving.sum()), 1)))
    text = "independent"
    if np.any(wider != 1):
        factors = dict.fromkeys(f"{factor:.3g}" for factor in (wider.min(), wider.max()))
        text = f"independent, intervals widened {' to '.join(factors)} times for autocorrelated residuals"
    return text, x, problem.whitened(White(noise_white=sd)), wider


def _collect(newton: BoundedNewton, optimum: Point, k: int, paths: tuple[Path, Path], limit: float) -> Profile:
    """A profile from the paths down and up in the coordinate of parameter k."""
    space, start = newton.problem.space, float(optimum.v[k])
    c = space.coordinates

    def physical(value: float) -> float:
        v = optimum.v.copy()
        v[k] = value
        return float(newton.physical(v)[k])

    kind, lower, upper = c.kinds[k], float(c.lower[k]), float(c.upper[k])
    if kind == UPPER and not newton.linear[k]:  # with an upper bound alone, x falls as z rises
        paths = (paths[1], paths[0])
    down, up = paths
    crossings = [path.crossing(start, limit) for path in paths]
    ends = [None if at is None else physical(at) for at in crossings]
    bounds = [
        f"its bound {lower:g}" if kind in (LOWER, BOTH) else "-infinity",
        f"its bound {upper:g}" if kind in (UPPER, BOTH) else "+infinity",
    ]
    open_to = [None if end is not None else bound for end, bound in zip(ends, bounds, strict=True)]
    return Profile(
        name=space.names[k],
        unit=space.units[k],
        value=physical(start),
        x=np.array([physical(v) for v in (*down.v[::-1], start, *up.v)]),
        statistic=np.concatenate([down.statistic[::-1], [0.0], up.statistic]),
        lower=ends[0],
        upper=ends[1],
        open_lower=open_to[0],
        open_upper=open_to[1],
    )
