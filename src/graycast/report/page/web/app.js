"use strict";
// Which page is shown, the keys, light and dark.

{
  const { el } = Graycast;
  const main = document.getElementById("main"),
    help = document.getElementById("help");
  const KEYS = [
    ["← →", "previous, next scene of the filtered list"],
    ["1 … 9", "views"],
    ["space", "back to the last view: flip between two"],
    ["↑ ↓ or [ ]", "previous, next pattern frame"],
    ["p", "pattern frames: play, stop"],
    ["m b", "masks, boxes"],
    ["s p", "3D: perfect surface, scanner points"],
    ["+ − 0", "zoom in, out, whole picture"],
    ["t", "light or dark"],
    ["Esc", "back to all scenes"],
    ["?", "these keys"],
  ];
  help.append(
    el(
      "table",
      {},
      KEYS.map(([key, text]) => el("tr", {}, el("th", {}, el("kbd", {}, key)), el("td", {}, text))),
    ),
    el("form", { method: "dialog" }, el("button", {}, "close")),
  );

  let turn = 0;
  async function route() {
    const mine = ++turn,
      key = location.hash.replace(/^#\/?/, "");
    main.dataset.ready = "";
    try {
      if (!Graycast.report)
        throw new Error("index.js is missing beside this page: run graycast report again");
      if (key) await Graycast.showScene(main, key, () => mine === turn);
      else {
        Graycast.closeScene();
        Graycast.showOverview(main);
      }
    } catch (error) {
      main.replaceChildren(el("p", { class: "sorry" }, error.message));
    }
    if (mine === turn) main.dataset.ready = key || "overview";
  }

  const root = document.documentElement,
    dark = matchMedia("(prefers-color-scheme: dark)");
  function dress(theme) {
    root.dataset.theme = theme;
    Graycast.redraw();
  }
  function stored() {
    try {
      return localStorage.getItem("graycast-theme");
    } catch {
      return null;
    }
  }
  function change() {
    const next = root.dataset.theme === "dark" ? "light" : "dark";
    try {
      localStorage.setItem("graycast-theme", next);
    } catch {
      /* a browser that keeps nothing */
    }
    dress(next);
  }
  dress(stored() ?? (dark.matches ? "dark" : "light"));
  dark.addEventListener("change", () => {
    if (!stored()) dress(dark.matches ? "dark" : "light");
  });

  document.getElementById("theme").onclick = change;
  document.getElementById("keys").onclick = () => help.showModal();
  addEventListener("hashchange", route);
  addEventListener("keydown", (event) => {
    if (
      event.ctrlKey ||
      event.metaKey ||
      event.altKey ||
      help.open ||
      event.target.matches("select, input:not([type=range])") ||
      (event.target.matches("input") && event.key.startsWith("Arrow"))
    )
      return;
    if (event.key === "t") change();
    else if (event.key === "?") help.showModal();
    else if (event.key === "Escape" && location.hash.length > 2) location.hash = "#/";
    else if (!Graycast.sceneKey(event)) return;
    event.preventDefault();
  });
  route();
}
