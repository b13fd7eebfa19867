"""The page's files for a bin: a thumbnail, a script of attempts, and a script for each scan."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ....base.errors import GraycastError
from ....base.file_limits import refuse_large_picture
from ....robot.pick.results.pick_files import (
    BINS,
    DEPTH_STEP_M,
    EPISODE,
    MOTION,
    WORK,
    StoredEpisode,
)
from ....robot.pick.results.replay import Motion, open_replay, read_motions
from ..page.packing import jpeg, jpeg_url, pack_words, receiving, shrunk
from ..page.pieces import stamp_of
from .bodies import packed_places, placed

_FORM = "2"  # version of the files; a change makes the files of all bins outdated
_QUALITY = 85
_THUMB_PX = 480
_ATTEMPT_KEYS = (
    "outcome", "detail", "targets", "part", "kind", "score", "pose_error", "least_factor",
    "seconds", "present",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class BinPiece:
    """A bin in a folder of picks; for `cell_folder`, see the argument `folder` of `open_replay`."""

    out: Path
    cell_folder: Path
    episode: StoredEpisode
    width_px: int

    @property
    def key(self) -> str:
        return bin_key(self.episode.bin_id)

    @property
    def folder(self) -> Path:
        return self.out / BINS / f"{self.episode.bin_id:06d}"

    def stamp(self) -> str:
        return stamp_of(f"picks {_FORM} {self.width_px}", self.folder, (EPISODE, MOTION, WORK))

    def files(self) -> Iterator[tuple[str, bytes]]:
        """Yield the files; raise GraycastError if a file of the bin is missing or damaged."""
        replay = open_replay(self.out, folder=self.cell_folder)
        episode, motions = self.episode, read_motions(replay, self.episode)
        still = replay.T_world_limb(replay.robot.home)
        timed = zip(episode.attempts, episode.work_s, strict=True)
        attempts = [_attempt_record(attempt, work_s) for attempt, work_s in timed]
        content = {"key": self.key, "kinds": replay.kinds(episode), "attempts": attempts}
        yield "scene.js", receiving(content)
        if motions:
            yield "thumb.jpg", jpeg(shrunk(self._picture(0), _THUMB_PX), _QUALITY)
        for number, motion in enumerate(motions):
            name = f"attempt-{number:03d}.js"
            content = {"key": f"{self.key}/{name}", **self._record(number)}
            yield name, receiving({**content, "motion": _packed_motion(motion, still)})
            still = still if motion is None else motion.T_world_limb[-1]

    def _record(self, number: int) -> dict[str, Any]:
        depth = read_image(self.folder / "depth" / f"{number:03d}.png")
        if depth.dtype != np.uint16 or depth.ndim != 2:
            raise GraycastError(f"{self.folder}/depth/{number:03d}.png: holds no depth")
        stride = -(-depth.shape[1] // self.width_px)
        thin = np.ascontiguousarray(depth[::stride, ::stride])
        return {
            "stride": stride,
            "width": thin.shape[1],
            "height": thin.shape[0],
            "depth_scale_mm": 1e3 * DEPTH_STEP_M,
            "depth": pack_words(thin),
            "picture": jpeg_url(shrunk(self._picture(number), thin.shape[1]), _QUALITY),
        }

    def _picture(self, number: int) -> np.ndarray:
        return read_image(self.folder / "pictures" / f"{number:03d}.png")[..., ::-1]


def bin_key(bin_id: int) -> str:
    return f"bin-{bin_id:06d}"


def read_image(path: Path) -> np.ndarray:
    """Read an image; raise GraycastError if it is missing or damaged."""
    if path.is_file():
        refuse_large_picture(path, str(path), GraycastError)
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise GraycastError(
            f"{path}: cannot be read: remove the bin's folder and run graycast robot pick again"
        )
    return image


def _attempt_record(attempt: Mapping[str, Any], work_s: Mapping[str, float]) -> dict[str, Any]:
    places = placed(np.array(attempt["T_world_part"], dtype=float).reshape(-1, 4, 4))
    return {
        **{name: attempt[name] for name in _ATTEMPT_KEYS},
        "work_s": {stage: round(seconds, 4) for stage, seconds in work_s.items()},
        "parts": np.round(places, 5).tolist(),
    }


def _packed_motion(motion: Motion | None, still: np.ndarray) -> dict[str, Any]:
    """Return a motion for the page; if the arm does not move, it has a single time step."""
    if motion is None:
        return {"time_s": [0.0], "limbs": packed_places(still[None]), "part": None}
    return {
        "time_s": np.round(motion.time_s, 4).tolist(),
        "limbs": packed_places(motion.T_world_limb),
        "grip": motion.grip,
        "carrier": motion.carrier,
        "part": motion.part,
        "held_until_s": motion.held_until_s,
    }
