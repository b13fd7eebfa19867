// Types of the live page's scripts; see types.d.ts of the datasets' page.

/** The state of the live page, and the functions that its scripts share. */
interface Live {
  state: any; // the last message about the settings; null before the first
  header: any; // the record of the last picture, with all settings; null before the first
  scene: any; // The viewer refers to this object, so it is kept while the size is the same.
  held: any; // the maps of an earlier picture to compare with, or null
  world: any; // the 3D view; null before the first picture
  bodies: any; // the last layout: meshes, poses and names
  edited: boolean; // whether the text differs from the settings in use
  latencies: any[];
  errors: string[];
  painted: number; // number of pictures
  at(id: string): any; // an element of the page

  // connection.js
  send(command: Record<string, any>): void;
  set(key: string, value: any, draft: boolean): void;
  drag(changes: Record<string, any>, draft: boolean): void;
  connect(): void;

  // pictures.js
  takeWorld(piece: any, array: (name: string, Type: any) => any): void;
  takePicture(piece: any, array: (name: string, Type: any) => any): void;

  // what the page shows
  showViews(): void;
  colorBar(bar: Bar): HTMLElement;
  showReadout(i: number): void;
  showFigures(): void;
  showSettings(): void;
  show(): void;
  remakeViewer(): void;
  makeWorld(): void;
}
