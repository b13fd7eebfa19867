"""Radiance of materials on a plane in Cycles, for `test_materials_in_both.py`; runs under bpy.

    python furnace_in_cycles.py WORKER CASES ANSWERS

WORKER is the folder of Graycast's Cycles worker, which defines the materials. CASES is JSON: a list
of {"words": of the material, "view": angle in rad to the normal, "light": [angle in rad, turn in
rad] of a distant lamp with 1 W/m2 across its rays, or null for a world of radiance 1}. ANSWERS
becomes a list of [mean, standard error], three bands each.
"""

import json
import math
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

SIDE_PX = 8
FURNACE_SAMPLES, LAMP_SAMPLES = 1024, 4  # a lamp without size has no noise


def stage() -> tuple[bpy.types.Object, bpy.types.Object, bpy.types.Object]:
    """Make a plane, an orthographic camera that sees a piece of it, and a distant lamp."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.blur_glossy = scene.cycles.light_sampling_threshold = 0.0
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.max_bounces = 1
    scene.render.resolution_x = scene.render.resolution_y = SIDE_PX
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    mesh = bpy.data.meshes.new("plane")
    mesh.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 0.01
    lamp = bpy.data.lights.new("lamp", "SUN")
    lamp.angle = 0.0
    bodies = [bpy.data.objects.new("body", data) for data in (mesh, camera, lamp)]
    for body in bodies:
        scene.collection.objects.link(body)
    scene.camera = bodies[1]
    return tuple(bodies)


def aim(body: bpy.types.Object, angle: float, turn: float = 0.0) -> None:
    """Aim a camera or a lamp at the origin from 3 m away."""
    z = Vector(
        (math.sin(angle) * math.cos(turn), math.sin(angle) * math.sin(turn), math.cos(angle))
    )
    body.matrix_world = Matrix.Translation(3 * z) @ z.to_track_quat("Z", "Y").to_matrix().to_4x4()


def picture(file: Path) -> np.ndarray:
    scene = bpy.context.scene
    scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.array(image.pixels[:]).reshape(-1, 4)[:, :3]
    bpy.data.images.remove(image)
    return pixels


def main(worker: str, cases: str, answers: str) -> None:
    sys.path.insert(0, worker)
    from materials import GRAIN, Surface

    plane, camera, lamp = stage()
    grain = plane.data.attributes.new(GRAIN, "FLOAT_VECTOR", "CORNER")
    grain.data.foreach_set("vector", [1.0, 0.0, 0.0] * 4)
    sky = bpy.context.scene.world.node_tree.nodes["Background"].inputs
    sky["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    cycles, results = bpy.context.scene.cycles, []
    with tempfile.TemporaryDirectory() as folder:
        for number, case in enumerate(json.loads(Path(cases).read_text())):
            surface = Surface(case["words"], Path(folder))
            surface.show("light", glowing=False)
            plane.data.materials.clear()
            plane.data.materials.append(surface.material)
            furnace = case["light"] is None
            sky["Strength"].default_value = float(furnace)
            lamp.data.energy = float(not furnace)
            aim(camera, case["view"])
            if not furnace:
                aim(lamp, *case["light"])
            cycles.samples = FURNACE_SAMPLES if furnace else LAMP_SAMPLES
            cycles.seed = number
            pixels = picture(Path(folder) / f"{number}.exr")
            results.append([pixels.mean(0).tolist(), (pixels.std(0) / SIDE_PX).tolist()])
    Path(answers).write_text(json.dumps(results))


main(*sys.argv[1:])
