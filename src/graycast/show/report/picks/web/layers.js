"use strict";
// The options above the 3D view: what it draws, its colours and its viewpoints.

{
  const { el, prefs, replay } = Graycast;

  /** Show the options with their present values. */
  replay.showLayers = () => {
    const toggle = (name, key, label, title) =>
      el(
        "button",
        {
          id: `toggle-${name}`,
          title,
          "aria-pressed": String(!!prefs[name]),
          onclick: () => setLayer(name, !prefs[name]),
        },
        el("kbd", {}, key),
        label,
      );
    const choose = (name, list) =>
      el(
        "select",
        {
          id: `choose-${name}`,
          "aria-label": name,
          onchange: (event) =>
            setLayer(name, list.find(([v]) => String(v) === event.target.value)[0]),
        },
        list.map(([value, text]) => el("option", { value, selected: prefs[name] === value }, text)),
      );
    document.querySelector("#main .options").replaceChildren(
      toggle("points", "p", "scan", "the scan that the robot used"),
      choose("pointPaint", [
        ["plain", "plain"],
        ["depth", "by depth"],
        ["colour", "as in the picture"],
      ]),
      choose(
        "pointSize",
        [1, 2, 3, 4].map((v) => [v, `${v} px`]),
      ),
      toggle("parts", "m", "true parts", "the true poses of the parts"),
      toggle("robot", "r", "robot", "arm and tool"),
      toggle("bin", "b", "bin", "bin and table"),
      el("span", { class: "spring" }),
      ...["robot", "bin", "side", "top"].map((name) =>
        el(
          "button",
          {
            "data-look": name,
            title: `look at or from: ${name}`,
            onclick: () => replay.open.cloud.look(name),
          },
          name,
        ),
      ),
    );
  };

  function setLayer(name, value) {
    prefs[name] = value;
    replay.showLayers();
    replay.open.cloud.draw(prefs);
  }
}
