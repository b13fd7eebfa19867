"use strict";
// Tags and ticks of scenes. The browser stores the tags of this dataset. A file that can be saved and
// loaded transfers them, and `graycast dataset export --selection` reads it.

{
  const KIND = "graycast-scenes",
    LONGEST = 40;
  /** @type {Tags} */
  const tags = /** @type {any} */ ({ ticked: new Set(), forgetful: false });
  Graycast.tags = tags;
  let held = null; // scene's key -> its tags, sorted

  const drawer = () => `graycast-tags ${Graycast.report.name} ${Graycast.report.fingerprint}`;

  function open() {
    if (held) return held;
    held = new Map();
    try {
      for (const [key, list] of Object.entries(JSON.parse(localStorage.getItem(drawer()) ?? "{}")))
        held.set(key, list);
    } catch {
      tags.forgetful = true;
    }
    return held;
  }

  function keep() {
    try {
      localStorage.setItem(drawer(), JSON.stringify(Object.fromEntries(held)));
    } catch {
      tags.forgetful = true;
    }
  }

  function put(key, list) {
    if (list.length) open().set(key, [...new Set(list)].sort());
    else open().delete(key);
  }

  /** Return the tags of one scene, sorted. */
  tags.of = (key) => open().get(key) ?? [];

  /** Split the typed text at commas into tags. */
  tags.read = (text) =>
    text
      .split(",")
      .map((word) => word.trim().replace(/\s+/g, " ").slice(0, LONGEST))
      .filter(Boolean);

  tags.add = (keys, list) => {
    for (const key of keys) put(key, [...tags.of(key), ...list]);
    keep();
  };

  tags.remove = (keys, tag) => {
    for (const key of keys)
      put(
        key,
        tags.of(key).filter((one) => one !== tag),
      );
    keep();
  };

  /** Return each tag of these scenes with its number of scenes, sorted by name. */
  tags.among = (keys) => {
    const counts = new Map();
    for (const key of keys)
      for (const tag of tags.of(key)) counts.set(tag, (counts.get(tag) ?? 0) + 1);
    return [...counts].sort(([a], [b]) => (a < b ? -1 : 1));
  };

  tags.all = () => tags.among(Graycast.rows().map((row) => row.key));

  tags.tick = (key, on = !tags.ticked.has(key)) => {
    if (on) tags.ticked.add(key);
    else tags.ticked.delete(key);
  };

  // --- files --------------------------------------------------------------------------------------

  /** Offer these scenes and their tags as a file to save. */
  tags.save = (keys) => {
    const { name, fingerprint } = Graycast.report;
    const scenes = Object.fromEntries([...keys].sort().map((key) => [key, tags.of(key)]));
    const text = JSON.stringify({ kind: KIND, dataset: name, fingerprint, scenes }, null, 1);
    const url = URL.createObjectURL(new Blob([text + "\n"], { type: "application/json" }));
    Graycast.el("a", { href: url, download: `${name}-scenes.json` }).click();
    setTimeout(() => URL.revokeObjectURL(url), 10000);
  };

  /** Add a saved file's tags and tick its scenes; return a message for the user. */
  tags.take = (name, text) => {
    let content = null;
    try {
      content = JSON.parse(text);
    } catch {
      /* It is reported below. */
    }
    if (content?.kind !== KIND || typeof content.scenes !== "object")
      return `${name} is not a file of scenes that this page has saved. Nothing was loaded.`;
    if (content.fingerprint !== Graycast.report.fingerprint)
      return `${name} belongs to another dataset (${content.dataset}). Nothing was loaded.`;
    const here = new Set(Graycast.rows().map((row) => row.key)),
      entries = Object.entries(content.scenes).filter(([key]) => here.has(key)),
      gone = Object.keys(content.scenes).length - entries.length;
    tags.ticked = new Set(entries.map(([key]) => key));
    for (const [key, list] of entries) put(key, [...tags.of(key), ...list.map(String)]);
    keep();
    const lost = gone ? ` The file names ${gone} more that this report lacks.` : "";
    return `Ticked, with the tags of ${name}: ${entries.length}.${lost}`;
  };

  // --- how tags appear ----------------------------------------------------------------------------

  const { el } = Graycast;

  /** Return tags as small labels; with `drop`, each has a cross that removes it. */
  tags.chips = (list, drop) =>
    list.map(([tag, text]) =>
      el(
        "span",
        { class: "chip", "data-tag": tag },
        text ?? tag,
        drop
          ? el(
              "button",
              {
                title: `remove the tag ${tag}`,
                "aria-label": `remove ${tag}`,
                onclick: () => drop(tag),
              },
              "×",
            )
          : null,
      ),
    );

  /** Return a field for typing tags; Enter passes them to `take` and leaves the field. */
  tags.field = (id, take) => {
    const names = el(
      "datalist",
      { id: `${id}-names` },
      tags.all().map(([tag]) => el("option", { value: tag })),
    );
    const field = el("input", {
      id,
      list: `${id}-names`,
      placeholder: "add a tag",
      title: "Type a tag and press Enter; separate several tags with commas.",
      "aria-label": "add a tag",
      autocomplete: "off",
      onkeydown: (event) => {
        if (event.key !== "Enter") return;
        const list = tags.read(field.value);
        field.value = "";
        field.blur();
        if (list.length) take(list);
      },
    });
    return el("span", { class: "tag-field" }, field, names);
  };
}
