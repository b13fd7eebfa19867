"""Where a suction cup holds what a scanner saw, with no model of the part.

After Mahler et al., "Dex-Net 3.0", ICRA 2018, section V: places are drawn in the mask, judged by
how surely the cup seals and holds on the measured surface, and drawn again about the best ones (the
cross-entropy method). Holes in the depth are unknown ground, on which no cup is taken to seal.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...rig.optics import Optics, rays
from .grip import frame_on
from .patch import STEP_M, patch_of_depth
from .robust import Burden, Doubt, patch_radius_m, robustness
from .suction import Cup

ROUNDS = 3
ELITE_SHARE = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class GripEstimate:
    """Where a tool goes, in the camera's frame, and how sure it is to hold there (0 to 1)."""

    T_cam_tool: Float[np.ndarray, "4 4"]
    score: float

    def __post_init__(self) -> None:
        self.T_cam_tool.flags.writeable = False


def suction_in_depth(
    depth_m: Float[np.ndarray, "h w"],
    camera: Optics,
    mask: Bool[np.ndarray, "h w"],
    cup: Cup,
    *,
    down: Float[np.ndarray, "3"],
    weight_n: float,
    doubt: Doubt,
    one_part: bool = True,
    most_lean_rad: float = np.radians(45),
    count: int = 60,
    seed: int = 0,
) -> list[GripEstimate]:
    """Grips on the measured surface within a mask, best first; none where nothing would hold.

    The cup stands along the normal of the plane through what lies under it. What is lifted is taken
    to weigh `weight_n`.

    Args:
        depth_m: z of each pixel, NaN where it is missing.
        camera: its optics.
        mask: where the cup's middle may go: one part, or the whole bin.
        cup: the tool.
        down: which way weights pull, in the camera's frame.
        weight_n: of a part.
        doubt: what is not known.
        one_part: whether the mask is of one part: then its centre of mass is taken to be in the
            middle of the mask's points, else under the cup, wherever that is.
        most_lean_rad: between the tool's axis and the vertical.
        count: places in each of three rounds.
        seed: of places and doubts.
    """
    rng = np.random.default_rng(seed)
    rows, columns = np.nonzero(mask & np.isfinite(depth_m))
    if len(rows) == 0:
        return []
    pixel = np.stack([columns, rows], axis=-1).astype(np.float64)
    point = rays(camera, pixel) * depth_m[rows, columns, None]
    center = np.broadcast_to(point.mean(axis=0), point.shape) if one_part else point
    judge = _Judge(
        depth_m=depth_m,
        camera=camera,
        cup=cup,
        down=down,
        weight_n=weight_n,
        doubt=doubt,
        most_lean_rad=most_lean_rad,
        seed=seed,
    )
    estimates: dict[int, GripEstimate | None] = {}
    chosen = rng.choice(len(point), size=min(count, len(point)), replace=False)
    for _ in range(ROUNDS):
        for i in dict.fromkeys(chosen.tolist()):
            if i not in estimates:
                estimates[i] = judge.grip(point[i], center[i])
        score = {i: grip.score for i, grip in estimates.items() if grip is not None}
        best = sorted(score, key=score.__getitem__, reverse=True)
        best = best[: max(int(ELITE_SHARE * count), 1)]
        if not best:
            chosen = rng.choice(len(point), size=min(count, len(point)), replace=False)
            continue
        near = pixel[rng.choice(best, size=count)] + rng.normal(size=(count, 2)) * (
            pixel[best].std(axis=0) / 2 + 1
        )
        chosen = np.array([np.argmin(((pixel - place) ** 2).sum(axis=1)) for place in near])
    found = [grip for grip in estimates.values() if grip is not None and grip.score > 0]
    return sorted(found, key=lambda grip: -grip.score)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Judge:
    """All that is the same for every place; fields as in `suction_in_depth`."""

    depth_m: Float[np.ndarray, "h w"]
    camera: Optics
    cup: Cup
    down: Float[np.ndarray, "3"]
    weight_n: float
    doubt: Doubt
    most_lean_rad: float
    seed: int

    def grip(
        self, point: Float[np.ndarray, "3"], center: Float[np.ndarray, "3"]
    ) -> GripEstimate | None:
        """A grip on a point, along the normal there; None where the cup cannot stand."""
        normal = _normal(point, self.depth_m, self.camera, self.cup.radius_m)
        if normal is None or -normal @ self.down < np.cos(self.most_lean_rad):
            return None
        T_cam_tool = frame_on(point, normal)
        patch = patch_of_depth(
            self.depth_m,
            self.camera,
            T_cam_tool,
            radius_m=patch_radius_m(self.cup, self.doubt),
            step_m=STEP_M,
        )
        R = T_cam_tool[:3, :3]
        burden = Burden(
            weight_n=self.weight_n, center_m=R.T @ (center - point), down=R.T @ self.down
        )
        score = robustness(self.cup, patch, [burden], self.doubt, seed=self.seed)
        return GripEstimate(T_cam_tool=T_cam_tool, score=score)


def _normal(
    point: Float[np.ndarray, "3"],
    depth_m: Float[np.ndarray, "h w"],
    camera: Optics,
    radius_m: float,
) -> Float[np.ndarray, "3"] | None:
    """Of the plane of least squares through what is measured within the cup's radius.

    It looks at the camera. None where fewer than ten points lie there.
    """
    T_cam_eye = frame_on(point, -point / np.linalg.norm(point))
    patch = patch_of_depth(depth_m, camera, T_cam_eye, radius_m=radius_m, step_m=radius_m / 8)
    x, y = np.moveaxis(patch.node_m, -1, 0)
    inside = np.isfinite(patch.height_m) & (np.hypot(x, y) <= radius_m)
    if inside.sum() < 10:
        return None
    at = np.stack([x[inside], y[inside], np.ones(inside.sum())], axis=-1)
    slope_x, slope_y, _ = np.linalg.lstsq(at, patch.height_m[inside], rcond=None)[0]
    normal = T_cam_eye[:3, :3] @ np.array([-slope_x, -slope_y, 1.0])
    return normal / np.linalg.norm(normal)
