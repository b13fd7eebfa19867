"""The search: which values make a cell's simulated scans have the real scans' statistics.

Light is rendered once for each code, so a trial is exposure, noise, decoding, filters and faults
alone. The noise is the same in every trial, so that the same search takes the same way. It has two
starts: the configured scanner, whose noise is mostly that of the light and of which each parameter
is first tried alone, to find what is far off; and the same with noise of the surface, as a real
laser scanner has it. A code is no number, and neither is a kind of noise: each pair of them has a
few damped Gauss-Newton steps, as the loss is a sum of squares. The better pair of each code goes on
by more such steps, the best of these by all that are left, and when they end, by a walk about their
end (covariance matrix adaptation). What is far worse than the best of its kind is given up: a start
at once, a code after its first steps.

Source: Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772.
"""

import contextlib
import importlib.util
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import GraycastError
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
    with_noise_of_surface,
    with_values,
)
from .rows import Figures, Places, Row, compare, figures_of, loss_of, pulls_of
from .stage import BinLook, Lit, scan_lit

_NEAR = 0.05  # first steps of a walk, as a share of the way between the bounds
_HEAT, _FINAL = 0.04, 0.1  # shares of the trials, for each pair and for the better one of a code
_HOPELESS = 2.0  # times the least loss of a code's starts, or of all codes: what is above it ends
_DARK_LOSS = 1e3  # of a scanner that sees nothing
_FIRST_LOOK = (0.0, 0.5, 1.0)  # shares at which a parameter is tried alone before the search
_PROFILE = np.linspace(0.0, 1.0, 5)  # shares at which a parameter is tried alone, beside the best
_LEVER = 0.1  # as a share: a slope over less is mostly noise
# Of damped steps: the last lever, the first damping [spreads^2 per range^2], how many steps may
# fail before slopes are taken anew, and the shortest way.
_LEAST_LEVER, _DAMPING, _MOST_FAILED, _LEAST_WAY = 0.02, 10.0, 4, 1e-3
_FITS = 2.0  # times the scanner's own loss
_AGAIN = 3  # times the number of parameters: trials at an end of an interval
_DECIDED = 0.5  # as a share of its range: a parameter held worse than this is not decided

_Key = TypeVar("_Key")


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """The interval in which a parameter may lie, according to the data.

    A value between `low` and `high` fits no worse than a second draw of noise would. The interval
    holds the values that were tried, and those whose misfit the other parameters can compensate
    (`joint_reach`, `made_up`, and a search where the interval would decide).
    """

    parameter: Parameter
    value: float
    low: float
    high: float

    @property
    def decided(self) -> bool:
        """Whether the data decide it: they hold it to at most half of its range."""
        return self.parameter.share(self.high) - self.parameter.share(self.low) <= _DECIDED


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """A search's end: the scanner, its parameters, its rows, and those of the start."""

    scanner: Scanner
    values: dict[str, float]
    held: tuple[Held, ...]
    by_code: dict[float | None, float]  # least loss by period [px] of the code
    before: tuple[Row, ...]
    after: tuple[Row, ...]
    fitting: float  # the most that the loss may be for the parameters to say something
    trials: int

    @property
    def loss(self) -> float:
        """The twin's misfit; infinite where nothing is lit."""
        return loss_of(self.after) if self.after else float("inf")

    @property
    def fits(self) -> bool:
        """Whether the misfit is low enough for the parameters to be those of the scanner."""
        return self.loss <= self.fitting


def require_cma() -> None:
    """Raises GraycastError where cma is not installed."""
    if importlib.util.find_spec("cma") is None:
        raise GraycastError(
            "the search for the twin's parameters needs cma, which is not installed: run pip "
            "install 'graycast[twin]'"
        )


def search(
    start: Scanner,
    lit: Sequence[Lit],
    codes: Sequence[CodeSpec],
    parameters: Sequence[Parameter],
    real: Figures,
    *,
    places: Places | None = None,
    trials: int,
    seed: int,
    progress: ProgressMeter = UNWATCHED,
) -> Found:
    """The best of about so many trials, and how well it holds each parameter.

    Args:
        places: where missing depth is counted; those with which `real` was made.
    """
    require_cma()
    court = _Court(start, lit, parameters, real, places, seed, trials, progress)
    x0 = shares_of(start, parameters)
    _, before = court.judge(start.code, x0)
    kinds = [court.first_look(start.code, x0), with_noise_of_surface(x0, parameters)]
    step = len(parameters) + 2  # trials: fewer tell no slopes, and no step is made
    heat, final = (max(int(share * trials), step) for share in (_HEAT, _FINAL))
    ends = {}
    for code in codes:
        hopeful = _hopeful({number: court.loss(code, x) for number, x in enumerate(kinds)})
        ends[code] = min((court.refine(code, kinds[n], heat) for n in hopeful), key=_loss)
    for code in _hopeful({code: loss for code, (loss, _) in ends.items()}):
        ends[code] = court.refine(code, ends[code][1], final)
    code = min(ends, key=lambda c: _loss(ends[c]))
    _, x = court.refine(code, ends[code][1], trials - court.done)
    ends[code] = _, x = court.walk(code, x, trials - court.done, step=_NEAR)
    _, after = court.judge(code, x)
    held = _hold(court, {code: x} | {other: end[1] for other, end in ends.items()}, seed)
    values = values_at(x, parameters)
    return Found(
        scanner=replace(with_values(start, parameters, values), code=code),
        values=values,
        held=held,
        by_code={c.period_px: ends[c][0] for c in codes},
        before=before,
        after=after,
        fitting=fitting_loss(real, len(lit)),
        trials=court.done,
    )


def _loss(end: tuple[float, Float[np.ndarray, " n"]]) -> float:
    return end[0]


def _hopeful(losses: Mapping[_Key, float]) -> list[_Key]:
    """Those whose loss is not far above the least."""
    least = min(losses.values())
    return [key for key, loss in losses.items() if loss <= _HOPELESS * least]


def scans_of(
    lit: Sequence[Lit], scanner: Scanner, values: dict[str, float], *, seed: int, name: str
) -> Iterator[DepthScan]:
    """The twin's scans of the scenes, made one by one; one in which nothing is lit is left out."""
    look = BinLook(
        color=values.get(BIN_COLOR, 1.0),
        gloss=values.get(BIN_GLOSS, 1.0),
        rougher=values.get(BIN_ROUGHNESS, 0.0),
    )
    for k, one in enumerate(lit):
        scan = scan_lit(one, scanner, look, seed=seed + k, name=f"{name} {k}")
        if scan is not None and scan.valid.sum() > 1000:
            yield scan


class _Court:
    """Judges trials; it counts them, and tells of each."""

    def __init__(
        self,
        start: Scanner,
        lit: Sequence[Lit],
        parameters: Sequence[Parameter],
        real: Figures,
        places: Places | None,
        seed: int,
        total: int,
        progress: ProgressMeter,
    ) -> None:
        self.start, self.lit, self.parameters, self.real = start, lit, parameters, real
        self.places, self.seed, self.total, self.progress = places, seed, total, progress
        self.done, self.least = 0, np.inf
        # Of the noise that all share: a place that is asked for again costs no trial.
        self.tried: dict[tuple[CodeSpec, bytes], tuple[float, tuple[Row, ...]]] = {}
        self.floor = find_floor([one.truth.depth_m for one in lit])

    def rows(
        self, code: CodeSpec, x: Float[np.ndarray, " n"], seed: int | None = None
    ) -> tuple[Row, ...]:
        values = values_at(x, self.parameters)
        scanner = replace(with_values(self.start, self.parameters, values), code=code)
        seed = self.seed if seed is None else seed
        scans = scans_of(self.lit, scanner, values, seed=seed, name="twin")
        figures = figures_of(scans, self.floor, self.places)
        return compare(self.real, figures) if figures.scans else ()

    def loss(self, code: CodeSpec, x: Float[np.ndarray, " n"], seed: int | None = None) -> float:
        return self.judge(code, x, seed)[0]

    def judge(
        self, code: CodeSpec, x: Float[np.ndarray, " n"], seed: int | None = None
    ) -> tuple[float, tuple[Row, ...]]:
        """A trial: its loss and its rows, none of which are there if nothing is lit."""
        place = code, x.tobytes()
        if seed is None and place in self.tried:
            return self.tried[place]
        rows = self.rows(code, x, seed)
        loss = loss_of(rows) if rows else _DARK_LOSS
        if seed is None:
            self.tried[place] = loss, rows
        self.done, self.least = self.done + 1, min(self.least, loss)
        self.progress.stage(f"lowest misfit {self.least:.2f}")
        self.progress.count("trials", self.done, max(self.done, self.total))
        return loss, rows

    def first_look(self, code: CodeSpec, x0: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """One parameter after another at a few places, each kept where it is best."""
        x, least = x0.copy(), self.loss(code, x0)
        for i in range(len(x)):
            for share in _FIRST_LOOK:
                moved = x.copy()
                moved[i] = share
                loss = self.loss(code, moved)
                if loss < least:
                    least, x = loss, moved
        return x

    def walk(
        self, code: CodeSpec, x0: Float[np.ndarray, " n"], trials: int, *, step: float
    ) -> tuple[float, Float[np.ndarray, " n"]]:
        """The least loss of a search from a place, and where it was."""
        import cma

        rng = np.random.default_rng(self.seed)
        options = {
            "bounds": [0.0, 1.0],
            "verbose": -9,
            "seed": np.nan,  # cma would seed NumPy's global stream; its draws come from `rng`
            "randn": lambda *size: rng.standard_normal(size),
        }
        strategy = cma.CMAEvolutionStrategy(np.clip(x0, 0.02, 0.98), step, options)
        last = self.done + trials
        best, at = self.loss(code, x0), x0
        while self.done < last and not strategy.stop():
            asked = strategy.ask()
            losses = [self.loss(code, np.asarray(x)) for x in asked]
            strategy.tell(asked, losses)
            k = int(np.argmin(losses))
            if losses[k] < best:
                best, at = losses[k], np.asarray(asked[k])
        return best, at

    def refine(
        self,
        code: CodeSpec,
        x0: Float[np.ndarray, " n"],
        trials: int,
        *,
        fixed: int | None = None,
        enough: float = 0.0,
    ) -> tuple[float, Float[np.ndarray, " n"]]:
        """The least loss of damped Gauss-Newton steps from a place, and where it was.

        The loss is a sum of squares, so a step from the slopes of all rows goes farther than a walk
        that hears their sum alone. Slopes cost a trial for each parameter, so what a step finds
        corrects them (Broyden's update). Where no step leads on, they are taken anew, and where
        that was in vain, over half of the way and on the other side. The end is where all of these
        lead nowhere, so a search that begins there ends there.

        Args:
            fixed: the number of a parameter that stays as it is.
            enough: a loss with which the steps end.
        """
        last = self.done + trials
        free = np.arange(len(x0)) != fixed
        best, rows = self.judge(code, x0)
        x = at = x0
        if not rows:  # nothing is lit there, so nothing has a slope
            return best, at
        dark = np.full(len(pulls_of(rows)), np.sqrt(_DARK_LOSS))

        def pulls(place: Float[np.ndarray, " n"]) -> Float[np.ndarray, " rows"]:
            nonlocal best, at
            if self.done >= last and (code, place.tobytes()) not in self.tried:
                raise _Spent
            loss, seen = self.judge(code, place)
            if loss < best:
                best, at = loss, place
            if best <= enough:
                raise _Spent
            return pulls_of(seen) if seen else dark

        here, lever = pulls_of(rows), _LEVER
        with contextlib.suppress(_Spent):
            while abs(lever) >= _LEAST_LEVER:
                before, failed, damping = best, 0, _DAMPING
                slope = _slopes(pulls, x, here, lever, free)
                x, here = at, pulls(at)  # one of the places that were tried may be better
                while failed < _MOST_FAILED:
                    normal = slope.T @ slope + damping * np.eye(len(x))
                    moved = np.clip(x - np.linalg.solve(normal, slope.T @ here), 0.0, 1.0)
                    way = moved - x
                    if np.linalg.norm(way) < _LEAST_WAY:
                        break
                    found = pulls(moved)
                    slope += np.outer(found - here - slope @ way, way) / (way @ way)
                    if (found**2).mean() < (here**2).mean():
                        x, here, damping, failed = moved, found, damping / 3, 0
                    else:
                        damping, failed = 4 * damping, failed + 1
                lever = _LEVER if best < before else -lever / 2
        return best, at


def _slopes(
    pulls: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " rows"]],
    x: Float[np.ndarray, " n"],
    here: Float[np.ndarray, " rows"],
    lever: float,
    free: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "rows n"]:
    """Of each row by each free parameter, over so much of its range; zero by the others."""
    slopes = np.zeros((len(here), len(x)))
    for i in np.flatnonzero(free):
        moved = x.copy()
        moved[i] += lever if 0 <= x[i] + lever <= 1 else -lever
        slopes[:, i] = (pulls(moved) - here) / (moved[i] - x[i])
    return slopes


def joint_reach(slopes: Float[np.ndarray, "rows n"], room: float) -> Float[np.ndarray, " n"]:
    """How far each parameter may lie from the best, the others making up for it.

    The rows are taken to be linear about the best, whose sum of squares may rise by `room`, and a
    parameter alone to lie evenly in its range. With room as two standard deviations, the result is
    two of the marginal law: that of a Gauss-Newton step with a ridge.

    Args:
        slopes: of each row by each parameter, whose range is one.
    """
    precision = 4 * slopes.T @ slopes / room + 12 * np.eye(slopes.shape[1])
    return 2 * np.sqrt(np.diag(np.linalg.inv(precision)))


def own_loss(real: Figures, scenes: int) -> float:
    """The loss that the real scanner itself would have: the means of so few scans differ.

    It holds for scans of other scenes. Scans of the same scenes differ less, so the true value is
    lower.
    """
    return 1 / real.scans + 1 / scenes


def fitting_loss(real: Figures, scenes: int) -> float:
    """The most that a twin's loss may be for its parameters to say something of the scanner's."""
    return _FITS * own_loss(real, scenes)


class _Spent(Exception):
    """All trials of a refinement are done."""


def _hold(
    court: _Court, ends: Mapping[CodeSpec, Float[np.ndarray, " n"]], seed: int
) -> tuple[Held, ...]:
    """Between what each parameter may lie, about the best place of each code that may be right.

    What does not fit is worse by more than two other draws of the noise make of the best itself,
    and than the scanner itself would be: the means of so few scans and scenes differ, in spreads,
    with a variance of one over either number. It is also worse by two standard deviations, which is
    a sum of squares of 4 in units of what the best still is off, as rows that do not fit are not
    known better than that (R. T. Birge, "The calculation of errors by the method of least squares",
    1932).

    A twin whose misfit is far above that of the scanner itself lies in another valley, or lacks
    what the scanner has, and its own neighbourhood says nothing about the scanner's numbers. Every
    other code that is not far above it may be the scanner's, too: it had fewer trials than the best
    one.

    Args:
        ends: the place that the search found for each code, the best one first.
    """
    code, x = next(iter(ends.items()))
    loss, after = court.judge(code, x)
    fitting = fitting_loss(court.real, len(court.lit))
    if not after or loss > fitting:
        return tuple(
            Held(parameter=p, value=p.value(float(share)), low=p.low, high=p.high)
            for p, share in zip(court.parameters, x, strict=True)
        )
    court.total = court.done + len(ends) * len(x) * (len(_PROFILE) + 2) + 2  # without `_widen`
    other = [court.loss(code, x, seed + 1000 * k) for k in (1, 2)]
    means = own_loss(court.real, len(court.lit))
    two_sigmas = 4 * max(loss, means) / len(pulls_of(after))
    room = max(2 * float(np.abs(np.array(other) - loss).max()), two_sigmas)
    limit = max(loss + room, means)
    may_be = {c: own for c, at in ends.items() if (own := court.loss(c, at)) <= fitting}
    spans = [_span(court, c, ends[c], max(own + room, means)) for c, own in may_be.items()]
    low = np.clip(np.min([s[0] for s in spans], axis=0), 0.0, 1.0)
    high = np.clip(np.max([s[1] for s in spans], axis=0), 0.0, 1.0)
    for i in np.flatnonzero(high - low <= _DECIDED):
        _widen(court, code, x, int(i), low, high, limit)
    return tuple(
        Held(parameter=p, value=p.value(float(v)), low=p.value(float(a)), high=p.value(float(b)))
        for p, v, a, b in zip(court.parameters, x, low, high, strict=True)
    )


def _span(
    court: _Court, code: CodeSpec, x: Float[np.ndarray, " n"], limit: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Between what each parameter fits: alone, in all trials before, and with all others moved.

    An interval ends at the nearest share of `_PROFILE` that does not fit, even where the others are
    moved to make up for it (`made_up`).
    """
    loss, after = court.judge(code, x)
    here, slopes = pulls_of(after), []
    for i, own in enumerate(x):
        pulls = {float(own): here}
        for share in _PROFILE:
            moved = x.copy()
            moved[i] = share
            _, rows = court.judge(code, moved)
            if rows and abs(share - own) >= _LEVER:
                pulls[float(share)] = pulls_of(rows)
        slopes.append(_slope(pulls, float(own)))
    slope, room = np.stack(slopes, axis=1), len(here) * (limit - loss)
    reach = joint_reach(slope, room)
    fitting = np.array(
        [x, *(np.frombuffer(at) for (_, at), (was, _) in court.tried.items() if was <= limit)]
    )
    low, high = x - reach, x + reach
    for i in range(len(x)):

        def fits(share: float, i: int = i) -> bool:
            if low[i] <= share <= high[i]:
                return True
            return court.loss(code, made_up(x, here, slope, i, share, room=room)) <= limit

        least, most = fitting[:, i].min(), fitting[:, i].max()
        below = [share for share in _PROFILE[::-1] if share < least]
        above = [share for share in _PROFILE if share > most]
        low[i] = min(low[i], _end(below, least, fits))
        high[i] = max(high[i], _end(above, most, fits))
    return low, high


def _widen(
    court: _Court,
    code: CodeSpec,
    x: Float[np.ndarray, " n"],
    i: int,
    low: Float[np.ndarray, " n"],
    high: Float[np.ndarray, " n"],
    limit: float,
) -> None:
    """Move the ends of an interval that decides outwards, while the others make up for it there.

    They are searched anew: a single step, as in `_span`, leaves a valley that bends.
    """
    for end, way in ((low, -1), (high, 1)):
        while 0 < end[i] < 1 and high[i] - low[i] <= _DECIDED:
            place = x.copy()
            place[i] = end[i]
            if court.refine(code, place, _AGAIN * len(x), fixed=i, enough=limit)[0] > limit:
                break
            end[i] = next(share for share in _PROFILE[::way] if way * (share - end[i]) > 0)


def _end(shares: Iterable[float], end: float, fits: Callable[[float], bool]) -> float:
    """The first of the shares that does not fit; the last one, or `end`, if all do."""
    for share in shares:
        end = float(share)
        if not fits(end):
            break
    return end


def made_up(
    x: Float[np.ndarray, " n"],
    pulls: Float[np.ndarray, " rows"],
    slopes: Float[np.ndarray, "rows n"],
    i: int,
    share: float,
    *,
    room: float,
) -> Float[np.ndarray, " n"]:
    """The place with one parameter at a share, and all others where they make up for it best.

    The rows are taken to be linear, and each parameter to lie evenly in its range, as
    `joint_reach` does.

    Args:
        pulls: of the rows at `x`.
    """
    others = np.arange(len(x)) != i
    slope = slopes[:, others]
    moved = pulls + slopes[:, i] * (share - x[i])
    normal = slope.T @ slope + 3 * room * np.eye(slope.shape[1])
    place = x.copy()
    place[i] = share
    place[others] = np.clip(x[others] - np.linalg.solve(normal, slope.T @ moved), 0.0, 1.0)
    return place


def _slope(
    pulls: dict[float, Float[np.ndarray, " rows"]], own: float
) -> Float[np.ndarray, " rows"]:
    """Between the nearest places tried on either side; zero where nothing else was seen."""
    below = max((share for share in pulls if share < own), default=own)
    above = min((share for share in pulls if share > own), default=own)
    return (pulls[above] - pulls[below]) / (above - below) if above > below else 0 * pulls[own]
