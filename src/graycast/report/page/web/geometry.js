"use strict";
// The dataset's camera models: rays of pixels, points, and where the projector sees them.
// Units as in the files: pixels and millimetres; the rig is in metres.

/** Ideal directions (x, y, 1) of all pixels of a scene's maps, two numbers each. */
Graycast.rays = (scene) => {
  if (scene.rays) return scene.rays;
  const { width, height, stride, view } = scene;
  const [fx, , cx, , fy, cy] = view.cam_K;
  const bent = view.distortion.some((k) => k !== 0);
  const out = new Float32Array(2 * width * height);
  for (let r = 0, i = 0; r < height; r++)
    for (let c = 0; c < width; c++, i += 2) {
      const xy = [(c * stride - cx) / fx, (r * stride - cy) / fy];
      const ideal = bent ? undistort(xy, view.distortion) : xy;
      out[i] = ideal[0];
      out[i + 1] = ideal[1];
    }
  scene.rays = out;
  return out;
};

/** Brown-Conrady, OpenCV's order (k1, k2, p1, p2, k3). */
function distort([x, y], [k1, k2, p1, p2, k3]) {
  const r2 = x * x + y * y,
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  return [
    x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
    y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
  ];
}

/** The inverse by fixed point: every step takes off what the last guess was distorted by. */
function undistort(target, distortion) {
  let [x, y] = target;
  for (let k = 0; k < 25; k++) {
    const [dx, dy] = distort([x, y], distortion);
    x += target[0] - dx;
    y += target[1] - dy;
    if (Math.abs(target[0] - dx) + Math.abs(target[1] - dy) < 1e-8) break;
  }
  return [x, y];
}

/**
 * Projector position of every pixel's point: {column, row} in projector px, NaN where none.
 * `which` is "depth" (perfect) or "scanner". The rig is exact, so the scanner's depth leads back
 * to the column it was made from, but for smoothing filters and the depth's steps.
 */
Graycast.projectorMap = (scene, which) => {
  scene.projected ??= {};
  if (scene.projected[which]) return scene.projected[which];
  const rig = Graycast.scannerOf(scene).rig,
    lens = rig.projector,
    T = rig.T_cam_proj;
  const bent = lens.distortion.some((k) => k !== 0);
  const rays = Graycast.rays(scene),
    steps = scene[which];
  const column = new Float32Array(scene.n).fill(NaN),
    row = new Float32Array(scene.n).fill(NaN);
  for (let i = 0; i < scene.n; i++) {
    if (!steps[i]) continue;
    const z = (steps[i] * scene.depth_scale_mm) / 1000;
    const p = [rays[2 * i] * z - T[0][3], rays[2 * i + 1] * z - T[1][3], z - T[2][3]];
    const q = [0, 1, 2].map((k) => T[0][k] * p[0] + T[1][k] * p[1] + T[2][k] * p[2]);
    if (q[2] <= 0) continue;
    const ideal = [q[0] / q[2], q[1] / q[2]];
    const [x, y] = bent ? distort(ideal, lens.distortion) : ideal;
    const u = x * lens.fx_px + lens.cx_px,
      v = y * lens.fy_px + lens.cy_px;
    if (u < -0.5 || v < -0.5 || u >= lens.width_px - 0.5 || v >= lens.height_px - 0.5) continue;
    column[i] = u;
    row[i] = v;
  }
  return (scene.projected[which] = { column, row });
};

/** Camera frame to world, both mm: R^T (p - t). */
Graycast.toWorld = (scene, x, y, z) => {
  const R = scene.view.cam_R_w2c,
    t = scene.view.cam_t_w2c;
  const a = x - t[0],
    b = y - t[1],
    c = z - t[2];
  return [
    R[0] * a + R[3] * b + R[6] * c,
    R[1] * a + R[4] * b + R[7] * c,
    R[2] * a + R[5] * b + R[8] * c,
  ];
};

/** The twelve edges of a box [R (9), center, size] as 24 corners, camera frame, mm. */
Graycast.boxEdges = ([R, center, size]) => {
  const corner = (k) => {
    const d = [0, 1, 2].map((axis) => (((k >> axis) & 1) - 0.5) * size[axis]);
    return [0, 1, 2].map(
      (row) => center[row] + R[3 * row] * d[0] + R[3 * row + 1] * d[1] + R[3 * row + 2] * d[2],
    );
  };
  const ends = [];
  for (const bit of [1, 2, 4])
    for (let k = 0; k < 8; k++) if (!(k & bit)) ends.push(corner(k), corner(k | bit));
  return ends;
};
