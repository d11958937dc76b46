"""The simulated stage against closed forms, plain loops and its own declared numbers."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hystfit as hf
from hystfit import BoucWen, signals, simulate
from hystfit.control import invert
from hystfit.data.record import Record
from hystfit.errors import DataError, ParameterError
from hystfit.identify import Ukf
from hystfit.outcome import Code
from hystfit.stage import (
    Actuator,
    Amplifier,
    Kinematics,
    Sensor,
    Stage,
    axis_plant,
    drive_in_turn,
    identify_jacobian,
    perturbed,
    piezo,
    population,
    track_adaptively,
)

IDEAL = Sensor(noise=0.0, resolution=0.0)


def test_the_surrogate_has_the_published_loop():
    """Hysteresis alone, by an ODE solver on the paper's equation: 13 um, 2.4 um wide at 40 V."""
    c, mu, tau, delta = 0.1542, 0.45, 0.01086, 0.00956

    def loop(start, turns):
        volts, states, h = [], [], start
        for a, b in itertools.pairwise(turns):
            s = np.sign(b - a)
            law = lambda x, q, s=s: [s * (mu * c) - s * tau * s * np.sign(q[0]) * np.abs(q[0]) - s * delta * abs(q[0])]
            out = solve_ivp(law, (0, abs(b - a)), [h], rtol=1e-10, atol=1e-12, dense_output=True, max_step=1.0)
            x = np.linspace(0, abs(b - a), 241)
            volts.append(a + s * x)
            states.append(out.sol(x)[0])
            h = out.y[0, -1]
        return volts, states

    volts, states = loop(0.0, [0, 100, -20, 100, -20, 100])
    y = [c * v - h for v, h in zip(volts, states, strict=True)]
    assert np.ptp(y[-1]) == pytest.approx(13.0, abs=0.1)
    down, up = (
        np.interp(40.0, *((v, w) if v[0] < v[-1] else (v[::-1], w[::-1])))
        for v, w in zip(volts[-2:], y[-2:], strict=True)
    )
    assert down - up == pytest.approx(2.40, abs=0.02)
    assert max(np.max(np.abs(h)) for h in states) < mu * c / (tau + delta)
    drive = jnp.asarray(np.concatenate(volts))
    ours, _ = simulate(piezo().parts[0], drive)
    np.testing.assert_allclose(ours, np.concatenate(y), atol=1e-7)


def test_a_step_creeps_logarithmically():
    t = np.concatenate([[0.0], np.geomspace(0.1, 1000, 200)])
    u = np.where(t > 0, 100.0, 0.0)
    y = Actuator(sensor=IDEAL).displacement(t, u)
    first = y[1]
    np.testing.assert_allclose(y[1:], first * (1 + 0.0175 * np.log10(t[1:] / 0.1)), rtol=1e-4)
    assert y[-1] - first == pytest.approx(0.8, abs=0.1)  # the paper's figure 4


def test_creep_may_depend_on_the_displacement():
    t = np.concatenate([[0.0], np.geomspace(0.1, 100, 60)])
    for volts in (30.0, 100.0):
        u = np.where(t > 0, volts, 0.0)
        y = Actuator(model=piezo(gamma=(0.012, 0.006), span=12.0), sensor=IDEAL).displacement(t, u)
        static, _ = simulate(piezo().parts[0], jnp.asarray(u))
        expected = 0.012 + 0.006 * float(static[-1]) / 12.0
        assert (y[-1] / y[1] - 1) / 3 == pytest.approx(expected, rel=1e-3)


def test_noise_resolution_and_limits_are_those_of_the_settings():
    t, u = signals.sine(5.0, 1000.0, frequency=1.0, low=-60.0, high=160.0)
    actuator = Actuator(sensor=Sensor(noise=0.005, resolution=0.001))
    record = actuator.record(t, u, seed=0)
    assert record.u.min() == -20
    assert record.u.max() == 120
    assert [note.code for note in record.notes] == [Code.PREPARED]
    assert Actuator().record(t, np.clip(u, -20, 120), seed=0).notes == ()
    np.testing.assert_allclose(record.y * 1000, np.round(record.y * 1000), atol=1e-9)
    noise = record.y - actuator.displacement(t, u)
    # standard deviation of 5000 readings: 1 % of itself; rounding adds 0.29 nm in quadrature
    assert np.std(noise) == pytest.approx(np.hypot(5e-3, 1e-3 / np.sqrt(12)), rel=0.04)
    assert actuator.record(t, u, seed=0).digest() == record.digest()
    assert actuator.record(t, u, seed=1).digest() != record.digest()


def test_a_finer_run_is_the_same_actuator():
    t, u = signals.random_reversals(2.0, 4000.0, speed=300.0, low=0.0, high=100.0, seed=3)
    actuator = Actuator(sensor=IDEAL)
    fine = actuator.record(t, u, seed=0, every=10)
    coarse = actuator.record(t[::10], u[::10], seed=0)
    # the hysteresis step is exact between reversals; creep lags by less than one coarse sample
    assert np.max(np.abs(fine.y - coarse.y)) < 0.005 * np.ptp(fine.y)
    np.testing.assert_array_equal(fine.u, coarse.u)


def test_bad_numbers_are_refused():
    with pytest.raises(ParameterError, match="low < high"):
        Amplifier(low=1.0, high=1.0)
    with pytest.raises(ParameterError, match="must not be negative"):
        Sensor(noise=-1.0)
    with pytest.raises(DataError, match="one shape"):
        Actuator().record(np.zeros(3), np.zeros(4), seed=0)
    with pytest.raises(ParameterError, match="parameters are"):
        population(piezo(), 3, spread={"alpha": 0.1}, seed=0)
    with pytest.raises(ParameterError, match="leaves the bounds"):
        population(BoucWen(mu=0.9), 500, spread={"mu": 0.5}, seed=0)
    for count, spread in ((0, {"c": 0.1}), (3, {"c": -0.1}), (3, {"c": float("nan")})):
        with pytest.raises(ParameterError, match="at least one device"):
            population(piezo(), count, spread=spread, seed=0)
    with pytest.raises(ParameterError, match="outside its bounds"):
        piezo(mu=2.0)
    with pytest.raises(ParameterError, match="tau must be positive"):
        piezo(tau=0.0)
    with pytest.raises(ParameterError, match="amplification and arm"):
        Stage.of(kinematics=Kinematics(arm=0.0))
    with pytest.raises(ParameterError, match="outside its bounds"):
        Stage.of(modes={"x": (-630.0, 0.02), "y": (630.0, 0.02), "theta": (900.0, 0.02)})
    for dt in (-1.0, np.ones(4), float("nan")):
        with pytest.raises(DataError, match="dt must be a number or of shape"):
            Stage.of().simulate(np.zeros((5, 3)), dt)


def test_a_population_scatters_by_the_given_spread_and_runs_vectorized():
    spread = {"c": 0.05, "mu": 0.02, "gamma": 0.1}
    many = population(piezo(), 400, spread=spread, seed=5)
    hysteresis, creep = many.parts
    for value, center, size in (
        (hysteresis.c, 0.1542, 0.05),
        (hysteresis.mu, 0.45, 0.02),
        (creep.gamma[:, 0], 0.0175, 0.1),
    ):
        # a standard deviation of 400 draws scatters by 3.5 %: four of them
        assert np.std(np.log(np.asarray(value) / center)) == pytest.approx(size, rel=0.15)
    np.testing.assert_array_equal(hysteresis.tau, np.full(400, 0.01086))
    few = population(piezo(), 5, spread=spread, seed=5)
    t, u = signals.sine(1.0, 200.0, low=0.0, high=100.0)
    dt = jnp.diff(jnp.asarray(t), prepend=0.0)
    together = jax.vmap(lambda model: simulate(model, jnp.asarray(u), dt)[0])(few)
    for k in range(5):
        one = jax.tree.map(lambda leaf, k=k: leaf[k], few)
        np.testing.assert_allclose(together[k], simulate(one, jnp.asarray(u), dt)[0], rtol=1e-12)


def test_a_population_gives_records_with_their_truth():
    t, u = signals.sine(1.0, 200.0, low=0.0, high=100.0)
    actuators = Actuator(sensor=Sensor(0.005, 0.0)).population(4, spread={"c": 0.05, "gamma": 0.1}, seed=5)
    data = actuators.records(t, u, seed=0)
    assert [record.name for record in data] == ["device=1", "device=2", "device=3", "device=4"]
    drawn = population(piezo(), 4, spread={"c": 0.05, "gamma": 0.1}, seed=5)
    np.testing.assert_array_equal(actuators.truth["c"], drawn.parts[0].c)
    assert (actuators.units["c"], np.ptp(actuators.truth["mu"])) == ("um/V", 0.0)
    noise = []
    for k, record in enumerate(data):
        model = piezo(c=actuators.truth["c"][k], gamma=actuators.truth["gamma[0]"][k])
        noise.append(record.y - np.asarray(simulate(model, u, np.diff(t, prepend=0.0))[0]))
    assert np.std(noise) == pytest.approx(0.005, rel=0.1)  # 800 samples: 2.5 % standard error
    assert abs(np.corrcoef(noise)[0, 1]) < 0.3  # each device has noise of its own: 4 standard errors


def test_a_population_of_stages_has_actuators_of_its_own():
    t = np.arange(50) / 500.0
    volts = np.stack([50 - 50 * np.cos(2 * np.pi * 10 * t)] * 3, axis=1)
    stages = Stage.of().population(2, spread={"c": 0.05}, seed=3)
    assert len({float(stages.truth[f"c@{k}"][n]) for k in (1, 2, 3) for n in (0, 1)}) == 6
    data = stages.records(t, volts, seed=0, axis="theta")
    again = Stage.of([piezo(c=stages.truth[f"c@{k}"][1]) for k in (1, 2, 3)])
    expected = again.simulate(volts, np.diff(t, prepend=0.0))[:, 2]
    np.testing.assert_allclose(data[1].y, expected, atol=5 * 0.005 / 43 + 0.001)
    assert (data[1].name, data[1].y_unit) == ("device=2", "mrad")
    with pytest.raises(ParameterError, match="an axis is"):
        stages.records(t, volts, seed=0, axis="z")


def test_several_devices_are_refused_where_one_is_needed():
    """These ended in errors of JAX about shapes, or in a stage of four actuators."""
    t, u = signals.sine(1.0, 200.0, low=0.0, high=100.0)
    several, record = population(piezo(), 4, spread={"c": 0.05}, seed=0), Actuator().record(t, u, seed=0)
    attempts = (
        lambda: Actuator(model=several),
        lambda: Stage.of(several),
        lambda: Stage.of([several] * 3),
        lambda: simulate(several, u, 0.005),
        lambda: hf.fit(several, record),
        lambda: population(several, 2, spread={}, seed=0),
    )
    for attempt in attempts:
        with pytest.raises(ParameterError, match="several devices"):
            attempt()
    with pytest.raises(ParameterError, match="seed"):
        population(piezo(), 2, spread={"c": 0.05}, seed=-1)
    for times, volts in ((t, u[:-1]), (t[::-1], u), (t[:, None], u[:, None])):
        for run in (Actuator().displacement, lambda a, b: Actuator().record(a, b, seed=0)):
            with pytest.raises(DataError, match="one shape"):
                run(times, volts)


# -- three axes --------------------------------------------------------------------------------------------------------


def test_jacobian_and_its_closed_inverse():
    kinematics = Kinematics(amplification=6.44, arm=40.0, direction=0.3)
    psi = 0.3 + 2 * np.pi / 3 * np.arange(3)
    extensions = (
        np.stack([np.cos(psi), np.sin(psi), np.full(3, 40.0)], axis=1) / 6.44
    )  # of x, y and theta, as the class has it
    np.testing.assert_allclose(kinematics.jacobian() @ extensions, np.eye(3), atol=1e-12)
    reach = np.abs(np.asarray(Kinematics().jacobian())).sum(axis=1) * 12
    assert reach[0] == pytest.approx(103, abs=0.2)  # the paper's workspace
    assert reach[1] == pytest.approx(89, abs=0.5)
    assert reach[2] == pytest.approx(1.93, abs=0.02)


def test_identification_recovers_the_jacobian():
    t = np.arange(4000) / 1000.0
    length = np.stack([6 + 6 * np.sin(2 * np.pi * f * t) for f in (1.0, 1.3, 1.7)], axis=1)
    truth = Kinematics(amplification=6.2, arm=41.0, direction=0.05)
    rng = np.random.default_rng(0)
    found = identify_jacobian(
        length, np.asarray(truth.pose(jnp.asarray(length))) + [1.0, 2.0, 0.1] + 0.005 * rng.standard_normal((4000, 3))
    )
    pulls = (found.jacobian - np.asarray(truth.jacobian())) / found.stderr
    assert np.max(np.abs(pulls)) < 4
    np.testing.assert_allclose(found.offset, [1.0, 2.0, 0.1], atol=0.002)
    with pytest.raises(ParameterError, match="independently"):
        identify_jacobian(np.repeat(length[:, :1], 3, axis=1), length)
    with pytest.raises(DataError, match="one shape"):
        identify_jacobian(length, length[:, :2])


def test_stage_is_its_parts_in_turn():
    t = np.arange(300) / 10_000.0
    u = np.stack([50 + 40 * np.sin(2 * np.pi * f * t) for f in (20.0, 30.0, 50.0)], axis=1)
    devices = [perturbed(piezo(), c=1 + 0.05 * k, gamma=1 - 0.2 * k) for k in range(3)]
    stage = Stage.of(devices)
    poses = stage.simulate(u)
    dt = jnp.full(300, 1e-4).at[0].set(0.0)
    length = np.stack([simulate(device, jnp.asarray(u[:, k]), dt)[0] for k, device in enumerate(devices)], axis=1)
    static = np.asarray(Kinematics().pose(jnp.asarray(length)))
    for k, (frequency, zeta) in enumerate(((630.0, 0.02), (630.0, 0.02), (900.0, 0.02))):
        w = 2 * np.pi * frequency

        def law(time, z, k=k, w=w, zeta=zeta):
            return [z[1], w * w * (np.interp(time, t, static[:, k]) - z[0]) - 2 * zeta * w * z[1]]

        solved = solve_ivp(law, (0, t[-1]), [static[0, k], 0.0], t_eval=t, rtol=1e-9, atol=1e-9, max_step=5e-5)
        np.testing.assert_allclose(poses[:, k], solved.y[0], atol=1e-5 * np.ptp(static[:, k]))


def test_finer_integration_changes_little_and_limits_hold():
    t = np.arange(300) / 10_000.0
    u = np.stack([50 + 90 * np.sin(2 * np.pi * 20 * t)] * 3, axis=1)
    stage = Stage.of()
    coarse, fine = stage.simulate(u), stage.simulate(u, finer=4)
    # a linear command is clipped at an instant between samples, which the coarse run sees a sample late
    assert np.max(np.abs(coarse - fine)) < 0.002 * np.ptp(fine[:, 2])
    np.testing.assert_allclose(stage.simulate(np.clip(u, -20, 120)), coarse, atol=1e-12)
    with pytest.raises(DataError, match=r"shape \(T, 3\)"):
        stage.simulate(u[:, :2])
    with pytest.raises(ParameterError, match="three actuators"):
        Stage.of([piezo()] * 2)
    with pytest.raises(ParameterError, match="to perturb"):
        perturbed(piezo(), alpha=1.1)


def test_stages_run_vectorized():
    t = np.arange(300) / 10_000.0
    u = jnp.asarray(np.stack([50 - 50 * np.cos(2 * np.pi * 40 * t)] * 3, axis=1))
    dt = jnp.full(300, 1e-4).at[0].set(0.0)
    devices = population(piezo(), 12, spread={"c": 0.03, "gamma": 0.2}, seed=1)
    grouped = jax.tree.map(lambda leaf: leaf.reshape(4, 3, *leaf.shape[1:]), devices)
    repeated = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (4, *jnp.shape(leaf))), Stage.of())
    many = eqx.tree_at(lambda stage: stage.actuators, repeated, grouped)
    together = eqx.filter_jit(jax.vmap(lambda stage: stage.run(u, dt)))(many)
    one = jax.tree.map(lambda leaf: leaf[2], many)
    np.testing.assert_allclose(together[2], one.simulate(u, 1e-4), atol=1e-10)
    assert not np.allclose(together[0], together[2], rtol=1e-3)
    records = Stage.of().records(t, u, seed=0)
    assert [record.y_unit for record in records.values()] == ["um", "um", "mrad"]
    assert np.std(records["x"].y - Stage.of().simulate(u, np.diff(t, prepend=0.0))[:, 0]) == pytest.approx(
        0.005, rel=0.2
    )


def test_a_jacobian_from_records_of_the_stage():
    """Gauges and probes while each actuator moves in turn; the modes rest when the drive is slow."""
    t, u = signals.sine(2.0, 500.0, frequency=1.0, low=0.0, high=100.0)
    times, volts = drive_in_turn(t, u)
    np.testing.assert_allclose(np.diff(times), 0.002, rtol=1e-9)
    for k in range(3):
        turn = slice(1000 * k, 1000 * (k + 1))
        np.testing.assert_array_equal(volts[turn, k], u)
        assert (np.ptp(np.delete(volts[turn], k, axis=1), axis=0) == 0).all()
    truth = Stage.of(kinematics=Kinematics(amplification=6.2, arm=41.0, direction=0.05))
    measured = truth.measure(times, volts, seed=0)
    found = identify_jacobian(measured.extension, measured.pose)
    np.testing.assert_allclose(found.jacobian, truth.kinematics.jacobian(), rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(truth.records(times, volts, seed=0)["theta"].y, measured.pose[:, 2])
    assert list(measured.columns())[-1] == "theta_mrad"
    again = truth.measure(times, 2 * volts, seed=1)
    assert again.u.max() == 120
    assert (len(measured.notes), len(again.notes)) == (0, 1)
    assert not np.array_equal(again.pose, measured.pose)
    with pytest.raises(DataError, match="rising"):
        truth.measure(times[::-1], volts, seed=0)
    with pytest.raises(ParameterError, match="no sensor 'z'"):
        truth.measure(times, volts, seed=0, sensors={"z": IDEAL})


def test_an_axis_is_the_scaled_actuator():
    t, u = signals.sine(0.2, 2000.0, frequency=10.0, low=0.0, high=100.0)
    dt = jnp.diff(jnp.asarray(t), prepend=0.0)
    whole, _ = simulate(axis_plant(gain=8.0, mode=None), jnp.asarray(u), dt)
    alone, _ = simulate(piezo(), jnp.asarray(u), dt)
    np.testing.assert_allclose(whole, 8.0 * np.asarray(alone), rtol=1e-10)
    with pytest.raises(ParameterError, match="BoucWen and LogCreep"):
        axis_plant(BoucWen())


@pytest.mark.slow
def test_a_filter_in_parallel_with_the_inverse_corrects_the_model():
    plant, dt = axis_plant(mode=None), 2e-3
    wrong = perturbed(plant, c=1.05, mu=0.9, tau=1.2, delta=0.85)
    t = dt * np.arange(3000)
    reference = 40 * (0.6 + 0.4 * np.cos(2 * np.pi * t / 1.7)) * (1 - np.cos(2 * np.pi * t))
    u = invert(wrong, reference, dt, limits=(-20.0, 120.0)).u
    before = Record(u=u, y=np.asarray(simulate(wrong, jnp.asarray(u), jnp.full(u.size, dt))[0]), t=t)
    ukf = Ukf.of(wrong, before, start="model", noise=0.02, prior=0.2, caution=2.0, settling=100.0)
    settings = {"block": 500, "limits": (-20.0, 120.0), "sensor": Sensor(0.02, 0.0), "seed": 0}
    run = track_adaptively(ukf, plant, reference, dt, **settings)
    first, last = (np.max(np.abs(run.error[part])) for part in (slice(0, 500), slice(-500, None)))
    assert first > 1.0
    assert last < 0.1 * first
    assert float(run.models[0].parts[0].c) == pytest.approx(float(plant.parts[0].c), rel=0.01)
    with pytest.raises(DataError, match="T >= block"):
        track_adaptively(ukf, plant, reference[:10], dt, **settings)
    for wrong_dt, finer in ((0.0, 10), (dt, 0)):
        with pytest.raises(DataError, match="dt and finer must be positive"):
            track_adaptively(ukf, plant, reference, wrong_dt, finer=finer, **settings)
