"""Commands for detectors: detector train, find, onnx, score, study."""

import argparse
from pathlib import Path

from ..base.errors import GraycastError
from ..learn.detect.networks import HOLES, INPUTS, MODELS
from .arguments import (
    CONTINUE,
    add_command,
    add_device,
    add_division,
    add_group,
    add_option,
    add_out,
    add_scoring,
    add_shared,
    division_of,
)
from .bars import open_bars
from .readers import above_zero, numbers, positive, reader, whole

_NOTES = 5  # At most this many notes are printed.

TRAIN = """\
The datasets are those of Graycast, their exports, or datasets of real pictures. An export keeps the
division into sets with which it was made, and --shares does not apply to it. The detector learns
from the scenes of the train set, and the command keeps the weights that score best on the val set.
It writes detector.pt (the weights and the encoding of pictures), history.csv and curves.png to the
folder of the training. If a training is stopped or killed, the same command continues it."""


def add_commands(commands) -> None:
    group = add_group(commands, "detector", "Train detectors, find parts with them, score them.")
    _add_train(group)
    find = add_command(
        group, "find", _find, "Find parts in a dataset or in pictures with a trained detector.",
        example="out/detector out/demo --out out/found",
    )  # fmt: skip
    _add_detector(find)
    pictures = "A dataset, an export, or a folder with the subfolders rgb, gray and depth."
    add_option(find, "pictures", Path, pictures)
    add_out(find, "The folder to write, which may hold earlier detections.")
    add_shared(find, "--split", usual="all scenes")
    add_option(
        find,
        "--as-real",
        None,
        "Treat the dataset as a real one. Its perfect depth is not used, and a detector that was "
        "trained on perfect depth gets the scanner's depth.",
    )
    add_shared(find, "--scale")
    _add_limits(find)
    drawings = "The number of pictures in which the detections are drawn."
    add_option(find, "--drawings", whole, drawings, 12)
    _add_network(find)

    onnx = add_command(
        group, "onnx", _onnx, "Write a detector as an ONNX file.",
        example="out/detector --out detector.onnx",
        more="The command checks that the file finds what the detector finds.",
    )  # fmt: skip
    _add_detector(onnx)
    add_out(onnx, "The ONNX file to write.")
    _add_limits(onnx)
    _add_network(onnx)
    _add_score(group)

    study = add_command(
        group, "study", _study, "Train and score a detector for every combination of a study.",
        example="configs/paper/study.yaml --out out/study",
        more="The command writes one table.", when_stopped=CONTINUE,
    )  # fmt: skip
    file = "The YAML file of the study, such as configs/paper/study.yaml."
    add_option(study, "study", Path, file)
    add_out(study, "The folder to write.")
    add_shared(study, "--list")
    _add_network(study)


def _add_detector(parser: argparse.ArgumentParser) -> None:
    detector = "The folder that graycast detector train wrote, or its file detector.pt."
    add_option(parser, "detector", Path, detector)


def _add_limits(parser: argparse.ArgumentParser) -> None:
    add_shared(parser, "--max-detections", default=300)
    add_shared(parser, "--min-score", default=0.05)


def _add_network(parser: argparse.ArgumentParser) -> None:
    add_device(parser)
    add_shared(parser, "--threads", usual="the number that torch chooses")


def _add_train(group) -> None:
    train = add_command(
        group, "train", _train, "Train a detector on datasets.",
        example="out/demo --out out/detector", more=TRAIN, when_stopped=CONTINUE,
    )  # fmt: skip
    add_option(
        train,
        "datasets",
        Path,
        "Folders of Graycast datasets or of their exports. For a dataset from another source, give "
        "its file of COCO annotations or the folder of one of its BOP splits.",
        nargs="+",
    )
    add_out(train, "The folder to write.")
    add_option(train, "--model", MODELS, "The architecture of the network.", "mask-rcnn")
    add_option(
        train,
        "--input",
        INPUTS,
        "The input of the network: rgb is the colour picture, depth is perfect depth, depth_sl is "
        "the scanner's depth, depth_noisy is perfect depth with Gaussian noise and random holes, "
        "and rgbd is colour with the scanner's depth.",
        "depth_sl",
    )
    add_shared(train, "--one-class")
    backbone = "The part of the network that computes features from pictures."
    add_option(train, "--backbone", str, backbone, usual="the model's own", metavar="NAME")
    add_option(
        train,
        "--weights",
        Path,
        "A file of weights from another training or a publication, with which the training starts.",
        usual="random weights",
    )
    side = "The longer side of the network's input picture in pixels."
    add_option(train, "--longest-side", positive, side, 384, metavar="PX")
    _add_training(train)
    add_shared(train, "--seed", default=0)
    _add_network(train)
    readers = "The number of additional processes that read pictures."
    add_option(train, "--readers", whole, readers, 0)


def _add_training(train: argparse.ArgumentParser) -> None:
    """Add the options for the training: schedule, division of scenes, and encoding of depth."""
    epochs = "The number of epochs, which are passes over all pictures of the train set."
    add_option(train, "--epochs", positive, epochs, 40)
    add_option(
        train,
        "--patience",
        positive,
        "The training ends after this number of consecutive validations without a better score.",
        10,
    )
    batch = "The number of pictures in one training step."
    add_option(train, "--batch", positive, batch, usual="the model's own")
    rate = "The highest learning rate of the schedule."
    add_option(train, "--learning-rate", above_zero, rate, usual="the model's own")
    add_division(train, shares="0.8,0.1,0.1")
    add_shared(train, "--min-visibility", default=0.1)
    add_option(
        train,
        "--holes",
        HOLES,
        "How missing depth is encoded: as an additional channel, as zero, or as the far end of "
        "the range.",
        "channel",
    )
    relief = "Omit the input channel with the height above the neighbourhood of each pixel."
    add_option(train, "--no-relief", None, relief)
    p_wrong = "Add an input channel with the probability that the scanner's depth is wrong."
    add_option(train, "--p-wrong", None, p_wrong)
    add_option(
        train,
        "--range",
        _range,
        "The nearest and the farthest depth in metres, such as 0.6,1.2.",
        usual="the range of the datasets",
        metavar="NEAR,FAR",
    )
    add_option(train, "--no-flips", None, "Train without mirrored pictures.")


def _add_score(group) -> None:
    score = add_command(
        group, "score", _score, "Score detections against the labels of a dataset.",
        example="out/found --on out/demo --out out/scores",
        more="Each score has a confidence interval.",
    )  # fmt: skip
    results = "A folder that graycast detector find wrote, or a file of COCO results."
    add_option(score, "results", Path, results)
    add_scoring(score, split="that of graycast detector find, otherwise train")
    add_option(
        score,
        "--against",
        Path,
        "A second set of detections in the same scenes. The difference between the scores is "
        "reported with its confidence interval.",
    )
    add_option(
        score,
        "--kind",
        ("box", "mask"),
        "Score only boxes or only masks.",
        usual="boxes, and also masks if results and labels have them",
    )
    add_shared(score, "--one-class")
    most = "The number of detections of each kind of part in a picture that are scored, best first."
    add_option(score, "--max-per-class", positive, most, 300)


_range = reader(
    numbers,
    lambda range_m: len(range_m) == 2 and 0 < range_m[0] < range_m[1],
    "a range: give two distances in metres, such as 0.6,1.2",
)


def _torch(options: argparse.Namespace) -> None:
    """Check that torch is installed and `--device` suits it; set torch's number of threads."""
    try:
        import torch
    except ImportError as error:
        raise GraycastError(
            "detectors need PyTorch, which is not installed: run pip install 'graycast[detect]'"
        ) from error
    if options.device == "optix":
        raise GraycastError("--device optix applies only to Cycles: give auto, cpu or cuda")
    if options.threads is not None:
        torch.set_num_threads(options.threads)


def _train(options: argparse.Namespace) -> None:
    _torch(options)
    from ..learn.detect import Augmentation, TrainSpec, train

    spec = TrainSpec(
        model=options.model,
        input=options.input,
        backbone=options.backbone,
        longest_px=options.longest_side,
        holes=options.holes,
        relief=not options.no_relief,
        p_wrong=options.p_wrong,
        range_m=options.range,
        epochs=options.epochs,
        batch=options.batch,
        learning_rate=options.learning_rate,
        seed=options.seed,
        one_class=options.one_class,
        min_visibility=options.min_visibility,
        patience=options.patience,
        split=division_of(options),
        augmentation=Augmentation(flip=not options.no_flips),
        weights=options.weights,
        device=options.device,
        workers=options.readers,
    )
    with open_bars() as bars:
        train(
            options.datasets,
            options.out,
            spec,
            progress=bars,
            on_row=lambda row: bars.line(_line(row)),
        )
    print(
        f"{options.out}: the training is complete; detector.pt holds the weights of the best "
        "validation"
    )


def _line(row: dict[str, float]) -> str:
    text = f"epoch {row['epoch']:.0f}: loss {row['loss']:.3f}"
    for name in ("box_ap50", "mask_ap50", "box_ap", "mask_ap"):
        if name in row:
            text += f", {name.replace('_', ' ').replace('ap', 'AP')} {row[name]:.3f}"
    return text


def _find(options: argparse.Namespace) -> None:
    _torch(options)
    from statistics import median

    from ..learn.detect import detect, load_detector, pictures_of

    detector = load_detector(options.detector, device=options.device)
    pictures = pictures_of(
        options.pictures,
        detector.about,
        split=options.split or "all",
        scale_m=options.scale,
        as_real=options.as_real,
    )
    with open_bars() as bars:
        detection = detect(
            detector,
            pictures,
            options.out,
            most=options.max_detections,
            least_score=options.min_score,
            drawings=options.drawings,
            progress=bars,
        )
    count = sum(map(len, detection.found))
    print(
        f"{options.out}: {count} detections in {len(detection.found)} pictures, "
        f"{median(detection.ms_per_picture):.0f} ms a picture"
    )
    for note in detection.notes[:_NOTES]:
        print(f"note: {note}")
    if len(detection.notes) > _NOTES:
        print(f"note: there are {len(detection.notes) - _NOTES} more notes of this kind")


def _onnx(options: argparse.Namespace) -> None:
    _torch(options)
    from ..learn.detect import load_detector
    from ..learn.detect.onnx_file import write_onnx

    detector = load_detector(options.detector, device=options.device)
    most, least = options.max_detections, options.min_score
    write_onnx(detector, options.out, most=most, least_score=least)
    print(f"{options.out}: written; onnxruntime finds in it what torch finds")


def _score(options: argparse.Namespace) -> None:
    from ..base.folder import refuse_foreign, whole_folder
    from ..score.evaluate import EVALUATION, Protocol, Task, evaluate, summary, write_evaluation

    if options.results.suffix == ".csv":
        raise GraycastError(f"{options.results} holds poses: use graycast robot score-poses")
    refuse_foreign(options.out, EVALUATION)
    task = Task(
        results=options.results,
        dataset=options.on,
        split=options.split,
        division=division_of(options),
        against=options.against,
        kind=options.kind,
        one_class=options.one_class,
        protocol=Protocol(
            min_visibility=options.min_visibility,
            most=options.max_per_class,
            draws=options.resamples,
            seed=options.seed,
        ),
    )
    with whole_folder(options.out) as folder, open_bars() as bars:
        evaluation, picture = evaluate(task, progress=bars)
        write_evaluation(evaluation, picture, folder)
    print(summary(evaluation))
    print(options.out)


def _study(options: argparse.Namespace) -> None:
    _torch(options)
    from ..learn.study import read_study, run_study, runs_of, write_study

    spec = read_study(options.study)
    runs = list(runs_of(spec))
    if options.list:
        print("\n".join(run.name for run in runs))
        return
    with open_bars() as bars:

        def on_done(result) -> None:
            figures = [
                f"{kind} {world} {result.of(world, kind).value:.2f}"
                for world, kind in result.figures
            ]
            bars.line(f"{result.run.name}: AP50 {', '.join(figures)}")

        results = run_study(
            spec, options.out, device=options.device, progress=bars, on_done=on_done
        )
    write_study(spec, results, options.out)
    print((options.out / "table.md").read_text(encoding="utf-8"))
