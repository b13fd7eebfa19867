// Types that the scripts of the pages share, for TypeScript's checker and for editors; no page loads
// this file. Distances are in millimetres unless the name has another unit.

type Point = [number, number, number];
type Prefs = Record<string, any>; // the user's choices

/** A camera's pose and lens, as in BOP's scene_camera.json. */
interface View {
  cam_K: number[];
  cam_R_w2c: number[];
  cam_t_w2c: number[];
  distortion: number[];
}

/** One part of a scene; its boxes are BOP's, which end at pixel centres. */
interface Instance {
  name: string;
  obj_id: number;
  visible: number | null;
  area: number;
  box: number[];
  amodal: number[] | null;
  t: Point | null;
  box3d: [number[], Point, Point] | null; // rotation, centre and size
}

/** The input of the camera models: a scan, or a scene of a dataset. */
interface Seen {
  sensor?: string; // the scanner's name, if it has one
  width: number; // width of the maps, which hold every `stride`-th pixel of the picture
  height: number;
  stride: number;
  n: number; // number of pixels in the maps
  depth_scale_mm: number; // size of a step of depth
  view: View;
  has: { depth: boolean; scanner: boolean };
  depth?: Uint16Array; // perfect depth in steps; 0 where missing
  scanner?: Uint16Array;
  rays?: Float32Array; // stored after the first request
  projected?: Record<string, Positions>;
}

interface Scene extends Seen {
  key: string;
  fusing?: any; // the fused cloud of all pictures of its scene, while loading and after
  fusedKey?: string | null; // the picture whose files hold that cloud; null if it is the only one
  full: [number, number]; // width and height of the picture
  kept: { frames: string[]; columns: string[] }; // names of the data that the dataset stores
  instances: Instance[];
  reason: Uint8Array;
  instance: Uint16Array; // number of the instance plus 1; 0 for none
  sigma?: Float32Array;
  sigmaHigh?: number;
  p_wrong?: Float32Array | null;
  range?: [number, number]; // range of depth for the colours
  rgb: Uint8ClampedArray; // four bytes per pixel
  white?: Uint8ClampedArray;
  frames?: any; // captured frames, while loading and after
  columns?: any; // decoded positions, while loading and after
  positions?: Record<string, Float32Array>; // decoded positions, on a live page
  levels?: Uint8Array; // the captured frame, on a live page
  shown?: Uint8Array; // the captured frame that is shown
  found?: any; // a detector's results
  manifest?: any;
}

/** Projector positions of pixels [px]; NaN where unknown. */
interface Positions {
  column: Float32Array;
  row: Float32Array;
}

/** The meaning of a painted picture's colours, and a note. */
interface Said {
  bar?: Bar | null;
  note?: string;
  shown?: Uint8Array;
}

interface Bar {
  map: string;
  low: number;
  high: number;
  unit: string;
  digits: number;
  whole?: boolean; // Every pixel has a value.
}

interface Lit {
  instance?: number;
  reason?: number | null;
  mark?: number;
}

/** A scene moved so that the centre of rotation is at the origin. */
interface Space {
  point: (i: number, step: number) => number[];
  middle: number[];
  reach: number; // radius of the visible content around the centre
  views: Record<string, Eye>;
  start: Eye;
}

interface Eye {
  yaw: number;
  pitch: number;
  distance: number;
  pan?: number[];
}

/** Arrays on the GPU. */
interface Thing {
  array: WebGLVertexArrayObject;
  color: WebGLBuffer;
  buffers: WebGLBuffer[];
  index: boolean;
  count: number;
  from?: ArrayLike<number>; // the pixel of each vertex
  paint?: string;
}

interface Drawn {
  thing: Thing;
  place?: Float32Array; // a matrix
  tint?: number[];
  open?: boolean; // Only its front is drawn.
  share?: number; // The rest of a pixel is the picture behind it.
  lines?: boolean;
}

/** A 3D view. */
interface Cloud {
  stage: HTMLElement;
  draw(prefs: Prefs): void;
  look(name: string): void;
  swap(scene: Scene): void;
  onScreen(point: number[]): number[] | null;
  close(): void;
}

/** One picture, or two to compare. */
interface Viewer {
  stage: HTMLElement;
  home(): void;
  zoomAt(factor: number, px?: number, py?: number): void;
  close(): void;
  paint(views: string[], prefs: Prefs): Said[];
  cover(prefs: Prefs, lit: Lit): void;
}

type GL = WebGL2RenderingContext;

interface Shapes {
  BIN: number[];
  pointOf(scene: Seen): (i: number, step: number) => Point;
  space(scene: Scene): Space;
  mesh(gl: GL, scene: Scene, space: Space): Thing;
  cloud(gl: GL, scene: Scene, space: Space): Thing;
  body(gl: GL, vertices: Float32Array, faces: Uint32Array): Thing;
  lines(gl: GL, place: Float32Array, color: number[]): Thing;
  edges(gl: GL, scene: Scene, space: Space): Thing;
  fused(gl: GL, cloud: any, space: Space): Thing;
  paintFused(gl: GL, thing: Thing, cloud: any, paint: string): void;
  fusedWords(cloud: any, paint: string): any;
  drop(gl: GL, thing: Thing): void;
  recolor(gl: GL, scene: Scene, thing: Thing, paint: string, prefs: Prefs): void;
  normals(scene: Scene, from: ArrayLike<number>): Int8Array;
}

interface Tags {
  ticked: Set<string>;
  forgetful: boolean; // The browser stores nothing.
  of(key: string): string[];
  read(text: string): string[];
  add(keys: string[], list: string[]): void;
  remove(keys: string[], tag: string): void;
  among(keys: Iterable<string>): [string, number][];
  all(): [string, number][];
  tick(key: string, on?: boolean): void;
  save(keys: Iterable<string>): void;
  take(name: string, text: string): string;
  chips(list: string[][], drop?: (tag: string) => void): HTMLElement[];
  field(id: string, take: (list: string[]) => void): HTMLElement;
}

interface Found {
  KINDS: [string, string][];
  FILTERS: [string, string][];
  SORTS: [string, string][];
  words(filter: string): string;
  told(): HTMLElement | null;
  count(row: Row, what: string): number | null;
  fits(row: Row, filter: string): boolean;
  follow(filter: string): void;
  line(row: Row): HTMLElement | null;
  slider(id: string, held: Prefs, change: (score: number) => void): HTMLElement;
  draw(scene: Scene, svg: SVGElement, prefs: Prefs, lit: Lit): void;
  list(scene: Scene, prefs: Prefs, actions: { light: (lit: Lit) => void }): HTMLElement[];
}

interface Side {
  readout(scene: Scene, i: number): void;
  tags: (...given: any[]) => any;
  legend: (...given: any[]) => any;
  instances: (...given: any[]) => any;
  facts: (...given: any[]) => any;
}

interface Toolbar {
  views: (...given: any[]) => any;
  compare: (...given: any[]) => any;
  options: (...given: any[]) => any;
  brightness(prefs: Prefs, set: (name: string, value: any) => void): HTMLElement;
  pictures(row: Row, go: (key: string) => void): HTMLElement[];
  under(said: Said[], names: string[]): HTMLElement[];
}

type Row = Record<string, any>; // a scene of the grid; its keys are the columns of index.js

interface Shared {
  report: any; // the content of index.js
  prefs: Prefs;

  // core.js
  linear(level: number): number;
  encoded(share: number): number;
  el(tag: string, attributes?: Record<string, any>, ...children: any[]): any;
  tip(event: MouseEvent, text?: string): void;
  words(name: string): string;
  ownReasons(row: { part_reasons?: any; reasons?: any }): any;
  count(value: number): string;
  percent(share: number | null | undefined, digits?: number): string;
  mm(value: number | null | undefined, digits?: number): string;
  signed(value: number, digits?: number): string;
  allRows?: Row[];
  rows(): Row[];
  siblings(row: Row): Row[]; // all pictures of its scene
  scannerOf(scene: Seen): { rig: any; code: any }; // null if unknown
  reasonColors(): Uint8ClampedArray; // three bytes for each reason's number
  colormap(name: string): Uint8Array; // 256 times three bytes
  heat(name: string, share: number): Uint8Array;
  sigmaLimit(scene: Scene): number;
  instanceColor(index: number): Point;
  receive(content: any): void;
  bring(file: string, name: string): Promise<any>;
  bringFound(key: string): Promise<any>;
  load(key: string): Promise<Scene>;
  frame(scene: Scene, k: number, ready: () => void): Uint8Array | null;
  columns(scene: Scene, ready: () => void): Record<string, Float32Array> | null;
  fused(scene: Scene, ready: () => void): any;
  letGo(scene: Scene): void;
  inflate(text: string): Promise<Uint8Array>;
  pixels(url: string, size: { width: number; height: number }): Promise<Uint8ClampedArray>;
  unpackWords(bytes: Uint8Array, width: number, height: number): Uint16Array;

  // geometry.js
  rays(scene: Seen): Float32Array; // x and y of each pixel
  projectorMap(scene: Seen, which: string): Positions;
  toWorld(scene: Seen, x: number, y: number, z: number): Point;
  boxEdges(box: [number[], Point, Point]): Point[];

  // paint.js
  VIEWS: { id: string; label: string }[];
  ERROR_LIMITS_MM: number[];
  GAINS: number[];
  viewsOf(scene: Scene): { id: string; label: string }[];
  paint(scene: Scene, view: string, prefs: Prefs, out: Uint8ClampedArray): Said;
  paintOverlay(scene: Scene, prefs: Prefs, lit: Lit, out: Uint8ClampedArray): void;
  depthRange(scene: Scene): [number, number];
  errorLimit(prefs: Prefs): number;
  sourcesOf(scene: Scene, view: string, prefs: Prefs): string[];
  sourceOf(scene: Scene, view: string, prefs: Prefs): string;
  frameNames(scene: Scene): string[];
  highest(values: Float32Array, share: number): number;

  // the picture and the 3D view
  makeViewer(
    scene: Scene,
    onPointer: (i: number, event: PointerEvent) => void,
    other?: Scene,
  ): Viewer;
  makeCloud(
    scene: Scene,
    options?: {
      space?: Space;
      bodies?: (gl: GL, space: Space) => (prefs: Prefs) => Drawn[];
      perfect?: boolean;
    },
  ): Cloud;
  wallsOf(scene: Scene): ((gl: GL, space: Space) => (prefs: Prefs) => Drawn[]) | null;
  shapes: Shapes;
  found: Found;
  side: Side;
  toolbar: Toolbar;
  tags: Tags;
  KEYS: Record<string, string[][]>;

  // the overview and its grid
  onlyValue(plot: any): string | null;
  plot(plot: any): HTMLElement;
  shares(plot: any): HTMLElement;
  stack(...given: any[]): HTMLElement;
  thumbName(): string;
  filtered(): Row[];
  filterBar(changed: () => void): any;
  liftAll(): void;
  showGrid(section: HTMLElement): any;
  cameFrom(key: string): void;

  // routing and keys
  showOverview(main: HTMLElement): void;
  showScene(main: HTMLElement, key: string, isCurrent: () => boolean): Promise<void>;
  closeScene(): void;
  focusCard(): void;
  gridKey(event: KeyboardEvent): boolean;
  sceneKey(event: KeyboardEvent): boolean;
  redraw(): void;
  repaint(): void;
  opened(): any; // for tests

  // the page of picks
  outcomes: Outcomes;
  limbsAt(motion: any, time: number): Float32Array[];
  carried(motion: any, time: number, before: number[]): Float32Array | null;
  makeBodies(middle: number[], now: () => any): Promise<(gl: GL) => (prefs: Prefs) => Drawn[]>;
  resting(now: any, k: number): Float32Array;
  replay: Replay;

  // the live page
  live: Live;
  makeWorld(scene: Scene, drag: (changes: any, draft: boolean) => void): any;
  worldOptions(
    prefs: Prefs,
    set: (name: string, value: any) => void,
    look: (name: string) => void,
  ): HTMLElement[];
  showControls(
    panel: HTMLElement & { values?: Record<string, any> },
    given: { controls: any; values: Record<string, any> },
    said: any,
    set: any,
  ): void;
}
