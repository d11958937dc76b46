"""One simulated piezo actuator with amplifier and sensor: hysteresis, creep, limits and noise.

The numbers of `piezo` are a calibrated surrogate of the Tokin AE0505D16 stack of Minase et al. (2010), whose identified
parameters were not published: 13 um over -20..100 V, a loop 2.4 um wide at 40 V, 0.0175 creep per decade.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.models import AbstractHysteresis, BoucWen, LogCreep, Series, simulate
from hystfit.models.shared.simulation import check_one_device
from hystfit.outcome import Code
from hystfit.params.space import ParameterSpace
from hystfit.stage.population import Population, single_models


def piezo(
    *,
    c: float = 0.1542,
    mu: float = 0.45,
    tau: float = 0.01086,
    delta: float = 0.00956,
    gamma: float | tuple[float, ...] = 0.0175,
    span: float = 12.0,
    longest: float | None = None,
) -> Series:
    """Surrogate of one AE0505D16 stack: exact Bouc-Wen hysteresis followed by logarithmic creep.

    Args:
        c: displacement per voltage without hysteresis [um/V].
        mu: relative reduction of the slope at a reversal.
        tau: rate of saturation of the hysteresis [1/V].
        delta: shape of the tips of the loop [1/V], |delta| < tau.
        gamma: creep per decade of time; several numbers are coefficients of a polynomial in displacement / span.
        span: unit of the displacement in the polynomial [um].
        longest: time after a step up to which the creep is logarithmic [s]; 1000 s if None.

    Raises:
        ParameterError: a number outside its bounds.
    """
    coefficients = gamma if isinstance(gamma, tuple) else (gamma,)
    creep = (
        LogCreep(gamma=coefficients, span=span)
        if longest is None
        else LogCreep.spanning(0.1, longest, gamma=coefficients, span=span)
    )
    if not tau > 0:
        raise ParameterError(f"tau must be positive, got {tau}")
    model = Series(BoucWen(c=c, mu=mu, tau=tau, rho=delta / tau, scheme="exact"), creep)
    ParameterSpace.of(model)  # raises outside the bounds
    return model


def perturbed(actuator: Series, **factors: float) -> Series:
    """The actuator with its parameters c, mu, tau, delta and gamma multiplied by factors.

    Raises:
        ParameterError: an unknown name, or a value outside its bounds.
    """
    known = ("c", "mu", "tau", "delta", "gamma")
    unknown = [name for name in factors if name not in known]
    if unknown:
        raise ParameterError(f"no parameter {unknown[0]!r} to perturb; there are {', '.join(known)}")
    factor = lambda name: factors.get(name, 1.0)
    hysteresis, creep, *rest = (cast(Any, part) for part in actuator.parts)
    hysteresis = dataclasses.replace(
        hysteresis,
        c=hysteresis.c * factor("c"),
        mu=hysteresis.mu * factor("mu"),
        tau=hysteresis.tau * factor("tau"),
        rho=hysteresis.rho * factor("delta") / factor("tau"),
    )
    scaled = Series(hysteresis, dataclasses.replace(creep, gamma=creep.gamma * factor("gamma")), *rest)
    ParameterSpace.of(scaled)  # raises outside the bounds
    return scaled


@dataclasses.dataclass(frozen=True)
class Amplifier:
    """Voltage limits [V] of the driving amplifier (PI LVPZT).

    Raises:
        ParameterError: low is not below high.
    """

    low: float = -20.0
    high: float = 120.0

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ParameterError(f"an amplifier needs low < high, got {self.low} and {self.high} V")

    def drive(self, u: Any) -> jax.Array:
        """The voltage that reaches the actuator."""
        return jnp.clip(u, self.low, self.high)


@dataclasses.dataclass(frozen=True)
class Sensor:
    """Standard deviation of white noise and resolution, both in the unit of the measured quantity; 0 is ideal.

    Raises:
        ParameterError: a negative number.
    """

    noise: float = 0.005
    resolution: float = 0.001

    def __post_init__(self) -> None:
        if not (self.noise >= 0 and self.resolution >= 0):
            raise ParameterError(f"noise and resolution must not be negative, got {self.noise} and {self.resolution}")

    def read(self, y: Any, rng: np.random.Generator) -> np.ndarray:
        """A noisy, rounded reading of y, any shape."""
        reading = np.asarray(y, dtype=float) + self.noise * rng.standard_normal(np.shape(y))
        return np.round(reading / self.resolution) * self.resolution if self.resolution > 0 else reading


@dataclasses.dataclass(frozen=True)
class Actuator:
    """A stack with amplifier and displacement sensor: a source of records.

    Attributes:
        model: voltage [V] to displacement [um]; any hystfit model.
        amplifier, sensor: before and after it.

    Raises:
        ParameterError: the model holds several devices.
    """

    model: AbstractHysteresis = dataclasses.field(default_factory=piezo)
    amplifier: Amplifier = Amplifier()
    sensor: Sensor = Sensor()

    def __post_init__(self) -> None:
        check_one_device(self.model)

    def population(self, count: int, *, spread: Mapping[str, float], seed: int) -> Population[Actuator]:
        """Actuators whose parameters scatter about those of this one; arguments and errors are those of `hystfit.stage.population`."""
        models, truth, units = single_models(self.model, count, spread=spread, seed=seed)
        return Population(tuple(dataclasses.replace(self, model=model) for model in models), truth, units)

    def displacement(self, t: Any, u: Any) -> np.ndarray:
        """Noise-free displacement [um] for commands u [V] at times t [s], shape (T,); at rest before the first.

        Raises:
            DataError: shapes differ, or times decrease.
        """
        t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
        if t.shape != u.shape or t.ndim != 1 or not (np.diff(t) >= 0).all():
            raise DataError(f"t and u must have one shape (T,), t rising; got {t.shape} and {u.shape}")
        return np.asarray(simulate(self.model, self.amplifier.drive(u), jnp.diff(jnp.asarray(t), prepend=t[0]))[0])

    def record(self, t: Any, u: Any, *, seed: int, every: int = 1, name: str = "stage") -> Record:
        """A measurement. Its input is the voltage that reached the actuator.

        Args:
            t: times [s], shape (T,).
            u: commands [V], shape (T,).
            seed: of the sensor noise.
            every: the actuator is simulated at all samples, and every so many are recorded.
            name: of the record.

        Raises:
            DataError: shapes differ, times decrease, or `every` is not positive.
        """
        t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
        if every < 1:
            raise DataError(f"every must be at least 1, got {every}")
        y = self.displacement(t, u)[::every]
        reached = np.asarray(self.amplifier.drive(u))
        beyond = np.count_nonzero(reached != u)
        record = Record(
            u=reached[::every],
            y=self.sensor.read(y, np.random.default_rng(seed)),
            t=t[::every],
            u_unit="V",
            y_unit="um",
            u_name="voltage",
            y_name="displacement",
            name=name,
            source="simulated (surrogate of the AE0505D16)",
        )
        if not beyond:
            return record
        return record.noted(Code.PREPARED, f"{beyond} commands beyond the limits of the amplifier")
