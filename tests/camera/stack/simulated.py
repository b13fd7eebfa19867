"""A small scanner in closed form: a wall and a ball with known projector positions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

from graycast.base.frames import axis_rotation, inverse, pixel_grid, rigid, transform_points
from graycast.rig.optics import Optics, project, rays
from graycast.rig.pair import Rig
from graycast.rig.pattern import Code, level_share

FastDumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
WALL_M, BALL_M, RADIUS_M = 0.8, np.array([0.0, 0.01, 0.72]), 0.08


def lens(width_px: int, height_px: int, focal_px: float, **terms) -> Optics:
    return Optics(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=(width_px - 1) / 2,
        cy_px=(height_px - 1) / 2,
        **terms,
    )


def small_rig(*, vertical: bool = False, projector=(128, 96), distortion=(0.0,) * 5) -> Rig:
    """Return camera and projector 0.2 m apart, side by side or one above the other."""
    angle = 0.25
    if vertical:
        T_cam_proj = rigid(axis_rotation("x", angle), np.array([0.0, 0.2, 0.0]))
    else:
        T_cam_proj = rigid(axis_rotation("y", -angle), np.array([0.2, 0.0, 0.0]))
    return Rig(
        name="small",
        camera=lens(160, 120, 190.0, distortion=distortion),
        projector=lens(*projector, 150.0 * projector[0] / 128),
        T_cam_proj=T_cam_proj,
        near_m=0.4,
        far_m=1.2,
    )


@dataclass(frozen=True)
class View:
    """Scene of every camera pixel: its depth [m] and its position on the projector [px]."""

    depth_m: np.ndarray
    column: np.ndarray
    row: np.ndarray


def view_of(rig: Rig) -> View:
    """Intersect rays with plane and sphere, without shadows."""
    ray = rays(rig.camera, pixel_grid(rig.camera.height_px, rig.camera.width_px))
    a = np.square(ray).sum(axis=-1)
    b = ray @ BALL_M
    under = b * b - a * (BALL_M @ BALL_M - RADIUS_M**2)
    with np.errstate(invalid="ignore"):
        ball = (b - np.sqrt(under)) / a
    depth_m = np.where(under > 0, ball, WALL_M)
    uv = project(rig.projector, transform_points(inverse(rig.T_cam_proj), ray * depth_m[..., None]))
    return View(depth_m, uv[..., 0], uv[..., 1])


def shoot(
    rig: Rig, code: Code, *, bits: int = 8, gain: float = 0.02, seed: int = 3, bright=0.75
) -> np.ndarray:
    """Return the stack: (n, h, w) digital numbers, with photon noise of `gain` DN per electron."""
    scene = view_of(rig)
    top = 2**bits - 1
    inside = (np.abs(scene.column - (code.width_px - 1) / 2) < code.width_px / 2) & (
        np.abs(scene.row - (code.height_px - 1) / 2) < code.height_px / 2
    )
    albedo = 0.7 + 0.3 * np.sin(0.21 * np.arange(rig.camera.width_px))
    light = []
    for frame in code.frames:
        size = 1 if frame.axis is None else code.size_px(frame.axis)
        i = 0 if frame.axis != "row" else 1
        share = level_share(frame, size, offset_px=code.offset_px[i], stride_px=code.stride_px[i])
        place = scene.row if frame.axis == "row" else scene.column
        index = np.clip(np.rint(np.nan_to_num(place)), 0, size - 1).astype(int)
        light.append(np.where(inside, share[index], 0.0))
    rng = np.random.default_rng(seed)
    signal_dn = bright * top * (0.03 + np.array(light) * albedo)
    noise_dn = rng.normal(0, 1, signal_dn.shape) * np.sqrt(0.25 + gain * signal_dn)
    dtype = np.uint8 if bits <= 8 else np.uint16
    return np.clip(np.rint(signal_dn + 0.02 * top + noise_dn), 0, top).astype(dtype)


def describe(code: Code, suffix: str = ".png") -> dict:
    """Return the content of STACK.yaml for a code, with files by the frames' names."""
    content: dict = {
        "projector": {"width_px": code.width_px, "height_px": code.height_px},
        "frames": [],
    }
    for frame in code.frames:
        entry: dict = {"file": frame.name + suffix, "kind": frame.kind}
        if frame.axis is not None:
            entry["axis"] = frame.axis
        if frame.kind == "gray":
            entry["bit"] = frame.bit
        if frame.inverse:
            entry["inverse"] = True
        if frame.xor_bit >= 0:
            entry["xor_bit"] = frame.xor_bit
        if frame.period_px:
            entry["period_px"] = frame.period_px
        if frame.steps:
            entry |= {"step": frame.step, "steps": frame.steps}
        content["frames"].append(entry)
    if code.stride_px != (1.0, 1.0):
        content["stride_px"] = {"column": code.stride_px[0], "row": code.stride_px[1]}
    return content


def save(folder: Path, content: dict, stack: np.ndarray, *, color: bool = False) -> Path:
    """Write pictures and STACK.yaml; return the path of STACK.yaml."""
    for entry, picture in zip(content["frames"], stack, strict=True):
        image = Image.fromarray(np.repeat(picture[..., None], 3, axis=-1) if color else picture)
        is_jpeg = entry["file"].endswith(".jpg")
        options = {"quality": 95} if is_jpeg else {"compress_level": 0}  # noise does not compress
        image.save(folder / entry["file"], **options)
    return write_yaml(folder, content)


def write_yaml(folder: Path, content) -> Path:
    path = folder / "STACK.yaml"
    path.write_text(yaml.dump(content, Dumper=FastDumper), encoding="utf-8")
    return path
