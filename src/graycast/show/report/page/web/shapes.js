"use strict";
// WebGL arrays for the 3D view: the perfect surface, the scanner's points and boxes.

{
  const SURFACE_VERTICES = 450000,
    TILT_RAD = 0.02, // A step of depth may tilt a normal by this angle.
    FAR_PX = 6; // the largest distance between the neighbours that give a normal
  /** @type {Shapes} */
  const shapes = /** @type {any} */ ({});
  Graycast.shapes = shapes;
  shapes.BIN = [0.72, 0.58, 0.4]; // the colour of a bin

  /** Return a function that converts a pixel and its depth in steps to a point of the world. */
  shapes.pointOf = (scene) => {
    const rays = Graycast.rays(scene);
    return (i, step) => {
      const z = step * scene.depth_scale_mm;
      return Graycast.toWorld(scene, rays[2 * i] * z, rays[2 * i + 1] * z, z);
    };
  };

  shapes.space = (scene) => {
    const point = shapes.pointOf(scene),
      steps = scene.has.depth ? scene.depth : scene.scanner,
      some = [[], [], []];
    const anyPart = scene.instance.some((k) => k > 0);
    for (let i = 0; i < scene.n; i += 23)
      if (steps[i] && (!anyPart || scene.instance[i]))
        point(i, steps[i]).forEach((v, k) => some[k].push(v));
    const middle = some.map((list) => list.sort((a, b) => a - b)[list.length >> 1] ?? 0);
    const spread = some.map((list, k) =>
      list.length
        ? Math.max(
            list[Math.floor(0.98 * list.length)] - middle[k],
            middle[k] - list[Math.floor(0.02 * list.length)],
          )
        : 100,
    );
    const reach = Math.max(Math.hypot(...spread), 20);
    const camera = Graycast.toWorld(scene, 0, 0, 0).map((v, k) => v - middle[k]),
      far = Math.hypot(...camera);
    const below = Graycast.toWorld(scene, 0, 1, 0).map((v, k) => v - middle[k] - camera[k]); // downwards in the image
    const level = Math.hypot(camera[0], camera[1]) > 0.3 * far;
    const yaw = level ? Math.atan2(camera[1], camera[0]) : Math.atan2(below[1], below[0]);
    const distance = 3.9 * reach,
      pitch = Math.asin(camera[2] / far);
    const views = {
      camera: { yaw, pitch: Math.min(pitch, 1.55), distance: far },
      oblique: { yaw: yaw + 0.45, pitch: 0.95, distance },
      side: { yaw, pitch: 0.12, distance },
      top: { yaw, pitch: 1.55, distance },
    };
    return {
      point: (i, step) => point(i, step).map((v, k) => v - middle[k]),
      middle,
      reach,
      views,
      start: views.oblique,
    };
  };

  /** Return the depth map as triangles, without steps that are steeper than about 80 degrees. */
  shapes.mesh = (gl, scene, space) => {
    const skip = Math.max(Math.ceil(Math.sqrt(scene.n / SURFACE_VERTICES)), 1);
    const w = Math.floor((scene.width - 1) / skip) + 1,
      h = Math.floor((scene.height - 1) / skip) + 1;
    const place = new Float32Array(3 * w * h),
      from = new Uint32Array(w * h),
      index = [];
    const pixelRad = (skip * scene.stride) / scene.view.cam_K[0];
    for (let r = 0, k = 0; r < h; r++)
      for (let c = 0; c < w; c++, k++) {
        const i = r * skip * scene.width + c * skip;
        from[k] = i;
        if (scene.depth[i]) place.set(space.point(i, scene.depth[i]), 3 * k);
      }
    const joined = (...corner) => {
      const z = corner.map((k) => scene.depth[from[k]]),
        low = Math.min(...z),
        high = Math.max(...z);
      return low > 0 && high - low < 6 * pixelRad * high;
    };
    for (let r = 0; r + 1 < h; r++)
      for (let c = 0; c + 1 < w; c++) {
        const a = r * w + c,
          b = a + 1,
          d = a + w,
          e = d + 1;
        if (joined(a, b, d)) index.push(a, d, b);
        if (joined(b, d, e)) index.push(b, d, e);
      }
    return {
      ...arrays(gl, place, Uint32Array.from(index), shapes.normals(scene, from)),
      from,
      count: index.length,
    };
  };

  shapes.cloud = (gl, scene, space) => {
    const from = [];
    for (let i = 0; i < scene.n; i++) if (scene.scanner[i]) from.push(i);
    const place = new Float32Array(3 * from.length);
    from.forEach((i, k) => place.set(space.point(i, scene.scanner[i]), 3 * k));
    return { ...arrays(gl, place, null, shapes.normals(scene, from)), from, count: from.length };
  };

  /** Return the fused points of all pictures of a scene. */
  shapes.fused = (gl, cloud, space) => {
    const place = new Float32Array(3 * cloud.count);
    for (let k = 0; k < place.length; k++)
      place[k] = cloud.low[k % 3] + cloud.step * cloud.place[k] - space.middle[k % 3];
    return { ...arrays(gl, place, null, cloud.normal), count: cloud.count };
  };

  const NO_REASON = { 253: [91, 141, 239], 254: [70, 74, 88], 255: [29, 111, 66] };
  const highSigma = (cloud) =>
    (cloud.sigmaHigh ??= Graycast.highest(Float32Array.from(cloud.sigma), 0.98) || 1);
  const most = (cloud) => (cloud.most ??= cloud.views.reduce((a, b) => Math.max(a, b), 1));

  shapes.paintFused = (gl, thing, cloud, paint) => {
    const color = new Uint8Array(4 * cloud.count).fill(255),
      reasons = Graycast.reasonColors();
    const paints = {
      colour: (k) => cloud.color.subarray(3 * k, 3 * k + 3),
      views: (k) => Graycast.heat("viridis", (cloud.views[k] - 1) / Math.max(most(cloud) - 1, 1)),
      view: (k) => Graycast.instanceColor(cloud.view[k]),
      sigma: (k) => Graycast.heat("viridis", cloud.sigma[k] / highSigma(cloud)),
      first: (k) => {
        const why = cloud.first[k];
        return NO_REASON[why] ?? reasons.subarray(3 * why, 3 * why + 3);
      },
      plain: () => [176, 178, 182],
    };
    for (let k = 0; k < cloud.count; k++) color.set(paints[paint](k), 4 * k);
    upload(gl, thing, color);
    thing.paint = paint;
  };

  shapes.fusedWords = (cloud, paint) => {
    const points = `${Graycast.count(cloud.count)} points of ${cloud.names.length} pictures`;
    const bar = { map: "viridis", whole: true };
    if (paint === "sigma")
      return {
        bar: {
          ...bar,
          low: 0,
          high: highSigma(cloud) * cloud.sigma_step_mm,
          unit: "mm",
          digits: 3,
        },
        note: `${points}; standard deviation across the surface`,
      };
    if (paint === "views")
      return {
        bar: { ...bar, low: 1, high: most(cloud), unit: "views", digits: 0 },
        note: `${points}; the number of pictures that measured the place`,
      };
    const told = {
      view: "; the colour shows from which picture a point comes",
      first: `; why ${cloud.names[0]} has no depth there, in the colours of the reasons: dark grey is hidden from it, green outside of its picture, blue seen through`,
    };
    return { note: points + (told[paint] ?? "") };
  };

  /** Return a mesh in its own frame, for bodies. */
  shapes.body = (gl, vertices, faces) => {
    const made = arrays(gl, vertices, faces, null);
    upload(gl, made, new Uint8Array((4 * vertices.length) / 3)); // The shader needs the buffer.
    return { ...made, count: faces.length };
  };

  /** Return lines between pairs of points, in one colour. */
  shapes.lines = (gl, place, [r, g, b]) => {
    const made = arrays(gl, place, null, null),
      count = place.length / 3;
    upload(
      gl,
      made,
      Uint8Array.from({ length: 4 * count }, (_, k) => [r, g, b, 255][k % 4]),
    );
    return { ...made, count };
  };

  /** Release a thing's memory on the GPU. */
  shapes.drop = (gl, thing) => {
    gl.deleteVertexArray(thing.array);
    for (const buffer of thing.buffers) gl.deleteBuffer(buffer);
  };

  shapes.edges = (gl, scene, space) => {
    const place = [],
      color = [];
    scene.instances.forEach((one, k) => {
      if (one.box[2] < 0) return;
      for (const p of Graycast.boxEdges(one.box3d)) {
        place.push(...Graycast.toWorld(scene, ...p).map((v, axis) => v - space.middle[axis]));
        color.push(...Graycast.instanceColor(k), 255);
      }
    });
    const made = arrays(gl, Float32Array.from(place), null, null);
    upload(gl, made, Uint8Array.from(color));
    return { ...made, count: place.length / 3 };
  };

  shapes.recolor = (gl, scene, thing, paint, prefs) => {
    const color = new Uint8Array(4 * thing.from.length),
      reasons = Graycast.reasonColors();
    const table = Graycast.colormap("RdBu_r"),
      limit = Graycast.errorLimit(prefs),
      scale = (127.5 * scene.depth_scale_mm) / limit;
    const heat = Graycast.colormap("viridis_r"),
      [low, high] = Graycast.depthRange(scene);
    for (let k = 0; k < thing.from.length; k++) {
      const i = thing.from[k];
      let r = 176,
        g = 178,
        b = 182;
      if (paint === "colour")
        [r, g, b] = [scene.rgb[4 * i], scene.rgb[4 * i + 1], scene.rgb[4 * i + 2]];
      else if (paint === "reason")
        [r, g, b] = reasons.subarray(3 * scene.reason[i], 3 * scene.reason[i] + 3);
      else if (paint === "sigma")
        [r, g, b] = Graycast.heat("magma", scene.sigma[i] / Graycast.sigmaLimit(scene));
      else if (paint === "instance" && scene.instance[i])
        [r, g, b] = Graycast.instanceColor(scene.instance[i] - 1);
      else if (paint === "difference" && scene.depth[i]) {
        const at =
          3 *
          Math.max(
            0,
            Math.min(255, Math.round(127.5 + (scene.scanner[i] - scene.depth[i]) * scale)),
          );
        [r, g, b] = table.subarray(at, at + 3);
      } else if (paint === "depth") {
        const at =
          3 *
          Math.max(
            0,
            Math.min(
              255,
              Math.round(
                (255 * ((scene.scanner[i] || scene.depth[i]) * scene.depth_scale_mm - low)) /
                  (high - low),
              ),
            ),
          );
        [r, g, b] = heat.subarray(at, at + 3);
      }
      color[4 * k] = r;
      color[4 * k + 1] = g;
      color[4 * k + 2] = b;
      color[4 * k + 3] = 255;
    }
    upload(gl, thing, color);
    thing.paint = paint;
  };

  /**
   * Return the surface's normals at some pixels, three bytes each, in the world frame, for shading.
   * They are averaged over enough pixels to hide the steps of depth, but not across an edge.
   */
  shapes.normals = (scene, from) => {
    const { width, n, depth_scale_mm, stride, view } = scene,
      rays = Graycast.rays(scene),
      steps = scene.has.depth ? scene.depth : scene.scanner,
      R = view.cam_R_w2c,
      out = new Int8Array(3 * from.length),
      sum = [0, 0, 0];
    const z = (i) => steps[i] * depth_scale_mm;
    /** Store the step in space over one pixel, along one axis, in `into`. */
    const slope = (i, by, room, into) => {
      const pixel = (stride * z(i)) / view.cam_K[0],
        m = Math.min(Math.max(Math.ceil(depth_scale_mm / (2 * TILT_RAD * pixel)), 1), FAR_PX);
      const on = room[1] >= m && steps[i + m * by] ? z(i + m * by) - z(i) : Infinity,
        back = room[0] >= m && steps[i - m * by] ? z(i) - z(i - m * by) : Infinity;
      const edge = Math.abs(on - back) > 3 * depth_scale_mm + 0.35 * m * pixel || on === back,
        a = edge && Math.abs(on) > Math.abs(back) ? i : i + m * by,
        b = edge && Math.abs(on) <= Math.abs(back) ? i : i - m * by;
      if (edge && on === Infinity && back === Infinity) return into.fill(0);
      for (let k = 0; k < 2; k++) into[k] = rays[2 * a + k] * z(a) - rays[2 * b + k] * z(b);
      into[2] = z(a) - z(b);
      return into;
    };
    const across = [0, 0, 0],
      down = [0, 0, 0];
    for (let k = 0; k < from.length; k++) {
      const i = from[k],
        c = i % width;
      slope(i, 1, [c, width - 1 - c], across);
      slope(i, width, [Math.floor(i / width), Math.floor((n - 1 - i) / width)], down);
      for (let j = 0; j < 3; j++) {
        const [p, q] = [(j + 1) % 3, (j + 2) % 3];
        sum[j] = across[p] * down[q] - across[q] * down[p];
      }
      const length = Math.hypot(...sum);
      if (!length) [sum[0], sum[1], sum[2]] = [0, 0, 1]; // Without neighbours, it faces the camera.
      for (let j = 0; j < 3; j++)
        out[3 * k + j] = Math.round(
          (127 * (R[j] * sum[0] + R[3 + j] * sum[1] + R[6 + j] * sum[2])) / (length || 1),
        );
    }
    return out;
  };

  function arrays(gl, place, index, normal) {
    const array = gl.createVertexArray(),
      color = gl.createBuffer(),
      buffers = [color];
    const buffer = () => {
      buffers.push(gl.createBuffer());
      return buffers.at(-1);
    };
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer());
    gl.bufferData(gl.ARRAY_BUFFER, place, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, color);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    if (normal) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer());
      gl.bufferData(gl.ARRAY_BUFFER, normal, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(2);
      gl.vertexAttribPointer(2, 3, gl.BYTE, true, 0, 0);
    }
    if (index) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, index, gl.STATIC_DRAW);
    }
    gl.bindVertexArray(null);
    return { array, color, buffers, index: !!index };
  }

  function upload(gl, thing, color) {
    gl.bindBuffer(gl.ARRAY_BUFFER, thing.color);
    gl.bufferData(gl.ARRAY_BUFFER, color, gl.STATIC_DRAW);
  }
}
