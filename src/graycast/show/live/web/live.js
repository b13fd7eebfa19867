"use strict";
// The page: a picture or two next to each other, the 3D view, and the buttons and keys.

{
  const { live, prefs } = Graycast,
    { at } = live;
  let viewer = null,
    heldNumber = 0, // number of the held picture's settings
    pointed = -1; // the pixel under the pointer; -1 for none

  /** Show the present picture in the present view. */
  live.show = () => {
    if (!live.scene || !viewer) return;
    live.showViews();
    const painted = viewer.paint(live.held ? [prefs.view, prefs.view] : [prefs.view], prefs);
    if (live.held)
      viewer.stage.querySelectorAll(".pane-name").forEach((name, k) => {
        name.textContent = k ? "held" : "now";
      });
    const { bar, note } = painted[0];
    at("under").replaceChildren(
      Graycast.el("div", {}, bar ? live.colorBar(bar) : null, note ?? ""),
    );
    live.showReadout(pointed);
    live.showSettings();
    live.showFigures();
  };
  Graycast.repaint = () => live.show();

  /** Replace the viewer, whose pictures have a fixed size and number. */
  live.remakeViewer = () => {
    viewer?.close();
    const point = (i) => {
      pointed = i;
      live.showReadout(i);
    };
    viewer = Graycast.makeViewer(live.scene, point, live.held ?? live.scene);
    at("hold-2d").replaceChildren(viewer.stage);
  };

  /** Make the 3D view, with its options, for the first picture. */
  live.makeWorld = () => {
    live.world = Graycast.makeWorld(live.scene, live.drag);
    at("hold-3d").replaceChildren(live.world.stage);
    if (live.bodies) live.world.bodies(live.bodies);
    live.world.draw(prefs);
    showWorldOptions();
  };

  function showWorldOptions() {
    at("space-options").replaceChildren(
      ...Graycast.worldOptions(
        prefs,
        (name, value) => {
          prefs[name] = value;
          live.world.draw(prefs);
          showWorldOptions();
        },
        (name) => live.world.look(name),
      ),
    );
  }

  // --- buttons and keys ---------------------------------------------------------------------------

  at("undo").onclick = () => live.send({ do: "undo" });
  at("redo").onclick = () => live.send({ do: "redo" });
  at("save").onclick = () => live.send({ do: "save", name: at("save-name").value });
  at("hold").onclick = () => {
    if (!live.scene) return;
    live.held = live.held ? null : { ...live.scene };
    heldNumber = live.header.number;
    at("hold").setAttribute("aria-pressed", String(!!live.held));
    at("back").hidden = !live.held;
    live.remakeViewer();
    live.show();
  };
  at("back").onclick = () => live.send({ do: "return", number: heldNumber });
  addEventListener("keydown", (event) => {
    if (
      !(event.ctrlKey || event.metaKey) ||
      /** @type {HTMLElement} */ (event.target).matches("textarea, input:not([type=range])")
    )
      return;
    if (event.key.toLowerCase() !== "z") return;
    event.preventDefault();
    live.send({ do: event.shiftKey ? "redo" : "undo" });
  });
  const root = document.documentElement;
  root.dataset.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  at("theme").onclick = () => {
    root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
    live.world?.draw(prefs);
  };

  live.connect();
}
