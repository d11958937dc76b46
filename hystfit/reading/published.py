"""The entries of the data sets: simulated records installed with hystfit, and public measurements with their checksums."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from hystfit.data.record import Dataset, Record
from hystfit.errors import DataError
from hystfit.outcome import Code
from hystfit.reading.instruments import magnetic_loops, pulse_train, shaking_table
from hystfit.reading.read import read_csv

Reader = Callable[[tuple[Path, ...]], Record | Dataset]
_RAW_ADDRESS = "https://raw.githubusercontent.com/{repository}/{revision}/{path}"


@dataclasses.dataclass(frozen=True)
class Source:
    """Publication of a measured set.

    Attributes:
        folder: name of the set here and in a local folder.
        repository: owner/name.
        revision: commit that the files are taken from.
        license: of the data.
        citation: of the data.
        about: what was measured.
    """

    folder: str
    repository: str
    revision: str
    license: str
    citation: str
    about: str


@dataclasses.dataclass(frozen=True)
class DataFile:
    """One published file.

    Attributes:
        name: in a local folder.
        paths: in the repository, tried in order for files that were moved; none where it holds another format.
        sha256: of the file.
    """

    name: str
    paths: tuple[str, ...]
    sha256: str

    def addresses(self, source: Source) -> list[str]:
        """Addresses of the file at the revision of its source."""
        place = {"repository": source.repository, "revision": source.revision}
        return [_RAW_ADDRESS.format(path=quote(path), **place) for path in self.paths]


@dataclasses.dataclass(frozen=True)
class Measured:
    """One measured record or data set: its files and their reader."""

    source: Source
    files: tuple[DataFile, ...]
    read: Reader
    about: str = ""


@dataclasses.dataclass(frozen=True)
class Bundled:
    """One simulated record that is installed with hystfit."""

    file: str
    about: str


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


def text_reader(
    u: tuple[int | str, str, str], y: tuple[int | str, str, str], *, rate: float | None = None, **options: object
) -> Reader:
    """Reader of one text file.

    Args:
        **options: of `read_csv`.
    """

    def reader(paths: tuple[Path, ...]) -> Record:
        record = read_csv(paths[0], input=u[0], output=y[0], **{"time": False, **options})  # type: ignore[arg-type]
        if isinstance(record, Dataset):
            raise DataError(f"{paths[0]} should hold one record, and holds {len(record)}")
        record = record.replace(u_name=u[1], u_unit=u[2], y_name=y[1], y_unit=y[2])
        if rate is None:
            return record
        timed = record.replace(t=np.arange(len(record)) / rate, t_unit="s")
        return timed.noted(Code.PREPARED, f"time computed from the published rate of {rate:g} samples per s")

    return reader


def _single(source: Source, *rows: tuple[Any, ...]) -> dict[str, Measured]:
    """Entries of one file each: (name, about, SHA-256, reader, paths in the repository or a file name)."""
    entries = {}
    for name, about, sha256, read, *paths in rows:
        known = tuple(path for path in paths if source is not FRICTION)
        file = DataFile(_LOCAL_NAMES.get(name, paths[0].rpartition("/")[2]), known, sha256)
        entries[name] = Measured(source, (file,), read, about)
    return entries


def _magnetic(stem: str, folder: str, field: str, flux: str, about: str) -> dict[str, Measured]:
    """Two matrices of one material, H and B."""
    files = tuple(
        DataFile(f"{letter}_{stem}.mat", (f"{folder}/{letter}_{stem.removesuffix('_APPA')}.mat",), sha256)
        for letter, sha256 in (("H", field), ("B", flux))
    )
    return {f"mag_ja_bh/{stem}": Measured(MAGNETIC, files, magnetic_loops, about)}


_ISOTROPIC = "1_isotropic/Characterisitcs_isotropic_mat"
_PIEZO = text_reader((0, "command", "V"), (4, "displacement", "um"), rate=200.0)
_STRAIN, _STRESS = ("e_true", "strain", ""), ("Sigma_true", "stress", "MPa")
_COUPON = text_reader(_STRAIN, _STRESS)
_TIMED_COUPON = text_reader(_STRAIN, _STRESS, time=1)
_WALL = text_reader((0, "displacement", "mm"), (1, "force", "kN"))
_WALL_REVERSED = text_reader((1, "displacement", "mm"), (0, "force", "kN"))
_SHEAR = text_reader((0, "displacement", ""), (1, "force", ""))
_FRICTION = text_reader(("x_in", "x", "in"), ("F_kip", "F", "kip"), time="t_s")

_LOCAL_NAMES = {"struct_slotboom/chan-albermani": "damper_chan_albermani.csv"}  # others are those of the repository

# fmt: off
ENTRIES: Mapping[str, Bundled | Measured] = {
    "stage-sine": Bundled("stage_sine.csv", "-20..100 V sine on the simulated piezo actuator"),
    "stage-sweep": Bundled("stage_sweep.csv", "sines of falling amplitude: nested minor loops"),
    "stage-step": Bundled("stage_step.csv", "a 100 V step: creep"),
    "stage-staircase": Bundled("stage_staircase.csv", "steps up and down with holds"),
    **_single(
        PIEZO,
        ("piezo_dbo/model", "40 cycles of 1 Hz, 0-3.6 V",
         "672714f09302b892721aa44d72f337a7ee1a0eb1d107f4d6797ab47d849428ae", _PIEZO,
         "MatLabCode/DiscreteBacklashModel/Model_Vi_Do.dat"),
        ("piezo_dbo/test", "1 Hz, decaying to rest and growing again twice, two holds",
         "6c33cb76d3f6e12f5074626710f71aeb43d8411a5ad0a56469ad01904221aae5", _PIEZO,
         "MatLabCode/DiscreteBacklashModel/Test_Vi_Do_Di.dat"),
    ),
    **_single(
        FORC,
        ("mag_forc_pyforc/FeCo", "one record per curve",
         "19e98501633124e00276f2f1472e006de1897aabc0632dd7caa3b2bdba228245", lambda paths: read_csv(paths[0]),
         "tests/fixtures/hchb_forc",
         "tests/hchb_forc",
         "tests/data/hchb_forc"),
    ),
    **_magnetic(
        "MnZn_ferrite", _ISOTROPIC,
        "37dfe350becbce166d88136344b7d4c3b63e3e05e166ec0f67f99f5771e8357f",
        "283667a4e4b2646a0b5f3e1b46bfa033848e6e04316c1ba88979a94c256783ec",
        "MnZn ferrite, four amplitudes",
    ),
    **_magnetic(
        "MnZn_HP_ferrite", "11_TwoStepSolver/Characteristics_isotropic_mat",
        "b7daba79622f56cff2ba3ab5c1a7f6cf7ea87c10bd06a5ef078ebc15da8cc345",
        "798118cb4770da692dba0de7f226d9714826dd505beb0b4840a5cf5178b80d9d",
        "high-permeability MnZn ferrite, four amplitudes",
    ),
    **_magnetic(
        "M130_27s", "3_mixed/Characterisitcs_mixed_mat",
        "57bec8a75306e06a5e3fb3a51ba56f0c0f5d2c0fe74a7f78401176c0ec5d3e5b",
        "6d26c631fcd8eaeec601c3ad96c4ac29a526c6ee04a876aadd4e9c660c617af0",
        "M130-27s electric steel, three amplitudes",
    ),
    **_magnetic(
        "M130_27s_APPA", "10_APPA/anisotropic/Characterisitcs_anisotropic_mat",
        "1784beb9a8fb48f66db5fd94083c202a5c8fe97c8cbf7d8fe235144674386027",
        "94315e3f6ec2765f50f509d51f3df96c7dd29e839cbcb17089f41e4ac330e3e6",
        "M130-27s electric steel in the easy direction, three amplitudes",
    ),
    **_single(
        STEEL,
        ("steel_resspylab/example_1", "cyclic, one amplitude",
         "716368c9cefa4fa5d295684847da89aaa5be3976f7a110edcd8e4939a13be603", _COUPON,
         "examples/example_1.csv",
         "VC_JupyterNotebook/example_1.csv"),
        ("steel_resspylab/example_2", "cyclic, growing with a mean",
         "c974de3b46a3a226dbd3ab33b98203b55745a03620765875f7381f2dc59fcc0e", _COUPON,
         "examples/example_2.csv",
         "VC_JupyterNotebook/example_2.csv"),
        ("steel_resspylab/example_3", "monotonic: no loop",
         "0a3dcbffc434eeddbb57f4f5edea2915bcdbde4bee334753197186f6962a06ce", _TIMED_COUPON,
         "examples/example_3.csv"),
    ),
    **_single(
        STRUCTURES,
        ("struct_slotboom/u-damper", "U-damper, growing cycles",
         "55200f2a29b2c4ccf80168010dc21977270d32d60076de61ec474ae00612ebe8", _WALL,
         "examples/WTCE Examples/Section 3.1 - Case Study 1/xyTestData.csv",
         "examples/WTCE Examples/Section 3.2 - Case Study 2/xyTestData.csv",
         "examples/04 Fit Analysis Model to Experiment/xyTestData.csv",
         "examples/xyTestData.csv"),
        ("struct_slotboom/hys1", "seismic damper 1, digitized",
         "a3ebe2321a1b22ee18583cb07d9316b4ec468a6cfc0acf63884ec8bd983410d4", _WALL,
         "examples/02 Basic Usage/2.3 Siesmic Damper 1/Hys1.csv",
         "doc/readthedocs/source/examples/02 Basic Usage/2.3 Siesmic Damper 1/Hys1.csv",
         "examples/WTCE Examples/Damper - Chan and Albermani.csv"),
        ("struct_slotboom/hys2", "seismic damper 2, digitized",
         "5f329c68f0b89fc5cffac50646112720c3c2d19bbae02223cc9b3f38a4edf159", _WALL,
         "examples/02 Basic Usage/2.4 Seismic Damper 2/Hys2.csv",
         "doc/readthedocs/source/examples/02 Basic Usage/2.3 Siesmic Damper 1/Hys2.csv"),
        ("struct_slotboom/chan-albermani", "slit damper, digitized (the same numbers as hys1)",
         "a3ebe2321a1b22ee18583cb07d9316b4ec468a6cfc0acf63884ec8bd983410d4", _WALL,
         "examples/WTCE Examples/Damper - Chan and Albermani.csv"),
        ("struct_slotboom/ts1", "timber wall, shear, noisy",
         "40e3936cb941e880e6c5b9aeb30bed1a6d4c939eae6d7b18de7622e52b91da67", _SHEAR,
         "examples/02 Basic Usage/2.2 Hysteresis with Noisey Data/TS1_Experiment_Shear.csv"),
        ("struct_slotboom/ts1-2.5", "timber wall, shear, the first part",
         "857d808fb54d87677b490f1d6cbea96429388801be070ead73b7b754c547c5bf", _SHEAR,
         "examples/03_Wall/TS1_Experiment_Shear_2.5.csv"),
        ("struct_slotboom/spc1", "wall, force in the first column; degrading",
         "ec1fa2a523af4df01599b95e87dab444086f4ef72694016ececd46464d6df1e1", _WALL_REVERSED,
         "examples/WTCE Examples/SPC1.csv"),
        ("struct_slotboom/trial2", "wall; pinching and failure",
         "ad931733df39cfe9d7f581c4686fd49a8ab4a3085f8208c9fdd59168a5085b85", _WALL,
         "test/trial2.csv"),
    ),
    **_single(
        MR_DAMPER,
        ("mr_labcontrol/4.1", "test 4.1",
         "97d7735351c9907159aa3c7038712ec1371685f608eb61d6a793622dad486866", shaking_table,
         "data/data_simulation_4.1_MRdamper.mat"),
        ("mr_labcontrol/4.2", "test 4.2",
         "a607d78cd52a2e7ae0b1059bb08345def8ee0e1913645071d23d74686acc9046", shaking_table,
         "data/data_simulation_4.2_MRdamper.mat"),
        ("mr_labcontrol/4.3", "test 4.3",
         "8a480594f87ad69a1ae11e21eb84c9bedcf0e37807c1c0129ff0ce8d78b08dab", shaking_table,
         "data/data_simulation_4.3_MRdamper.mat"),
        ("mr_labcontrol/4.4", "test 4.4",
         "fd4be6ad437614c8e68ed459f1f4172d28c4f448444b5df579ed3aaaf8f8fd90", shaking_table,
         "data/data_simulation_4.4_MRdamper.mat"),
        ("mr_labcontrol/ensaio.A.1", "test A.1",
         "491b7bb96f9206f98a1428eec3fe7031d6de96151bd035aff5f8a1353488fdf1", shaking_table,
         "data/ensaio.A.1.mat"),
        ("mr_labcontrol/ensaio.vali.1", "test vali.1",
         "3f059800d5175f2fe946485b4b77cde158f683966a39fa5f7aed71e08a30853d", shaking_table,
         "data/ensaio.vali.1.mat"),
    ),
    **_single(
        FERROELECTRIC,
        ("ferro_hzo_forc/3V", "reversal curves up to 3 V",
         "31c7824908b146ec62d81b8827f7455e946e87d4d46fae08504d60e596e70e76", pulse_train,
         "+ferroelectric/+FORC/FORC_+3V_4m.csv"),
    ),
    **_single(
        FRICTION,
        ("friction_brfd/0.5Hz", "0.5 Hz, 30 lb tension 1.5 inch",
         "bfc94edd765e046fa851ba3a401e56dede7a632484a9318d7aed6fa9986d859c", _FRICTION,
         "friction_brfd_0.5Hz30lbtension1.5amplitude.csv"),
        ("friction_brfd/1Hz", "1 Hz, 30 lb tension 1 inch",
         "bcf7722513a879e94f057856c49cc20a81f2d013a1611def296ea54bb210d6f9", _FRICTION,
         "friction_brfd_1Hz30lbtension1amplitude.csv"),
        ("friction_brfd/2Hz", "2 Hz, 30 lb tension 0.5 inch",
         "9290051219ee8ab3d9da9139b69650e101308b8dcd4269f3c9fd0f95c14b9464", _FRICTION,
         "friction_brfd_2Hz30lbtension0.5amplitude.csv"),
        ("friction_brfd/KocaeliDBE", "KocaeliDBE",
         "83a882dc61f0ab3719ddb4d2ae23ac580bf87a37c8b91aa6395d54b7cd7d2afe", _FRICTION,
         "friction_brfd_KocaeliDBE.csv"),
    ),
}
# fmt: on
