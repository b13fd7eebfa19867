"""Measurement of a board's corners in its views, and exclusion of views that fit no rig."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from ...camera.stack import decode_stack, mirror_symptom
from .adjust import NO_FIT, Observations, joined, poses_between, rms_alone_px
from .board import Board, CalibrationError
from .corners import MIN_CORNERS, find_corners, projector_corners

MIN_VIEWS = 3  # Fewer board directions do not determine the intrinsics.
GOOD_VIEWS = 8
SAME_POSE = 0.005  # Views show one pose if corners differ by less than this share of their spread.
GROSS, GROSS_PX = 6.0, 2.0  # A corner is wrong above both limits: times the view's median, and px.
MOST_RMS = 0.005  # largest residual of a device, in widths of its picture
GOOD_RMS_PX, SPOILING = 0.5, 3.0  # good RMS; least factor by which a bad view raises the RMS
MINORITY = 1 / 3  # A larger share of views is never left out, because it may be right.
# A view's projector pose is wrong if its difference exceeds both ELSEWHERE times the median and a
# minimum: noise turns it by up to 1.3 degrees. `fit_agreeing` detects smaller differences.
ELSEWHERE, TURN_DEG, SHIFT = 4.0, 2.0, 0.15  # The shift is a share of the baseline.


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardView:
    """One pose of the board: its picture under white light and the decoded projector pixels.

    `column` and `row` are in projector pixels, NaN where unknown. `symptoms` are the warnings from
    decoding the stack.
    """

    name: str
    white: Shaped[np.ndarray, "h w"]
    column: Float[np.ndarray, "h w"]
    row: Float[np.ndarray, "h w"]
    sigma_column: Float[np.ndarray, "h w"] | None = None
    sigma_row: Float[np.ndarray, "h w"] | None = None
    symptoms: tuple[str, ...] = ()


def read_view(path: Path) -> tuple[BoardView, tuple[int, int]]:
    """Decode a stack that shows one pose of the board; return also the projector's size [px].

    The picture of the board is the white frame, or the brighter of a bit and its inverse.

    Raises:
        ConfigError, DecodeError: the stack cannot be used; see `decode_stack`.
    """
    result = decode_stack(path)
    codes = result.codes
    view = BoardView(
        name=str(path),
        white=result.picture.mean(axis=2).astype(np.uint8),
        column=codes.column,
        row=codes.row,
        sigma_column=codes.sigma_column,
        sigma_row=codes.sigma_row,
        symptoms=result.warnings,
    )
    return view, (result.code.width_px, result.code.height_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewCorners:
    """The decoded corners of one view, and the number of corners that are not decoded."""

    name: str
    corners: Observations
    undecoded: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """The views that can belong to one rig, and the reasons why other views are left out."""

    views: tuple[ViewCorners, ...]
    left_out: Mapping[str, str]

    @property
    def corners(self) -> Observations:
        """The corners of all views, with views numbered in order."""
        return _joined(self.views)

    def less(self, faults: Mapping[str, str]) -> "Observed":
        """Return the views without faults, and add the faults to `left_out`.

        Raises:
            CalibrationError: too few views remain; the text names all views that are left out.
        """
        good = tuple(view for view in self.views if view.name not in faults)
        left_out = {**self.left_out, **faults}
        if len(good) < MIN_VIEWS:
            reasons = "; ".join(f"{views}: {why}" for views, why in grouped(left_out))
            raise CalibrationError(
                f"of {len(good) + len(left_out)} views of the board {len(good)} can be used, and "
                f"at least {MIN_VIEWS} in different directions are needed: {reasons}"
            )
        return Observed(views=good, left_out=left_out)


def _joined(views: Sequence[ViewCorners]) -> Observations:
    parts = [view.corners for view in views]
    return joined([replace(part, view=np.full(len(part.view), k)) for k, part in enumerate(parts)])


def check_views(views: Sequence[BoardView]) -> tuple[int, int]:
    """Return the camera's (width, height) [px]; refuse too few views and views of unequal size."""
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"{len(views)} views of the board; at least {MIN_VIEWS} in different directions are "
            f"needed, {GOOD_VIEWS} or more are good"
        )
    names = [view.name for view in views]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise CalibrationError(f"two views are named {', '.join(twice)}: rename one of them")
    size = views[0].white.shape
    for view in views:
        for part in (view.white, view.column, view.row):
            if part.shape != size:
                raise CalibrationError(
                    f"view {view.name} is {part.shape[1]} x {part.shape[0]} px, view "
                    f"{views[0].name} {size[1]} x {size[0]}: give pictures of one camera with one "
                    "size"
                )
    return size[1], size[0]


def observe(
    views: Sequence[BoardView],
    board: Board,
    *,
    camera_size_px: tuple[int, int],
    projector_size_px: tuple[int, int],
) -> Observed:
    """Return the corners that both devices see, in the views that can belong to one rig.

    Raises:
        CalibrationError: there are too few such views.
    """
    good: list[ViewCorners] = []
    faults = {}
    for view in views:
        try:
            one = _observe_one(view, board, projector_size_px)
            _refuse_same_pose(one, good)
        except CalibrationError as error:  # One error reports the faults of all bad views.
            faults[view.name] = str(error)
        else:
            good.append(one)
    observed = Observed(views=tuple(good), left_out={}).less(faults)
    return agreeing(observed, camera_size_px, projector_size_px)


def agreeing(
    observed: Observed, camera_size_px: tuple[int, int], projector_size_px: tuple[int, int]
) -> Observed:
    """Return the views that agree on both lenses and on the pose between the devices.

    First, each device is calibrated alone, and views are left out that do not fit one lens together
    with the other views. Then the projector's pose from each view must agree with most others.

    Raises:
        CalibrationError: too few views agree.
    """
    while misfit := _misfit(observed, camera_size_px, projector_size_px):
        observed = observed.less(misfit)
    return observed.less(_elsewhere(observed, camera_size_px, projector_size_px))


def grouped(sentences: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Group views whose sentences differ only in numbers; yield their names and one sentence."""
    views: dict[str, list[str]] = {}
    for name, sentence in sentences.items():
        views.setdefault(re.sub(r"\d+", "", sentence), []).append(name)
    for names in views.values():
        yield f"view{'s' * (len(names) > 1)} {', '.join(names)}", sentences[names[0]]


def _observe_one(view: BoardView, board: Board, projector_size_px: tuple[int, int]) -> ViewCorners:
    mirrored = mirror_symptom(view.column, view.row)
    if mirrored is not None:
        raise CalibrationError(mirrored)
    corners = find_corners(view.white, board)
    lit_px, per_camera_px = projector_corners(
        corners,
        view.column,
        view.row,
        sigma_column=view.sigma_column,
        sigma_row=view.sigma_row,
    )
    decoded = np.isfinite(lit_px).all(axis=1)
    if decoded.sum() < MIN_CORNERS:
        raise CalibrationError(
            f"{decoded.sum()} of {len(decoded)} corners have decoded columns and rows around "
            f"them, {MIN_CORNERS} are needed: light the board with the projector, and code both "
            f"axes{''.join(f' ({symptom})' for symptom in view.symptoms)}"
        )
    position_px = lit_px[decoded]
    # The fit may extrapolate, so a corner may be slightly outside the projector's picture.
    if position_px.min() < -2 or (position_px > np.array(projector_size_px) + 1).any():
        span = f"({position_px[:, 0].max():.0f}, {position_px[:, 1].max():.0f})"
        size = f"{projector_size_px[0]} x {projector_size_px[1]}"
        raise CalibrationError(
            f"code reaches {span}, the projector has {size} px: give the right projector size"
        )
    part = Observations(
        view=np.zeros(decoded.sum(), dtype=np.intp),
        point_m=board.corners_m[corners.id[decoded]],
        camera_px=corners.position_px[decoded],
        projector_px=position_px,
        per_camera_px=per_camera_px[decoded],
    )
    return ViewCorners(name=view.name, corners=part, undecoded=int((~decoded).sum()))


def _refuse_same_pose(view: ViewCorners, others: Sequence[ViewCorners]) -> None:
    own = view.corners
    radius_px = own.camera_px.std(axis=0).max()
    for other in others:
        its = other.corners
        mine, same = np.nonzero((own.point_m[:, None] == its.point_m).all(axis=2))
        apart_px = np.linalg.norm(own.camera_px[mine] - its.camera_px[same], axis=1)
        if len(mine) and np.median(apart_px) < SAME_POSE * radius_px:
            raise CalibrationError(
                f"it shows the board in the same pose as view {other.name}: move the board between "
                "two views"
            )


def _less_gross(corners: Observations) -> Observations:
    """Return the corners without gross errors; a view with such an error may have good corners."""
    keep = np.ones(len(corners.view), dtype=bool)
    for k in np.unique(corners.view):
        mine = corners.view == k
        camera_px, projector_px = corners.camera_px[mine], corners.projector_px[mine]
        H, _ = cv2.findHomography(camera_px, projector_px, cv2.LMEDS)
        if H is not None:  # GROSS_PX allows for distortion, which a homography does not model.
            at = np.column_stack([camera_px, np.ones(len(camera_px))]) @ H.T
            off_px = np.linalg.norm(at[:, :2] / at[:, 2:] - projector_px, axis=1)
            keep[mine] = off_px <= max(GROSS * float(np.median(off_px)), GROSS_PX)
    return corners.only(keep)


def _misfit(
    observed: Observed, camera_size_px: tuple[int, int], projector_size_px: tuple[int, int]
) -> dict[str, str]:
    """Return the view without which the other views fit one lens far better, and the reason."""
    corners = _less_gross(observed.corners)
    for device, size_px in (("camera", camera_size_px), ("projector", projector_size_px)):
        whole_px = rms_alone_px(corners, getattr(corners, f"{device}_px"), size_px)
        if whole_px < GOOD_RMS_PX:
            continue
        without_px = []
        for view in observed.views:
            rest = _less_gross(_joined([v for v in observed.views if v is not view]))
            without_px.append(rms_alone_px(rest, getattr(rest, f"{device}_px"), size_px))
        worst = int(np.argmin(without_px))
        if len(observed.views) > MIN_VIEWS and without_px[worst] < whole_px / SPOILING:
            return {
                observed.views[worst].name: f"the {device}'s corners fit one lens within "
                f"{without_px[worst]:.2f} px without it and {whole_px:.2f} px with it (RMS): the "
                "board or a device may have moved, or its code may be wrong"
            }
        if whole_px > MOST_RMS * size_px[0]:
            raise CalibrationError(
                f"the {device}'s corners fit no lens: the residual is {whole_px:.3g} px (RMS). "
                f"{NO_FIT[0].upper()}{NO_FIT[1:]}"
            )
    return {}


def _elsewhere(
    observed: Observed, camera_size_px: tuple[int, int], projector_size_px: tuple[int, int]
) -> dict[str, str]:
    """Return the views whose projector pose differs from that of most views, with reasons.

    Only a minority is returned: if more views differ, `fit_agreeing` compares groups of views.
    """
    T = poses_between(_less_gross(observed.corners), camera_size_px, projector_size_px)
    between = np.einsum("aji,bjk->abik", T[:, :3, :3], T[:, :3, :3])
    cosine = (np.trace(between, axis1=2, axis2=3) - 1) / 2
    turn_deg = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    usual = int(np.median(turn_deg, axis=1).argmin())
    shift_m = np.linalg.norm(T[:, :3, 3] - T[usual, :3, 3], axis=1)
    least_m = SHIFT * np.linalg.norm(T[usual, :3, 3])
    away = turn_deg[usual] > _far(np.delete(turn_deg[usual], usual), TURN_DEG)
    away |= shift_m > _far(np.delete(shift_m, usual), float(least_m))
    if away.sum() > MINORITY * len(away):
        return {}
    there = observed.views[usual].name
    return {
        view.name: f"its board puts the projector {1e3 * shift_m[k]:.0f} mm and "
        f"{turn_deg[usual, k]:.1f} degrees from where view {there} has it: its pictures may be "
        "turned, or a device may have moved"
        for k, view in enumerate(observed.views)
        if away[k]
    }


def _far(usual: Float[np.ndarray, " n"], least: float) -> float:
    return max(ELSEWHERE * float(np.median(usual)), least)
