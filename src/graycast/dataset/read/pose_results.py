"""Estimated poses, and BOP's results files that store them."""

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...base.errors import GraycastError
from ...base.frames import is_rigid, rigid
from ...base.tables import csv_text
from ..files.records import MM_PER_M

HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
ROTATION_TOLERANCE = 1e-3  # Files hold few digits, so R's entries may be off by this.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseEstimate:
    """One estimated pose.

    Attributes:
        T_cam_part: transform from the part to the camera frame [m].
        time_s: time for all poses of the picture together; -1 if unknown.
    """

    scene_id: int
    im_id: int
    obj_id: int
    score: float
    T_cam_part: Float[np.ndarray, "4 4"]
    time_s: float = -1.0

    def __post_init__(self) -> None:
        self.T_cam_part.flags.writeable = False


def pose_results_text(estimates: Sequence[PoseEstimate]) -> str:
    """Return BOP's results file: R by rows, t [mm], with enough digits to read back each number.

    Source: https://bop.felk.cvut.cz/challenges, "Formatting guidelines" of the localization task.
    """
    rows = []
    for one in estimates:
        R = " ".join(repr(float(x)) for x in one.T_cam_part[:3, :3].ravel())
        t = " ".join(repr(float(x) * MM_PER_M) for x in one.T_cam_part[:3, 3])
        score, time_s = repr(float(one.score)), repr(float(one.time_s))
        rows.append([one.scene_id, one.im_id, one.obj_id, score, R, t, time_s])
    return csv_text(HEADER, rows)


def read_pose_results(path: Path) -> list[PoseEstimate]:
    """Read the poses of a results file, in the order of its rows.

    Raises:
        GraycastError: the file is missing, has another header, or has a row that is not a pose;
            the text names the row, the value and the remedy.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise GraycastError(f"{path}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise GraycastError(f"{path}: is not text: give a CSV file of BOP results") from error
    rows = list(csv.reader(lines))
    if not rows or tuple(cell.strip() for cell in rows[0]) != HEADER:
        raise GraycastError(
            f"{path}: does not begin with the line {','.join(HEADER)}: give a CSV file of BOP "
            "results"
        )
    estimates = [
        _estimate(row, f"{path}: line {n}") for n, row in enumerate(rows[1:], start=2) if row
    ]
    _check_times(path, estimates)
    return estimates


def _estimate(row: list[str], where: str) -> PoseEstimate:
    if len(row) != len(HEADER):
        raise GraycastError(
            f"{where} has {len(row)} cells, not {len(HEADER)}: numbers of R and of t are separated "
            "by spaces, cells by commas"
        )
    cell = dict(zip(HEADER, row, strict=True))
    ids = {name: _whole(cell[name], f"{where}: {name}") for name in HEADER[:3]}
    score = _numbers(cell["score"], 1, f"{where}: score")[0]
    time_s = _numbers(cell["time"], 1, f"{where}: time")[0]
    if time_s < 0 and time_s != -1:
        raise GraycastError(
            f"{where}: time is {time_s}; give seconds, or -1 if the time is not known"
        )
    R = np.array(_numbers(cell["R"], 9, f"{where}: R")).reshape(3, 3)
    t_m = np.array(_numbers(cell["t"], 3, f"{where}: t")) / MM_PER_M
    T = rigid(R, t_m)
    if not is_rigid(T, ROTATION_TOLERANCE):
        raise GraycastError(
            f"{where}: R is not a rotation: give nine numbers row by row that are orthonormal "
            "with determinant 1"
        )
    return PoseEstimate(**ids, score=score, T_cam_part=T, time_s=time_s)


def _whole(text: str, where: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if value < 0:
        raise GraycastError(f"{where} is {text!r}; it must be a whole number of at least 0")
    return value


def _numbers(text: str, count: int, where: str) -> list[float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers between spaces"
        raise GraycastError(f"{where} is {text!r}; it must be {wanted}")
    return values


def _check_times(path: Path, estimates: Sequence[PoseEstimate]) -> None:
    """Refuse poses of one picture with different times: BOP's time is the picture's time."""
    known: dict[tuple[int, int], float] = {}
    for one in estimates:
        image = (one.scene_id, one.im_id)
        if known.setdefault(image, one.time_s) != one.time_s:
            raise GraycastError(
                f"{path}: scene {image[0]}, image {image[1]} has the times {known[image]} and "
                f"{one.time_s}: each row must state the time of the whole picture"
            )
