"""The three-axis stage (three piezo actuators, 3-RRR kinematics, modal dynamics, sensors) and the plant of one of its axes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.config import require_x64
from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.models import AbstractHysteresis, BoucWen, LogCreep, SecondOrder, Series, simulate
from hystfit.models.shared.shapes import Scalar, Signal, State
from hystfit.models.shared.simulation import check_one_device
from hystfit.outcome import Code, Note
from hystfit.params.space import ParameterSpace
from hystfit.stage.actuator import Amplifier, Sensor, piezo
from hystfit.stage.kinematics import AXES, UNITS, Kinematics
from hystfit.stage.population import Population, seeds_of, single_models

RATE = 10_000.0  # samples/s of the simulated controller
MODES = {"x": (630.0, 0.02), "y": (630.0, 0.02), "theta": (900.0, 0.02)}  # Hz and damping ratio


def _stack(models: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *models)


@dataclasses.dataclass(frozen=True)
class StageMeasurement:
    """Measured channels of the stage.

    Attributes:
        t: times [s], shape (T,).
        u: voltages that reached the actuators [V], shape (T, 3).
        extension: from strain gauges on the actuators [um], shape (T, 3).
        pose: from probes on the platform, x, y [um] and theta [mrad], shape (T, 3).
        notes: on commands beyond the limits of the amplifiers.
    """

    t: np.ndarray
    u: np.ndarray
    extension: np.ndarray
    pose: np.ndarray
    notes: tuple[Note, ...] = ()

    def columns(self) -> dict[str, np.ndarray]:
        """Columns of a file by name, with the unit after the last underscore."""
        channels = {"t_s": self.t} | {f"u{k + 1}_V": self.u[:, k] for k in range(3)}
        channels |= {f"extension{k + 1}_um": self.extension[:, k] for k in range(3)}
        return channels | {f"{axis}_{UNITS[axis]}": self.pose[:, k] for k, axis in enumerate(AXES)}

    def record(self, axis: str, actuator: int) -> Record:
        """One axis over the voltage of one actuator (0, 1, 2)."""
        return Record(
            u=self.u[:, actuator],
            y=self.pose[:, AXES.index(axis)],
            t=self.t,
            u_unit="V",
            y_unit=UNITS[axis],
            u_name=f"voltage{actuator + 1}",
            y_name=axis,
            name=f"stage-{axis}",
            source="simulated stage",
            notes=self.notes,
        )


class Stage(eqx.Module):
    """From voltages of three actuators to the pose (x, y, theta) [um, um, mrad], with the vector form of a model's `init` and `step`.

    Attributes:
        actuators: one model whose parameters have a leading axis of 3.
        kinematics: extensions to pose.
        modes: `SecondOrder` of each axis, parameters with a leading axis of 3.
        low, high: limits of the amplifiers [V].
    """

    actuators: Any
    kinematics: Kinematics
    modes: Any
    low: Scalar
    high: Scalar

    @classmethod
    def of(
        cls,
        actuators: AbstractHysteresis | Sequence[AbstractHysteresis] | None = None,
        *,
        kinematics: Kinematics | None = None,
        modes: Mapping[str, tuple[float, float]] | None = None,
        amplifier: Amplifier = Amplifier(),  # noqa: B008 a frozen value
    ) -> Stage:
        """A stage of three actuators.

        Args:
            actuators: one model of voltage [V] to extension [um] for all, or three of one structure; `piezo()` by default.
            kinematics: extensions to pose; `Kinematics()` by default.
            modes: natural frequency [Hz] and damping ratio by axis; `MODES` by default.
            amplifier: of each actuator.

        Raises:
            ParameterError: not one or three actuators, not all axes, or a number outside its bounds.
        """
        devices = list(actuators) if isinstance(actuators, Sequence) else [actuators or piezo()] * 3
        if len(devices) != 3:
            raise ParameterError(f"a stage has three actuators, got {len(devices)}")
        modes = dict(MODES if modes is None else modes)
        if set(modes) != set(AXES):
            raise ParameterError(f"modes must name the axes {', '.join(AXES)}, got {', '.join(modes)}")
        second = [SecondOrder(omega=2 * np.pi * f, zeta=zeta) for f, zeta in (modes[axis] for axis in AXES)]
        kinematics = kinematics or Kinematics()
        if not (float(kinematics.amplification) > 0 and float(kinematics.arm) > 0):
            raise ParameterError(
                f"amplification and arm must be positive, got {kinematics.amplification} and {kinematics.arm}"
            )
        for part in (*devices, *second, kinematics):
            ParameterSpace.of(part)  # raises outside the bounds
        for device in devices:
            check_one_device(device)
        limits = (jnp.asarray(float(v)) for v in (amplifier.low, amplifier.high))
        return cls(_stack(devices), kinematics, _stack(second), *limits)

    def population(self, count: int, *, spread: Mapping[str, float], seed: int) -> Population[Stage]:
        """Stages whose actuators scatter about those of this one, each on its own; arguments are those of `hystfit.stage.population`."""
        places = [jax.tree.map(lambda leaf, k=k: leaf[k], self.actuators) for k in range(3)]
        seeds = zip(places, seeds_of(seed, 3), strict=True)
        scattered = [single_models(model, count, spread=spread, seed=own) for model, own in seeds]
        named = lambda part: {
            f"{name}@{k + 1}": v for k, found in enumerate(scattered) for name, v in found[part].items()
        }
        devices = [_stack(models) for models in zip(*(models for models, _, _ in scattered), strict=True)]
        stages = tuple(dataclasses.replace(self, actuators=three) for three in devices)
        return Population(stages, named(1), named(2))

    def init(self, u0: Float[Array, " 3"]) -> State:
        """State in equilibrium at voltages, without history: states of the actuators and modes, static pose of the previous sample."""
        u0 = jnp.clip(u0, self.low, self.high)
        states = jax.vmap(lambda model, u: model.init(u))(self.actuators, u0)
        length = jax.vmap(lambda model, s, u: model.step(s, u, u, jnp.zeros(()))[1])(self.actuators, states, u0)
        pose = self.kinematics.pose(length)
        return jnp.concatenate([states.ravel(), jax.vmap(lambda mode, p: mode.init(p))(self.modes, pose).ravel(), pose])

    def step(
        self, state: State, u0: Float[Array, " 3"], u1: Float[Array, " 3"], dt: Scalar
    ) -> tuple[State, Float[Array, " 3"]]:
        """One sample: the voltages go from u0 to u1, clipped at the limits of the amplifiers.

        Args:
            state: before the sample.
            u0, u1: voltages at the previous and at this sample [V].
            dt: time between them [s].

        Returns:
            State after the sample, and the pose.
        """
        u0, u1 = (jnp.clip(u, self.low, self.high) for u in (u0, u1))
        stacks, modal, previous = state[:-9].reshape(3, -1), state[-9:-3].reshape(3, 2), state[-3:]
        one_step = jax.vmap(lambda model, s, before, after: model.step(s, before, after, dt))
        stacks, length = one_step(self.actuators, stacks, u0, u1)
        static = self.kinematics.pose(length)
        modal, pose = one_step(self.modes, modal, previous, static)
        return jnp.concatenate([stacks.ravel(), modal.ravel(), static]), pose

    def run(self, u: Float[Array, "T 3"], dt: Signal) -> Float[Array, "T 3"]:
        """Poses for voltages, from rest at the first sample; traced, so `jax.vmap` simulates populations."""
        before = jnp.concatenate([u[:1], u[:-1]])
        return jax.lax.scan(lambda s, sample: self.step(s, *sample), self.init(u[0]), (before, u, dt))[1]

    def simulate(self, u: Any, dt: Any = 1 / RATE, *, finer: int = 1) -> np.ndarray:
        """Poses for voltages, shape (T, 3), from rest at the first sample.

        Args:
            u: voltages, shape (T, 3).
            dt: time between samples, a number or shape (T,).
            finer: integration steps per sample; the voltage is linear between samples.

        Raises:
            DataError: wrong shape, values that are not finite.
        """
        require_x64()
        u = np.asarray(u, dtype=float)
        if u.ndim != 2 or u.shape[1] != 3 or not np.isfinite(u).all() or finer < 1:
            raise DataError(f"voltages must be finite and of shape (T, 3), finer at least 1; got {u.shape} and {finer}")
        dt = np.asarray(dt, dtype=float)
        if dt.shape not in ((), (len(u),)) or not (np.isfinite(dt).all() and (dt >= 0).all()):
            raise DataError(f"dt must be a number or of shape ({len(u)},), finite and not negative; got {dt}")
        steps = np.broadcast_to(dt, (len(u),)).copy()
        steps[0] = 0.0
        fine, fine_steps = upsample(u, steps, finer)
        return np.asarray(_run(self, jnp.asarray(fine), jnp.asarray(fine_steps)))[::finer]

    def measure(self, t: Any, u: Any, *, seed: int, sensors: Mapping[str, Sensor] | None = None) -> StageMeasurement:
        """A measurement of all channels: voltages that reached the actuators, strain gauges on them, probes on the platform.

        Args:
            t: times [s], shape (T,).
            u: commanded voltages [V], shape (T, 3).
            seed: of the sensor noise.
            sensors: by axis, and "gauge"; those of `sensors()` where not given.

        Raises:
            DataError: times of another length or decreasing; see `simulate`.
            ParameterError: a sensor of an unknown channel.
        """
        channels = self.sensors()
        if sensors is not None and (unknown := set(sensors) - set(channels)):
            raise ParameterError(f"no sensor {unknown.pop()!r}; there are {', '.join(channels)}")
        channels |= dict(sensors or {})
        t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
        if t.shape != u.shape[:1] or not (np.diff(t) >= 0).all():
            raise DataError(f"times must have shape (T,) with the T of the voltages, rising; got {t.shape}, {u.shape}")
        steps = np.diff(t, prepend=t[0])
        poses, reached = self.simulate(u, steps), np.clip(u, float(self.low), float(self.high))
        lengths = np.asarray(_lengths(self.actuators, jnp.asarray(reached.T), jnp.asarray(steps))).T
        rng = np.random.default_rng(seed)
        probes = np.stack([channels[axis].read(poses[:, k], rng) for k, axis in enumerate(AXES)], axis=1)
        beyond = int(np.count_nonzero(reached != u))
        notes = (Note(Code.PREPARED, f"{beyond} commands beyond the limits of the amplifiers"),) if beyond else ()
        return StageMeasurement(t, reached, channels["gauge"].read(lengths, rng), probes, notes)

    def records(self, t: Any, u: Any, *, seed: int) -> dict[str, Record]:
        """Measured poses: one record an axis, over the voltage of the actuator that moves it most; arguments are those of `measure`."""
        measured = self.measure(t, u, seed=seed)
        strongest = np.argmax(np.abs(np.asarray(self.kinematics.jacobian())), axis=1)
        return {axis: measured.record(axis, int(strongest[k])) for k, axis in enumerate(AXES)}

    def record(self, t: Any, u: Any, *, seed: int, axis: str = "x", name: str = "stage") -> Record:
        """One of `records`, by its axis x, y or theta, under another name.

        Raises:
            ParameterError: no such axis.
        """
        if axis not in AXES:
            raise ParameterError(f"an axis is {', '.join(AXES)}, got {axis!r}")
        return self.records(t, u, seed=seed)[axis].replace(name=name)

    def sensors(self) -> dict[str, Sensor]:
        """Default sensors: 5 nm of noise and 1 nm of resolution at the probes and the gauges."""
        arm = float(self.kinematics.arm)
        return {"x": Sensor(), "y": Sensor(), "theta": Sensor(0.005 / arm, 0.001 / arm), "gauge": Sensor()}


_run = eqx.filter_jit(lambda stage, u, dt: stage.run(u, dt))
_lengths = eqx.filter_jit(
    lambda actuators, u, dt: jax.vmap(lambda model, voltage: simulate(model, voltage, dt)[0])(actuators, u)
)


def upsample(u: np.ndarray, dt: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (T, ...) and time steps (T,) on a grid finer by a factor, the input linear between samples; row k becomes row factor * k."""
    count = len(u)
    at = np.arange(factor * (count - 1) + 1) / factor
    low = np.minimum(at.astype(int), count - 2)
    part = (at - low).reshape(-1, *[1] * (u.ndim - 1))
    fine = u[low] + part * (u[low + 1] - u[low])
    steps = np.concatenate([dt[:1], np.repeat(dt[1:] / factor, factor)])
    return fine, steps


def axis_plant(
    actuator: AbstractHysteresis | None = None,
    *,
    gain: float = 103.0 / 12.0,
    mode: tuple[float, float] | None = MODES["x"],
) -> Series:
    """One actuator and the lever on one axis: a model of voltage [V] to platform displacement [um].

    Args:
        actuator: Bouc-Wen hysteresis and creep in a `Series`; `piezo()` if None.
        gain: platform over actuator displacement.
        mode: natural frequency [Hz] and damping ratio of the axis; None for a rigid axis.

    Raises:
        ParameterError: an actuator of another structure.
    """
    actuator = piezo() if actuator is None else actuator
    kinds = [type(part) for part in actuator.parts] if isinstance(actuator, Series) else []
    if kinds != [BoucWen, LogCreep]:
        raise ParameterError(
            f"an axis needs a Series of BoucWen and LogCreep, got {type(actuator).__name__} of {kinds}"
        )
    hysteresis, creep = actuator.parts  # type: ignore[attr-defined]
    scaled = lambda node, field: jnp.asarray(getattr(node, field)) * gain
    hysteresis = dataclasses.replace(hysteresis, c=scaled(hysteresis, "c"), offset=scaled(hysteresis, "offset"))
    creep = dataclasses.replace(creep, span=scaled(creep, "span"))
    parts = [hysteresis, creep]
    if mode is not None:
        parts.append(SecondOrder(omega=2 * np.pi * mode[0], zeta=mode[1]))
    return Series(*parts)
