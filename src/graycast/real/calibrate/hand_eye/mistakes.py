"""Mistakes of hand-eye calibrations, named with their remedies, and turns of symmetric boards."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from ....base.frames import inverse, rigid
from ..board import Board, CalibrationError
from .fitting import USUAL, Views, first_guess, refined, residuals, weights_of

MIN_VIEWS = 4
LEAST_TURN_RAD = np.radians(3.0)  # A smaller RMS rotation about an axis determines nothing.
BETTER = 3.0  # A mistake is named if the poses fit better without it by this factor.
FLOOR_M = 1e-6  # Smaller misfits count as equal.
MOVED = 2.0  # Two places of the board must reduce the RMS residual by this factor.
CHANCE = 1e-4  # Probability that noise alone looks like a moved board.
Fitted = tuple[Views, Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"], Float[np.ndarray, " n"]]


def refuse_one_axis(views: Views) -> None:
    """Refuse poses that turn the tool about fewer than two axes.

    Raises:
        CalibrationError: the text names the axis, and the number that the poses do not determine.
    """
    R = views.T_base_tool[:, :3, :3]
    mean = Rotation.from_matrix(R).mean().as_matrix()
    in_tool = views.mount == "in-hand"
    turn = Rotation.from_matrix(mean.T @ R if in_tool else R @ mean.T).as_rotvec()
    _, size, axes = np.linalg.svd(turn / np.sqrt(len(turn)))
    frame, camera = ("tool", "T_tool_cam") if in_tool else ("base", "T_base_cam")
    if size[0] < LEAST_TURN_RAD:
        raise CalibrationError(
            f"the tool has the same orientation in all poses (within {np.degrees(size[0]):.1f} "
            f"degrees), so {camera} is not observable: turn the tool by 20 to 40 degrees about two "
            "axes"
        )
    if size[1] < LEAST_TURN_RAD:
        axis = axes[0] * np.sign(axes[0][np.abs(axes[0]).argmax()])
        text = ", ".join(f"{value:.2f}" for value in axis + 0.0)
        raise CalibrationError(
            f"all poses turn the tool about one axis only, ({text}) in the frame of the {frame} "
            f"(nearest: {'xyz'[np.abs(axis).argmax()]}), so the position of {camera} along that "
            "axis is not observable: turn the tool by 20 to 40 degrees about a second axis, too"
        )


def board_turns(board: Board) -> Float[np.ndarray, "k 4 4"]:
    """Return the turns of a board after which its corners look the same, the identity first.

    Chessboards are turned by half, and square ones by a quarter, because detectors may begin at
    another corner in each picture. Markers exclude this.
    """
    if board.marker_m is not None:
        return np.eye(4)[None]
    middle_m = board.corners_m.mean(axis=0)
    step = 1 if board.squares_x == board.squares_y else 2
    turns = []
    for quarters in range(0, 4, step):
        R = Rotation.from_rotvec([0, 0, quarters * np.pi / 2]).as_matrix()
        turns.append(rigid(np.rint(R), middle_m - np.rint(R) @ middle_m))
    return np.array(turns)


def fit_turns(views: Views, turns: Float[np.ndarray, "k 4 4"]) -> Fitted:
    """Choose a turn of the board in each view; return the views, both poses and the misfits [m].

    The angle between two views must be that between two poses of the tool, which gives the first
    choice. Then the turn with the least misfit is chosen, until no view changes.
    """
    best = None
    for reference in range(1 if len(turns) == 1 else min(len(views.names), 3)):
        every = [views.turned(np.broadcast_to(T, views.T_p_q.shape)) for T in turns]
        wanted = _angle(inverse(views.T_base_tool[reference]) @ views.T_base_tool)
        own = views.T_p_q[reference]
        cost = np.array([np.abs(_angle(inverse(own) @ v.T_p_q) - wanted) for v in every])
        for _ in range(1 if len(turns) == 1 else 5):
            choice = cost.argmin(axis=0)
            current = views.turned(turns[choice])
            X, Y = _quick(current)
            cost = np.array([_misfit_m(v, X, Y) for v in every])
            if (cost.argmin(axis=0) == choice).all():
                break
        fitted = (current, X, Y, _misfit_m(current, X, Y))
        if best is None or np.median(fitted[3]) < np.median(best[3]):
            best = fitted
    assert best is not None
    return best


def _angle(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, " n"]:
    return Rotation.from_matrix(T[:, :3, :3]).magnitude()


def _quick(views: Views):
    """Return the poses of camera and board by a fit with the usual scatter of robots."""
    X, Y = first_guess(views)
    X, (Y,) = refined(views, X, Y[None], weights_of(views, X, Y, USUAL))
    return X, Y


def _misfit_m(views: Views, X, Y) -> Float[np.ndarray, " n"]:
    """Return the misfit [m] of each view at the tool, with its turn at the board's distance."""
    e = residuals(views, X, Y)
    distance_m = np.median(np.linalg.norm(views.T_p_q[:, :3, 3], axis=1))
    return np.hypot(np.linalg.norm(e[:, 3:], axis=1), distance_m * np.linalg.norm(e[:, :3], axis=1))


def refuse_mistakes(
    views: Views,
    fitted: Fitted,
    turns: Float[np.ndarray, "k 4 4"],
    readings: Mapping[str, Float[np.ndarray, "n 4 4"]],
) -> None:
    """Refuse poses that fit far better after a usual mistake is undone.

    Args:
        readings: the poses under other conventions (see `RobotPoses`).

    Raises:
        CalibrationError: the text names the mistake and its remedy.
    """
    before_m = max(float(np.median(fitted[3])), FLOOR_M)
    best_m, best_text = before_m, ""
    for text, T_base_tool in _without_mistakes(views, readings):
        other = fit_turns(replace(views, T_base_tool=T_base_tool), turns)
        misfit_m = max(float(np.median(other[3])), FLOOR_M)
        if misfit_m < best_m:
            best_m, best_text = misfit_m, text
    if best_m * BETTER < before_m:
        raise CalibrationError(
            f"{best_text} (the misfit falls from {1e3 * before_m:.3g} to {1e3 * best_m:.3g} mm)"
        )
    _refuse_moved_board(fitted)


def _without_mistakes(views: Views, readings) -> Iterator[tuple[str, Float[np.ndarray, "n 4 4"]]]:
    """Yield each mistake with its remedy, and the poses after it is undone."""
    T = views.T_base_tool
    n = len(T)
    for shift in range(1, n):
        yield (
            f"the poses are in another order than the scans: with pose {shift + 1} for the first "
            "scan and so on, they fit; name the scan of each pose, or correct the order",
            np.roll(T, -shift, axis=0),
        )
    yield (
        "the poses are in another order than the scans: in reverse order, they fit; name the scan "
        "of each pose, or reverse the file",
        T[::-1],
    )
    other = "to-hand" if views.mount == "in-hand" else "in-hand"
    yield (
        "the poses are inverted: they fit as T_tool_base; write T_base_tool, which is the inverse "
        f"of each pose, or give --mount {other} if the scanner is mounted that way",
        inverse(T),
    )
    for name, reading in readings.items():
        yield f"the poses fit if {name}: correct the columns of the file", reading
    for factor, unit, remedy in (
        (1e-3, "millimetres for metres", "divide them by 1000, or state the unit mm"),
        (1e3, "metres for millimetres", "state the unit m"),
    ):
        scaled = T.copy()
        scaled[:, :3, 3] *= factor
        yield f"the positions of the poses are {unit}: {remedy}", scaled


def _refuse_moved_board(fitted: Fitted) -> None:
    """Refuse views in which the board has two places, one after the other."""
    views, X, Y, _ = fitted
    n = len(views.names)
    weights = weights_of(views, X, Y, USUAL)
    ours = _squares(views, weights, residuals(views, X, Y))
    best, at = ours, 0
    for split in range(2, n - 1):
        group = (np.arange(n) >= split).astype(np.intp)
        camera, boards = refined(views, X, np.array([Y, Y]), weights, group)
        squares = _squares(views, weights, residuals(views, camera, boards[group]))
        if squares < best:
            best, at, places = squares, split, boards
    rest = 6 * n - 18
    if rest <= 0 or best * MOVED**2 > ours:
        return
    ratio = (ours - best) / 6 / (max(best, 1e-12) / rest)
    if f_distribution.sf(ratio, 6, rest) * n < CHANCE:
        step_m = np.linalg.norm(places[1][:3, 3] - places[0][:3, 3])
        raise CalibrationError(
            f"the board or the scanner moved between the scans {views.names[at - 1]} and "
            f"{views.names[at]}: with a second place of the board, {1e3 * step_m:.1f} mm away, the "
            f"residuals are {np.sqrt(ours / best):.1f} times smaller; fix both, and scan again"
        )


def _squares(views: Views, weights, e) -> float:
    return float(np.einsum("ni,nij,nj->", e, weights, e))
