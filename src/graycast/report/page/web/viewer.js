"use strict";
// A picture that can be zoomed and moved, with masks and boxes over it.

{
  const { el } = Graycast;

  /** Makes a viewer for one scene. onPointer(pixel index or -1, event). */
  Graycast.makeViewer = (scene, onPointer) => {
    const { width, height } = scene;
    const base = el("canvas", { width, height, id: "picture" }),
      over = el("canvas", { width, height, id: "overlay" });
    const boxes = el("svg", { viewBox: `0 0 ${width} ${height}`, id: "boxes" });
    const sheet = el("div", { class: "sheet" }, base, over, boxes),
      stage = el("div", { class: "stage", tabindex: 0 }, sheet);
    const image = new ImageData(width, height),
      veil = new ImageData(width, height);
    let zoom = 1,
      x = 0,
      y = 0,
      fit = 1,
      drag = null,
      moved = false;

    const place = () => {
      const scale = fit * zoom;
      sheet.style.width = `${width}px`;
      sheet.style.height = `${height}px`;
      sheet.style.transform = `translate(${x}px,${y}px) scale(${scale})`;
      sheet.classList.toggle("crisp", scale * devicePixelRatio >= 2);
      boxes.style.setProperty("--thin", `${1.3 / scale}px`);
    };
    const home = () => {
      fit = Math.min(stage.clientWidth / width, stage.clientHeight / height) || 1;
      zoom = 1;
      x = (stage.clientWidth - width * fit) / 2;
      y = (stage.clientHeight - height * fit) / 2;
      place();
    };
    const zoomAt = (factor, px = stage.clientWidth / 2, py = stage.clientHeight / 2) => {
      const next = Math.min(Math.max(zoom * factor, 1), 60),
        k = next / zoom;
      if (next === 1) return home();
      x = px - (px - x) * k;
      y = py - (py - y) * k;
      zoom = next;
      place();
    };
    const at = (event) => {
      const box = stage.getBoundingClientRect(),
        scale = fit * zoom;
      const c = Math.floor((event.clientX - box.left - x) / scale),
        r = Math.floor((event.clientY - box.top - y) / scale);
      return c >= 0 && r >= 0 && c < width && r < height ? r * width + c : -1;
    };
    stage.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const box = stage.getBoundingClientRect();
        zoomAt(
          Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0016)),
          event.clientX - box.left,
          event.clientY - box.top,
        );
        onPointer(at(event), event);
      },
      { passive: false },
    );
    stage.addEventListener("pointerdown", (event) => {
      drag = [event.clientX - x, event.clientY - y];
      moved = false;
      stage.setPointerCapture(event.pointerId);
    });
    stage.addEventListener("pointermove", (event) => {
      if (drag && event.buttons) {
        [x, y] = [event.clientX - drag[0], event.clientY - drag[1]];
        moved = true;
        place();
      }
      onPointer(at(event), event);
    });
    stage.addEventListener("pointerup", () => {
      drag = null;
    });
    stage.addEventListener("pointerleave", (event) => onPointer(-1, event));
    stage.addEventListener("dblclick", home);
    const watch = new ResizeObserver(home);
    watch.observe(stage);

    return {
      stage,
      home,
      zoomAt,
      close: () => watch.disconnect(),
      paint(view, prefs) {
        const said = Graycast.paint(scene, view, prefs, image.data);
        base.getContext("2d").putImageData(image, 0, 0);
        return said;
      },
      cover(prefs, lit) {
        Graycast.paintOverlay(scene, prefs, lit, veil.data);
        over.getContext("2d").putImageData(veil, 0, 0);
        drawBoxes(scene, boxes, prefs, lit.instance ?? -1);
      },
    };
  };

  /** BOP's boxes span pixel centres: [x, y, last - first, ...]; drawn around whole pixels. */
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
