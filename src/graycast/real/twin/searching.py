"""The search: which values make a cell's simulated scans have the real scans' statistics.

Light is rendered once for each code, so a trial is exposure, noise, decoding and filters alone.
Covariance matrix adaptation walks the box of the declared parameters (Hansen's `cma`), with the
same noise in every trial, so that the same search takes the same way. First each
parameter is tried alone, which finds what is far off. A code is no number: each candidate has a
short search from there, and the best goes on.

Source: Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772.
"""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...errors import GraycastError
from ...pattern import CodeSpec
from ...scanner import Scanner
from ..realism import DepthScan
from ..realism.patches import find_floor
from .parameters import BIN_REFLECTANCE, Parameter, shares_of, values_at, with_values
from .rows import Figures, Row, compare, figures_of, loss_of
from .stage import Lit, scan_lit

FIRST_STEP = 0.2  # of the way between the bounds
_FIRST_PART = 0.15  # as a share of the trials, for the short search of each code
_DARK_LOSS = 1e3  # of a scanner that sees nothing
_FIRST_LOOK = (0.0, 0.5, 1.0)  # shares at which a parameter is tried alone before the search
_PROFILE = np.linspace(0.0, 1.0, 5)  # shares at which a parameter is tried alone, beside the best
_DECIDED = 0.5  # as a share of its range: a parameter held worse than this is not decided

OnTrial = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """How well the data hold a parameter: between what it may lie.

    `low` and `high` are the nearest tried values beyond which nothing that was tried fits as well
    as two draws of noise are alike.
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
    trials: int


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
    trials: int,
    seed: int,
    on_trial: OnTrial = lambda done, total, text: None,
) -> Found:
    """The best of about so many trials, and how well it holds each parameter."""
    require_cma()
    profile = len(parameters) * len(_PROFILE) + 2
    court = _Court(start, lit, parameters, real, seed, trials + profile, on_trial)
    x0 = shares_of(start, parameters)
    before = court.rows(start.code, x0)
    x0 = court.first_look(start.code, x0)
    share = _FIRST_PART if len(codes) > 1 else 0.0
    best: dict[CodeSpec, tuple[float, Float[np.ndarray, " n"]]] = {}
    for code in codes:
        best[code] = court.walk(code, x0, max(int(share * trials), 1), FIRST_STEP)
    code = min(best, key=lambda c: best[c][0])
    left = trials - court.done
    loss, x = court.walk(code, best[code][1], max(left, 1), FIRST_STEP / 2)
    if best[code][0] < loss:
        loss, x = best[code]
    held = _hold(court, code, x, loss, seed)
    values = values_at(x, parameters)
    return Found(
        scanner=replace(with_values(start, parameters, values), code=code),
        values=values,
        held=held,
        by_code={c.period_px: min(best[c][0], loss if c == code else np.inf) for c in codes},
        before=before,
        after=court.rows(code, x),
        trials=court.done,
    )


def scans_of(
    lit: Sequence[Lit], scanner: Scanner, values: dict[str, float], *, seed: int, name: str
) -> list[DepthScan]:
    """The twin's scans of the scenes; a scene in which nothing is lit is left out."""
    factor = values.get(BIN_REFLECTANCE, 1.0)
    made = [
        scan_lit(one, scanner, bin_factor=factor, seed=seed + k, name=f"{name} {k}")
        for k, one in enumerate(lit)
    ]
    return [scan for scan in made if scan is not None and scan.valid.sum() > 1000]


class _Court:
    """Judges trials; it counts them, and tells of each."""

    def __init__(
        self,
        start: Scanner,
        lit: Sequence[Lit],
        parameters: Sequence[Parameter],
        real: Figures,
        seed: int,
        total: int,
        on_trial: OnTrial,
    ) -> None:
        self.start, self.lit, self.parameters, self.real = start, lit, parameters, real
        self.seed, self.total, self.on_trial = seed, total, on_trial
        self.done, self.least = 0, np.inf
        self.tried: list[tuple[CodeSpec, Float[np.ndarray, " n"], float]] = []  # one noise for all
        self.floor = find_floor([one.truth.depth_m for one in lit])

    def rows(
        self, code: CodeSpec, x: Float[np.ndarray, " n"], seed: int | None = None
    ) -> tuple[Row, ...]:
        values = values_at(x, self.parameters)
        scanner = replace(with_values(self.start, self.parameters, values), code=code)
        seed = self.seed if seed is None else seed
        scans = scans_of(self.lit, scanner, values, seed=seed, name="twin")
        return compare(self.real, figures_of(scans, self.floor)) if scans else ()

    def loss(self, code: CodeSpec, x: Float[np.ndarray, " n"], seed: int | None = None) -> float:
        rows = self.rows(code, x, seed)
        loss = loss_of(rows) if rows else _DARK_LOSS
        if seed is None:
            self.tried.append((code, x.copy(), loss))
        self.done, self.least = self.done + 1, min(self.least, loss)
        self.on_trial(self.done, self.total, f"lowest misfit {self.least:.2f}")
        return loss

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
        self, code: CodeSpec, x0: Float[np.ndarray, " n"], trials: int, step: float
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
        best, at = self.loss(code, x0), x0
        last = self.done + trials - 1
        while self.done < last and not strategy.stop():
            asked = strategy.ask()
            losses = [self.loss(code, np.asarray(x)) for x in asked]
            strategy.tell(asked, losses)
            k = int(np.argmin(losses))
            if losses[k] < best:
                best, at = losses[k], np.asarray(asked[k])
        return best, at


def _hold(
    court: _Court, code: CodeSpec, x: Float[np.ndarray, " n"], loss: float, seed: int
) -> tuple[Held, ...]:
    """Each parameter alone over its range, and in all trials before: where the fit is worse.

    Worse is by more than two other draws of the noise make of the best itself, or by a twentieth,
    and than the scanner itself would be: the means of so few scans and scenes differ, in spreads,
    with a variance of one over either number.
    """
    other = [court.loss(code, x, seed + 1000 * k) for k in (1, 2)]
    limit = loss + max(2 * float(np.abs(np.array(other) - loss).max()), 0.05 * loss, 1e-9)
    scans = max(len(values) for values in court.real.value.values())
    limit = max(limit, 1 / scans + 1 / len(court.lit))
    fits = np.array([at for c, at, was in court.tried if c == code and was <= limit])
    found = []
    for i, parameter in enumerate(court.parameters):
        good: list[float] = fits[:, i].tolist()
        bad: list[float] = []
        for share in _PROFILE:
            moved = x.copy()
            moved[i] = share
            (good if court.loss(code, moved) <= limit else bad).append(float(share))
        low = max((b for b in bad if b < min(good)), default=min(good))
        high = min((b for b in bad if b > max(good)), default=max(good))
        found.append(
            Held(
                parameter=parameter,
                value=parameter.value(float(x[i])),
                low=parameter.value(low),
                high=parameter.value(high),
            )
        )
    return tuple(found)
