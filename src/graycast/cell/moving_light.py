"""Light over time: few renders of a moving scene, from which all pictures are interpolated.

The light of a picture is the mean over its exposure. Between two renders it changes in proportion
to time. If the picture moves by d between two renders, the phase of a cosine with the period p is
then wrong by at most 0.1 (2 pi d / p)^3 / 6 rad, and its amplitude is at most (pi d / p)^2 / 2 too
low. An edge is blurred over d. All renders use the same random numbers, so that the errors of their
light paths are similar.

Leaves out: speckle, line noise and the error of few light paths are those of the ground truth's
time and stay at their pixels; fixed lamps, see `motion`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int

from ..base import array_types as arrays
from ..base.frames import inverse
from ..base.progress import UNWATCHED, ProgressMeter
from ..camera.decode import levels_of, take_back
from ..camera.exposure import ExposureTimes
from ..camera.light import SensorLight, camera_light
from ..camera.scanner import Scanner
from ..camera.sensor import Capture, merge_exposures
from ..rendering import GroundTruth, Quality, Renderer
from ..world.scene import Layout, Scene, bin_of
from .motion import MotionSection, Timeline, pose_at, speed_px_s, timeline
from .moving_parts import flow_px, layout_at, parts_speed_px_s
from .views import refuse_inside


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderPlan:
    """The times of all renders, and the weight of each render in the light of each picture."""

    time_s: Float[np.ndarray, " m"]
    weight: Float[np.ndarray, "p m"]


def plan_renders(
    start_s: Float[np.ndarray, " p"], duration_s: Float[np.ndarray, " p"], *, longest_s: float
) -> RenderPlan:
    """Return the fewest renders that are at most `longest_s` apart within each exposure.

    Each picture has its own renders, one in the middle of each equal part of its exposure, unless
    evenly spaced renders over the whole scan are fewer; the light is interpolated between those.
    """
    parts = np.maximum(1, np.ceil(duration_s / longest_s - 1e-9)).astype(int)
    owner = np.repeat(np.arange(len(start_s)), parts)
    part = np.concatenate([np.arange(n) for n in parts])
    own_s = start_s[owner] + duration_s[owner] * (part + 0.5) / parts[owner]
    first_s, last_s = float(own_s.min()), float(own_s.max())
    even = math.ceil((last_s - first_s) / longest_s - 1e-9) + 1
    if even < len(own_s):
        time_s = np.linspace(first_s, last_s, even)
        step_s = (last_s - first_s) / (even - 1) if even > 1 else math.inf
        share = np.maximum(1 - np.abs(own_s[:, None] - time_s) / step_s, 0.0)
    else:
        time_s, share = own_s, np.eye(len(own_s))
    weight = np.zeros((len(start_s), len(time_s)))
    np.add.at(weight, owner, share / parts[owner, None])
    return RenderPlan(time_s=time_s, weight=weight)


class MovingLight:
    """The light of a moving scene on the sensor, as a function of the exposure times for `take`.

    `record` has the times of the pictures and the number of renders of the last call.
    """

    def __init__(
        self,
        renderer: Renderer,
        scene: Scene,
        layout: Layout,
        patterns: arrays.UInt8Array_n_ph_pw,
        motion: MotionSection,
        *,
        quality: Quality,
        seed: int,
        progress: ProgressMeter = UNWATCHED,
    ) -> None:
        """Keep what a call needs.

        Args:
            scene: the scene at the time of the ground truth.
            seed: the seed of all renders.
        """
        self._renderer, self._scene, self._layout = renderer, scene, layout
        self._patterns, self._motion, self._progress = patterns, motion, progress
        self._quality, self._seed = quality, seed
        self.record: dict[str, Any] = {}
        self._line: Timeline | None = None

    def __call__(self, times: ExposureTimes) -> list[SensorLight]:
        """Render the scene at several times, and return the light of each exposure.

        Raises:
            ConfigError: the rig would be inside the bin; the path does not cover the scan.
            ValueError: see `Renderer.render`.
        """
        line = timeline(self._motion, times, len(self._patterns))
        self._line = line
        plan = _plan(self._scene, self._layout, self._motion, line)
        exposures, frames = line.start_s.shape
        camera = self._scene.rig.camera
        shape = (exposures, frames, camera.height_px, camera.width_px)
        stack, background = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        for number, time_s in enumerate(plan.time_s):
            self._progress.count("renders of a scan", number, len(plan.time_s))
            weight = plan.weight[:, number].reshape(exposures, frames).astype(np.float32)
            frames_now = np.flatnonzero(weight.any(axis=0))
            light, ambient = self._light_at(float(time_s), frames_now)
            for image, frame in zip(light, frames_now, strict=True):
                for exposure in np.flatnonzero(weight[:, frame]):
                    stack[exposure, frame] += weight[exposure, frame] * image
                    background[exposure, frame] += weight[exposure, frame] * ambient
        self._progress.count("renders of a scan", len(plan.time_s), len(plan.time_s))
        self.record = {
            "start_s": line.start_s.tolist(),
            "exposure_s": line.duration_s.tolist(),
            "scan_s": line.scan_s,
            "pictures": line.start_s.size,
            "renders": len(plan.time_s),
        }
        return [SensorLight(*light) for light in zip(stack, background, strict=True)]

    def at_rest(self, scanner: Scanner, exposures: Sequence[Capture]) -> Capture:
        """Merge the exposures of the last scan; with compensation, of a scene at rest.

        Each exposure is taken back by its own times, before the exposures are merged.
        """
        if not self._motion.compensate or self._line is None:
            return merge_exposures(exposures)
        T, code = self._scene.T_world_cam, scanner.light_code()
        top_dn = levels_of(scanner.sensor).saturation_dn
        backs = list[Capture]()
        for exposure, middle_s in zip(exposures, self._line.middle_s, strict=True):
            poses = [pose_at(T, self._motion, float(t)) for t in middle_s]
            motion = np.stack([inverse(pose) @ T for pose in poses])
            frames = take_back(
                exposure.frames, code, scanner.rig, motion,
                saturation_dn=top_dn, progress=self._progress,
            )  # fmt: skip
            backs.append(replace(exposure, frames=frames))
        return backs[0] if len(backs) == 1 else _merged(backs, top_dn)

    def flow(self, truth: GroundTruth) -> Float32[np.ndarray, "p h w 2"] | None:
        """Return the flow to each picture of the last scan [px]; None if it is not wanted."""
        if not self._motion.flow or self._line is None:
            return None
        times_s = self._line.middle_s.ravel().tolist()
        still = self._scene, self._layout, truth, self._motion
        return np.stack([flow_px(*still, time_s).astype(np.float32) for time_s in times_s])

    def _light_at(self, time_s: float, frames_now: Int[np.ndarray, " k"]) -> tuple[Any, Any]:
        """Return the light of some patterns, and all other light, as in `camera_light`."""
        scene = self._scene
        T_world_cam = pose_at(scene.T_world_cam, self._motion, time_s)
        if scene.bin is not None:
            refuse_inside(T_world_cam, scene.rig, bin_of(scene), f"motion: {time_s:.3g} s")
        moved = replace(scene, T_world_cam=T_world_cam)
        layout = layout_at(self._layout, self._motion, time_s)
        rendering = self._renderer.render(
            moved, layout, self._patterns[frames_now], quality=self._quality, seed=self._seed
        )
        return camera_light(rendering.radiance, scene.rig)


def _merged(exposures: Sequence[Capture], top_dn: float) -> Capture:
    """Merge exposures that were taken back.

    A point may be outside the pictures of one exposure only. It then counts as saturated there, so
    that another exposure gives its values.
    """
    outside = [~each.frames.any(axis=0) for each in exposures]
    inside = [
        replace(each, frames=np.where(out, each.frames.dtype.type(top_dn), each.frames))
        for each, out in zip(exposures, outside, strict=True)
    ]
    capture = merge_exposures(inside)
    nowhere = np.all(outside, axis=0)
    frames = np.where(nowhere, capture.frames.dtype.type(0), capture.frames)
    return replace(capture, frames=frames)


def _plan(scene: Scene, layout: Layout, motion: MotionSection, line: Timeline) -> RenderPlan:
    duration_s = np.repeat(line.duration_s, line.start_s.shape[1])
    start_s = line.start_s.ravel()
    ends = {"start_s": float(start_s[0]), "end_s": float(start_s[-1] + duration_s[-1])}
    speed = max(
        speed_px_s(scene.rig, scene.T_world_cam, motion, **ends),
        parts_speed_px_s(scene, layout, motion, **ends),
    )
    longest_s = motion.render_px / speed if speed else math.inf
    return plan_renders(start_s, duration_s, longest_s=longest_s)
