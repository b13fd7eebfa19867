"use strict";
// The controls of the settings. Each has a slider, a number or a choice, the cost of a change, and
// a button that restores the default.

{
  const { el } = Graycast;
  const STEPS = 1000; // number of steps of a slider with a logarithmic scale
  const COSTS = {
    free: "measured again from the stored light",
    light: "rendered again, roughly first",
    physics: "the parts are dropped again",
  };
  const made = new Map(); // key -> {control, show(value), element}
  let held = null; // the key of a control that the user is moving

  /** Return the value of a control among the values in use. */
  function value(values, { key, whole, grey }) {
    let found = values[key];
    if (whole && found === undefined) {
      found = values[whole];
      for (const step of key.slice(whole.length + 1).split(".")) found = found?.[step];
    }
    return grey && Array.isArray(found) ? found.reduce((a, b) => a + b) / found.length : found;
  }

  /** Return the key and the value to send: the control's own, or those of its whole section. */
  function sent(values, { key, whole, grey }, to) {
    const put = grey ? [to, to, to] : to;
    if (!whole) return [key, put];
    const copy = structuredClone(values[whole]),
      way = key.slice(whole.length + 1).split("."),
      last = way.pop();
    way.reduce((node, step) => node[step], copy)[last] = put;
    return [whole, copy];
  }

  const digits = (number) => Number(number.toPrecision(4));

  /** Show a header's controls; each action of the user calls `set(key, value, draft)`. */
  Graycast.showControls = (panel, { controls, values }, said, set) => {
    const listed = JSON.stringify(controls);
    if (panel.dataset.listed !== listed) {
      panel.dataset.listed = listed;
      build(panel, controls, set);
    }
    panel.values = values;
    for (const [key, one] of made) {
      one.element.classList.toggle("said", said.includes(one.control.whole ?? key));
      if (key !== held) one.show(value(values, one.control));
    }
  };

  function build(panel, controls, set) {
    const open = new Set(
      [...panel.querySelectorAll("details[open]")].map((one) => one.dataset.group),
    );
    const groups = new Map();
    made.clear();
    for (const control of controls) {
      if (!groups.has(control.group)) groups.set(control.group, []);
      const one = control.choices ? choice(panel, control, set) : slider(panel, control, set);
      made.set(control.key, { ...one, control });
      groups.get(control.group).push(one.element);
    }
    const shown = open.size ? open : new Set(["Exposure", "Rig"]);
    const text = panel.querySelector("#all-words");
    panel.replaceChildren(
      ...[...groups].map(([name, rows]) =>
        el("details", { "data-group": name, open: shown.has(name) }, el("summary", {}, name), rows),
      ),
      ...(text ? [text] : []),
    );
  }

  /** Return the row of a control: its label, its inputs, and a button that restores the default. */
  function row(panel, control, set, ...inputs) {
    const back = el(
      "button",
      {
        class: "unsay",
        title: "remove this setting, so that the default applies",
        "aria-label": `${control.label}: use the default`,
        onclick: () => set(control.whole ?? control.key, null, false),
      },
      "×",
    );
    return el(
      "div",
      {
        class: "control",
        "data-key": control.key,
        "data-cost": control.cost,
        title: [control.about, COSTS[control.cost]].filter(Boolean).join("\n\n"),
      },
      el("span", { class: "label" }, el("i", { class: `cost ${control.cost}` }), control.label),
      ...inputs,
      back,
    );
  }

  function slider(panel, control, set) {
    const { low, high, step, scale = 1, unit = "", label } = control,
      ratio = step === undefined;
    const range = el("input", {
      type: "range",
      "aria-label": label,
      min: ratio ? 0 : low,
      max: ratio ? STEPS : high,
      step: ratio ? 1 : step,
    });
    const number = el("input", { type: "number", "aria-label": `${label}, number`, step: "any" });
    const element = row(panel, control, set, range, number, el("span", { class: "unit" }, unit));
    const read = () => {
      const at = Number(range.value);
      return ratio ? digits(low * (high / low) ** (at / STEPS)) : digits(at);
    };
    const give = (to, draft) => set(...sent(panel.values, control, to), draft);
    range.addEventListener("input", () => {
      held = control.key;
      number.value = digits(read() * scale);
      give(read(), true);
    });
    range.addEventListener("change", () => {
      held = null;
      give(read(), false);
    });
    number.addEventListener("focus", () => (held = control.key));
    number.addEventListener("blur", () => (held = null));
    number.addEventListener("change", () => {
      held = null;
      if (number.value !== "") give(Number(number.value) / scale, false);
    });
    const show = (now) => {
      const known = typeof now === "number";
      // A file determines the rest of the section, so nothing can be sent until the file has been
      // read.
      const sendable = !control.whole || panel.values[control.whole] !== undefined;
      range.disabled = number.disabled = !sendable;
      element.classList.toggle("unset", !known);
      number.value = known ? digits(now * scale) : "";
      if (known) range.value = ratio ? STEPS * (Math.log(now / low) / Math.log(high / low)) : now;
    };
    return { element, show };
  }

  function choice(panel, control, set) {
    const words = (one) =>
      Array.isArray(one) ? one.map(digits).join(" + ") : String(one).replaceAll("_", " ");
    const select = el(
      "select",
      { "aria-label": control.label },
      control.choices.map((one) => el("option", { value: JSON.stringify(one) }, words(one))),
    );
    select.addEventListener("change", () =>
      set(...sent(panel.values, control, JSON.parse(select.value)), false),
    );
    const show = (now) => {
      const text = JSON.stringify(now);
      if (![...select.options].some((one) => one.value === text))
        select.append(
          el("option", { value: text }, now === null || now === undefined ? "–" : words(now)),
        );
      select.value = text;
    };
    return { element: row(panel, control, set, select), show };
  }
}
