"""Calibration boards (chessboards and ChArUco boards), and their description as text."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from ...base.errors import GraycastError

MIN_SQUARES = 3  # A homography needs 4 points; 3 x 3 squares have 4 inner corners.
FORMS = (
    "chessboard:9x6:0.025 (squares in x and y, side of a square in m) or "
    "charuco:8x5:0.03:0.022:DICT_5X5_100 (then side of a marker in m, ArUco dictionary; :legacy at "
    "the end for the layout of OpenCV before 4.6)"
)


class CalibrationError(GraycastError):
    """Failure of a calibration; the text says which pictures are unusable and why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A flat board of `squares_x` by `squares_y` squares, with or without ArUco markers.

    Board frame: origin at the outer corner of the first square, x along a row of squares,
    y along a column, z into the board (away from its printed side). A board of 9 x 6 squares has
    8 x 5 inner corners. `legacy` means the ChArUco layout of OpenCV before 4.6, which differs if
    `squares_y` is even.

    Leaves out: a bent board or a wrong scale of the print, which cause errors of the calibration.
    """

    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float | None = None
    dictionary: str | None = None
    legacy: bool = False

    def __post_init__(self) -> None:
        if min(self.squares_x, self.squares_y) < MIN_SQUARES:
            size = f"{self.squares_x} x {self.squares_y}"
            raise ValueError(
                f"the board has {size} squares; give at least {MIN_SQUARES} in each direction"
            )
        if not 0.0005 <= self.square_m <= 2:
            raise ValueError(f"square_m is {self.square_m}; give 0.0005 to 2 metres")
        if (self.marker_m is None) != (self.dictionary is None):
            raise ValueError("a ChArUco board needs both marker_m and dictionary")
        if self.marker_m is not None and not 0 < self.marker_m < self.square_m:
            sizes = f"marker_m is {self.marker_m}, square_m {self.square_m}"
            raise ValueError(f"{sizes}; a marker must be smaller than its square")
        if self.dictionary is not None:
            self._check_dictionary(self.dictionary)

    def _check_dictionary(self, name: str) -> None:
        if name not in dictionaries():
            raise ValueError(f"no ArUco dictionary {name!r}: choose {', '.join(dictionaries())}")
        most = len(_dictionary(name).bytesList)
        needed = self.squares_x * self.squares_y // 2
        if needed > most:
            raise ValueError(
                f"the board needs {needed} markers, {name} has {most}: choose a larger dictionary"
            )

    @property
    def corner_count(self) -> int:
        return (self.squares_x - 1) * (self.squares_y - 1)

    @property
    def corners_m(self) -> Float[np.ndarray, "corners 3"]:
        """Inner corners in the board frame, row by row; the index is the id of a corner."""
        x, y = np.meshgrid(np.arange(1, self.squares_x), np.arange(1, self.squares_y))
        grid = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
        return self.square_m * grid

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """Return the same board as OpenCV's object, which can draw and detect it."""
        if self.marker_m is None or self.dictionary is None:
            raise ValueError("this board is a chessboard: it has no markers")
        board = cv2.aruco.CharucoBoard(
            (self.squares_x, self.squares_y),
            self.square_m,
            self.marker_m,
            _dictionary(self.dictionary),
        )
        board.setLegacyPattern(self.legacy)
        return board


def parse_board(text: str) -> Board:
    """Parse the text of `--board`; the text of a ChArUco board may end in `:legacy`.

    Raises:
        ValueError: the text does not describe a board; the message shows the two forms.
    """
    kind, *fields = text.strip().split(":")
    legacy = kind == "charuco" and fields[-1:] == ["legacy"]
    if legacy:
        fields.pop()
    if (kind, len(fields)) not in (("chessboard", 2), ("charuco", 4)):
        raise ValueError(f"board is {text!r}; give {FORMS}")
    try:
        squares_x, squares_y = (int(count) for count in fields[0].lower().split("x"))
        lengths_m = [float(length) for length in fields[1:3]]
    except ValueError:
        raise ValueError(f"board is {text!r}; give {FORMS}") from None
    return Board(
        squares_x=squares_x,
        squares_y=squares_y,
        square_m=lengths_m[0],
        marker_m=lengths_m[1] if kind == "charuco" else None,
        dictionary=fields[3] if kind == "charuco" else None,
        legacy=legacy,
    )


def dictionaries() -> tuple[str, ...]:
    """Return the names of the ArUco dictionaries in the installed OpenCV."""
    return tuple(name for name in dir(cv2.aruco) if name.startswith("DICT_"))


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
