"""Check with another physics engine, MuJoCo, of whether a layout is in balance.

MuJoCo shares no code with the engine of the drop: contacts, friction cone and integrator differ.
The simulation uses the same collision hulls with the same margins, starts at rest, and has no
damping and steps of 0.5 ms. A part that stays in place only because of numerical effects of the
drop slides, rolls or falls in this simulation.

Contacts are as stiff as the step allows: under its weight, a part sinks by about a micrometre.
Leaves out: bins that are meshes.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from graycast.world.drop.body import Body, motion_m
from graycast.world.drop.rapier import GRAVITY_M_S2, SKIN_M
from graycast.world.scene import Bin, Layout

STEP_S = 0.0005
WALL_M = 0.15
MEMORY_BYTES = 2**30  # 255 parts of many hulls have thousands of contact points.
# MuJoCo's `solref` (time constant [s] and damping ratio of a contact) and `solimp`: see its
# documentation of solver parameters.
STIFFNESS = (0.002, 1.0)
IMPEDANCE = (0.99, 0.999, 1e-4, 0.5, 2.0)


def unbalanced_m(
    box: Bin, bodies: tuple[Body, ...], layout: Layout, *, seconds: float = 1.0
) -> Float[np.ndarray, " n"]:
    """Return the largest displacement [m] of a point of each part after `seconds` of simulation.

    Args:
        box: a bin that is a box.
        bodies: kinds of parts, which `layout.part_index` refers to.
        layout: poses of the parts.
        seconds: simulated time.

    Raises:
        ImportError: MuJoCo is not installed.
        ValueError: the bin is a mesh.
    """
    import mujoco

    if box.mesh is not None:
        raise ValueError("the bin is a mesh; balance is checked in bins that are boxes")
    model = _spec(box, bodies, layout).compile()
    data = mujoco.MjData(model)
    for _ in range(round(seconds / STEP_S)):
        mujoco.mj_step(model, data)
    end = np.tile(np.eye(4), (len(layout.part_index), 1, 1))
    for i, T in enumerate(end):
        body = data.body(f"part {i}")
        T[:3, :3], T[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    box_m = np.stack([body.box_m for body in bodies])[layout.part_index]
    return motion_m(np.stack([layout.T_world_part, end]), box_m)[0]


def _spec(box: Bin, bodies: tuple[Body, ...], layout: Layout):
    import mujoco

    spec = mujoco.MjSpec()
    spec.memory = MEMORY_BYTES
    spec.option.timestep = STEP_S
    spec.option.gravity = [0.0, 0.0, -GRAVITY_M_S2]
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.impratio = 10  # stiffness of friction over that of the normal force
    spec.option.noslip_iterations = 20
    # After a drop, contacts have small gaps. MuJoCo's newer collision detection then finds only one
    # or two contact points between two faces, or an edge and a wall, so that flat boxes rock.
    # The older collision detection, libccd, finds all corners of the contact.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    spec.option.iterations = 200
    spec.option.tolerance = 1e-10
    _add_box(spec, box, bodies)
    for kind, body in enumerate(bodies):
        for piece, (vertices, _) in enumerate(body.hulls):
            mesh = spec.add_mesh(name=f"{kind} {piece}", uservert=vertices.ravel().tolist())
            mesh.maxhullvert = -1
    for i, (T, kind) in enumerate(zip(layout.T_world_part, layout.part_index, strict=True)):
        _add_part(spec, f"part {i}", bodies[kind], T, int(kind))
    return spec


def _add_box(spec, box: Bin, bodies: tuple[Body, ...]) -> None:
    """Add floor and walls; like the drop, use the mean friction of both surfaces of a contact."""
    import mujoco

    friction = (box.friction + float(np.mean([body.friction for body in bodies]))) / 2
    x, y, top = box.inner_m[0] / 2, box.inner_m[1] / 2, box.inner_m[2]
    far_x, far_y = x + WALL_M, y + WALL_M
    for low, high in (
        ((-far_x, -far_y, -WALL_M), (far_x, far_y, 0.0)),
        ((-far_x, -far_y, 0.0), (-x, far_y, top)),
        ((x, -far_y, 0.0), (far_x, far_y, top)),
        ((-x, -far_y, 0.0), (x, -y, top)),
        ((-x, y, 0.0), (x, far_y, top)),
    ):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(np.array(low) + high) / 2,
            size=(np.array(high) - low) / 2,
            friction=[friction, 0.0, 0.0],
            priority=1,
            solref=STIFFNESS,
            solimp=IMPEDANCE,
        )


def _add_part(spec, name: str, body: Body, T: Float[np.ndarray, "4 4"], kind: int) -> None:
    import mujoco

    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    mj_body = spec.worldbody.add_body(name=name, pos=T[:3, 3], quat=[w, x, y, z])
    mj_body.add_freejoint()
    moment = body.inertia_kg_m2
    mj_body.mass, mj_body.ipos, mj_body.explicitinertial = body.mass_kg, body.center_m, True
    mj_body.fullinertia = [*np.diag(moment), moment[0, 1], moment[0, 2], moment[1, 2]]
    for piece in range(len(body.hulls)):
        mj_body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{kind} {piece}",
            friction=[body.friction, 0.0, 0.0],
            condim=3,
            margin=SKIN_M,  # A contact begins at the sum of both margins.
            solref=STIFFNESS,
            solimp=IMPEDANCE,
        )
