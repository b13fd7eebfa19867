"""Simulation of a real scan on its own surface, for docs/measurements/reenactment.md.

The depth of the scan becomes the surface of a scene. A material is fitted to each mask
(`graycast.real.material`), and one more to the pixels outside all masks. The scene is rendered with
the rig and the code of the scan, a sensor with the noise of the real sensor takes the pictures, and
the same decoder reads both stacks.

Two numbers of the real camera are taken from its pictures: the black level, and the factor from
light to digital numbers, which makes the medians of the masked pixels equal.

Leaves out: lens blur that the rig file does not state; light from outside the picture; surfaces
without depth, unless they are saturated. Pixels without a normal, at edges and on small faces, are
rendered but not compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import yaml
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.stats import spearmanr

from graycast.base.errors import GraycastError
from graycast.base.folder import write_whole
from graycast.base.plotting import caption, plain_figure, save_png
from graycast.base.settings import parse_yaml, read_text
from graycast.camera.decode import DepthMap, Reason, epipolar_residual_px, off_the_line, triangulate
from graycast.camera.decode.plan import plan_axes
from graycast.camera.exposure import ExposureSpec
from graycast.camera.rig_file import load_scanner
from graycast.camera.scanner import Scanner, take
from graycast.camera.stack import read_description
from graycast.camera.stack.stack_pictures import read_pictures
from graycast.cell.resolve import patterns_of
from graycast.real.material import MaterialFit, MaterialScan, fit_material, open_scan, read_masks
from graycast.real.material.normals import smooth_normals
from graycast.real.rescan.source import SourceImage
from graycast.real.rescan.staging import stage
from graycast.rendering import Quality, open_renderer
from graycast.rig.optics import Optics, project
from graycast.world.parts import Material, Mesh
from graycast.world.scene import Environment, Layout, Scene

from .figures import Figures, Show

REST, ALL = "rest", "all masks"
PERCENTILES = (1, 10, 25, 50, 75, 90, 99)
OFF_PX = 2.0  # A pixel whose code is farther from its epipolar line is off the line.
BLACK = 1.0  # percentile of the darkest values that is the black level
BOUNCES = 6
GRAIN_PX = 7  # side of the windows of local medians
Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """The pictures of a stack and the result of decoding them."""

    scan: MaterialScan
    frames: Float[np.ndarray, "n h w"]

    @cached_property
    def black_dn(self) -> float:
        """Black level [DN]: a low percentile of each pixel's darkest value."""
        return float(np.percentile(self.frames.min(axis=0), BLACK))

    @property
    def white(self) -> Float[np.ndarray, "h w"]:
        """The white picture above the black level [DN]."""
        return self.frames[self.scan.result.code.brightest] - self.black_dn

    @property
    def depth(self) -> DepthMap:
        assert self.scan.result.depth is not None
        return self.scan.result.depth

    @cached_property
    def normal(self) -> Float[np.ndarray, "h w 3"]:
        """The normals to which materials are fitted; NaN where they are unknown."""
        known = np.isfinite(self.scan.surface_m)
        return smooth_normals(self.scan.scanner.rig.camera, self.scan.surface_m, known).normal


def measure(
    stack: Path,
    rig: Path,
    masks: Sequence[Path],
    reflectance: float | None,
    metal: bool,
    out: Path,
    samples: int,
    show: Show,
) -> Figures:
    """Write the simulated stack and a picture of both stacks; return the results.

    Args:
        reflectance: reflectance of the pixels outside the masks, if they show a matt surface of
            known reflectance. None takes the intensity of the light from the first mask's fit.
        metal: whether the masks are known to show metal, which may scatter some of its light.

    Raises:
        GraycastError: the stack cannot be decoded, or a material cannot be fitted.
    """
    show("the stack is decoded")
    scanner = load_scanner(rig)
    real = opened(stack, scanner)
    regions = {path.stem: read_masks([path]) for path in masks}
    masked = np.logical_or.reduce([*regions.values()])
    regions[REST] = ~masked
    fits = fitted(real.scan, regions, reflectance, metal, show)
    materials = {name: with_mottle(real.scan, regions[name], fit) for name, fit in fits.items()}
    scene, layout = staged(real, regions, materials)
    folder = acted(real, scene, layout, masked, out / "stack", samples, show)
    own = opened(folder, scanner)
    draw(real, own, out / "reenactment.png")
    rows = [
        {"material": name, **_described(fits[name]), **compared(real, own, mask)}
        for name, mask in regions.items()
    ]
    rows.append({"material": ALL, **compared(real, own, masked)})
    contrasts = [
        {"material": name, "stack": kind, **contrasts_of(one, mask)}
        for name, mask in regions.items()
        for kind, one in (("real", real), ("simulated", own))
    ]
    return {"stack": stack.name, "samples": samples, "rows": rows, "contrasts": contrasts}


def opened(stack: Path, scanner: Scanner) -> Pictures:
    """Decode a stack and read its pictures."""
    scan = open_scan(stack, scanner)
    sections = read_description(scan.path).frames
    frames = read_pictures([scan.path.parent / section.file for section in sections]).frames
    return Pictures(scan=scan, frames=frames.astype(np.float64))


def fitted(
    scan: MaterialScan,
    regions: Mapping[str, Mask],
    reflectance: float | None,
    metal: bool,
    show: Show,
) -> dict[str, MaterialFit]:
    """Fit a material to each region; all regions have the same intensity of the light."""
    scale = None
    if reflectance is not None:
        scale = scan.scale(regions[REST], reflectance)
    fits: dict[str, MaterialFit] = {}
    for name, mask in regions.items():
        show(f"the material {name} is fitted")
        known = metal and name != REST
        fits[name] = fit_material(scan.observations(mask), scale=scale, metal=known, seed=0)
        scale = scale or fits[name].scale
    return fits


def with_mottle(scan: MaterialScan, mask: Mask, fit: MaterialFit) -> Material:
    """Return a fitted material with mottle, if the scan determines the mottle."""
    try:
        return scan.mottle(mask, seed=0).on(fit.material)
    except GraycastError:
        return fit.material


def staged(
    real: Pictures, regions: Mapping[str, Mask], materials: Mapping[str, Material]
) -> tuple[Scene, Layout]:
    """Build the scene of a scan with a part for each region and its material."""
    image = SourceImage(
        camera=real.scan.scanner.rig.camera,
        depth_m=real.scan.surface_m,
        rgb=None,
        obj_id=np.zeros(0, dtype=np.int64),
        T_cam_part=np.zeros((0, 4, 4)),
    )
    scene = stage(image, {}, real.scan.scanner).scene
    (whole,) = scene.parts
    mesh = _with_normals(whole.mesh, real.normal, image.camera)
    label = np.zeros(image.depth_m.shape, dtype=int)
    for number, mask in enumerate(regions.values()):
        label[mask] = number
    middle_m = mesh.vertices_m[mesh.faces].mean(axis=1)
    of_face = label[_pixels_of(middle_m, image.camera)]
    parts = tuple(
        replace(whole, name=name, mesh=_faces_of(mesh, of_face == number), material=material)
        for number, (name, material) in enumerate(materials.items())
        if (of_face == number).any()
    )
    scene = replace(scene, parts=parts, lamps=(), environment=Environment(radiance=(0.0, 0.0, 0.0)))
    count = len(parts)
    poses = np.tile(np.eye(4), (count, 1, 1))
    return scene, Layout(T_world_part=poses, part_index=np.arange(count))


def acted(
    real: Pictures,
    scene: Scene,
    layout: Layout,
    masked: Mask,
    folder: Path,
    samples: int,
    show: Show,
) -> Path:
    """Render the scene with the code of the real stack, and write the pictures as a stack."""
    result, levels = real.scan.result, real.scan.result.levels.levels
    scanner = replace(real.scan.scanner, code=result.code)
    show("the scene is rendered")
    with open_renderer("mitsuba", device="cpu") as renderer:
        radiance = renderer.render(
            scene,
            layout,
            patterns_of(scanner),
            quality=Quality(samples=samples, depth=BOUNCES),
            seed=0,
        ).radiance
    show("the pictures are taken")
    gain = max(levels.slope_dn, 1e-3)
    sensor = replace(
        scanner.sensor,
        bit_depth=max(8, round(np.log2(levels.saturation_dn + 1))),
        offset_dn=real.black_dn,
        gain_dn_per_e=gain,
        read_noise_e=float(np.sqrt(levels.floor_dn2)) / gain,
        full_well_e=2 * levels.saturation_dn / gain,  # The stored number saturates first.
    )
    own = float(np.median(radiance.pattern[result.code.brightest][masked]))
    wanted_e = float(np.median(real.white[masked])) / gain
    exposure_s = wanted_e / (sensor.responsivity * own)
    scanner = replace(scanner, sensor=sensor, exposure=ExposureSpec(exposure_s=exposure_s))
    capture = take(scanner, radiance, seed=0)
    kind = np.uint8 if sensor.bit_depth == 8 else np.uint16
    write_pictures(real.scan.path, [frame.astype(kind) for frame in capture.frames], folder)
    return folder


def write_pictures(stack: Path, pictures: Sequence[np.ndarray], folder: Path) -> None:
    """Write other pictures of the frames of a stack file, with a stack file of their own.

    The pictures are numbered PNG files in one folder, because a stack file may name pictures in
    other folders, or pictures of a kind that loses detail.
    """
    folder.mkdir(parents=True, exist_ok=True)
    content = parse_yaml(read_text(stack), stack)
    frames = [
        {**entry, "file": f"{number:03d}.png"} for number, entry in enumerate(content["frames"])
    ]
    for entry, picture in zip(frames, pictures, strict=True):
        write_whole(folder / entry["file"], cv2.imencode(".png", picture)[1].tobytes())
    content = {key: value for key, value in content.items() if key != "rig"} | {"frames": frames}
    text = yaml.safe_dump(content, sort_keys=False)
    write_whole(folder / "stack.yaml", text.encode())


# --- comparison ----------------------------------------------------------------------------------


def compared(real: Pictures, own: Pictures, mask: Mask) -> Figures:
    """Compare the real stack (first values) with the simulated stack (second values) in a mask.

    White pictures are compared where depth and normal are known. The median relative error and the
    rank correlation have three values: for single pixels, for the local medians of both pictures,
    and for the real picture against its own local medians. The last is the limit for a model that
    does not reproduce the grain. Shares are percentages.
    """
    known = mask & np.isfinite(real.normal[..., 0])
    light = [one.white[known] for one in (real, own)]
    calm = [ndimage.median_filter(one.white, GRAIN_PX)[known] for one in (real, own)]
    figures: Figures = {
        "known %": 100 * float(known.sum() / mask.sum()),
        "error %": [_median_error(*both) for both in (light, calm, (light[0], calm[0]))],
        "rank": [_rank(*both) for both in (light, calm, (light[0], calm[0]))],
        "percentiles": [
            (np.percentile(one, PERCENTILES) / np.median(one)).round(2).tolist() for one in light
        ],
    }
    pairs = [_decoded(one, mask) for one in (real, own)]
    return figures | {name: [pair[name] for pair in pairs] for name in pairs[0]}


def _median_error(true: np.ndarray, own: np.ndarray) -> float:
    return round(100 * float(np.median(np.abs(own - true) / np.maximum(true, 1.0))), 1)


def _rank(true: np.ndarray, own: np.ndarray) -> float:
    return round(float(spearmanr(true, own).statistic), 3)


def draw(real: Pictures, own: Pictures, path: Path) -> None:
    """Draw both white pictures, both depth maps, and the errors of the white picture."""
    height, width = real.scan.surface_m.shape
    figure, axes = plain_figure(10.0, 15.0 * height / width + 1.5, [1, 1], rows=3)
    depths = [1e3 * one.depth.depth_m for one in (real, own)]
    span = dict(zip(("vmin", "vmax"), np.nanpercentile(depths[0], [1, 99]), strict=True))
    error = 100 * (own.white - real.white) / np.maximum(real.white, 1.0)
    look = {"cmap": "gray", "vmin": 0, "vmax": real.white.max()}
    panels = (
        ("white picture, real", real.white, look),
        ("white picture, simulated", own.white, look),
        ("depth [mm], real", depths[0], span),
        ("depth [mm], simulated", depths[1], span),
        ("simulated - real [% of real]", error, {"cmap": "RdBu_r", "vmin": -100, "vmax": 100}),
    )
    for ax, (title, picture, own_look) in zip(axes, panels, strict=False):
        ax.grid(visible=False)
        drawing = ax.imshow(picture, interpolation="nearest", **own_look)
        caption(ax, title, "")
        figure.colorbar(drawing, ax=ax, fraction=0.02, pad=0.01)
    both = np.isfinite(real.normal[..., 0]) & (real.white > 1) & (own.white > 1)
    light = [np.log10(one.white[both]) for one in (real, own)]
    axes[-1].hexbin(*light, gridsize=80, bins="log", cmap="Greys", mincnt=1)
    axes[-1].plot(*np.tile([0.0, light[0].max()], (2, 1)), lw=0.8)
    caption(axes[-1], "light of a pixel, log10 [DN]", "real", "simulated")
    save_png(figure, path, dpi=110)


def _described(fit: MaterialFit) -> Figures:
    return {"kind": fit.kind, "roughness": fit.roughness.value, "color": fit.color.value} | {
        "scatter": fit.scatter
    }


def _decoded(one: Pictures, mask: Mask) -> Figures:
    """Return shares of pixels [%] in a mask, and the ratio of noise to the stated sigma."""
    codes, rig = one.scan.result.codes, one.scan.scanner.rig
    bare = triangulate(codes, rig, max_epipolar_px=0.0)  # 0 accepts pixels off their lines.
    residual_px = epipolar_residual_px(codes, bare, rig)
    known = np.isfinite(residual_px) & mask
    off = off_the_line(codes, residual_px, rig, limit_px=OFF_PX)[known]
    depth_m, sigma_m = bare.depth_m.astype(np.float64), bare.sigma_m
    bend_m = np.full(depth_m.shape, np.nan)
    bend_m[:, 1:-1] = depth_m[:, 2:] - 2 * depth_m[:, 1:-1] + depth_m[:, :-2]
    ratio = (np.abs(bend_m) / (np.sqrt(6) * sigma_m))[mask & np.isfinite(bend_m)]
    return {
        "depth %": 100 * float(np.isfinite(one.depth.depth_m[mask]).mean()),
        "saturated %": 100 * float((codes.reason[mask] == Reason.SATURATED).mean()),
        "off line %": 100 * float(off.mean()) if off.size else float("nan"),
        "noise / sigma": float(1.4826 * np.median(ratio)) if ratio.size else float("nan"),
    }


def contrasts_of(one: Pictures, mask: Mask) -> dict[str, float]:
    """Return, for each phase period, the median fringe contrast (amplitude / mean) in a mask."""
    contrasts = {}
    for axis, plan in plan_axes(one.scan.result.code, fine_bits=0).items():
        for period in plan.periods:
            values = one.frames[list(period.frames)][:, mask] - one.black_dn
            turn = np.exp(1j * np.asarray(period.delta_rad))
            amplitude = 2 * np.abs(turn @ values) / len(values)
            share = amplitude / np.maximum(values.mean(axis=0), 1.0)
            contrasts[f"{axis} {period.period_px:g}"] = round(float(np.median(share)), 3)
    return contrasts


# --- surface -------------------------------------------------------------------------------------


def _with_normals(mesh: Mesh, normal: Float[np.ndarray, "h w 3"], camera: Optics) -> Mesh:
    """Return the mesh with the normals of pixels as shading normals, where they are known."""
    corner_m = mesh.vertices_m[mesh.faces]
    # A corner is between pixels, so a point between corner and middle gives the face's own pixel.
    inside_m = corner_m + 0.25 * (corner_m.mean(axis=1, keepdims=True) - corner_m)
    own = normal[_pixels_of(inside_m.reshape(-1, 3), camera)].reshape(-1, 3, 3)
    with np.errstate(invalid="ignore"):  # Comparisons with NaN are false, so sides do not change.
        top = (own * mesh.face_normal[:, None]).sum(axis=-1) > 0.7
    assert mesh.corner_normals is not None  # `stage` gives its solid shading normals.
    return replace(mesh, corner_normals=np.where(top[..., None], own, mesh.corner_normals))


def _pixels_of(points_m: Float[np.ndarray, "n 3"], camera: Optics) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column of the pixel that shows each point, or of the nearest pixel."""
    place_px = np.rint(project(camera, points_m)).astype(int)
    return (
        np.clip(place_px[:, 1], 0, camera.height_px - 1),
        np.clip(place_px[:, 0], 0, camera.width_px - 1),
    )


def _faces_of(mesh: Mesh, own: Bool[np.ndarray, " f"]) -> Mesh:
    used, faces = np.unique(mesh.faces[own], return_inverse=True)
    normals = mesh.corner_normals
    return Mesh(
        vertices_m=mesh.vertices_m[used],
        faces=faces.reshape(-1, 3),
        corner_normals=None if normals is None else normals[own],
    )
