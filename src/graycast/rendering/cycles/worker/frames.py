"""Render a job: build its world once, and write each frame as soon as it is complete.

The file of a frame is complete or does not exist, and a frame with a file is not rendered again.
So the next process can continue a job that was interrupted.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from camera import CyclesCamera
from projector import Projector
from world import World

LIGHT = ("projected", "ambient")  # Kinds of frame with light; the others show a quantity.
TRUTH = ("position", "normal", "instance")  # Kinds of frame that are sampled at pixel centres.


def render_job(folder: Path) -> Iterator[str]:
    """Render a job; yield the name of each frame when its file is written."""
    job = json.loads((folder / "job.json").read_text())
    todo = [frame for frame in job["frames"] if not _file(folder, frame).exists()]
    if not todo:
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)  # This frees the data of the last job.
    scene = bpy.context.scene
    _settings(scene, job)
    camera = CyclesCamera(scene, job, folder)
    projector = Projector(scene, job, folder)
    world = World(scene, job, folder)
    for frame in todo:
        kind = frame["kind"]
        lit = kind in LIGHT
        world.show("light" if lit else kind, ambient=kind == "ambient")
        projector.show(frame["levels"], frame["bands"])
        camera.look(centre=kind in TRUTH)
        _for_kind(scene, job, frame, lit)
        _write(_file(folder, frame), _render(scene, folder))
        yield frame["name"]


def _file(folder: Path, frame: dict[str, Any]) -> Path:
    return folder / f"{frame['name']}.npy"


def _settings(scene: bpy.types.Scene, job: dict[str, Any]) -> None:
    """Set up unbiased path tracing, without clamps, cut-offs or filters."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = job["camera"]["width_px"], job["camera"]["height_px"]
    render.resolution_percentage = 100
    render.use_persistent_data = True  # Keep scene and BVH from frame to frame.
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode = "RGBA"
    render.image_settings.color_depth = "32"
    render.image_settings.exr_codec = "NONE"
    if job["threads"]:
        render.threads_mode, render.threads = "FIXED", job["threads"]
    if job["device"] != "cpu":
        _find_gpu(job["device"])
    cycles.use_adaptive_sampling = False
    cycles.pixel_filter_type = "BOX"
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.light_sampling_threshold = 0
    cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.transmission_bounces = cycles.volume_bounces = 0
    cycles.film_exposure = 1


def _find_gpu(device: str) -> None:
    preferences = bpy.context.preferences.addons["cycles"].preferences
    preferences.compute_device_type = device.upper()
    preferences.refresh_devices()
    if not any(one.type == device.upper() for one in preferences.devices):
        raise RuntimeError(f"Cycles finds no {device} device")
    for one in preferences.devices:
        one.use = one.type == device.upper()


def _for_kind(
    scene: bpy.types.Scene, job: dict[str, Any], frame: dict[str, Any], lit: bool
) -> None:
    cycles = scene.cycles
    bounces = job["depth"] - 1 if lit else 0
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    _set_samples(cycles, None if frame["kind"] in TRUTH else job["samples"])
    cycles.seed = frame["seed"]
    # Ground truth is one sample by an OSL camera, which CUDA does not support.
    cycles.device = "GPU" if job["device"] != "cpu" and frame["kind"] not in TRUTH else "CPU"
    scene.render.film_transparent = not lit  # Alpha is 0 where there is no surface.
    cycles.use_denoising = lit and job["denoise"] != "none"
    if cycles.use_denoising:
        cycles.denoiser = {"oidn": "OPENIMAGEDENOISE", "optix": "OPTIX"}[job["denoise"]]
        cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"


def _set_samples(cycles: Any, count: int | None) -> None:
    """Use `count` samples of Cycles' sequence after its first sample; None uses only the first.

    The first sample is always the exact centre of the pixel. As one of n samples, it would bias a
    pixel at an edge by 1 / n. A run of samples that starts at a power of two is well distributed.
    """
    cycles.use_sample_subset = count is not None
    cycles.samples = 1
    if count is not None:
        cycles.sample_offset, cycles.sample_subset_length = 1 << (count - 1).bit_length(), count
        cycles.samples = cycles.sample_offset + count


def _render(scene: bpy.types.Scene, folder: Path) -> np.ndarray:
    """Render and return the linear picture (h, w, 4) in float32, rows from the top."""
    file = folder / "frame.exr"  # Blender writes the pixels of a render only to files.
    scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(file))
    width, height = image.size
    pixels = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]


def _write(file: Path, picture: np.ndarray) -> None:
    part = file.with_suffix(".part")
    with part.open("wb") as stream:
        np.save(stream, np.ascontiguousarray(picture))
    os.replace(part, file)
