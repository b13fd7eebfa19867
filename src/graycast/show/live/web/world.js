"use strict";
// The cell in 3D: the bin, the parts, both fields of view, their common volume and the scanned
// points. The rig can be dragged around the point at which it looks.

{
  const { el } = Graycast;
  const LINES = {
    camera: [40, 110, 200],
    projector: [225, 120, 30],
    common: [40, 150, 90],
    baseline: [20, 20, 20],
  };
  const GRAB_PX = 26,
    DEG_PER_PX = 0.35;

  const unit = Float32Array.of(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1);

  /**
   * Make the 3D view: {stage, show(scene), bodies(world), draw(prefs), look(name)}. While the rig is
   * dragged, `drag(changes, draft)` is called with settings.
   */
  Graycast.makeWorld = (scene, drag) => {
    const space = Graycast.shapes.space(scene);
    const { yaw, distance } = space.views.camera;
    const halfway = Graycast.toWorld(scene, 0, 0, 0).map((v, k) => (v - space.middle[k]) / 2);
    space.views.all = { yaw: yaw + 0.9, pitch: 0.35, distance: 3.1 * distance, pan: halfway };
    space.start = { ...space.views.all, distance: 2.2 * distance }; // Rig and bin fill the view.
    let world = null, // the meshes as received
      fresh = true,
      things = null,
      lines = {},
      prefs = {},
      header = null;
    const put = (place) => {
      const out = Float32Array.from(place);
      space.middle.forEach((v, k) => (out[12 + k] -= v));
      return out;
    };

    /** Return the bodies on the GPU; they are uploaded again if they have changed. */
    const bodies = (gl) => (now) => {
      const { body, drop, lines: drawn } = Graycast.shapes,
        out = [];
      if (fresh && world) {
        if (things) Object.values(things).forEach((thing) => drop(gl, thing));
        things = Object.fromEntries(
          world.meshes.map((name) => [name, body(gl, world.vertices[name], world.faces[name])]),
        );
        fresh = false;
      }
      if (header && header !== lines.of) {
        Object.values(lines.things ?? {}).forEach((thing) => drop(gl, thing));
        lines = { of: header, things: {} };
        for (const [name, points] of Object.entries(header.lines)) {
          const placed = Float32Array.from(points, (v, k) => v - space.middle[k % 3]);
          if (placed.length) lines.things[name] = drawn(gl, placed, LINES[name]);
        }
      }
      if (things) {
        if (things.bin && now.bin)
          out.push({ thing: things.bin, place: put(unit), tint: Graycast.shapes.BIN, open: true });
        if (now.parts)
          world.kinds.forEach((kind, k) =>
            out.push({
              thing: things[`part${kind}`],
              place: put(world.places.subarray(16 * k, 16 * k + 16)),
              tint: Graycast.instanceColor(k).map((v) => v / 255),
            }),
          );
      }
      for (const [name, thing] of Object.entries(lines.things ?? {}))
        if (now[name === "baseline" ? "camera" : name]) out.push({ thing, lines: true });
      return out;
    };

    const cloud = Graycast.makeCloud(scene, { space, bodies, perfect: false });
    const { stage } = cloud;

    /** Show the points of another picture; a map of reasons also needs points without depth. */
    const swap = () => {
      const everywhere = prefs.pointPaint === "reason";
      const shown = everywhere ? { ...scene, scanner: scene.depth } : scene;
      const point = Graycast.shapes.pointOf(shown);
      space.point = (i, step) => point(i, step).map((v, k) => v - space.middle[k]);
      cloud.swap(shown);
    };

    // --- dragging the rig -------------------------------------------------------------------------

    const handles = () => {
      const points = header?.lines.baseline ?? [];
      return [points.slice(0, 3), points.slice(3, 6)]
        .filter((point) => point.length)
        .map((point) => cloud.onScreen(point.map((v, k) => v - space.middle[k])))
        .filter(Boolean);
    };
    const near = (event) => {
      const box = stage.getBoundingClientRect();
      return handles().some(
        ([x, y]) => Math.hypot(event.clientX - box.left - x, event.clientY - box.top - y) < GRAB_PX,
      );
    };
    let held = null;
    stage.addEventListener(
      "pointerdown",
      (event) => {
        if (event.button !== 0 || !near(event)) return;
        event.stopPropagation();
        stage.setPointerCapture(event.pointerId);
        const { values } = header;
        held = {
          x: event.clientX,
          y: event.clientY,
          tilt: values["view.tilt_deg"],
          azimuth: values["view.azimuth_deg"],
          distance: values["view.distance_m"],
        };
      },
      true,
    );
    const turned = (event) => {
      const dx = event.clientX - held.x,
        dy = event.clientY - held.y;
      if (event.shiftKey)
        return { "view.distance_m": Number((held.distance * Math.exp(-0.004 * dy)).toFixed(4)) };
      const azimuth = (((held.azimuth + dx * DEG_PER_PX + 180) % 360) + 360) % 360;
      return {
        "view.azimuth_deg": Number((azimuth - 180).toFixed(2)),
        "view.tilt_deg": Number(Math.min(Math.max(held.tilt + dy * DEG_PER_PX, 0), 80).toFixed(2)),
      };
    };
    stage.addEventListener(
      "pointermove",
      (event) => {
        stage.style.cursor = held || near(event) ? "move" : "";
        if (!held) return;
        event.stopPropagation();
        drag(turned(event), true);
      },
      true,
    );
    stage.addEventListener(
      "pointerup",
      (event) => {
        if (!held) return;
        const last = turned(event),
          moved = event.clientX !== held.x || event.clientY !== held.y;
        held = null;
        if (moved) drag(last, false);
      },
      true,
    );

    return {
      stage,
      handles,
      look: cloud.look,
      close: cloud.close,
      /** Show the bodies of another layout. */
      bodies(next) {
        world = next;
        fresh = true;
      },
      /** Show a new picture. */
      show(next) {
        header = next;
        swap();
        cloud.draw(prefs);
      },
      draw(next) {
        const other = (next.pointPaint === "reason") !== (prefs.pointPaint === "reason");
        prefs = { ...next };
        if (other && header) swap();
        cloud.draw(prefs);
      },
    };
  };

  /** Return the row of options below the 3D view. */
  Graycast.worldOptions = (prefs, set, look) => {
    const paints = ["instance", "difference", "sigma", "reason", "colour", "depth"];
    const named = { instance: "parts", sigma: "σ", reason: "reasons", colour: "picture" };
    const toggle = (name, label) =>
      el(
        "button",
        {
          "data-toggle": name,
          "aria-pressed": String(prefs[name]),
          onclick: () => set(name, !prefs[name]),
        },
        label,
      );
    return [
      el(
        "label",
        {},
        "points by",
        el(
          "select",
          { id: "choose-points", onchange: (event) => set("pointPaint", event.target.value) },
          paints.map((name) =>
            el("option", { value: name, selected: name === prefs.pointPaint }, named[name] ?? name),
          ),
        ),
      ),
      ...[
        ["points", "points"],
        ["parts", "parts"],
        ["bin", "bin"],
        ["camera", "camera"],
        ["projector", "projector"],
        ["common", "common volume"],
      ].map(([name, label]) => toggle(name, label)),
      el("span", {}, "look from"),
      ...[
        ["all", "afar"],
        ["oblique", "near"],
        ["side", "the side"],
        ["top", "above"],
        ["camera", "the camera"],
      ].map(([name, label]) =>
        el("button", { "data-look": name, onclick: () => look(name) }, label),
      ),
      el("span", {}, "drag turns; drag the rig (black line) to move it, with shift its distance"),
    ];
  };
}
