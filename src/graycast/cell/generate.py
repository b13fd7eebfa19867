"""Many scenes of one cell, made by workers and written to the folder of a dataset.

A scene depends only on (configuration, dataset seed, scene id), not on the number of workers, the
order of scenes or a restart.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..base.errors import ConfigError, DatasetError
from ..base.progress import UNWATCHED, ProgressMeter
from ..base.public_value import public_value
from ..camera.decode import pooled_shares
from ..camera.scanner import Scanner
from ..dataset.files.places import CLAIM
from ..dataset.files.records import Claim
from ..dataset.files.safe_reading import Unreadable, read_json
from ..dataset.files.seal import differing_files
from ..dataset.write.bop import scene_files
from ..dataset.write.claim import BESIDE_CONFIG, Taker, described_values, make_claim, refuse_other
from ..dataset.write.picture_bytes import depth_scale_mm
from ..dataset.write.set_aside import SetAside, SetAsideFile
from ..dataset.write.store import open_store
from ..rig.pair import PRESETS
from .config import Config
from .engine import ALONE, Failed, SceneMaker, SceneTask, TaskResult, Workers, make_missing
from .resolve import Cell, reach_m
from .simulate import Shot, own_record


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Counts of a run: scenes made, already present and given up; share of pixels per reason."""

    written: int
    found: int
    set_aside: tuple[SetAside, ...]
    seconds: float
    reasons: dict[str, float]
    part_reasons: dict[str, float]  # shares among the pixels that see parts


def generate(
    cell: Cell,
    out: Path | str,
    *,
    scenes: int,
    seed: int,
    device: str = "auto",
    workers: Workers = ALONE,
    on_result: Callable[[TaskResult], None] = lambda _: None,
    on_failed: Callable[[Failed], None] = lambda failed: None,
    progress: ProgressMeter = UNWATCHED,
) -> Summary:
    """Make the scenes 0 .. scenes-1 that are not in `out` yet, and the split's COCO file.

    A scene that fails for good is set aside, and the other scenes are made; `set_aside.json` names
    the failed scene, and the next run tries it again.

    Args:
        out: the dataset's folder, which is created, or continued if it has the same configuration.
        device: 'auto', 'cpu', 'cuda' or, for Cycles, 'optix'.
        on_result: called with the result of each scene, in this process.
        on_failed: called with the reason for each failed try.
        progress: counts scenes, shows the preparations, and notes each part whose collision hulls
            are coarse. If this process makes all scenes, it shows their steps, too.

    Raises:
        DatasetError: the folder has a different dataset or is in use, or writing fails.
        DeviceError: this machine has no such device.
        GraycastError, ValueError: no scene was made, for this reason; or Ray does not answer.
    """
    out = Path(out)
    start = time.perf_counter()
    task = _task(cell, seed, workers.device(cell.config.render.backend, device))
    reason_px: list[dict[str, int]] = []
    part_reason_px: list[dict[str, int]] = []
    with open_store(out, **_claimed(task)) as store:
        there, aside = store.finished(), SetAsideFile(out)
        todo = [scene_id for scene_id in range(scenes) if scene_id not in there]

        def keep(result: TaskResult) -> None:
            store.write_files(result.scene_id, result.files)
            reason_px.append(result.reason_px)
            part_reason_px.append(result.part_reason_px)
            on_result(result)

        def give_up(failed: Failed) -> None:
            if failed.final:
                aside.add(f"{failed.scene_id:06d}", failed.set_aside())
            on_failed(failed)

        try:
            aside.forget(f"{scene_id:06d}" for scene_id in there.union(todo))
            lost = make_missing(
                task,
                todo,
                what="scenes",
                total=scenes,
                workers=workers,
                progress=progress,
                on_result=keep,
                on_failed=give_up,
            )
            store.finish(set(range(scenes)) - {scene.scene_id for scene in lost})
        except BaseException:
            store.tidy()
            raise
    return Summary(
        written=len(reason_px),
        found=scenes - len(todo),
        set_aside=tuple(scene.set_aside() for scene in lost),
        seconds=time.perf_counter() - start,
        reasons=pooled_shares(reason_px),
        part_reasons=pooled_shares(part_reason_px),
    )


def save_scene(cell: Cell, shots: Shot | Sequence[Shot], out: Path | str) -> Path:
    """Write a scene from `make_scene` into the folder of a new or unfinished dataset.

    If a cell takes several images of a scene, pass all images that `make_images` makes.

    The files equal those of `generate` for the same cell, seed and number, and `generate` may
    continue the folder. Unlike `generate`, this function accepts a scene in which nothing was
    decoded. If the same scene is there already, it stays unchanged.

    Returns:
        The scene's own folder.

    Raises:
        ValueError: the scene was made from a different configuration than the cell's, or an image
            of the scene is missing.
        DatasetError: the scene is there already with different files; the folder has a different
            dataset or is in use; or writing fails.
    """
    out = Path(out)
    samples = [shot.sample for shot in ([shots] if isinstance(shots, Shot) else shots)]
    manifest = samples[0].manifest
    scene_id = manifest["scene_id"]
    config = cell.config.model_dump(mode="json", exclude={"scenes", "seed"})
    if manifest["config"] != config or manifest.get("own", {}) != own_record(cell):
        raise ValueError(
            f"scene {scene_id} was made from another configuration than this cell's: give the "
            "cell with which make_scene made it"
        )
    images = [(sample.sensor, sample.image) for sample in samples]
    if tuple(images) != cell.images:
        raise ValueError(
            f"scene {scene_id} has {len(cell.images)} images, {len(images)} were given: give all "
            "that make_images makes"
        )
    task = _task(cell, manifest["dataset_seed"], manifest["device"])
    scene = out / "train" / f"{scene_id:06d}"
    with open_store(out, **_claimed(task)) as store:
        try:
            if scene_id not in store.finished():
                store.write(scene_id, samples)
            elif differing := differing_files(scene, scene_files(samples, task.depth_scale_mm)):
                name, how = next(iter(differing.items()))
                raise DatasetError(
                    f"{scene} exists already, and its {name} {how}: remove this folder, or save "
                    "the scene to another dataset"
                )
            store.finish(store.finished())
        except BaseException:
            store.tidy()
            raise
    return scene


def depth_step_mm(cell: Cell) -> float:
    """Return the step of the cell's depth pictures [mm], as configured or as the depth requires.

    Raises:
        ConfigError: with every step, the cell is deeper than 16 bits can store.
    """
    if cell.config.store.depth_step_mm is not None:
        return cell.config.store.depth_step_mm
    try:
        return depth_scale_mm(reach_m(cell))
    except ValueError as error:
        raise ConfigError(
            f"the bin is up to {reach_m(cell):.4g} m from the camera, and depth pictures end at "
            "65.534 m: give a smaller view.distance_m, or another store.depth_step_mm"
        ) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Origin of a dataset; `files` are the paths in its configuration."""

    config: Config
    seed: int
    files: tuple[str, ...]


def read_origin(out: Path) -> Origin:
    """Return the configuration and seed of a dataset that `generate` made.

    Raises:
        DatasetError: `out` has no such dataset, or its version of Graycast is different.
    """
    try:
        claim = read_json(out / CLAIM, Claim)
        settings = {key: claim.config[key] for key in claim.config if key not in BESIDE_CONFIG}
        stored = settings["store"] | {"depth_step_mm": claim.depth_scale_mm}
        config = Config.model_validate(settings | {"store": stored})
        named = [entry.rig for entry in config.scanners or (config,)]
        rigs = [rig for rig in named if rig not in PRESETS]
        return Origin(config=config, seed=claim.seed, files=(*claim.config["files"], *rigs))
    except (Unreadable, ValidationError, KeyError) as error:
        why = " ".join(str(error).split())
        raise DatasetError(f"{out} holds no dataset that this Graycast made ({why})") from error


def rerender(
    cell: Cell, out: Path, scene_id: int, *, seed: int, device: str = "auto"
) -> dict[str, str]:
    """Make a stored scene again, and compare it with the stored files; nothing is written.

    Returns:
        The files that differ, and how; empty if all files are equal. Timings in a manifest are not
        compared.

    Raises:
        DatasetError: the scene is missing, or the dataset has a different configuration.
        DropError, ValueError, DeviceError: as in `make_scene` and `open_renderer`.
    """
    task = _task(cell, seed, ALONE.device(cell.config.render.backend, device))
    refuse_other(out / CLAIM, make_claim(**_claimed(task)))
    scene = out / "train" / f"{scene_id:06d}"
    if not scene.is_dir():
        raise DatasetError(f"{scene} is not there: give the number of a finished scene")
    with closing(SceneMaker(task)) as maker:
        return differing_files(scene, maker.make(scene_id).files)


def _task(cell: Cell, seed: int, device: str) -> SceneTask:
    return SceneTask(cell=cell, seed=seed, device=device, depth_scale_mm=depth_step_mm(cell))


def _claimed(task: SceneTask) -> dict[str, Any]:
    """Return the arguments of `open_store` and of `make_claim` for this run."""
    cell = task.cell
    config = cell.config.model_dump(mode="json", exclude={"scenes", "seed"})
    beside = (cell.file_digests, described_scanner(cell.scanner))
    return {
        "config": config | dict(zip(BESIDE_CONFIG, beside, strict=True)),
        "seed": task.seed,
        "parts": cell.kinds,
        "rig": cell.scene.rig,
        "depth_scale_mm": task.depth_scale_mm,
        "takers": _takers(cell),
    }


def _takers(cell: Cell) -> tuple[Taker, ...]:
    """Return all scanners, or () if a single scanner without a name takes one image."""
    images = Counter(name for name, _ in cell.images)
    takers = tuple(
        Taker(
            name=name,
            images=images[name],
            rig=cell.scene.rig if scanner is cell.scanner else scanner.rig,
            scanning=described_scanner(scanner),
        )
        for name, scanner in cell.scanners
    )
    return () if images == {"": 1} else takers


def described_scanner(scanner: Scanner) -> dict[str, Any]:
    """Return all values of a preset or rig file except the rig, which a claim holds separately."""
    names = [field.name for field in fields(scanner) if field.name != "rig"]
    return {name: described_values(getattr(scanner, name)) for name in names}
