"""`hystfit simulate stage`: training records of one actuator and of the three-axis stage, every signal, and what it refuses."""

import json

import numpy as np
import pytest

import hystfit as hf
from hystfit import signals
from hystfit.cli import run
from hystfit.stage import Kinematics, identify_jacobian


@pytest.mark.parametrize("name", sorted(signals.SIGNALS))
def test_every_signal_drives_the_stage(name, tmp_path):
    out = tmp_path / "data.csv"
    assert run(["simulate", "stage", "--signal", name, "--out", str(out)]) == 0
    record = hf.read_csv(out, time="t", input="u", output="y")
    assert (record.u_unit, record.y_unit, record.t_unit) == ("V", "um", "s")
    assert record.u.min() >= -20
    assert np.ptp(record.u) > 100  # the stage's range is used where no limits are given
    header = out.read_text().splitlines()[0]
    assert header == ("t_s,u_V,y_um,curve" if name == "forc-protocol" else "t_s,u_V,y_um")


def test_reversal_curves_are_numbered_and_sampled_evenly(tmp_path):
    drive = ["--signal", "forc-protocol", "--curves", "4", "--points", "20", "--rate", "50", "--low", "0"]
    assert run(["simulate", "stage", *drive, "--out", str(tmp_path)]) == 0
    t, u, _, curve = np.loadtxt(tmp_path / "data.csv", delimiter=",", skiprows=1).T
    expected = signals.forc_protocol(curves=4, points=20, low=0.0, high=100.0)
    np.testing.assert_allclose(u, expected[0], rtol=1e-9)
    np.testing.assert_array_equal(curve, expected[1])
    np.testing.assert_allclose(np.diff(t), 0.02, rtol=1e-9)
    assert json.loads((tmp_path / "result.json").read_text())["signal"]["rate"] == 50


def test_numbers_written_as_counts_and_commands_beyond_the_limits(tmp_path, capsys):
    drive = ["--signal", "amplitude-sweep", "--cycles", "3", "--high", "150"]
    assert run(["simulate", "stage", *drive, "--out", str(tmp_path / "x.csv"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert [note["code"] for note in content["notes"]] == ["prepared"]  # the amplifier clips the command
    assert content["range"]["u"][1] < 150


def test_three_axes_are_enough_to_calibrate_from(tmp_path):
    """The file alone gives the Jacobian; the same seed gives the same file, another one other noise."""
    drive = ["simulate", "stage", "--axes", "3", "--duration", "2", "--seed", "5", "--out"]
    assert run([*drive, str(tmp_path)]) == 0
    header = (tmp_path / "data.csv").read_text().splitlines()[0]
    assert header == "t_s,u1_V,u2_V,u3_V,extension1_um,extension2_um,extension3_um,x_um,y_um,theta_mrad"
    table = np.loadtxt(tmp_path / "data.csv", delimiter=",", skiprows=1)
    assert table.shape == (3 * 400, 10)
    found = identify_jacobian(table[:, 4:7], table[:, 7:])
    # the 630 Hz modes ring where a turn begins, so that pulls are those of more than the sensors' noise
    np.testing.assert_allclose(found.jacobian, Kinematics().jacobian(), rtol=0.01, atol=0.01)
    content = json.loads((tmp_path / "result.json").read_text())
    assert (content["schema"], content["axes"], content["drive"]) == ("hystfit.simulate/1", 3, "in-turn")
    assert content["range"]["u3_V"] == pytest.approx([-20, 100], abs=0.01)
    assert run([*drive, str(tmp_path / "again.csv")]) == 0
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "data.csv").read_text()
    drive[drive.index("5")] = "6"
    assert run([*drive, str(tmp_path / "other.csv")]) == 0
    other = np.loadtxt(tmp_path / "other.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(other[:, :4], table[:, :4])
    # the difference of two readings of 5 nm (and 1 nm steps), 1200 of them: 4 standard deviations
    assert np.std(other[:, 7] - table[:, 7]) == pytest.approx(7.1e-3, rel=0.09)


def test_one_actuator_of_three_and_all_together(tmp_path):
    common = ["simulate", "stage", "--axes", "3", "--noise", "0", "--set", "gamma=0", "--duration", "1", "--out"]
    poses = {}
    for drive in ("1", "2", "3", "together"):
        out = tmp_path / f"{drive}.csv"
        assert run([*common, str(out), "--drive", drive]) == 0
        table = np.loadtxt(out, delimiter=",", skiprows=1)
        moved = np.ptp(table[:, 1:4], axis=0) > 0
        assert moved.sum() == (3 if drive == "together" else 1)
        poses[drive] = table[:, 7:] - table[0, 7:]
    # without creep and far below the modes the pose is the sum of what each actuator does; readings have steps of 1 nm
    np.testing.assert_allclose(poses["1"] + poses["2"] + poses["3"], poses["together"], atol=0.01)
    assert np.ptp(poses["together"][:, 2]) > 1.9  # all together only turn the platform
    assert np.ptp(poses["together"][:, :2]) < 0.01


def test_a_population_is_one_file_with_its_truth_beside(tmp_path):
    drive = [
        "simulate",
        "stage",
        "--population",
        "3",
        "--spread",
        "c=0.05,mu=0.02",
        "--set",
        "gamma=0",
        "--duration",
        "2",
    ]
    for name in ("all.csv", "all.nc"):
        assert run([*drive, "--out", str(tmp_path / name)]) == 0
    records, same = (hf.read(tmp_path / name, by="device") for name in ("all.csv", "all.nc"))
    assert [record.name for record in records] == ["device=1", "device=2", "device=3"]
    for one, other in zip(records, same, strict=True):
        np.testing.assert_allclose(one.y, other.y, rtol=1e-9)
    table = np.genfromtxt(tmp_path / "all.truth.csv", delimiter=",", names=True, deletechars="")
    fits = hf.fit_many("bouc-wen", tmp_path / "all.csv", starts=1, reading={"by": "device"})
    for name, column in (("c", "c_[um/V]"), ("mu", "mu")):
        errors = np.array([row.stderr[name] for row in fits])
        assert np.all(np.abs(fits.values(name) - table[column]) < 5 * errors)
        assert np.ptp(table[column]) > 5 * errors.max()  # the devices differ


def test_a_population_of_stages_has_all_channels(tmp_path):
    drive = ["--axes", "3", "--drive", "together", "--population", "2", "--spread", "c=0.05", "--duration", "1"]
    assert run(["simulate", "stage", *drive, "--noise", "0", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "data.csv").read_text().startswith("device,t_s,u1_V,")
    table = np.loadtxt(tmp_path / "data.csv", delimiter=",", skiprows=1)
    truth = np.genfromtxt(tmp_path / "truth.csv", delimiter=",", names=True, deletechars="")
    assert table.shape == (400, 11)
    stroke = [[np.ptp(table[table[:, 0] == device][:, 5 + k]) for k in range(3)] for device in (1, 2)]
    slopes = np.array([[truth[f"c@{k}_[um/V]"][n] for k in (1, 2, 3)] for n in (0, 1)])
    np.testing.assert_allclose(stroke / slopes, np.mean(stroke / slopes), rtol=1e-3)  # the model is linear in c
    content = json.loads((tmp_path / "result.json").read_text())
    assert (content["population"], content["spread"]) == (2, {"c": 0.05})


BAD = [
    (["--population", "0"], "at least one device"),
    (["--spread", "c=0.1"], "--population"),
    (["--population", "2", "--spread", "c"], "--spread c"),
    (["--population", "2", "--spread", "beta=0.1"], "'beta'"),
    (["--axes", "2"], "--axes"),
    (["--drive", "2"], "--axes 3"),
    (["--axes", "3", "--drive", "4"], "in-turn, together, 1, 2 or 3"),
    (["--axes", "3", "--set", "gamma=4"], "gamma"),
    (["--axes", "3", "--set", "beta=4"], "'beta'"),
    (["--noise", "nan"], "--noise"),
    (["--seed", "-1"], "--seed"),
    (["--signal", "forc-protocol", "--rate", "0"], "--rate"),
    (["--signal", "random-reversals", "--speed", "fast"], "--speed"),
    (["--signal", "multisine", "--frequencies", "low"], "frequencies"),
    (["--signal", "amplitude-sweep", "--cycles", "2.5"], "2.5"),
]


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(("arguments", "name"), BAD)
def test_bad_input_is_refused(arguments, name, tmp_path, capsys):
    out = tmp_path / "x.csv"
    assert run(["simulate", "stage", *arguments, "--out", str(out)]) == 2
    assert name in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("option", [["--axes", "3"], ["--population", "3"]])
def test_a_model_has_no_axes_and_no_population(option, tmp_path, capsys):
    assert run(["simulate", "bouc-wen", *option, "--out", str(tmp_path / "x.csv")]) == 2
    assert "bouc-wen" in capsys.readouterr().err


def test_the_rest_state_precedes_training_and_test_records(tmp_path):
    from hystfit.cli.options import Reading, Split
    from hystfit.cli.records import train_and_test

    out = tmp_path / "x.csv"
    assert run(["simulate", "stage", "--duration", "2", "--out", str(out)]) == 0
    train, test = train_and_test([str(out)], Reading(), Split(rest=-20.0, window=":1", test_window="1:"))
    assert test is not None
    for record in (train[0], test[0]):
        assert (record.u[0], len(record), record.used.sum()) == (-20.0, 401, 200)
        assert np.isnan(record.y[0])
    assert run(["fit", str(out), "--model", "bouc-wen", "--rest", "nan", "--out", str(tmp_path / "fit")]) == 2
