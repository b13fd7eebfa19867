"use strict";
// One scene: its pictures or the 3D view, the values at the pointer, and its content.

{
  const { el, side, tags, toolbar } = Graycast;
  const prefs = Object.assign(Graycast.prefs, {
    view: "color",
    last: "perfect",
    compare: false,
    second: "scanner",
    how: "swipe",
    masks: false,
    boxes: false,
    frame: 2,
    source: "stored",
    axis: "column",
    shade: true,
    gain: 1,
    limit: 0,
    surface: true,
    points: true,
    surfacePaint: "instance",
    pointPaint: "difference", // Its colours differ from those of the surface.
    pointSize: 1,
    bin: true,
    fused: false,
    fusedPaint: "colour",
    found: true,
    foundKind: "all",
    score: Graycast.report?.detections?.score ?? 0.5,
  });
  let open = null; // the scene that is shown

  Graycast.showScene = async (main, key, isCurrent) => {
    const row = Graycast.rows().find((one) => one.key === key);
    if (!row) throw new Error(`there is no scene ${key} in this report`);
    document.title = `${Graycast.report.name} ${row.id} · graycast`;
    document.getElementById("where").textContent =
      `${Graycast.report.name} / ${row.split} / scene ${row.id}` +
      (row.picture ? ` / ${row.picture}` : "");
    const [scene, found] = await Promise.all([Graycast.load(key), Graycast.bringFound(key)]);
    if (!isCurrent()) return;
    Graycast.closeScene();
    Graycast.cameFrom(key);
    scene.found = found;
    scene.fusedKey = row.picture ? Graycast.siblings(row)[0].key : null;
    const views = Graycast.viewsOf(scene);
    if (!views.some((view) => view.id === prefs.view)) prefs.view = views[0].id;
    open = { scene, row, views, lit: {}, viewer: null, cloud: null };
    pointed = -1;
    document.getElementById("steps").replaceChildren(...steps(key));
    main.replaceChildren(
      el(
        "section",
        { class: "scene" },
        el(
          "div",
          { class: "toolbars" },
          el("nav", { class: "tabs" }),
          el("div", { class: "options" }),
        ),
        el("div", { class: "left" }, el("div", { class: "hold" }), el("div", { class: "under" })),
        el(
          "aside",
          {},
          el("div", { id: "tags" }),
          el("table", { id: "readout" }),
          side.legend(row, { light, pick }),
          el("div", { id: "found-list" }),
          side.instances(scene, { light }),
          side.facts(scene, row),
        ),
      ),
    );
    showTags();
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
    document.getElementById("steps").replaceChildren();
    Graycast.tip(null, "");
  };

  /** Return the filtered scenes, or all scenes if this one is not among them. */
  function around(key) {
    const rows = Graycast.filtered();
    return rows.some((row) => row.key === key) ? rows : Graycast.rows();
  }

  function neighbours(key) {
    const rows = around(key),
      at = rows.findIndex((row) => row.key === key);
    return [rows[at - 1]?.key, rows[at + 1]?.key];
  }

  function steps(key) {
    const [before, after] = neighbours(key),
      rows = around(key),
      at = rows.findIndex((row) => row.key === key);
    const narrowed = rows.length < Graycast.rows().length ? " filtered" : "";
    const link = (to, id, title, text) =>
      el("a", to ? { href: `#/${to}`, id, title } : { class: "off" }, text);
    return [
      link(before, "before", "previous scene (←)", "← previous"),
      el("span", {}, `${at + 1} of ${rows.length}${narrowed}`),
      link(after, "after", "next scene (→)", "next →"),
    ];
  }

  // --- the picture --------------------------------------------------------------------------------

  const views = () => (prefs.compare ? [prefs.view, prefs.second] : [prefs.view]);

  function show(main = document.getElementById("main")) {
    if (prefs.view === "cloud" || (!prefs.masks && !prefs.boxes)) {
      open.lit.instance = -1;
      Graycast.tip(null, "");
    }
    settleSecond();
    if (!views().includes("pattern") || prefs.view === "cloud") play(false);
    const { scene, viewer } = open,
      at = (name) => main.querySelector(name);
    at(".tabs").replaceChildren(
      ...toolbar.pictures(open.row, (key) => (location.hash = `#/${key}`)),
      ...toolbar.views(open.views, prefs, pick),
      el("span", { class: "spring" }),
      ...toolbar.compare(open.views, prefs, set),
    );
    at(".options").replaceChildren(
      ...toolbar.options(scene, prefs, {
        set,
        flip,
        play: () => play(!playing),
        playing: !!playing,
        look: (name) => open.cloud.look(name),
        rescore,
      }),
    );
    const list = Graycast.found.list(scene, prefs, { light });
    at("#found-list").replaceChildren(...list);
    const three = prefs.view === "cloud";
    at("#readout").hidden = three; // In 3D, the pointer selects no pixel.
    if (three) open.cloud ??= Graycast.makeCloud(scene, { bodies: Graycast.wallsOf(scene) });
    const stage = three ? open.cloud.stage : viewer.stage;
    if (at(".hold").firstChild !== stage) at(".hold").replaceChildren(stage);
    if (three) {
      open.cloud.draw(prefs);
      at(".under").replaceChildren(...toolbar.under([cloudWords()], []));
    } else {
      repaint();
      viewer.settle(); // It must be done now, since a caller may point as soon as it is `ready`.
      viewer.cover(prefs, open.lit);
    }
  }

  /** Make the second view one of this scene's views that differs from the first. */
  function settleSecond() {
    const others = open.views
      .map((view) => view.id)
      .filter((id) => id !== "cloud" && id !== prefs.view);
    if (!others.length) prefs.compare = false;
    else if (!others.includes(prefs.second))
      prefs.second = others.includes(prefs.last) ? prefs.last : others[0];
  }

  function cloudWords() {
    const limit = Graycast.errorLimit(prefs),
      difference = prefs.points && prefs.pointPaint === "difference";
    const fused = prefs.fused && open.cloud.fusedWords?.();
    if (fused) return fused;
    return {
      bar: difference
        ? {
            map: "RdBu_r",
            low: -limit,
            high: limit,
            unit: "mm, scanner minus perfect",
            digits: 1,
            whole: true,
          }
        : null,
      note: "drag to turn, shift-drag to move, wheel to zoom, double-click to start again",
    };
  }

  /** Paint the pictures again without replacing their controls, as the user may be moving a slider. */
  function repaint() {
    if (!open || prefs.view === "cloud") return;
    const said = open.viewer.paint(views(), prefs);
    open.scene.shown = said.find((one) => one.shown)?.shown ?? null;
    const names = views().map((id) => Graycast.VIEWS.find((view) => view.id === id).label);
    document.querySelector("#main .under").replaceChildren(...toolbar.under(said, names));
    side.readout(open.scene, pointed);
    for (const id of ["frame-slider", "choose-frame"]) {
      const control = /** @type {HTMLInputElement} */ (document.getElementById(id));
      if (control) control.value = String(prefs.frame);
    }
  }
  Graycast.repaint = repaint;

  function set(name, value) {
    if (name === "second" && value === prefs.view) prefs.view = prefs.second; // They swap places.
    if (name === "fused" && value) prefs.points = prefs.surface = false; // Fused points hide these.
    prefs[name] = value;
    show();
  }

  function pick(view) {
    if (view !== prefs.view) prefs.last = prefs.view;
    prefs.view = view;
    show();
  }

  /** Change the score threshold without replacing its slider, as the user may be moving it. */
  function rescore(value) {
    prefs.score = value;
    open.viewer.cover(prefs, open.lit);
    const list = Graycast.found.list(open.scene, prefs, { light });
    document.getElementById("found-list").replaceChildren(...list);
  }

  function flip(by) {
    const n = Graycast.frameNames(open.scene).length;
    prefs.frame = (((prefs.frame + by) % n) + n) % n;
    repaint();
  }

  const PLAY_MS = 300;
  let playing = 0; // the timer that flips frames; 0 if stopped
  function play(on) {
    clearInterval(playing);
    // A frame that is still loading is not skipped.
    const next = () => (open.scene.kept.frames.length && !open.scene.shown ? null : flip(1));
    playing = on ? setInterval(next, PLAY_MS) : 0;
    document.getElementById("frame-play")?.setAttribute("aria-pressed", String(!!playing));
  }

  // --- next to the picture ------------------------------------------------------------------------

  function showTags() {
    const { key } = open.row,
      done = (act) => (value) => {
        act([key], value);
        showTags();
      };
    document.getElementById("tags").replaceChildren(
      ...side.tags(key, {
        add: done(tags.add),
        remove: done(tags.remove),
        tick: done(() => tags.tick(key)),
      }),
    );
  }

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
        .forEach((/** @type {HTMLElement} */ tr) =>
          tr.classList.toggle("lit", tr.dataset.k === String(k)),
        );
    }
    Graycast.tip(event, shown && k >= 0 ? `${k} ${open.scene.instances[k].name}` : "");
  }

  function nextPicture() {
    const all = Graycast.siblings(open.row),
      next = all[(all.indexOf(open.row) + 1) % all.length];
    if (next !== open.row) location.hash = `#/${next.key}`;
  }

  // --- keys -------------------------------------------------------------------------------------

  /** Return the view of a digit key; with shift, the key's character is not the digit. */
  function digit(event) {
    const view = Graycast.VIEWS[Number(event.code.match(/^(?:Digit|Numpad)(\d)$/)?.[1]) - 1];
    return open.views.includes(view) ? view.id : null;
  }

  Graycast.sceneKey = (event) => {
    if (!open) return false;
    const press = (id) => document.getElementById(id)?.click();
    const view = digit(event);
    if (view && event.shiftKey && view !== "cloud" && prefs.view !== "cloud") {
      prefs.compare = true;
      set("second", view);
    } else if (view && !event.shiftKey) pick(view);
    else if (event.key === "ArrowLeft") press("before");
    else if (event.key === "ArrowRight") press("after");
    else if (event.key === " ") {
      if (open.views.some((v) => v.id === prefs.last)) pick(prefs.last);
    } else if ("[]".includes(event.key) && open.views.some((v) => v.id === "pattern")) {
      if (views().includes("pattern")) flip(event.key === "]" ? 1 : -1);
      else pick("pattern");
    } else if (views().includes("pattern") && event.key.startsWith("Arrow"))
      flip(event.key === "ArrowDown" ? 1 : -1);
    else if (event.key === "p" && prefs.view === "cloud") press("toggle-points");
    else if (event.key === "p") press("frame-play");
    else if (event.key === "c") press("toggle-compare");
    else if (event.key === "v" && prefs.compare && prefs.view !== "cloud")
      set("how", prefs.how === "swipe" ? "side" : "swipe");
    else if (event.key === "f" && prefs.view === "cloud") press("toggle-fused");
    else if (event.key === "n") nextPicture();
    else if (event.key === "m") press("toggle-masks");
    else if (event.key === "b") press("toggle-boxes");
    else if (event.key === "d") press("toggle-found");
    else if (event.key === "s") press("toggle-surface");
    else if (event.key === "w") press("toggle-bin");
    else if (event.key === "x") press("tick-scene");
    else if (event.key === "g") document.getElementById("tag-scene").focus();
    else if (event.key === "+" || event.key === "=") open.viewer.zoomAt(1.4);
    else if (event.key === "-") open.viewer.zoomAt(1 / 1.4);
    else if (event.key === "0") open.viewer.home();
    else return false;
    return true;
  };
  Graycast.redraw = () => {
    if (open) show();
  };
  Graycast.opened = () => open; // for use in the browser's console
}
