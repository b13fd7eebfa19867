"""One bin, which is filled by a drop and emptied until it is empty or too many grips fail.

The physics of the drop continues: each part is lifted from among its neighbours, and the other
parts come to rest again before the next scan. After a failed grip, the part stays at its place
or wherever it fell.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from ....base.color import srgb_of_bytes
from ....base.frames import inverse, rigid, transform_points
from ....base.progress import UNWATCHED, ProgressMeter
from ....base.streams import EMPTIED_BIN
from ....cell.simulate import mixed_counts
from ....rendering import Renderer
from ....rig.optics import project
from ....world.drop import drop
from ..arm.ways import Blocked, Ways
from ..outcome import TAKEN, Attempt, Outcome
from .bin_scan import BinScan, scan, targets
from .carry import BinState, carry_out
from .choose import choose
from .clock import Clock
from .pick_sections import PickingSection
from .ready import Ready

POSE_STEP_S = 0.05
_GOOD, _BAD, _PART = (63, 158, 47), (200, 56, 90), (242, 177, 52)
AXIS_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """The record of one emptied bin.

    `filled`, `taken` and `left` are the numbers of parts at the start, taken out by the tool, and
    in the bin at the end; all others fell outside. `pictures` (RGB) and `depths_m` (used by the
    robot) have an entry for each attempt. `kinds` has each part's index among the cell's parts.
    """

    bin_id: int
    kinds: tuple[int, ...]
    attempts: tuple[Attempt, ...]
    pictures: tuple[UInt8[np.ndarray, "h w 3"], ...]
    depths_m: tuple[Float[np.ndarray, "h w"], ...]
    filled: int
    taken: int
    left: int

    @property
    def spilled(self) -> int:
        return self.filled - self.taken - self.left


def empty_bin(
    ready: Ready,
    renderer: Renderer,
    bin_id: int,
    *,
    seed: int,
    progress: ProgressMeter = UNWATCHED,
) -> Episode:
    """Fill a bin, empty it, and return the record.

    Raises:
        DropError: the parts did not come to rest in the bin.
        ValueError: a picture is dark, or a value is out of its range.
    """
    config = ready.cell.config
    own = np.random.SeedSequence(seed, spawn_key=(bin_id,)).spawn(len(EMPTIED_BIN))
    streams = dict(zip(EMPTIED_BIN, own, strict=True))
    counts = mixed_counts(ready.cell.cell, np.random.default_rng(streams["counts"]))
    layout = drop(
        ready.cell.cell.scene,
        counts,
        seed=int(streams["drop"].generate_state(1, np.uint64)[0]),
        limits=config.drop,
        progress=progress,
    )
    world = BinState(
        layout=layout,
        numbers=np.arange(sum(counts)),
        hand_eye=_hand_eye(config.picking, np.random.default_rng(streams["calibration"])),
        q=ready.robot.home,
    )
    attempts: list[Attempt] = []
    pictures: list[UInt8[np.ndarray, "h w 3"]] = []
    depths_m: list[Float[np.ndarray, "h w"]] = []
    taken = failures = 0
    while len(world.numbers) and failures < config.picking.failures:
        left = len(world.numbers)
        progress.stage(f"bin {bin_id}, scan {len(attempts) + 1}: {left} parts are left")
        attempt, bin_scan, world = _attempt(ready, renderer, world, streams["attempts"].spawn(1)[0])
        attempts.append(attempt)
        pictures.append(_picture(bin_scan, attempt))
        depths_m.append(bin_scan.view.depth_m)
        if attempt.outcome is Outcome.TWO_AT_ONCE:
            taken += left - len(world.numbers)
        else:
            taken += attempt.outcome is Outcome.PICKED
        failures = 0 if attempt.outcome in TAKEN else failures + 1
    return Episode(
        bin_id=bin_id,
        kinds=tuple(layout.part_index.tolist()),
        attempts=tuple(attempts),
        pictures=tuple(pictures),
        depths_m=tuple(depths_m),
        filled=sum(counts),
        taken=taken,
        left=len(world.numbers),
    )


def _hand_eye(picking: PickingSection, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """Return the calibration error: the transform from planned to true poses of the tip."""
    turn = Rotation.from_rotvec(picking.hand_eye_rad * rng.normal(size=3)).as_matrix()
    return rigid(turn, picking.hand_eye_m * rng.normal(size=3))


def _attempt(
    ready: Ready, renderer: Renderer, world: BinState, seed: np.random.SeedSequence
) -> tuple[Attempt, BinScan, BinState]:
    scan_seed, plan_seed = seed.spawn(2)
    clock = Clock()
    with clock("scan"):
        bin_scan = scan(ready.cell, renderer, world.layout, seed=scan_seed)
    with clock("detect"):
        candidates = targets(ready.cell, bin_scan, world.layout, ready.detector)
    choice = choose(
        ready,
        bin_scan.view,
        candidates,
        world.q,
        world.tabu,
        world.blocked,
        seed=int(plan_seed.generate_state(1)[0]),
        clock=clock,
    )
    attempt = Attempt(
        outcome=Outcome.NOTHING_FOUND,
        T_world_part=world.layout.T_world_part,
        present=tuple(world.numbers.tolist()),
        targets=len(candidates),
        seconds={"scan": bin_scan.seconds, "motion": 0.0},
        work_s=clock.seconds,
    )
    if isinstance(choice, Blocked):
        world = world.without_way(choice.places_m)
        return replace(attempt, outcome=choice.outcome, detail=choice.detail), bin_scan, world
    with clock("physics"):
        carried, after = carry_out(ready, world, choice)
    time_s, q = _sampled(choice.ways)
    aim = choice.aim
    attempt = replace(
        attempt,
        outcome=carried.outcome,
        detail=carried.detail,
        part=None if carried.part is None else int(world.numbers[carried.part]),
        kind=aim.target.kind,
        score=aim.score,
        T_world_tool=aim.T_world_tool,
        opening_m=aim.opening_m,
        pose_error=carried.pose_error,
        least_factor=carried.least_factor,
        lost_s=carried.lost_s,
        seconds={"scan": bin_scan.seconds, "motion": choice.ways.seconds},
        time_s=time_s,
        q=q,
    )
    return attempt, bin_scan, after


def _sampled(ways: Ways) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, "t joints"]]:
    """Return times and joint angles of the whole motion, one row per `POSE_STEP_S`."""
    times, angles, before = [], [], 0.0
    for way in ways.all:
        for t in np.arange(0.0, way.seconds, POSE_STEP_S):
            times.append(before + t)
            angles.append(way.at(float(t)))
        before += way.seconds
    return np.array([*times, before]), np.stack([*angles, ways.away.q[-1]])


def _picture(bin_scan: BinScan, attempt: Attempt) -> UInt8[np.ndarray, "h w 3"]:
    """Return the scan's picture (RGB) with the part's outline, the tool's axis and the outcome."""
    image = np.ascontiguousarray(np.repeat(srgb_of_bytes(bin_scan.gray)[..., None], 3, axis=-1))
    ink = _GOOD if attempt.outcome in TAKEN else _BAD
    if attempt.part is not None:
        mask = (bin_scan.instance == attempt.present.index(attempt.part)).astype(np.uint8)
        lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, lines, -1, _PART, 1, cv2.LINE_AA)
    if attempt.T_world_tool is not None:
        tip = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, AXIS_M]])
        world = transform_points(attempt.T_world_tool, tip)
        at = project(
            bin_scan.view.camera, transform_points(inverse(bin_scan.view.T_world_cam), world)
        )
        (x, y), (u, v) = np.rint(at).astype(int).tolist()
        cv2.line(image, (x, y), (u, v), ink, 2, cv2.LINE_AA)
        cv2.circle(image, (x, y), 5, ink, 2, cv2.LINE_AA)
    _label(image, str(attempt.outcome))
    return image


def _label(image: UInt8[np.ndarray, "h w 3"], text: str) -> None:
    """Write white text on a black background at the top left of a picture, in place."""
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.5
    (width_px, height_px), below_px = cv2.getTextSize(text, font, size, 1)
    corner = (width_px + 11, height_px + below_px + 7)
    cv2.rectangle(image, (0, 0), corner, (0, 0, 0), cv2.FILLED)
    cv2.putText(image, text, (6, height_px + 5), font, size, (255, 255, 255), 1, cv2.LINE_AA)
