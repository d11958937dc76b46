"""C code of a model and its inverse: one C99 file with fixed memory, for the board that drives the actuator."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from hystfit.control.online_inverse import InverseStep, Limits
from hystfit.control.preisach_inverse import PreisachStep
from hystfit.control.step_inverse import SearchStep
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.bouc_wen import BoucWen
from hystfit.models.bouc_wen_asymmetric import AsymmetricBoucWen
from hystfit.models.compose import Offset, Series, Sum
from hystfit.models.creep import LogCreep
from hystfit.models.duhem import _LONG, _NODES, _WEIGHTS, Duhem
from hystfit.models.polynomial import derivative_matrix
from hystfit.models.prandtl_ishlinskii import PrandtlIshlinskii
from hystfit.models.preisach.model import Preisach
from hystfit.models.registry import model_name
from hystfit.models.relaxation import Relaxation

if TYPE_CHECKING:
    from hystfit.results.result import FitResult

_FOLDER = Path(__file__).with_name("c")


@dataclasses.dataclass
class _Part:
    """What the C code of one model needs: its template, numbers (macros, in capitals), arrays, and the size of its state."""

    template: str
    states: int
    numbers: dict[str, Any]
    arrays: dict[str, Any] = dataclasses.field(default_factory=dict)


def export_c(
    model: AbstractHysteresis | FitResult, folder: str | Path, *, name: str = "hysteresis", limits: Limits | None = None
) -> tuple[Path, ...]:
    """Write a model and its inverse as C99: `name`.h, `name`.c and `name`_main.c, a test harness.

    No allocation, no library beyond math.h, fixed memory; one call a sample: `name`_step(&h, u, dt) forward, `name`_inverse(&h, y, dt, &u)
    inverse. Same numbers as `simulate` and `InverseStep`.

    Args:
        model: `BoucWen`, `AsymmetricBoucWen`, `Duhem`, `PrandtlIshlinskii`, `Preisach` with cells, alone or in a `Series` or
            `Sum` with `LogCreep`, `Relaxation` and `Offset`; or a fit of one.
        folder: made where it does not exist.
        name: prefix of files and functions, a C identifier.
        limits: between which the inverse holds its input, as `InverseStep.of`.

    Returns:
        The three files.

    Raises:
        ModelError: a model without C code, or a name that is no C identifier.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ModelError(f"name must be a C identifier in lower case, got {name!r}")
    own = model if isinstance(model, AbstractHysteresis) else model.model
    blocks: list[str] = []
    root, states = _emit(own, f"{name}_model", blocks)
    inverse = InverseStep.of(model, limits=limits)
    low, high = float(inverse.low), float(inverse.high)
    words = {
        "name": name,
        "NAME": name.upper(),
        "root": root,
        "states": str(states),
        "low": _number(low),
        "high": _number(high),
        "title": f"{model_name(own)}: forward model and inverse.",
        "version": importlib.metadata.version("hystfit"),
        "u_unit": _unit(model, "u"),
        "y_unit": _unit(model, "y"),
    }
    sign = inverse.solver.sign if isinstance(inverse.solver, SearchStep) else 1.0
    scale = high - low if np.isfinite([low, high]).all() else 1.0
    constants = {"SIGN": sign, "SCALE": scale, "TOLERANCE": float(inverse.tolerance), "GIVEN": int(inverse.given)}
    head = f'#include <float.h>\n#include <math.h>\n\n#include "{name}.h"\n\n'
    head += "".join(f"#define {name.upper()}_{key} {_number(value)}\n" for key, value in constants.items())
    body = "\n".join(blocks)
    if "legendre(" in body:
        body = (_FOLDER / "legendre.c").read_text(encoding="utf-8") + "\n" + body
    code = f"{head}\n{body}\n{_fill('api.c', words)}"
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    files = {f"{name}.h": _fill("header.h", words), f"{name}.c": code, f"{name}_main.c": _fill("harness.c", words)}
    for file, text in files.items():
        (out / file).write_text(text, encoding="utf-8")
    return tuple(out / file for file in files)


def _unit(model: Any, which: str) -> str:
    data = getattr(model, "data", None)
    unit = getattr(next(iter(data)), f"{which}_unit", "") if data is not None else ""
    return unit or f"the model's {'input' if which == 'u' else 'output'} unit"


def _fill(template: str, words: dict[str, str]) -> str:
    text = (_FOLDER / template).read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: words[match[1]], text)


def _number(value: Any) -> str:
    """A C constant with all digits."""
    if isinstance(value, (bool, int, np.integer)):
        return str(int(value))
    value = float(value)
    if np.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    text = f"{value:.17g}"
    text = text if re.search(r"[.e]", text) else text + ".0"
    return f"({text})" if value < 0 else text


def _emit(model: AbstractHysteresis, prefix: str, blocks: list[str]) -> tuple[str, int]:
    """Append the C code of a model and its parts; the prefix of its functions and the size of its state."""
    if isinstance(model, (Series, Sum)):
        return _emit_composition(model, prefix, blocks)
    part = next((make(model) for kind, make in _PARTS.items() if isinstance(model, kind)), None)
    if part is None:
        raise ModelError(
            f"{type(model).__name__} has no C code; these have: {', '.join(kind.__name__ for kind in _PARTS)} (Preisach with cells), "
            "alone or in Series and Sum"
        )
    words = {"f": prefix, "M": prefix.upper()}
    lines = [
        f"#define {words['M']}_{key} {value if isinstance(value, str) else _number(value)}"
        for key, value in part.numbers.items()
    ]
    if any(key.startswith("OTHER") for key in part.numbers):
        lines = [line.replace("_OTHER ", "_OTHER(e) ") for line in lines]
    for key, values in part.arrays.items():
        flat = np.ravel(np.asarray(values))
        kind = "int" if np.issubdtype(flat.dtype, np.integer) else "double"
        rows = [", ".join(_number(x) for x in flat[k : k + 4]) for k in range(0, flat.size, 4)]
        lines.append(f"static const {kind} {prefix}_{key}[{flat.size}] = {{\n    " + ",\n    ".join(rows) + "};")
    blocks.append("\n".join(lines) + "\n\n" + _fill(part.template, words))
    return prefix, part.states


def _emit_composition(model: Series | Sum, prefix: str, blocks: list[str]) -> tuple[str, int]:
    found = [_emit(part, f"{prefix}{k}", blocks) for k, part in enumerate(model.parts)]
    offsets = np.cumsum([0, *(states for _, states in found)])
    total = int(offsets[-1])
    chain = isinstance(model, Series)
    init, step = "", ""
    for k, (own, _) in enumerate(found):
        at = int(offsets[k])
        init += f"    {own}_init(s + {at}, signal);\n"
        after = f"next ? next + {at} : 0"
        if not chain:
            step += f"    y += {own}_step(s + {at}, before, signal, dt, {after});\n"
            continue
        step += f"    y = {own}_step(s + {at}, before, signal, dt, {after});\n"
        if k < len(found) - 1:
            init += f"    signal = {own}_step(s + {at}, signal, signal, 0.0, 0);\n    s[{total + k}] = signal;\n"
            step += (
                f"    before = s[{total + k}];\n    signal = y;\n    if (next)\n        next[{total + k}] = signal;\n"
            )
    doc = "Each output is the next one's input." if chain else "Outputs add up."
    blocks.append(_fill("series.c", {"f": prefix, "doc": doc, "init": init, "step": step}))
    return prefix, total + (len(found) - 1 if chain else 0)


def _bouc_wen(model: BoucWen) -> _Part:
    names = {"C": model.c, "MU": model.mu, "TAU": model.tau, "RHO": model.rho, "OFFSET": model.offset}
    names["H0"] = model.init(jnp.zeros(()))[0]
    return _Part("bouc_wen.c", 1, {**names, "EXACT": int(model.scheme == "exact")})


def _asymmetric_bouc_wen(model: AsymmetricBoucWen) -> _Part:
    names = ("c", "mu", "tau", "rho", "n", "skew", "offset", "center", "half")
    numbers = {name.upper(): getattr(model, name) for name in names} | {"H0": model.init(jnp.zeros(()))[0]}
    numbers |= {"B": int(model.b.shape[0]) + 2, "EXACT": int(model.scheme == "exact")}
    return _Part("bouc_wen_asymmetric.c", 1, numbers, {"b": np.append([0.0, 0.0], np.asarray(model.b))})


def _log_creep(model: LogCreep) -> _Part:
    modes = int(model.tau.shape[0])
    numbers = {"SPAN": model.span, "BASE": model.base, "MODES": modes, "DEGREE": int(model.gamma.shape[0]) - 1}
    return _Part("log_creep.c", modes, numbers, {"gamma": model.gamma, "weights": model.weights, "tau": model.tau})


def _relaxation(model: Relaxation) -> _Part:
    modes = int(model.tau.shape[0])
    return _Part("relaxation.c", modes, {"MODES": modes}, {"a": model.a, "tau": model.tau})


def _duhem(model: Duhem) -> _Part:
    m, n = int(model.f.shape[0]), int(model.g.shape[0])
    size = max(m, n)
    numbers = {
        "ALPHA": model.alpha,
        "W0": model.w0,
        "CENTER": model.center,
        "HALF": model.half,
        "F": m,
        "G": n,
        "EXACT": int(model.scheme == "exact"),
    }
    arrays = {"f": model.f, "g": model.g}
    if model.scheme == "exact":
        numbers |= {"SIZE": size, "LONG": _LONG, "NODES": len(_NODES)}
        padded = [np.pad(np.asarray(c), (0, size - c.shape[0])) for c in (model.f, model.g)]
        slope = derivative_matrix(size) / float(model.half)
        arrays |= {
            "f_padded": padded[0],
            "g_padded": padded[1],
            "derivative": slope,
            "nodes": _NODES,
            "weights": _WEIGHTS,
        }
    else:
        numbers["EXPLICIT"] = int(model.scheme == "explicit")
    return _Part("duhem.c", 1, numbers, arrays)


def _prandtl_ishlinskii(model: PrandtlIshlinskii) -> _Part:
    kinds = [("identity", "square", "mirror").index(kind) for kind in model.envelopes]
    count, plays = model.w.shape
    hardens = int(bool(model.hardening.size))
    numbers = {
        "OFFSET": model.offset,
        "LOW": model.low,
        "HIGH": model.high,
        "LEVEL": model.level,
        "FIRST": int(model.rest == "first"),
        "STOPS": int(model.operator == "stop"),
        "ENVELOPES": int(count),
        "PLAYS": int(plays),
        "B": int(model.b.shape[0]) + 1,
        "HARDENS": hardens,
    }
    arrays = {"w": model.w, "r": model.r, "b": np.append(0.0, np.asarray(model.b)), "kinds": np.array(kinds)}
    if hardens:
        numbers["S0"] = model.s0
        arrays["hardening"] = model.hardening
    return _Part("prandtl_ishlinskii.c", int(count * plays) + hardens, numbers, arrays)


def _preisach(model: Preisach) -> _Part:
    if model.elements != "cells":
        raise ModelError(
            "point relays have no continuous inverse and no C code: fit Preisach with cells (--model preisach, or elements='cells')"
        )
    solver = PreisachStep.of(model)
    knots = np.asarray(solver.knots)
    center = float(model.center)
    other = {"demagnetized": f"(2 * {_number(center)} - (e))", "negative": "(-INFINITY)", "positive": "INFINITY"}
    numbers = {
        "LEVELS": int(model.levels.shape[0]),
        "KNOTS": knots.size,
        "DEPTH": model.depth,
        "REST": solver.memory.rest,
        "OFFSET": model.offset,
        "CENTER": center,
        "HALF": model.half,
        "B": int(model.b.shape[0]) + 1,
        "OTHER": other[model.initial],
    }
    everett = solver.memory.everett
    straight = solver.straight if model.slopes.size else np.zeros(knots.size)
    arrays = {
        "levels": model.levels,
        "off": everett.off,
        "diagonal": everett.diagonal,
        "sums": everett.sums,
        "knots": knots,
        "first": solver.excursion,
        "straight": straight,
        "b": np.append(0.0, np.asarray(model.b)),
    }
    return _Part("preisach.c", 1 + 2 * model.depth, numbers, arrays)


_PARTS: dict[type[AbstractHysteresis], Callable[[Any], _Part]] = {
    BoucWen: _bouc_wen,
    AsymmetricBoucWen: _asymmetric_bouc_wen,
    Duhem: _duhem,
    PrandtlIshlinskii: _prandtl_ishlinskii,
    Preisach: _preisach,
    LogCreep: _log_creep,
    Relaxation: _relaxation,
    Offset: lambda model: _Part("offset.c", 0, {"VALUE": model.value}),
}
