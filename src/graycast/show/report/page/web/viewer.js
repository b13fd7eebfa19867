"use strict";
// Pictures that can be zoomed and moved, with masks and boxes over them: one picture, or two
// pictures side by side or on top of each other with a bar to swipe.

{
  const { el } = Graycast;
  const HOLD_PX = 12; // The bar can be grabbed within this distance.

  /**
   * Make a viewer for one scene, with onPointer(pixel index or -1, event). The second picture may
   * belong to another scene whose pictures have the same size.
   */
  Graycast.makeViewer = (scene, onPointer, other = scene) => {
    const { width, height } = scene;
    const panes = [makePane(scene, ""), makePane(other, "-2")];
    const swipe = el("div", {
      id: "swipe",
      role: "slider",
      tabindex: 0,
      "aria-label": "where the two pictures meet",
      "aria-valuemin": 0,
      "aria-valuemax": 100,
    });
    const stage = el("div", { class: "stage" }, ...panes.map((pane) => pane.element), swipe);
    let zoom = 1,
      x = 0,
      y = 0,
      fit = 1,
      drag = null,
      cut = 0.5,
      how = "single",
      fitted = "";

    const room = () => `${stage.clientWidth} ${stage.clientHeight}`;
    const wide = () => stage.clientWidth / (how === "side" ? 2 : 1);
    const place = () => {
      const scale = fit * zoom;
      for (const { sheet } of panes) {
        sheet.style.width = `${width}px`;
        sheet.style.height = `${height}px`;
        sheet.style.transform = `translate(${x}px,${y}px) scale(${scale})`;
        sheet.classList.toggle("crisp", scale * devicePixelRatio >= 2);
        sheet.style.setProperty("--thin", `${1.3 / scale}px`);
      }
      const at = how === "swipe" ? cut * stage.clientWidth : 0;
      panes[1].element.style.clipPath = how === "swipe" ? `inset(0 0 0 ${at}px)` : "";
      swipe.style.left = `${at}px`;
      swipe.setAttribute("aria-valuenow", String(Math.round(100 * cut)));
    };
    const home = () => {
      fit = Math.min(wide() / width, stage.clientHeight / height) || 1;
      fitted = room();
      zoom = 1;
      x = (wide() - width * fit) / 2;
      y = (stage.clientHeight - height * fit) / 2;
      place();
    };
    /** Show the whole picture again if the size of the stage has changed. */
    const settle = () => {
      if (room() !== fitted) home();
    };
    const zoomAt = (factor, px = wide() / 2, py = stage.clientHeight / 2) => {
      const next = Math.min(Math.max(zoom * factor, 1), 60),
        k = next / zoom;
      if (next === 1) return home();
      x = px - (px - x) * k;
      y = py - (py - y) * k;
      zoom = next;
      place();
    };
    /** Return the position of an event in its pane, and the pane. */
    const spot = (event) => {
      const box = stage.getBoundingClientRect(),
        right = how === "side" && event.clientX - box.left >= wide();
      return {
        px: event.clientX - box.left - (right ? wide() : 0),
        py: event.clientY - box.top,
        right,
      };
    };
    const point = (event) => {
      const { px, py, right } = spot(event),
        scale = fit * zoom;
      const c = Math.floor((px - x) / scale),
        r = Math.floor((py - y) / scale);
      const on = c >= 0 && r >= 0 && c < width && r < height;
      panes.forEach(({ cross }, k) => {
        cross.hidden = how !== "side" || !on || right === (k === 1);
        cross.style.transform = `translate(${px}px,${py}px)`;
      });
      onPointer(on ? r * width + c : -1, event);
    };
    stage.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const { px, py } = spot(event);
        zoomAt(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0016)), px, py);
        point(event);
      },
      { passive: false },
    );
    stage.addEventListener("pointerdown", (event) => {
      drag = [event.clientX - x, event.clientY - y];
      stage.setPointerCapture(event.pointerId);
    });
    stage.addEventListener("pointermove", (event) => {
      if (drag && event.buttons) {
        [x, y] = [event.clientX - drag[0], event.clientY - drag[1]];
        place();
      }
      point(event);
    });
    stage.addEventListener("pointerup", () => {
      drag = null;
    });
    stage.addEventListener("pointerleave", (event) => {
      for (const { cross } of panes) cross.hidden = true;
      onPointer(-1, event);
    });
    stage.addEventListener("dblclick", home);
    holdSwipe(stage, swipe, (share) => {
      cut = Math.min(Math.max(share(cut), 0), 1);
      place();
    });
    const watch = new ResizeObserver(settle);
    watch.observe(stage);

    return {
      stage,
      home,
      settle,
      zoomAt,
      close: () => watch.disconnect(),
      /** Show one or two `views`; return the result of `Graycast.paint` for each. */
      paint(views, prefs) {
        const next = views.length > 1 ? prefs.how : "single",
          resized = (next === "side") !== (how === "side");
        how = next;
        stage.dataset.how = how;
        if (resized) home();
        else place();
        return views.map((view, k) => panes[k].paint(view, prefs, views.length > 1));
      },
      cover(prefs, lit) {
        for (const pane of panes.slice(0, how === "single" ? 1 : 2)) pane.cover(prefs, lit);
      },
    };
  };

  /** Return one picture with its overlays; `end` is the suffix of its elements' ids. */
  function makePane(scene, end) {
    const { width, height } = scene;
    const base = el("canvas", { width, height, id: `picture${end}` }),
      over = el("canvas", { width, height, id: `overlay${end}` });
    const boxes = el("svg", {
      viewBox: `0 0 ${width} ${height}`,
      id: `boxes${end}`,
      class: "boxes",
    });
    const found = el("svg", {
      viewBox: `0 0 ${width} ${height}`,
      id: `found${end}`,
      class: "found",
    });
    const sheet = el("div", { class: "sheet" }, base, over, boxes, found),
      name = el("span", { class: "pane-name" }),
      cross = el("i", { class: "cross", hidden: true });
    const image = new ImageData(width, height),
      veil = new ImageData(width, height);
    return {
      element: el("div", { class: "pane" }, sheet, cross, name),
      sheet,
      cross,
      paint(view, prefs, named) {
        const said = Graycast.paint(scene, view, prefs, image.data);
        base.getContext("2d").putImageData(image, 0, 0);
        name.textContent = named ? Graycast.VIEWS.find((one) => one.id === view).label : "";
        return said;
      },
      cover(prefs, lit) {
        Graycast.paintOverlay(scene, prefs, lit, veil.data);
        over.getContext("2d").putImageData(veil, 0, 0);
        drawBoxes(scene, boxes, prefs, lit.instance ?? -1);
        Graycast.found.draw(scene, found, prefs, lit);
      },
    };
  }

  /** Let the bar follow the pointer that grabbed it, and the arrow keys while it has the focus. */
  function holdSwipe(stage, swipe, move) {
    const to = (event) => {
      const box = stage.getBoundingClientRect();
      move(() => (event.clientX - box.left) / box.width);
    };
    swipe.style.width = `${2 * HOLD_PX}px`;
    swipe.addEventListener("pointerdown", (event) => {
      event.stopPropagation();
      swipe.setPointerCapture(event.pointerId);
      to(event);
    });
    swipe.addEventListener("pointermove", (event) => {
      if (!swipe.hasPointerCapture(event.pointerId)) return;
      event.stopPropagation();
      to(event);
    });
    swipe.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      move((share) => share + step);
    });
  }

  /** Draw BOP's boxes [x, y, last - first, ...], which end at pixel centres, around whole pixels. */
  function drawBoxes(scene, svg, prefs, instance) {
    const s = scene.stride,
      drawn = [];
    scene.instances.forEach((one, k) => {
      if ((!prefs.boxes && k !== instance) || one.box[2] < 0) return;
      const color = `rgb(${Graycast.instanceColor(k).join()})`,
        strong = k === instance ? " strong" : "";
      const rect = ([bx, by, bw, bh], name) =>
        el("rect", {
          class: name + strong,
          stroke: color,
          x: bx / s,
          y: by / s,
          width: (bw + 1) / s,
          height: (bh + 1) / s,
        });
      drawn.push(rect(one.box, "visible"));
      if (k === instance && one.amodal?.[2] >= 0) drawn.push(rect(one.amodal, "amodal"));
    });
    svg.replaceChildren(...drawn);
  }
}
