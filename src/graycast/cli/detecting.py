"""Commands about detectors: train, detect."""

import argparse
from pathlib import Path

from ..errors import GraycastError
from .arguments import above_zero, add_command, positive, progress_bar, seed, share

# torch takes seconds to import and may be missing, so names are repeated here; a test compares.
MODELS = ("mask-rcnn", "yolov3", "solov2", "yolov7", "rf-detr")
INPUTS = ("rgb", "depth", "depth_sl", "depth_noisy", "rgbd")
HOLES = ("channel", "zero", "far")

TRAIN = """\
Train a detector on datasets of Graycast, on exports of them, or on datasets of real pictures. It
learns from the scenes of train and keeps the weights that are best on those of val. The folder of
the training gets detector.pt (the weights, and how pictures are encoded), history.csv, curves.png
and files for TensorBoard. A training that was stopped or killed goes on with the same command."""


def add_commands(commands) -> None:
    train = add_command(commands, "train", _train, "Train a detector on datasets.")
    train.description = TRAIN
    train.set_defaults(when_stopped="the same command goes on from here")
    train.add_argument(
        "datasets",
        type=Path,
        nargs="+",
        help="Folders of datasets or exports; of others' datasets a file of COCO annotations, or "
        "the folder of one of BOP's splits.",
    )
    train.add_argument("--out", type=Path, required=True, help="The folder of this training.")
    train.add_argument(
        "--model", choices=MODELS, default="mask-rcnn", help="The network (default: mask-rcnn)."
    )
    train.add_argument(
        "--input",
        choices=INPUTS,
        default="depth_sl",
        help="What the network sees: colour, perfect depth, the scanner's depth, perfect "
        "depth with Gaussian noise and random holes, or colour with the scanner's "
        "depth (default: depth_sl).",
    )
    train.add_argument(
        "--one-class",
        action="store_true",
        help="Treat all parts as one class: the detector learns where a part is, not "
        "which part it is.",
    )
    train.add_argument(
        "--backbone",
        help="The backbone: the part of the network that turns pictures into features "
        "(default: the model's own).",
    )
    train.add_argument(
        "--weights",
        type=Path,
        metavar="FILE",
        help="Start from these weights, another run's or published ones, not from random numbers.",
    )
    train.add_argument(
        "--size",
        type=positive,
        default=384,
        metavar="PX",
        help="The longer side of the picture that the network sees (default: 384).",
    )
    train.add_argument(
        "--epochs",
        type=positive,
        default=40,
        help="How often the training goes through all pictures (default: 40).",
    )
    train.add_argument(
        "--patience",
        type=positive,
        default=10,
        help="How many validations without a better score end the training (default: 10).",
    )
    train.add_argument(
        "--batch",
        type=positive,
        help="How many pictures one step of the training takes (default: the model's own).",
    )
    train.add_argument(
        "--learning-rate",
        type=above_zero,
        help="The highest learning rate of the training (default: the model's own).",
    )
    train.add_argument(
        "--split",
        default="0.8,0.1,0.1",
        metavar="SHARES",
        help="The shares of scenes that go to train, val and test; an export has its own "
        "(default: 0.8,0.1,0.1).",
    )
    train.add_argument(
        "--split-seed", type=seed, default=0, help="Another seed puts other scenes into each set."
    )
    train.add_argument(
        "--min-visibility",
        type=share,
        default=0.1,
        metavar="SHARE",
        help="Parts of which a smaller share is visible are ignored: finding one is neither right "
        "nor wrong (default: 0.1).",
    )
    train.add_argument(
        "--holes",
        choices=HOLES,
        default="channel",
        help="What missing depth is to the network: a channel of its own, zero, or far away "
        "(default: channel).",
    )
    train.add_argument(
        "--no-relief",
        action="store_true",
        help="Leave the channel out that holds the height over the neighbourhood.",
    )
    train.add_argument(
        "--range",
        type=_range,
        metavar="NEAR,FAR",
        help="The working volume in metres from the camera (default: what the datasets span).",
    )
    train.add_argument(
        "--no-flips", action="store_true", help="Do not mirror pictures while training."
    )
    train.add_argument(
        "--seed",
        type=seed,
        default=0,
        help="Another seed draws weights, order and augmentation anew (default: 0).",
    )
    _add_device(train)
    train.add_argument(
        "--workers",
        type=seed,
        default=0,
        help="How many processes read pictures beside the training (default: 0).",
    )

    detect = add_command(commands, "detect", _detect, "Find parts in a dataset or in pictures.")
    detect.add_argument("detector", type=Path, help="The folder of a training, or its detector.pt.")
    detect.add_argument(
        "pictures",
        type=Path,
        nargs="?",
        help="A dataset, an export, or a folder with pictures in rgb, gray and depth.",
    )
    detect.add_argument(
        "--out",
        type=Path,
        required=True,
        help="The folder to write, which is new or an earlier one; with --export the file.",
    )
    detect.add_argument(
        "--export",
        choices=("onnx",),
        help="Look at no pictures: write the detector as an ONNX file, checked against torch.",
    )
    detect.add_argument(
        "--split",
        choices=("train", "val", "test", "all"),
        default="all",
        help="The set of scenes to look at, such as test, which the training did not see "
        "(default: all).",
    )
    detect.add_argument(
        "--as-real",
        action="store_true",
        help="Treat the dataset as a real one: hide its perfect depth, and show the "
        "scanner's depth to a detector that was trained on perfect depth.",
    )
    detect.add_argument(
        "--scale",
        type=above_zero,
        metavar="METRES",
        help="How many metres one unit of depth is in files that belong to no dataset: "
        "0.001 for millimetres. Floats are metres without it.",
    )
    detect.add_argument(
        "--most",
        type=positive,
        default=300,
        help="How many detections a picture has at most (default: 300).",
    )
    detect.add_argument(
        "--least-score",
        type=share,
        default=0.05,
        help="The least score of a detection (default: 0.05).",
    )
    detect.add_argument(
        "--drawings", type=seed, default=12, help="How many pictures to draw (default: 12)."
    )
    _add_device(detect)

    study = add_command(
        commands,
        "study",
        _study,
        "Train and score every combination of a study, and write one table.",
    )
    study.set_defaults(when_stopped="the same command goes on from here")
    study.add_argument(
        "study", type=Path, help="The study, a YAML file; configs/paper/study.yaml is one."
    )
    study.add_argument("--out", type=Path, required=True, help="The folder of the study.")
    study.add_argument(
        "--list", action="store_true", help="Only list the combinations; train nothing."
    )
    _add_device(study)


def _add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda"),
        default="auto",
        help="Where the network runs; auto takes the GPU where there is one (default: auto).",
    )
    parser.add_argument(
        "--threads",
        type=positive,
        help="How many processor threads the network uses (default: torch's own choice).",
    )


def _range(text: str) -> tuple[float, float]:
    try:
        near_m, far_m = (float(word) for word in text.split(","))
    except ValueError:
        near_m, far_m = 0.0, 0.0
    if not 0 < near_m < far_m:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no range: give two distances in metres such as 0.6,1.2"
        )
    return near_m, far_m


def _torch(options: argparse.Namespace) -> None:
    """See that torch is there, and how many threads it takes."""
    try:
        import torch
    except ImportError as error:
        raise GraycastError(
            "detectors need PyTorch, which is not installed: pip install 'graycast[detect]'"
        ) from error
    if options.threads is not None:
        torch.set_num_threads(options.threads)


def _train(options: argparse.Namespace) -> None:
    _torch(options)
    from ..detect import Augmentation, TrainSpec, train
    from ..export.split import Split, parse_shares

    spec = TrainSpec(
        model=options.model,
        input=options.input,
        backbone=options.backbone,
        longest_px=options.size,
        holes=options.holes,
        relief=not options.no_relief,
        range_m=options.range,
        epochs=options.epochs,
        batch=options.batch,
        learning_rate=options.learning_rate,
        seed=options.seed,
        one_class=options.one_class,
        min_visibility=options.min_visibility,
        patience=options.patience,
        split=Split(shares=parse_shares(options.split), seed=options.split_seed),
        augmentation=Augmentation(flip=not options.no_flips),
        weights=options.weights,
        device=options.device,
        workers=options.workers,
    )
    with progress_bar() as bar:
        tasks = {}

        def on_told(told) -> None:
            if told.row is not None:
                bar.console.print(_line(told.row))
                return
            if told.stage not in tasks:
                tasks[told.stage] = bar.add_task(told.stage, total=told.total)
            bar.update(tasks[told.stage], completed=told.done, total=told.total)

        train(options.datasets, options.out, spec, on_told=on_told)
    print(f"{options.out}: trained; detector.pt has the weights of the best validation")


def _line(row: dict[str, float]) -> str:
    text = f"epoch {row['epoch']:.0f}: loss {row['loss']:.3f}"
    for name in ("box_ap50", "mask_ap50", "box_ap", "mask_ap"):
        if name in row:
            text += f", {name.replace('_', ' ').replace('ap', 'AP')} {row[name]:.3f}"
    return text


def _detect(options: argparse.Namespace) -> None:
    _torch(options)
    from statistics import median

    from ..detect import detect, load_detector, pictures_of

    detector = load_detector(options.detector, device=options.device)
    if options.export is not None:
        _export(detector, options)
        return
    if options.pictures is None:
        raise GraycastError("there is nothing to look at: give a dataset or a folder of pictures")
    pictures = pictures_of(
        options.pictures,
        detector.about,
        split=options.split,
        scale_m=options.scale,
        as_real=options.as_real,
    )
    with progress_bar() as bar:
        task = bar.add_task("pictures", total=len(pictures.scene_ids))
        looked = detect(
            detector,
            pictures.examples,
            options.out,
            class_ids=pictures.class_ids,
            said=pictures.said,
            most=options.most,
            least_score=options.least_score,
            drawings=options.drawings,
            on_picture=lambda done: bar.update(task, completed=done),
        )
    count = sum(map(len, looked.found))
    print(
        f"{options.out}: {count} detections in {len(looked.found)} pictures, "
        f"{median(looked.ms_per_picture):.0f} ms a picture"
    )


def _export(detector, options: argparse.Namespace) -> None:
    from ..detect.onnx_file import write_onnx

    if options.pictures is not None:
        raise GraycastError("--export looks at no pictures: leave them out")
    write_onnx(detector, options.out, most=options.most, least_score=options.least_score)
    print(f"{options.out}: written; onnxruntime finds in it what torch finds")


def _study(options: argparse.Namespace) -> None:
    _torch(options)
    from ..study import read_study, run_study, runs_of, write_study

    spec = read_study(options.study)
    runs = list(runs_of(spec))
    if options.list:
        print("\n".join(run.name for run in runs))
        return
    with progress_bar() as bar:
        whole = bar.add_task("runs", total=len(runs))
        stage = bar.add_task("", total=None)
        place = {run.name: i for i, run in enumerate(runs)}

        def on_told(run, what: str, done: int, total: int) -> None:
            bar.update(whole, completed=place[run.name])
            bar.update(
                stage, description=f"{run.name}: {what}", completed=done, total=total or None
            )

        results = run_study(spec, options.out, device=options.device, on_told=on_told)
    write_study(spec, results, options.out)
    print((options.out / "table.md").read_text(encoding="utf-8"))
