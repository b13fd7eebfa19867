"""Fit of a configuration (pose, colours and light) to real views of an empty bin."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.errors import GraycastError
from ...base.folder import whole_folder
from ...base.settings import read_text
from ...cell.config import Config
from ...cell.resolve import Cell, open_cell_renderer
from ...dataset.files.json_text import plain
from ...world.parts import Material
from ...world.parts.material_section import MaterialSection, material_words
from ...world.scene import Bin, bin_of
from ..depth_file import read_gray
from ..fitted_config import fitted_text, refuse_there
from .bending import BentBin, bent_bin, mesh_bytes
from .bin_views import BinView
from .box import open_box
from .look import BinAppearance, Frames, fit_look, mean_color
from .mesh import mesh_shape
from .pose_fit import FREEDOMS, FaceFit, PoseFit, difference, find_pose, settle
from .residual_picture import draw_residuals
from .shape import BinShape


@dataclass(frozen=True, slots=True, kw_only=True)
class BinFit:
    """A fitted bin: shape and pose of the bin as drawn, look, and the bent bin with its own pose.

    `apart` has, for each view, the distance [m] and angle [rad] between the pose fitted to this
    view alone and the common pose.
    """

    views: tuple[str, ...]
    shape: BinShape
    pose: PoseFit
    apart: tuple[tuple[float, float], ...]
    look: BinAppearance | None = None
    bent: BentBin | None = None


def shape_of(box: Bin, *, wall_known: bool = True) -> BinShape:
    """Return the shape of a bin; a box without known wall thickness has no rim or outer walls."""
    if box.mesh is not None:
        return mesh_shape(box)
    return open_box(box.inner_m, box.wall_m if wall_known else None)


def fit_pose(
    views: Sequence[BinView],
    shape: BinShape,
    *,
    azimuth_rad: float,
    seed: int,
    stated: Float[np.ndarray, "4 4"] | None = None,
) -> BinFit:
    """Fit one pose to all views, and one to each view alone, which shows the spread.

    Raises:
        GraycastError: no surface in the views agrees with the bin.
    """
    pose = find_pose(views, shape, azimuth_rad=azimuth_rad, seed=seed, stated=stated)
    alone = [settle([view], shape, pose.T_world_cam) for view in views if len(views) > 1]
    return BinFit(
        views=tuple(view.name for view in views),
        shape=shape,
        pose=pose,
        apart=tuple(difference(one.T_world_cam, pose.T_world_cam) for one in alone),
    )


def with_look(
    fit: BinFit,
    cell: Cell,
    views: Sequence[BinView],
    *,
    floor_reflectance: float | None,
    frames: Frames | None,
    device: str,
    seed: int,
) -> BinFit:
    """Add colours and light to the fit, so that rendered pictures resemble the views' pictures.

    Raises:
        GraycastError: see `fit_look`, or there is no such device.
    """
    with open_cell_renderer(cell, device=device) as renderer:
        look = fit_look(
            cell,
            shape_of(bin_of(cell.scene)),
            views,
            fit.pose.T_world_cam,
            floor_reflectance=floor_reflectance,
            frames=frames,
            renderer=renderer,
            seed=seed,
        )
    return replace(fit, look=look)


def with_bend(fit: BinFit, cell: Cell, views: Sequence[BinView]) -> BinFit:
    """Add the bent bin to the fit, unless the views do not determine its pose (`PoseFit.loose`).

    Raises:
        GraycastError: see `bent_bin`.
    """
    if fit.pose.loose:
        return fit
    return replace(fit, bent=bent_bin(bin_of(cell.scene), fit.pose.T_world_cam, views))


def read_frames(white: Path, black: Path, view: BinView) -> Frames:
    """Read two frames of the measuring camera as grey values from 0 to 1.

    Raises:
        GraycastError: a file cannot be read, or its size differs from the view's.
    """
    frames = [read_gray(path) for path in (white, black)]
    for path, frame in zip((white, black), frames, strict=True):
        if frame.shape != view.depth_m.shape:
            sizes = [f"{s[1]} x {s[0]}" for s in (frame.shape, view.depth_m.shape)]
            raise GraycastError(f"{path}: is {sizes[0]} pixels, the depth {sizes[1]}: one camera")
    return Frames(white=frames[0], black=frames[1])


def write_fit(
    fit: BinFit,
    cell: Cell,
    views: Sequence[BinView],
    base: Path,
    out: Path,
    *,
    mesh: Path | None = None,
) -> list[Path]:
    """Write the configuration, a report and a picture of the residuals into one folder.

    Args:
        fit: the fit to write.
        cell: cell of the configuration `base`.
        views: the fitted views.
        base: the configuration file whose text the new file keeps, except for the fitted keys.
        out: the new configuration file.
        mesh: file for the mesh of a bent bin, in the folder of `out`.

    Raises:
        GraycastError: a file exists already or cannot be written, or the views do not determine
            all degrees of freedom of the pose.
    """
    if fit.pose.loose:
        raise GraycastError(
            f"nothing is written: no wall or edge determines {', '.join(fit.pose.loose)} of the "
            "bin: correct its size with --inner, or add views that show more of it"
        )
    text = fitted_text(read_text(base), base, sections(fit, cell, mesh), _comments(fit, base))
    report, picture = (out.with_name(out.stem + end) for end in (".fit.json", ".fit.png"))
    files = [out, report, picture] if mesh is None else [out, report, picture, mesh]
    refuse_there(*files)
    with whole_folder(out.parent) as aside:
        draw_residuals(fit.pose, fit.shape, views, aside / picture.name)
        report_text = json.dumps(described(fit), indent=1) + "\n"
        (aside / report.name).write_text(report_text, encoding="utf-8")
        (aside / out.name).write_text(text, encoding="utf-8")
        if fit.bent is not None and mesh is not None:
            (aside / mesh.name).write_bytes(mesh_bytes(fit.bent.mesh))
        refuse_there(*files)  # Another process may have written the files meanwhile.
    return files


def azimuth_of(config: Config) -> float:
    """Return the azimuth [rad] of the camera's x axis in the world, from a configuration."""
    T = config.view.T_world_cam
    return math.radians(config.view.azimuth_deg) if T is None else math.atan2(T[4], T[0])


# --- written files --------------------------------------------------------------------------------


def sections(fit: BinFit, cell: Cell, mesh: Path | None = None) -> dict[str, Mapping[str, Any]]:
    """Return the fitted keys of the configuration with their new values.

    `mesh` is the file of a bent bin, in the folder of the configuration.
    """
    box = cell.config.bin.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    if fit.bent is not None and mesh is not None:
        box = _bent_words(box, cell, mesh)
    elif bin_of(cell.scene).mesh is None:
        box |= {"inner_m": list(bin_of(cell.scene).inner_m), "wall_m": bin_of(cell.scene).wall_m}
    else:
        box = {key: value for key, value in box.items() if key not in ("inner_m", "wall_m")}
    content: dict[str, Mapping[str, Any]] = {
        "view": {"T_world_cam": _numbers((fit.bent or fit.pose).T_world_cam)},
        "bin": box,
    }
    if fit.look is None:
        return content
    color, walls = fit.look.reflectance, bin_of(cell.scene).material
    own = cell.config.bin
    floor = bin_of(cell.scene).floor or walls
    box["floor"] = _words(floor, color["floor"], own.floor or own.material)
    if "walls" in color:
        box["material"] = _words(walls, color["walls"], own.material)
    if "table" in color:
        content["table"] = _words(cell.scene.table, color["table"], cell.config.table)
    if fit.look.light_scale is not None:
        content["light"] = _scaled_light(cell.config, fit.look.light_scale)
    return content


def _bent_words(box: Mapping[str, Any], cell: Cell, mesh: Path) -> dict[str, Any]:
    """Return the section of a bin with the bent mesh instead of the former shape.

    The mesh file has no texture, so the wood of a box or the texture of a mesh becomes one colour.
    """
    other = ("inner_m", "wall_m", "mesh", "unit", "up_axis")
    words: dict[str, Any] = {"mesh": mesh.name, "unit": "m"}
    words |= {key: value for key, value in box.items() if key not in other}
    material = bin_of(cell.scene).material
    if cell.config.bin.material is None:
        words["material"] = _words(material, mean_color(material), None)
    return words


def _numbers(T: Float[np.ndarray, "4 4"]) -> list[float]:
    """Return the 16 numbers of a pose, rounded to 1e-9, with 0.0 instead of -0.0."""
    return [round(float(value), 9) + 0.0 for value in T.ravel()]


def _words(
    material: Material, color: tuple[float, float, float], section: MaterialSection | None
) -> dict[str, Any]:
    """Return the section of a material with another colour and otherwise unchanged keys."""
    rounded = [round(band, 4) for band in color]
    return material_words(material, section) | {"base_color": rounded}


def _scaled_light(config: Config, scale: float) -> dict[str, Any]:
    light = config.light.model_dump(mode="json", exclude_none=True)
    for one in (light["environment"], *light["lamps"]):
        one["radiance"] = [float(f"{scale * band:.5g}") for band in one["radiance"]]
    return light


def _comments(fit: BinFit, base: Path) -> dict[str, str]:
    pose = fit.pose
    text = (
        f"Fitted by graycast real fit-bin to {len(fit.views)} view(s) of the empty bin, from "
        f"{base.name}:\nresiduals RMS {1e3 * pose.rms_m:.2f} mm, {pose.inlier_share:.0%} of the "
        "points in the bin belong to it."
    )
    if pose.by_edges:
        text += f"\nDetermined only by edges, not by walls: {', '.join(pose.by_edges)}."
    comments = {"view": text, "bin": "Shape as given."}
    if fit.look is not None:
        level = np.mean(fit.look.reflectance["floor"])
        color = f"colours from the pictures, relative to a floor that reflects {level:.3f} (stated)"
        comments["bin"] = f"Shape as given; {color}."
        comments["table"] = f"What the bin stands on: {color}."
        comments["light"] = "Levels from the white and black frames, scaled by one factor."
    if fit.bent is not None:
        shape = "Shape bent by graycast real fit-bin to where the views measured it"
        comments["bin"] = comments["bin"].replace("Shape as given", shape)
        comments["view"] += "\nThe origin is in the middle of the bent floor."
    return comments


def described(fit: BinFit) -> dict[str, Any]:
    """Return the fit as a dictionary for JSON, in SI units, with None for unknown values."""
    pose, look = fit.pose, fit.look
    content = {
        "views": fit.views,
        "bin": {"inner_m": fit.shape.inner_m, "bounds_m": fit.shape.bounds_m},
        "T_world_cam": pose.T_world_cam,
        "residuals_m": {"rms": pose.rms_m, "median": pose.median_m, "p95": pose.p95_m},
        "inlier_share": pose.inlier_share,
        "agreeing_share": pose.agreeing,
        "standard_deviation": {
            name: value if math.isfinite(value) else None
            for name, value in zip(FREEDOMS, pose.sigma.tolist(), strict=True)
        },
        "held_by_edges_alone": pose.by_edges,
        "not_held": pose.loose,
        "views_apart": [{"m": m, "rad": rad} for m, rad in fit.apart],
        "faces": [asdict(face) for face in pose.faces if face.seen_px],
        "bent": None
        if fit.bent is None
        else {
            "T_world_cam": fit.bent.T_world_cam,
            "before_m": dict(zip(("median", "p90"), fit.bent.before_m, strict=True)),
            "after_m": dict(zip(("median", "p90"), fit.bent.after_m, strict=True)),
        },
        "look": None if look is None else asdict(look),
    }
    return plain(content)


def summary(fit: BinFit) -> list[str]:
    """Return a few lines that describe the fit."""
    pose = fit.pose
    x, y, z = (1e3 * pose.T_world_cam[:3, 3]).tolist()
    lines = [
        f"camera at ({x:.1f}, {y:.1f}, {z:.1f}) mm from the middle of the bin's floor",
        f"  residuals: RMS {1e3 * pose.rms_m:.2f} mm, median {1e3 * pose.median_m:.2f} mm, 95 % "
        f"within {1e3 * pose.p95_m:.2f} mm; {pose.inlier_share:.0%} of its points belong to it",
    ]
    lines += [_face_line(face) for face in pose.faces if face.seen_px]
    if pose.loose:
        loose = ", ".join(pose.loose)
        lines.append(f"  NOT DETERMINED by the views: {loose}: add views that show more walls")
    if pose.by_edges:
        lines.append(
            f"  determined only by edges: {', '.join(pose.by_edges)}, because too little of the "
            "walls is in view"
        )
    if fit.apart:
        far_m, turned = (max(values) for values in zip(*fit.apart, strict=True))
        lines.append(
            f"  each view alone is up to {1e3 * far_m:.2f} mm and {math.degrees(turned):.3f} "
            "degrees from all together"
        )
    if fit.bent is not None:
        errors = [
            f"median {1e3 * median_m:.2f} mm, 90 % within {1e3 * most_m:.2f} mm"
            for median_m, most_m in (fit.bent.before_m, fit.bent.after_m)
        ]
        lines.append(f"  depth from the mesh: {errors[0]}; from the bent mesh: {errors[1]}")
    return lines if fit.look is None else lines + _look_lines(fit.look)


def _face_line(face: FaceFit) -> str:
    residual = f"median {1e3 * face.median_m:+.2f} mm, RMS {1e3 * face.rms_m:.2f} mm"
    residual = "no inliers" if math.isnan(face.rms_m) else residual
    return f"  {face.name:10} {face.inliers:4.0%} of its pixels agree; {residual}"


def _look_lines(look: BinAppearance) -> list[str]:
    lines = []
    for name, color in look.reflectance.items():
        bands = ", ".join(f"{band:.3f}" for band in color)
        lines.append(f"  {name:10} reflects {bands} ({look.pixels[name]} pixels)")
    if look.light_scale is None:
        level = "as configured: the level needs --white and --black"
    else:
        level = f"{look.light_scale:.3g} times as configured"
    return [*lines, f"  lamps and environment {level}"]
