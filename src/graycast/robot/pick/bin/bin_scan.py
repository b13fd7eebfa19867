"""One scan of the bin: rendering, sensor, decoding and detection."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from ....base.frames import inverse
from ....camera.picture import color_picture, gray_picture
from ....camera.scanner import measure, scan_seconds, take
from ....camera.sensor import Capture
from ....cell.config import resolve_quality
from ....cell.metering import metered_region
from ....dataset.read.detections import Detections
from ....dataset.read.example import Example
from ....rendering import Renderer, Rendering
from ....world.scene import Layout
from ...grasp import DepthView
from .aim import Candidate, whole_bin
from .robot_cell import PickCell

LEAST_VISIBLE_PX = 30  # The truth as detector reports no part with fewer visible pixels.
LEAST_SCORE = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class BinScan:
    """The result of a scan, and the true scene from the same view.

    `instance` is the index of the true part at each pixel, or -1. `seconds` is the simulated time
    of the frames, which is exposure and read-out.
    """

    view: DepthView
    gray: UInt8[np.ndarray, "h w"]
    rgb: UInt8[np.ndarray, "h w 3"] | None
    instance: np.ndarray
    seconds: float


def scan(
    cell: PickCell, renderer: Renderer, layout: Layout, *, seed: np.random.SeedSequence
) -> BinScan:
    """Scan the parts at their poses; depth that cannot be decoded is NaN.

    Without measured depth and a trained detector, one sample per pixel suffices for the picture.

    Raises:
        ValueError: the picture is dark, or a value is out of its range.
    """
    base, picking = cell.cell, cell.config.picking
    render_seed, noise_seed, picture_seed, depth_seed = map(int, seed.generate_state(4, np.uint64))
    quality = resolve_quality(cell.config)
    if picking.depth != "scanner" and cell.detector is None:
        quality = replace(quality, samples=1)
    rendering = renderer.render(
        base.scene, layout, base.patterns(), quality=quality, seed=render_seed
    )
    capture = take(
        base.scanner,
        rendering.radiance,
        seed=noise_seed,
        metered=metered_region(base.scene, base.scanner.exposure),
    )
    depth_m, p_wrong = _acted_on(cell, rendering, capture, depth_seed)
    return BinScan(
        view=DepthView(
            depth_m=depth_m,
            p_wrong=p_wrong,
            camera=base.scene.rig.camera,
            T_world_cam=base.scene.T_world_cam,
        ),
        gray=gray_picture(capture),
        rgb=_picture(cell, renderer, rendering, picture_seed),
        instance=rendering.truth.instance,
        seconds=scan_seconds(capture, readout_s=picking.readout_s),
    )


def _acted_on(
    cell: PickCell, rendering: Rendering, capture: Capture, seed: int
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"] | None]:
    """Return the depth that the robot uses: the scanner's, perfect depth, or noisy depth.

    The scanner's depth comes with the probability that it is wrong, if it is estimated.
    """
    picking = cell.config.picking
    if picking.depth == "scanner":
        noise = rendering.radiance.path_noise
        measured = measure(cell.cell.scanner, capture, path_noise=noise)[1]
        return measured.depth_m, measured.p_wrong
    perfect = rendering.truth.depth_m.astype(np.float64)
    if picking.depth_noise_m is None:
        return perfect, None
    noise_m = np.random.default_rng(seed).normal(0, picking.depth_noise_m, perfect.shape)
    return np.asarray(perfect + noise_m), None


def _picture(
    cell: PickCell, renderer: Renderer, rendering: Rendering, seed: int
) -> UInt8[np.ndarray, "h w 3"] | None:
    """Return the colour picture for the detector; None if there is no trained detector."""
    if cell.detector is None:
        return None
    return color_picture(cell.cell.scanner, rendering, denoiser=renderer.denoiser, seed=seed)


def targets(
    cell: PickCell, shot: BinScan, layout: Layout, detector: Any | None
) -> tuple[Candidate, ...]:
    """Return the candidate parts in a scan.

    Args:
        layout: the true poses of the parts, which are used only if detections or poses are true.
        detector: an opened detector, or None to use the truth.
    """
    picking = cell.config.picking
    if picking.detector == "none":
        return (Candidate(kind=None, score=1.0, mask=whole_bin(shot.view, cell.box)),)
    if detector is None:
        candidates = _true_targets(shot, layout)
    else:
        candidates = _detected(cell, shot, detector)
    if picking.pose == "truth":
        candidates = [_with_true_pose(target, shot, layout) for target in candidates]
    return tuple(candidates)


def _true_targets(shot: BinScan, layout: Layout) -> list[Candidate]:
    masks = ((kind, shot.instance == i) for i, kind in enumerate(layout.part_index.tolist()))
    return [
        Candidate(kind=kind, score=1.0, mask=mask)
        for kind, mask in masks
        if mask.sum() >= LEAST_VISIBLE_PX
    ]


def _detected(cell: PickCell, shot: BinScan, detector: Any) -> list[Candidate]:
    from pycocotools import mask as coco_mask

    ids = {part.name: i for i, part in enumerate(cell.cell.scene.parts)}
    # Classes that only the detector knows need an id, too, as ids below 0 are left out.
    another = 0 if len(ids) == 1 else len(ids)
    wanted = {name: ids.get(name, another) for name in detector.about.names}
    depth_m = shot.view.depth_m.astype(np.float32)
    example = Example(
        scene_id=0,
        rgb=shot.rgb,
        gray=shot.gray,
        scanner_depth_m=depth_m,
        depth_m=depth_m,
        p_wrong=shot.view.p_wrong,
    )
    detections: Detections = detector.detect(example, obj_ids=wanted, least_score=LEAST_SCORE)
    coded = detections.mask
    return [
        Candidate(
            kind=kind if kind < len(ids) else None,
            score=float(detections.score[i]),
            mask=None if coded is None else coco_mask.decode(dict(coded[i])).astype(bool),
            box_px=detections.box_px[i],
        )
        for i, kind in enumerate(detections.obj_id.tolist())
    ]


def _with_true_pose(target: Candidate, shot: BinScan, layout: Layout) -> Candidate:
    """Return a detection with the kind and the true pose of the part that fills most of it."""
    inside = shot.instance[target.inside(shot.instance.shape)]
    inside = inside[inside >= 0]
    if not len(inside):
        return target
    number = int(np.bincount(inside).argmax())
    return replace(
        target,
        kind=int(layout.part_index[number]),
        T_cam_part=inverse(shot.view.T_world_cam) @ layout.T_world_part[number],
    )
