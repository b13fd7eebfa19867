"use strict";
// Moving bodies (the arm's limbs, the tool and the carried part) and fixed bodies.
// Poses are (x, y, z) in millimetres and a unit quaternion (x, y, z, w); matrices are column-major.

{
  const ARM = [0.66, 0.7, 0.76],
    TOOL = [0.19, 0.21, 0.25],
    TABLE = { light: [0.83, 0.83, 0.81], dark: [0.24, 0.25, 0.27] };

  /** @type {(place: number[]) => Float32Array} from a translation and a quaternion, real part last */
  const matrix = ([x, y, z, a, b, c, d]) =>
    Float32Array.of(
      1 - 2 * (b * b + c * c),
      2 * (a * b + c * d),
      2 * (a * c - b * d),
      0,
      2 * (a * b - c * d),
      1 - 2 * (a * a + c * c),
      2 * (b * c + a * d),
      0,
      2 * (a * c + b * d),
      2 * (b * c - a * d),
      1 - 2 * (a * a + b * b),
      0,
      x,
      y,
      z,
      1,
    );

  const times = (p, q) =>
    Float32Array.from({ length: 16 }, (_, i) => {
      const row = i % 4,
        column = i - row;
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += p[row + 4 * k] * q[column + k];
      return sum;
    });

  /** Invert a rigid transform. */
  const inverse = (p) => {
    const out = Float32Array.of(
      p[0],
      p[4],
      p[8],
      0,
      p[1],
      p[5],
      p[9],
      0,
      p[2],
      p[6],
      p[10],
      0,
      0,
      0,
      0,
      1,
    );
    for (let r = 0; r < 3; r++)
      out[12 + r] = -(out[r] * p[12] + out[4 + r] * p[13] + out[8 + r] * p[14]);
    return out;
  };

  /** Interpolate poses; linear quaternions are accurate, because poses are 50 ms apart. */
  function between(limbs, at, next, share) {
    const out = [];
    for (let k = 0; k < 7; k++) out.push(limbs[at + k] * (1 - share) + limbs[next + k] * share);
    const length = Math.hypot(out[3], out[4], out[5], out[6]);
    for (let k = 3; k < 7; k++) out[k] /= length;
    return out;
  }

  /** Return the poses of all limbs at a time, as matrices. */
  Graycast.limbsAt = (motion, time) => {
    const { time_s, limbs } = motion,
      wide = limbs.length / time_s.length,
      last = time_s.length - 1;
    let i = 0;
    while (i < last - 1 && time_s[i + 1] <= time) i++;
    const step = last ? time_s[i + 1] - time_s[i] : 0,
      share = step ? Math.min(Math.max((time - time_s[i]) / step, 0), 1) : 0,
      next = Math.min(i + 1, last);
    return Array.from({ length: wide / 7 }, (_, k) =>
      matrix(between(limbs, i * wide + 7 * k, next * wide + 7 * k, share)),
    );
  };

  /** Return the pose of the carried part; null before the grip and after the release. */
  Graycast.carried = (motion, time, before) => {
    if (motion.held_until_s === null || motion.held_until_s === undefined) return null;
    const from = motion.time_s[motion.grip];
    if (time < from || time > motion.held_until_s) return null;
    const now = Graycast.limbsAt(motion, time)[motion.carrier],
      then = Graycast.limbsAt(motion, from)[motion.carrier];
    return times(times(now, inverse(then)), matrix(before));
  };

  /** Load the meshes once for the page. */
  let meshes = null;
  async function unpacked() {
    const { limbs, parts, bin, table } = Graycast.report;
    const mesh = async ({ vertices, faces }) => ({
      vertices: new Float32Array((await Graycast.inflate(vertices)).buffer),
      faces: new Uint32Array((await Graycast.inflate(faces)).buffer),
    });
    return {
      limbs: await Promise.all(limbs.map(mesh)),
      parts: await Promise.all(parts.map(mesh)),
      bin: await mesh(bin),
      table: await mesh(table),
    };
  }

  /**
   * Return the `bodies` of `makeCloud` for a bin; `now()` returns {content, attempt, number, motion,
   * time}.
   */
  Graycast.makeBodies = async (middle, now) => {
    meshes ??= await unpacked();
    return (gl) => {
      const made = ({ vertices, faces }) => Graycast.shapes.body(gl, vertices, faces);
      const limbs = meshes.limbs.map(made),
        parts = meshes.parts.map(made),
        bin = made(meshes.bin),
        table = made(meshes.table);
      const seen = (place) => {
        const out = Float32Array.from(place);
        middle.forEach((v, k) => (out[12 + k] -= v));
        return out;
      };
      const still = seen(matrix([0, 0, 0, 0, 0, 0, 1]));
      const tint = (number) => Graycast.instanceColor(number).map((v) => v / 255);
      return (prefs) => {
        const { content, attempt, motion, time } = now(),
          out = [];
        if (!motion) return out;
        if (prefs.bin) {
          const theme = document.documentElement.dataset.theme;
          out.push({ thing: table, place: still, tint: TABLE[theme] ?? TABLE.light });
          out.push({ thing: bin, place: still, tint: Graycast.shapes.BIN, open: true });
        }
        if (prefs.robot)
          Graycast.limbsAt(motion, time).forEach((place, k) =>
            out.push({
              thing: limbs[k],
              place: seen(place),
              tint: Graycast.report.limbs[k].is_tool ? TOOL : ARM,
            }),
          );
        attempt.present.forEach((number, k) => {
          const before = attempt.parts[k],
            taken = number === motion.part;
          if (!prefs.parts && !taken) return;
          const place =
            (taken && Graycast.carried(motion, time, before)) || Graycast.resting(now(), k);
          if (place)
            out.push({
              thing: parts[content.kinds[number]],
              place: seen(place),
              tint: tint(number),
            });
        });
        return out;
      };
    };
  };

  /** Return the pose of a part; a lost part has its pose in the next scan that includes it. */
  Graycast.resting = ({ content, attempt, number, motion, time }, k) => {
    const mine = attempt.present[k],
      until = motion.held_until_s ?? Infinity;
    if (mine !== motion.part || time <= until) return matrix(attempt.parts[k]);
    const next = content.attempts[number + 1],
      there = next ? next.present.indexOf(mine) : -1;
    return there < 0 ? null : matrix(next.parts[there]);
  };
}
