"use strict";
// The scene in 3D, plain WebGL 2: the perfect surface as a mesh, the scanner's points over it.
// Frame: the world's axes (z up), millimetres, about the middle of what the camera sees.

{
  const { el } = Graycast;
  const FIELD_RAD = 0.55,
    SURFACE_VERTICES = 450000;
  const VERTEX = `#version 300 es
    uniform mat4 uClip;
    uniform float uSize;
    in vec3 aPlace;
    in vec4 aColor;
    out vec3 vPlace;
    out vec4 vColor;
    void main() {
      vPlace = aPlace;
      vColor = aColor;
      gl_Position = uClip * vec4(aPlace, 1.0);
      gl_PointSize = uSize;
    }`;
  // Points and lines have no normal: their derivatives are nothing, and NaN times 0 is NaN.
  const FRAGMENT = `#version 300 es
    precision highp float;
    uniform vec3 uEye;
    uniform float uShade;
    in vec3 vPlace;
    in vec4 vColor;
    out vec4 color;
    void main() {
      vec3 n = normalize(cross(dFdx(vPlace), dFdy(vPlace)));
      float facing = abs(dot(n, normalize(uEye - vPlace)));
      color = vec4(vColor.rgb * (uShade > 0.5 ? 0.45 + 0.55 * facing : 1.0), 1.0);
    }`;

  /** Makes a 3D view of a scene: {stage, draw(prefs), look(name), close()}. */
  Graycast.makeCloud = (scene) => {
    const canvas = el("canvas", { id: "cloud" }),
      stage = el("div", { class: "stage cloud" }, canvas);
    const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!gl) {
      stage.append(
        el("p", { class: "sorry" }, "This browser gives no WebGL 2, which the 3D view needs."),
      );
      return { stage, draw() {}, look() {}, close() {} };
    }
    const program = link(gl),
      space = makeSpace(scene);
    const where = Object.fromEntries(
      ["uClip", "uSize", "uEye", "uShade"].map((name) => [
        name,
        gl.getUniformLocation(program, name),
      ]),
    );
    const surface = scene.has.depth ? mesh(gl, program, scene, space) : null;
    const points = scene.has.scanner ? cloud(gl, program, scene, space) : null;
    const boxes = scene.instances[0]?.box3d ? edges(gl, program, scene, space) : null;
    const eye = { ...space.start, pan: [0, 0, 0] };
    let prefs = {},
      queued = false;

    const render = () => {
      queued = false;
      const w = Math.round(stage.clientWidth * devicePixelRatio),
        h = Math.round(stage.clientHeight * devicePixelRatio);
      if (!w || !h) return;
      if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
      const place = eyePlace(eye);
      gl.viewport(0, 0, w, h);
      gl.clearColor(...background(), 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.useProgram(program);
      gl.uniformMatrix4fv(where.uClip, false, clip(eye, place, w / h, space.reach));
      gl.uniform3fv(where.uEye, place);
      const put = (thing, kind, shade) => {
        gl.uniform1f(where.uShade, shade);
        gl.uniform1f(where.uSize, (prefs.pointSize ?? 2) * devicePixelRatio);
        gl.bindVertexArray(thing.array);
        if (thing.index) gl.drawElements(kind, thing.count, gl.UNSIGNED_INT, 0);
        else gl.drawArrays(kind, 0, thing.count);
      };
      gl.enable(gl.CULL_FACE); // only the side that the camera saw: one looks in through a wall
      if (surface && prefs.surface !== false) put(surface, gl.TRIANGLES, 1);
      gl.disable(gl.CULL_FACE);
      if (points && prefs.points !== false) put(points, gl.POINTS, 0);
      if (boxes && prefs.boxes) put(boxes, gl.LINES, 0);
    };
    const ask = () => {
      if (!queued) {
        queued = true;
        requestAnimationFrame(render);
      }
    };
    steer(stage, eye, ask, () => {
      Object.assign(eye, space.start, { pan: [0, 0, 0] });
      ask();
    });
    const watch = new ResizeObserver(ask);
    watch.observe(stage);
    return {
      stage,
      draw(next) {
        if (surface && next.surfacePaint !== surface.paint)
          recolor(gl, scene, surface, next.surfacePaint, next);
        const key = `${next.pointPaint} ${Graycast.errorLimit(next)}`;
        if (points && key !== points.paint) {
          recolor(gl, scene, points, next.pointPaint, next);
          points.paint = key;
        }
        prefs = next;
        ask();
      },
      look(name) {
        Object.assign(eye, space.views[name], { pan: [0, 0, 0] });
        ask();
      },
      close() {
        watch.disconnect();
        gl.getExtension("WEBGL_lose_context")?.loseContext();
      },
    };
  };

  const background = () => {
    const found = getComputedStyle(document.documentElement).getPropertyValue("--space").trim();
    return [1, 3, 5].map((k) => parseInt(found.slice(k, k + 2), 16) / 255);
  };

  // --- what is drawn ----------------------------------------------------------------------------

  function makeSpace(scene) {
    const rays = Graycast.rays(scene),
      steps = scene.has.depth ? scene.depth : scene.scanner,
      some = [[], [], []];
    const point = (i, step) => {
      const z = step * scene.depth_scale_mm;
      return Graycast.toWorld(scene, rays[2 * i] * z, rays[2 * i + 1] * z, z);
    };
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
    const below = Graycast.toWorld(scene, 0, 1, 0).map((v, k) => v - middle[k] - camera[k]); // the image's down
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
  }

  /** The depth map as triangles; none where a step is steeper than about 80 degrees. */
  function mesh(gl, program, scene, space) {
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
    return { ...arrays(gl, program, place, Uint32Array.from(index)), from, count: index.length };
  }

  function cloud(gl, program, scene, space) {
    const from = [];
    for (let i = 0; i < scene.n; i++) if (scene.scanner[i]) from.push(i);
    const place = new Float32Array(3 * from.length);
    from.forEach((i, k) => place.set(space.point(i, scene.scanner[i]), 3 * k));
    return { ...arrays(gl, program, place, null), from, count: from.length };
  }

  function edges(gl, program, scene, space) {
    const place = [],
      color = [];
    scene.instances.forEach((one, k) => {
      if (one.box[2] < 0) return;
      for (const p of Graycast.boxEdges(one.box3d)) {
        place.push(...Graycast.toWorld(scene, ...p).map((v, axis) => v - space.middle[axis]));
        color.push(...Graycast.instanceColor(k), 255);
      }
    });
    const made = arrays(gl, program, Float32Array.from(place), null);
    upload(gl, made, Uint8Array.from(color));
    return { ...made, count: place.length / 3 };
  }

  function recolor(gl, scene, thing, paint, prefs) {
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
  }

  // --- WebGL ------------------------------------------------------------------------------------

  function link(gl) {
    const program = gl.createProgram();
    for (const [kind, text] of [
      [gl.VERTEX_SHADER, VERTEX],
      [gl.FRAGMENT_SHADER, FRAGMENT],
    ]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS))
        throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "aPlace");
    gl.bindAttribLocation(program, 1, "aColor");
    gl.linkProgram(program);
    return program;
  }

  function arrays(gl, program, place, index) {
    const array = gl.createVertexArray(),
      color = gl.createBuffer();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, place, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, color);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    if (index) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, index, gl.STATIC_DRAW);
    }
    gl.bindVertexArray(null);
    return { array, color, index: !!index };
  }

  function upload(gl, thing, color) {
    gl.bindBuffer(gl.ARRAY_BUFFER, thing.color);
    gl.bufferData(gl.ARRAY_BUFFER, color, gl.STATIC_DRAW);
  }

  // --- the eye ----------------------------------------------------------------------------------

  const outward = ({ yaw, pitch }) => [
    Math.cos(pitch) * Math.cos(yaw),
    Math.cos(pitch) * Math.sin(yaw),
    Math.sin(pitch),
  ];
  const eyePlace = (eye) => outward(eye).map((v, k) => eye.pan[k] + v * eye.distance);
  const across = ({ yaw }) => [-Math.sin(yaw), Math.cos(yaw), 0];
  const upward = (eye) => {
    const o = outward(eye),
      a = across(eye);
    return [o[1] * a[2] - o[2] * a[1], o[2] * a[0] - o[0] * a[2], o[0] * a[1] - o[1] * a[0]];
  };

  function clip(eye, place, aspect, reach) {
    const back = outward(eye),
      right = across(eye),
      up = upward(eye);
    const dot = (a) => -(a[0] * place[0] + a[1] * place[1] + a[2] * place[2]);
    const near = Math.max(eye.distance / 200, 0.5),
      far = eye.distance + 40 * reach,
      f = 1 / Math.tan(FIELD_RAD / 2),
      d = near - far;
    const row = [
      [right, f / aspect],
      [up, f],
    ].map(([axis, k]) => [axis[0] * k, axis[1] * k, axis[2] * k, dot(axis) * k]);
    const z = [...back, dot(back)],
      a = (far + near) / d,
      b = (2 * far * near) / d;
    row.push(
      [z[0] * a, z[1] * a, z[2] * a, z[3] * a + b],
      z.map((v) => -v),
    );
    return Float32Array.from({ length: 16 }, (_, k) => row[k % 4][k >> 2]);
  }

  function steer(stage, eye, ask, home) {
    let held = null;
    stage.addEventListener("pointerdown", (event) => {
      held = [event.clientX, event.clientY];
      stage.setPointerCapture(event.pointerId);
    });
    stage.addEventListener("pointerup", () => {
      held = null;
    });
    stage.addEventListener("contextmenu", (event) => event.preventDefault());
    stage.addEventListener("pointermove", (event) => {
      if (!held) return;
      const dx = event.clientX - held[0],
        dy = event.clientY - held[1];
      held = [event.clientX, event.clientY];
      if (event.shiftKey || event.buttons & 2) {
        const k = (2 * Math.tan(FIELD_RAD / 2) * eye.distance) / stage.clientHeight,
          a = across(eye),
          u = upward(eye);
        eye.pan = eye.pan.map((v, i) => v - dx * k * a[i] + dy * k * u[i]);
      } else {
        eye.yaw -= 0.006 * dx;
        eye.pitch = Math.min(Math.max(eye.pitch + 0.006 * dy, -1.55), 1.55);
      }
      ask();
    });
    stage.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        eye.distance = Math.min(
          Math.max(eye.distance * Math.exp(event.deltaY * (event.deltaMode ? 0.05 : 0.0012)), 5),
          20000,
        );
        ask();
      },
      { passive: false },
    );
    stage.addEventListener("dblclick", home);
  }
}
