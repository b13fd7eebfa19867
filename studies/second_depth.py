"""How often a second depth is right where the frames of a pixel support two surfaces.

python -m studies.second_depth

Prints the table of docs/measurements/wrong_depth.md: 20 parts at `small`, 64 paths per pixel. All
frames of a pixel are fitted by two places on its ray, that of its depth and another one. The other
place is near that of a neighbour or, in pixels that do see two surfaces, any on the ray. It counts
if both places add light, the weaker one at least a tenth, and the fit is good and better than with
one place. In computed mixtures, which test the method, both surfaces add light as in the fit. True
depths come from pixels of a quarter of the size.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numba
import numpy as np
from jaxtyping import Bool, Float, Float32

from benchmarks.decoders import bare, pictures_of, shared_patterns
from benchmarks.materials import MATERIALS
from benchmarks.stages import cell_of
from graycast.base.tables import markdown_table
from graycast.camera.decode import WRONG_M, WRONG_SIGMAS, levels_of, triangulation_axis
from graycast.camera.decode.meeting import lens_of, place_px, rows_of
from graycast.camera.scanner import Scanner, decode_capture
from graycast.cell.resolve import patterns_of
from graycast.rendering import Quality, Renderer, open_renderer
from graycast.rig.optics import picture_rays
from graycast.rig.pattern import AXES, CodeSpec
from graycast.rig.pattern.spec import Codec
from graycast.world.drop import DropLimits, drop
from graycast.world.parts import Material

CELLS = (
    ("like-phoxi-m", "matt"),
    ("like-phoxi-m", "metal 0.35"),
    ("like-zivid-2-m70", "metal 0.35"),
)
CODES: tuple[Codec, ...] = ("gray_phase", "multi_frequency", "micro_phase")
SEED = 911
FINE = 4  # A pixel at `small` has this many pixels at `full` on each side.
# A pixel of two surfaces has a step over this length, with at least this number of fine pixels on
# either side.
STEP_M, LEAST_SIDE = 0.003, 3
MIXTURE = 0.35  # Share of the light from the second surface in computed mixtures
APART_PX, RAY_APART_PX = 2.5, 6.0  # Nearer places count as one: those of neighbours, of the ray.
LEAST_SHARE, LEAST_GAIN, LEAST_LEAD = 0.1, 20.0, 8.0  # Gain and lead in squared sigmas
MODEL_ERROR = 0.03  # Error of a frame beyond noise, as a share of the pixel's contrast
ON_SURFACE, SURFACE_PX = 3, 1.5  # So many neighbours must have a place within this distance.


@dataclass(frozen=True, slots=True, kw_only=True)
class Stack:
    """The frames of all coded axes, with the depth that the decoder measures in them."""

    scanner: Scanner
    frames: Float32[np.ndarray, "n h w"]
    depth_m: Float32[np.ndarray, "h w"]
    sigma_m: Float32[np.ndarray, "h w"]


def second_depth(stack: Stack, *, any_place: bool) -> Float[np.ndarray, "h w"]:
    """Return the second depth [m], among those of neighbours or of the whole ray; NaN without."""
    rig, code = stack.scanner.rig, stack.scanner.light_code()
    levels, coded = levels_of(stack.scanner.sensor), AXES.index(triangulation_axis(rig))
    lines = [(AXES.index(f.axis) != coded, code.share(f)) for f in code.frames if f.axis]
    share = np.zeros((len(lines), max(len(line) for _, line in lines)))
    for row, (_, line) in zip(share, lines, strict=True):
        row[: len(line)] = line
    pattern = np.array([along for along, _ in lines]), np.array([len(s) for _, s in lines]), share
    law = levels.offset_dn, levels.floor_dn2, levels.slope_dn
    size_px = code.size_px(AXES[coded])
    places_m = 1 / np.linspace(1 / rig.far_m, 1 / rig.near_m, size_px) if any_place else np.empty(0)
    geometry = rows_of(rig.T_proj_cam, coded), lens_of(rig.projector, coded)
    second_m = np.full(stack.depth_m.shape, np.nan)
    rays = np.ascontiguousarray(picture_rays(rig.camera), dtype=np.float64)
    _search(stack.frames, pattern, law, rays, stack.depth_m, geometry, places_m, second_m)
    return second_m


@numba.njit(error_model="numpy")
def _search(frames, pattern, law, rays, depth_m, geometry, places_m, second_m):
    offset_dn, floor_dn2, slope_dn = law
    T, lens = geometry
    reach_px = np.linspace(-0.5, 0.5, 3) if len(places_m) else np.linspace(-1, 1, 5)
    n, h, w = frames.shape
    most = max(25, len(places_m))
    z, u, cost, other_m = np.empty((4, most))
    first, other = np.empty((2, n))
    for y in range(h):
        for x in range(w):
            if np.isnan(depth_m[y, x]):
                continue
            own_u, own_v = place_px(rays[y], x, np.float64(depth_m[y, x]), T, lens)
            count = 0
            if len(places_m):
                z[: len(places_m)], count = places_m, len(places_m)
            else:
                for near in depth_m[max(y - 2, 0) : y + 3, max(x - 2, 0) : x + 3].flat:
                    if not np.isnan(near):
                        z[count], count = near, count + 1
            apart = RAY_APART_PX if len(places_m) else APART_PX
            for i in range(count):
                u[i] = place_px(rays[y], x, z[i], T, lens)[0]
            if not (np.abs(u[:count] - own_u) >= apart).any():
                continue
            level = frames[:, y, x].astype(np.float64)
            error2 = (MODEL_ERROR * (level.max() - level.min())) ** 2
            weight = 1 / (floor_dn2 + slope_dn * np.maximum(level - offset_dn, 0) + error2)
            _expect(pattern, own_u, own_v, first)
            for i in range(count):
                cost[i], other_m[i] = np.inf, np.nan
                on_surface = (np.abs(u[:count] - u[i]) < SURFACE_PX).sum() >= ON_SURFACE
                if not abs(u[i] - own_u) >= apart or not (on_surface or len(places_m)):
                    continue
                du = place_px(rays[y], x, z[i] * 1.001, T, lens)[0] - u[i]
                for off_px in reach_px:
                    near = z[i] * (1 + 0.001 * off_px / du)
                    there_u, there_v = place_px(rays[y], x, near, T, lens)
                    _expect(pattern, there_u, there_v, other)
                    gain, misfit, part = _fit_two(level, weight, first, other)
                    if gain >= LEAST_GAIN and part >= LEAST_SHARE and misfit < cost[i]:
                        cost[i], other_m[i] = misfit, near
            best = cost[:count].argmin()
            lead = np.inf
            for i in range(count if len(places_m) else 0):
                if abs(u[i] - u[best]) >= RAY_APART_PX:
                    lead = min(lead, cost[i] - cost[best])
            if cost[best] <= n and lead >= LEAST_LEAD:
                second_m[y, x] = other_m[best]


@numba.njit(error_model="numpy")
def _expect(pattern, u, v, expected):
    """Write the share of white of each frame at a place."""
    along, sizes, share = pattern
    for j in range(len(along)):
        at = min(max(v if along[j] else u, 0.0), sizes[j] - 1.0)
        k = min(int(at), sizes[j] - 2)
        expected[j] = share[j, k] + (at - k) * (share[j, k + 1] - share[j, k])


@numba.njit(error_model="numpy")
def _fit_two(level, weight, first, other):
    """Fit `a + b first + c other`; return the gain over c = 0, the misfit, and c / (b + c)."""
    total = weight.sum()
    y = level - (weight * level).sum() / total
    p = first - (weight * first).sum() / total
    q = other - (weight * other).sum() / total
    yp, yq = (weight * y * p).sum(), (weight * y * q).sum()
    pp, qq, pq = (weight * p * p).sum(), (weight * q * q).sum(), (weight * p * q).sum()
    det = pp * qq - pq * pq
    b, c = (yp * qq - yq * pq) / det, (yq * pp - yp * pq) / det
    if not (b > 0 and c > 0):
        return 0.0, np.inf, 0.0
    explained = b * yp + c * yq
    return explained - yp * yp / pp, (weight * y * y).sum() - explained, c / (b + c)


# --- truth -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """True depths [m] of the fine pixels of each pixel, and those of its two surfaces.

    `nearer_m` and `farther_m` are NaN where a pixel sees one surface.
    """

    fine_m: Float32[np.ndarray, "h w n"]
    nearer_m: Float32[np.ndarray, "h w"]
    farther_m: Float32[np.ndarray, "h w"]


def truth_of(full_m: Float32[np.ndarray, "H W"]) -> Truth:
    h, w = (side // FINE for side in full_m.shape)
    fine_m = full_m.reshape(h, FINE, w, FINE).swapaxes(1, 2).reshape(h, w, FINE**2)
    order_m = np.sort(fine_m, axis=2)
    steps_m = np.diff(order_m, axis=2)
    before = steps_m.argmax(axis=2) + 1
    nearer = np.arange(FINE**2) < before[..., None]
    two = (steps_m.max(axis=2) > STEP_M) & (np.minimum(before, FINE**2 - before) >= LEAST_SIDE)
    means = [np.where(two, order_m.mean(axis=2, where=side), np.nan) for side in (nearer, ~nearer)]
    return Truth(fine_m=fine_m, nearer_m=means[0], farther_m=means[1])


def is_right(
    stack: Stack, second_m: Float[np.ndarray, "h w"], truth: Truth
) -> Bool[np.ndarray, "h w"]:
    """Return where a true depth in 3 x 3 pixels agrees with the second depth, but not the first."""
    h, w = second_m.shape
    fine_m = np.pad(truth.fine_m, ((1, 1), (1, 1), (0, 0)), mode="edge")
    most_m = np.maximum(WRONG_M, WRONG_SIGMAS * stack.sigma_m)[..., None]
    right = np.zeros((h, w), dtype=bool)
    for dy in range(3):
        for dx in range(3):
            true_m = fine_m[dy : dy + h, dx : dx + w]
            other = np.abs(true_m - stack.depth_m[..., None]) > most_m
            right |= (other & (np.abs(true_m - second_m[..., None]) <= most_m)).any(axis=2)
    return right


def mixed(stack: Stack, truth: Truth, *, seed: int) -> Stack:
    """Return a stack with the computed light of both surfaces of each pixel, and noise."""
    rig, code = stack.scanner.rig, stack.scanner.light_code()
    levels, coded = levels_of(stack.scanner.sensor), AXES.index(triangulation_axis(rig))
    rays = np.ascontiguousarray(picture_rays(rig.camera), dtype=np.float64).reshape(-1, 3)
    geometry = rows_of(rig.T_proj_cam, coded), lens_of(rig.projector, coded)
    coded_frames = [f for f in code.frames if f.axis]
    light = np.zeros((len(coded_frames), len(rays)))
    for depth_m, part in ((truth.nearer_m, 1 - MIXTURE), (truth.farther_m, MIXTURE)):
        places = [place_px(rays, k, z, *geometry) for k, z in enumerate(depth_m.ravel().tolist())]
        for own, f in zip(light, coded_frames, strict=True):
            place = np.array(places)[:, int(AXES.index(f.axis) != coded)]
            line = code.share(f)
            own += part * np.interp(place, np.arange(len(line)), line)
    signal = 0.5 * levels.range_dn * light.reshape(-1, *truth.nearer_m.shape)
    noise = np.sqrt(levels.floor_dn2 + levels.slope_dn * np.nan_to_num(signal))
    frames = levels.offset_dn + signal
    frames += noise * np.random.default_rng(seed).standard_normal(frames.shape)
    exact_m = np.zeros_like(truth.nearer_m)
    return replace(stack, frames=frames.astype(np.float32), depth_m=truth.nearer_m, sigma_m=exact_m)


# --- table -------------------------------------------------------------------------------------


def stacks(rig: str, material: str, renderer: Renderer) -> Iterator[tuple[str, Stack, Truth]]:
    """Yield a stack of each code, with the truth."""
    cell, full = (cell_of({"count": 20, "rig": rig, "resolution": r}) for r in ("small", "full"))
    layout = drop(cell.scene, (20,), seed=SEED, limits=DropLimits())
    parts = (replace(cell.scene.parts[0], material=Material(**MATERIALS[material])),)
    several = [bare(replace(cell.scanner, code=CodeSpec(codec=code))) for code in CODES[1:]]
    several = [bare(cell.scanner), *several]
    keys, patterns = shared_patterns(several)
    scene, few = replace(cell.scene, parts=parts), Quality(samples=1)
    light = renderer.render(scene, layout, patterns, quality=Quality(samples=64), seed=SEED)
    scene, white = replace(full.scene, parts=parts), patterns_of(full.scanner)[:1]
    fine = renderer.render(scene, layout, white, quality=few, seed=SEED).truth.depth_m
    for name, scanner in zip(CODES, several, strict=True):
        capture, own = pictures_of(scanner, light.radiance, keys, seed=SEED)
        depth = decode_capture(scanner, capture, path_noise=own.path_noise)[1]
        coded = [k for k, f in enumerate(scanner.light_code().frames) if f.axis]
        frames = capture.frames[coded].astype(np.float32)
        stack = Stack(scanner=scanner, frames=frames, depth_m=depth.depth_m, sigma_m=depth.sigma_m)
        yield name, stack, truth_of(fine)


def figures(stack: Stack, truth: Truth, *, any_place: bool) -> str:
    """Return the number of pixels with a second depth, and the share [%] of it that is right."""
    second_m = second_depth(stack, any_place=any_place)
    known = np.isfinite(second_m)
    return f"{known.sum()}; {100 * is_right(stack, second_m, truth)[known].mean():.0f}"


def main() -> None:
    rows = []
    with open_renderer("mitsuba") as renderer:
        for rig, material in CELLS:
            for code, stack, truth in stacks(rig, material, renderer):
                two = np.isfinite(truth.nearer_m) & np.isfinite(stack.depth_m)
                computed = mixed(stack, truth, seed=SEED)
                at_steps = replace(stack, depth_m=np.where(two, stack.depth_m, np.nan))
                cells = [
                    figures(stack, truth, any_place=False),
                    figures(at_steps, truth, any_place=True),
                    figures(computed, truth, any_place=True),
                ]
                rows.append([rig, material, code, str(two.sum()), *cells])
    head = ["rig", "material", "code", "pixels with a step", "near neighbours", "on the ray"]
    head.append("computed")
    print(markdown_table(head, rows))


if __name__ == "__main__":
    main()
