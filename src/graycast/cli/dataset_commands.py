"""Commands for datasets: dataset stats, export, merge, import, rerender, grasps, score-depth."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError
from .arguments import (
    CONTINUE,
    add_command,
    add_device,
    add_division,
    add_group,
    add_option,
    add_out,
    add_shared,
    division_of,
    failed_line,
    file_options,
    print_missing,
    resolve_config,
)
from .bars import open_bars
from .readers import above_zero, export_format, positive

# Heavy modules are imported by the command that needs them, so that --help answers at once.

_FORMATS = ("coco", "yolo", "bop-webdataset", "parquet", "clouds", "ros2bag", "mcap", "rerun",
            "foundationpose")  # fmt: skip
_OPTIONS = (  # Each has the same name in the library.
    "image", "depth", "polygons", "labels", "cloud", "organised", "shard_scenes", "link",
    "pixel_origin", "min_visibility",
)  # fmt: skip
NEW_FOLDER = "The folder to write, which must be new or empty."
MERGE = """\
The cloud is in the world frame. Where views see the same surface they are averaged by their noise;
a point that other views see through is left out. Each point keeps its standard deviation, how many
views measured it, and why the first view has no depth there. A table lists what each view measures
of the parts' surface, what no other view measures, and in which order the views add most."""
GRASPS = """\
Each instance gets grasps for one tool with an analytic score and with the result of the collision
check against the bin and the other parts. Some grasps of each scene are simulated with rigid-body
physics, which tells whether the part is lifted out of the heap. The labels are written to
DATASET/grasps/NAME, and no other file of the dataset changes. If the command is stopped, the same
command continues it. At the end it reports how well the score ranks the grasps that held in the
simulation. It needs pip install 'graycast[pick]'."""


def add_commands(commands) -> None:
    group = add_group(
        commands, "dataset", "Count, convert, import, merge, label and score datasets."
    )
    stats = add_command(
        group, "stats", _stats, "Compute statistics of a dataset from its files.",
        example="out/demo --out out/stats",
    )  # fmt: skip
    _add_dataset(stats)
    add_out(stats, "The folder to write, with stats.json and stats.png.", required=False)
    add_shared(stats, "--workers", default=1)
    card = "Write the dataset's card, which is the file README.md in the folder of the dataset."
    add_option(stats, "--card", None, card)
    add_option(
        stats,
        "--licence",
        str,
        "The licence that the card states, as an SPDX identifier such as CC-BY-4.0. It needs "
        "--card.",
        metavar="SPDX",
    )
    _add_export(group)
    merge = add_command(
        group, "merge", _merge, "Fuse each scene's views into one cloud.",
        example="out/demo --out out/clouds", more=MERGE,
    )  # fmt: skip
    source = "The dataset's folder, or the folder of one of its scenes."
    add_option(merge, "source", Path, source)
    add_out(merge, NEW_FOLDER)
    _add_import(group)
    rerender = add_command(
        group, "rerender", _rerender, "Make a scene of a dataset again, and compare its files.",
        example="out/demo --scene 2", more="It lists the files that differ from the stored ones.",
    )  # fmt: skip
    _add_dataset(rerender)
    add_shared(rerender, "--scene", default=0)
    _add_files(rerender)
    add_device(rerender)
    _add_grasps(group)
    depth = add_command(
        group, "score-depth", _score_depth, "Compare the scanner's depth with perfect depth.",
        example="out/demo --out out/depth",
        more="The result is bias, noise, spikes and holes by angle of incidence.",
    )  # fmt: skip
    _add_dataset(depth)
    add_out(depth, "The folder to write.")


def _add_dataset(parser: argparse.ArgumentParser) -> None:
    add_option(parser, "dataset", Path, "The folder of the dataset.")


def _add_files(parser: argparse.ArgumentParser) -> None:
    add_shared(parser, "--files", default=Path(), usual="the current folder")


def _add_export(group) -> None:
    export = add_command(
        group, "export", _export, "Write a dataset in another format.",
        example="out/demo --format coco --out out/coco",
    )  # fmt: skip
    _add_dataset(export)
    form = "The format to write. The page docs/reference/exports.md describes each format."
    add_option(export, "--format", _FORMATS, form, required=True, type=export_format)
    add_out(export, NEW_FOLDER)
    add_option(
        export,
        "--selection",
        Path,
        "A file that lists the scenes to export. The page of graycast report saves such files.",
        usual="all scenes",
    )
    add_division(export, shares="1", usual="1, so that all scenes are in train")
    add_option(
        export,
        "--picture",
        ("rgb", "gray"),
        "The picture to export: rgb is the colour picture, gray is the scanner's white frame.",
        usual="rgb",
        dest="image",
    )
    depth = "The depth files to write."
    kinds = ("perfect", "scanner", "both", "none")
    add_option(export, "--depth-files", kinds, depth, usual="chosen by the format", dest="depth")
    add_option(
        export,
        "--polygons",
        None,
        "Write masks as polygons instead of run-length encoding. It applies only to the format "
        "coco.",
    )
    add_option(
        export,
        "--labels",
        ("segments", "boxes"),
        "Write each part as its outline (segments) or as its box. It applies only to the format "
        "yolo.",
        usual="segments",
    )
    cloud = "The file format of the point clouds. It applies only to the format clouds."
    add_option(export, "--cloud", ("ply", "pcd"), cloud, usual="ply")
    add_option(
        export,
        "--organised",
        None,
        "Write a point for every pixel, which is NaN where there is no depth. It applies only to "
        "the format clouds.",
    )
    add_option(
        export,
        "--pixel-origin",
        ("centre", "corner"),
        "The point of the top-left pixel that has the coordinates (0, 0). The renderers of "
        "bop_toolkit expect its corner. It applies only to the format bop-webdataset.",
        usual="centre",
    )
    shards = "The largest number of scenes in one file."
    add_option(export, "--shard-scenes", positive, shards, usual="chosen by the format")
    add_option(export, "--link", None, "Make hard links to the dataset's pictures, not copies.")
    add_shared(export, "--min-visibility", usual="0")
    add_shared(export, "--workers", default=1)


def _add_import(group) -> None:
    real = add_command(
        group, "import", _import, "Make a dataset from real pictures and their labels.",
        example="photos --intrinsics K.json --out out/real",
    )  # fmt: skip
    folder = "The folder of the pictures, with one or more of the subfolders rgb, gray and depth."
    add_option(real, "folder", Path, folder)
    add_out(real, NEW_FOLDER)
    add_shared(real, "--intrinsics", "--distortion", "--scale", "--size", "--ray-length")
    add_option(
        real,
        "--max-depth",
        above_zero,
        "The farthest depth in metres that is stored. Pixels beyond it get no depth.",
        usual="the farthest depth of all pictures",
        metavar="METRES",
    )
    labels = "The labels: a COCO file, or a folder of LabelMe files."
    add_option(real, "--annotations", Path, labels, usual="FOLDER/annotations")
    add_option(real, "--unlabelled", None, "Import the pictures without labels.")
    add_option(
        real,
        "--like",
        Path,
        "A dataset whose names and numbers of objects are used. Depth far outside the range of "
        "its scanner is refused.",
        metavar="DATASET",
    )


def _add_grasps(group) -> None:
    grasps = add_command(
        group, "grasps", _grasps, "Label where a gripper can hold the parts of a dataset.",
        example="out/demo --tool configs/cells/ur5e_suction.yaml", more=GRASPS,
        when_stopped=f"the labelled scenes are kept; {CONTINUE}",
    )  # fmt: skip
    _add_dataset(grasps)
    add_option(
        grasps,
        "--tool",
        Path,
        "The configuration of a robot cell, such as configs/cells/ur5e_suction.yaml, or a file "
        "with only its section tool.",
        required=True,
    )
    name = "The name of this set of labels."
    kind = "the kind of the tool, suction or jaws"
    add_option(grasps, "--name", str, name, usual=kind, metavar="NAME")
    most = "The largest number of labels of an instance."
    add_option(grasps, "--per-instance", positive, most, 20)
    add_shared(grasps, "--simulate", default=10)
    places = "The number of candidate grasps on each kind of part."
    add_option(grasps, "--places", positive, places, 400)
    add_shared(grasps, "--seed", default=0)
    _add_files(grasps)
    add_shared(grasps, "--workers", default=1)


def _stats(options: argparse.Namespace) -> int:
    from rich.console import Console

    from ..dataset.stats import dataset_statistics, statistics_table, write_statistics

    if options.licence is not None:
        if not options.card:
            raise GraycastError("--licence applies only with --card: add it, or remove --licence")
        from ..dataset.card import spdx

        spdx(options.licence)  # Check this before reading the dataset.
    with open_bars() as bars:
        statistics = dataset_statistics(options.dataset, workers=options.workers, progress=bars)
    Console(width=None).print(statistics_table(statistics))
    if options.out is not None:
        write_statistics(statistics, options.out)
        options.when_stopped = f"{options.out} is written, the card is not"
        print(options.out)
    if options.card:
        from ..dataset.card import write_card

        print(write_card(options.dataset, statistics, licence=options.licence))
    return 0


def _export(options: argparse.Namespace) -> int:
    from ..dataset.export import Options, export

    settings = {name: getattr(options, name) or None for name in _OPTIONS}
    export_options = Options(format=options.format, split=division_of(options), **settings)
    with open_bars() as bars:
        record = export(
            options.dataset, options.out, export_options, selection=options.selection,
            workers=options.workers, progress=bars,
        )  # fmt: skip
    counts = ", ".join(f"{name} {len(ids)}" for name, ids in record.splits.items())
    print(f"{options.out}: {record.format}, scenes: {counts}")
    return 0


def _merge(options: argparse.Namespace) -> int:
    from ..score.merge import described, merge

    with open_bars() as bars:
        record = merge(options.source, options.out, progress=bars)
    print(f"{options.out}: clouds of {len(record['scenes'])} scene(s)")
    for surface in record["surfaces"]:
        print("\n".join(described(surface)))
    for doubt in record["doubts"]:
        print(f"warning: {doubt}")
    return 0


def _import(options: argparse.Namespace) -> int:
    from ..dataset.read.real import absent
    from ..dataset.read.stored import open_dataset
    from ..real.import_real import import_real

    names = range_m = None
    if options.like is not None:
        like = open_dataset(options.like)
        names = list(like.categories.values())
        if rig := like.claim.get("rig"):  # Datasets of real pictures have no rig.
            range_m = (float(rig["near_m"]), float(rig["far_m"]))
    with open_bars() as bars:
        done = import_real(
            options.folder,
            options.out,
            files=file_options(options),
            annotations=options.annotations,
            labelled=not options.unlabelled,
            names=names,
            range_m=range_m,
            progress=bars,
        )
    objects = ", ".join(f"{i} {name}" for i, name in enumerate(done.categories, start=1))
    instances = f"{done.instances} instances of {objects}" if objects else "no instances"
    print(f"{options.out}: {len(done.stems)} pictures, {instances}")
    notes = [f"not known: {', '.join(absent(options.out))}", *(f"note: {n}" for n in done.notes)]
    print("\n".join(f"  {note}" for note in notes))
    return 0


def _rerender(options: argparse.Namespace) -> int:
    from ..cell.generate import read_origin, rerender

    origin = read_origin(options.dataset)
    claim = options.dataset / "graycast.json"
    try:
        cell = resolve_config(origin.config, claim, options.files)
    except GraycastError as error:
        if not origin.files:
            raise
        raise GraycastError(
            f"{error}; the dataset was made from the files {', '.join(origin.files)}: give the "
            "folder in which their paths begin with --files"
        ) from error
    differing = rerender(
        cell, options.dataset, options.scene, seed=origin.seed, device=options.device
    )
    scene = options.dataset / "train" / f"{options.scene:06d}"
    for name, how in differing.items():
        print(f"{name} {how}")
    print(f"{scene}: {len(differing)} file(s) differ" if differing else f"{scene}: the same")
    return 1 if differing else 0


def _grasps(options: argparse.Namespace) -> int:
    try:
        import coal  # noqa: F401
    except ImportError as error:
        raise GraycastError(
            "the collision check of the tool needs a library that is not installed: run pip "
            "install 'graycast[pick]'"
        ) from error
    from ..robot.grasp_labels import Labelling, describe_ranking, label_dataset, rank, read_tool

    tool = read_tool(options.tool)
    labelling = Labelling(
        tool=tool,
        places=options.places,
        per_instance=options.per_instance,
        simulate=options.simulate,
    )
    name = options.name or tool.kind
    if Path(name).name != name or name.startswith("."):
        raise GraycastError(
            f"--name is {name!r}: it names a folder, so give a name without / that does not begin "
            "with a dot"
        )
    with open_bars() as bars:

        def report(key, outcome) -> None:
            number = {word: int(count) for word, count in outcome.reasons.items()}
            bars.line(
                f"{key}  {outcome.seconds:6.1f} s  {number['grasps']} labels, "
                f"{number['held']} of {number['simulated']} lifted"
            )

        def failed(key, outcome) -> None:
            bars.line(failed_line(key, outcome))

        lost = label_dataset(
            options.dataset,
            labelling,
            name=name,
            seed=options.seed,
            files=options.files,
            workers=options.workers,
            on_result=report,
            on_failed=failed,
            progress=bars,
        )
    print(describe_ranking(rank(options.dataset, name)))
    labels = options.dataset / "grasps" / name
    print(f"{labels}: the labels; docs/reference/formats.md describes them")
    print_missing(lost)
    return 1 if lost else 0


def _score_depth(options: argparse.Namespace) -> int:
    from ..base.folder import refuse_foreign, whole_folder
    from ..camera.decode import REASON_COLOR
    from ..score.evaluate import DEPTH, evaluate_depth, write_depth

    refuse_foreign(options.out, DEPTH)
    with whole_folder(options.out) as folder, open_bars() as bars:
        tables = evaluate_depth(options.dataset, progress=bars)
        write_depth(tables, folder, colors=REASON_COLOR)
    print((options.out / "depth.md").read_text(encoding="utf-8"), end="")
    print(options.out)
    return 0
