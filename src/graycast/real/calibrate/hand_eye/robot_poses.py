"""Files of robot poses: CSV with units in its header, or YAML and JSON with matrices."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ....base.errors import ConfigError
from ....base.frames import is_rigid, rigid
from ....base.settings import parse_yaml, read_text
from ..board import CalibrationError

CONVENTION = (
    "T_base_tool, which maps coordinates of the tool to coordinates of the robot's base: a CSV "
    "file with the columns x_m,y_m,z_m and qx,qy,qz,qw (quaternion) or rx_rad,ry_rad,rz_rad "
    "(rotation vector), and optionally scan (x_mm and rx_deg are allowed, too), or a YAML or JSON "
    "file with the key T_base_tool: 4 x 4 matrices in metres by the names of the scans or in their "
    "order"
)
TURNS = {"quaternion": ("qx", "qy", "qz", "qw"), "rotation vector": ("rx", "ry", "rz")}
EULER = ("roll", "pitch", "yaw", "a", "b", "c", "w", "p", "r", "alpha", "beta", "gamma")
FARTHEST_M = 20.0  # A robot's tool is not farther from its base.
ROUNDING = 5e-3  # A matrix or a quaternion with few decimals is rounded, and then made rigid.


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPoses:
    """Poses of the tool in the order of the file; `names` are those of the scans, if stated.

    `readings` has the poses under other conventions that the numbers of the file may have, such as
    degrees. They serve to name a mistake.
    """

    names: tuple[str, ...] | None
    T_base_tool: Float[np.ndarray, "n 4 4"]
    readings: Mapping[str, Float[np.ndarray, "n 4 4"]]

    def of(self, scans: Sequence[str], path: Path) -> "RobotPoses":
        """Return the poses of the scans, in their order.

        Raises:
            CalibrationError: scans and poses differ in number, or a name has no counterpart.
        """
        if self.names is None:
            if len(scans) != len(self.T_base_tool):
                raise CalibrationError(
                    f"{path} has {len(self.T_base_tool)} poses, and there are {len(scans)} scans: "
                    "give one pose for each scan, or name the scan of each pose (column scan)"
                )
            return self
        if missing := [name for name in scans if name not in self.names]:
            raise CalibrationError(
                f"{path} has no pose for the scan {missing[0]}"
                f"{f' and {len(missing) - 1} more' if missing[1:] else ''}: add it, or move the "
                f"scan to another folder (the file names {', '.join(self.names[:3])}...)"
            )
        return self.only(scans, self.names)

    def only(self, subset: Sequence[str], scans: Sequence[str]) -> "RobotPoses":
        """Return the poses of a part of the scans, to which the poses belong in their order."""
        index = [scans.index(name) for name in subset]
        readings = {name: T[index] for name, T in self.readings.items()}
        return RobotPoses(
            names=tuple(subset), T_base_tool=self.T_base_tool[index], readings=readings
        )


def read_poses(path: Path) -> RobotPoses:
    """Read a file of poses; see `CONVENTION`.

    Raises:
        ConfigError: the file has another form, a pose is not rigid, or its unit is another one.
    """
    read = _read_csv if path.suffix.lower() == ".csv" else _read_matrices
    poses = read(path)
    if len(set(poses.names or ())) < len(poses.names or ()):
        raise ConfigError(f"{path}: two poses have the same scan: name each scan once")
    far_m = float(np.abs(poses.T_base_tool[:, :3, 3]).max(initial=0))
    if not far_m < FARTHEST_M:
        raise ConfigError(
            f"{path}: a tool is {far_m:.6g} m from the base, so these are millimetres for metres: "
            "divide them by 1000, or state the unit (columns x_mm,y_mm,z_mm or the line unit: mm)"
        )
    return poses


def _read_csv(path: Path) -> RobotPoses:
    reader = csv.DictReader(io.StringIO(read_text(path)), skipinitialspace=True)
    heads = [head.strip() for head in reader.fieldnames or ()]
    euler = [head for head in heads if re.sub(r"_(deg|rad)$", "", head.lower()) in EULER]
    if euler:
        raise ConfigError(
            f"{path}: the column {euler[0]} is an Euler angle, whose order and axes differ from "
            "robot to robot: export quaternions, rotation vectors or matrices"
        )
    place, scale_m = _columns(heads, ("x", "y", "z"), {"m": 1.0, "mm": 1e-3}, path)
    if all(name in heads for name in TURNS["quaternion"]):
        kind, turn, scale_rad = "quaternion", list(TURNS["quaternion"]), 1.0
    else:
        kind = "rotation vector"
        turn, scale_rad = _columns(heads, TURNS[kind], {"rad": 1.0, "deg": np.pi / 180}, path)
    rows, scans = [], list[str]()
    for i, row in enumerate(reader, 2):
        try:
            rows.append([float(row[head]) for head in (*place, *turn)])
        except (TypeError, ValueError, KeyError) as error:
            raise ConfigError(f"{path}: line {i} lacks a number: correct it") from error
        scans.append(str(row.get("scan")).strip())
    names = tuple(scans) if "scan" in heads else None
    table = np.array(rows).reshape(-1, 3 + len(turn))
    if not np.isfinite(table).all():
        raise ConfigError(f"{path}: a number is not finite: correct it")
    return _with_readings(names, scale_m * table[:, :3], scale_rad * table[:, 3:], kind, path)


def _columns(heads, names, units: Mapping[str, float], path: Path):
    """Return the columns of three numbers and their unit; refuse columns without a unit."""
    for unit, scale in units.items():
        columns = [f"{name}_{unit}" for name in names]
        if all(column in heads for column in columns):
            return columns, scale
    raise ConfigError(
        f"{path}: the columns are {', '.join(heads) or 'empty'}: give {CONVENTION.split(': ')[1]}"
    )


def _with_readings(names, place_m, turn, kind: str, path: Path) -> RobotPoses:
    """Return the poses, with the other readings of their rotations."""
    if kind == "quaternion":
        length = np.linalg.norm(turn, axis=1)
        if np.abs(length - 1).max(initial=0) > ROUNDING:
            raise ConfigError(
                f"{path}: a quaternion has the length {length[np.abs(length - 1).argmax()]:.4g}, "
                "and 1 is needed: check the columns"
            )
        wrong = {"the quaternions have w first": Rotation.from_quat(turn[:, [1, 2, 3, 0]])}
        right = Rotation.from_quat(turn)
    else:
        longest = float(np.linalg.norm(turn, axis=1).max(initial=0))
        if longest > 2 * np.pi * (1 + ROUNDING):
            raise ConfigError(
                f"{path}: a rotation vector has the length {longest:.4g}, which is more than a "
                "turn of 6.28 rad, so these are degrees for radians: name the columns "
                "rx_deg,ry_deg,rz_deg"
            )
        wrong = {"the rotation vectors are degrees": Rotation.from_rotvec(np.radians(turn))}
        right = Rotation.from_rotvec(turn)

    def poses(rotation: Rotation) -> Float[np.ndarray, "n 4 4"]:
        pairs = zip(rotation.as_matrix(), place_m, strict=True)
        return np.array([rigid(R, t) for R, t in pairs]).reshape(-1, 4, 4)

    return RobotPoses(
        names=names,
        T_base_tool=poses(right),
        readings={name: poses(rotation) for name, rotation in wrong.items()},
    )


def _read_matrices(path: Path) -> RobotPoses:
    content = parse_yaml(read_text(path), path)
    unit = content.get("unit", "m")
    listed = content.get("T_base_tool")
    if unit not in ("m", "mm") or not isinstance(listed, Mapping | list):
        raise ConfigError(f"{path}: has no poses under the key T_base_tool: give {CONVENTION}")
    names, values = None, list(listed)
    if isinstance(listed, Mapping):
        names, values = tuple(str(name) for name in listed), list(listed.values())
    poses = []
    for i, value in enumerate(values):
        try:
            T = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            T = np.empty(0)
        if T.shape != (4, 4) or not is_rigid(T, ROUNDING):
            raise ConfigError(
                f"{path}: pose {names[i] if names else i + 1} is not a rigid transform: give 4 x 4 "
                "numbers with a rotation at the left and the last row 0 0 0 1"
            )
        T[:3, :3] = Rotation.from_matrix(T[:3, :3]).as_matrix()
        T[:3, 3] *= 1e-3 if unit == "mm" else 1.0
        poses.append(T)
    return RobotPoses(names=names, T_base_tool=np.array(poses).reshape(-1, 4, 4), readings={})
