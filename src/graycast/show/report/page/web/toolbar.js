"use strict";
// The rows above a scene's picture: its views, a view for comparison, and the options of the view.

{
  const { el, words } = Graycast;
  const STORED = { pattern: "the camera", column: "the decoder" };
  const SOURCES = { scanner: "scanner's depth", depth: "perfect depth" };
  const SURFACE = [
    ["instance", "parts"],
    ["colour", "picture"],
    ["reason", "reasons"],
    ["shaded", "grey"],
  ];
  const POINTS = [
    ["instance", "parts"],
    ["difference", "difference"],
    ["colour", "picture"],
    ["depth", "depth"],
    ["plain", "grey"],
  ];
  const FUSED = [
    ["colour", "picture"],
    ["views", "number of views"],
    ["view", "which view"],
    ["sigma", "σ"],
    ["first", "why the first lacks it"],
    ["plain", "grey"],
  ];
  const AXES = [
    ["column", "column"],
    ["row", "row"],
    ["sigma_column", "σ of column"],
    ["sigma_row", "σ of row"],
  ];
  /** @type {Toolbar} */
  const bar = /** @type {any} */ ({});
  Graycast.toolbar = bar;

  /** Return a button per view; in narrow windows, its name lacks the part in brackets. */
  bar.views = (views, prefs, pick) =>
    views.map((view) =>
      el(
        "button",
        {
          "data-view": view.id,
          title: view.label,
          "aria-pressed": String(view.id === prefs.view),
          onclick: () => pick(view.id),
        },
        el("kbd", {}, String(Graycast.VIEWS.indexOf(view) + 1)),
        view.label.split(" ")[0],
        view.label.includes(" ")
          ? el("span", { class: "long" }, view.label.slice(view.label.indexOf(" ")))
          : null,
      ),
    );

  /** Return a choice of the scene's pictures; it is empty if there is only one. */
  bar.pictures = (row, go) => {
    const all = Graycast.siblings(row);
    if (all.length < 2) return [];
    return [
      el(
        "label",
        { title: "another view or scanner of this scene (n)" },
        "picture",
        el(
          "select",
          {
            id: "choose-picture",
            "aria-label": "picture",
            onchange: (event) => go(event.target.value),
          },
          all.map((one) => el("option", { value: one.key, selected: one === row }, one.picture)),
        ),
      ),
    ];
  };

  /** Return the buttons of the comparison: off, or another view, swiped or side by side. */
  bar.compare = (views, prefs, set) => {
    const flat = views.filter((view) => view.id !== "cloud");
    if (prefs.view === "cloud" || flat.length < 2) return [];
    return [
      toggle(prefs, set, "compare", "compare", "c", "two views of this scene, pixel by pixel"),
      ...(prefs.compare
        ? [
            choose(
              prefs,
              set,
              "second",
              "",
              flat.map((view) => [view.id, view.label]),
            ),
            choose(prefs, set, "how", "", [
              ["swipe", "swipe"],
              ["side", "side by side"],
            ]),
          ]
        : []),
    ];
  };

  /** Return the options of the view. actions: set(name, value), flip(by), play(), look(name). */
  bar.options = (scene, prefs, actions) =>
    (prefs.view === "cloud" ? cloudOptions : pictureOptions)(scene, prefs, actions).filter(Boolean);

  function toggle(prefs, set, name, label, key, title) {
    return el(
      "button",
      {
        id: `toggle-${name}`,
        title,
        "aria-pressed": String(!!prefs[name]),
        onclick: () => set(name, !prefs[name]),
      },
      key ? el("kbd", {}, key) : null,
      label,
    );
  }

  function choose(prefs, set, name, label, list) {
    return el(
      "label",
      {},
      label,
      el(
        "select",
        {
          id: `choose-${name}`,
          "aria-label": label || name,
          onchange: (event) => set(name, list.find(([v]) => String(v) === event.target.value)[0]),
        },
        list.map(([value, text]) => el("option", { value, selected: prefs[name] === value }, text)),
      ),
    );
  }

  /** Return a choice of the factor of light for white and pattern frames. */
  bar.brightness = (prefs, set) =>
    choose(
      prefs,
      set,
      "gain",
      "brightness",
      Graycast.GAINS.map((gain) => [gain, `× ${gain}`]),
    );

  const limit = (prefs, set) =>
    choose(prefs, set, "limit", "±", [
      [0, `auto (${Graycast.errorLimit({})} mm)`],
      ...Graycast.ERROR_LIMITS_MM.map((mm) => [mm, `${mm} mm`]),
    ]);

  function cloudOptions(scene, prefs, { set, look }) {
    const { depth, scanner } = scene.has,
      sizes = [1, 2, 3, 4].map((v) => [v, `${v} px`]);
    return [
      depth ? toggle(prefs, set, "surface", "perfect surface", "s") : null,
      depth ? choose(prefs, set, "surfacePaint", "", SURFACE) : null,
      scanner ? toggle(prefs, set, "points", "scanner points", "p") : null,
      scanner ? choose(prefs, set, "pointPaint", "", POINTS) : null,
      scanner ? choose(prefs, set, "pointSize", "", sizes) : null,
      scene.fusedKey ? toggle(prefs, set, "fused", "fused cloud", "f") : null,
      scene.fusedKey && prefs.fused ? choose(prefs, set, "fusedPaint", "", FUSED) : null,
      depth && scanner && prefs.pointPaint === "difference" ? limit(prefs, set) : null,
      scene.instances[0]?.box3d ? toggle(prefs, set, "boxes", "boxes", "b") : null,
      binButton(prefs, set),
      el("span", { class: "spring" }),
      ...["camera", "oblique", "side", "top"].map((name) =>
        el("button", { title: `look from: ${name}`, onclick: () => look(name) }, name),
      ),
    ];
  }

  function binButton(prefs, set) {
    const { bin } = Graycast.report;
    if (!bin?.missing) return bin ? toggle(prefs, set, "bin", "bin", "w") : null;
    return el("button", { id: "toggle-bin", disabled: true, title: bin.missing }, "no bin");
  }

  function pictureOptions(scene, prefs, actions) {
    const { set } = actions,
      shows = (view) => prefs.view === view || (prefs.compare && prefs.second === view);
    return [
      toggle(prefs, set, "masks", "masks", "m"),
      toggle(prefs, set, "boxes", "boxes", "b"),
      ...foundOptions(scene, prefs, actions),
      shows("difference") ? limit(prefs, set) : null,
      shows("column") ? choose(prefs, set, "axis", "of", axes(scene, prefs)) : null,
      shows("column") ? source(scene, prefs, set, "column") : null,
      ...(shows("pattern") ? patternOptions(scene, prefs, actions) : []),
      shows("white") || shows("pattern") ? bar.brightness(prefs, set) : null,
    ];
  }

  function foundOptions(scene, prefs, { set, rescore }) {
    if (!scene.found) return [];
    const title = "what the detector found, and what it missed";
    return [
      toggle(prefs, set, "found", "detections", "d", title),
      prefs.found ? choose(prefs, set, "foundKind", "", Graycast.found.KINDS) : null,
      prefs.found ? Graycast.found.slider("score-slider", prefs, rescore) : null,
    ];
  }

  function source(scene, prefs, set, view) {
    const all = Graycast.sourcesOf(scene, view, prefs);
    if (all.length < 2) return null;
    return choose(
      prefs,
      set,
      "source",
      "from",
      all.map((one) => [one, one === "stored" ? STORED[view] : SOURCES[one]]),
    );
  }

  function patternOptions(scene, prefs, { set, flip, play, playing }) {
    const frames = Graycast.frameNames(scene);
    prefs.frame = Math.min(prefs.frame, Math.max(frames.length - 1, 0));
    return [
      prefs.view === "column" || prefs.second === "column"
        ? null
        : source(scene, prefs, set, "pattern"),
      el(
        "button",
        { id: "frame-back", title: "frame before (↑ or [)", onclick: () => flip(-1) },
        "‹",
      ),
      el("input", {
        id: "frame-slider",
        type: "range",
        "aria-label": "frame",
        min: 0,
        max: frames.length - 1,
        value: prefs.frame,
        oninput: (event) => flip(Number(event.target.value) - prefs.frame),
      }),
      el("button", { id: "frame-on", title: "next frame (↓ or ])", onclick: () => flip(1) }, "›"),
      choose(
        prefs,
        set,
        "frame",
        "",
        frames.map((name, k) => [k, `${k} ${words(name)}`]),
      ),
      el(
        "button",
        { id: "frame-play", "aria-pressed": String(playing), onclick: play },
        el("kbd", {}, "p"),
        "play",
      ),
      scene.white && Graycast.sourceOf(scene, "pattern", prefs) !== "stored"
        ? toggle(prefs, set, "shade", "over the white frame")
        : null,
    ];
  }

  function axes(scene, prefs) {
    const there = AXES.filter(
      ([axis]) => scene.kept.columns.includes(axis) || !axis.startsWith("sigma_"),
    );
    if (!there.some(([axis]) => axis === prefs.axis)) prefs.axis = "column";
    return there;
  }

  /** Return the meaning of the colours, with a line for each displayed picture. */
  bar.under = (said, names) =>
    said.flatMap(({ bar: scale, note }, k) => {
      if (!scale && !note) return [];
      const out = said.length > 1 ? [el("b", {}, names[k])] : [];
      if (scale) {
        out.push(el("span", { class: "bar" }, ...scaleBar(scale)));
        if (!scale.whole)
          out.push(el("span", { class: "bar" }, el("i", { class: "none" }), "no value"));
      }
      if (note) out.push(el("span", { class: "note" }, note));
      return el("div", {}, out);
    });

  function scaleBar({ map, low, high, unit, digits }) {
    const canvas = el("canvas", { width: 256, height: 1 }),
      image = new ImageData(256, 1),
      table = Graycast.colormap(map);
    for (let k = 0; k < 256; k++)
      image.data.set([table[3 * k], table[3 * k + 1], table[3 * k + 2], 255], 4 * k);
    canvas.getContext("2d").putImageData(image, 0, 0);
    const say = (value) => value.toFixed(digits).replace("-", "−");
    return [say(low), canvas, `${say(high)} ${unit}`];
  }
}
