"use strict";
// One scene: a picture or the 3D view, the values under the pointer, what is in it.

{
  const { el, side, words } = Graycast;
  const prefs = Object.assign(Graycast.prefs, {
    view: "color",
    last: "perfect",
    masks: false,
    boxes: false,
    frame: 2,
    source: "stored",
    axis: "column",
    shade: true,
    limit: 0,
    surface: true,
    points: true,
    surfacePaint: "colour",
    pointPaint: "difference",
    pointSize: 1,
  });
  let open = null; // what is shown now

  Graycast.showScene = async (main, key, isCurrent) => {
    const row = Graycast.rows().find((one) => one.key === key);
    if (!row) throw new Error(`there is no scene ${key} in this report`);
    document.title = `${Graycast.report.name} ${row.id} · graycast`;
    document.getElementById("where").textContent =
      `${Graycast.report.name} / ${row.split} / ${row.id}`;
    const scene = await Graycast.load(key);
    if (!isCurrent()) return;
    Graycast.closeScene();
    const views = Graycast.viewsOf(scene);
    if (!views.some((view) => view.id === prefs.view)) prefs.view = views[0].id;
    open = { scene, row, views, lit: {}, viewer: null, cloud: null };
    pointed = -1;
    main.replaceChildren(
      el(
        "section",
        { class: "scene" },
        el(
          "div",
          { class: "left" },
          el("nav", { class: "tabs" }),
          el("div", { class: "options" }),
          el("div", { class: "hold" }),
          el("div", { class: "under" }),
        ),
        el(
          "aside",
          {},
          steps(key),
          el("table", { id: "readout" }),
          side.legend(row, { light, pick }),
          side.instances(scene, { light }),
          side.facts(scene, row),
        ),
      ),
    );
    open.viewer = Graycast.makeViewer(scene, point);
    show(main);
    side.readout(scene, -1);
    neighbours(key).forEach((next) => next && Graycast.load(next).catch(() => {}));
  };

  Graycast.closeScene = () => {
    play(false);
    if (open) Graycast.letGo(open.scene);
    open?.viewer?.close();
    open?.cloud?.close();
    open = null;
    Graycast.tip(null, "");
  };

  function neighbours(key) {
    let rows = Graycast.filtered();
    if (!rows.some((row) => row.key === key)) rows = Graycast.rows();
    const at = rows.findIndex((row) => row.key === key);
    return [rows[at - 1]?.key, rows[at + 1]?.key];
  }

  function steps(key) {
    const [before, after] = neighbours(key);
    return el(
      "div",
      { class: "steps" },
      el(
        "a",
        before ? { href: `#/${before}`, id: "before", title: "←" } : { class: "off" },
        "← previous",
      ),
      el("a", after ? { href: `#/${after}`, id: "after", title: "→" } : { class: "off" }, "next →"),
    );
  }

  // --- the picture --------------------------------------------------------------------------------

  function show(main = document.getElementById("main")) {
    if (prefs.view === "cloud" || (!prefs.masks && !prefs.boxes)) {
      open.lit.instance = -1;
      Graycast.tip(null, "");
    }
    if (prefs.view !== "pattern") play(false);
    const { scene, views, viewer } = open,
      at = (name) => main.querySelector(name);
    at(".tabs").replaceChildren(
      ...views.map((view) =>
        el(
          "button",
          {
            "data-view": view.id,
            "aria-pressed": String(view.id === prefs.view),
            onclick: () => pick(view.id),
          },
          el("kbd", {}, String(Graycast.VIEWS.findIndex((v) => v.id === view.id) + 1)),
          view.label,
        ),
      ),
    );
    at(".options").replaceChildren(...options().filter(Boolean));
    const three = prefs.view === "cloud";
    if (three) open.cloud ??= Graycast.makeCloud(scene);
    const stage = three ? open.cloud.stage : viewer.stage;
    if (at(".hold").firstChild !== stage) at(".hold").replaceChildren(stage);
    if (three) {
      open.cloud.draw(prefs);
      const bar =
        prefs.points && prefs.pointPaint === "difference"
          ? {
              map: "RdBu_r",
              low: -Graycast.errorLimit(prefs),
              high: Graycast.errorLimit(prefs),
              unit: "mm, scanner less perfect",
              digits: 1,
            }
          : null;
      at(".under").replaceChildren(
        ...under({ bar, note: "drag turns, shift-drag moves, wheel zooms, double click resets" }),
      );
    } else {
      repaint();
      viewer.cover(prefs, open.lit);
    }
  }

  /** The picture anew, its controls left as they are: a slider that is being moved stays. */
  function repaint() {
    if (!open || prefs.view === "cloud") return;
    const said = open.viewer.paint(prefs.view, prefs);
    document.querySelector("#main .under").replaceChildren(...under(said));
    side.readout(open.scene, pointed);
    for (const id of ["frame-slider", "choose-frame"]) {
      const control = document.getElementById(id);
      if (control) control.value = String(prefs.frame);
    }
  }
  Graycast.repaint = repaint;

  function pick(view) {
    if (view !== prefs.view) prefs.last = prefs.view;
    prefs.view = view;
    show();
  }

  const STORED = { pattern: "the camera", column: "the decoder" };
  const SOURCES = { scanner: "scanner's depth", depth: "perfect depth" };

  function options() {
    const { scene } = open,
      set = (name, value) => {
        prefs[name] = value;
        show();
      };
    const toggle = (name, label, key) =>
      el(
        "button",
        {
          id: `toggle-${name}`,
          "aria-pressed": String(!!prefs[name]),
          onclick: () => set(name, !prefs[name]),
        },
        key ? el("kbd", {}, key) : null,
        label,
      );
    const choose = (name, label, list) =>
      el(
        "label",
        {},
        label,
        el(
          "select",
          {
            id: `choose-${name}`,
            onchange: (event) => set(name, list.find(([v]) => String(v) === event.target.value)[0]),
          },
          list.map(([value, text]) =>
            el("option", { value, selected: prefs[name] === value }, text),
          ),
        ),
      );
    const view = prefs.view,
      both = scene.has.depth && scene.has.scanner;
    const sources = Graycast.sourcesOf(scene, view, prefs);
    const source =
      sources.length > 1
        ? choose(
            "source",
            "from",
            sources.map((one) => [one, one === "stored" ? STORED[view] : SOURCES[one]]),
          )
        : null;
    const limit = choose("limit", "±", [
      [0, `auto (${Graycast.errorLimit({})} mm)`],
      ...Graycast.ERROR_LIMITS_MM.map((mm) => [mm, `${mm} mm`]),
    ]);
    if (view === "cloud") {
      const look = (name) => el("button", { onclick: () => open.cloud.look(name) }, name);
      return [
        scene.has.depth ? toggle("surface", "perfect surface", "s") : null,
        scene.has.depth
          ? choose(
              "surfacePaint",
              "",
              ["colour", "reason", "instance", "shaded"].map((v) => [v, v]),
            )
          : null,
        scene.has.scanner ? toggle("points", "scanner points", "p") : null,
        scene.has.scanner
          ? choose(
              "pointPaint",
              "",
              ["difference", "colour", "instance", "depth", "plain"].map((v) => [v, v]),
            )
          : null,
        both && prefs.pointPaint === "difference" ? limit : null,
        choose(
          "pointSize",
          "size",
          [1, 2, 3, 4].map((v) => [v, `${v} px`]),
        ),
        scene.instances[0]?.box3d ? toggle("boxes", "boxes", "b") : null,
        el("span", { class: "spring" }),
        ...["camera", "oblique", "side", "top"].map(look),
      ];
    }
    const frames = Graycast.frameNames(scene);
    prefs.frame = Math.min(prefs.frame, Math.max(frames.length - 1, 0));
    return [
      toggle("masks", "masks", "m"),
      toggle("boxes", "boxes", "b"),
      view === "difference" ? limit : null,
      view === "column" ? choose("axis", "of", axes(scene)) : null,
      view === "column" || view === "pattern" ? source : null,
      ...(view === "pattern"
        ? [
            el("button", { id: "frame-back", title: "↑ or [", onclick: () => flip(-1) }, "‹"),
            el("input", {
              id: "frame-slider",
              type: "range",
              "aria-label": "frame",
              min: 0,
              max: frames.length - 1,
              value: prefs.frame,
              oninput: (event) => flip(Number(event.target.value) - prefs.frame),
            }),
            el("button", { id: "frame-on", title: "↓ or ]", onclick: () => flip(1) }, "›"),
            choose(
              "frame",
              "frame",
              frames.map((name, k) => [k, `${k} ${words(name)}`]),
            ),
            el(
              "button",
              {
                id: "frame-play",
                "aria-pressed": String(!!playing),
                onclick: () => play(!playing),
              },
              el("kbd", {}, "p"),
              "play",
            ),
            scene.white && Graycast.sourceOf(scene, view, prefs) !== "stored"
              ? toggle("shade", "over the white frame")
              : null,
          ]
        : []),
    ];
  }

  function axes(scene) {
    const all = [
      ["column", "column"],
      ["row", "row"],
      ["sigma_column", "σ of column"],
      ["sigma_row", "σ of row"],
    ];
    const there = all.filter(
      ([axis]) => scene.kept.columns.includes(axis) || !axis.startsWith("sigma_"),
    );
    if (!there.some(([axis]) => axis === prefs.axis)) prefs.axis = "column";
    return there;
  }

  function flip(by) {
    const n = Graycast.frameNames(open.scene).length;
    prefs.frame = (((prefs.frame + by) % n) + n) % n;
    repaint();
  }

  const PLAY_MS = 300;
  let playing = 0; // the timer that flips, 0 for none
  function play(on) {
    clearInterval(playing);
    // a frame that is still on its way is waited for
    const next = () => (open.scene.kept.frames.length && !open.scene.shown ? null : flip(1));
    playing = on ? setInterval(next, PLAY_MS) : 0;
    document.getElementById("frame-play")?.setAttribute("aria-pressed", String(!!playing));
  }

  function under({ bar, note }) {
    const out = [];
    if (bar) {
      const canvas = el("canvas", { width: 256, height: 1 }),
        image = new ImageData(256, 1),
        table = Graycast.colormap(bar.map);
      for (let k = 0; k < 256; k++)
        image.data.set([table[3 * k], table[3 * k + 1], table[3 * k + 2], 255], 4 * k);
      canvas.getContext("2d").putImageData(image, 0, 0);
      const say = (value) => value.toFixed(bar.digits).replace("-", "−");
      out.push(el("span", { class: "bar" }, say(bar.low), canvas, `${say(bar.high)} ${bar.unit}`));
      if (prefs.view !== "cloud" && !bar.whole)
        out.push(el("span", { class: "bar" }, el("i", { class: "none" }), "no value"));
    }
    if (note) out.push(el("span", { class: "note" }, note));
    return out;
  }

  // --- beside it --------------------------------------------------------------------------------

  function light(lit) {
    Object.assign(open.lit, lit);
    if (prefs.view !== "cloud") open.viewer.cover(prefs, open.lit);
  }

  let named = -1;
  let pointed = -1;
  function point(i, event) {
    if (!open) return;
    pointed = i;
    side.readout(open.scene, i);
    const k = i < 0 ? -1 : open.scene.instance[i] - 1,
      shown = prefs.masks || prefs.boxes;
    if (k !== named) {
      named = k;
      if (shown) light({ instance: k });
      document
        .querySelectorAll("#instances tr")
        .forEach((tr) => tr.classList.toggle("lit", tr.dataset.k === String(k)));
    }
    Graycast.tip(event, shown && k >= 0 ? `${k} ${open.scene.instances[k].name}` : "");
  }

  // --- keys -------------------------------------------------------------------------------------

  Graycast.sceneKey = (event) => {
    if (!open) return false;
    const press = (id) => document.getElementById(id)?.click();
    const view = Graycast.VIEWS[Number(event.key) - 1];
    if (view && open.views.includes(view)) pick(view.id);
    else if (event.key === "ArrowLeft") press("before");
    else if (event.key === "ArrowRight") press("after");
    else if (event.key === " ") {
      if (open.views.some((v) => v.id === prefs.last)) pick(prefs.last);
    } else if ("[]".includes(event.key) && open.views.some((v) => v.id === "pattern")) {
      if (prefs.view === "pattern") flip(event.key === "]" ? 1 : -1);
      else pick("pattern");
    } else if (prefs.view === "pattern" && event.key.startsWith("Arrow"))
      flip(event.key === "ArrowDown" ? 1 : -1);
    else if (event.key === "p" && prefs.view === "pattern") play(!playing);
    else if (event.key === "m") press("toggle-masks");
    else if (event.key === "b") press("toggle-boxes");
    else if (event.key === "s") press("toggle-surface");
    else if (event.key === "p") press("toggle-points");
    else if (event.key === "+" || event.key === "=") open.viewer.zoomAt(1.4);
    else if (event.key === "-") open.viewer.zoomAt(1 / 1.4);
    else if (event.key === "0") open.viewer.home();
    else return false;
    return true;
  };
  Graycast.redraw = () => {
    if (open) show();
  };
  Graycast.opened = () => open; // for whoever looks in from the console
}
