"use strict";
// The column next to a scene: values at the pointer, reasons, instances, and facts of the scene.

{
  const { el, percent, words } = Graycast;
  /** @type {Side} */
  const side = /** @type {any} */ ({});
  Graycast.side = side;

  /** Fill the table of values for pixel `i`; -1 means no pixel. */
  side.readout = (scene, i) => {
    const s = scene.depth_scale_mm,
      digits = s < 0.1 ? 2 : 1;
    const on = i >= 0,
      depth = on && scene.depth[i],
      scan = on && scene.scanner[i],
      k = on ? scene.instance[i] - 1 : -1;
    const reason =
      on && scene.has.scanner
        ? Graycast.report.reasons.find((r) => r.number === scene.reason[i])
        : null;
    const map = on && scan && Graycast.scannerOf(scene).rig ? positions(scene) : null;
    const lines = [
      [
        "pixel",
        on
          ? `${(i % scene.width) * scene.stride}, ${Math.floor(i / scene.width) * scene.stride}`
          : "–",
      ],
      ["perfect", depth ? Graycast.mm(depth * s, digits) : "–"],
      ["scanner", scan ? Graycast.mm(scan * s, digits) : "–"],
      ["difference", depth && scan ? `${Graycast.signed((scan - depth) * s, digits)} mm` : "–"],
      [
        "reason",
        reason ? [el("i", { style: `background:${reason.color}` }), words(reason.name)] : "–",
      ],
      [
        "column, row",
        map && map.column[i] === map.column[i]
          ? `${map.column[i].toFixed(1)}, ${map.row[i].toFixed(1)} px`
          : "–",
      ],
      ...["column", "row"]
        .filter((axis) => scene.kept.columns.includes(axis))
        .map((axis) => [`decoded ${axis}`, decoded(scene, axis, i)]),
      ["white frame", on && scene.white ? white(scene, i) : "–"],
      ...(scene.shown ? [["this frame", on ? captured(scene, i) : "–"]] : []),
      ["instance", k >= 0 ? `${k} ${scene.instances[k].name}` : "–"],
    ];
    document
      .getElementById("readout")
      .replaceChildren(
        ...lines.map(([name, value]) =>
          el("tr", { "data-name": name }, el("th", {}, name), el("td", {}, value)),
        ),
      );
  };

  /** Return each pixel's projector position; null if the lens has no inverse. */
  function positions(scene) {
    try {
      return Graycast.projectorMap(scene, "scanner");
    } catch {
      return null;
    }
  }

  /** Return the decoded position if the column map has been opened, which loads it. */
  function decoded(scene, axis, i) {
    const maps = scene.columns?.maps,
      value = maps?.[axis][i];
    if (!maps) return "open Column map";
    return i >= 0 && value === value
      ? `${value.toFixed(2)} ± ${maps[`sigma_${axis}`][i].toFixed(2)} px`
      : "–";
  }

  /** Return the level in the dataset, which is linear. */
  const white = (scene, i) => `≈ ${Math.round(255 * Graycast.linear(scene.white[4 * i]))} of 255`;

  /** Return a frame's digital number, with the precision of 8 bits and JPEG. */
  function captured(scene, i) {
    const { low_dn, high_dn } = scene.frames.content,
      share = Graycast.linear(scene.shown[i]);
    return `≈ ${Math.round(low_dn + (high_dn - low_dn) * share)} DN`;
  }

  /** Return the scene's tags and its tick; actions: add(tags), remove(tag), tick(). */
  side.tags = (key, { add, remove, tick }) => {
    const { tags } = Graycast,
      ticked = tags.ticked.has(key);
    return [
      el(
        "button",
        {
          id: "tick-scene",
          title: "tick this scene, to save or tag it with others",
          "aria-pressed": String(ticked),
          onclick: tick,
        },
        el("kbd", {}, "x"),
        ticked ? "ticked" : "tick",
      ),
      tags.field("tag-scene", add),
      ...tags.chips(
        tags.of(key).map((tag) => [tag]),
        remove,
      ),
    ];
  };

  /** Return the scene's reasons; actions.light highlights one, actions.pick opens their view. */
  side.legend = (row, { light, pick }) => {
    return el(
      "div",
      { id: "reasons" },
      el("p", { class: "note" }, row.part_reasons ? "parts · all pixels" : "all pixels"),
      Graycast.report.reasons
        .filter((r) => row.reasons[r.name])
        .map((r) =>
          el(
            "div",
            {
              title: r.meaning,
              onpointerenter: () => light({ reason: r.number }),
              onpointerleave: () => light({ reason: null }),
              onclick: () => pick("reasons"),
            },
            el("i", { style: `background:${r.color}` }),
            el("span", {}, words(r.name)),
            el(
              "em",
              {},
              row.part_reasons ? `${percent(row.part_reasons[r.name] ?? 0)} · ` : "",
              percent(row.reasons[r.name]),
            ),
          ),
        ),
    );
  };

  /** Return the list of instances; actions.light highlights an instance in the picture. */
  side.instances = (scene, { light }) => {
    const rows = scene.instances.map((one, k) =>
      el(
        "tr",
        {
          "data-k": k,
          onpointerenter: () => light({ instance: k }),
          onpointerleave: () => light({ instance: -1 }),
        },
        el(
          "td",
          {},
          el("i", { style: `background:rgb(${Graycast.instanceColor(k).join()})` }),
          String(k),
        ),
        el("td", {}, one.name),
        el("td", {}, percent(one.visible, 0)),
        el("td", {}, String(one.area)),
        el("td", {}, one.t ? one.t[2].toFixed(0) : "–"),
      ),
    );
    return el(
      "div",
      { id: "instances" },
      el(
        "table",
        {},
        el(
          "thead",
          {},
          el(
            "tr",
            {},
            [
              ["", ""],
              ["part", ""],
              ["visible", "visible share of its silhouette"],
              ["pixels", "visible pixels"],
              ["z mm", "its distance from the camera's plane"],
            ].map(([name, title]) => el("th", { title }, name)),
          ),
        ),
        el("tbody", {}, rows),
      ),
    );
  };

  /** Return facts of the scene from its manifest. */
  side.facts = (scene, row) => {
    const m = scene.manifest,
      list = [["decoded on parts", percent(row.part_decoded)]];
    if (row.sigma_mm !== null)
      list.push([
        "scanner on parts",
        `σ ${row.sigma_mm.toFixed(2)}, median ${Graycast.signed(row.bias_mm, 2)} mm`,
      ]);
    if (m.exposure_s) list.push(["exposure", `${(1000 * m.exposure_s).toPrecision(3)} ms`]);
    if (m.backend) list.push(["rendered by", `${m.backend} on ${m.device}`]);
    if (m.physics)
      list.push([
        "physics",
        `${m.physics.at_rest ? "at rest" : "NOT at rest"}, overlap ${(1000 * m.physics.deepest_penetration_m).toFixed(2)} mm`,
      ]);
    if (m.timings)
      list.push([
        "made in",
        `${Object.values(m.timings)
          .reduce((a, b) => a + b, 0)
          .toFixed(1)} s`,
      ]);
    list.push(
      [
        "picture",
        `${scene.full.join(" × ")} px${scene.stride > 1 ? `, every ${scene.stride}. pixel here` : ""}`,
      ],
      ["depth step", `${scene.depth_scale_mm} mm`],
    );
    return el(
      "dl",
      { class: "scene-facts" },
      list.map(([term, value]) => [el("dt", {}, term), el("dd", {}, value)]),
    );
  };
}
