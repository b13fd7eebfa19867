"""Search for the parameters with which simulated scans have the statistics of real scans.

Light is rendered once for each code, so a trial consists only of exposure, noise, decoding, filters
and faults. All trials have the same noise, so that searches are reproducible. Each candidate code
has its own search: it begins at the best of some start points and continues with damped
Gauss-Newton steps, because the loss is a mean of squares. If the steps end before the code's share
of the trials is used up, new steps begin at the next best start point. The best code gets the
remaining trials.

Sources: K. Levenberg, "A method for the solution of certain non-linear problems in least squares",
1944 (damping); C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations",
1965 (correction of the Jacobian in each step).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from ...base.progress import UNWATCHED, ProgressMeter
from ...camera.scanner import Scanner
from ...rig.pattern import CodeSpec
from ..realism import DepthScan
from ..realism.patches import find_floor
from .parameters import (
    BIN_COLOR,
    BIN_GLOSS,
    BIN_ROUGHNESS,
    Parameter,
    shares_of,
    values_at,
    with_values,
)
from .rows import Figures, Row, compare, figures_of, loss_of, pulls_of
from .stage import BinLook, LitScene, scan_lit

_DARK_LOSS = 1e3  # loss of a scanner that measures no depth
_LEVER = 0.1  # finite difference as a share of a range; shorter steps give mostly noise
_STARTS = 16  # number of start points that are spread over the ranges
# First damping of steps [spreads^2 per range^2]; number of failed steps before the Jacobian is
# computed again; and the shortest step.
_DAMPING, _MOST_FAILED, _LEAST_WAY = 10.0, 4, 1e-3
_LEAST_PIXELS = 1000  # A scan is used if it has more valid pixels.


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """The fitted value of a parameter with its interval of uncertainty (see `reach_of`)."""

    parameter: Parameter
    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Result of a search: scanner, parameters, and statistics before and after the search."""

    scanner: Scanner
    estimates: tuple[Estimate, ...]
    by_code: dict[float | None, float]  # smallest loss for each period [px] of the code
    before: tuple[Row, ...]
    after: tuple[Row, ...]
    trials: int

    @property
    def values(self) -> dict[str, float]:
        """Value of each parameter, by its key."""
        return {one.parameter.key: one.value for one in self.estimates}

    @property
    def loss(self) -> float:
        """Loss of the twin; infinite if its scans have no depth."""
        return loss_of(self.after) if self.after else float("inf")


def search(
    start: Scanner,
    lit: Sequence[LitScene],
    codes: Sequence[CodeSpec],
    parameters: Sequence[Parameter],
    real: Figures,
    *,
    trials: int,
    seed: int,
    progress: ProgressMeter = UNWATCHED,
) -> Fit:
    """Search for the best scanner with about `trials` trials.

    The start points are the scanner `start`, the laser scanner of `PARAMETERS`, and points of a
    Sobol sequence over all ranges.
    """
    run = _Trials(start, lit, parameters, real, seed, trials, progress)
    x0 = shares_of(start, parameters)
    _, before = run.judge(start.named_code(), x0)
    laser = np.array([p.share(p.laser) for p in parameters])
    spread = qmc.Sobol(len(x0), seed=np.random.default_rng(seed)).random(_STARTS)
    each = trials // (len(codes) + 1)  # trials per code
    for number, code in enumerate(codes, start=1):
        for x in run.ranked(code, (x0, laser, *spread)):
            run.descend(code, x, number * each - run.done)
    code = min(codes, key=lambda c: run.best(c)[0])
    for x in (run.best(code)[1], *run.ranked(code, (x0, laser, *spread))):
        run.descend(code, x, trials - run.done)
    x = run.best(code)[1]
    _, after = run.judge(code, x)
    reach = reach_of(run.slopes(code, x)) if after else np.ones(len(x))
    return Fit(
        scanner=replace(with_values(start, parameters, values_at(x, parameters)), code=code),
        estimates=tuple(
            Estimate(
                parameter=p,
                value=p.value(float(at)),
                low=p.value(float(at - width)),
                high=p.value(float(at + width)),
            )
            for p, at, width in zip(parameters, x, reach, strict=True)
        ),
        by_code={c.period_px: run.best(c)[0] for c in codes},
        before=before,
        after=after,
        trials=run.done,
    )


def scans_of(
    lit: Sequence[LitScene], scanner: Scanner, values: dict[str, float], *, seed: int, name: str
) -> Iterator[DepthScan]:
    """Yield the scanner's scans of the scenes, except scans with too little depth."""
    look = BinLook(
        color=values.get(BIN_COLOR, 1.0),
        gloss=values.get(BIN_GLOSS, 1.0),
        rougher=values.get(BIN_ROUGHNESS, 0.0),
    )
    for k, one in enumerate(lit):
        scan = scan_lit(one, scanner, look, seed=seed + k, name=f"{name} {k}")
        if scan is not None and scan.valid.sum() > _LEAST_PIXELS:
            yield scan


def reach_of(slopes: Float[np.ndarray, "rows n"]) -> Float[np.ndarray, " n"]:
    """Return the half-width of each parameter's interval when all parameters are uncertain.

    It is two standard deviations of the marginal posterior distribution. Rows are assumed to be
    linear in the parameters, with normal errors of one spread. The prior of a parameter has the
    variance of a uniform distribution over its range, 1/12. A parameter that changes no row has a
    half-width of `2 sqrt(1/12)`.

    Args:
        slopes: derivative of each row [spreads] by each parameter, in units of its range.
    """
    precision = slopes.T @ slopes + 12 * np.eye(slopes.shape[1])
    return 2 * np.sqrt(np.diag(np.linalg.inv(precision)))


@dataclass
class _Trials:
    """The trials of a search, with a cache of their results and reports of progress."""

    start: Scanner
    lit: Sequence[LitScene]
    parameters: Sequence[Parameter]
    real: Figures
    seed: int
    total: int
    progress: ProgressMeter

    def __post_init__(self) -> None:
        # All trials have the same noise, so a point is never tried twice.
        self.tried: dict[CodeSpec, dict[bytes, tuple[float, tuple[Row, ...]]]] = {}
        self.floor = find_floor([one.truth.depth_m for one in self.lit])

    @property
    def done(self) -> int:
        """Number of trials made so far."""
        return sum(len(places) for places in self.tried.values())

    def rows(self, code: CodeSpec, x: Float[np.ndarray, " n"]) -> tuple[Row, ...]:
        """Return the rows at a point x; no rows if no scan has enough depth."""
        values = values_at(x, self.parameters)
        scanner = replace(with_values(self.start, self.parameters, values), code=code)
        scans = scans_of(self.lit, scanner, values, seed=self.seed, name="twin")
        figures = figures_of(scans, self.floor, self.real.places)
        return compare(self.real, figures) if figures.scans else ()

    def judge(self, code: CodeSpec, x: Float[np.ndarray, " n"]) -> tuple[float, tuple[Row, ...]]:
        """Return loss and rows of a trial, which is made unless the cache has its result."""
        tried = self.tried.setdefault(code, {})
        if x.tobytes() not in tried:
            rows = self.rows(code, x)
            tried[x.tobytes()] = (loss_of(rows) if rows else _DARK_LOSS), rows
            least = min(self.best(c)[0] for c in self.tried if self.tried[c])
            self.progress.stage(f"lowest misfit {least:.2f}")
            self.progress.count("trials", self.done, max(self.done, self.total))
        return tried[x.tobytes()]

    def best(self, code: CodeSpec) -> tuple[float, Float[np.ndarray, " n"]]:
        """Return the lowest loss of a code's trials, and the point of that trial."""
        tried = self.tried[code]
        at = min(tried, key=lambda place: tried[place][0])
        return tried[at][0], np.frombuffer(at)

    def ranked(
        self, code: CodeSpec, starts: Sequence[Float[np.ndarray, " n"]]
    ) -> list[Float[np.ndarray, " n"]]:
        """Return start points sorted by their losses, lowest first."""
        return sorted(starts, key=lambda x: self.judge(code, x)[0])

    def pulls(self, code: CodeSpec, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " rows"]:
        """Return the residuals of the least-squares problem: the deviation of each row."""
        _, rows = self.judge(code, x)
        known = sum(bool(np.isfinite(value).any()) for value in self.real.value.values())
        return pulls_of(rows) if rows else np.full(known, np.sqrt(_DARK_LOSS))

    def slopes(self, code: CodeSpec, x: Float[np.ndarray, " n"]) -> Float[np.ndarray, "rows n"]:
        """Return the Jacobian of the residuals by finite differences: a trial per parameter."""
        here, columns = self.pulls(code, x), []
        for i, share in enumerate(x):
            lever = _LEVER if share + _LEVER <= 1 else -_LEVER
            moved = x.copy()
            moved[i] += lever
            columns.append((self.pulls(code, moved) - here) / lever)
        return np.stack(columns, axis=1)

    def descend(self, code: CodeSpec, x: Float[np.ndarray, " n"], trials: int) -> None:
        """Take steps from a point until `trials` are used up or no step improves the loss.

        A Jacobian costs one trial per parameter, so each step only corrects it (Broyden). After
        some successive steps without improvement, it is computed again.
        """
        last = self.done + trials
        while self.done + len(x) < last:
            begin, here, slopes = x, self.pulls(code, x), self.slopes(code, x)
            damping, failed = _DAMPING, 0
            while failed < _MOST_FAILED and self.done < last:
                normal = slopes.T @ slopes + damping * np.eye(len(x))
                moved = np.clip(x - np.linalg.solve(normal, slopes.T @ here), 0.0, 1.0)
                way = moved - x
                if np.linalg.norm(way) < _LEAST_WAY:
                    break
                there = self.pulls(code, moved)
                slopes += np.outer(there - here - slopes @ way, way) / (way @ way)
                if (there**2).sum() < (here**2).sum():
                    x, here, damping, failed = moved, there, damping / 3, 0
                else:
                    damping, failed = 4 * damping, failed + 1
            if x is begin:
                return
