"use strict";
// The settings: the file's name, the controls, and the configuration as text.

{
  const { el, live } = Graycast,
    { at } = live,
    panel = at("controls");

  /** Show the present settings. */
  live.showSettings = () => {
    if (!live.state) return;
    at("where").textContent = live.state.path;
    at("undo").disabled = !live.state.undo;
    at("redo").disabled = !live.state.redo;
    const name = at("save-name");
    if (!name.value)
      name.value = `${live.state.path
        .split("/")
        .at(-1)
        .replace(/\.ya?ml$/, "")}_live.yaml`;
    const values = { ...live.header?.values, ...live.state.values };
    Graycast.showControls(
      panel,
      { controls: live.state.controls, values },
      live.state.said,
      live.set,
    );
    showText();
  };

  /** Mark the text as edited, or replace it by the settings in use. */
  function edit(on) {
    live.edited = on;
    at("reset").hidden = !on;
    if (!on && at("text").value !== live.state.text) at("text").value = live.state.text;
  }

  /** Show the configuration's text, where every key can be set; a refused text stays for editing. */
  function showText() {
    let details = at("all-words");
    if (!details) {
      const text = el("textarea", {
        id: "text",
        spellcheck: "false",
        rows: 14,
        "aria-label": "the configuration",
        oninput: () => edit(true),
      });
      details = el(
        "details",
        { id: "all-words", "data-group": "text" },
        el("summary", {}, "All keys, as YAML"),
        text,
        el(
          "button",
          { id: "apply", onclick: () => live.send({ do: "rewrite", text: text.value }) },
          "apply",
        ),
        el(
          "button",
          {
            id: "reset",
            title: "replace the text by the settings in use",
            hidden: true,
            onclick: () => edit(false),
          },
          "discard the edits",
        ),
      );
      panel.append(details);
    }
    if (!live.edited) edit(false);
  }
}
