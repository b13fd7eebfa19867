"""Search for places where a suction cup holds a part, on a known mesh or on a measured surface.

Grips on a mesh are computed once, in the part's frame; a part's pose moves them to the world.
Without a model, the search follows Mahler et al., "Dex-Net 3.0", ICRA 2018, section V: it samples
places in the mask, scores how reliably the cup seals and holds on the measured surface, and samples
again near the best places (the cross-entropy method). Gaps in the depth are unknown surface, on
which a cup does not seal; so is depth that is probably wrong.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ...base.public_value import public_value
from ...rig.optics import Optics, rays
from ...world.parts import Mesh
from ...world.parts.sampling import spread_points
from .grip import Grip, downs, frame_on
from .patch import STEP_M, patch_of_depth, patch_of_mesh
from .robust import Burden, Doubt, patch_radius_m, robustness
from .suction import Cup

ROUNDS = 3
ELITE_SHARE = 0.25
MOST_P_WRONG = 0.1  # A cup is placed only on depth that is wrong with at most this probability.


def suction_places(
    mesh: Mesh,
    cup: Cup,
    *,
    weight_n: float,
    center_m: Float[np.ndarray, "3"],
    doubt: Doubt,
    count: int = 200,
    seed: int = 0,
) -> list[Grip]:
    """Return grips that are spread over the surface, even those at which the cup does not hold.

    The score of a grip is the minimum of its robustness with the tool upright and with the tool
    leaning by 30 degrees to four sides, because the part's orientation in the bin is unknown here.

    Args:
        center_m: the part's centre of mass, in the part's frame.
        count: number of places that are tried, evenly distributed over the surface.
        seed: seed for the random trials of the robustness.
    """
    points, normals = spread_points(mesh, count)
    places = []
    for point, normal in zip(points, normals, strict=True):
        T_part_tool = frame_on(point, normal)
        patch = patch_of_mesh(mesh, T_part_tool, radius_m=patch_radius_m(cup, doubt), step_m=STEP_M)
        center = T_part_tool[:3, :3].T @ (center_m - point)
        burdens = [Burden(weight_n=weight_n, center_m=center, down=down) for down in downs()]
        score = robustness(cup, patch, burdens, doubt, seed=seed)
        places.append(Grip(T_part_tool=T_part_tool, score=score))
    return places


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class DepthView:
    """The depth [m] that the robot uses (NaN if it is missing), and the pose of the camera.

    `p_wrong` is the probability that a depth is wrong (NaN without depth); None if it is unknown.
    """

    depth_m: Float[np.ndarray, "h w"]
    camera: Optics
    T_world_cam: Float[np.ndarray, "4 4"]
    p_wrong: Float[np.ndarray, "h w"] | None = None

    def sure(self) -> "DepthView":
        """Return the view without depth that is probably wrong, for places of a cup.

        Obstacles are all of `depth_m`, because a surface that may not exist is better avoided.
        """
        if self.p_wrong is None:
            return self
        depth_m = np.where(self.p_wrong > MOST_P_WRONG, np.nan, self.depth_m)
        return replace(self, depth_m=depth_m, p_wrong=None)

    @property
    def down(self) -> Float[np.ndarray, "3"]:
        """Direction of gravity in the camera's frame."""
        return self.T_world_cam[:3, :3].T @ np.array([0.0, 0.0, -1.0])


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class GripEstimate:
    """The pose of a tool in the camera's frame, and the score of the grip at this pose (0 to 1)."""

    T_cam_tool: Float[np.ndarray, "4 4"]
    score: float

    def __post_init__(self) -> None:
        self.T_cam_tool.flags.writeable = False


@public_value
@dataclass(frozen=True, slots=True, kw_only=True)
class SuctionSearch:
    """A search for suction grips on the measured surface, without a model of the part.

    The cup's axis is the normal of a plane that is fitted to the surface under the cup.

    Attributes:
        weight_n: weight of the part that is lifted, in newtons.
        doubt: uncertainties of the grip.
        most_lean_rad: largest angle between the tool's axis and the vertical.
    """

    view: DepthView
    cup: Cup
    weight_n: float
    doubt: Doubt
    most_lean_rad: float = np.radians(45)

    def grips(
        self,
        mask: Bool[np.ndarray, "h w"],
        *,
        one_part: bool = True,
        count: int = 60,
        seed: int = 0,
    ) -> list[GripEstimate]:
        """Return grips within a mask, best first; the list is empty if no grip would hold.

        Args:
            mask: pixels at which the cup's centre may be placed: one part, or the whole bin.
            one_part: whether the mask shows one part, whose centre of mass is then assumed to be
                the mean of the mask's points; otherwise, it is assumed to be under the cup.
            seed: seed for the places and for the random trials.
        """
        view = self.view.sure()
        rng, depth_m = np.random.default_rng(seed), view.depth_m
        rows, columns = np.nonzero(mask & np.isfinite(depth_m))
        if len(rows) == 0:
            return []
        pixel = np.stack([columns, rows], axis=-1).astype(np.float64)
        point = rays(view.camera, pixel) * depth_m[rows, columns, None]
        center = np.broadcast_to(point.mean(axis=0), point.shape) if one_part else point
        estimates: dict[int, GripEstimate | None] = {}
        index = rng.choice(len(point), size=min(count, len(point)), replace=False)
        for _ in range(ROUNDS):
            for i in dict.fromkeys(index.tolist()):
                if i not in estimates:
                    estimates[i] = self._grip(view, point[i], center[i], seed)
            score = {i: grip.score for i, grip in estimates.items() if grip is not None}
            best = sorted(score, key=score.__getitem__, reverse=True)
            best = best[: max(int(ELITE_SHARE * count), 1)]
            if not best:
                index = rng.choice(len(point), size=min(count, len(point)), replace=False)
                continue
            near = pixel[rng.choice(best, size=count)] + rng.normal(size=(count, 2)) * (
                pixel[best].std(axis=0) / 2 + 1
            )
            index = np.array([np.argmin(((pixel - place) ** 2).sum(axis=1)) for place in near])
        holding = [grip for grip in estimates.values() if grip is not None and grip.score > 0]
        return sorted(holding, key=lambda grip: -grip.score)

    def _grip(
        self,
        view: DepthView,
        point: Float[np.ndarray, "3"],
        center: Float[np.ndarray, "3"],
        seed: int,
    ) -> GripEstimate | None:
        """Return a grip at a point; None if the surface is unknown or leans too much there."""
        down = view.down
        normal = _normal(point, view, self.cup.radius_m)
        if normal is None or -normal @ down < np.cos(self.most_lean_rad):
            return None
        T_cam_tool = frame_on(point, normal)
        radius_m = patch_radius_m(self.cup, self.doubt)
        patch = patch_of_depth(
            view.depth_m, view.camera, T_cam_tool, radius_m=radius_m, step_m=STEP_M
        )
        R = T_cam_tool[:3, :3]
        burden = Burden(weight_n=self.weight_n, center_m=R.T @ (center - point), down=R.T @ down)
        score = robustness(self.cup, patch, [burden], self.doubt, seed=seed)
        return GripEstimate(T_cam_tool=T_cam_tool, score=score)


def _normal(
    point: Float[np.ndarray, "3"], view: DepthView, radius_m: float
) -> Float[np.ndarray, "3"] | None:
    """Return the normal of the least-squares plane through the depth within the cup's radius.

    The normal points to the camera. The result is None if fewer than ten points are measured.
    """
    T_cam_eye = frame_on(point, -point / np.linalg.norm(point))
    patch = patch_of_depth(
        view.depth_m, view.camera, T_cam_eye, radius_m=radius_m, step_m=radius_m / 8
    )
    x, y = np.moveaxis(patch.node_m, -1, 0)
    inside = np.isfinite(patch.height_m) & (np.hypot(x, y) <= radius_m)
    if inside.sum() < 10:
        return None
    at = np.stack([x[inside], y[inside], np.ones(inside.sum())], axis=-1)
    slope_x, slope_y, _ = np.linalg.lstsq(at, patch.height_m[inside], rcond=None)[0]
    normal = T_cam_eye[:3, :3] @ np.array([-slope_x, -slope_y, 1.0])
    return normal / np.linalg.norm(normal)
