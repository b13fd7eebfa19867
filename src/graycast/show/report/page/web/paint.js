"use strict";
// The views of a scene: each paints its picture and describes the meaning of its colours.

{
  const DARK = [58, 60, 66]; // the colour of missing values in maps
  const LIMITS_MM = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];

  Graycast.VIEWS = [
    { id: "color", label: "Colour" },
    { id: "white", label: "White frame" },
    { id: "pattern", label: "Pattern frames" },
    { id: "column", label: "Column map" },
    { id: "perfect", label: "Perfect depth" },
    { id: "scanner", label: "Scanner depth" },
    { id: "difference", label: "Difference" },
    { id: "reasons", label: "Reasons" },
    { id: "cloud", label: "3D" },
  ];

  /** Return the views for which a scene has data. */
  Graycast.viewsOf = (scene) => {
    const { rig, code } = Graycast.scannerOf(scene),
      any = scene.has.depth || scene.has.scanner;
    const has = {
      color: true,
      white: !!scene.white,
      pattern: scene.kept.frames.length > 0 || (!!code && any),
      column: scene.kept.columns.length > 0 || (!!rig && any),
      perfect: scene.has.depth,
      scanner: scene.has.scanner,
      difference: scene.has.depth && scene.has.scanner,
      reasons: scene.has.scanner,
      cloud: any,
    };
    return Graycast.VIEWS.filter((view) => has[view.id]);
  };

  /** Paint a view into RGBA bytes; if its data are missing, it is dark, and the note says why. */
  Graycast.paint = (scene, view, prefs, out) => {
    try {
      return painted(scene, view, prefs, out);
    } catch (error) {
      blank(scene, out);
      return { note: error.message };
    }
  };

  /** @type {Shared["paint"]} */
  function painted(scene, view, prefs, out) {
    switch (view) {
      case "color":
        out.set(scene.rgb);
        return {};
      case "white": {
        const table = brightened(prefs.gain);
        for (let i = 0; i < out.length; i++) out[i] = i % 4 === 3 ? 255 : table[scene.white[i]];
        return { note: `the scanner's white frame, ${SHOWN}` };
      }
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
  }

  const SHOWN = "black at the sensor's offset, white where it saturates, in sRGB";
  Graycast.GAINS = [1, 2, 4, 8, 16, 32];

  /** Return a table of sRGB levels for amplified light. */
  const brightened = (gain = 1) =>
    Uint8Array.from({ length: 256 }, (_, level) => Graycast.encoded(gain * Graycast.linear(level)));

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

  /** Return one range of colours for both depths, from 1 to 99 % of the pixels. */
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

  /** Return the error limit: the user's choice, else the first that covers the dataset's two sigma. */
  Graycast.errorLimit = (prefs) => {
    if (prefs.limit) return prefs.limit;
    const sigma = Graycast.report.statistics.part_error.sigma_mm ?? 0.3;
    return LIMITS_MM.find((l) => l >= 2 * sigma) ?? 50;
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
      note: "scanner minus perfect depth; red is too far",
    };
  }

  function paintReasons(scene, out) {
    const table = Graycast.reasonColors();
    for (let i = 0; i < scene.n; i++) put(out, i, table, 3 * scene.reason[i]);
    return {};
  }

  /** Return a hint that the dataset does not store some data, with the key that stores them. */
  const keeping = (kept, key, what) =>
    kept.length ? "" : ` (${what} are stored if the configuration has store: {${key}: true})`;
  const SAID = { scanner: "from the scanner's depth", depth: "from the perfect depth" };

  /** Return the sources of frames or positions, best first: stored, or computed from a depth. */
  Graycast.sourcesOf = (scene, view, prefs) => {
    const stored =
      view === "pattern" ? scene.kept.frames.length > 0 : scene.kept.columns.includes(prefs.axis);
    const known = Graycast.scannerOf(scene)[view === "pattern" ? "code" : "rig"];
    return [
      stored && "stored",
      known && scene.has.scanner && "scanner",
      known && scene.has.depth && "depth",
    ].filter(Boolean);
  };
  const source = (scene, view, prefs) => {
    const all = Graycast.sourcesOf(scene, view, prefs);
    return all.includes(prefs.source) ? prefs.source : all[0];
  };
  Graycast.sourceOf = source;

  /** Return the names of the frames in the pattern view. */
  Graycast.frameNames = (scene) =>
    scene.kept.frames.length
      ? scene.kept.frames
      : (Graycast.scannerOf(scene).code?.frames ?? []).map((frame) => frame.name);

  function blank(scene, out) {
    for (let i = 0; i < scene.n; i++) put(out, i, DARK, 0);
  }

  /** Paint a captured frame, which is the decoder's input. */
  function paintFrame(scene, prefs, out) {
    const n = scene.kept.frames.length,
      k = prefs.frame % n,
      levels = Graycast.frame(scene, k, Graycast.repaint);
    if (levels) Graycast.frame(scene, (k + 1) % n, Graycast.repaint); // This preloads the next frame.
    if (!levels) {
      blank(scene, out);
      return { note: "loading the captured frames …" };
    }
    const table = brightened(prefs.gain);
    for (let i = 0; i < scene.n; i++) {
      out[4 * i] = out[4 * i + 1] = out[4 * i + 2] = table[levels[i]];
      out[4 * i + 3] = 255;
    }
    const { bits, low_dn, high_dn, merged } = scene.frames.content;
    const kind = merged ? ", with the best exposure for each pixel, all on one scale" : "";
    const range = `${low_dn.toFixed(0)} to ${high_dn.toFixed(0)} DN`;
    return { shown: levels, note: `captured, ${bits} bit, ${range}${kind}; ${SHOWN}` };
  }

  /** Paint the stored decoded positions, or their standard deviations. */
  function paintStoredColumn(scene, prefs, out) {
    const maps = Graycast.columns(scene, Graycast.repaint);
    if (!maps) {
      blank(scene, out);
      return { note: "loading the code maps …" };
    }
    const values = maps[prefs.axis],
      axis = prefs.axis.replace("sigma_", "");
    if (prefs.axis !== axis) {
      const high = Graycast.highest(values, 0.99) || 1;
      paintMap(out, "viridis", scene.n, (i) => values[i] / high);
      return {
        bar: { map: "viridis", low: 0, high, unit: "projector px", digits: 3 },
        note: `standard deviation of the decoded ${axis}, as estimated by the decoder`,
      };
    }
    const size = projectorSize(scene, axis) ?? Graycast.highest(values, 1);
    paintMap(out, "viridis", scene.n, (i) => values[i] / size);
    return {
      bar: { map: "viridis", low: 0, high: size, unit: "projector px", digits: 0 },
      note: `projector ${axis} of each pixel as decoded`,
    };
  }

  const projectorSize = (scene, axis) => {
    const lens = Graycast.scannerOf(scene).rig?.projector;
    return axis === "row" ? lens?.height_px : lens?.width_px;
  };

  /** Return a quantile of a map, from every 7th pixel. */
  Graycast.highest = (values, share) => {
    const some = values.filter((v, i) => i % 7 === 0 && v === v).sort();
    return some[Math.min(Math.floor(share * some.length), some.length - 1)] ?? 0;
  };

  function paintColumn(scene, prefs, out) {
    const which = source(scene, "column", prefs);
    if (which === "stored") return paintStoredColumn(scene, prefs, out);
    const { column, row } = Graycast.projectorMap(scene, which);
    const upright = prefs.axis === "row";
    const values = upright ? row : column,
      size = projectorSize(scene, upright ? "row" : "column");
    paintMap(out, "viridis", scene.n, (i) => values[i] / size);
    return {
      bar: { map: "viridis", low: 0, high: size, unit: "projector px", digits: 0 },
      note: `projector ${upright ? "row" : "column"} of each pixel, computed ${SAID[which]} and the rig${keeping(scene.kept.columns, "columns", "decoded ones")}`,
    };
  }

  /** Paint a frame's ideal level at the projector position of each pixel. */
  function paintPattern(scene, prefs, out) {
    const which = source(scene, "pattern", prefs);
    if (which === "stored") return paintFrame(scene, prefs, out);
    const map = Graycast.projectorMap(scene, which);
    const { frames } = Graycast.scannerOf(scene).code,
      frame = frames[prefs.frame % frames.length];
    frame.table ??= Uint8Array.from(atob(frame.levels), (c) => c.charCodeAt(0));
    const at = frame.axis === "row" ? map.row : map.column,
      lit = scene.white && prefs.shade !== false,
      gain = prefs.gain ?? 1,
      light = Float32Array.from({ length: 256 }, (_, k) => (gain * Graycast.linear(k)) / 255);
    for (let i = 0; i < scene.n; i++) {
      if (map.column[i] !== map.column[i]) {
        put(out, i, DARK, 0);
        continue;
      }
      const level = frame.table[frame.axis ? Math.round(at[i]) : 0];
      const v = lit ? Graycast.encoded(level * light[scene.white[4 * i]]) : level;
      put(out, i, [v, v, v], 0);
    }
    return {
      note: `ideal bits, computed ${SAID[which]}: no blur, noise or stray light${which === "depth" ? ", no shadow" : ""}${keeping(scene.kept.frames, "frames", "captured frames")}`,
    };
  }

  /** Paint masks, their borders, and a highlighted reason or instance, which stays bright. */
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
