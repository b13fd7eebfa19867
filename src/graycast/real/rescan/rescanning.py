"""Scan of all images of a third-party dataset: staging, rendering, capture, decoding, writing.

An image's result depends only on the source, the scanner, the seed and the image's numbers.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...base.errors import ConfigError, DatasetError, DecodeError
from ...base.progress import UNWATCHED, ProgressMeter
from ...base.public_value import public_value
from ...base.settings import check_fields
from ...base.streams import rescan_seeds
from ...base.usage import rss_bytes
from ...base.version import __version__
from ...camera.decode import pooled_shares, reason_counts, reason_shares
from ...camera.picture import gray_picture
from ...camera.scanner import Scanner, measure, take
from ...cell.config import RenderSection, quality_of
from ...cell.engine import (
    ALONE,
    HOPELESS,
    Failed,
    Job,
    TaskResult,
    WorkerRenderer,
    Workers,
    make_missing,
)
from ...cell.generate import described_scanner
from ...cell.metering import metered_region
from ...cell.resolve import patterns_of
from ...cell.simulate import on_part
from ...dataset.files.json_text import plain
from ...dataset.files.records import FORMAT_VERSION, MM_PER_M
from ...dataset.files.sample import LEAST_DECODED, Sample
from ...dataset.write.bop import scanner_files
from ...dataset.write.claim import claimed_options, described_values, fingerprint, part_digest
from ...dataset.write.picture_bytes import DEPTH_MAX, depth_scale_mm
from ...dataset.write.set_aside import SetAsideFile
from ..depth_file import read_intrinsics
from .rescan_folder import open_rescan, plain_files, record_file
from .source import Source, SourceImage
from .staging import Staged, stage, with_camera

_LEAST_IN_RANGE = 0.01  # least share of the depth that must be in the rig's range
_NOT_CLAIMED = ("seed", "images", "copies", "device")  # The claim stores the seed separately.
_BY_CONTENT = ("models", "materials", "intrinsics")  # The claim stores the content of these files.


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class RescanSpec:
    """Options of a rescan: the camera, the rendering, the images, and the seed.

    With `camera='image'`, the image's intrinsics replace those of the rig. With 'rig', the camera
    of the rig is at the position of the image's camera. `images` scans only this number of first
    images; None scans all. `copies` makes copies of the original files instead of links.
    """

    camera: Literal["image", "rig"] = "image"
    seed: int = 0
    render: RenderSection = field(default_factory=RenderSection)
    images: int | None = None
    copies: bool = False
    device: str = "auto"

    def __post_init__(self) -> None:
        check_fields(self)


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class RescanSummary:
    """Summary of a run: numbers of written and already finished images, and images set aside.

    The shares refer to all pixels of the written images, and to the pixels that show objects.
    """

    written: int
    there: int
    set_aside: Mapping[tuple[int, int], str]
    seconds: float
    reasons: dict[str, float]
    part_reasons: dict[str, float]


class ImageScanner:
    """Scanner of the images of one task, with one renderer that stays open between images."""

    def __init__(self, task: "RescanTask", *, threads: int | None, progress: ProgressMeter) -> None:
        self._task, self._progress = task, progress
        self._renderer = WorkerRenderer(device=task.device, threads=threads, progress=progress)

    def make(self, scene_id: int) -> TaskResult:
        """Scan one image; `scene_id` is its index among the images of the source.

        Raises:
            DatasetError, DecodeError, ValueError: this image cannot be scanned.
        """
        start = time.perf_counter()
        task = self._task
        scene, number = task.source.images[scene_id]
        # Checksums are computed before the image is read, so that they show later changes.
        sums = task.source.sums(scene, [number])[number]
        image = task.source.read(scene, number)
        _refuse_out_of_range(image, task.scanner)
        scanner = task.scanner
        if task.spec.camera == "image":
            scanner = with_camera(scanner, image.camera)
        self._progress.stage("staging the image")
        staged = stage(
            image,
            task.source.parts,
            scanner,
            unknown_look=task.source.plain,
            background=task.source.background,
        )
        # Rescans with different rigs or of different cameras must have independent noise.
        name = f"{scanner.rig.name} {task.source.sensor}".rstrip()
        seeds = rescan_seeds(task.seed, scene, scanner=name, image=number)
        sample, facts = self._scanned(staged, scanner, seeds, number)
        files, entries = scanner_files(sample, task.depth_scale_mm, staged.obj_id)
        for key in ("cam_R_w2c", "cam_t_w2c"):  # The world frame of `stage` is not the dataset's.
            del entries["scene_camera_sl"][key]
        step_mm = image.step_m * MM_PER_M
        if not task.source.scenes:
            own_files, own_entries = plain_files(image, number)
            files, entries = files + own_files, entries | own_entries
            step_mm = own_entries["scene_camera"]["depth_scale"]
        own = on_part(staged.scene, staged.layout, sample.truth)
        seconds = time.perf_counter() - start
        record = facts | {
            "seconds": seconds,
            "perfect_step_mm": step_mm,
            "entries": entries,
            "source": sums,
        }
        return TaskResult(
            scene_id=scene_id,
            files=(*files, record_file(number, record, files)),
            seconds=seconds,
            reasons=facts["reasons"],
            reason_px=reason_counts(sample.scanner_depth.reason),
            part_reason_px=reason_counts(sample.scanner_depth.reason[own]),
            rss_bytes=rss_bytes(),
        )

    def _scanned(
        self, staged: Staged, scanner: Scanner, seeds: dict[str, int], number: int
    ) -> tuple[Sample, dict[str, Any]]:
        """Render and measure a staged image; return the sample and values for its record."""
        task = self._task
        render = task.spec.render
        with self._renderer.of(render) as renderer:
            self._progress.stage(f"{renderer.name} renders")
            rendering = renderer.render(
                staged.scene,
                staged.layout,
                patterns_of(scanner),
                quality=quality_of(render),
                seed=seeds["render"],
            )
        self._progress.stage("decoding the pictures")
        capture = take(
            scanner,
            rendering.radiance,
            seed=seeds["noise"],
            metered=metered_region(staged.scene, scanner.exposure),
        )
        codes, depth = measure(scanner, capture, path_noise=rendering.radiance.path_noise)
        reasons = reason_shares(depth.reason)
        _refuse_undecoded(reasons)
        own = on_part(staged.scene, staged.layout, rendering.truth)
        facts = {
            "seeds": seeds,
            "exposure_s": capture.reference_s,
            "reasons": reasons,
            "part_reasons": reason_shares(depth.reason[own]),
        }
        # This depth is not written, so it may be clipped to the largest value of 16 bits.
        deepest_m = DEPTH_MAX * task.depth_scale_mm / MM_PER_M
        truth = replace(
            rendering.truth, depth_m=np.minimum(rendering.truth.depth_m, np.float32(deepest_m))
        )
        camera = scanner.rig.camera
        sample = Sample(
            scene=staged.scene,
            layout=staged.layout,
            truth=truth,
            rgb=np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8),
            gray=gray_picture(capture),
            scanner_depth=depth,
            modulation=codes.modulation,
            manifest={},
            image=number,
        )
        return sample, facts

    def close(self) -> None:
        self._renderer.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class RescanTask(Job):
    """Data that a worker process needs to scan any image of a source."""

    RUNNER = ImageScanner

    source: Source
    scanner: Scanner
    spec: RescanSpec
    depth_scale_mm: float


def rescan(
    source: Source,
    scanner: Scanner,
    out: Path | str,
    spec: RescanSpec,
    *,
    workers: Workers = ALONE,
    on_result: Callable[[TaskResult], None] = lambda _: None,
    on_failed: Callable[[Failed], None] = lambda _: None,
    progress: ProgressMeter = UNWATCHED,
) -> RescanSummary:
    """Scan the images of a source that are not in `out` yet.

    An image that cannot be scanned is set aside, and the run continues. `set_aside.json` names such
    images, and the next run tries them again.

    Raises:
        GraycastError, ValueError: no image can be scanned, for the reason in the text; or the
            folder belongs to another result, is in use, or cannot be written.
    """
    start = time.perf_counter()
    task = RescanTask(
        seed=spec.seed,
        device=workers.device(spec.render.backend, spec.device),
        source=source,
        scanner=scanner,
        spec=spec,
        depth_scale_mm=depth_scale_mm(scanner.rig.far_m),
    )
    wanted = source.images[: spec.images]
    reason_px: list[dict[str, int]] = []
    part_reason_px: list[dict[str, int]] = []
    scene_ids = sorted({scene_id for scene_id, _ in wanted})
    opened = open_rescan(Path(out), source, _claim(task), scene_ids=scene_ids, copies=spec.copies)
    with opened as folder:
        there = folder.finished().intersection(wanted)
        todo = [k for k, place in enumerate(wanted) if place not in there]
        if not there:
            _refuse_hopeless(source, wanted[:HOPELESS], scanner)
        aside = SetAsideFile(folder.out)
        aside.forget(map(_name, folder.finished().union(wanted)))

        def keep(result: TaskResult) -> None:
            folder.write(wanted[result.scene_id], result.files)
            reason_px.append(result.reason_px)
            part_reason_px.append(result.part_reason_px)
            on_result(result)

        def give_up(failed: Failed) -> None:
            if failed.final:
                aside.add(_name(wanted[failed.scene_id]), failed.set_aside())
            on_failed(failed)

        try:
            lost = make_missing(
                task,
                todo,
                what="images",
                total=len(wanted),
                workers=workers,
                progress=progress,
                on_result=keep,
                on_failed=give_up,
            )
        finally:
            folder.finish()
    return RescanSummary(
        written=len(reason_px),
        there=len(there),
        set_aside={wanted[image.scene_id]: image.set_aside().reason for image in lost},
        seconds=time.perf_counter() - start,
        reasons=pooled_shares(reason_px),
        part_reasons=pooled_shares(part_reason_px),
    )


def _name(place: tuple[int, int]) -> str:
    """Return the name of an image in `set_aside.json`."""
    return "{:06d}/{:06d}".format(*place)


def _refuse_out_of_range(image: SourceImage, scanner: Scanner) -> None:
    """Refuse an image whose depth is outside the rig's range.

    Raises:
        DecodeError: too little depth is within the rig's range.
    """
    depth_m = image.depth_m[np.isfinite(image.depth_m)]
    rig = scanner.rig
    within = (depth_m >= rig.near_m) & (depth_m <= rig.far_m)
    if depth_m.size and within.mean() < _LEAST_IN_RANGE:
        low, middle, high = np.quantile(depth_m, [0.05, 0.5, 0.95])
        raise DecodeError(
            f"its depth is {low:.3g} to {high:.3g} m, {middle:.3g} m in the median, and the rig "
            f"{rig.name} measures from {rig.near_m:.3g} to {rig.far_m:.3g} m: choose another rig "
            "(graycast rig list), or check the depth scale"
        )


def _refuse_hopeless(source: Source, first: Sequence[tuple[int, int]], scanner: Scanner) -> None:
    """Refuse a rig that cannot measure any of the first images, before any image is scanned.

    Raises:
        ConfigError: the depth of all first images is outside the rig's range.
    """
    errors = []
    for scene_id, image_id in first:
        try:
            _refuse_out_of_range(source.read(scene_id, image_id), scanner)
            return
        except DecodeError as error:
            errors.append(f"scene {scene_id}, image {image_id}: {error}")
        except DatasetError:  # The run sets this image aside with the reason.
            return
    raise ConfigError(errors[0])


def _refuse_undecoded(reasons: Mapping[str, float]) -> None:
    if reasons["decoded"] < LEAST_DECODED:
        most = max(reasons, key=lambda name: reasons[name])
        raise DecodeError(
            f"the scanner measures {reasons['decoded']:.2%} of the pixels, and {reasons[most]:.0%} "
            f"are {most}: choose a rig that sees and lights these scenes (graycast rig list)"
        )


def _claim(task: RescanTask) -> dict[str, Any]:
    """Return the content of `graycast.json`: all options and values on which the result depends.

    Checksums of the source's files are in the record of each image.
    """
    source, spec = task.source, task.spec
    intrinsics = source.options.intrinsics
    K = None if intrinsics is None else read_intrinsics(intrinsics)
    config = {
        "split": source.split,
        **claimed_options(spec, without=_NOT_CLAIMED),
        "sensor": source.sensor,
        "options": claimed_options(source.options, without=_BY_CONTENT) | {"intrinsics": K},
        "plain": sorted(source.plain),
        "scanner": described_scanner(task.scanner),
        "parts": {obj_id: part_digest(part) for obj_id, part in source.parts.items()},
        "names": {obj_id: part.name for obj_id, part in source.parts.items()},
        "background": None if source.background is None else source.background.words,
    }
    claim: dict[str, Any] = plain(
        {
            "format_version": FORMAT_VERSION,
            "kind": "rescan",
            "config": config,
            "seed": task.seed,
            "depth_scale_mm": task.depth_scale_mm,
            "rig": described_values(task.scanner.rig),
        }
    )
    return claim | {
        "fingerprint": fingerprint(claim),
        "sources": [str(source.folder.resolve())],
        "versions": {"graycast": __version__},
    }
