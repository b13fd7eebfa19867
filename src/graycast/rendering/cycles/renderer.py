"""The `Renderer` that uses Blender Cycles.

Each pattern, the white picture and the ambient picture are separate renders with different random
numbers, so noise differs between patterns, as in the paper. White patterns reuse the white picture,
and black patterns are not rendered. The ambient picture is rendered once for all frames.

Limits: no constant blur (`psf_px`) of the projector; silhouettes are rasterised by `rig.meshdepth`
and, with a distorted lens, end at the image.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import DeviceError, GraycastError
from ...base.frames import inverse, transform_points
from ...rig.meshdepth import rasterize
from ...rig.optics import in_picture, picture_rays, points, project, relative_illumination
from ...rig.pair import Rig
from ...world.scene import Layout, Scene
from ..denoise import open_denoiser
from ..device import examine_cuda
from ..radiance import (
    Denoiser,
    GroundTruth,
    OnFrame,
    Patterns,
    Quality,
    Radiance,
    Renderer,
    Rendering,
    Silhouette,
    refuse_other_size,
)
from ..wavelength import at_one_wavelength, at_projector_wavelength, refuse_layers
from .job import (
    ALBEDO,
    LOOK,
    TRUTH,
    Bands,
    Render,
    is_simple,
    need_renders,
    pattern_frames,
    write_job,
)
from .process import CyclesDied, CyclesProcess, CyclesState, examine_cycles

DEVICES = ("auto", "cpu", "cuda", "optix")
MAX_DEATHS = 3
NORMAL_OFFSET = 2.0  # worker/materials.py adds this offset.

GREY = (1 / 3, 1 / 3, 1 / 3)

Pictures = dict[str, Float[np.ndarray, "h w 4"]]


def choose_cycles_device(name: str, cycles: CyclesState) -> str:
    """Return the device on which Cycles renders: 'cpu', 'cuda' or 'optix'.

    Raises:
        DeviceError: the device, or Cycles itself, is not available.
        ValueError: there is no such name.
    """
    if name not in DEVICES:
        raise ValueError(f"Cycles has no device {name!r}: choose one of {', '.join(DEVICES)}")
    if not cycles.usable:
        raise DeviceError(cycles.problem)
    if name == "cpu":
        return name
    cuda = examine_cuda()
    usable = cuda.devices if name == "cuda" else cuda.usable
    if name == "auto":
        return "optix" if usable else "cpu"
    if not usable:
        why = cuda.problem or "libnvoptix.so.1 cannot be loaded"
        raise DeviceError(f"device {name} cannot be used: {why}; use --device cpu")
    return name


@final
class CyclesRenderer(Renderer):
    """A renderer with one child process, which is replaced if it dies."""

    name = "cycles"

    def __init__(
        self,
        *,
        device: str = "auto",
        threads: int | None = None,
        patterns_per_render: int = 1,
        on_frame: OnFrame | None = None,
    ):
        if patterns_per_render not in (1, 3):
            raise ValueError(
                f"patterns_per_render is {patterns_per_render}; give 1, or 3 (R, G and B)"
            )
        cycles = examine_cycles()
        self.device = choose_cycles_device(device, cycles)
        if cycles.python is None:
            raise DeviceError("Blender Cycles has no Python to run in")
        self.versions = {"bpy": str(cycles.version)}
        self._python = cycles.python
        self.threads, self.patterns_per_render = threads, patterns_per_render
        self.on_frame = on_frame or (lambda done, total: None)
        self._process: CyclesProcess | None = None
        self.denoiser: Denoiser = open_denoiser("cpu")

    def render(
        self, scene: Scene, layout: Layout, pattern: Patterns, *, quality: Quality, seed: int
    ) -> Rendering:
        refuse_layers(scene, "Cycles")
        self._refuse(scene.rig, pattern, quality)
        look, measured, bands = scene, at_projector_wavelength(scene), scene.rig.band_weights
        if self._in_grey(scene.rig, quality):
            measured = at_one_wavelength(measured)
            bands = bands if measured is look else GREY
        frames = pattern_frames(need_renders(pattern), self.patterns_per_render)
        seeds = np.random.SeedSequence(seed).generate_state(2).tolist()
        settings: dict[str, object] = {"device": self.device, "threads": self.threads}
        settings |= {name: getattr(quality, name) for name in ("samples", "depth", "denoise")}

        def shoot(scene: Scene, frames: tuple[Render, ...], bands: Bands, seed: int) -> Pictures:
            # Halve the numbers, because Cycles' seeds are signed.
            seeds = np.random.SeedSequence(seed).generate_state(len(frames)) >> 1
            orders = [frame.order(bands, int(n)) for frame, n in zip(frames, seeds, strict=True)]
            with tempfile.TemporaryDirectory(prefix="graycast-cycles-") as name:
                folder = Path(name)
                write_job(folder, scene, layout, pattern, settings | {"frames": orders})
                self._run(folder, frames)
                return {frame.name: np.load(folder / f"{frame.name}.npy") for frame in frames}

        both = measured is look
        own = (*frames, *LOOK, *TRUTH, *(ALBEDO if both else ()))
        pictures = colour = shoot(measured, own, bands, seeds[0])
        if not both:
            colour = shoot(look, (*LOOK, *ALBEDO), scene.rig.band_weights, seeds[1])
        truth = _truth(scene, layout, pictures)
        radiance = _radiance(scene.rig, pictures, colour, pattern, frames)
        place_px = _centre_places(scene.rig, truth, radiance.white > 0)
        return Rendering(radiance=replace(radiance, place_px=place_px), truth=truth)

    def _refuse(self, rig: Rig, pattern: Patterns, quality: Quality) -> None:
        refuse_other_size(pattern, rig.projector)
        if rig.projector.psf_px:
            raise ValueError(
                "Cycles cannot render the blur psf_px of the projector: set it to 0, or use mitsuba"
            )
        if quality.denoise == "optix" and self.device == "cpu":
            raise ValueError("denoise optix needs an NVIDIA GPU: use oidn, or --device optix")
        if self.device == "cuda" and not is_simple(rig.camera):
            raise ValueError(
                "Cycles on CUDA supports only pinhole cameras with square pixels and without "
                "distortion: use --device optix or cpu"
            )
        if self.patterns_per_render == 3 and quality.denoise != "none":
            raise ValueError(
                "a denoiser would mix the three patterns of a render: set patterns_per_render to "
                "1, or denoise to none"
            )

    def _in_grey(self, rig: Rig, quality: Quality) -> bool:
        """Return whether light of one wavelength is rendered equally in all bands.

        This lets several patterns share a render. It also helps a denoiser, which was trained on
        photographs and would blur the stripes in, for example, a red picture.
        """
        one_line = sum(weight > 0 for weight in rig.band_weights) == 1
        return self.patterns_per_render == 3 or (one_line and quality.denoise != "none")

    def close(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None

    def _run(self, folder: Path, frames: tuple[Render, ...]) -> None:
        """Run a job to its end; if the process dies, a new process renders the missing frames."""
        for _ in range(MAX_DEATHS):
            if self._process is None:
                self._process = CyclesProcess(self._python)
            try:
                written = sum((folder / f"{frame.name}.npy").exists() for frame in frames)
                for done, _ in enumerate(self._process.run(folder), start=written + 1):
                    self.on_frame(done, len(frames))
                return
            except CyclesDied as error:
                why = error
                self.close()
            except BaseException:
                self.close()  # The child may be in the middle of a job.
                raise
        raise GraycastError(
            f"the process of Blender Cycles ended {MAX_DEATHS} times on one scene: {why}"
        )


def _radiance(
    rig: Rig,
    pictures: Pictures,
    colour: Pictures,
    pattern: Patterns,
    frames: tuple[Render, ...],
) -> Radiance:
    camera = rig.camera
    share = relative_illumination(camera).astype(np.float32)[..., None]
    white = (pictures["white"][..., :3] * share).sum(axis=-1)
    # A pattern without a render is white or black.
    stack = np.where((pattern.max(axis=(1, 2)) == 255)[:, None, None], white, np.float32(0))
    for frame in frames:
        bands = pictures[frame.name][..., :3] * share
        if len(frame.levels) == 1:
            np.sum(bands, axis=-1, out=stack[frame.levels[0]])
            continue
        for band, number in enumerate(frame.levels):
            if number >= 0:
                stack[number] = bands[..., band]
    ambient = pictures["ambient"][..., :3] * share
    return Radiance(
        pattern=stack,
        white=white,
        ambient=ambient @ np.array(rig.passed_bands, dtype=np.float32),
        white_rgb=colour["white"][..., :3] * share,
        ambient_rgb=colour["ambient"][..., :3] * share,
        albedo=np.ascontiguousarray(colour["albedo"][..., :3]),
    )


def _centre_places(
    rig: Rig, truth: GroundTruth, lit: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "2 h w"]:
    """Return the projector position [px] of the surface at each lit pixel's centre, or NaN.

    Cycles does not report the origin of light. If another surface shades the centre of a pixel, the
    position is computed as if there were no obstacle.
    """
    point = transform_points(rig.T_proj_cam, points(rig.camera, truth.depth_m))
    place_px = project(rig.projector, point)
    inside = lit & np.isfinite(truth.depth_m) & in_picture(rig.projector, place_px)
    return np.moveaxis(np.where(inside[..., None], place_px, np.nan), -1, 0).astype(np.float32)


def _truth(scene: Scene, layout: Layout, pictures: Pictures) -> GroundTruth:
    camera = scene.rig.camera
    hit = pictures["position"][..., 3] > 0.5
    T_cam_world = inverse(scene.T_world_cam)
    point = transform_points(T_cam_world, pictures["position"][..., :3].astype(np.float64))
    normal = (pictures["normal"][..., :3].astype(np.float64) - NORMAL_OFFSET) @ T_cam_world[
        :3, :3
    ].T
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    ray = picture_rays(camera)
    normal *= -np.sign((normal * ray).sum(axis=-1, keepdims=True))
    instance = np.where(hit, np.rint(pictures["instance"][..., 0]).astype(np.int32) - 1, -1)
    return GroundTruth(
        depth_m=np.where(hit, point[..., 2], np.nan),
        normal=np.where(hit[..., None], normal, np.nan),
        instance=instance,
        amodal=tuple(
            _silhouette(scene, layout, index, instance == index)
            for index in range(len(layout.part_index))
        ),
    )


def _silhouette(scene: Scene, layout: Layout, index: int, visible: np.ndarray) -> Silhouette:
    """Return the outline of the mesh plus its visible pixels; rounding may differ at the border."""
    part = scene.parts[layout.part_index[index]]
    T_cam_part = inverse(scene.T_world_cam) @ layout.T_world_part[index]
    vertices_cam = transform_points(T_cam_part, part.mesh.vertices_m)
    # A vertex beyond the fold of a distorted lens has no image.
    imaged = np.isfinite(project(scene.rig.camera, vertices_cam)).all(axis=-1)
    faces = part.mesh.faces[imaged[part.mesh.faces].all(axis=-1)]
    raster = rasterize(vertices_cam, faces, scene.rig.camera)
    rows, columns = np.nonzero(np.isfinite(raster.z))
    visible_rows, visible_columns = np.nonzero(visible)
    rows = np.concatenate([rows + raster.top_px, visible_rows])
    columns = np.concatenate([columns + raster.left_px, visible_columns])
    if len(rows) == 0:
        return Silhouette(left_px=0, top_px=0, mask=np.zeros((0, 0), dtype=bool))
    top, left = int(rows.min()), int(columns.min())
    mask = np.zeros((int(rows.max()) - top + 1, int(columns.max()) - left + 1), dtype=bool)
    mask[rows - top, columns - left] = True
    return Silhouette(left_px=left, top_px=top, mask=mask)
