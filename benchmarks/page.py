"""The page docs/benchmarks.md, every figure of which is measured anew.

Each section measures, and returns its text. A figure that no section measures is not on the page.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

DROPS, SEEDS = (30, 100, 180, 255), range(1, 6)
PAPER = ("metal_workpiece_1", "toothpaste")
SCENES = 3  # of each paper configuration, after one that compiles
Rows = list[list[str]]

INTRODUCTION = """\
`python -m benchmarks page` measures every figure of this page anew and writes the page. It was
written on {date:.10} at commit `{commit}` on a machine with {cores} processors ({cpu}),
{memory_gib} GiB, Python {python} and no GPU. Ratios can be expected to hold on other machines;
seconds cannot. `python -m benchmarks compare REV` holds every stage against another commit. Figures
of a GPU are in [many-scenes.md](many-scenes.md#on-a-gpu), those of Blender Cycles in
[backends.md](backends.md#measured)."""


def page(root: Path, circumstances: dict[str, object], commit: str) -> Iterator[tuple[str, str]]:
    """The headings and texts of the page, in order; each takes seconds to minutes.

    Args:
        root: the repository.
        circumstances: date and machine, as in `__main__`.
        commit: what is measured.
    """
    sections: dict[str, Callable[[], str]] = {
        "Rendering": rendering,
        "Dropping parts": dropping,
        "One scene": one_scene,
        "Scenes as in the paper": lambda: paper_scenes(root),
        "Decoding": decoding,
        "Convex hulls": hulls,
    }
    yield "Benchmarks", INTRODUCTION.format(**circumstances, commit=commit).replace("\n", " ")
    for heading, measure in sections.items():
        yield heading, measure()


def rendering() -> str:
    from graycast.bench import measure_render

    found = measure_render("auto", 30)
    size = f"{found['width_px']} x {found['height_px']} pixels"
    return (
        f"30 brackets in a wooden box, {size}, {found['samples']} samples, path depth "
        f"{found['depth']}, a lamp and an environment. The stack has {found['patterns']} patterns, "
        "white, and ambient light in RGB. The frame is one white picture with the renderer's "
        "fastest settings (no footprint filter). Both are rendered in turn, five times; the ratio "
        "is the median of the pairs' ratios.\n\n"
    ) + table(
        ["stack", "one white frame", "`stack_over_frame`", "build", "ground truth"],
        [
            [
                *(f"{found[name]:.2f} s" for name in ("stack_s", "one_white_frame_s")),
                f"{found['stack_over_frame']:.2f}",
                *(f"{found[name]:.2f} s" for name in ("build_s", "ground_truth_s")),
            ]
        ],
    )


def dropping() -> str:
    from graycast.drop import DropLimits, drop

    cell = cell_of({"bin": {"inner_m": (0.5, 0.4, 0.2)}}, Path())
    rows = []
    for count in DROPS:
        drop(cell.scene, (1,), seed=0, limits=DropLimits())  # reads the hulls, or makes them once
        worked, simulated, attempts = [], [], []
        for seed in SEEDS:
            start = time.process_time()
            layout = drop(cell.scene, (count,), seed=seed, limits=DropLimits())
            worked.append(time.process_time() - start)
            simulated.append(layout.simulated_s)
            attempts.append(layout.attempt + 1)
        figures = f"{sum(worked):.1f} s", f"{median(worked):.2f} s", f"{max(worked):.2f} s"
        rows.append([str(count), *figures, f"{median(simulated):.2f} s", str(max(attempts))])
    head = ["brackets", "processor time of five seeds", "median", "most", "simulated, median"]
    return (
        "`metal_workpiece_1` in a bin of 0.5 x 0.4 x 0.2 m, seeds 1 to 5, one thread.\n\n"
        + table([*head, "attempts at most"], rows)
    )


def one_scene() -> str:
    from graycast.bench import measure_scene

    found = measure_scene("auto", 30, 8)
    rows = [[name, f"{seconds:.2f}"] for name, seconds in found["stages"].items()]
    rows.append(["scene (median)", f"{found['seconds_per_scene']:.2f}"])
    peak = max(found["rss_bytes_after_each_scene"]) / 1e9
    return (
        "The scene of *Rendering*, from the drop to the written files, after one scene that "
        "compiles the kernels.\n\n" + table(["stage", "seconds"], rows) + "\n\n"
        f"After a scene the process has {peak:.2f} GB of memory at most."
    )


def paper_scenes(root: Path) -> str:
    from graycast.cell import open_cell_renderer, resolve_cell
    from graycast.config import load_config
    from graycast.simulate import make_scene

    rows = []
    for name in PAPER:
        file = root / "configs" / "paper" / f"{name}.yaml"
        cell = resolve_cell(load_config(file), file.parent)
        seconds: list[dict[str, float]] = []
        with open_cell_renderer(cell) as renderer:
            for scene_id in range(1 + SCENES):
                shot = make_scene(cell, scene_id, seed=0, renderer=renderer)
                seconds.append(shot.sample.manifest["timings"])
        stages = {stage: median(own[stage] for own in seconds[1:]) for stage in seconds[0]}
        whole = median(sum(own.values()) for own in seconds[1:])
        rows.append([name, *(f"{s:.2f}" for s in stages.values()), f"{3600 / whole:.0f}"])
    return (
        f"Median seconds of {SCENES} scenes in one process with all processors, without writing: "
        "`configs/paper/`, 100 to 255 brackets or 5 to 10 cartons, 20 samples.\n\n"
    ) + table(["", *stages, "scenes an hour"], rows)


def decoding() -> str:
    from graycast.bench import measure_decode

    found = measure_decode()
    size = f"{found['frames']} frames of {found['width_px']} x {found['height_px']} pixels"
    rows: Rows = [
        [f"Gray code, {size}", f"{1e3 * found['decode_s']:.0f} ms"],
        ["one copy of that stack", f"{1e3 * found['copy_s']:.0f} ms"],
        ["the same in plain NumPy", f"{found['plain_numpy_s']:.1f} s"],
    ]
    for name in ("gray_phase_s", "multi_frequency_s"):
        code = name.removesuffix("_s")
        rows += [[f"`{code}`, {what}", f"{1e3 * s:.0f} ms"] for what, s in found[name].items()]
    return (
        "Pictures of 8 bit become positions, standard deviations and reasons. Gray code has both "
        "axes with inverses; codes with phases have one axis of 1280 columns.\n\n"
    ) + table(["", "time"], rows)


def hulls() -> str:
    from graycast.bench import measure_hulls

    names = "hulls", "vertices", "filled_mm", "lost_mm", "tolerance_mm", "processor_s"
    rows = []
    for row in measure_hulls()["hulls"]:
        rows.append([row["part"], *(_short(row[name]) for name in names)])
    return (
        "The convex hulls with which the physics engine computes collisions. *Filled* is the "
        "largest distance by which the hulls extend beyond the part, *lost* the largest distance "
        "by which the part's surface lies outside all hulls; the *bound* is the tolerance that "
        "neither may exceed ([drop.md](drop.md#what-collides)). Hulls are made once and kept.\n\n"
    ) + table(
        ["part", "hulls", "vertices", "filled mm", "lost mm", "bound mm", "processor s"], rows
    )


def cell_of(settings: dict[str, Any], folder: Path) -> Any:
    from graycast.bench.cells import paper_cell
    from graycast.cell import resolve_cell
    from graycast.config import Config

    plain = paper_cell(30).config.model_dump(exclude_unset=True)
    return resolve_cell(Config.model_validate(plain | settings), folder)


def table(head: list[str], rows: Rows) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _short(value: float) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)
