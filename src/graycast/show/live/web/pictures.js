"use strict";
// Layouts and pictures as they arrive from the server.

{
  const { live, prefs } = Graycast,
    { at } = live,
    main = at("main");

  /** Show the meshes and poses of another layout. */
  live.takeWorld = ({ header }, array) => {
    const each = (end, Type) =>
      Object.fromEntries(header.meshes.map((name) => [name, array(`${name}.${end}`, Type)]));
    live.bodies = {
      ...header,
      vertices: each("vertices", Float32Array),
      faces: each("faces", Uint32Array),
      places: array("places", Float32Array),
    };
    live.world?.bodies(live.bodies);
    if (live.scene) live.world?.draw(prefs);
  };

  function opaque(bytes, channels) {
    const n = bytes.length / channels,
      out = new Uint8ClampedArray(4 * n);
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < 3; k++) out[4 * i + k] = bytes[channels * i + (channels === 3 ? k : 0)];
      out[4 * i + 3] = 255;
    }
    return out;
  }

  /** Return a picture's maps, and empty places for what is derived from them. */
  function sceneOf(header, arrays, array) {
    return {
      width: header.width,
      height: header.height,
      full: [header.width, header.height],
      n: header.width * header.height,
      stride: 1,
      depth_scale_mm: header.depth_scale_mm,
      view: header.view,
      has: { depth: true, scanner: true },
      kept: { frames: header.frames, columns: [header.axis, `sigma_${header.axis}`] },
      instances: [],
      depth: array("depth", Uint16Array),
      scanner: array("scanner", Uint16Array),
      sigma: array("sigma", Float32Array),
      p_wrong: arrays.p_wrong ? array("p_wrong", Float32Array) : null,
      reason: array("reason", Uint8Array),
      instance: array("instance", Uint16Array),
      ...(arrays.rgb && { rgb: opaque(array("rgb", Uint8Array), 3) }),
      white: opaque(array("white", Uint8Array), 1),
      levels: array("frame", Uint8Array),
      positions: {
        [header.axis]: array("place", Float32Array),
        [`sigma_${header.axis}`]: array("place_sigma", Float32Array),
      },
      frames: { content: header },
      rays: null,
      range: null,
      projected: null,
      sigmaHigh: null,
    };
  }

  /** Show a newer picture with its maps. */
  live.takePicture = ({ header, arrays }, array) => {
    const before = live.header;
    live.header = { ...header, values: { ...header.values, ...live.state.values } };
    prefs.axis = prefs.axis.startsWith("sigma_") ? `sigma_${header.axis}` : header.axis;
    prefs.frame = header.frame;
    Graycast.report.scanners[""] = { rig: header.rig, code: null };
    Graycast.report.statistics.part_error.sigma_mm = header.figures.sigma_mm;
    const next = sceneOf(header, arrays, array);
    const resized =
      !live.scene || live.scene.width !== next.width || live.scene.height !== next.height;
    if (resized) {
      next.rgb ??= opaque(new Uint8Array(3 * next.n), 3);
      live.scene = next;
      live.held = null;
    } else Object.assign(live.scene, next);
    if (live.held) live.held.range = Graycast.depthRange(live.scene);
    if (!live.world) live.makeWorld();
    if (resized) live.remakeViewer();
    live.world.show(live.header);
    if (before?.number !== header.number || header.exact) at("doing").textContent = "";
    live.show();
    count(header);
  };

  /** Record the time from the user's action to the first picture. */
  function count({ number, kind, first }) {
    live.painted += 1;
    for (const one of live.latencies)
      if (one.number === number && one.ms === null && first) {
        one.ms = performance.now() - one.since;
        one.change = kind;
      }
    live.latencies = live.latencies.filter((one) => one.number >= number || one.ms !== null);
    main.dataset.shown = number;
    if (number > Number(main.dataset.failed || -1)) main.classList.remove("stale");
    main.dataset.exact = String(live.header.exact);
    main.dataset.ready = "live";
  }

  Graycast.frame = (of, k) => (k === of.frames.content.frame ? of.levels : null);
  Graycast.columns = (of) => of.positions;
}
