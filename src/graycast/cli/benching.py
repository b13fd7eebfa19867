"""The command bench with its subcommands."""

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
from .detecting import need_torch

AGREE = """\
Render the same scenes with Mitsuba and Cycles and compare the two. The scenes are brackets of a
Lambertian, a metal and a coated plastic surface in a small wooden box before a PhoXi M. For
each class of surface the command prints the ratio of the radiance pixel by pixel (Cycles
divided by Mitsuba), the difference of the decoded projector columns, the difference in which
pixels are decoded, and whether the ground truth is the same. A scene takes about 5 minutes on 2
cores; fewer samples are faster but noisier."""
DENOISE = """\
Measure how denoising every picture of a stack changes the depth that is decoded from it. Cycles
and Mitsuba render with 4, 8, 16 and more samples per pixel, without a denoiser and with each
denoiser of this machine. Each result is compared with the converged pictures of the same
renderer, which have four times the largest number of samples. The scene shows metal brackets in
a wooden box under Gray code and white light. Sensor noise is present only in the tables whose
title says so. The command takes about 40 minutes on 2 cores, and about 10 minutes with
--samples 64."""
RENDERERS = """\
Measure the time that a stack of 24 patterns takes in Mitsuba (one pass) and in Cycles (with one
and with three patterns per render), in alternation. Then measure how many samples each renderer
needs for the same error of the decoded depth, with 13 patterns on a crop of 172 x 130 pixels.
Cycles renders only a few patterns, and the time of the others is extrapolated, unless --whole
is given. The command takes about 40 minutes on 2 cores."""

ZOO = """\
Drop parts of each family of industrial parts (bolts, nuts, tubes, springs and others) into a
bin of 400 x 300 x 150 mm. Each number of parts is dropped with many seeds. The command counts
how often the parts come to an acceptable rest, and how many attempts and seconds this takes. If
MuJoCo is installed, it simulates each layout for one second; the layout is in balance if no
point of a part moves by more than 1 mm. The whole benchmark takes hours on one core; --families
hex_bolt --seeds 5 takes seconds. Each row is printed as soon as it is complete, and each drop
is written to the file of --json at once. If the command is stopped, the same command continues
after the last drop in that file."""

POSE = """\
Estimate the poses of parts in datasets whose true poses are known. In the scanner's depth, the
parts are given by their true masks, by boxes of the right size, and by boxes that are 20 % too
large or too small; in perfect depth, they are given by masks and boxes. With --detector they are
also given by the masks and boxes that it finds in the scenes of its test set. For each case the
command prints the share of poses within 5 degrees and 3 mm modulo the symmetry of the part's
shape, the share of instances that were detected, the first share modulo only the symmetry that
the dataset states (strict), the median errors, and the median processor time per instance in
seconds."""


def add_commands(commands) -> None:
    told = "Measure speed and memory on this machine, and compare the renderers with each other."
    group = commands.add_parser("bench", help=told, description=told)
    kinds = group.add_subparsers(required=True, metavar="WHAT")
    render = _add_kind(
        kinds,
        "render",
        _render,
        "Measure the time to render a whole stack of patterns, compared with one white frame.",
    )
    _add_count(render)
    add_device(render)
    _add_kind(
        kinds,
        "decode",
        _decode,
        "Measure the time to decode a stack, and the time of OpenCV's decoder if it is installed.",
    )
    _add_count(
        _add_kind(
            kinds, "drop", _drop, "Measure the time to simulate the fall of the parts into the bin."
        )
    )
    scene = _add_kind(
        kinds, "scene", _scene, "Measure the time and the memory of each stage of making a scene."
    )
    scene.add_argument(
        "--scenes", type=positive, default=3, help="The number of scenes to make (default: 3)."
    )
    _add_count(scene)
    add_device(scene)
    engine = _add_kind(
        kinds,
        "engine",
        _engine,
        "Measure the speed and the memory of several workers, including workers of Ray.",
    )
    engine.add_argument(
        "--scenes",
        type=positive,
        default=6,
        help="The number of scenes in each of the three rounds (default: 6).",
    )
    _add_count(engine)
    _add_zoo(kinds)
    _add_kind(
        kinds,
        "hulls",
        _hulls,
        "Measure the distance between the collision hulls and the surfaces of many kinds of parts.",
    )
    live = _add_kind(kinds, "live", _alive, "Measure the response times of graycast live.")
    add_config(live)
    live.add_argument(
        "--rounds",
        type=positive,
        default=20,
        help="The number of times that each kind of change is made (default: 20).",
    )
    add_device(live)
    detectors = _add_kind(
        kinds,
        "detectors",
        _detectors,
        "Measure the time that a training spends on reading, and the time of detectors per "
        "picture.",
    )
    detectors.add_argument(
        "detectors",
        type=Path,
        nargs="+",
        help="Folders that graycast train wrote, or their files detector.pt.",
    )
    detectors.add_argument(
        "--on",
        type=Path,
        required=True,
        metavar="DATASET",
        help="The dataset whose pictures are used. It must have at least 28 scenes.",
    )
    _add_pose(kinds)
    _add_studies(kinds)


def _add_pose(kinds) -> None:
    pose = _add_kind(
        kinds, "pose", _pose, "Measure how often and how fast the poses of parts are found."
    )
    pose.description = POSE
    pose.add_argument(
        "datasets", type=Path, nargs="+", help="Folders of datasets that graycast generate made."
    )
    pose.add_argument(
        "--instances",
        type=positive,
        default=100,
        metavar="N",
        help="The number of instances of each dataset whose poses are estimated (default: 100).",
    )
    pose.add_argument(
        "--min-visibility",
        type=share,
        default=0.7,
        metavar="SHARE",
        help="The smallest visible share of an instance, from 0 to 1; instances below it are "
        "skipped (default: 0.7).",
    )
    pose.add_argument(
        "--detector",
        type=Path,
        metavar="RUN",
        help="The folder that graycast train wrote. The instances are then of the scenes that its "
        "training kept for tests, and its masks and its boxes are two more cases.",
    )
    pose.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="A new folder; the poses as BOP results and sheets of pictures are written to it.",
    )
    add_seed(pose, default=0)


def _add_zoo(kinds) -> None:
    zoo = _add_kind(
        kinds,
        "zoo",
        _zoo,
        "Measure how often parts of each family come to rest, and whether they are in balance.",
    )
    zoo.description = ZOO
    zoo.set_defaults(
        when_stopped="the drops in the file of --json are kept; run the same "
        "command again to continue"
    )
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
        help="The numbers of parts in a drop, separated by commas. Families of large parts "
        "use smaller numbers (default: 1,10,60).",
    )
    zoo.add_argument(
        "--seeds", type=positive, default=20, help="The number of drops of each kind (default: 20)."
    )


def _add_studies(kinds) -> None:
    agree = _add_study(
        kinds,
        "agree",
        _agree,
        "Measure the differences between pictures of Cycles and of Mitsuba.",
        AGREE,
    )
    agree.add_argument(
        "--scenes", type=positive, default=5, help="The number of scenes to render (default: 5)."
    )
    _add_samples(
        agree, 128, "The number of samples per pixel of Cycles. Mitsuba uses eight times as many"
    )
    _add_size(agree, (258, 194))

    denoise = _add_study(
        kinds,
        "denoise",
        _denoise,
        "Measure how denoised pictures change the decoded depth.",
        DENOISE,
    )
    _add_samples(denoise, 256, "The largest number of samples per pixel in the series")
    _add_size(denoise, (206, 154))
    _add_count(denoise)

    told = "Measure how much faster one pass of Mitsuba is than the renders of Cycles."
    renderers = _add_study(kinds, "renderers", _renderers, told, RENDERERS)
    _add_samples(renderers, 16, "The number of samples per pixel while time is measured")
    _add_size(renderers, (1032, 772))
    _add_count(renderers)
    renderers.add_argument(
        "--whole",
        action="store_true",
        help="Let Cycles render all patterns instead of extrapolating from a few.",
    )


def _add_kind(kinds, name: str, run, told: str) -> argparse.ArgumentParser:
    made = add_command(kinds, name, run, told)
    made.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="A JSON file to which the figures are also written.",
    )
    return made


def _add_study(kinds, name: str, run, told: str, description: str) -> argparse.ArgumentParser:
    made = _add_kind(kinds, name, run, told)
    made.description = description
    made.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="A PNG file in which the figures are also plotted.",
    )
    add_device(made)
    return made


def _add_count(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--count", type=positive, default=30, help="The number of parts in a scene (default: 30)."
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
    need_torch()
    from ..bench.detectors import measure_detectors

    runs = options.detectors
    with _following() as on_work:
        figures = measure_detectors(
            runs, options.on, on_run=lambda done, what: on_work(done / len(runs), what)
        )
    return _report(options, "detectors", figures)


def _pose(options: argparse.Namespace) -> int:
    from .. import bench

    detector = None
    if options.detector is not None:
        need_torch()
        from ..detect import load_detector

        detector = load_detector(options.detector)
    with _following() as on_work:
        figures = bench.measure_poses(
            options.datasets,
            instances=options.instances,
            min_visibility=options.min_visibility,
            seed=options.seed,
            detector=detector,
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
    """Show a progress bar from 0 to 100."""
    with progress_bar() as bar:
        task = bar.add_task("", total=100)
        yield lambda share, what: bar.update(task, completed=round(100 * share), description=what)


def _report(options: argparse.Namespace, what: str, figures: dict[str, Any]) -> int:
    """Print the figures, and write the files that the options ask for."""
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
