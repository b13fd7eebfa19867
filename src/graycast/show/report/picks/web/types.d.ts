// Types of the scripts for picks; see types.d.ts of the datasets' page.

interface Outcome {
  name: string;
  color: string;
  meaning: string;
}

interface Outcomes {
  of(k: number): Outcome;
  named(name: string): Outcome;
  number(name: string): number;
  looked(k: number): boolean;
  any(): boolean;
  clear(): void;
  swatch(one: Outcome): HTMLElement;
  buttons(counts: Record<string, number>, changed: () => void): HTMLElement[];
}

/** The state of a replay, and the functions that its scripts share. */
interface Replay {
  open: any; // the bin on the page, its attempt, scan, time and 3D view; null for no bin
  running: number; // the id of the requested frame, 0 for none
  waiting: number; // the timer of the next attempt

  // scans.js
  bringAttempt(bin: any, number: number): Promise<any>;
  spaceOf(look: any, scan: any): Space;

  // attempts.js, layers.js
  showOutcome(): void;
  showFacts(): void;
  showAttempts(): void;
  showLayers(): void;

  // player.js
  showPlayer(): void;
  changeSpeed(by: number): void;
  seek(time: number): void;
  step(by: number): void;
  play(on: boolean): void;
  neighbour(by: number): number | null;
}
