"""Loops of the three-axis stage in one call, against loops of its parts."""

import jax.numpy as jnp
import numpy as np
import pytest

from hystfit import BoucWen, Record, simulate
from hystfit.control import Controller, InverseStep, TransferFunction, invert, run_loop
from hystfit.errors import DataError, ParameterError
from hystfit.identify import Ukf
from hystfit.stage import Decoupled, Kinematics, Sensor, Stage, StageInverse, track_adaptively, upsample

LIMITS = (-20.0, 120.0)
RATE = 500.0
DEVICES = tuple(BoucWen(c=0.15 + 0.01 * k, mu=0.4, tau=0.011, rho=0.8) for k in range(3))
SLACK = tuple(BoucWen(c=0.14 + 0.01 * k, mu=0.45, tau=0.012, rho=0.7) for k in range(3))
TRUTH = Stage.of(DEVICES, kinematics=Kinematics(direction=0.1))
JACOBIAN = np.asarray(TRUTH.kinematics.jacobian())


def poses(count: int = 400) -> np.ndarray:
    """A circle with a rotation, of growing size, about the middle of the stage, from its rest."""
    t = np.arange(count) / RATE
    phase = 2 * np.pi * 2.5 * t
    shape = np.stack([12 * np.cos(phase), 12 * np.sin(phase), 0.1 * np.sin(2 * phase)], axis=1)
    middle = JACOBIAN @ np.full(3, 6.0)
    return np.minimum(t / 0.2, 1.0)[:, None] * (middle + np.minimum(0.4 + t, 1.0)[:, None] * shape)


def test_a_loop_of_the_stage_is_its_three_inverses_and_its_simulation():
    wanted = poses()
    found = run_loop(
        TRUTH, wanted, RATE, feedforward=StageInverse.of(SLACK, JACOBIAN, limits=LIMITS), limits=LIMITS, finer=4
    )
    lengths = wanted @ np.linalg.inv(JACOBIAN).T
    apart = [invert(SLACK[k], lengths[:, k], 1 / RATE, limits=LIMITS).u for k in range(3)]
    np.testing.assert_allclose(found.u, np.stack(apart, axis=1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.y[1:], TRUTH.simulate(found.u, 1 / RATE, finer=4)[1:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.max_error(0.4), np.abs(wanted - found.y)[200:].max(axis=0), rtol=1e-12)


def test_a_finer_plant_is_a_simulation_with_more_samples():
    u = 50 - 50 * np.cos(np.arange(200) / 20.0)
    found = run_loop(DEVICES[0], u, RATE, feedforward=u, finer=4)
    fine, _ = upsample(u, np.full(u.size, 1 / RATE), 4)
    np.testing.assert_allclose(found.y, simulate(DEVICES[0], fine)[0][::4], rtol=0, atol=1e-12)
    with pytest.raises(DataError, match="finer >= 1"):
        run_loop(DEVICES[0], u, RATE, feedforward=u, finer=0)


def test_feedback_removes_the_static_error_of_every_axis():
    """An integrator leaves none; without it wrong actuators leave several percent."""
    wanted = np.tile(poses()[-1], (400, 1))
    ahead = StageInverse.of(SLACK, JACOBIAN, limits=LIMITS)
    controller = Decoupled(Controller.of(TransferFunction((200.0,), (1.0, 0.0)), RATE), jnp.asarray(JACOBIAN))
    closed = run_loop(TRUTH, wanted, RATE, feedforward=ahead, controller=controller, limits=LIMITS)
    opened = run_loop(TRUTH, wanted, RATE, feedforward=ahead, limits=LIMITS)
    assert (np.abs(closed.error[-1]) < 1e-5 * np.abs(wanted[-1])).all()
    assert np.max(np.abs(opened.error[-1] / wanted[-1])) > 0.03


def test_a_limited_actuator_is_remembered_as_it_moved():
    """With `applied`, the memory of the inverse is that of the actuators driven by the limited voltages."""
    ahead, u = StageInverse.of(DEVICES, JACOBIAN, limits=LIMITS), jnp.asarray([10.0, 40.0, 70.0])
    memory = ahead.moved(ahead.init(0.0), u)
    for k in range(3):
        single = InverseStep.of(DEVICES[k], limits=LIMITS)
        expected = single.moved(single.init(0.0), u[k])
        np.testing.assert_allclose(memory.state[k], expected.state, rtol=0, atol=1e-12)
    with pytest.raises(ParameterError, match="three actuators"):
        StageInverse.of(DEVICES[:2], JACOBIAN, limits=LIMITS)


def test_a_filter_for_each_actuator_corrects_the_stage():
    wanted, t = poses(1200), np.arange(1200) / RATE
    fixed = run_loop(TRUTH, wanted, RATE, feedforward=StageInverse.of(SLACK, JACOBIAN, limits=LIMITS), limits=LIMITS)
    scales = [Record(u=u, y=np.asarray(simulate(m, u)[0]), t=t) for m, u in zip(SLACK, fixed.u.T, strict=True)]
    filters = [
        Ukf.of(m, r, start="model", noise=0.002, prior=0.2, caution=0.1, settling=100.0)
        for m, r in zip(SLACK, scales, strict=True)
    ]
    sensors = [Sensor(0.005, 0.0), Sensor(0.005, 0.0), Sensor(0.005 / 40, 0.0)]
    options = {"block": 200, "limits": LIMITS, "sensor": sensors, "seed": 0, "finer": 1, "jacobian": JACOBIAN}
    run = track_adaptively(filters, TRUTH, wanted, 1 / RATE, **options)
    last = slice(-200, None)
    assert (np.abs(run.error[last]).max(axis=0) < 0.1 * np.abs(fixed.error[last]).max(axis=0)).all()
    for model, device in zip(run.models, DEVICES, strict=True):
        assert float(model.c) == pytest.approx(float(device.c), rel=0.02)
    with pytest.raises(DataError, match=r"\(T, 3\)"):
        track_adaptively(filters, TRUTH, wanted[:, :2], 1 / RATE, **options)
