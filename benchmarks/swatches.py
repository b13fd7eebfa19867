"""Pictures of all materials by name, for docs/images/materials.jpg.

A sphere and the turned ring of the built-in parts are on a matt grey table. One picture is in
colour under a square lamp, the other monochrome under projected stripes. The exposure is the same
for all materials, so that bright materials look bright. All pictures are denoised.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from graycast.base.color import srgb
from graycast.base.frames import look_at, rigid
from graycast.rendering import Quality, Renderer, open_renderer
from graycast.rendering.denoise import denoise
from graycast.rig.optics import Optics
from graycast.rig.pair import Rig
from graycast.world.parts import MATERIALS, Material, Mesh, Part, builtin_part
from graycast.world.scene import Environment, Lamp, Layout, Quad, Scene

WIDTH_PX, HEIGHT_PX, COLUMNS, LABEL_PX, GAP_PX = 160, 100, 4, 18, 6
SAMPLES, SEED, STRIPE_PX = 512, 1, 7
BALL_M = 0.018  # radius of the ball
WHITE_LAMP, WHITE_STRIPES = 0.8, 1.3  # radiance [W sr^-1 m^-2] that is white in the pictures


def draw(out: Path, show: Callable[[str], None], names: tuple[str, ...] = (*MATERIALS,)) -> None:
    """Render the swatches of all materials, and write them with their names as one picture."""
    rows = -(-len(names) // COLUMNS)
    cell = 2 * WIDTH_PX + GAP_PX, HEIGHT_PX + LABEL_PX
    sheet = Image.new("RGB", (COLUMNS * cell[0] - GAP_PX, rows * cell[1]), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    with open_renderer("mitsuba", device="cpu") as renderer:
        for number, name in enumerate(names):
            show(f"{name} is rendered")
            x, y = cell[0] * (number % COLUMNS), cell[1] * (number // COLUMNS)
            pen.text((x + 2, y), name, fill="black", font=font)
            for k, picture in enumerate(swatch(renderer, MATERIALS[name].material)):
                place = x + k * WIDTH_PX, y + LABEL_PX
                sheet.paste(Image.fromarray(picture), place)
    sheet.save(out, quality=88)


def swatch(renderer: Renderer, material: Material) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Render the two parts under the lamp and under the stripes."""
    ring = builtin_part("metal_workpiece_2")
    parts = tuple(replace(part, material=material) for part in (_ball(), ring))
    height_m = -float(ring.mesh.bounds_m[0, 2])
    poses = [
        rigid(np.eye(3), np.array([-0.028, 0.0, BALL_M])),
        rigid(np.eye(3), np.array([0.025, 0.0, height_m])),
    ]
    layout = Layout(T_world_part=np.stack(poses), part_index=np.arange(2))
    scene = _scene(parts)
    projector = scene.rig.projector
    stripe = (np.arange(projector.width_px) // STRIPE_PX % 2 * 255).astype(np.uint8)
    pattern = np.tile(stripe, (1, projector.height_px, 1))
    quality = Quality(samples=SAMPLES, depth=4)
    rendering = renderer.render(scene, layout, pattern, quality=quality, seed=SEED)
    light, normal = rendering.radiance, rendering.truth.normal
    stripes = np.repeat(light.pattern[0][..., None], 3, axis=-1)
    lit, striped = (
        denoise(picture, light.albedo, normal, renderer.denoiser)
        for picture in (light.ambient_rgb, stripes)
    )
    return [srgb(lit / WHITE_LAMP), srgb(striped / WHITE_STRIPES)]


def _ball() -> Part:
    ball = trimesh.creation.icosphere(5, radius=BALL_M)
    normals = ball.vertices[ball.faces] / BALL_M
    mesh = Mesh(
        vertices_m=np.array(ball.vertices),
        faces=np.array(ball.faces),
        corner_normals=np.array(normals),
    )
    return Part(name="ball", mesh=mesh, material=Material(), density_kg_m3=1000.0, friction=0.4)


def _scene(parts: tuple[Part, ...]) -> Scene:
    table = Quad(
        center_m=(0.0, 0.0, 0.0),
        half_u_m=(1.0, 0.0, 0.0),
        half_v_m=(0.0, 1.0, 0.0),
        material=Material(base_color=(0.2, 0.2, 0.2), specular=0.0),
    )
    camera, projector = (
        look_at(np.array(place_m), np.array([0.0, 0.0, 0.012]), np.array([0.0, 0.0, -1.0]))
        for place_m in ((0.0, -0.30, 0.32), (0.16, -0.26, 0.32))
    )
    rig = Rig(
        name="swatches",
        camera=_optics(WIDTH_PX, HEIGHT_PX, 640.0),
        projector=_optics(256, 160, 640.0),
        T_cam_proj=np.linalg.inv(camera) @ projector,
        near_m=0.1,
        far_m=1.0,
        intensity_w_sr=1.0,
    )
    lamp = Lamp(center_m=(-0.25, 0.15, 0.45), size_m=0.16, radiance=(14.0, 14.0, 14.0))
    around = Environment(radiance=(0.3, 0.3, 0.3))
    return Scene(
        rig=rig,
        T_world_cam=camera,
        parts=parts,
        surfaces=(table,),
        lamps=(lamp,),
        environment=around,
    )


def _optics(width_px: int, height_px: int, f_px: float) -> Optics:
    middle = (width_px - 1) / 2, (height_px - 1) / 2
    return Optics(
        width_px=width_px,
        height_px=height_px,
        fx_px=f_px,
        fy_px=f_px,
        cx_px=middle[0],
        cy_px=middle[1],
    )
