"""The stages that `compare` times: python -P benchmarks/stages.py STAGES ROUND WORK

`PYTHONPATH` must be the `src` of the measured tree. The program writes each result as a line of
JSON. ROUND is a number, which determines the seeds of the drops, or `warm`, which fills caches and
whose results are ignored. WORK is a folder that both trees share.
"""

import inspect
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import count
from pathlib import Path
from statistics import median
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any

Job = tuple[str, str, int, Callable[[], object]]  # stage, row, number of runs, function to time
Group = Callable[[Path, int], Iterator[Job]]

BRACKET = "metal_workpiece_1"
DROPS = ((30, 8), (100, 3), (180, 1), (255, 1))  # numbers of parts, and of drops in a round
PARTS = 30  # number of parts in the picture
SAMPLES = 16
WHITE_SAMPLES = 4  # At 16 samples, one frame would take as long as a stack.
SCENES = 3  # number of scenes in the validated dataset


def imports(work: Path, number: int) -> Iterator[Job]:
    for row, words in (
        ("import graycast", ("-c", "import graycast")),
        ("graycast --help", ("-c", "from graycast.cli import main; main(['--help'])")),
    ):
        command = [sys.executable, *words]
        job = partial(subprocess.run, command, check=True, stdout=subprocess.DEVNULL)
        yield "import", row, 9, job


def hulls(work: Path, number: int) -> Iterator[Job]:
    from graycast.world.drop import prepare
    from graycast.world.parts import builtin_part

    for name in (BRACKET, "hygiene_spray"):
        empty = Path(mkdtemp(dir=work))
        job = partial(prepare, (builtin_part(name),), hull_folder=empty)
        yield "hulls", f"hulls, {name}", 1, job


def drops(work: Path, number: int) -> Iterator[Job]:
    from graycast.world.drop import DropLimits, drop

    scene = cell_of({"bin": {"inner_m": (0.5, 0.4, 0.2)}}).scene

    def several(parts: int, seeds: range) -> None:
        for seed in seeds:
            drop(scene, (parts,), seed=seed, limits=DropLimits())

    several(1, range(1))  # The timed drops must find the hulls cached.
    for parts, each in DROPS:
        # Each round has other seeds, because the time of a drop depends strongly on the seed.
        seeds = range(1 + number * each, 1 + (number + 1) * each)
        yield "drop", f"drop, {each} x {parts} parts", 1, partial(several, parts, seeds)


def images(work: Path, number: int) -> Iterator[Job]:
    from graycast.camera.picture import color_picture
    from graycast.camera.scanner import measure, take
    from graycast.cell.config import resolve_quality
    from graycast.rendering import open_renderer

    cell, renderer = cell_of({}), open_renderer("mitsuba")
    layout, patterns = stored_layout(work, cell.scene), cell.patterns()

    @cache  # Later stages use the stack that was timed.
    def render(frames: int, samples: int, seed: int) -> Any:
        quality = replace(resolve_quality(cell.config), samples=samples)
        return renderer.render(cell.scene, layout, patterns[:frames], quality=quality, seed=seed)

    render(1, WHITE_SAMPLES, 0)  # Loading the libraries must not be timed.
    white, stack = (1, WHITE_SAMPLES, 1), (len(patterns), SAMPLES, 1)
    yield "render", f"render, white frame, {WHITE_SAMPLES} samples", 1, partial(render, *white)
    yield "render", f"render, stack, {SAMPLES} samples", 1, partial(render, *stack)
    light, scanner = render(*stack), cell.scanner
    yield "sensor", "sensor", 3, partial(take, scanner, light.radiance, seed=1)
    develop = partial(color_picture, scanner, light, denoiser=renderer.denoiser, seed=1)
    yield "picture", "picture, denoised", 3, develop
    capture = take(scanner, light.radiance, seed=1)
    noise = {}  # Commits before 7292fe19 find the noise of the light without this argument.
    if "path_noise" in inspect.signature(measure).parameters:
        noise = {"path_noise": light.radiance.path_noise}
    yield "decode", "decode", 5, partial(measure, scanner, capture, **noise)
    yield from files(work, cell, layout, light, renderer)


def files(work: Path, cell: Any, layout: Any, light: Any, renderer: Any) -> Iterator[Job]:
    from graycast.cell import simulate
    from graycast.dataset.check.checking import validate
    from graycast.dataset.write.store import open_store

    # `make_scene` makes the manifests, which must fit the dataset, from existing layout and light.
    simulation: Any = simulate
    simulation.drop = lambda *_, **__: layout
    own = {name: getattr(renderer, name) for name in ("name", "device", "versions")}
    again = SimpleNamespace(render=lambda *_, **__: light, denoiser=None, **own)
    make = partial(simulation.make_scene, cell, seed=0, renderer=again)
    samples, numbers = [make(number).sample for number in range(SCENES)], count()
    config = cell.config.model_dump(mode="json", exclude={"scenes", "seed"})
    # Both commits use the same depth step, because a finer step makes larger files.
    shared: Any = {"parts": cell.scene.parts, "rig": cell.scene.rig, "depth_scale_mm": 0.05}
    with open_store(Path(mkdtemp(dir=work)) / "dataset", config=config, seed=0, **shared) as store:
        # `write` takes one sample in commits before 114e8a0, and several samples since.
        several = "samples" in inspect.signature(store.write).parameters

        def write() -> None:
            sample = samples[number := next(numbers)]
            store.write(number, [sample] if several else sample)

        yield "write", "write", SCENES, write
        while len(store.finished()) < SCENES:
            write()
        store.finish(range(SCENES))
        if problems := validate(store.out):  # A check that fails might be faster.
            raise ValueError(f"the dataset has problems: {problems[0]}")
        yield "validate", f"validate, {SCENES} scenes", 3, partial(validate, store.out)


def cell_of(settings: dict[str, object]) -> Any:
    """Return a cell of metal brackets in a wooden box as in the paper, with changed settings."""
    from graycast.cell.config import Config
    from graycast.cell.resolve import resolve_cell

    words = {"parts": [{"builtin": BRACKET}], "count": PARTS} | settings
    return resolve_cell(Config.model_validate(words), Path())


def stored_layout(work: Path, scene: Any) -> Any:
    """Return one layout for both trees, whose drops may differ: the first call stores it."""
    import numpy as np

    from graycast.world.drop import DropLimits, drop
    from graycast.world.scene import Layout

    file = work / "poses.npy"
    if not file.exists():
        np.save(file, drop(scene, (PARTS,), seed=0, limits=DropLimits()).T_world_part)
    return Layout(T_world_part=np.load(file), part_index=np.zeros(PARTS, dtype=np.int64))


GROUPS: dict[Group, tuple[str, ...]] = {
    imports: ("import",),
    hulls: ("hulls",),
    drops: ("drop",),
    images: ("render", "sensor", "picture", "decode", "write", "validate"),
}
STAGES = [stage for stages in GROUPS.values() for stage in stages]


def processor_s() -> float:
    """Return the processor time of this process, all threads, and of its ended child processes."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def run_job(stage: str, row: str, times: int, job: Callable[[], object]) -> None:
    processor, wall = [], []
    try:
        for _ in range(times):
            start = processor_s(), time.perf_counter()
            job()
            processor.append(processor_s() - start[0])
            wall.append(time.perf_counter() - start[1])
    except Exception as error:  # An error of one commit must not end the comparison.
        return complain(stage, row, error)
    say(stage, row, value=median(processor))
    if stage == "render":
        say(stage, f"{row}, wall clock", value=median(wall))


def run_group(group: Group, stages: set[str], number: str, work: str) -> None:
    waiting, warm = stages.intersection(GROUPS[group]), number == "warm"
    try:
        for stage, row, times, job in group(Path(work), 0 if warm else int(number)):
            if stage not in stages and not waiting:
                return
            waiting.discard(stage)
            # The hulls and drop stages need no warm-up: their caches are already filled.
            if stage in stages and not (warm and stage in ("hulls", "drop")):
                run_job(stage, row, 1 if warm else times, job)
    except Exception as error:
        for stage in waiting:
            complain(stage, stage, error)


def complain(stage: str, row: str, error: Exception) -> None:
    first = f"{type(error).__name__}: {error}".splitlines()[0][:120]
    say(stage, row, error=first, missing=getattr(error, "name", None))


def say(stage: str, row: str, **figures: object) -> None:
    print(json.dumps({"stage": stage, "row": row} | figures), flush=True)


if __name__ == "__main__":
    names = set(sys.argv[1].split(","))
    for each in (each for each in GROUPS if names.intersection(GROUPS[each])):
        run_group(each, names, *sys.argv[2:])
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
    say("memory", "peak memory [MB]", value=peak_mb)
