"""Feedback design against the published closed loop, controllers and loops against plain ones, and plant identification."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim, lti

import hystfit as hf
from hystfit.control import (
    Controller,
    InverseStep,
    TransferFunction,
    assess,
    design,
    identify_plant,
    invert,
    margins,
    pd_lead_lag,
    root_locus,
    run_loop,
    second_order,
)
from hystfit.errors import DataError, ParameterError

PLANT = second_order(328.0, 0.02, 0.62)
PAPER = pd_lead_lag(24.19, derivative=1.469e-3, filter=1.25e-4, zero=20.0, pole=20.0 / 3)
CORE = hf.BoucWen(c=0.9, mu=0.45, tau=0.01, rho=0.88)
STAGE = hf.Series(CORE, hf.SecondOrder(omega=328.0, zeta=0.02))


# -- design ----------------------------------------------------------------------------------------------------------------


def test_controller_of_the_preisach_surrogate() -> None:
    # C(s) = (1.777e-3 s^2 + 1.2452 s + 24.19) / (1.875e-5 s^2 + 0.150125 s + 1), papers' section 2.5.
    np.testing.assert_allclose(PAPER.num, [1.777e-3, 1.2452, 24.19], rtol=2e-4)
    np.testing.assert_allclose(PAPER.den, [1.875e-5, 0.150125, 1.0], rtol=1e-6)


def test_design_reproduces_poles_damping_and_margins() -> None:
    ideal = assess(PAPER, PLANT)
    np.testing.assert_allclose(ideal.poles[0], -17.7, atol=0.05)
    np.testing.assert_allclose(np.sort_complex(ideal.poles[1:3]), [-397 - 749j, -397 + 749j], atol=0.8)
    np.testing.assert_allclose(ideal.poles[3], -7207, atol=1)
    assert ideal.damping == pytest.approx(0.47, abs=0.005)
    assert ideal.margins.phase == pytest.approx(49, abs=0.6)
    assert ideal.margins.sensitivity == pytest.approx(1.24, abs=0.006)
    sampled = assess(PAPER, PLANT, rate=1e4).margins
    assert sampled.phase == pytest.approx(40, abs=0.6)
    assert sampled.sensitivity == pytest.approx(1.50, abs=0.006)
    slow = assess(PAPER, PLANT, rate=2e3)
    assert slow.margins.phase == pytest.approx(5, abs=0.6)
    assert len(slow.notes) > len(assess(PAPER, PLANT, rate=1e4).notes)


def test_design_from_the_goals() -> None:
    rule = design(omega=328.0, zeta=0.02, gain=0.62)
    np.testing.assert_allclose(rule.controller.num, PAPER.num, rtol=2e-3)
    np.testing.assert_allclose(rule.controller.den, PAPER.den, rtol=6e-3)
    assert rule.static_error == pytest.approx(1 / 16)
    locus = design(omega=328.0, zeta=0.02, gain=0.62, locus=True, damping_ratio=0.55)
    pair = locus.poles[np.imag(locus.poles) > 0][0]
    assert -pair.real / abs(pair) == pytest.approx(0.55, abs=1e-6)


@pytest.mark.parametrize(("zeta", "part"), [(0.005, 0.9), (0.005, 1.1), (0.05, 0.9), (0.05, 1.1)])
def test_design_holds_for_other_plants(zeta: float, part: float) -> None:
    found = assess(PAPER, second_order(328.0 * part, zeta, 0.62))
    assert found.damping >= 0.40


def test_margins_against_closed_forms() -> None:
    # L = k / (s + 1)^3: the phase reaches -180 degrees at sqrt(3), where |L| = k / 8.
    loop = TransferFunction((4.0,), (1.0, 3.0, 3.0, 1.0))
    found = margins(loop)
    assert found.gain == pytest.approx(2.0, rel=1e-3)
    crossover = float(np.sqrt(4.0 ** (2 / 3) - 1))
    assert found.crossover == pytest.approx(crossover, rel=1e-4)
    assert found.phase == pytest.approx(180 - 3 * np.degrees(np.arctan(crossover)), abs=0.01)
    assert found.stable
    assert not margins(loop * 2.1).stable
    # One radian of delay at the crossover takes 57.3 degrees.
    late = margins(loop, 0.2 / crossover)
    assert found.phase - late.phase == pytest.approx(np.degrees(0.2), abs=0.01)


@pytest.mark.parametrize("gain", [0.3, 0.9, 1.1, 4.0, 30.0])
@pytest.mark.parametrize(
    "loop",
    [
        TransferFunction((1.0,), (1.0, -1.0)),  # stable where the gain is above 1
        TransferFunction((6.0,), (1.0, 3.0, 2.0, 0.001)),
        TransferFunction((2.0, 2.0), (1.0, 4.0, -1.0, -4.0)),
        TransferFunction((1.0, -2.0), (1.0, 3.0, 2.0)),
    ],
    ids=["unstable pole", "integrator", "unstable pole and zero", "zero on the right"],
)
def test_encirclements_tell_what_the_closed_poles_tell(loop: TransferFunction, gain: float) -> None:
    assert margins(loop * gain).stable == bool(np.all((loop * gain).closed().real < 0))


def test_root_locus_starts_at_the_poles_and_ends_at_the_zeros() -> None:
    loop = TransferFunction((5 / 3, 5.0), (1.0, 6.0, 5.0))  # zero at -3, poles at -1 and -5
    few, many = root_locus(loop, [1e-9, 1e9])
    np.testing.assert_allclose(np.sort(few.real), [-5, -1], atol=1e-6)
    assert np.abs(many + 3).min() < 1e-3
    assert loop(0.0) == pytest.approx(1.0)


def test_unreachable_goals_are_refused() -> None:
    with pytest.raises(ParameterError, match="unstable"):
        assess(PAPER * 10.0, PLANT, rate=1e4)
    with pytest.raises(ParameterError, match="sample faster"):
        assess(PAPER * 1.5, PLANT, rate=1.5e3)
    with pytest.raises(ParameterError, match="damping_ratio"):
        design(omega=328.0, zeta=0.02, gain=0.62, damping_ratio=1.5)
    for rate, delay in ((0.0, 1.5), (-1e4, 1.5), (1e4, -1.0)):
        with pytest.raises(ParameterError, match="rate must be positive"):
            assess(PAPER, PLANT, rate=rate, delay=delay)
    with pytest.raises(ParameterError, match="rate must be positive"):
        Controller.of(PAPER, 0.0)
    with pytest.raises(ParameterError, match="as many poles"):
        TransferFunction((1.0, 0.0, 0.0), (1.0, 1.0))
    with pytest.raises(ParameterError, match="samples/s"):
        Controller.of(PAPER, 1000.0)


# -- controller and loops --------------------------------------------------------------------------------------------------


def test_sampled_controller_is_tustin() -> None:
    rate = 1e4
    controller = Controller.of(PAPER, rate)
    w = np.array([10.0, 300.0, 2000.0])
    z = np.exp(1j * w / rate)
    a, b, c, d = (np.asarray(value) for value in (controller.A, controller.B, controller.C, controller.D))
    found = [c @ np.linalg.solve(x * np.eye(2) - a, b) + d for x in z]
    np.testing.assert_allclose(found, PAPER(2 * rate * (z - 1) / (z + 1)), rtol=1e-9)


def test_sampled_controller_follows_the_continuous_one() -> None:
    t = np.arange(2000) / 1e4
    error = np.sin(2 * np.pi * 20 * t)
    _, expected, _ = lsim(lti(PAPER.num, PAPER.den), error, t)
    controller, state, out = Controller.of(PAPER, 1e4), jnp.zeros(2), []
    a, b, c, d = (np.asarray(v) for v in (controller.A, controller.B, controller.C, controller.D))
    state = np.zeros(2)
    for e in error:
        out.append(c @ state + d * e)
        state = a @ state + b * e
    assert np.abs(np.array(out) - expected)[200:].max() < 0.01 * np.ptp(expected)


def test_loop_equals_a_plain_python_loop() -> None:
    rate, count, delay = 1e4, 60, 2
    reference = 10 + 5 * np.sin(np.arange(count) / 8)
    ahead = reference / 0.62
    controller = Controller.of(PAPER, rate)
    found = run_loop(STAGE, reference, rate, feedforward=ahead, controller=controller, limits=(0.0, 25.0), delay=delay)
    a, b, c, d, gain = (np.asarray(v) for v in (controller.A, controller.B, controller.C, controller.D, controller.L))
    state, u0, x, y = STAGE.init(jnp.asarray(0.0)), 0.0, np.zeros(2), [0.0] * (delay + 1)
    before = 0.0
    for k in range(count):
        error = before - y[-1 - delay]
        asked = ahead[k] + c @ x + d * error
        u = min(max(asked, 0.0), 25.0)
        x = a @ x + b * error + gain * (u - asked)
        state, out = STAGE.step(state, jnp.asarray(u0), jnp.asarray(u), jnp.asarray(1 / rate))
        y.append(float(out))
        u0, before = u, reference[k]
        assert u == pytest.approx(float(found.u[k]), abs=1e-9)
        assert y[-1] == pytest.approx(float(found.y[k]), abs=1e-9)
    assert found.saturated > 0


def test_feedback_error_of_a_constant_is_the_static_error() -> None:
    plant = hf.Series(hf.BoucWen(c=0.62, mu=1e-9, tau=1e-9), hf.SecondOrder(omega=328.0, zeta=0.02))
    found = run_loop(plant, np.full(12000, 20.0), 1e4, controller=Controller.of(PAPER, 1e4))
    assert found.error[-1] == pytest.approx(20.0 / (1 + 24.19 * 0.62), rel=1e-3)


def test_feedforward_and_feedback_beat_either() -> None:
    t = np.arange(20000) / 1e4
    reference = 40 * (1 - np.cos(2 * np.pi * t))
    drifted = hf.Series(hf.BoucWen(c=0.9 * 0.92, mu=0.45, tau=0.01, rho=0.88), STAGE.parts[1])
    ahead, controller = invert(CORE, reference).u, Controller.of(PAPER, 1e4)
    ff = run_loop(drifted, reference, 1e4, feedforward=ahead)
    fb = run_loop(drifted, reference, 1e4, controller=controller)
    both = run_loop(drifted, reference, 1e4, feedforward=ahead, controller=controller)
    assert both.rms_error(0.1) < 0.2 * min(ff.rms_error(0.1), fb.rms_error(0.1))
    running = run_loop(drifted, reference, 1e4, feedforward=InverseStep.of(CORE), controller=controller)
    np.testing.assert_allclose(running.y, both.y, atol=1e-6)


def test_running_inverse_that_remembers_what_was_given() -> None:
    # Limits take away part of the feed-forward: only a memory of the given input knows where the plant is.
    reference = 30 + 25 * np.sin(np.arange(4000) / 300)
    inverse = InverseStep.of(CORE, limits=(-200.0, 200.0))
    given = run_loop(CORE, reference, 1e3, feedforward=inverse, limits=(10.0, 55.0), applied=True)
    asked = run_loop(CORE, reference, 1e3, feedforward=inverse, limits=(10.0, 55.0))
    free = (given.u > 10.0) & (given.u < 55.0)
    assert np.abs(given.error[free]).max() < 1e-9
    assert np.abs(asked.error[(asked.u > 10.0) & (asked.u < 55.0)]).max() > 0.1


def test_anti_windup_shortens_the_way_back() -> None:
    # An almost pure integrator against a limit that it cannot overcome for half of the time.
    slow = TransferFunction((0.1, 5.0), (1.0, 1e-3))
    plant = hf.BoucWen(c=1.0, mu=1e-9, tau=1e-9)
    reference = np.where(np.arange(4000) < 2000, 2.0, 0.5)
    late = [
        run_loop(
            plant, reference, 1e3, controller=Controller.of(slow, 1e3, anti_windup=on), limits=(0.0, 1.0)
        ).rms_error(2.0)
        for on in (False, True)
    ]
    assert late[0] == pytest.approx(0.5, rel=1e-6)  # wound up, it stays on the limit
    assert late[1] == pytest.approx(0.5 / np.sqrt(20), rel=0.1)  # else it decays with its gain of 5 1/s


def test_sensor_noise_is_seeded_and_sized() -> None:
    controller = Controller.of(PAPER, 1e4)
    quiet, loud, again = (
        run_loop(STAGE, np.full(3000, 10.0), 1e4, controller=controller, noise=noise, seed=3)
        for noise in (0.0, 0.05, 0.05)
    )
    np.testing.assert_array_equal(loud.u, again.u)
    # The controller's gain at high frequency is 95 V/um.
    assert np.std(loud.u[1000:] - quiet.u[1000:]) == pytest.approx(95 * 0.05, rel=0.2)


def test_runaway_loops_say_so() -> None:
    with pytest.raises(ParameterError):
        run_loop(STAGE, np.full(20000, 10.0), 1e4, controller=Controller.of(PAPER * 20.0, 1e4))
    held = run_loop(STAGE, np.full(8000, 10.0), 1e4, controller=Controller.of(PAPER * 20.0, 1e4), limits=(0.0, 200.0))
    assert len(held.notes) == 2  # the input is at a limit, and jumps from one to the other
    assert len(run_loop(STAGE, np.full(200, 10.0), 1e4, controller=Controller.of(PAPER, 1e4)).notes) == 0
    with pytest.raises(DataError):
        run_loop(STAGE, np.zeros(10), 1e4, feedforward=np.zeros(9))


# -- plant -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signal", ["step", "chirp"])
def test_plant_identification(signal: str) -> None:
    extra = {} if signal == "step" else {"start": 5.0, "stop": 200.0}
    _, u = hf.signals.make(signal, duration=2.0, rate=5000.0, low=0.0, high=10.0, **extra)
    clean = 3 + 0.62 * np.asarray(hf.simulate(hf.SecondOrder(omega=328.0, zeta=0.02), u - u[0], 2e-4)[0])
    y = clean + 0.02 * np.random.default_rng(0).normal(size=u.size)
    found = identify_plant(u, y, 2e-4)
    assert found.stderr is not None
    truth = np.array([328.0, 0.02, 0.62, 3.0])
    values = np.array([found.omega, found.zeta, found.gain, found.offset])
    assert (np.abs(values - truth) < 4.5 * np.array(found.stderr)).all()  # 3e-5 of false alarms
    assert found.zeta == pytest.approx(0.02, rel=0.01)
    paper = identify_plant(u, y, 2e-4, method="total-least-squares")
    assert paper.omega == pytest.approx(328.0, rel=2e-3)
    assert paper.zeta == pytest.approx(0.02, rel=0.05)
    assert paper.nrmse_percent >= found.nrmse_percent


def test_records_without_a_resonance_are_refused() -> None:
    t = np.arange(400) / 1e3
    with pytest.raises(DataError, match="constant"):
        identify_plant(np.zeros(400), t, 1e-3)
    with pytest.raises(DataError, match="no resonance"):
        identify_plant((t > 0.05) * 1.0, 1 - np.exp(-np.maximum(t - 0.05, 0) / 0.05), 1e-3)
