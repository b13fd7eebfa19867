"""The command rescan, which adds scanner depth to a dataset that others made."""

import argparse
from datetime import timedelta
from pathlib import Path

from .arguments import (
    CONTINUE,
    add_command,
    add_device,
    add_option,
    add_out,
    add_rig,
    add_shared,
    add_workers,
    failed_line,
    print_shares,
    resolve_rig_option,
    workers_of,
)
from .bars import open_bars
from .readers import above_zero, positive

# Heavy modules are imported by the command, so that --help answers at once.

RESCAN = """\
It reads a split in BOP's format (also those of BlenderProc, XYZ-IBD, IPD, ITODD and T-LESS), a
dataset in the layout of Sileane or of Fraunhofer IPA, or depth maps alone. It stages each image:
the objects from their models and poses, and what is behind and beside them from the perfect depth.
Then it shows the patterns of the rig, takes the pictures and decodes them. The result has the
layout of the original, with links to its files, and beside them depth_sl, gray_sl, reason_sl,
masks and JSON files of the scanner. The original is not changed. If an image cannot be scanned, it
is set aside, set_aside.json states the reason, and the exit code is 1."""


def add_rescan(commands) -> None:
    rescan = add_command(
        commands, "rescan", _rescan, "Add scanner depth to a dataset that others made.",
        example="lm/train_pbr --rig like-phoxi-m --out out/lm_sl", more=RESCAN,
        when_stopped=f"the finished images are kept; {CONTINUE}",
    )  # fmt: skip
    add_option(
        rescan, "source", Path,
        "The split, such as lm/train_pbr, a folder in another layout, or a folder of depth maps.",
    )  # fmt: skip
    add_rig(rescan, flag=True)
    add_out(rescan, "The folder to write.")
    add_option(
        rescan, "--camera", ("image", "rig"),
        "Whose camera looks at the scenes from where the image's camera stood: image has the "
        "intrinsics and the size of the images, so that every pixel shows what it showed; rig is "
        "the rig's own camera.",
        "image",
    )  # fmt: skip
    add_option(
        rescan, "--models", Path,
        "The folder of the models, or the mesh of the only object.",
        usual="models beside the split",
    )  # fmt: skip
    add_option(
        rescan, "--materials", Path,
        "A YAML file with the material of each object, by its id or name, and of all that is no "
        "object under background. Without one, an object looks as its mesh says, or has the mean "
        "colour of the pictures, and all else looks as the pictures do.",
    )  # fmt: skip
    add_option(rescan, "--sensor", str, "The camera, where a dataset has several.", metavar="NAME")
    add_option(
        rescan, "--depth-scale", above_zero,
        "The millimetres of one step of depth, in place of what the dataset states.",
    )  # fmt: skip
    add_shared(rescan, "--intrinsics", "--ray-length")
    add_shared(rescan, "--unit", usual="the unit of the layout")
    add_option(
        rescan, "--depth-only", None,
        "Stage the depth alone, without models and poses. This is coarser: nothing is behind what "
        "the camera sees, and everything is matt.",
    )  # fmt: skip
    add_option(
        rescan, "--images", positive, "The number of images to scan, from the first one on.",
        usual="all",
    )  # fmt: skip
    add_option(rescan, "--copy", None, "Copy the original files instead of linking to them.")
    add_shared(rescan, "--seed", default=0)
    add_shared(rescan, "--backend", default="mitsuba")
    add_device(rescan)
    add_workers(rescan)


def _rescan(options: argparse.Namespace) -> int:
    from ..cell.config import RenderSection
    from ..real.rescan.open_source import open_source
    from ..real.rescan.rescanning import RescanSpec, rescan
    from ..real.rescan.source import SourceOptions

    workers, scanner = workers_of(options), resolve_rig_option(options)
    source = open_source(
        options.source,
        SourceOptions(
            sensor=options.sensor or "",
            models=options.models,
            materials=options.materials,
            depth_scale_mm=options.depth_scale,
            intrinsics=options.intrinsics,
            depth_only=options.depth_only,
            unit=options.unit,
            ray_length=options.ray_length,
        ),
    )
    spec = RescanSpec(
        camera=options.camera,
        seed=options.seed,
        render=RenderSection(backend=options.backend),
        images=options.images,
        copies=options.copy,
        device=options.device,
    )
    count = min(len(source.images), options.images or len(source.images))
    objects = f"{len(source.parts)} objects" if source.parts else "depth alone"
    print(f"{count} images of {source.folder} with {objects}, rig {scanner.rig.name}")
    if source.plain:
        ids = ", ".join(map(str, sorted(source.plain)))
        print(
            f"note: objects {ids} have the mean colour of the pictures and are matt plastic: give "
            "--materials with what they are made of"
        )
    for note in source.notes:
        print(f"note: {note}")
    with open_bars() as bars:

        def name_of(number: int) -> str:
            scene_id, image_id = source.images[number]
            return f"image {scene_id:06d}/{image_id:06d}"

        def report(result) -> None:
            decoded = f"{result.reasons['decoded']:.1%} of all pixels decoded"
            if result.part_reasons:
                decoded = f"{result.part_reasons['decoded']:.1%} of the objects' pixels, {decoded}"
            bars.line(f"{name_of(result.scene_id)}  {result.seconds:6.1f} s  {decoded}")

        def failed(one) -> None:
            bars.line(failed_line(name_of(one.scene_id), one, if_final="set aside"))

        summary = rescan(
            source,
            scanner,
            options.out,
            spec,
            workers=workers,
            on_result=report,
            on_failed=failed,
            progress=bars,
        )
    took = timedelta(seconds=round(summary.seconds))
    print(f"{options.out}: {summary.written} images made, {summary.there} were there, {took}")
    if summary.reasons:
        print_shares(summary.part_reasons, summary.reasons)
    for (scene_id, image_id), why in summary.set_aside.items():
        print(f"  image {scene_id:06d}/{image_id:06d} is set aside: {why}")
    return 1 if summary.set_aside else 0
