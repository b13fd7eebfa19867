"""The stages of a scene: rendering, decoding, dropping, and all of them. Ratios are of one run."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from jaxtyping import UInt8

from ..config import resolve_quality
from ..dataset import open_store
from ..decode import DecodeSpec, Levels, decode, decode_plain
from ..drop import DropLimits, drop
from ..generate import depth_step_mm
from ..pattern import Code, gray, gray_phase, multi_frequency
from ..render import open_renderer
from ..simulate import make_scene
from ..usage import rss_bytes
from .cells import paper_cell
from .figures import Figures

PAIRS = 5  # timed in turn, A B A B ...


def in_turn(
    first: Callable[[], object], second: Callable[[], object]
) -> tuple[float, float, float]:
    """Median seconds of two jobs that are run in turn, after one run of each to warm up.

    The third value is the median of the pairs' ratios: other work of the machine slows both jobs of
    a pair, and a ratio of medians compares runs of different pairs.
    """
    first(), second()
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(PAIRS):
        for job, times in zip((first, second), seconds, strict=True):
            start = time.perf_counter()
            job()
            times.append(time.perf_counter() - start)
    ratios = [one / other for one, other in zip(*seconds, strict=True)]
    return median(seconds[0]), median(seconds[1]), median(ratios)


def measure_render(device: str, count: int) -> Figures:
    renderer = open_renderer("mitsuba", device=device)
    from ..render.mitsuba import light
    from ..render.mitsuba_scene import build
    from ..render.mitsuba_truth import truth

    cell = paper_cell(count)
    layout = drop(cell.scene, (count,), seed=0, limits=DropLimits())
    start = time.perf_counter()
    world, part_shapes = build(cell.scene, layout)
    build_s = time.perf_counter() - start
    patterns, quality = cell.patterns(), resolve_quality(cell.config)

    def stack() -> object:
        return light(world, cell.scene, patterns, quality=quality, seed=1)

    def frame() -> object:
        # Its cheapest form: a white picture is the same over any footprint.
        plain = replace(quality, footprint=False)
        return light(world, cell.scene, patterns[:1], quality=plain, seed=1)

    stack_s, frame_s, ratio = in_turn(stack, frame)
    start = time.perf_counter()
    truth(world, part_shapes, cell.scene, layout)
    camera = cell.scene.rig.camera
    return {
        "device": renderer.device,
        "parts": count,
        "patterns": len(patterns),
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "samples": quality.samples,
        "depth": quality.depth,
        "stack_s": stack_s,
        "one_white_frame_s": frame_s,
        "stack_over_frame": ratio,
        "build_s": build_s,
        "ground_truth_s": time.perf_counter() - start,
    }


def measure_decode() -> Figures:
    """44 frames of 1920 x 1080, 8 bit: 11 + 10 bits with inverses, white and black; then phases.

    OpenCV's decoder, where it is installed, matches two cameras and takes 42 frames of each.
    """
    code = gray(1280, 720, inverses=True)
    rng = np.random.default_rng(0)
    frames = _seen_by_camera(code, rng, 1920, 1080)
    levels = Levels(offset_dn=4.0, saturation_dn=255.0, floor_dn2=0.1, slope_dn=0.025)
    spec = DecodeSpec()
    decode_s, copy_s, ratio = in_turn(lambda: decode(frames, code, spec, levels), frames.copy)
    start = time.perf_counter()
    decode_plain(frames, code, spec, levels)
    figures: Figures = {
        "frames": len(frames),
        "width_px": 1920,
        "height_px": 1080,
        "decode_s": decode_s,
        "copy_s": copy_s,
        "decode_over_copy": ratio,
        "plain_numpy_s": time.perf_counter() - start,
    }
    figures |= _decode_by_opencv(frames, code, decode_s)
    for name, make in (("gray_phase_s", gray_phase), ("multi_frequency_s", multi_frequency)):
        figures[name] = {}
        for width_px, height_px in ((1032, 772), (1920, 1080)):
            code = make(1280, 720)
            frames = _seen_by_camera(code, rng, width_px, height_px)
            seconds, *_ = in_turn(partial(decode, frames, code, spec, levels), frames.copy)
            figures[name][f"{len(frames)} frames {width_px} x {height_px}"] = seconds
    return figures


def _seen_by_camera(
    code: Code, rng: np.random.Generator, width_px: int, height_px: int
) -> UInt8[np.ndarray, "n h w"]:
    """Frames of a camera that sees the whole projector, with noise."""
    row = np.linspace(0, code.height_px - 1, height_px).astype(int)[:, None]
    column = np.linspace(0, code.width_px - 1, width_px).astype(int)
    frames = np.empty((len(code.frames), height_px, width_px), dtype=np.uint8)
    for frame, pattern in zip(frames, code.render(), strict=True):
        frame[:] = 20 + 0.7 * pattern[row, column] + rng.normal(0, 1.5, frame.shape)
    return frames


def _decode_by_opencv(frames: UInt8[np.ndarray, "n h w"], code: Code, decode_s: float) -> Figures:
    """`cv2.structured_light`, which only the contrib packages of OpenCV have."""
    import cv2

    if not hasattr(cv2, "structured_light"):
        missing = (
            "not measured: this OpenCV has no structured_light: run pip install --force-reinstall "
            "--no-deps opencv-contrib-python-headless"
        )
        return {"opencv_over_decode": missing}
    pattern = cv2.structured_light.GrayCodePattern.create(code.width_px, code.height_px)
    pattern.setWhiteThreshold(5)
    pattern.setBlackThreshold(40)
    white, black, bits = frames[:1], frames[1:2], frames[2:]
    start = time.perf_counter()
    pattern.decode([list(bits)] * 2, None, list(black) * 2, list(white) * 2)
    opencv_s = time.perf_counter() - start
    return {"opencv_s": opencv_s, "opencv_over_decode": opencv_s / decode_s}


def measure_drop(count: int) -> Figures:
    cell = paper_cell(count)
    drop(cell.scene, (count,), seed=0, limits=DropLimits())  # decomposes the part once
    seconds, depths, attempts = [], [], []
    for seed in range(1, 1 + PAIRS):
        start = time.perf_counter()
        layout = drop(cell.scene, (count,), seed=seed, limits=DropLimits())
        seconds.append(time.perf_counter() - start)
        depths.append(layout.deepest_penetration_m)
        attempts.append(layout.attempt + 1)
    return {
        "parts": count,
        "drop_s": median(seconds),
        "each_s": seconds,
        "deepest_penetration_m": max(depths),
        "attempts": attempts,
    }


def measure_scene(device: str, count: int, scenes: int) -> Figures:
    cell = paper_cell(count)
    renderer = open_renderer("mitsuba", device=device)
    scale_mm = depth_step_mm(cell)
    stages: dict[str, list[float]] = {}
    seconds, rss = [], []
    with tempfile.TemporaryDirectory() as folder:
        store = open_store(
            Path(folder) / "bench",
            config={},
            seed=0,
            parts=cell.scene.parts,
            rig=cell.scene.rig,
            depth_scale_mm=scale_mm,
        )
        with store:
            for scene_id in range(1 + scenes):
                start = time.perf_counter()
                shot = make_scene(cell, scene_id, seed=0, renderer=renderer)
                made = time.perf_counter()
                store.write(scene_id, [shot.sample])
                ended = time.perf_counter()
                rss.append(rss_bytes())
                if scene_id == 0:
                    continue  # compiles the kernels
                seconds.append(ended - start)
                timings = shot.sample.manifest["timings"] | {"write": ended - made}
                for stage, value in timings.items():
                    stages.setdefault(stage, []).append(value)
    split = {stage: median(values) for stage, values in stages.items()}
    total = sum(split.values())
    return {
        "device": renderer.device,
        "parts": count,
        "patterns": len(cell.code.frames),
        "scenes": scenes,
        "seconds_per_scene": median(seconds),
        "stages": split,
        "render_share": split["render"] / total,
        "rss_bytes_after_each_scene": rss,
    }
