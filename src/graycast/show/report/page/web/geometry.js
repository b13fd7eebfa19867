"use strict";
// The dataset's camera models: rays of pixels, points, and their positions in the projector.
// Units are those of the files: pixels and millimetres, but metres for the rig.

/**
 * Return undistorted directions (x, y, 1) of all pixels of a scene's maps, as two numbers each.
 * An error is thrown if the lens has no inverse over the picture, as in `optics.undistort`.
 */
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

/**
 * Distort a point by Brown-Conrady, in OpenCV's order (k1, k2, p1, p2, k3).
 * @param {number[]} ideal
 * @param {number[]} distortion
 */
function distort([x, y], [k1, k2, p1, p2, k3]) {
  const r2 = x * x + y * y,
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3));
  return [
    x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
    y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
  ];
}

/**
 * Undistort by Newton's method, with the limits and the refusals of `lens_inverse.py`.
 * @param {number[]} target
 * @param {number[]} distortion
 */
function undistort(target, distortion) {
  const [k1, k2, p1, p2, k3] = distortion;
  let [x, y] = target;
  for (let k = 0; k < 20; k++) {
    const [dx, dy] = distort([x, y], distortion),
      r2 = x * x + y * y,
      radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)),
      slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3)); // d radial / d r2, times 2
    const a = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
      b = slope * x * y + 2 * p1 * x + 2 * p2 * y,
      d = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
      determinant = a * d - b * b;
    const [ex, ey] = [dx - target[0], dy - target[1]],
      off = Math.max(Math.abs(ex), Math.abs(ey));
    if (off < 1e-14 || (k === 19 && off < 1e-9)) {
      if (determinant > 0) return [x, y];
      break; // The lens model folds over here.
    }
    x -= (d * ex - b * ey) / determinant;
    y -= (a * ey - b * ex) / determinant;
  }
  throw new Error(
    `The camera's distortion (${distortion.join(", ")}) has no inverse over this picture: its ` +
      "coefficients have to be in the order k1, k2, p1, p2, k3 and fitted to it.",
  );
}

/**
 * Return whether radial distortion grows up to this squared ideal radius: the derivative
 * 1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 must have no root there. The lens model ends where it folds
 * over.
 * @param {number} r2
 * @param {number[]} distortion
 */
function grows(r2, [k1, k2, , , k3]) {
  const growth = (s) => 1 + s * (3 * k1 + s * (5 * k2 + s * 7 * k3));
  const [a, b, c] = [21 * k3, 10 * k2, 3 * k1], // the derivative's slope: a s^2 + b s + c
    root = Math.sqrt(b * b - 4 * a * c),
    turns = a ? [(-b - root) / (2 * a), (-b + root) / (2 * a)] : [-c / b];
  return [r2, ...turns.filter((s) => s > 0 && s < r2)].every((s) => growth(s) > 0);
}

/**
 * Return the projector position of each pixel's point: {column, row} in px, NaN where unknown.
 * `which` is "depth" (perfect) or "scanner". The rig is exact, so the scanner's depth gives the
 * column from which it was made, except for smoothing filters and the rounding of depth.
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
    if (bent && !grows(ideal[0] ** 2 + ideal[1] ** 2, lens.distortion)) continue;
    const [x, y] = bent ? distort(ideal, lens.distortion) : ideal;
    const u = x * lens.fx_px + lens.cx_px,
      v = y * lens.fy_px + lens.cy_px;
    if (u < -0.5 || v < -0.5 || u >= lens.width_px - 0.5 || v >= lens.height_px - 0.5) continue;
    column[i] = u;
    row[i] = v;
  }
  return (scene.projected[which] = { column, row });
};

/** Transform from the camera frame to the world, both in mm: R^T (p - t). */
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

/** Return the twelve edges of a box [R (9), center, size] as 24 corners in the camera frame [mm]. */
Graycast.boxEdges = ([R, center, size]) => {
  const corner = (k) => {
    const d = [0, 1, 2].map((axis) => (((k >> axis) & 1) - 0.5) * size[axis]);
    const along = (row) =>
      center[row] + R[3 * row] * d[0] + R[3 * row + 1] * d[1] + R[3 * row + 2] * d[2];
    return /** @type {Point} */ ([along(0), along(1), along(2)]);
  };
  const ends = [];
  for (const bit of [1, 2, 4])
    for (let k = 0; k < 8; k++) if (!(k & bit)) ends.push(corner(k), corner(k | bit));
  return ends;
};
