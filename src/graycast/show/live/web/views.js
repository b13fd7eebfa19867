"use strict";
// The views of a picture: their colours, their buttons and their choices.

{
  const { el, live, prefs, words } = Graycast,
    { at } = live;

  Graycast.VIEWS.splice(-1, 1, { id: "sigma", label: "σ of depth" }); // 3D has its own place.
  Graycast.VIEWS.push({ id: "p_wrong", label: "doubt of depth" });

  const paint = Graycast.paint; // the views that all pages have

  Graycast.paint = (of, view, now, out) => {
    if (view === "p_wrong") return paintDoubt(of, out);
    if (view !== "sigma") return paint(of, view, now, out);
    const high = Graycast.sigmaLimit(of);
    for (let i = 0; i < of.n; i++) {
      const [r, g, b] =
        of.sigma[i] === of.sigma[i] ? Graycast.heat("magma", of.sigma[i] / high) : [58, 60, 66];
      out.set([r, g, b, 255], 4 * i);
    }
    return {
      bar: { map: "magma", low: 0, high, unit: "mm", digits: 2 },
      note: "standard deviation of the depth, as estimated by the scanner",
    };
  };

  /** Paint the logarithm of the probability that each depth is wrong. */
  function paintDoubt(of, out) {
    for (let i = 0; i < of.n; i++) {
      const p = of.p_wrong ? of.p_wrong[i] : NaN;
      const share = 1 + Math.log10(Math.max(p, 1e-4)) / 4;
      out.set([...(p === p ? Graycast.heat("magma", share) : [58, 60, 66]), 255], 4 * i);
    }
    return {
      bar: { map: "magma", low: -4, high: 0, unit: "log10", digits: 0 },
      note: of.p_wrong
        ? "probability that the depth is wrong, as estimated by the scanner"
        : "the scanner estimates this only with max_p_wrong below 1",
    };
  }

  /** Show the buttons of the views, and the choices of the selected view. */
  live.showViews = () => {
    const known = Graycast.VIEWS.filter((view) => view.id !== "p_wrong" || live.scene?.p_wrong);
    const buttons = known.map((view) =>
      el(
        "button",
        {
          "data-view": view.id,
          "aria-pressed": String(view.id === prefs.view),
          onclick: () => change("view", view.id),
        },
        view.label,
      ),
    );
    at("views").replaceChildren(
      ...buttons,
      chooseFrame(),
      chooseColumn(),
      chooseGain(),
      el("span", { class: "spring" }),
      chooseComparison(),
    );
  };

  function change(name, value) {
    prefs[name] = value;
    live.show();
  }

  /** Return a list of `options`, which are values and labels. */
  const choice = (attributes, options, now) =>
    el(
      "select",
      attributes,
      options.map(([value, label]) => el("option", { value, selected: value === now }, label)),
    );

  const chooseFrame = () =>
    choice(
      {
        id: "choose-frame",
        hidden: prefs.view !== "pattern",
        onchange: (event) => live.send({ do: "look", frame: Number(event.target.value) }),
      },
      live.header.frames.map((name, k) => [k, words(name)]),
      prefs.frame,
    );

  const chooseColumn = () =>
    choice(
      {
        id: "choose-column",
        hidden: prefs.view !== "column",
        onchange: (event) => change("axis", event.target.value),
      },
      [live.header.axis, `sigma_${live.header.axis}`].map((axis) => [
        axis,
        axis.replace("sigma_", "σ of "),
      ]),
      prefs.axis,
    );

  const chooseGain = () =>
    choice(
      {
        id: "choose-gain",
        "aria-label": "brightness",
        hidden: !["white", "pattern"].includes(prefs.view),
        onchange: (event) => change("gain", Number(event.target.value)),
      },
      Graycast.GAINS.map((gain) => [gain, `brightness × ${gain}`]),
      prefs.gain,
    );

  const chooseComparison = () =>
    choice(
      {
        id: "choose-how",
        hidden: !live.held,
        onchange: (event) => change("how", event.target.value),
      },
      [
        ["side", "side by side"],
        ["swipe", "swipe"],
      ],
      prefs.how,
    );

  /** Return the colour bar of a view. */
  live.colorBar = ({ map, low, high, unit, digits }) => {
    const canvas = el("canvas", { width: 256, height: 1 }),
      context = canvas.getContext("2d"),
      image = context.createImageData(256, 1),
      table = Graycast.colormap(map);
    for (let k = 0; k < 256; k++) image.data.set([...table.subarray(3 * k, 3 * k + 3), 255], 4 * k);
    context.putImageData(image, 0, 0);
    return el(
      "span",
      { class: "bar" },
      low.toFixed(digits),
      canvas,
      `${high.toFixed(digits)} ${unit}`,
    );
  };
}
