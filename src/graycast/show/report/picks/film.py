"""A film of one bin: the page's view from behind the bin, attempt by attempt.

The project's own rasteriser draws it. As on the page, there are no shadows, and a released part
does not fall; it is shown where the next scan finds it. Points of a carried part are removed from
the scan, so that the other points stay visible. At the end of an attempt, the true remaining parts
are drawn translucently over the scan.
"""

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8, UInt16
from PIL import Image, ImageDraw, ImageFont

from ....base.errors import GraycastError
from ....base.folder import write_whole
from ....base.frames import inverse, look_at, transform_points
from ....base.progress import UNWATCHED, ProgressMeter
from ....rig.meshdepth import rasterize
from ....rig.optics import Optics, picture_rays, pinhole, pixels_of, points, project
from ....robot.pick import StoredEpisode, read_episodes
from ....robot.pick.outcome import Outcome
from ....robot.pick.pick_files import BINS, DEPTH_STEP_M
from ....robot.pick.replay import Motion, Replay, open_replay, read_motions
from ....robot.pick.solids import joined
from ....world.parts import Mesh
from .bin_files import read_image
from .bodies import TINT, look, open_bin, table
from .words import OUTCOME_COLOR

KINDS = {".gif": "GIF", ".webp": "WEBP"}
WIDTH_PX, LEAST_PX = 480, 280  # In a narrower picture, the words would overlap.
FRAME_MS = 100  # GIF stores times in hundredths of a second.
_END_FRAMES = 8  # An attempt's outcome stays for this many frames.
_FIELD_RAD = 0.55  # It equals `FIELD_RAD` of the page.
_PITCH_RAD, _DISTANCE = 0.42, 4.2  # The distance is in units of `reach` of `look`.
_BAND_PX = 26  # The words are in this band below the picture.
_ON_SURFACE_M = 2e-3  # Scan points deeper than this in a body are hidden.
_PALETTE_FRAMES = 12
_SMOOTH_PX = 5  # Measured normals are averaged over this, only for shading.

_OF_PART_M = 5e-3  # A point closer than this to a part's true surface belongs to the part.
_GHOST = 0.5  # A translucent part has this share of the colour.
_FARTHER = (1.0, 1.15, 1.3, 1.5, 1.75, 2.0)  # The camera moves back until the tool stays in view.

Steps = UInt16[np.ndarray, "h w"]
Colors = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Eye:
    camera: Optics
    T_world_eye: Float[np.ndarray, "4 4"]

    def sees(self, mesh: Mesh) -> Float[np.ndarray, "v 3"]:
        return transform_points(inverse(self.T_world_eye), mesh.vertices_m.astype(np.float64))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layer:
    """Colours and z [m] of the visible surface; z is infinite where there is none."""

    color: Float[np.ndarray, "h w 3"]
    z: Float[np.ndarray, "h w"]

    def over(self, other: "_Layer") -> "_Layer":
        """Return both layers, with the nearer surface in front."""
        mine = self.z < other.z
        color = np.where(mine[..., None], self.color, other.color)
        return _Layer(color=color, z=np.where(mine, self.z, other.z))


def write_film(
    picks: Path,
    bin_id: int,
    out: Path,
    *,
    cell_folder: Path,
    speed: float = 2.0,
    width_px: int = WIDTH_PX,
    progress: ProgressMeter = UNWATCHED,
) -> int:
    """Draw a bin's attempts as a film in one file.

    Args:
        out: the file; its suffix, .gif or .webp, selects the format.
        cell_folder: see `folder` of `open_replay`.
        speed: the film's speed in multiples of the robot's.
        width_px: width of the picture; its height is three quarters, plus a line of words.
        progress: counts attempts.

    Returns:
        The number of frames.

    Raises:
        GraycastError: the bin is missing or damaged, or suffix or width are not allowed.
    """
    if out.suffix.lower() not in KINDS:
        raise GraycastError(f"{out}: give a file name that ends with {' or '.join(KINDS)}")
    if width_px < LEAST_PX:
        raise GraycastError(
            f"a width of {width_px} pixels is too small for the captions: give at least {LEAST_PX}"
        )
    episodes = {episode.bin_id: episode for episode in read_episodes(picks)}
    if bin_id not in episodes:
        bins = f"it has {min(episodes)} to {max(episodes)}" if episodes else "none is finished yet"
        raise GraycastError(f"{picks}: bin {bin_id} does not exist: {bins}")
    replay = open_replay(picks, folder=cell_folder)
    episode = episodes[bin_id]
    frames = []
    motions = read_motions(replay, episode)
    attempts = _attempts(replay, episode, motions, _eye(replay, width_px, motions), speed)
    for done, attempt in enumerate(attempts, start=1):
        frames += attempt
        progress.count("attempts", done, len(episode.attempts))
    write_whole(out, _encoded(frames, KINDS[out.suffix.lower()]))
    return len(frames)


def _eye(replay: Replay, width_px: int, motions: Sequence[Motion | None] = ()) -> _Eye:
    """Return a camera behind the bin, far enough away to keep the tool in the picture."""
    height_px = round(0.75 * width_px)
    f_px = height_px / 2 / np.tan(_FIELD_RAD / 2)
    camera = pinhole(width_px, height_px, f_px)
    view = look(replay)
    yaw, middle = view["yaw"], 1e-3 * np.array(view["middle"])
    out = np.array([np.cos(_PITCH_RAD) * np.cos(yaw), np.cos(_PITCH_RAD) * np.sin(yaw), 0.0])
    out[2] = np.sin(_PITCH_RAD)
    tool_m = _tool_path_m(replay, motions)
    for farther in _FARTHER:
        eye_m = middle + farther * _DISTANCE * 1e-3 * view["reach"] * out
        T_world_eye = look_at(eye_m, middle, np.array([0.0, 0.0, -1.0]))
        place = project(camera, transform_points(inverse(T_world_eye), tool_m))
        if (np.abs(place - (camera.cx_px, camera.cy_px)) < (0.5 * width_px, 0.5 * height_px)).all():
            break
    return _Eye(camera=camera, T_world_eye=T_world_eye)


def _tool_path_m(replay: Replay, motions: Sequence[Motion | None]) -> Float[np.ndarray, "points 3"]:
    """Return the box corners of the tool's limbs at all times, in world coordinates."""
    corners_m = [np.zeros((0, 3))]
    for number, limb in enumerate(replay.limbs[replay.arm_limbs :], start=replay.arm_limbs):
        corners = np.stack(np.meshgrid(*limb.bounds_m.T), axis=-1).reshape(-1, 3)
        places = [motion.T_world_limb[::4, number] for motion in motions if motion is not None]
        corners_m += [
            transform_points(T, corners) for T in np.concatenate([*places, np.zeros((0, 4, 4))])
        ]
    return np.concatenate(corners_m)


def _attempts(
    replay: Replay,
    episode: StoredEpisode,
    motions: Sequence[Motion | None],
    eye: _Eye,
    speed: float,
) -> Iterator[list[Image.Image]]:
    kinds = replay.kinds(episode)
    ground = _ground(replay, eye)
    still = replay.T_world_limb(replay.robot.home)
    for number, (attempt, motion) in enumerate(zip(episode.attempts, motions, strict=True)):
        following = episode.attempts[number + 1 :][:1]
        step = _scan_steps(replay, episode, number)
        whole = scene = _points(replay, step, eye, ground)
        left = whole
        if motion is not None and motion.part is not None and motion.held_until_s is not None:
            left = _points(replay, _without(replay, step, kinds, attempt, motion.part), eye, ground)
        words = f"bin {episode.bin_id}, attempt {number + 1} of {len(episode.attempts)}"
        steps = [-1] if motion is None else _steps(motion, 1e-3 * FRAME_MS * speed)
        frames = []
        for i in steps:
            limbs = still if motion is None else motion.T_world_limb[i]
            scene = whole if motion is None or i < motion.grip else left
            layer = _robot(replay, eye, limbs)
            if motion is not None and motion.part is not None:
                T = _part_place(attempt, following, motion, i)
                if T is not None:
                    layer = layer.over(_part(replay, eye, kinds, motion.part, T))
            frames.append(_picture(layer.over(scene), words, None))
        if not following:
            rest = _remaining(attempt, motion)
            scene = _with_ghosts(scene, replay, eye, kinds, rest)
            words += f", {len(rest)} left"
        frames += [_picture(layer.over(scene), words, attempt)] * _END_FRAMES
        yield frames
        still = still if motion is None else motion.T_world_limb[-1]


def _steps(motion: Motion, step_s: float) -> list[int]:
    """Return the indices of the times to show, including the last."""
    wanted = np.arange(0.0, motion.time_s[-1], step_s)
    nearest = np.abs(motion.time_s[None] - wanted[:, None]).argmin(axis=1)
    return [*nearest.tolist(), len(motion.time_s) - 1]


def _part_place(
    attempt: Mapping[str, Any], following: Sequence[Mapping[str, Any]], motion: Motion, i: int
) -> Float[np.ndarray, "4 4"] | None:
    """Return the touched part's pose; after release, its pose in the next scan with it."""
    place = attempt["present"].index(motion.part)
    before = np.array(attempt["T_world_part"][place])
    carried = motion.T_world_part(i, before)
    if carried is not None:
        return carried
    if motion.held_until_s is None or motion.time_s[i] <= motion.held_until_s:
        return before
    for one in following:
        if motion.part in one["present"]:
            return np.array(one["T_world_part"][one["present"].index(motion.part)])
    return None


# --- layers ---------------------------------------------------------------------------------------


def _ground(replay: Replay, eye: _Eye) -> _Layer:
    """Return the table and the inside of the bin, without faces that look away."""
    box = open_bin(replay)
    corner = eye.sees(box)[box.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    facing = np.einsum("fi,fi->f", normal, corner[:, 0]) < 0
    front = Mesh(vertices_m=box.vertices_m, faces=box.faces[facing])
    size = (eye.camera.height_px, eye.camera.width_px)
    sky = _Layer(color=np.full((*size, 3), TINT["sky"]), z=np.full(size, np.inf))
    bin_ = _body(eye, front, np.array(TINT["bin"]))
    return bin_.over(_body(eye, table(replay), np.array(TINT["table"]))).over(sky)


def _robot(replay: Replay, eye: _Eye, T_world_limb: Float[np.ndarray, "limbs 4 4"]) -> _Layer:
    arm = replay.arm_limbs
    pairs = list(zip(replay.limbs, T_world_limb, strict=True))
    body = _body(eye, joined(pairs[:arm]), np.array(TINT["arm"]))
    return body.over(_body(eye, joined(pairs[arm:]), np.array(TINT["tool"])))


def _remaining(
    attempt: Mapping[str, Any], motion: Motion | None
) -> dict[int, Float[np.ndarray, "4 4"]]:
    """Return the parts that are in the bin at the end, with their true poses."""
    carried = motion.part if motion is not None and motion.held_until_s is not None else None
    places = zip(attempt["present"], attempt["T_world_part"], strict=True)
    return {number: np.array(T) for number, T in places if number != carried}


def _with_ghosts(
    scene: _Layer,
    replay: Replay,
    eye: _Eye,
    kinds: tuple[int, ...],
    rest: Mapping[int, Float[np.ndarray, "4 4"]],
) -> _Layer:
    """Return the scene with the true parts drawn translucently, even those that no scan shows."""
    color = scene.color.copy()
    for number, T in rest.items():
        ghost = _part(replay, eye, kinds, number, T)
        lit = np.isfinite(ghost.z)
        color[lit] += _GHOST * (ghost.color[lit] - color[lit])
    return _Layer(color=color, z=scene.z)


def _part(
    replay: Replay, eye: _Eye, kinds: tuple[int, ...], number: int, T: Float[np.ndarray, "4 4"]
) -> _Layer:
    mesh = replay.cell.cell.scene.parts[kinds[number]].mesh
    return _body(eye, joined([(mesh, T)]), np.array(TINT["part"]))


def _body(eye: _Eye, mesh: Mesh, tint: Float[np.ndarray, "3"]) -> _Layer:
    """Return a mesh in one colour, shaded by the angle between its faces and the view."""
    vertices = eye.sees(mesh)
    face, z = rasterize(vertices, mesh.faces.astype(np.int64), eye.camera).over(eye.camera)
    corner = vertices[mesh.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    shade = _shade(normal[face], picture_rays(eye.camera))
    return _Layer(color=shade[..., None] * tint, z=np.where(face >= 0, z, np.inf))


def _shade(
    normal: Float[np.ndarray, "*n 3"], place: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n"]:
    """Return the shading of the page's bodies, which is darker at oblique angles."""
    long = np.linalg.norm(normal, axis=-1) * np.linalg.norm(place, axis=-1)
    return 0.45 + 0.55 * np.abs((normal * place).sum(axis=-1)) / np.maximum(long, 1e-15)


def _scan_steps(replay: Replay, episode: StoredEpisode, number: int) -> Steps:
    """Read the depth that the robot used, in its stored steps."""
    return read_image(
        replay.folder / BINS / f"{episode.bin_id:06d}" / "depth" / f"{number:03d}.png"
    )


def _without(
    replay: Replay, step: Steps, kinds: tuple[int, ...], attempt: Mapping[str, Any], part: int
) -> Steps:
    """Return the depth without the points on a part."""
    scene = replay.cell.cell.scene
    mesh = scene.parts[kinds[part]].mesh
    T_world_part = np.array(attempt["T_world_part"][attempt["present"].index(part)])
    T_cam_part = inverse(scene.T_world_cam) @ T_world_part
    vertices = transform_points(T_cam_part, mesh.vertices_m.astype(np.float64))
    face, z = rasterize(vertices, mesh.faces.astype(np.int64), scene.rig.camera).over(
        scene.rig.camera
    )
    on_part = (face >= 0) & (np.abs(step * DEPTH_STEP_M - z) < _OF_PART_M)
    return np.where(on_part, 0, step).astype(step.dtype)


def _points(replay: Replay, step: Steps, eye: _Eye, ground: _Layer) -> _Layer:
    """Return the points of a scan, drawn over the table and the bin."""
    scene = replay.cell.cell.scene
    world = transform_points(scene.T_world_cam, points(scene.rig.camera, step * DEPTH_STEP_M))
    point = transform_points(inverse(eye.T_world_eye), world)
    known = step > 0
    for axis in (0, 1):  # A slope across a gap is not valid.
        known &= (np.roll(step, 1, axis) > 0) & (np.roll(step, -1, axis) > 0)
    normal = np.cross(np.gradient(point, axis=1), np.gradient(point, axis=0))
    long = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-15)
    normal = cv2.blur(np.where(known[..., None], normal / long, 0.0), (_SMOOTH_PX, _SMOOTH_PX))
    return _scattered(eye, point[known], _shade(normal, point)[known], ground)


def _scattered(
    eye: _Eye, point: Float[np.ndarray, "p 3"], shade: Float[np.ndarray, " p"], ground: _Layer
) -> _Layer:
    """Draw points as single pixels, far ones first, so that near ones cover them."""
    pixel, inside = pixels_of(eye.camera, point)
    order = np.argsort(-point[:, 2])
    order = order[inside[order]]
    (row, column), z = pixel[order].T, point[order, 2]
    visible = z < ground.z[row, column] + _ON_SURFACE_M
    row, column, z = row[visible], column[visible], z[visible]
    color, depth = ground.color.copy(), ground.z.copy()
    color[row, column] = shade[order][visible][:, None] * np.array(TINT["point"])
    depth[row, column] = z
    return _Layer(color=color, z=depth)


# --- pictures -------------------------------------------------------------------------------------


def _picture(layer: _Layer, words: str, ended: Mapping[str, Any] | None) -> Image.Image:
    """Return the layer with a line below: the attempt and, once it has ended, its outcome."""
    color: Colors = np.rint(255 * layer.color).clip(0, 255).astype(np.uint8)
    height, width = color.shape[:2]
    image = Image.new("RGB", (width, height + _BAND_PX), "white")
    image.paste(Image.fromarray(color), (0, 0))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(14)
    draw.text((8, height + 4), words, fill="#1d2228", font=font)
    if ended is not None:
        ink = OUTCOME_COLOR[Outcome(ended["outcome"])]
        right = width - 8 - draw.textlength(ended["outcome"], font=font)
        draw.rectangle((right - 18, height + 8, right - 8, height + 18), fill=ink)
        draw.text((right, height + 4), ended["outcome"], fill="#1d2228", font=font)
    return image


def _palette(frames: list[Image.Image]) -> Image.Image:
    """Return a palette of frequent colours, and of the outcomes' colours, which are rare."""
    every = max(len(frames) // _PALETTE_FRAMES, 1)
    some = np.vstack([np.asarray(frame) for frame in frames[::every]])
    rare = [value for ink in OUTCOME_COLOR.values() for value in bytes.fromhex(ink[1:])]
    often = Image.fromarray(some).quantize(255 - len(OUTCOME_COLOR), dither=Image.Dither.NONE)
    palette = Image.new("P", (1, 1))
    palette.putpalette([*(often.getpalette() or []), *rare])
    return palette


def _encoded(frames: list[Image.Image], kind: str) -> bytes:
    """Encode the pictures; one palette for a GIF keeps still areas small."""
    if kind == "GIF":
        palette = _palette(frames)
        frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    encoding = {"quality": 70, "method": 4} if kind == "WEBP" else {"optimize": False}
    file = io.BytesIO()
    frames[0].save(
        file, kind, save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, **encoding
    )
    return file.getvalue()
