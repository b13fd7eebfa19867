"""The limits of the decoder in docs/measurements/stacks.md: light, noise, periods.

python -m studies.decoder_limits saturation    pixels with a frame at the top of the range
python -m studies.decoder_limits noise         measured noise of stacks that have only phases
python -m studies.decoder_limits periods       error rate against coverage in weak light
python -m studies.decoder_limits sigma         error over sigma, over modulation
python -m studies.decoder_limits all

The scene is a map of projector columns in closed form: a tilted wall, and in front of it a ball, a
box and bars that are 1 to 6 pixels wide. At their edges, the map jumps by several periods.
"""

import argparse
from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt16
from scipy.ndimage import gaussian_filter
from scipy.special import j1

from graycast.camera.decode import CodeMap, DecodeSpec, Levels, Reason, decode
from graycast.camera.stack.description import LevelsSection
from graycast.camera.stack.levels import measure_levels
from graycast.rig.pattern import Code, Frame, gray, gray_phase, micro_phase, multi_frequency

from .projected import LEVELS, frames_of, share_of_white

SHAPE = (192, 256)
WIDTH_PX = 512
WRONG_PX = 1.0  # a column with a larger error is wrong; half a cell of a Gray code is 0.5
USUAL = DecodeSpec(min_contrast=0.005)


def surface() -> Float[np.ndarray, "h w"]:
    """Return the projector columns (h, w) of the scene."""
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(float)
    wall = 60 + 1.5 * x + 0.2 * y
    inside = np.maximum(1 - ((x - 80) / 45) ** 2 - ((y - 70) / 45) ** 2, 0)
    place = wall - 40 * np.sqrt(inside)
    place = np.where((np.abs(x - 190) < 30) & (np.abs(y - 60) < 35), wall - 37.3, place)
    for n, at in enumerate((30, 70, 110, 150, 190, 230)):  # 1 to 6 px wide
        place = np.where((x >= at) & (x <= at + n) & (y > 130) & (y < 180), wall - 52.9, place)
    return place


def stack(
    code: Code,
    *,
    white_dn: float | Float[np.ndarray, "h w"],
    dark_dn: float = 60.0,
    disc_px: float = 1.0,
    seed: int = 1,
    levels: Levels = LEVELS,
    share: Float[np.ndarray, "n h w"] | None = None,
) -> UInt16[np.ndarray, "n h w"]:
    """Return frames of the scene with noise, clipped at the saturation of the camera."""
    place = surface()
    if share is None:
        share = share_of_white(code, place, disc_px=disc_px)
    light = dark_dn + white_dn * share
    frames = frames_of(light, np.random.default_rng(seed), levels=levels)
    return np.minimum(frames, int(levels.saturation_dn)).astype(np.uint16)


def scores_of(
    code: Code, frames: UInt16[np.ndarray, "n h w"], *, levels: Levels = LEVELS
) -> tuple[float, float, CodeMap]:
    """Return the share of decoded pixels, the share of these that are wrong, and the codes."""
    place = surface()
    codes = decode(frames, code, USUAL, levels)
    known = codes.reason == Reason.DECODED
    limit_px = WRONG_PX if code.subpixel else 2.5
    wrong = np.abs(codes.column - place)[known] > limit_px
    return float(known.mean()), float(wrong.mean()) if known.any() else 0.0, codes


# --- saturation --------------------------------------------------------------------------------

SHINY_CODES = {
    "gray": gray(WIDTH_PX, 384, axes=("column",)),
    "gray, inverses": gray(WIDTH_PX, 384, axes=("column",), inverses=True),
    "gray and phase": gray_phase(WIDTH_PX, 384, steps=12),
    "gray and phase, inverses": gray_phase(WIDTH_PX, 384, steps=12, inverses=True),
    "three frequencies": multi_frequency(WIDTH_PX, 384),
}


def shiny(*, strength: float) -> Float[np.ndarray, "h w"]:
    """Return the light [DN] of brushed metal: lognormal, `strength` times the range at 3 sigma."""
    rng = np.random.default_rng(5)
    texture = gaussian_filter(rng.normal(size=SHAPE), (1.0, 12.0)) + gaussian_filter(
        rng.normal(size=SHAPE), 9.0
    )
    texture /= texture.std()
    return LEVELS.range_dn * 0.35 * np.exp(texture * np.log(strength / 0.35) / 3)


def saturation(args: argparse.Namespace) -> None:
    print("code, white light at 3 sigma / range: clipped %, decoded %, wrong % of these")
    for name, code in SHINY_CODES.items():
        for strength in (1.5, 4.0, 12.0):
            # The projector is out of focus, so the cosines' maximum is below the white level.
            frames = stack(code, white_dn=shiny(strength=strength), disc_px=3.0)
            top = (frames >= LEVELS.saturation_dn).any(axis=0).mean()
            decoded, wrong, codes = scores_of(code, frames)
            lost = (codes.reason == Reason.SATURATED).mean()
            print(
                f"{name:26} {strength:5.1f}: {100 * top:5.1f} {100 * decoded:6.2f} "
                f"{100 * wrong:6.3f}   saturated {100 * lost:5.2f}"
            )


# --- noise of phases alone -----------------------------------------------------------------------


def without(code: Code, *kinds: str) -> Code:
    return replace(code, frames=tuple(f for f in code.frames if f.kind not in kinds))


def two_periods(
    steps: int, *, periods_px: tuple[float, float] = (16.0, 17.0), width_px: int = 256
) -> Code:
    """Return two cosines with a beat of at least `width_px`: 272 px for 16 and 17 px."""
    frames = [
        Frame(kind="phase", axis="column", period_px=p, step=k, steps=steps)
        for p in periods_px
        for k in range(steps)
    ]
    return Code(width_px=width_px, height_px=192, frames=tuple(frames))


PHASES_ALONE = {
    "3 x 3 steps": without(multi_frequency(WIDTH_PX, 384, steps=3), "white", "black"),
    "3 x 4 steps": without(multi_frequency(WIDTH_PX, 384), "white", "black"),
    "3 x 8 steps": without(multi_frequency(WIDTH_PX, 384, steps=8), "white", "black"),
    "2 x 12 steps": two_periods(12, periods_px=(16.0, 16.5), width_px=WIDTH_PX),
    "micro, 3 + 5": without(micro_phase(WIDTH_PX, 384), "white", "black"),
    "gray and 8 steps": without(gray_phase(WIDTH_PX, 384), "white", "black"),
}


def textured(
    code: Code, *, gamma: float, levels: Levels = LEVELS, white_dn: float = 1500.0
) -> UInt16[np.ndarray, "n h w"]:
    """Return a stack of the scene with a printed texture; `gamma` is the projector's exponent."""
    rng = np.random.default_rng(8)
    albedo = 0.25 + 0.75 * gaussian_filter(rng.random(SHAPE) > 0.5, 1.0, output=float)
    share = share_of_white(code, surface()) ** gamma
    return stack(code, white_dn=white_dn * albedo, share=share, levels=levels)


def sigma_at(levels: Levels, light_dn: float) -> float:
    return np.sqrt(levels.floor_dn2 + levels.slope_dn * light_dn)


def noise(args: argparse.Namespace) -> None:
    print("code, response: measured over true noise at 100 and 1000 DN, where from")
    for name, code in PHASES_ALONE.items():
        for gamma in (1.0, 1.3):
            result = measure_levels(textured(code, gamma=gamma), code, LevelsSection())
            ratio = [sigma_at(result.levels, dn) / sigma_at(LEVELS, dn) for dn in (100, 1000)]
            why = result.source.split("(")[-1].rstrip(")")
            print(f"{name:18} {gamma:3.1f}: {ratio[0]:5.2f} {ratio[1]:5.2f}   {why}")


# --- counting periods --------------------------------------------------------------------------

WEAK_CODES = {
    "three frequencies": multi_frequency(WIDTH_PX, 384),
    "two frequencies": two_periods(6, periods_px=(32.0, 34.0), width_px=WIDTH_PX),
    "micro phase": micro_phase(WIDTH_PX, 384),
    "micro phase, 8 px": micro_phase(WIDTH_PX, 384, period_px=8.0),
}
WEAK_DN = (60.0, 120.0, 240.0, 480.0)


def periods(args: argparse.Namespace) -> None:
    """Count columns with errors above half a period; `--power` is the projector's exponent."""
    place = surface()
    print("code, white light: modulation, decoded %, wrong % of these, settled %, wrong % of these")
    for name, code in WEAK_CODES.items():
        for white_dn in WEAK_DN:
            share = share_of_white(code, place) ** args.power
            decoded, _, codes = scores_of(code, stack(code, white_dn=white_dn, share=share))
            known = codes.reason == Reason.DECODED
            off_px = np.abs(codes.column - place)
            limit_px = 0.5 * min(f.period_px for f in code.frames if f.period_px)
            wrong = (off_px[known] > limit_px).mean() if known.any() else 0.0
            mark = getattr(codes, "mark", None)
            settled = known & (mark & 2 > 0) if mark is not None else np.zeros(SHAPE, dtype=bool)
            bad = (off_px[settled] > limit_px).mean() if settled.any() else 0.0
            shares = [100 * share for share in (decoded, wrong, settled.mean(), bad)]
            words = "{:6.2f} {:6.3f}   {:6.2f} {:6.3f}".format(*shares)
            print(f"{name:18} {white_dn:4.0f}: {np.median(codes.modulation):6.3f} {words}")


# --- error over sigma ----------------------------------------------------------------------------

SIGMA_CODES = {
    "gray": gray(WIDTH_PX, 384, axes=("column",)),
    "gray, inverses": gray(WIDTH_PX, 384, axes=("column",), inverses=True),
    "gray and phase": gray_phase(WIDTH_PX, 384),
    "three frequencies": multi_frequency(WIDTH_PX, 384),
    "micro phase": micro_phase(WIDTH_PX, 384),
}


def sigma(args: argparse.Namespace) -> None:
    """Print the root mean square of error over sigma, for pixels decoded in the right period.

    A camera pixel covers 1.5 projector pixels, and the projector blurs by a disc. Noise is the only
    error. In a second case, each frame of a Gray code also has a random error of 4 % of the light.
    """
    print(
        "code, disc: modulation of the finest stripes; error over sigma, 60, 300, 3000 DN of white"
    )
    for name, code in SIGMA_CODES.items():
        for disc_px in (0.0, 1.0, 1.5, 2.0, 2.4, 3.0):
            shortest = min((f.period_px for f in code.frames if f.kind == "phase"), default=4.0)
            x = 2 * np.pi * disc_px / shortest
            left = np.sinc(1.5 / shortest) * (2 * j1(x) / x if x else 1.0)
            plain = [_scatter(code, disc_px, white_dn) for white_dn in (60.0, 300.0, 3000.0)]
            words = " ".join(f"{ratio:5.2f}" for ratio in plain)
            if not code.subpixel:
                more = [_scatter(code, disc_px, dn, error=0.04) for dn in (300.0, 3000.0)]
                words += "   with 4 %: " + " ".join(f"{ratio:5.2f}" for ratio in more)
            print(f"{name:18} {disc_px:3.1f}: {left:5.2f}   {words}")


def _scatter(code: Code, disc_px: float, white_dn: float, *, error: float = 0.0) -> float:
    rng = np.random.default_rng(6)
    u = np.linspace(8, WIDTH_PX - 9, 400)[None] + rng.uniform(0, 1, (120, 1))
    share = share_of_white(code, u, disc_px=disc_px)
    share = share + error * rng.normal(size=share.shape)
    codes = decode(frames_of(60 + white_dn * share, rng), code, USUAL, LEVELS)
    off_px = codes.column - u
    near = (codes.reason == Reason.DECODED) & (np.abs(off_px) < 4)
    return float(np.sqrt(np.mean((off_px / codes.sigma_column)[near] ** 2)))


def main() -> None:
    jobs = {"saturation": saturation, "noise": noise, "periods": periods, "sigma": sigma}
    parser = argparse.ArgumentParser()
    parser.add_argument("job", choices=[*jobs, "all"])
    parser.add_argument("--power", type=float, default=1.0)
    args = parser.parse_args()
    for name, job in jobs.items():
        if args.job in (name, "all"):
            job(args)


if __name__ == "__main__":
    main()
