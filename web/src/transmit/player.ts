// Patterns on a canvas, each for a whole number of refreshes; refreshes that the machine skipped are counted.

import type { Packets } from "./packets";

/** Cells of dark margin on each side. */
export const MARGIN = 2;

/** How levels become pixel values. */
export interface Light {
  gamma: number;
  /** Part of the full light, 0 to 1. */
  brightness: number;
}

/** Levels of a pattern: 0 to this. */
const TOP = 4;

/** Draws a pattern of levels, row by row, with the dark margin. */
export function drawPattern(canvas: HTMLCanvasElement, levels: ArrayLike<number>, side: number, light: Light): void {
  const context = canvas.getContext("2d", { alpha: false });
  if (context === null) return;
  context.fillStyle = "#000";
  context.fillRect(0, 0, canvas.width, canvas.height);
  const cell = canvas.width / (side + 2 * MARGIN);
  const colours = Array.from({ length: TOP + 1 }, (_, level) => {
    const value = pixel(level / TOP, light);
    return `rgb(${value} ${value} ${value})`;
  });
  for (let k = 0; k < levels.length; k += 1) {
    context.fillStyle = colours[levels[k]!] ?? "#000";
    context.fillRect((MARGIN + (k % side)) * cell, (MARGIN + Math.floor(k / side)) * cell, cell, cell);
  }
}

/** Pixel value of a part of the full light. */
export function pixel(part: number, light: Light): number {
  return Math.round(255 * (part * light.brightness) ** (1 / light.gamma));
}

export class Player {
  /** Refreshes since the start, those that were skipped with them. */
  refreshes = 0;
  skipped = 0;
  /** Patterns that were never shown, as all their refreshes were skipped or they were not there in time. */
  lost = 0;
  paused = false;
  /** Called where a count changed. */
  onChange: () => void = () => undefined;

  private packets: Packets | null = null;
  private last = 0;
  private shown = -1;
  private running = 0;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly refreshMs: number,
    private lasts: number,
    private light: Light,
  ) {}

  /** Number of the pattern that is to be seen now. */
  get pattern(): number {
    return Math.floor(this.refreshes / this.lasts);
  }

  get playing(): boolean {
    return this.packets !== null;
  }

  play(packets: Packets, lasts: number): void {
    this.packets = packets;
    this.lasts = lasts;
    this.restart();
    const run = ++this.running;
    const tick = (now: number): void => {
      if (run !== this.running) return;
      this.step(now);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  /** The canvas is dark until `play`. */
  stop(): void {
    this.running += 1;
    this.packets = null;
    this.draw();
  }

  restart(): void {
    [this.refreshes, this.skipped, this.lost, this.shown, this.last] = [0, 0, 0, -1, 0];
    this.paused = false;
  }

  setLight(light: Light): void {
    this.light = light;
    this.draw();
  }

  pause(paused: boolean): void {
    this.paused = paused;
    this.last = 0; // what passes while it is paused was not skipped
  }

  /** The canvas' pixels are those of the display, as many for each cell. */
  fit(): void {
    const side = this.packets?.facts.side ?? 16;
    const cells = side + 2 * MARGIN;
    const room = Math.min(this.canvas.clientWidth, this.canvas.clientHeight || Infinity) * devicePixelRatio;
    const cell = Math.max(1, Math.floor(room / cells));
    if (this.canvas.width === cell * cells) return;
    this.canvas.width = this.canvas.height = cell * cells;
    this.draw();
  }

  private step(now: number): void {
    if (this.paused) return;
    if (this.last !== 0) {
      // times of refreshes scatter by little; two or more periods are refreshes that were skipped
      const passed = Math.max(1, Math.round((now - this.last) / this.refreshMs));
      this.refreshes += passed;
      if (passed > 1) {
        this.skipped += passed - 1;
        this.onChange();
      }
    }
    this.last = now;
    const pattern = this.pattern;
    if (pattern === this.shown) return;
    const missed = pattern - this.shown - 1;
    const levels = this.packets?.levels(pattern);
    if (levels === null || levels === undefined) {
      this.last = 0; // the light waits for the server
      this.refreshes = Math.max(0, this.shown) * this.lasts;
      return;
    }
    this.shown = pattern;
    this.draw();
    if (missed > 0) {
      this.lost += missed;
      this.onChange();
    }
  }

  private draw(): void {
    const levels = this.shown < 0 ? null : this.packets?.levels(this.shown);
    drawPattern(this.canvas, levels ?? [], this.packets?.facts.side ?? 1, this.light);
  }
}
