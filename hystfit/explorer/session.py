"""The session behind a page: models with sliders, their loops at the values of these, and fits that start there."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from hystfit.config import require_x64
from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import HystfitError, ParameterError
from hystfit.fitting.comparison.candidates import candidates
from hystfit.fitting.fit import fit
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import MODELS, make_model
from hystfit.models.shared.starting import scales_of
from hystfit.params.param import leaves_of, short_names
from hystfit.params.space import ParameterSpace
from hystfit.results.accuracy import Metrics
from hystfit.results.result import FitResult

_MANY = 32  # weights that still have sliders
_REACH = 10.0  # factor to either side of a logarithmic slider


@dataclasses.dataclass(frozen=True)
class Slider:
    """A parameter that the user moves from `low` to `high`; other values within its bounds `lower` and `upper` can be typed.

    On a `logarithmic` one equal distances are equal factors; a fit changes those that are `fitted` unless the user says otherwise.
    """

    name: str
    unit: str
    doc: str
    value: float
    low: float
    high: float
    lower: float | None
    upper: float | None
    logarithmic: bool
    fitted: bool
    weight: bool


class View:
    """A model as the user chose it, on a record as it is fitted; free parameters without a slider, `hidden`, keep their values."""

    def __init__(self, choice: str, model: AbstractHysteresis, record: Record):
        self.choice, self.record = choice, record
        names = short_names([leaf.path for leaf in leaves_of(model)])
        self._space = ParameterSpace.of(model, free=names, scales=scales_of(Dataset.of(record)))
        self._x = self._space.vector(model)
        free = set(ParameterSpace.of(model).names)
        weights = self._space.weights if self._space.weights.sum() <= _MANY else None
        rows = range(len(self._space)) if weights is not None else np.flatnonzero(~self._space.weights).tolist()
        scalar = {name for name in self._space.names if "[" not in name}
        shown = [k for k in rows if self._space.names[k] in free | scalar]
        self._place = {self._space.names[k]: k for k in shown}
        self.sliders = tuple(self._slider(k, free) for k in shown)
        self.hidden = len(free - set(self._place))

    def _slider(self, k: int, free: set[str]) -> Slider:
        info, value, name = self._space.infos[k], float(self._x[k]), self._space.names[k]
        scale = float(np.asarray(self._space.coordinates.scale)[k])
        lower, upper = info.bounds
        logarithmic = bool(np.isfinite(lower) and np.isinf(upper) and value > lower == 0.0 and not info.linear)
        if logarithmic:
            low, high = value / _REACH, value * _REACH
        elif np.isfinite([lower, upper]).all():
            low, high = lower, upper
        else:
            reach = max(scale, abs(value))
            low, high = max(lower, value - reach), min(upper, value + reach)
        return Slider(
            name, self._space.units[k], info.doc, value, low, high,
            lower if np.isfinite(lower) else None, upper if np.isfinite(upper) else None,
            logarithmic, name in free, bool(self._space.weights[k]),
        )  # fmt: skip

    def model(self, values: Mapping[str, Any]) -> AbstractHysteresis:
        """The model at values of some sliders by name, the others as in the view; a ParameterError where it cannot have them."""
        x = self._x.copy()
        for name, value in self.checked(values).items():
            x[self._place[name]] = value
        return self._space.assembled(x)

    def checked(self, values: Mapping[str, Any]) -> dict[str, float]:
        """Values as numbers within their bounds."""
        for name, value in values.items():
            if name not in self._place:
                raise ParameterError(f"{self.choice} has no slider {name!r}")
            lower, upper = self._space.infos[self._place[name]].bounds
            number = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
            if not (number and lower <= value <= upper):
                raise ParameterError(f"{name} is a number in [{lower:g}, {upper:g}], got {value!r}")
        return {name: float(value) for name, value in values.items()}

    def to_dict(self) -> dict[str, Any]:
        """For the page."""
        sliders = [dataclasses.asdict(slider) for slider in self.sliders]
        return {"model": self.choice, "sliders": sliders, "hidden": self.hidden}


@dataclasses.dataclass(frozen=True)
class Source:
    """How the record is read again, at a shell (LOOP and options) and in Python (a line that makes `record`); empty where unknown."""

    shell: str = ""
    python: str = ""


@dataclasses.dataclass(frozen=True)
class Points:
    """Curves for a canvas, one after another, in single precision from an origin in double; `facts` are for JSON."""

    facts: dict[str, Any]
    numbers: Float[np.ndarray, " n"]


class Session:
    """A record, the models that the user has chosen for it, and the fit that runs; `values` are those of the sliders, as last drawn."""

    def __init__(
        self,
        record: Record,
        model: str = "auto",
        *,
        start: Mapping[str, float] | None = None,
        source: Source | None = None,
        translate: Callable[[str], str] = str,
    ):
        """Choose models for a record, and read starting values off it; "auto" takes that with the fewest parameters that suits the loop."""
        require_x64()
        self._translate = translate
        self.record, self._source = record, source or Source()
        self.result: FitResult | None = None
        suited = _suited(record)
        chosen = suited[0] if model == "auto" else model
        self.choices = tuple(dict.fromkeys([chosen, *suited]))
        self._dt = None if record.t is None else record.dt
        self._lock, self._fitting = threading.Lock(), threading.Lock()
        self._views: list[View] = []
        self._fit: dict[str, Any] = {"state": "none"}
        middle = lambda signal: float(0.5 * (np.nanmin(signal) + np.nanmax(signal)))
        self._origin = {"u": middle(record.u), "y": middle(record.y[record.used])}
        first = self.choose({"model": chosen})
        given = self._views[0].checked(start or {})
        self.values = {slider["name"]: slider["value"] for slider in first["sliders"]} | given
        self.model = self._views[0].model(self.values)
        self._first = {**first, "start": given}

    def scene(self) -> dict[str, Any]:
        """What the page shows at first."""
        record, axis = self.record, self._axis
        used = record.used
        return {
            "record": {
                "name": record.name,
                "samples": len(record),
                "u": [record.u_name, record.u_unit, float(record.u.min()), float(record.u.max())],
                "y": [record.y_name, record.y_unit, float(record.y[used].min()), float(record.y[used].max())],
                "x": ["sample", "", *axis[[0, -1]]] if record.t is None else ["time", record.t_unit, *axis[[0, -1]]],
                "origin": self._origin,
            },
            "source": dataclasses.asdict(self._source),
            "choices": self.choices,
            "view": self._first,
        }

    def choose(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """A model with starting values read off the record, as sliders."""
        name = request["model"]
        if name not in self.choices:  # a name may mean a file with code, so that only the user's own is taken
            raise ParameterError(f"no model {name!r} on this page: open it by --model")
        model = make_model(name)
        record = model.prepared(self.record)
        return self._added(View(name, model.starting_points([record])[0], record))

    def measured(self, request: Mapping[str, Any]) -> Points:
        """The measured curve between two samples, for a canvas of some columns: x, u, y."""
        part, starts = self._part(request)
        y = np.where(self.record.used, self.record.y, np.nan)[part]
        kept = visible(starts, self.record.u[part], y)
        return self._points(part, kept, [y[kept]], y, kept[:0])

    def predict(self, request: Mapping[str, Any]) -> Points:
        """The model's curve between two samples: x, u, y, the same at two other settings, and the residuals.

        A request has `view`, `values` by name, `band` (two sets of values that replace some, or nothing), and the part.
        """
        part, starts = self._part(request)
        view, values = self._view(request), request["values"]
        model = view.model(values)
        with self._lock:
            y = self._run(model)
            sides = [self._run(view.model(values | side))[part] for side in request.get("band") or ()]
            self.model, self.values = model, view.checked(values)
        used = view.record.used
        error = Metrics.of([self.record.y[used]], [y[used]]).to_dict()
        residuals = np.where(used, self.record.y - y, np.nan)[part]
        y = y[part]
        kept = visible(starts, self.record.u[part], y)
        points = self._points(part, kept, [side[kept] for side in (y, *sides)], residuals, visible(starts, residuals))
        return dataclasses.replace(points, facts=points.facts | {"error": error})

    def start_fit(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a fit in the background from `view`, `values` of the sliders and `fitted`, what it may change; `fit_state` follows it."""
        view = self._view(request)
        start, fitted = view.checked(request["values"]), set(request["fitted"])
        options = {
            "start": start,
            "starts": 1,
            "fix": [slider.name for slider in view.sliders if slider.fitted and slider.name not in fitted],
            "free": [slider.name for slider in view.sliders if not slider.fitted and slider.name in fitted],
        }
        if not self._fitting.acquire(blocking=False):
            raise ParameterError("a fit is running: wait until it has finished")
        self._fit = {"state": "running", "began": time.monotonic()}
        threading.Thread(target=self._fitted, args=(view.choice, options), daemon=True).start()
        return self.fit_state()

    def fit_state(self) -> dict[str, Any]:
        """Whether a fit runs, since how many seconds, and what the last one has found."""
        state = dict(self._fit)
        if began := state.pop("began", None):
            state["seconds"] = time.monotonic() - began
        return state

    @property
    def _axis(self) -> Float[np.ndarray, " T"]:
        """Abscissa of the curves over time: time, or sample numbers."""
        return np.arange(float(len(self.record))) if self.record.t is None else self.record.t

    def _view(self, request: Mapping[str, Any]) -> View:
        return self._views[int(request["view"])]

    def _added(self, view: View) -> dict[str, Any]:
        with self._lock:
            self._views.append(view)
            return {"view": len(self._views) - 1, **view.to_dict()}

    def _part(self, request: Mapping[str, Any]) -> tuple[slice, np.ndarray]:
        """The samples that are shown, at least two, and the first of each piece of them; `from` and `to` may be None."""
        axis, (low, high) = self._axis, (request["from"], request["to"])
        first = 0 if low is None else min(int(np.searchsorted(axis, float(low))), axis.size - 2)
        stop = axis.size if high is None else max(int(np.searchsorted(axis, float(high), "right")), first + 2)
        return slice(first, stop), chunks(stop - first, min(max(int(request["columns"]), 2), 8000))

    def _run(self, model: AbstractHysteresis) -> Float[np.ndarray, " T"]:
        return type(model).free_run(model, self.record.u, self._dt)

    def _points(
        self, part: slice, kept: np.ndarray, curves: list[np.ndarray], residuals: np.ndarray, of_residuals: np.ndarray
    ) -> Points:
        """Abscissa, input and curves at the samples kept, then abscissa and residuals at others."""
        axis, u = self._axis[part] - self._axis[part.start], self.record.u[part][kept] - self._origin["u"]
        curves = [curve - self._origin["y"] for curve in curves]
        with np.errstate(over="ignore"):  # an unstable model
            numbers = np.concatenate([axis[kept], u, *curves, axis[of_residuals], residuals[of_residuals]]).astype(
                "<f4"
            )
        facts = {"points": kept.size, "columns": of_residuals.size, "curves": len(curves)}
        return Points(facts | {"x": float(self._axis[part.start])}, numbers)

    def _fitted(self, choice: str, options: dict[str, Any]) -> None:
        try:
            result = fit(choice, self.record, **options)
            model = result.model
            found = self._added(View(choice, model, model.prepared(self.record)))
            self.result = result
            self._fit = {"state": "done", "result": _described(result, self._translate), "view": found, "from": options}
        except Exception as error:
            known = isinstance(error, HystfitError)
            self._fit = {
                "state": "failed",
                "error": self._translate(str(error)) if known else f"{type(error).__name__}: {error}",
            }
        finally:
            self._fitting.release()


def _described(result: FitResult, translate: Callable[[str], str]) -> dict[str, Any]:
    """The verdict on a fit, and its standard errors."""
    return {
        "model": result.name,
        "status": str(result.status),
        "usable": result.usable,
        "advice": translate(result.advice),
        "notes": [note.to_dict() | {"text": translate(note.text)} for note in result.notes],
        "stderr": {p.name: p.stderr for p in result.parameters if p.stderr is not None and np.isfinite(p.stderr)},
    }


def _suited(record: Record) -> list[str]:
    """Models that the page offers: those that a comparison iterates, by their number of parameters, then the others."""
    chosen = candidates(Dataset((record,)))
    count = lambda name: sum(leaf.size for leaf in leaves_of(make_model(name)) if not leaf.info.fixed)
    first = sorted(chosen.iterated, key=count)
    cores = [n for n, entry in MODELS.items() if entry.place == "core" and not make_model(n).from_saturation]
    names = dict.fromkeys([*first, *chosen.resonant, *cores])
    return [name for name in names if record.t is not None or make_model(name).rate_independent]


def chunks(samples: int, columns: int) -> Int[np.ndarray, " chunks"]:
    """First sample of each of at most `columns` pieces of equal length; a short record keeps every sample."""
    return np.arange(0, samples, 1 if samples <= 2 * columns else -(-samples // columns))


def visible(starts: Int[np.ndarray, " chunks"], *signals: Float[np.ndarray, " T"]) -> Int[np.ndarray, " kept"]:
    """Numbers of the samples to draw: first, last, lowest and highest of every signal in each piece; NaN is not drawn.

    A polyline through them covers the same pixels as one through all samples, whichever signal it is drawn over.
    """
    count = signals[0].size
    if starts.size == count:
        return np.arange(count)
    width = int(starts[1])
    kept = [starts, np.minimum(starts + width, count) - 1]
    for signal in signals:
        rows = np.pad(signal, (0, starts.size * width - count), mode="edge").reshape(-1, width)
        kept += [starts + np.where(np.isnan(rows), np.inf, rows * sign).argmin(axis=1) for sign in (1.0, -1.0)]
    return np.unique(np.minimum(np.concatenate(kept), count - 1))
