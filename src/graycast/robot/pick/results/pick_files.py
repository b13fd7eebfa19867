"""Picks on disk: a folder with the completed bins of one cell and one seed.

picks.json            the cell and the seed; picks with another cell or seed are refused
bins/000000/
    episode.json      counts, attempts and their outcomes, and the poses of the parts
    motion.json       the arm's joint angles over time, for each attempt
    work.json         computing time of each stage; only this file differs between runs
    pictures/000.png  the camera's picture with the tool's position and the outcome
    depth/000.png     the depth that the robot used, 16 bit, unit `DEPTH_STEP_M`; 0 is missing
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from ....base.errors import DatasetError, GraycastError
from ....base.file_limits import parse_json
from ....base.folder import claimed_folder, new_folder, write_whole
from ....cell.generate import described_scanner
from ....dataset.files.json_text import json_bytes
from ....dataset.write.claim import BESIDE_CONFIG, make_claim, refuse_other
from ..bin.episode import Episode
from ..bin.robot_cell import PickCell

CLAIM, BINS = "picks.json", "bins"
EPISODE, MOTION, WORK = "episode.json", "motion.json", "work.json"
DEPTH_STEP_M = 1e-4
_LOCK = ".lock"


def episode_files(episode: Episode) -> tuple[tuple[str, bytes], ...]:
    """Return the path (inside the bin's folder) and the content of each file of a bin."""
    attempts = episode.attempts
    record = {
        "bin_id": episode.bin_id,
        "kinds": list(episode.kinds),
        "filled": episode.filled,
        "taken": episode.taken,
        "left": episode.left,
        "spilled": episode.spilled,
        "attempts": [attempt.as_dict() for attempt in attempts],
    }
    motion = [
        None
        if attempt.q is None or attempt.time_s is None
        else {
            "time_s": np.round(attempt.time_s, 4).tolist(),
            "q": np.round(attempt.q, 5).tolist(),
        }
        for attempt in attempts
    ]
    files = [
        (EPISODE, json_bytes(record)),
        (MOTION, json_bytes({"attempts": motion})),
        (WORK, json_bytes({"attempts": [attempt.work_s for attempt in attempts]})),
    ]
    for number, image in enumerate(episode.pictures):
        files.append((f"pictures/{number:03d}.png", _png(image[..., ::-1])))
    for number, depth_m in enumerate(episode.depths_m):
        files.append((f"depth/{number:03d}.png", _png(_steps(depth_m))))
    return tuple(files)


def _steps(depth_m: Float[np.ndarray, "h w"]) -> np.ndarray:
    return np.round(np.nan_to_num(depth_m) / DEPTH_STEP_M).clip(0, 65535).astype(np.uint16)


def _png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(image))[1].tobytes()


@dataclass(frozen=True, slots=True, kw_only=True)
class PickFolder:
    """An open folder of picks, locked against other runs."""

    out: Path

    def finished(self) -> set[int]:
        return {int(bin_.name) for bin_ in (self.out / BINS).iterdir() if bin_.name.isdecimal()}

    def write(self, bin_id: int, files: Sequence[tuple[str, bytes]]) -> None:
        """Write one bin completely or not at all.

        Raises:
            GraycastError: a file cannot be written, or the bin exists already.
        """
        with new_folder(self.out / BINS / f"{bin_id:06d}") as folder:
            for name, content in files:
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)


@contextmanager
def open_picks(out: Path, cell: PickCell, *, seed: int) -> Iterator[PickFolder]:
    """Create a folder of picks, or open it again to continue with the same cell and seed.

    Raises:
        DatasetError: the folder holds another cell's picks or other files, or is in use.
    """
    base = cell.cell
    config = cell.config.model_dump(mode="json", exclude={"scenes", "seed"})
    beside = (cell.file_digests, described_scanner(base.scanner))
    config |= dict(zip(BESIDE_CONFIG, beside, strict=True))
    claim = make_claim(config, seed, base.scene.parts, base.scene.rig, 1e3 * DEPTH_STEP_M)
    if out.is_file():
        raise DatasetError(f"{out} is a file: give a folder for the picks")
    if out.is_dir() and not (out / CLAIM).exists():
        rest = [entry.name for entry in out.iterdir() if not entry.name.startswith(".")]
        if rest:
            raise DatasetError(
                f"{out} is not empty and holds no picks (it has {min(rest)}): choose another folder"
            )
    with claimed_folder(out, BINS, _LOCK):
        if (out / CLAIM).exists():
            refuse_other(out / CLAIM, claim)
        else:
            write_whole(out / CLAIM, json_bytes(claim))
        try:
            yield PickFolder(out=out)
        except BaseException:
            _tidy(out)
            raise


def _tidy(out: Path) -> None:
    """Release and remove an output folder in which no bin was finished."""
    with suppress(OSError):
        (out / BINS).rmdir()  # This works only if no bin was finished.
        (out / CLAIM).unlink(missing_ok=True)
        (out / _LOCK).unlink(missing_ok=True)
        out.rmdir()


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredEpisode:
    """The content of a bin's `episode.json` and `work.json`.

    `kinds` has each part's index among the cell's parts; it is empty if the file lacks this key.
    """

    bin_id: int
    filled: int
    taken: int
    left: int
    spilled: int
    kinds: tuple[int, ...]
    attempts: tuple[Mapping[str, Any], ...]
    work_s: tuple[Mapping[str, float], ...]


def read_episodes(out: Path) -> tuple[StoredEpisode, ...]:
    """Read all finished bins of a folder, in the order of their ids.

    Raises:
        GraycastError: the folder contains no picks, or a file is damaged.
    """
    if not (out / CLAIM).is_file():
        raise GraycastError(f"{out}: holds no picks: give a folder that graycast robot pick wrote")
    return tuple(
        _read(folder) for folder in sorted((out / BINS).iterdir()) if folder.name.isdecimal()
    )


def _read(folder: Path) -> StoredEpisode:
    try:
        data = parse_json((folder / EPISODE).read_bytes())
        work = parse_json((folder / WORK).read_bytes())
        return StoredEpisode(
            attempts=tuple(data["attempts"]),
            work_s=tuple(work["attempts"]),
            kinds=tuple(data.get("kinds", ())),
            **{name: int(data[name]) for name in ("bin_id", "filled", "taken", "left", "spilled")},
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise GraycastError(
            f"{folder}: cannot be read ({error}): remove this folder and run graycast robot "
            "pick again"
        ) from error
