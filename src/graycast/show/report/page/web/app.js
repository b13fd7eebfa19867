"use strict";
// Routing between pages, keys, and the light or dark theme.

{
  const { el } = Graycast;
  const main = document.getElementById("main"),
    help = /** @type {HTMLDialogElement} */ (document.getElementById("help"));
  const table = ([title, keys]) =>
    el(
      "section",
      {},
      el("h2", {}, title),
      el(
        "table",
        {},
        keys.map(([key, text]) =>
          el("tr", {}, el("th", {}, el("kbd", {}, key)), el("td", {}, text)),
        ),
      ),
    );
  const [first, ...rest] = Object.entries(Graycast.KEYS).map(table);
  help.append(
    el("div", { class: "key-lists" }, el("div", {}, first, rest.pop()), rest),
    el("form", { method: "dialog" }, el("button", {}, "close")),
  );

  let turn = 0;
  async function route() {
    const mine = ++turn,
      key = location.hash.replace(/^#\/?/, "");
    main.dataset.ready = "";
    try {
      if (!Graycast.report)
        throw new Error("index.js is missing in this page's folder: run graycast report again");
      if (key) await Graycast.showScene(main, key, () => mine === turn);
      else {
        Graycast.closeScene();
        Graycast.showOverview(main);
        Graycast.focusCard();
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
      /* The browser stores nothing. */
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
  const TYPED = "select, input:not([type=range]):not([type=checkbox])";
  addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target),
      more = /** @type {HTMLDetailsElement} */ (document.querySelector("#more[open]"));
    if (event.ctrlKey || event.metaKey || event.altKey || help.open) return;
    if (target.matches(TYPED)) {
      if (event.key === "Escape") target.blur();
      return;
    }
    if (target.matches("input") && event.key.startsWith("Arrow")) return;
    if (event.key === " " && target.matches("button, summary")) return; // The key presses the button.
    if (event.key === "t") change();
    else if (event.key === "?") help.showModal();
    else if (event.key === "Escape" && more) more.open = false;
    else if (event.key === "Escape" && location.hash.length > 2) location.hash = "#/";
    else if (event.key === "Enter" && target.matches("button, summary, a")) return;
    else if (!Graycast.sceneKey(event) && !Graycast.gridKey(event)) return;
    event.preventDefault();
  });
  route();
}
