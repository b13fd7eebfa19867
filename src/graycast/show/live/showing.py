"""Convert results for the page: maps to bytes, with a header that describes them."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Num, UInt8, UInt16

from ...base.frames import transform_points
from ...base.robust import robust_sigma
from ...camera.decode import CodeMap, DepthMap, reason_shares, triangulation_axis
from ...camera.picture import srgb_frame
from ...camera.sensor import Capture
from ...cell.generate import depth_step_mm
from ...cell.resolve import Cell
from ...cell.simulate import on_part
from ...rendering import Rendering
from ...rig.optics import Optics
from ...rig.pair import Rig
from ...world.parts import Mesh
from ...world.scene import Layout, Scene, bin_mesh
from ..report.page.packing import view_record
from ..report.rig_picture import common_field, footprint_m
from .asking import Answer, Ask
from .controls import values_of_files

MM_PER_M = 1000.0
DEPTH_MAX = 65535


@dataclass(frozen=True, slots=True, kw_only=True)
class PageContent:
    """All data that the page needs to show a picture."""

    cell: Cell
    scene: Scene
    layout: Layout
    rendering: Rendering
    samples: int
    exact: bool  # The picture equals the result of `make_scene`.
    capture: Capture
    codes: CodeMap
    depth: DepthMap
    rgb: UInt8[np.ndarray, "h w 3"] | None  # None until it is available


def picture_answer(ask: Ask, page: PageContent, *, kind: str, ms: float, first: bool) -> Answer:
    """Return all maps of a picture, including the colour picture if it is available."""
    cell, depth, truth = page.cell, page.depth, page.rendering.truth
    scale_mm = depth_step_mm(cell)
    rig, codes = cell.scanner.rig, page.codes
    camera, axis = rig.camera, triangulation_axis(rig)
    place, spread = (
        (codes.column, codes.sigma_column) if axis == "column" else (codes.row, codes.sigma_row)
    )
    frame = ask.frame % len(page.capture.frames)
    arrays = {
        "depth": _steps(truth.depth_m, scale_mm),
        "scanner": _steps(depth.depth_m, scale_mm),
        "sigma": (MM_PER_M * depth.sigma_m).astype(np.float32),
        "reason": depth.reason,
        "instance": (truth.instance + 1).astype(np.uint16),
        "place": place.astype(np.float32),
        "place_sigma": spread.astype(np.float32),
        "white": srgb_frame(page.capture, cell.code.brightest),
        "frame": srgb_frame(page.capture, frame),
    }
    if depth.p_wrong is not None:
        arrays["p_wrong"] = depth.p_wrong.astype(np.float32)
    if page.rgb is not None:
        arrays["rgb"] = page.rgb
    header = {
        "number": ask.number,
        "kind": kind,
        "first": first,
        "ms": round(ms, 1),
        "samples": page.samples,
        "of": cell.config.render.samples,
        "exact": page.exact,
        "frame": frame,
        "axis": axis,
        "depth_scale_mm": scale_mm,
        "width": camera.width_px,
        "height": camera.height_px,
        "view": view_record(camera, page.scene.T_world_cam),
        **_capture(page),
        "figures": _figures(page),
        "rig": _rig(rig),
        "lines": _lines(rig, page.scene.T_world_cam),
        "target": _target(page),
        "notes": list(cell.notes),
        "values": values_of_files(cell),
    }
    return Answer(
        kind="picture",
        number=ask.number,
        header=header,
        arrays={name: np.ascontiguousarray(array).tobytes() for name, array in arrays.items()},
    )


def world_answer(ask: Ask, page: PageContent) -> Answer:
    """Return the bodies of the 3D view: meshes of the bin and the parts, and their poses."""
    scene, layout = page.scene, page.layout
    kinds = sorted({int(kind) for kind in layout.part_index})
    meshes = {f"part{kind}": scene.parts[kind].mesh for kind in kinds}
    if scene.bin is not None:
        meshes["bin"] = bin_mesh(scene.bin)
    arrays = {}
    for name, mesh in meshes.items():
        arrays[f"{name}.vertices"] = (MM_PER_M * mesh.vertices_m).astype(np.float32).tobytes()
        arrays[f"{name}.faces"] = mesh.faces.astype(np.uint32).tobytes()
    places = layout.T_world_part.copy()
    places[:, :3, 3] *= MM_PER_M
    by_columns = np.swapaxes(places, 1, 2).reshape(len(places), 16)
    arrays["places"] = by_columns.astype(np.float32).tobytes()
    header = {
        "meshes": list(meshes),
        "kinds": [int(kind) for kind in layout.part_index],
        "names": [scene.parts[int(kind)].name for kind in layout.part_index],
    }
    return Answer(kind="world", number=ask.number, header=header, arrays=arrays)


def world_key(page: PageContent) -> str:
    """Return a cache key that changes when the bodies of the 3D view change."""
    scene, layout = page.scene, page.layout
    digest = hashlib.sha256(layout.T_world_part.tobytes() + layout.part_index.tobytes())
    meshes: list[Mesh] = [part.mesh for part in scene.parts]
    if scene.bin is not None:
        meshes.append(bin_mesh(scene.bin))
    for mesh in meshes:
        digest.update(mesh.vertices_m.tobytes() + mesh.faces.tobytes())
    return digest.hexdigest()


def _steps(depth_m: Float[np.ndarray, "h w"], scale_mm: float) -> UInt16[np.ndarray, "h w"]:
    """Return depth in the steps of depth pictures; 0 if missing or beyond 16 bits."""
    step = np.rint(np.nan_to_num(depth_m) * (MM_PER_M / scale_mm))
    return np.where((step > 0) & (step <= DEPTH_MAX), step, 0).astype(np.uint16)


def _capture(page: PageContent) -> dict[str, Any]:
    sensor = page.capture.sensor
    return {
        "bits": sensor.bit_depth,
        "low_dn": sensor.offset_dn,
        "high_dn": sensor.saturation_dn,
        "merged": isinstance(page.capture.exposure_s, np.ndarray),
        "frames": [frame.name for frame in page.cell.code.frames],
    }


def _rig(rig: Rig) -> dict[str, Any]:
    names = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "distortion")
    return {
        "projector": {name: getattr(rig.projector, name) for name in names},
        "T_cam_proj": rig.T_cam_proj.tolist(),
        "baseline_mm": MM_PER_M * rig.baseline_m,
        "axes_deg": float(np.degrees(rig.axes_angle_rad)),
    }


def _figures(page: PageContent) -> dict[str, Any]:
    """Return the figures that the page shows next to the picture."""
    depth, truth = page.depth, page.rendering.truth
    of_parts = on_part(page.scene, page.layout, truth)
    part_reasons = reason_shares(depth.reason[of_parts])
    error_mm = MM_PER_M * (depth.depth_m - truth.depth_m)
    known = error_mm[of_parts & np.isfinite(error_mm)]
    return {
        "reasons": reason_shares(depth.reason),
        "part_reasons": part_reasons or None,
        "part_decoded": part_reasons.get("decoded"),
        "bias_mm": float(np.median(known)) if known.size else None,
        "sigma_mm": float(robust_sigma(known - np.median(known))) if known.size else None,
        "exposure_ms": 1e3 * page.capture.reference_s,
        "saturated": _mean(page.capture.frames[0] >= page.capture.sensor.saturation_dn),
    }


def _mean(values: Num[np.ndarray, "*n"] | Any) -> float | None:
    return float(np.mean(values)) if np.size(values) else None


def _target(page: PageContent) -> list[float]:
    """Return the point [mm, world frame] about which the user turns the rig by dragging."""
    view, box = page.cell.config.view, page.scene.bin
    height_m = 0.0 if box is None else box.inner_m[2]
    return [MM_PER_M * v for v in view.target_m or (0.0, 0.0, height_m / 3)]


def _lines(rig: Rig, T_world_cam: Float[np.ndarray, "4 4"]) -> Mapping[str, list[float]]:
    """Return line segments [mm, world frame]: both fields of view, and their common part."""
    ends_m = rig.near_m, 0.5 * (rig.near_m + rig.far_m), rig.far_m
    lines = {
        "camera": _field(rig.camera, np.eye(4), rig.far_m),
        "projector": _field(rig.projector, rig.T_cam_proj, rig.far_m),
        "baseline": [np.stack([np.zeros(3), rig.T_cam_proj[:3, 3]])],
        "common": _volume([_outline(common_field(rig, z_m), z_m) for z_m in ends_m]),
    }
    points_m = {
        name: transform_points(T_world_cam, np.reshape(segments, (-1, 3)))
        for name, segments in lines.items()
    }
    return {name: np.round(MM_PER_M * p, 2).ravel().tolist() for name, p in points_m.items()}


def _field(
    optics: Optics, T_cam_device: Float[np.ndarray, "4 4"], z_m: float
) -> list[Float[np.ndarray, "2 3"]]:
    corners = _outline(footprint_m(optics, T_cam_device, z_m), z_m)
    if not len(corners):
        return []
    each = len(corners) // 4
    sides = [np.stack([T_cam_device[:3, 3], corners[each * k]]) for k in range(4)]
    return [*sides, *_around(corners[::each] if not optics.has_distortion else corners)]


def _outline(xy_m: Float[np.ndarray, "n 2"], z_m: float) -> Float[np.ndarray, "n 3"]:
    return np.column_stack([xy_m, np.full(len(xy_m), z_m)])


def _around(corners: Float[np.ndarray, "n 3"]) -> list[Float[np.ndarray, "2 3"]]:
    return list(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))


def _volume(outlines: list[Float[np.ndarray, "_ 3"]]) -> list[Float[np.ndarray, "2 3"]]:
    """Return outlines at several depths, with edges between their outermost corners."""
    segments = [segment for corners in outlines for segment in _around(corners)]
    visible = [corners for corners in outlines if len(corners)]
    for front, back in pairwise(visible):
        for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            ends = [corners[np.argmax(corners[:, :2] @ [x, y])] for corners in (front, back)]
            segments.append(np.stack(ends))
    return segments
