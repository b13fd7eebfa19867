"use strict";
// The bin in the 3D view of a dataset's page: its inner sides and rim. They are translucent,
// because the camera does not see all walls.

{
  const SHARE = 0.6; // share of the bin's colour in a pixel
  let loaded = null; // a promise of the mesh, which all scenes share

  async function unpacked({ vertices, growth, faces }) {
    const bytes = await Promise.all([vertices, growth, faces].map(Graycast.inflate));
    return {
      vertices: new Float32Array(bytes[0].buffer),
      growth: new Float32Array(bytes[1].buffer),
      faces: new Uint32Array(bytes[2].buffer),
    };
  }

  /** Return the `bodies` of `makeCloud` for the bin of a scene; null if the page has no bin. */
  Graycast.wallsOf = (scene) => {
    const { bin } = Graycast.report;
    if (!bin?.faces) return null;
    const factor = scene.manifest.domain?.bin?.size_factor ?? 1;
    return (gl, { middle }) => {
      let thing = null;
      loaded ??= unpacked(bin);
      loaded.then(({ vertices, growth, faces }) => {
        const place = vertices.map((v, k) => v + (factor - 1) * growth[k] - middle[k % 3]);
        thing = Graycast.shapes.body(gl, place, faces);
        Graycast.redraw();
      });
      return (prefs) =>
        thing && prefs.bin ? [{ thing, tint: Graycast.shapes.BIN, open: true, share: SHARE }] : [];
    };
  };
}
