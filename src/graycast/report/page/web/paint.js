"use strict";
// The views of a scene: each paints its picture and says what its colours mean.

{
  const DARK = [58, 60, 66]; // no value, in maps of numbers
  const LIMITS_MM = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];

  Graycast.VIEWS = [
    { id: "color", label: "Colour" },
    { id: "white", label: "White frame" },
    { id: "pattern", label: "Pattern bits" },
    { id: "column", label: "Column map" },
    { id: "perfect", label: "Perfect depth" },
    { id: "scanner", label: "Scanner depth" },
    { id: "difference", label: "Difference" },
    { id: "reasons", label: "Reasons" },
    { id: "cloud", label: "3D" },
  ];

  /** Which views a scene has anything for. */
  Graycast.viewsOf = (scene) => {
    const rig = Graycast.report.claim.rig,
      any = scene.has.depth || scene.has.scanner;
    const has = {
      color: true,
      white: !!scene.white,
      pattern: !!Graycast.report.code && any,
      column: !!rig && any,
      perfect: scene.has.depth,
      scanner: scene.has.scanner,
      difference: scene.has.depth && scene.has.scanner,
      reasons: scene.has.scanner,
      cloud: any,
    };
    return Graycast.VIEWS.filter((view) => has[view.id]);
  };

  /** Paint a view into RGBA bytes; returns {bar: {map, low, high, unit}, note}. */
  Graycast.paint = (scene, view, prefs, out) => {
    switch (view) {
      case "color":
        out.set(scene.rgb);
        return {};
      case "white":
        out.set(scene.white);
        return { note: "the scanner's white frame, linear, share of the sensor's range" };
      case "reasons":
        return paintReasons(scene, out);
      case "pattern":
        return paintPattern(scene, prefs, out);
      case "column":
        return paintColumn(scene, prefs, out);
      case "difference":
        return paintDifference(scene, prefs, out);
      default:
        return paintDepth(scene, view === "perfect" ? scene.depth : scene.scanner, out);
    }
  };

  function paintMap(out, map, n, share) {
    const table = Graycast.colormap(map);
    for (let i = 0; i < n; i++) {
      const s = share(i);
      if (s !== s) put(out, i, DARK, 0);
      else put(out, i, table, 3 * Math.max(0, Math.min(255, Math.round(255 * s))));
    }
  }
  function put(out, i, from, at) {
    out[4 * i] = from[at];
    out[4 * i + 1] = from[at + 1];
    out[4 * i + 2] = from[at + 2];
    out[4 * i + 3] = 255;
  }

  /** One range for both depths, so that flipping between them compares; 1 to 99 % of the pixels. */
  Graycast.depthRange = (scene) => {
    if (scene.range) return scene.range;
    const steps = scene.has.depth ? scene.depth : scene.scanner,
      some = [];
    for (let i = 0; i < scene.n; i += 37) if (steps[i]) some.push(steps[i]);
    some.sort((a, b) => a - b);
    const at = (q) =>
      (some[Math.min(Math.floor(q * some.length), some.length - 1)] ?? 0) * scene.depth_scale_mm;
    return (scene.range = [at(0.01), Math.max(at(0.99), at(0.01) + 1)]);
  };

  function paintDepth(scene, steps, out) {
    const [low, high] = Graycast.depthRange(scene),
      scale = scene.depth_scale_mm / (high - low),
      base = low / (high - low);
    paintMap(out, "viridis_r", scene.n, (i) => (steps[i] ? steps[i] * scale - base : NaN));
    return { bar: { map: "viridis_r", low, high, unit: "mm", digits: 0 } };
  }

  /** The limit in force: as chosen, else the first that holds two sigma of the dataset. */
  Graycast.errorLimit = (prefs) => {
    const sigma = Graycast.report.statistics.part_error.sigma_mm ?? 0.3;
    return prefs.limit || (LIMITS_MM.find((l) => l >= 2 * sigma) ?? 50);
  };
  Graycast.ERROR_LIMITS_MM = LIMITS_MM;

  function paintDifference(scene, prefs, out) {
    const limit = Graycast.errorLimit(prefs),
      scale = scene.depth_scale_mm / (2 * limit);
    paintMap(out, "RdBu_r", scene.n, (i) =>
      scene.scanner[i] && scene.depth[i] ? 0.5 + (scene.scanner[i] - scene.depth[i]) * scale : NaN,
    );
    return {
      bar: { map: "RdBu_r", low: -limit, high: limit, unit: "mm", digits: limit < 1 ? 1 : 0 },
      note: "scanner less perfect depth; red is too far",
    };
  }

  function paintReasons(scene, out) {
    const table = Graycast.reasonColors();
    for (let i = 0; i < scene.n; i++) put(out, i, table, 3 * scene.reason[i]);
    return {};
  }

  const source = (scene, prefs) =>
    (prefs.source === "depth" && scene.has.depth) || !scene.has.scanner ? "depth" : "scanner";
  const SAID = { scanner: "from the scanner's depth", depth: "from the perfect depth" };

  function paintColumn(scene, prefs, out) {
    const which = source(scene, prefs),
      { column, row } = Graycast.projectorMap(scene, which);
    const lens = Graycast.report.claim.rig.projector,
      upright = prefs.axis === "row";
    const values = upright ? row : column,
      size = upright ? lens.height_px : lens.width_px;
    paintMap(out, "viridis", scene.n, (i) => values[i] / size);
    return {
      bar: { map: "viridis", low: 0, high: size, unit: "projector px", digits: 0 },
      note: `projector ${upright ? "row" : "column"} of each pixel, worked out ${SAID[which]} and the rig`,
    };
  }

  /** What a frame would show at the projector position of every pixel. */
  function paintPattern(scene, prefs, out) {
    const which = source(scene, prefs),
      map = Graycast.projectorMap(scene, which);
    const { frames } = Graycast.report.code,
      frame = frames[prefs.frame % frames.length];
    frame.table ??= Uint8Array.from(atob(frame.levels), (c) => c.charCodeAt(0));
    const at = frame.axis === "row" ? map.row : map.column,
      lit = scene.white && prefs.shade !== false;
    for (let i = 0; i < scene.n; i++) {
      if (map.column[i] !== map.column[i]) {
        put(out, i, DARK, 0);
        continue;
      }
      const level = frame.table[frame.axis ? Math.round(at[i]) : 0];
      const v = lit ? (level * scene.white[4 * i]) / 255 : level;
      put(out, i, [v, v, v], 0);
    }
    return {
      note: `ideal bits, looked up ${SAID[which]}: not the captured frames, which the dataset does not store (no blur, noise or stray light${which === "depth" ? ", no shadow" : ""})`,
    };
  }

  /** Masks in colours, their borders, and what a highlighted reason or instance leaves bright. */
  Graycast.paintOverlay = (scene, prefs, { instance = -1, reason = null }, out) => {
    const w = scene.width,
      id = scene.instance;
    out.fill(0);
    const masks = prefs.masks;
    if (!masks && instance < 0 && reason === null) return;
    const colors = scene.instances.map((_, k) => Graycast.instanceColor(k));
    for (let i = 0; i < scene.n; i++) {
      if (reason !== null && scene.reason[i] !== reason) {
        out[4 * i + 3] = 190;
        continue;
      }
      const k = id[i] - 1;
      if (k < 0 || (!masks && k !== instance)) continue;
      const border =
        id[i] !== id[i - 1] || id[i] !== id[i + 1] || id[i] !== id[i - w] || id[i] !== id[i + w];
      const c = colors[k];
      out[4 * i] = c[0];
      out[4 * i + 1] = c[1];
      out[4 * i + 2] = c[2];
      out[4 * i + 3] = border ? 255 : !masks ? 0 : k === instance ? 130 : 75;
    }
  };
}
