"""The public measured sets: where each file is, its checksum, and how it is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError
from hystfit.reading.datasets import File, Measured, Source, uniform_time
from hystfit.reading.instruments import magnetic_loops, pulse_train, reversal_curves, shaking_table

Reader = Callable[[tuple[Path, ...]], Record | Dataset]

PIEZO = Source(
    "piezo_dbo",
    "yan9a/DiscreteBacklashOperator",
    "79fd060d86cdf69be2388e29bf57b0766c273650",
    "MIT",
    "Y. N. Aye and W. T. Ang, A Discrete Backlash Operator for Identification and Compensation of Hysteresis and "
    "Non-linearity for Piezoelectric Micromanipulator, ICSTSD, Yangon, 2018",
    "piezo stack in a flexure, open loop: command in V, displacement in um, 200 Hz",
)
FORC = Source(
    "mag_forc_pyforc",
    "peytondmurray/pyforc",
    "abc3ffb224e4898431d0d93a5fd4ccdcc15c7dc6",
    "MIT",
    "P. D. Murray, pyforc (test data)",
    "FeCo nanowires, vibrating-sample magnetometer, 152 first-order reversal curves: field in Oe, moment in emu",
)
MAGNETIC = Source(
    "mag_ja_bh",
    "romanszewczyk/JAmodel",
    "4bbe905d420ce27c66ee93d8b25ef44b553f9175",
    "MIT",
    "R. Szewczyk, JAmodel",
    "centered B(H) loops of several amplitudes, without time: field in A/m, flux density in T",
)
STEEL = Source(
    "steel_resspylab",
    "AlbanoCastroSousa/RESSPyLab",
    "99657963eca60d7f84445201ec5a47a3f7c63e45",
    "MIT",
    "A. de Castro e Sousa, RESSPyLab",
    "S355J2 steel coupons: true strain, true stress in MPa",
)
STRUCTURES = Source(
    "struct_slotboom",
    "cslotboom/hysteresis",
    "585ca4527358ce1fdd002636662baee415ea5a6f",
    "Apache-2.0",
    "C. Slotboom, hysteresis",
    "seismic dampers and timber walls: displacement in mm, force in kN, without time",
)
MR_DAMPER = Source(
    "mr_labcontrol",
    "labcontrol-data/mr-damper",
    "e42439f08b227bb08e9923ee2736bedf2f4fe59a",
    "MIT",
    "Labcontrol, Universidade Tecnologica Federal do Parana, mr-damper",
    "magneto-rheological damper on a shaking table: position, velocity and force, 100 Hz",
)
FERROELECTRIC = Source(
    "ferro_hzo_forc",
    "ShangHTao/FerroelectricMATLABKit",
    "ef0aad6fc94d2c0dc3f7e5a1e380876784f5643f",
    "MIT",
    "ShangHTao, FerroelectricMATLABKit",
    "9 nm ferroelectric film, pulse train: voltage in V, current in A (integrate it for the charge)",
)
FRICTION = Source(
    "tidy",
    "ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash",
    "0e09aa9d950760277e31c08cd93fd01f39a5af09",
    "CC BY-SA 4.0",
    "ARTS-Laboratory, Dataset-Friction-Damper-with-Backlash",
    "banded rotary friction damper: displacement in inch, force in kip, 1024 Hz (published as JSON, read from CSV)",
)


def _text(
    u: tuple[int | str, str, str], y: tuple[int | str, str, str], *, rate: float | None = None, **options: object
) -> Reader:
    """Reader of one text file: (column, name, unit) of the input and of the output, and options of `read_csv`."""

    def reader(paths: tuple[Path, ...]) -> Record | Dataset:
        from hystfit.reading.read import read_csv

        options.setdefault("time", False)
        record = read_csv(paths[0], input=u[0], output=y[0], **options)  # type: ignore[arg-type]
        if isinstance(record, Dataset):
            raise DataError(f"{paths[0]} should hold one record, and holds {len(record)}")
        record = record.replace(u_name=u[1], u_unit=u[2], y_name=y[1], y_unit=y[2])
        return record if rate is None else uniform_time(record, rate)

    return reader


def _one(
    source: Source, name: str, paths: str | tuple[str, ...], sha256: str, read: Reader, about: str = ""
) -> Measured:
    return Measured(source, (File(name, (paths,) if isinstance(paths, str) else paths, sha256),), read, about)


def _pair(stem: str, folder: str, field: str, flux: str, about: str) -> Measured:
    files = tuple(
        File(f"{letter}_{stem}.mat", (f"{folder}/{letter}_{stem.removesuffix('_APPA')}.mat",), sha256)
        for letter, sha256 in (("H", field), ("B", flux))
    )
    return Measured(MAGNETIC, files, magnetic_loops, about)


_ISOTROPIC = "1_isotropic/Characterisitcs_isotropic_mat"
_DISPLACEMENT, _FORCE = (0, "displacement", "mm"), (1, "force", "kN")
_STRESS = _text(("e_true", "strain", ""), ("Sigma_true", "stress", "MPa"))
_WALL = _text(_DISPLACEMENT, _FORCE)
_FRICTION = _text(("x_in", "x", "in"), ("F_kip", "F", "kip"), time="t_s")

MEASURED: Mapping[str, Measured] = {
    "piezo_dbo/model": _one(
        PIEZO,
        "Model_Vi_Do.dat",
        "MatLabCode/DiscreteBacklashModel/Model_Vi_Do.dat",
        "672714f09302b892721aa44d72f337a7ee1a0eb1d107f4d6797ab47d849428ae",
        _text((0, "command", "V"), (4, "displacement", "um"), rate=200.0),
        "40 cycles of 1 Hz, 0-3.6 V",
    ),
    "piezo_dbo/test": _one(
        PIEZO,
        "Test_Vi_Do_Di.dat",
        "MatLabCode/DiscreteBacklashModel/Test_Vi_Do_Di.dat",
        "6c33cb76d3f6e12f5074626710f71aeb43d8411a5ad0a56469ad01904221aae5",
        _text((0, "command", "V"), (4, "displacement", "um"), rate=200.0),
        "1 Hz, decaying to rest and growing again twice, two holds",
    ),
    "mag_forc_pyforc/FeCo": _one(
        FORC,
        "hchb_forc",
        ("tests/fixtures/hchb_forc", "tests/hchb_forc", "tests/data/hchb_forc"),
        "19e98501633124e00276f2f1472e006de1897aabc0632dd7caa3b2bdba228245",
        reversal_curves,
        "one record per curve",
    ),
    "mag_ja_bh/MnZn_ferrite": _pair(
        "MnZn_ferrite",
        _ISOTROPIC,
        "37dfe350becbce166d88136344b7d4c3b63e3e05e166ec0f67f99f5771e8357f",
        "283667a4e4b2646a0b5f3e1b46bfa033848e6e04316c1ba88979a94c256783ec",
        "MnZn ferrite, four amplitudes",
    ),
    "mag_ja_bh/MnZn_HP_ferrite": _pair(
        "MnZn_HP_ferrite",
        "11_TwoStepSolver/Characteristics_isotropic_mat",
        "b7daba79622f56cff2ba3ab5c1a7f6cf7ea87c10bd06a5ef078ebc15da8cc345",
        "798118cb4770da692dba0de7f226d9714826dd505beb0b4840a5cf5178b80d9d",
        "high-permeability MnZn ferrite, four amplitudes",
    ),
    "mag_ja_bh/M130_27s": _pair(
        "M130_27s",
        "3_mixed/Characterisitcs_mixed_mat",
        "57bec8a75306e06a5e3fb3a51ba56f0c0f5d2c0fe74a7f78401176c0ec5d3e5b",
        "6d26c631fcd8eaeec601c3ad96c4ac29a526c6ee04a876aadd4e9c660c617af0",
        "M130-27s electric steel, three amplitudes",
    ),
    "mag_ja_bh/M130_27s_APPA": _pair(
        "M130_27s_APPA",
        "10_APPA/anisotropic/Characterisitcs_anisotropic_mat",
        "1784beb9a8fb48f66db5fd94083c202a5c8fe97c8cbf7d8fe235144674386027",
        "94315e3f6ec2765f50f509d51f3df96c7dd29e839cbcb17089f41e4ac330e3e6",
        "M130-27s electric steel in the easy direction, three amplitudes",
    ),
    "steel_resspylab/example_1": _one(
        STEEL,
        "example_1.csv",
        ("examples/example_1.csv", "VC_JupyterNotebook/example_1.csv"),
        "716368c9cefa4fa5d295684847da89aaa5be3976f7a110edcd8e4939a13be603",
        _STRESS,
        "cyclic, one amplitude",
    ),
    "steel_resspylab/example_2": _one(
        STEEL,
        "example_2.csv",
        ("examples/example_2.csv", "VC_JupyterNotebook/example_2.csv"),
        "c974de3b46a3a226dbd3ab33b98203b55745a03620765875f7381f2dc59fcc0e",
        _STRESS,
        "cyclic, growing with a mean",
    ),
    "steel_resspylab/example_3": _one(
        STEEL,
        "example_3.csv",
        "examples/example_3.csv",
        "0a3dcbffc434eeddbb57f4f5edea2915bcdbde4bee334753197186f6962a06ce",
        _text(("e_true", "strain", ""), ("Sigma_true", "stress", "MPa"), time=1),
        "monotonic: no loop",
    ),
    "struct_slotboom/u-damper": _one(
        STRUCTURES,
        "xyTestData.csv",
        (
            "examples/WTCE Examples/Section 3.1 - Case Study 1/xyTestData.csv",
            "examples/WTCE Examples/Section 3.2 - Case Study 2/xyTestData.csv",
            "examples/04 Fit Analysis Model to Experiment/xyTestData.csv",
            "examples/xyTestData.csv",
        ),
        "55200f2a29b2c4ccf80168010dc21977270d32d60076de61ec474ae00612ebe8",
        _WALL,
        "U-damper, growing cycles",
    ),
    "struct_slotboom/hys1": _one(
        STRUCTURES,
        "Hys1.csv",
        (
            "examples/02 Basic Usage/2.3 Siesmic Damper 1/Hys1.csv",
            "doc/readthedocs/source/examples/02 Basic Usage/2.3 Siesmic Damper 1/Hys1.csv",
            "examples/WTCE Examples/Damper - Chan and Albermani.csv",
        ),
        "a3ebe2321a1b22ee18583cb07d9316b4ec468a6cfc0acf63884ec8bd983410d4",
        _WALL,
        "seismic damper 1, digitized",
    ),
    "struct_slotboom/hys2": _one(
        STRUCTURES,
        "Hys2.csv",
        (
            "examples/02 Basic Usage/2.4 Seismic Damper 2/Hys2.csv",
            "doc/readthedocs/source/examples/02 Basic Usage/2.3 Siesmic Damper 1/Hys2.csv",
        ),
        "5f329c68f0b89fc5cffac50646112720c3c2d19bbae02223cc9b3f38a4edf159",
        _WALL,
        "seismic damper 2, digitized",
    ),
    "struct_slotboom/chan-albermani": _one(
        STRUCTURES,
        "damper_chan_albermani.csv",
        "examples/WTCE Examples/Damper - Chan and Albermani.csv",
        "a3ebe2321a1b22ee18583cb07d9316b4ec468a6cfc0acf63884ec8bd983410d4",
        _WALL,
        "slit damper, digitized (the same numbers as hys1)",
    ),
    "struct_slotboom/ts1": _one(
        STRUCTURES,
        "TS1_Experiment_Shear.csv",
        "examples/02 Basic Usage/2.2 Hysteresis with Noisey Data/TS1_Experiment_Shear.csv",
        "40e3936cb941e880e6c5b9aeb30bed1a6d4c939eae6d7b18de7622e52b91da67",
        _text((0, "displacement", ""), (1, "force", "")),
        "timber wall, shear, noisy",
    ),
    "struct_slotboom/ts1-2.5": _one(
        STRUCTURES,
        "TS1_Experiment_Shear_2.5.csv",
        "examples/03_Wall/TS1_Experiment_Shear_2.5.csv",
        "857d808fb54d87677b490f1d6cbea96429388801be070ead73b7b754c547c5bf",
        _text((0, "displacement", ""), (1, "force", "")),
        "timber wall, shear, the first part",
    ),
    "struct_slotboom/spc1": _one(
        STRUCTURES,
        "SPC1.csv",
        "examples/WTCE Examples/SPC1.csv",
        "ec1fa2a523af4df01599b95e87dab444086f4ef72694016ececd46464d6df1e1",
        _text((1, "displacement", "mm"), (0, "force", "kN")),
        "wall, force in the first column; degrading",
    ),
    "struct_slotboom/trial2": _one(
        STRUCTURES,
        "trial2.csv",
        "test/trial2.csv",
        "ad931733df39cfe9d7f581c4686fd49a8ab4a3085f8208c9fdd59168a5085b85",
        _WALL,
        "wall; pinching and failure",
    ),
    "mr_labcontrol/4.1": _one(
        MR_DAMPER,
        "data_simulation_4.1_MRdamper.mat",
        "data/data_simulation_4.1_MRdamper.mat",
        "97d7735351c9907159aa3c7038712ec1371685f608eb61d6a793622dad486866",
        shaking_table,
        "test 4.1",
    ),
    "mr_labcontrol/4.2": _one(
        MR_DAMPER,
        "data_simulation_4.2_MRdamper.mat",
        "data/data_simulation_4.2_MRdamper.mat",
        "a607d78cd52a2e7ae0b1059bb08345def8ee0e1913645071d23d74686acc9046",
        shaking_table,
        "test 4.2",
    ),
    "mr_labcontrol/4.3": _one(
        MR_DAMPER,
        "data_simulation_4.3_MRdamper.mat",
        "data/data_simulation_4.3_MRdamper.mat",
        "8a480594f87ad69a1ae11e21eb84c9bedcf0e37807c1c0129ff0ce8d78b08dab",
        shaking_table,
        "test 4.3",
    ),
    "mr_labcontrol/4.4": _one(
        MR_DAMPER,
        "data_simulation_4.4_MRdamper.mat",
        "data/data_simulation_4.4_MRdamper.mat",
        "fd4be6ad437614c8e68ed459f1f4172d28c4f448444b5df579ed3aaaf8f8fd90",
        shaking_table,
        "test 4.4",
    ),
    "mr_labcontrol/ensaio.A.1": _one(
        MR_DAMPER,
        "ensaio.A.1.mat",
        "data/ensaio.A.1.mat",
        "491b7bb96f9206f98a1428eec3fe7031d6de96151bd035aff5f8a1353488fdf1",
        shaking_table,
        "test A.1",
    ),
    "mr_labcontrol/ensaio.vali.1": _one(
        MR_DAMPER,
        "ensaio.vali.1.mat",
        "data/ensaio.vali.1.mat",
        "3f059800d5175f2fe946485b4b77cde158f683966a39fa5f7aed71e08a30853d",
        shaking_table,
        "test vali.1",
    ),
    "ferro_hzo_forc/3V": _one(
        FERROELECTRIC,
        "FORC_+3V_4m.csv",
        "+ferroelectric/+FORC/FORC_+3V_4m.csv",
        "31c7824908b146ec62d81b8827f7455e946e87d4d46fae08504d60e596e70e76",
        pulse_train,
        "reversal curves up to 3 V",
    ),
    "friction_brfd/0.5Hz": _one(
        FRICTION,
        "friction_brfd_0.5Hz30lbtension1.5amplitude.csv",
        (),
        "bfc94edd765e046fa851ba3a401e56dede7a632484a9318d7aed6fa9986d859c",
        _FRICTION,
        "0.5 Hz, 30 lb tension 1.5 inch",
    ),
    "friction_brfd/1Hz": _one(
        FRICTION,
        "friction_brfd_1Hz30lbtension1amplitude.csv",
        (),
        "bcf7722513a879e94f057856c49cc20a81f2d013a1611def296ea54bb210d6f9",
        _FRICTION,
        "1 Hz, 30 lb tension 1 inch",
    ),
    "friction_brfd/2Hz": _one(
        FRICTION,
        "friction_brfd_2Hz30lbtension0.5amplitude.csv",
        (),
        "9290051219ee8ab3d9da9139b69650e101308b8dcd4269f3c9fd0f95c14b9464",
        _FRICTION,
        "2 Hz, 30 lb tension 0.5 inch",
    ),
    "friction_brfd/KocaeliDBE": _one(
        FRICTION,
        "friction_brfd_KocaeliDBE.csv",
        (),
        "83a882dc61f0ab3719ddb4d2ae23ac580bf87a37c8b91aa6395d54b7cd7d2afe",
        _FRICTION,
        "KocaeliDBE",
    ),
}
