"""The three-axis stage: three piezo actuators, 3-RRR kinematics, modal dynamics, sensors; a plant for control and a source of records."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.models import AbstractHysteresis, BoucWen, LogCreep, SecondOrder, Series, simulate
from hystfit.outcome import Code, Note
from hystfit.params.space import ParameterSpace
from hystfit.stage.actuator import Amplifier, Sensor, piezo, population
from hystfit.stage.kinematics import AXES, Kinematics
from hystfit.stage.measured import Measured

RATE = 10_000.0  # samples/s of the simulated controller
MODES = {"x": (630.0, 0.02), "y": (630.0, 0.02), "theta": (900.0, 0.02)}  # Hz and damping ratio


def _stack(models: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *models)


class Stage(eqx.Module):
    """Voltages of three actuators in, pose (x, y, theta) [um, um, mrad] out. `init` and `step` as any model has, on vectors.

    Attributes:
        actuators: one model whose numbers have a leading axis of 3.
        kinematics: extensions to pose.
        modes: `SecondOrder` of each axis, numbers with a leading axis of 3.
        low, high: limits of the amplifiers [V].
    """

    actuators: Any
    kinematics: Kinematics
    modes: Any
    low: Float[Array, ""]
    high: Float[Array, ""]

    @classmethod
    def of(
        cls,
        actuators: AbstractHysteresis | Sequence[AbstractHysteresis] | None = None,
        *,
        kinematics: Kinematics | None = None,
        modes: Mapping[str, tuple[float, float]] | None = None,
        amplifier: Amplifier = Amplifier(),  # noqa: B008 a frozen value
    ) -> Stage:
        """A stage of one actuator model three times, or of three of one structure; defaults are the surrogate's.

        Args:
            actuators: voltage [V] to extension [um].
            kinematics: see `Kinematics`.
            modes: natural frequency [Hz] and damping ratio by axis.
            amplifier: of each actuator.

        Raises:
            ParameterError: not one or three actuators, not all axes, or a number beyond its bounds.
        """
        given = [actuators or piezo()] * 3 if not isinstance(actuators, Sequence) else list(actuators)
        if len(given) != 3:
            raise ParameterError(f"a stage has three actuators, got {len(given)}")
        modes = dict(MODES if modes is None else modes)
        if set(modes) != set(AXES):
            raise ParameterError(f"modes must name the axes {', '.join(AXES)}, got {', '.join(modes)}")
        second = [SecondOrder(omega=2 * np.pi * f, zeta=zeta) for f, zeta in (modes[axis] for axis in AXES)]
        kinematics = kinematics or Kinematics()
        if not (float(kinematics.amplification) > 0 and float(kinematics.arm) > 0):
            raise ParameterError(
                f"amplification and arm must be positive, got {kinematics.amplification} and {kinematics.arm}"
            )
        for part in (*given, *second, kinematics):
            ParameterSpace.of(part)  # refuses what is beyond the bounds
        limits = (jnp.asarray(float(v)) for v in (amplifier.low, amplifier.high))
        return cls(_stack(given), kinematics, _stack(second), *limits)

    def init(self, u0: Float[Array, " 3"]) -> Float[Array, " state"]:
        """At rest on voltages, with no history. State: actuators, modes, static pose before."""
        u0 = jnp.clip(u0, self.low, self.high)
        states = jax.vmap(lambda model, u: model.init(u))(self.actuators, u0)
        length = jax.vmap(lambda model, s, u: model.step(s, u, u, jnp.zeros(()))[1])(self.actuators, states, u0)
        pose = self.kinematics.pose(length)
        return jnp.concatenate([states.ravel(), jax.vmap(lambda mode, p: mode.init(p))(self.modes, pose).ravel(), pose])

    def step(
        self, state: Float[Array, " state"], u0: Float[Array, " 3"], u1: Float[Array, " 3"], dt: Float[Array, ""]
    ) -> tuple[Float[Array, " state"], Float[Array, " 3"]]:
        """One sample: the voltages go from u0 to u1, held at the amplifiers' limits."""
        u0, u1 = (jnp.clip(u, self.low, self.high) for u in (u0, u1))
        own, modal, before = state[:-9].reshape(3, -1), state[-9:-3].reshape(3, 2), state[-3:]
        own, length = jax.vmap(lambda model, s, a, b: model.step(s, a, b, dt))(self.actuators, own, u0, u1)
        static = self.kinematics.pose(length)
        modal, pose = jax.vmap(lambda mode, s, a, b: mode.step(s, a, b, dt))(self.modes, modal, before, static)
        return jnp.concatenate([own.ravel(), modal.ravel(), static]), pose

    def run(self, u: Float[Array, "T 3"], dt: Float[Array, " T"]) -> Float[Array, "T 3"]:
        """Poses for voltages, from rest on the first; traced, so that `jax.vmap` runs populations and seeds."""
        before = jnp.concatenate([u[:1], u[:-1]])
        return jax.lax.scan(lambda s, sample: self.step(s, *sample), self.init(u[0]), (before, u, dt))[1]

    def simulate(self, u: Any, dt: Any = 1 / RATE, *, finer: int = 1) -> np.ndarray:
        """Poses for voltages, shape (T, 3), at rest on the first sample before it.

        Args:
            u: voltages, shape (T, 3).
            dt: time between samples, a number or shape (T,).
            finer: integration steps a sample, the voltage linear between samples.

        Raises:
            DataError: wrong shape, values that are not finite.
        """
        u = np.asarray(u, dtype=float)
        if u.ndim != 2 or u.shape[1] != 3 or not np.isfinite(u).all() or finer < 1:
            raise DataError(f"voltages must be finite and of shape (T, 3), finer at least 1; got {u.shape} and {finer}")
        given = np.asarray(dt, dtype=float)
        if given.shape not in ((), (len(u),)) or not (np.isfinite(given).all() and (given >= 0).all()):
            raise DataError(f"dt must be a number or of shape ({len(u)},), finite and not negative; got {given}")
        steps = np.broadcast_to(given, (len(u),)).copy()
        steps[0] = 0.0
        fine, times = refine(u, steps, finer)
        return np.asarray(_run(self, jnp.asarray(fine), jnp.asarray(times)))[::finer]

    def measure(self, t: Any, u: Any, *, seed: int, sensors: Mapping[str, Sensor] | None = None) -> Measured:
        """A measurement of all channels: voltages that reached the actuators, strain gauges on them, probes on the platform.

        Args:
            t: times [s], shape (T,).
            u: voltages asked for, shape (T, 3).
            seed: of the sensors' noise.
            sensors: by axis, and "gauge"; those of `sensors()` where not given.

        Raises:
            DataError: times of another length or that run back; see `simulate`.
            ParameterError: a sensor of no such channel.
        """
        known = self.sensors()
        if sensors is not None and (unknown := set(sensors) - set(known)):
            raise ParameterError(f"no sensor {unknown.pop()!r}; there are {', '.join(known)}")
        known |= dict(sensors or {})
        t, u = np.asarray(t, dtype=float), np.asarray(u, dtype=float)
        if t.shape != u.shape[:1] or not (np.diff(t) >= 0).all():
            raise DataError(f"times must have shape (T,) with the T of the voltages, rising; got {t.shape}, {u.shape}")
        steps = np.diff(t, prepend=t[0])
        poses, reached = self.simulate(u, steps), np.clip(u, float(self.low), float(self.high))
        lengths = np.asarray(_lengths(self.actuators, jnp.asarray(reached.T), jnp.asarray(steps))).T
        rng = np.random.default_rng(seed)
        probes = np.stack([known[axis].read(poses[:, k], rng) for k, axis in enumerate(AXES)], axis=1)
        beyond = int(np.count_nonzero(reached != u))
        notes = (Note(Code.PREPARED, f"{beyond} commands beyond the amplifiers' limits"),) if beyond else ()
        return Measured(t, reached, known["gauge"].read(lengths, rng), probes, notes)

    def records(self, t: Any, u: Any, *, seed: int, sensors: Mapping[str, Sensor] | None = None) -> dict[str, Record]:
        """Measured poses: one record an axis, its input the voltage of the actuator that moves it most. See `measure`."""
        measured = self.measure(t, u, seed=seed, sensors=sensors)
        strongest = np.argmax(np.abs(np.asarray(self.kinematics.jacobian())), axis=1)
        return {axis: measured.record(axis, int(strongest[k])) for k, axis in enumerate(AXES)}

    def sensors(self) -> dict[str, Sensor]:
        """5 nm of noise and 1 nm of resolution at the probes and the gauges."""
        arm = float(self.kinematics.arm)
        return {"x": Sensor(), "y": Sensor(), "theta": Sensor(0.005 / arm, 0.001 / arm), "gauge": Sensor()}

    def scattered(self, count: int, *, spread: Mapping[str, float], seed: int) -> Stage:
        """`count` stages whose actuators scatter about the first one's: one stage with a leading axis on every number."""
        first = jax.tree.map(lambda leaf: leaf[0], self.actuators)
        many = population(first, 3 * count, spread=spread, seed=seed)
        grouped = jax.tree.map(lambda leaf: leaf.reshape(count, 3, *leaf.shape[1:]), many)
        repeated = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *jnp.shape(leaf))), self)
        return eqx.tree_at(lambda stage: stage.actuators, repeated, grouped)


_run = eqx.filter_jit(lambda stage, u, dt: stage.run(u, dt))
_lengths = eqx.filter_jit(
    lambda actuators, u, dt: jax.vmap(lambda model, own: simulate(model, own, dt)[0])(actuators, u)
)


def refine(u: np.ndarray, dt: np.ndarray, finer: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (T, ...) and steps (T,) on a grid `finer` times as fine, the input linear between samples; row k becomes row finer * k."""
    count = len(u)
    at = np.arange(finer * (count - 1) + 1) / finer
    low = np.minimum(at.astype(int), count - 2)
    part = (at - low).reshape(-1, *[1] * (u.ndim - 1))
    fine = u[low] + part * (u[low + 1] - u[low])
    steps = np.concatenate([dt[:1], np.repeat(dt[1:] / finer, finer)])
    return fine, steps


def axis_plant(
    actuator: AbstractHysteresis | None = None,
    *,
    gain: float = 103.0 / 12.0,
    mode: tuple[float, float] | None = MODES["x"],
) -> Series:
    """One actuator through the lever on one axis: a model of voltage to platform displacement [um], for loops of one axis.

    Args:
        actuator: Bouc-Wen hysteresis and creep in a `Series`; `piezo()` if None.
        gain: platform over actuator displacement.
        mode: natural frequency [Hz] and damping ratio of the axis, None for none.

    Raises:
        ParameterError: an actuator of another structure.
    """
    actuator = piezo() if actuator is None else actuator
    kinds = [type(part) for part in actuator.parts] if isinstance(actuator, Series) else []
    if kinds != [BoucWen, LogCreep]:
        raise ParameterError(
            f"an axis needs a Series of BoucWen and LogCreep, got {type(actuator).__name__} of {kinds}"
        )
    hysteresis, creep = actuator.parts
    scaled = lambda node, field: jnp.asarray(getattr(node, field)) * gain
    hysteresis = dataclasses.replace(
        hysteresis, c=scaled(hysteresis, "c"), h0=scaled(hysteresis, "h0"), offset=scaled(hysteresis, "offset")
    )
    creep = dataclasses.replace(creep, span=scaled(creep, "span"))
    parts = [hysteresis, creep]
    if mode is not None:
        parts.append(SecondOrder(omega=2 * np.pi * mode[0], zeta=mode[1]))
    return Series(*parts)


def perturbed(actuator: Series, **factors: float) -> Series:
    """The same actuator with parameters times factors: c, mu, tau, delta, gamma.

    Raises:
        ParameterError: an unknown name, or a value beyond its bounds.
    """
    known = ("c", "mu", "tau", "delta", "gamma")
    unknown = [name for name in factors if name not in known]
    if unknown:
        raise ParameterError(f"no parameter {unknown[0]!r} to perturb; there are {', '.join(known)}")
    get = lambda name: factors.get(name, 1.0)
    hysteresis, creep, *rest = actuator.parts
    hysteresis = dataclasses.replace(
        hysteresis,
        c=hysteresis.c * get("c"),
        mu=hysteresis.mu * get("mu"),
        tau=hysteresis.tau * get("tau"),
        rho=hysteresis.rho * get("delta") / get("tau"),
    )
    made = Series(hysteresis, dataclasses.replace(creep, gamma=creep.gamma * get("gamma")), *rest)
    ParameterSpace.of(made)  # refuses what is beyond the bounds
    return made
