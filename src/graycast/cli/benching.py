"""The commands that measure: bench and its kinds."""

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .arguments import (
    add_command,
    add_config,
    add_device,
    add_seed,
    counts,
    positive,
    progress_bar,
    share,
    size,
)

AGREE = """\
Render the same scenes with Mitsuba and Cycles and compare the two. The scenes are brackets of a
Lambertian, a metal and a coated plastic surface in a small wooden box before a PhoXi M. For each
class of surface it prints the ratio of their light pixel by pixel (Cycles over Mitsuba), how the
decoded depth differs in projector columns and in which pixels have one, and whether the ground
truth is the same. A scene takes about 5 minutes on 2 cores; fewer samples are quick, but noisy."""
DENOISE = """\
Measure what denoising every picture of a stack does to the depth that is decoded from it. Cycles
and Mitsuba render 4, 8, 16 ... samples, with each denoiser of this machine and without, and are
compared with their own converged pictures (four times the most samples). The scene is metal
brackets in a wooden box under Gray code and white light; only the tables that say so have sensor
noise. It takes about 40 minutes on 2 cores, a quarter of that up to 64 samples."""
RENDERERS = """\
Measure how long a stack of 24 patterns takes, by Mitsuba in one pass and by Cycles with one and
with three patterns per render, in turn. Then measure how many samples each needs for the same error
of decoded depth (13 patterns on a crop of 172 x 130 pixels). Cycles renders a few patterns, and the
time of the others is calculated, unless --whole is given. It takes about 40 minutes on 2 cores."""

ZOO = """\
Drop parts of each family of the trade (bolts, nuts, tubes, springs, ...) into a bin of 400 x 300 x
150 mm, each number of parts with many seeds, and count how often the parts come to an acceptable
rest, after how many attempts and seconds. Where MuJoCo is installed, each layout is let go in it
for a second and counts as in balance where no point of a part moves by more than 1 mm. All of it
takes hours on one core; --families hex_bolt --seeds 5 takes seconds. Each row is printed when it is
there, and each drop is written into the file of --json at once. When the command has been stopped,
the same command goes on after the last drop of that file."""

POSE = """\
Look for instances of parts in datasets with known poses: by their true masks, by boxes of the right
size, 20 % too large and 20 % too small, in the scanner's depth, and by masks and boxes in perfect
depth. For each it prints the share within 5 degrees and 3 mm modulo the symmetry of the part's
shape, and that of the symmetry which the dataset states (strict), the median errors, and the
median processor seconds for an instance."""


def add_commands(commands) -> None:
    told = "Measure speed and memory on this machine, and hold the renderers against each other."
    group = commands.add_parser("bench", help=told, description=told)
    kinds = group.add_subparsers(required=True, metavar="WHAT")
    render = _add_kind(
        kinds,
        "render",
        _render,
        "Measure how long a whole stack takes to render, against one white frame.",
    )
    _add_count(render)
    add_device(render)
    _add_kind(
        kinds,
        "decode",
        _decode,
        "Measure how long decoding takes, OpenCV's too where it is installed.",
    )
    _add_count(
        _add_kind(kinds, "drop", _drop, "Measure how long the parts' fall into the bin takes.")
    )
    scene = _add_kind(
        kinds, "scene", _scene, "Measure the time and memory of whole scenes, stage by stage."
    )
    scene.add_argument(
        "--scenes", type=positive, default=3, help="How many scenes are made (default: 3)."
    )
    _add_count(scene)
    add_device(scene)
    engine = _add_kind(
        kinds, "engine", _engine, "Measure what more workers cost and bring, those of Ray too."
    )
    engine.add_argument(
        "--scenes",
        type=positive,
        default=6,
        help="How many scenes each of the three rounds makes (default: 6).",
    )
    _add_count(engine)
    _add_zoo(kinds)
    _add_kind(
        kinds,
        "hulls",
        _hulls,
        "Measure how near the collision hulls of a zoo of parts are to the parts' surfaces.",
    )
    live = _add_kind(
        kinds, "live", _alive, "Measure how long one waits for what graycast live shows."
    )
    add_config(live)
    live.add_argument(
        "--rounds",
        type=positive,
        default=20,
        help="How often each kind of change is made (default: 20).",
    )
    add_device(live)
    detectors = _add_kind(
        kinds,
        "detectors",
        _detectors,
        "Measure what reading costs a training, and how long detectors take for a picture.",
    )
    detectors.add_argument(
        "detectors", type=Path, nargs="+", help="The folders of trainings, or their detector.pt."
    )
    detectors.add_argument(
        "--on",
        type=Path,
        required=True,
        metavar="DATASET",
        help="The dataset whose pictures are taken; it has 28 scenes or more.",
    )
    _add_pose(kinds)
    _add_studies(kinds)


def _add_pose(kinds) -> None:
    pose = _add_kind(kinds, "pose", _pose, "Measure how often and how fast poses are found.")
    pose.description = POSE
    pose.add_argument(
        "datasets", type=Path, nargs="+", help="Datasets that graycast generate has made."
    )
    pose.add_argument(
        "--instances",
        type=positive,
        default=100,
        metavar="N",
        help="How many instances of each dataset are looked for (default: 100).",
    )
    pose.add_argument(
        "--min-visibility",
        type=share,
        default=0.7,
        metavar="SHARE",
        help="Take instances of which at least this share is visible (default: 0.7).",
    )
    pose.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="Also write the poses as BOP results and sheets of pictures into this new folder.",
    )
    add_seed(pose, default=0)


def _add_zoo(kinds) -> None:
    zoo = _add_kind(
        kinds, "zoo", _zoo, "Check whether every family of parts comes to rest and is in balance."
    )
    zoo.description = ZOO
    zoo.set_defaults(when_stopped="drops in the file of --json are kept; the same command goes on")
    zoo.add_argument(
        "--families",
        metavar="A,B,...",
        help="The families that are dropped (default: all of them).",
    )
    zoo.add_argument(
        "--counts",
        type=counts,
        default=(1, 10, 60),
        metavar="N,N,...",
        help="How many parts a drop has; a family of large parts is dropped in smaller numbers "
        "(default: 1,10,60).",
    )
    zoo.add_argument(
        "--seeds", type=positive, default=20, help="The number of drops of each kind (default: 20)."
    )


def _add_studies(kinds) -> None:
    agree = _add_study(kinds, "agree", _agree, "Measure how well Cycles and Mitsuba agree.", AGREE)
    agree.add_argument(
        "--scenes", type=positive, default=5, help="How many scenes are rendered (default: 5)."
    )
    _add_samples(
        agree, 128, "How many samples a pixel Cycles takes; Mitsuba takes eight times as many"
    )
    _add_size(agree, (258, 194))

    denoise = _add_study(kinds, "denoise", _denoise, "Measure what denoisers do to depth.", DENOISE)
    _add_samples(denoise, 256, "The largest number of samples for a pixel in the series")
    _add_size(denoise, (206, 154))
    _add_count(denoise)

    told = "Measure how much faster one pass of Mitsuba is than Cycles."
    renderers = _add_study(kinds, "renderers", _renderers, told, RENDERERS)
    _add_samples(renderers, 16, "How many samples a pixel takes while time is measured")
    _add_size(renderers, (1032, 772))
    _add_count(renderers)
    renderers.add_argument(
        "--whole", action="store_true", help="Let Cycles render all patterns once instead of a few."
    )


def _add_kind(kinds, name: str, run, told: str) -> argparse.ArgumentParser:
    made = add_command(kinds, name, run, told)
    made.add_argument(
        "--json", type=Path, metavar="FILE", help="Also write the figures into this JSON file."
    )
    return made


def _add_study(kinds, name: str, run, told: str, description: str) -> argparse.ArgumentParser:
    made = _add_kind(kinds, name, run, told)
    made.description = description
    made.add_argument(
        "--plot", type=Path, metavar="FILE", help="Also draw the figures into this PNG."
    )
    add_device(made)
    return made


def _add_count(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--count", type=positive, default=30, help="How many parts a scene has (default: 30)."
    )


def _add_samples(parser: argparse.ArgumentParser, default: int, told: str) -> None:
    parser.add_argument(
        "--samples", type=positive, default=default, help=f"{told} (default: {default})."
    )


def _add_size(parser: argparse.ArgumentParser, default: tuple[int, int]) -> None:
    words = f"{default[0]}x{default[1]}"
    told = (
        f"The size of the crop from the middle of the camera's 1032x772 pixels (default: {words})."
    )
    parser.add_argument("--size", type=size, default=default, metavar="WxH", help=told)


def _render(options: argparse.Namespace) -> int:
    from .. import bench

    return _report(options, "render", bench.measure_render(options.device, options.count))


def _decode(options: argparse.Namespace) -> int:
    from .. import bench

    return _report(options, "decode", bench.measure_decode())


def _drop(options: argparse.Namespace) -> int:
    from .. import bench

    return _report(options, "drop", bench.measure_drop(options.count))


def _alive(options: argparse.Namespace) -> int:
    from .. import bench

    with progress_bar() as bar:
        task = bar.add_task("rounds", total=options.rounds)
        figures = bench.measure_live(
            options.config,
            rounds=options.rounds,
            device=options.device,
            on_round=lambda done: bar.update(task, completed=done),
        )
    return _report(options, "live", figures)


def _hulls(options: argparse.Namespace) -> int:
    from .. import bench

    with _following() as on_work:
        figures = bench.measure_hulls(on_work)
    return _report(options, "hulls", figures)


def _scene(options: argparse.Namespace) -> int:
    from .. import bench

    figures = bench.measure_scene(options.device, options.count, options.scenes)
    return _report(options, "scene", figures)


def _engine(options: argparse.Namespace) -> int:
    from .. import bench

    with _following() as on_work:
        figures = bench.measure_engines(options.count, options.scenes, on_work=on_work)
    return _report(options, "engine", figures)


def _agree(options: argparse.Namespace) -> int:
    from .. import bench

    with bench.opened(options.device, 1) as renderers, _following() as on_work:
        figures = bench.study_agreement(
            *renderers,
            scenes=options.scenes,
            samples=options.samples,
            size_px=options.size,
            on_work=on_work,
        )
    return _report(options, "agree", figures)


def _denoise(options: argparse.Namespace) -> int:
    from .. import bench

    with bench.opened(options.device, 1, 3) as renderers, _following() as on_work:
        figures = bench.study_denoisers(
            *renderers,
            count=options.count,
            most=options.samples,
            size_px=options.size,
            on_work=on_work,
        )
    return _report(options, "denoise", figures)


def _renderers(options: argparse.Namespace) -> int:
    from .. import bench

    with bench.opened(options.device, 1, 3) as renderers, _following() as on_work:
        figures = bench.study_renderers(
            *renderers,
            count=options.count,
            samples=options.samples,
            size_px=options.size,
            whole=options.whole,
            on_work=on_work,
        )
    return _report(options, "renderers", figures)


def _detectors(options: argparse.Namespace) -> int:
    from ..bench.detectors import measure_detectors

    runs = options.detectors
    with _following() as on_work:
        figures = measure_detectors(
            runs, options.on, on_run=lambda done, what: on_work(done / len(runs), what)
        )
    return _report(options, "detectors", figures)


def _pose(options: argparse.Namespace) -> int:
    from .. import bench

    with _following() as on_work:
        figures = bench.measure_poses(
            options.datasets,
            instances=options.instances,
            min_visibility=options.min_visibility,
            seed=options.seed,
            out=options.out,
            on_work=on_work,
        )
    return _report(options, "pose", figures)


def _zoo(options: argparse.Namespace) -> int:
    from .. import bench

    families = {"families": options.families.split(",")} if options.families else {}
    with _following() as on_work:
        figures = bench.study_zoo(
            **families,
            counts=options.counts,
            seeds=options.seeds,
            file=options.json,
            on_work=on_work,
            on_row=lambda row: print(bench.describe_row(row), flush=True),
        )
    return _report(options, "zoo", figures)


@contextmanager
def _following() -> Iterator[Callable[[float, str], None]]:
    """A bar from 0 to 100 for a study's work."""
    with progress_bar() as bar:
        task = bar.add_task("", total=100)
        yield lambda share, what: bar.update(task, completed=round(100 * share), description=what)


def _report(options: argparse.Namespace, what: str, figures: dict[str, Any]) -> int:
    """Print the figures, and write what was asked for."""
    from .. import bench

    figures = bench.stamped(what, figures)
    print(bench.describe(figures))
    if options.json is not None:
        bench.write_figures(options.json, figures)
        print(options.json)
    if getattr(options, "plot", None) is not None:
        bench.draw(figures, options.plot)
        print(options.plot)
    return 0
