// The frame with a box around each tracked array, and the arrays enlarged.

import { colour, one } from "../common/dom";
import { imageOf } from "./grey";
import type { Model } from "./model";
import { arrayName, type About, type Box } from "./rows";
import { View } from "./view";

export function speedWords(approach: number | null | undefined): string {
  if (approach === null || approach === undefined) return "";
  const speed = Math.abs(approach * 3.6).toFixed(0);
  return speed === "0" ? "at rest" : `${speed} km/h ${approach >= 0 ? "approaching" : "receding"}`;
}

interface Shown { image: ImageBitmap; cuts: ImageBitmap[]; about: About; model: Model }

const ARROWS: Record<string, readonly [number, number]> = { ArrowLeft: [-40, 0], ArrowRight: [40, 0], ArrowUp: [0, -40], ArrowDown: [0, 40] };

export class FrameView {
  private readonly canvas = one("frame", HTMLCanvasElement);
  private readonly view = new View(one("frame-box", HTMLElement), () => this.paint());
  private shown: Shown | null = null;
  private asked = 0;
  private drawn = 0;

  constructor() {
    new ResizeObserver(() => this.paint()).observe(this.canvas);
    one("zoom-in", HTMLButtonElement).onclick = () => this.view.zoomBy(1.5);
    one("zoom-out", HTMLButtonElement).onclick = () => this.view.zoomBy(1 / 1.5);
    one("zoom-fit", HTMLButtonElement).onclick = () => this.view.reset();
  }

  /** True if a key zooms or moves the frame. */
  takesKey(key: string): boolean {
    const arrow = ARROWS[key];
    if (key === "+" || key === "=") this.view.zoomBy(1.5);
    else if (key === "-") this.view.zoomBy(1 / 1.5);
    else if (key === "0") this.view.reset();
    else if (arrow !== undefined && this.view.zoom > 1) this.view.moveBy(...arrow);
    else return false;
    return true;
  }

  async draw(about: About, picture: Blob, model: Model): Promise<void> {
    const order = ++this.asked;
    const [image, ...cuts] = await Promise.all([
      createImageBitmap(picture), ...about.cuts.slice(0, 3).map((cut) => createImageBitmap(imageOf(cut.received))),
    ]);
    if (order < this.drawn) return; // a newer frame was decoded sooner
    this.drawn = order;
    this.free();
    this.shown = { image, cuts, about, model };
    this.canvas.style.aspectRatio = `${image.width} / ${image.height}`;
    this.view.fit(about.width, about.height);
    this.canvas.setAttribute("aria-label", this.words(about, model));
  }

  private paint(): void {
    const sharp = window.devicePixelRatio;
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    this.canvas.width = Math.max(1, Math.round(width * sharp));
    this.canvas.height = Math.max(1, Math.round(height * sharp));
    one("zoom-fit", HTMLButtonElement).textContent = `${Number(this.view.zoom.toFixed(1))}×`;
    const context = this.canvas.getContext("2d", { alpha: false });
    if (context === null) return;
    context.scale(sharp, sharp);
    context.fillStyle = colour("screen");
    context.fillRect(0, 0, width, height);
    if (this.shown === null) return;
    const { image, cuts, about, model } = this.shown;
    const [x, y] = this.view.origin;
    context.imageSmoothingEnabled = this.view.scale * (about.width / image.width) < 2;
    context.drawImage(image, x, y, about.width * this.view.scale, about.height * this.view.scale);
    const side = Math.min(height * 0.36, width * 0.3, 160);
    const covered = about.boxes.some((box) => box.corners.some(([px, py]) => x + px * this.view.scale < cuts.length * (side + 8) + 8 && y + py * this.view.scale < side + 8));
    cuts.forEach((cut, k) => this.inset(context, cut, [8 + k * (side + 8), covered ? height - side - 8 : 8, side], arrayName(about.cuts[k] ?? { id: 0 })));
    for (const box of about.boxes) this.box(context, box, model);
  }

  /** The newest cut-out of an array, enlarged, at the frame's upper edge, or at the lower one if it covered an array. */
  private inset(context: CanvasRenderingContext2D, cut: ImageBitmap, [left, top, side]: readonly [number, number, number], name: string): void {
    context.imageSmoothingEnabled = false;
    context.drawImage(cut, left, top, side, side);
    context.lineWidth = 2;
    context.strokeStyle = "#ffb300";
    context.strokeRect(left, top, side, side);
    context.font = "600 12px system-ui, sans-serif";
    context.fillStyle = "rgb(11 13 17 / 80%)";
    context.fillRect(left, top, context.measureText(name).width + 10, 18);
    context.fillStyle = "#fff";
    context.fillText(name, left + 5, top + 13);
  }

  private box(context: CanvasRenderingContext2D, box: Box, model: Model): void {
    const [scale, origin] = [this.view.scale, this.view.origin];
    const points = box.corners.map(([x, y]) => [origin[0] + (x + 0.5) * scale, origin[1] + (y + 0.5) * scale] as const);
    const [x, y] = [0, 1].map((k) => points.reduce((sum, point) => sum + (point[k as 0 | 1]), 0) / points.length) as [number, number];
    const grow = 1 + 6 / Math.max(8, Math.hypot(points[0]![0] - x, points[0]![1] - y));
    context.lineWidth = 2;
    context.strokeStyle = box.seen ? "#ffb300" : "#ff6e6e";
    context.setLineDash(box.seen ? [] : [6, 4]);
    context.beginPath();
    for (const [px, py] of points) context.lineTo(x + (px - x) * grow, y + (py - y) * grow);
    context.closePath();
    context.stroke();
    context.setLineDash([]);
    const lines = [arrayName(box), `${box.distance_m.toFixed(1)} m`, speedWords(model.approach.get(box.id))].filter((line) => line !== "");
    const text = lines.join(" · ");
    context.font = "600 14px system-ui, sans-serif";
    const width = context.measureText(text).width;
    const bottom = Math.max(...points.map((point) => y + (point[1] - y) * grow)) + 8;
    const top = bottom + 22 > this.canvas.clientHeight ? Math.min(...points.map((point) => y + (point[1] - y) * grow)) - 30 : bottom;
    const left = Math.min(Math.max(x - width / 2, 4), Math.max(this.canvas.clientWidth - width - 4, 0));
    context.fillStyle = "rgb(11 13 17 / 80%)";
    context.fillRect(left - 5, top, width + 10, 22);
    context.fillStyle = "#fff";
    context.fillText(text, left, top + 16);
  }

  private words(about: About, model: Model): string {
    const boxes = about.boxes.map((box) => `${arrayName(box)} ${box.seen ? "" : "out of sight "}at ${box.distance_m.toFixed(1)} m ${speedWords(model.approach.get(box.id))}`.trim());
    return `Frame ${about.frame} at ${about.time_s.toFixed(3)} s: ${boxes.join("; ") || "no array"}`;
  }

  private free(): void {
    this.shown?.image.close();
    this.shown?.cuts.forEach((cut) => cut.close());
    this.shown = null;
  }

  clear(): void {
    this.drawn = ++this.asked;
    this.free();
    this.canvas.setAttribute("aria-label", "No frame yet");
    this.view.reset();
  }
}
