"""C code of a model and its inverse: one C99 file with fixed memory, for the board that drives the actuator."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hystfit.config import verb
from hystfit.control.online_inverse import InverseStep, Limits
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import model_name
from hystfit.models.shared.c_code import CPart, template
from hystfit.version import __version__

if TYPE_CHECKING:
    from hystfit.results.result import FitResult

_FOLDER = files("hystfit.control") / "c"


@verb
def export_c(
    model: AbstractHysteresis | FitResult,
    folder: str | Path,
    *,
    name: str = "hysteresis",
    limits: Limits | None = None,
    s_function: bool = False,
) -> tuple[Path, ...]:
    """Write a model and its inverse as C99: `name`.h, `name`.c and `name`_main.c, a test harness.

    No allocation, no library beyond math.h, fixed memory; one call a sample: `name`_step(&h, u, dt) forward, `name`_inverse(&h, y, dt, &u)
    inverse. Same numbers as `simulate` and `InverseStep`. A model without a causal inverse (a resonance, a delay) is exported forward only.

    Args:
        model: a model that has C code (method `c_part`), or a fit of one.
        folder: made where it does not exist.
        name: prefix of files and functions, a C identifier.
        limits: between which the inverse holds its input; None for the range of the fitted input, as `InverseStep.of`.
        s_function: also write `name`_sfun.c, a level-2 C MEX S-function of the forward model for Simulink.

    Returns:
        The files.

    Raises:
        ModelError: a model without C code, or a name that is not a C identifier.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ModelError(f"name must be a C identifier in lower case, got {name!r}")
    exported = model if isinstance(model, AbstractHysteresis) else model.device
    part = exported.c_part()
    blocks: list[str] = []
    _emit(part, f"{name}_model", blocks)
    body = "\n".join(blocks)
    if "legendre(" in body:
        body = template("legendre.c") + "\n" + body
    inverse, obstacle = _inverse_of(model, exported, limits)
    low, high = (-np.inf, np.inf) if inverse is None else (float(inverse.low), float(inverse.high))
    words = {
        "name": name,
        "NAME": name.upper(),
        "root": f"{name}_model",
        "states": str(part.states),
        "low": _number(low),
        "high": _number(high),
        "limits": _limits_words(model, limits, low),
        "invertible": str(int(inverse is not None)),
        "obstacle": obstacle and f"\n * No inverse: {obstacle}.\n *",
        "title": f"{model_name(exported)}: forward model{'' if inverse is None else ' and inverse'}.",
        "version": __version__,
        "u_unit": _unit(model, "u"),
        "y_unit": _unit(model, "y"),
    }
    head = f'#include <float.h>\n#include <math.h>\n\n#include "{name}.h"\n\n' + _constants(inverse, name, low, high)
    filled = lambda file: _fill((_FOLDER / file).read_text(encoding="utf-8"), words)
    texts = {f"{name}.h": filled("header.h"), f"{name}.c": f"{head}\n{body}\n{filled('api.c')}"}
    texts[f"{name}_main.c"] = filled("harness.c")
    if s_function:
        texts[f"{name}_sfun.c"] = filled("s_function.c")
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (out / file).write_text(text, encoding="utf-8")
    return tuple(out / file for file in texts)


def _inverse_of(
    model: AbstractHysteresis | FitResult, exported: AbstractHysteresis, limits: Limits | None
) -> tuple[InverseStep | None, str]:
    """The inverse, or None and the reason for which a model with a resonance or a delay has none."""
    try:
        return InverseStep.of(model, limits=limits), ""
    except ModelError as error:
        if exported.output_resonance() is None and exported.obstacle("inverse") is None:
            raise
        return None, str(error)


def _constants(inverse: InverseStep | None, name: str, low: float, high: float) -> str:
    """Definitions of the constants of an inverse between limits."""
    if inverse is None:
        return ""
    scale = high - low if np.isfinite([low, high]).all() else 1.0
    constants = {"SIGN": inverse.solver.sign, "SCALE": scale, "TOLERANCE": float(inverse.tolerance)}
    constants["GIVEN"] = int(inverse.given)
    return "".join(f"#define {name.upper()}_{key} {_number(value)}\n" for key, value in constants.items())


def _unit(model: Any, which: str) -> str:
    data = getattr(model, "data", None)
    unit = getattr(next(iter(data)), f"{which}_unit", "") if data is not None else ""
    return unit or f"the model's {'input' if which == 'u' else 'output'} unit"


def _limits_words(model: Any, limits: Limits | None, low: float) -> str:
    """Where the limits of the inverse come from."""
    if limits is not None:
        return "the limits given"
    if not np.isfinite(low):
        return "no limits"
    return "the range of the model" if isinstance(model, AbstractHysteresis) else "the range of the fitted input"


def _fill(text: str, words: dict[str, str]) -> str:
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


def _emit(part: CPart, prefix: str, blocks: list[str]) -> None:
    """Append the C code of a model, its parts first."""
    for k, inner in enumerate(part.parts):
        _emit(inner, f"{prefix}{k}", blocks)
    lines = [
        f"#define {prefix.upper()}_{key} {value if isinstance(value, str) else _number(value)}"
        for key, value in part.numbers.items()
    ]
    for key, values in part.arrays.items():
        flat = np.ravel(np.asarray(values))
        kind = "int" if np.issubdtype(flat.dtype, np.integer) else "double"
        rows = [", ".join(_number(x) for x in flat[k : k + 4]) for k in range(0, flat.size, 4)]
        lines.append(f"static const {kind} {prefix}_{key}[{flat.size}] = {{\n    " + ",\n    ".join(rows) + "};")
    blocks.append("\n".join(lines) + "\n\n" + _fill(part.template, {"f": prefix, "M": prefix.upper()}))
