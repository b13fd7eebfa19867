"use strict";
// The scene in 3D with plain WebGL 2: the perfect surface as a mesh, the scanner's points, and
// moving bodies. The frame has the axes of the world (z up), in millimetres, about the centre of
// the camera's view.

{
  const { el } = Graycast;
  const FIELD_RAD = 0.55;
  const LIT = ["instance", "plain"]; // With these colours, points are shaded like the surface.
  const FUSED_LIT = ["colour", "plain"],
    FUSED_PX = 2, // Smaller points would let the background show through.
    FUSED_GROUND = 0.4; // The ground is dark, because most bins and tables are pale.
  const VERTEX = `#version 300 es
    uniform mat4 uClip;
    uniform mat4 uPlace;
    uniform float uSize;
    in vec3 aPlace;
    in vec4 aColor;
    in vec3 aNormal;
    out vec3 vPlace;
    out vec3 vNormal;
    out vec4 vColor;
    void main() {
      vPlace = (uPlace * vec4(aPlace, 1.0)).xyz;
      vNormal = aNormal;
      vColor = aColor;
      gl_Position = uClip * vec4(vPlace, 1.0);
      gl_PointSize = uSize;
    }`;
  // Lines have no normal, so their shade is NaN, which no other kind has. Bodies (2) have one
  // colour and flat faces, with normals computed from the points of each face.
  const FRAGMENT = `#version 300 es
    precision highp float;
    uniform vec3 uEye;
    uniform float uShade;
    uniform vec3 uTint;
    in vec3 vPlace;
    in vec3 vNormal;
    in vec4 vColor;
    out vec4 color;
    void main() {
      bool body = uShade > 1.5;
      vec3 normal = body ? cross(dFdx(vPlace), dFdy(vPlace)) : vNormal;
      float facing = abs(dot(normalize(normal), normalize(uEye - vPlace)));
      color = vec4((body ? uTint : vColor.rgb) * (uShade > 0.5 ? 0.45 + 0.55 * facing : 1.0), 1.0);
    }`;

  const STILL = Float32Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1);

  /**
   * Make a 3D view of a scene: {stage, draw(prefs), look(name), swap(scene), onScreen(point), close()}.
   * `space` is a result of `shapes.space`; null uses that of the scene. `bodies(gl, space)` returns
   * a function that lists, for each picture, {thing, place (a matrix), tint, open (only its front
   * is drawn), share (of its colour in a pixel)} or lines {thing, lines: true}. `perfect` also
   * shows the perfect surface and the boxes.
   */
  Graycast.makeCloud = (scene, { space = null, bodies = null, perfect = true } = {}) => {
    const canvas = el("canvas", { id: "cloud" }),
      stage = el("div", { class: "stage cloud" }, canvas);
    const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    let refused = gl ? null : "This browser has no WebGL 2, which the 3D view needs.";
    try {
      space ??= Graycast.shapes.space(scene);
    } catch (error) {
      refused = error.message;
    }
    if (refused) {
      stage.append(el("p", { class: "sorry" }, refused));
      return { stage, draw() {}, look() {}, swap() {}, onScreen: () => null, close() {} };
    }
    const program = link(gl),
      shapes = Graycast.shapes,
      moving = bodies?.(gl, space);
    const where = Object.fromEntries(
      ["uClip", "uPlace", "uSize", "uEye", "uShade", "uTint"].map((name) => [
        name,
        gl.getUniformLocation(program, name),
      ]),
    );
    const surface = perfect && scene.has.depth ? shapes.mesh(gl, scene, space) : null;
    let points = scene.has.scanner ? shapes.cloud(gl, scene, space) : null;
    let fused = null; // the points of all pictures of the scene, loaded on demand
    const boxes = perfect && scene.instances[0]?.box3d ? shapes.edges(gl, scene, space) : null;
    const eye = { pan: [0, 0, 0], ...space.start };
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
      const ground = background().map((v) => (fused && prefs.fused ? FUSED_GROUND * v : v));
      gl.clearColor(...ground, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      gl.useProgram(program);
      gl.uniformMatrix4fv(where.uClip, false, clip(eye, place, w / h, space.reach));
      gl.uniform3fv(where.uEye, place);
      gl.uniformMatrix4fv(where.uPlace, false, STILL);
      const put = (thing, kind, shade, size = prefs.pointSize ?? 2) => {
        gl.uniform1f(where.uShade, shade);
        gl.uniform1f(where.uSize, size * devicePixelRatio);
        gl.bindVertexArray(thing.array);
        if (thing.index) gl.drawElements(kind, thing.count, gl.UNSIGNED_INT, 0);
        else gl.drawArrays(kind, 0, thing.count);
      };
      gl.enable(gl.CULL_FACE); // Walls can be seen through from behind.
      if (surface && prefs.surface !== false) put(surface, gl.TRIANGLES, 1);
      gl.disable(gl.CULL_FACE);
      if (points && prefs.points !== false)
        put(points, gl.POINTS, LIT.includes(prefs.pointPaint) ? 1 : 0);
      if (fused && prefs.fused) {
        const shade = FUSED_LIT.includes(prefs.fusedPaint) ? 1 : 0;
        put(fused, gl.POINTS, shade, Math.max(prefs.pointSize, FUSED_PX));
      }
      if (boxes && prefs.boxes) put(boxes, gl.LINES, 0);
      for (const body of moving?.(prefs) ?? []) {
        if (body.lines) {
          gl.uniformMatrix4fv(where.uPlace, false, STILL);
          put(body.thing, gl.LINES, 0);
          continue;
        }
        gl.uniformMatrix4fv(where.uPlace, false, body.place ?? STILL);
        gl.uniform3fv(where.uTint, body.tint);
        if (body.open) gl.enable(gl.CULL_FACE);
        else gl.disable(gl.CULL_FACE);
        if (body.share) mix(gl, body.share);
        put(body.thing, gl.TRIANGLES, 2);
        if (body.share) mix(gl, 0);
      }
    };
    /** Load the fused cloud, or update its colours. */
    const fuse = () => {
      if (scene.fusing?.error) return;
      const cloud = Graycast.fused(scene, Graycast.redraw);
      if (cloud) fused ??= shapes.fused(gl, cloud, space);
      if (fused && fused.paint !== prefs.fusedPaint)
        shapes.paintFused(gl, fused, cloud, prefs.fusedPaint);
    };
    const ask = () => {
      if (!queued) {
        queued = true;
        requestAnimationFrame(render);
      }
    };
    steer(stage, eye, ask, () => {
      Object.assign(eye, { pan: [0, 0, 0] }, space.start);
      ask();
    });
    const watch = new ResizeObserver(ask);
    watch.observe(stage);
    return {
      stage,
      draw(next) {
        if (surface && next.surfacePaint !== surface.paint)
          shapes.recolor(gl, scene, surface, next.surfacePaint, next);
        const key = `${next.pointPaint} ${Graycast.errorLimit(next)}`;
        if (points && key !== points.paint) {
          shapes.recolor(gl, scene, points, next.pointPaint, next);
          points.paint = key;
        }
        prefs = next;
        if (scene.fusedKey && next.fused) fuse();
        ask();
      },
      /** Return the meaning of the fused cloud's colours. */
      fusedWords() {
        if (scene.fusing?.error) return { note: scene.fusing.error.message };
        return fused
          ? shapes.fusedWords(scene.fusing.cloud, prefs.fusedPaint)
          : { note: "loading the cloud …" };
      },
      /** Show the points of another scan from the same viewpoint, without moving the eye. */
      swap(next) {
        scene = next;
        if (points) shapes.drop(gl, points);
        points = scene.has.scanner ? shapes.cloud(gl, scene, space) : null;
      },
      /** Return the position of a point on the stage [px]; null if it is behind the eye. */
      onScreen(point) {
        const m = clip(eye, eyePlace(eye), stage.clientWidth / stage.clientHeight, space.reach);
        const [x, y, , w] = [0, 1, 2, 3].map(
          (k) => m[k] * point[0] + m[k + 4] * point[1] + m[k + 8] * point[2] + m[k + 12],
        );
        if (w <= 0) return null;
        return [((x / w + 1) / 2) * stage.clientWidth, ((1 - y / w) / 2) * stage.clientHeight];
      },
      look(name) {
        Object.assign(eye, { pan: [0, 0, 0] }, space.views[name]);
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
    gl.bindAttribLocation(program, 2, "aNormal");
    gl.linkProgram(program);
    return program;
  }

  /** Blend the next body with the picture behind it; surfaces in its plane take precedence. */
  function mix(gl, share) {
    for (const what of [gl.BLEND, gl.POLYGON_OFFSET_FILL])
      share ? gl.enable(what) : gl.disable(what);
    gl.depthMask(!share);
    gl.blendColor(0, 0, 0, share);
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    gl.polygonOffset(1, 1);
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
    const scaled = (axis, k) => [axis[0] * k, axis[1] * k, axis[2] * k, dot(axis) * k];
    const row = [scaled(right, f / aspect), scaled(up, f)];
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
