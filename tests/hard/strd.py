"""NIST's reference problems of nonlinear regression, each as a model of the user's own.

    python -m tests.hard.strd [NAME ...]

Data and certified values are those of the Statistical Reference Datasets of the National Institute of Standards and Technology
(www.itl.nist.gov/div898/strd), in the public domain; `nist/` holds the 26 files with one predictor as published.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hystfit as hf
from hystfit.models import AbstractHysteresis
from hystfit.results.result import FitResult

FOLDER = Path(__file__).with_name("nist")
DIGITS = 6.0  # of values, and of standard errors, that a usable fit must share with the certified ones
exp = jnp.exp


def _peaks(b: Any, x: Any) -> Any:
    return b[0] * exp(-b[1] * x) + b[2] * exp(-(((x - b[3]) / b[4]) ** 2)) + b[5] * exp(-(((x - b[6]) / b[7]) ** 2))


def _decays(b: Any, x: Any) -> Any:
    return b[0] * exp(-b[1] * x) + b[2] * exp(-b[3] * x) + b[4] * exp(-b[5] * x)


def _cubics(b: Any, x: Any) -> Any:
    return (b[0] + x * (b[1] + x * (b[2] + x * b[3]))) / (1 + x * (b[4] + x * (b[5] + x * b[6])))


def _waves(b: Any, x: Any) -> Any:
    wave = lambda one, other, period: one * jnp.cos(2 * jnp.pi * x / period) + other * jnp.sin(2 * jnp.pi * x / period)
    return b[0] + wave(b[1], b[2], 12.0) + wave(b[4], b[5], b[3]) + wave(b[7], b[8], b[6])


LAWS: dict[str, Callable[[Any, Any], Any]] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - exp(-b[1] * x)),
    "Chwirut1": lambda b, x: exp(-b[0] * x) / (b[1] + b[2] * x),
    "Chwirut2": lambda b, x: exp(-b[0] * x) / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": _waves,
    "Eckerle4": lambda b, x: b[0] / b[1] * exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": _peaks,
    "Gauss2": _peaks,
    "Gauss3": _peaks,
    "Hahn1": _cubics,
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos1": _decays,
    "Lanczos2": _decays,
    "Lanczos3": _decays,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * exp(-x * b[3]) + b[2] * exp(-x * b[4]),
    "Misra1a": lambda b, x: b[0] * (1 - exp(-b[1] * x)),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Rat42": lambda b, x: b[0] / (1 + exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - jnp.arctan(b[2] / (x - b[3])) / jnp.pi,
    "Thurber": _cubics,
}


class Curve(AbstractHysteresis):
    """A curve without memory, y = law(b, u); it needs no reversal of its input."""

    rate_independent: ClassVar[bool] = True
    from_saturation: ClassVar[bool] = True
    b: Float[Array, " p"] = hf.param(1.0, doc="coefficients")
    law: str = eqx.field(static=True, default="DanWood")

    def init(self, u0: Any) -> Any:
        """None: a state that nothing reads."""
        return jnp.reshape(0.0 * u0, (1,))

    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        """The value of the curve."""
        return state, LAWS[self.law](self.b, u1)


class Reference(NamedTuple):
    """A problem: data, two starts (2, p), certified values and standard errors, each (p,)."""

    x: np.ndarray
    y: np.ndarray
    starts: np.ndarray
    values: np.ndarray
    errors: np.ndarray


def reference_of(name: str) -> Reference:
    """Read a problem from its file."""
    text = (FOLDER / f"{name}.dat").read_text(encoding="ascii")
    rows = np.array([[float(v) for v in line.split()] for line in re.findall(r"^ +b\d+ *= *(.*)$", text, re.M)])
    data = np.array(
        [[float(v) for v in line.split()] for line in text.split("\nData:")[-1].splitlines()[1:] if line.strip()]
    )
    return Reference(data[:, 1], data[:, 0], rows[:, :2].T, rows[:, 2], rows[:, 3])


def digits(found: np.ndarray, certified: np.ndarray) -> float:
    """Correct significant digits of the worst of several numbers; 0 where one is missing, 11 (as certified) at most."""
    with np.errstate(divide="ignore"):
        return float(np.clip(-np.log10(np.nan_to_num(np.max(np.abs(found / certified - 1)), nan=1.0)), 0.0, 11.0))


def attempt(name: str, number: int, starts: int) -> FitResult:
    """Fit a problem from its first or second start (number 0 or 1), alone or with others about it."""
    problem = reference_of(name)
    model = Curve(b=problem.starts[number], law=name)
    record = hf.Record(u=problem.x, y=problem.y, name=name)
    return hf.fit(model, record, start="model", starts=starts, noise="iid")


def judged(name: str, number: int, starts: int) -> tuple[str, FitResult, float, float]:
    """`right` (usable, to `DIGITS`), `refused` (not usable) or `wrong`; the fit, and the digits of values and errors."""
    fit, certified = attempt(name, number, starts), reference_of(name)
    errors = np.array([np.nan if p.stderr is None else p.stderr for p in fit.parameters])
    of_values, of_errors = digits(fit.x, certified.values), digits(errors, certified.errors)
    if not fit.usable:
        return "refused", fit, of_values, of_errors
    return ("right" if of_values >= DIGITS and of_errors >= 3.0 else "wrong"), fit, of_values, of_errors


def main() -> int:
    """Fit every problem from both starts, alone and with seven others; 1 where a usable fit is wrong."""
    hf.enable_x64()
    wrong = 0
    for name in sys.argv[1:] or LAWS:
        for number, starts in ((0, 1), (1, 1), (0, 8), (1, 8)):
            outcome, fit, of_values, of_errors = judged(name, number, starts)
            wrong += outcome == "wrong"
            print(
                f"{name:9} start {number + 1}, of {starts}: {outcome:8} {fit.status.name:13} digits of values {of_values:5.1f}, of "
                f"errors {of_errors:5.1f}",
                flush=True,
            )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
