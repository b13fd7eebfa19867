"""Writer of docs/measurements/benchmarks.md, which measures every figure of the page.

The function of each section makes its measurements and returns its text.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import UInt8

from graycast.base.tables import markdown_table
from graycast.camera.decode import DecodeSpec, Levels, decode
from graycast.cell.config import load_config, resolve_quality
from graycast.cell.generate import depth_step_mm
from graycast.cell.resolve import open_cell_renderer, resolve_cell
from graycast.cell.simulate import make_scene
from graycast.dataset.write.store import open_store
from graycast.rendering import open_renderer
from graycast.rig.pattern import Code, gray, gray_phase, multi_frequency
from graycast.world.drop import DropLimits, drop
from graycast.world.drop.decomposition import decompose, measure

from .figures import in_turn
from .processes import peak_rss_bytes
from .stages import PARTS, cell_of
from .zoo_parts import ZOO, wavy_ring, zoo_part

DROPS, SEEDS = (30, 100, 180, 255), range(1, 6)
PAPER = ("metal_workpiece_1", "toothpaste")
SCENES, PAPER_SCENES = 8, 3  # scenes that are timed after a first scene, which compiles kernels
DENSE_FACES = (80_000, 330_000, 500_000)
MOST_HULLS = 8  # rows of the table of hulls
ROOT = Path(__file__).resolve().parents[1]

INTRODUCTION = """\
`python -m benchmarks page` measured every figure and wrote this page on {date:.10} at commit
`{commit}`, with {cores} processors ({cpu}), {memory_gib} GiB, Python {python} and no GPU. Ratios
hold on other machines; seconds do not. `python -m benchmarks compare REV` compares another commit.
[Many scenes](many-scenes.md) has figures of a GPU, [renderers](renderers.md) of Blender Cycles."""


def page(
    circumstances: dict[str, object], commit: str, names: Sequence[str] = ()
) -> Iterator[tuple[str, str]]:
    """Yield the headings and texts of the page in order; each takes seconds to minutes.

    Args:
        circumstances: date and machine, from `__main__.circumstances`.
        commit: the measured commit.
        names: names in `SECTIONS`; empty means all sections.
    """
    yield "Benchmarks", INTRODUCTION.format(**circumstances, commit=commit).replace("\n", " ")
    for name in names or SECTIONS:
        heading, measure = SECTIONS[name]
        yield heading, measure()


def rendering() -> str:
    open_renderer("mitsuba")  # It must choose the device before the next imports.
    from graycast.rendering.mitsuba.renderer import light
    from graycast.rendering.mitsuba.scene import build
    from graycast.rendering.mitsuba.truth import truth

    cell = cell_of({})
    layout = drop(cell.scene, (PARTS,), seed=0, limits=DropLimits())
    start = time.perf_counter()
    world = build(cell.scene, layout)
    build_s = time.perf_counter() - start
    patterns, quality = cell.patterns(), resolve_quality(cell.config)
    # The footprint filter does not change a white picture, so the frame is rendered without it.
    plain = replace(quality, footprint=False)
    stack_s, frame_s, ratio = in_turn(
        lambda: light(world, cell.scene, patterns, quality=quality, seed=1),
        lambda: light(world, cell.scene, patterns[:1], quality=plain, seed=1),
    )
    start = time.perf_counter()
    truth(world.scene, world.part_shapes, cell.scene, layout)
    seconds = stack_s, frame_s, build_s, time.perf_counter() - start
    stack, frame, build_time, ground_truth = (f"{s:.2f} s" for s in seconds)
    camera = cell.scene.rig.camera
    return (
        f"A stack of {len(patterns)} patterns, white and ambient light against one white frame "
        f"without the footprint filter: {PARTS} brackets in a wooden box, {camera.width_px} x "
        f"{camera.height_px} pixels, {quality.samples} samples, path depth {quality.depth}, a lamp "
        "and an environment. The ratio is the median of five pairs.\n\n"
    ) + markdown_table(
        ["stack", "one white frame", "ratio", "build", "ground truth"],
        [[stack, frame, f"{ratio:.2f}", build_time, ground_truth]],
    )


def dropping() -> str:
    cell = cell_of({"bin": {"inner_m": (0.5, 0.4, 0.2)}})
    rows = []
    for count in DROPS:
        drop(cell.scene, (1,), seed=0, limits=DropLimits())  # Later drops find the hulls cached.
        worked, simulated, attempts = [], [], []
        for seed in SEEDS:
            start = time.process_time()
            layout = drop(cell.scene, (count,), seed=seed, limits=DropLimits())
            worked.append(time.process_time() - start)
            simulated.append(layout.simulated_s)
            attempts.append(layout.attempt + 1)
        figures = (f"{s:.2f}" for s in (median(worked), max(worked), median(simulated)))
        rows.append([str(count), *figures, str(max(attempts))])
    head = ["brackets", "median", "most", "simulated, median", "attempts at most"]
    return (
        "Processor seconds of `metal_workpiece_1` in a bin of 0.5 x 0.4 x 0.2 m, seeds 1 to 5, one "
        "thread.\n\n" + markdown_table(head, rows)
    )


def one_scene() -> str:
    cell, renderer = cell_of({}), open_renderer("mitsuba")
    times: dict[str, list[float]] = {}
    with TemporaryDirectory() as folder:
        shared: Any = {"parts": cell.scene.parts, "rig": cell.scene.rig, "config": {}, "seed": 0}
        out = Path(folder) / "dataset"
        with open_store(out, depth_scale_mm=depth_step_mm(cell), **shared) as store:
            for scene_id in range(1 + SCENES):
                start = time.perf_counter()
                shot = make_scene(cell, scene_id, seed=0, renderer=renderer)
                write_start = time.perf_counter()
                store.write(scene_id, [shot.sample])
                ended = time.perf_counter()
                timings = shot.sample.manifest["timings"] | {"write": ended - write_start}
                for stage, value in (timings | {"scene (median)": ended - start}).items():
                    times.setdefault(stage, []).append(value)
    rows = [[stage, f"{median(seconds[1:]):.2f}"] for stage, seconds in times.items()]
    peak = peak_rss_bytes() / 1e9
    return (
        f"The scene of *Rendering*, from the drop to the files, median of {SCENES} after one that "
        "compiles the kernels; the process had "
        f"{peak:.2f} GB of memory at most.\n\n" + markdown_table(["stage", "seconds"], rows)
    )


def paper_scenes() -> str:
    rows = []
    for name in PAPER:
        file = ROOT / "configs" / "paper" / f"{name}.yaml"
        cell = resolve_cell(load_config(file), file.parent)
        seconds: list[dict[str, float]] = []
        with open_cell_renderer(cell) as renderer:
            for scene_id in range(1 + PAPER_SCENES):
                shot = make_scene(cell, scene_id, seed=0, renderer=renderer)
                seconds.append(shot.sample.manifest["timings"])
        stages = {stage: median(own[stage] for own in seconds[1:]) for stage in seconds[0]}
        whole = median(sum(own.values()) for own in seconds[1:])
        rows.append([name, *(f"{s:.2f}" for s in stages.values()), f"{3600 / whole:.0f}"])
    return (
        f"Median seconds of {PAPER_SCENES} scenes of `configs/paper/` in one process, without "
        "writing: 100 to 255 brackets or 5 to 10 cartons, 20 samples.\n\n"
    ) + markdown_table(["", *stages, "scenes an hour"], rows)


def decoding() -> str:
    levels = Levels(offset_dn=4.0, saturation_dn=255.0, floor_dn2=0.1, slope_dn=0.025)
    rng, times = np.random.default_rng(0), {}
    for name, code, *sizes in (
        ("Gray code", gray(1280, 720, inverses=True), (1920, 1080)),
        ("`gray_phase`", gray_phase(1280, 720), (1032, 772), (1920, 1080)),
        ("`multi_frequency`", multi_frequency(1280, 720), (1032, 772), (1920, 1080)),
    ):
        for width_px, height_px in sizes:
            frames = camera_frames(code, rng, width_px, height_px)
            job = partial(decode, frames, code, DecodeSpec(), levels)
            decode_s, copy_s, _ = in_turn(job, frames.copy)
            size = f"{len(frames)} frames of {width_px} x {height_px}"
            times[f"{name}, {size}"] = decode_s
            times.setdefault("one copy of that stack", copy_s)
    return (
        "Pictures of 8 bit become positions, standard deviations and reasons: Gray code of both "
        "axes with inverses, codes with phases of 1280 columns.\n\n"
    ) + markdown_table(["", "ms"], [[what, f"{1e3 * s:.0f}"] for what, s in times.items()])


def camera_frames(
    code: Code, rng: np.random.Generator, width_px: int, height_px: int
) -> UInt8[np.ndarray, "n h w"]:
    """Return noisy 8-bit frames of a camera whose picture is the projector's, resampled."""
    row = np.linspace(0, code.height_px - 1, height_px).astype(int)[:, None]
    column = np.linspace(0, code.width_px - 1, width_px).astype(int)
    frames = np.empty((len(code.frames), height_px, width_px), dtype=np.uint8)
    for frame, pattern in zip(frames, code.render(), strict=True):
        frame[:] = 20 + 0.7 * pattern[row, column] + rng.normal(0, 1.5, frame.shape)
    return frames


def hulls() -> str:
    """Measure the collision hulls of each part of the zoo, and of smooth rings with many faces."""
    meshes = {name: zoo_part(name).mesh for name in ZOO}
    meshes |= {f"ring of {faces} faces": wavy_ring(faces) for faces in DENSE_FACES}
    rows = []
    for name, mesh in meshes.items():
        start = time.process_time()
        pieces = decompose(mesh)
        worked_s = time.process_time() - start
        if len(pieces) == 1:
            continue
        figures = measure(mesh, pieces)
        rows.append((name, len(pieces), figures.worst_m, figures.tolerance_m, worked_s))
    within = sum(off_m <= bound_m for _, _, off_m, bound_m, _ in rows)
    rows.sort(key=lambda row: -row[1])
    return (
        f"{len(rows)} parts [collide](../explanation/drop.md#what-collides) by more than one "
        f"convex hull. The hulls of {within} are nearer to the part's surface than their bound. "
        f"These {MOST_HULLS} have the most:\n\n"
    ) + markdown_table(
        ["part", "hulls", "off mm", "bound mm", "processor s"],
        [
            [name, str(count), f"{1e3 * off_m:.2f}", f"{1e3 * bound_m:.2f}", f"{worked_s:.2f}"]
            for name, count, off_m, bound_m, worked_s in rows[:MOST_HULLS]
        ],
    )


SECTIONS: dict[str, tuple[str, Callable[[], str]]] = {
    "rendering": ("Rendering", rendering),
    "drops": ("Dropping parts", dropping),
    "scene": ("One scene", one_scene),
    "paper": ("Scenes as in the paper", paper_scenes),
    "decoding": ("Decoding", decoding),
    "hulls": ("Convex hulls", hulls),
}
